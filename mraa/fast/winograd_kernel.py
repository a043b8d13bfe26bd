"""The transforms of `mraa.fast.winograd` as compiled loops, 16 channels at a time.

They also do what lies beside the convolution: scale, shift and ReLU before it, bias, residual and
ReLU behind it. Arrays are C-contiguous, float32 or bfloat16 given by its bits as uint16.
"""

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from mraa.fast.compiled import compiled

LANES = 16
"""Channels in one step of the transforms."""

_B2 = ((1, 0, -1, 0), (0, 1, 1, 0), (0, -1, 1, 0), (0, 1, 0, -1))
_A2 = ((1, 1, 1, 0), (0, 1, -1, -1))
_B4 = (
    (4, 0, -5, 0, 1, 0),
    (0, -4, -4, 1, 1, 0),
    (0, 4, -4, -1, 1, 0),
    (0, -2, -1, 2, 1, 0),
    (0, 2, -1, -2, 1, 0),
    (0, 4, 0, -5, 0, 1),
)
_A4 = ((1, 1, 1, 1, 1, 0), (0, 1, -1, 2, -2, 0), (0, 1, 1, 4, 4, 0), (0, 1, -1, 8, -8, 1))
_A3 = ((1, 1, 1, 0), (0, 1, -1, 0), (0, 1, 1, -1))
_INPUT, _OUTPUT = {4: _B2, 6: _B4}, {2: _A2, 3: _A3, 4: _A4}

_FLOATS = ir.VectorType(ir.FloatType(), LANES)
_WORDS = ir.VectorType(ir.IntType(32), LANES)
_HALVES = ir.VectorType(ir.IntType(16), LANES)
_WIDE = ir.IntType(64)


def _vector(value: float) -> ir.Constant:
    return ir.Constant(_FLOATS, [value] * LANES)


def _splat(builder: Any, value: Any) -> Any:
    """A vector of one float32."""
    first = builder.insert_element(
        ir.Constant(_FLOATS, ir.Undefined), value, ir.Constant(ir.IntType(32), 0)
    )
    mask = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    return builder.shuffle_vector(first, ir.Constant(_FLOATS, ir.Undefined), mask)


class _Lanes:
    """Vectors of an array of float32, or of bfloat16 as uint16, by the number of the first."""

    def __init__(self, context: Any, builder: Any, kind: Any, array: Any) -> None:
        self.builder = builder
        self.half = kind.dtype == types.uint16
        self.data = context.make_array(kind)(context, builder, array).data

    def _place(self, at: Any) -> Any:
        kind = _HALVES if self.half else _FLOATS
        return self.builder.bitcast(self.builder.gep(self.data, [at]), kind.as_pointer())

    def load(self, at: Any) -> Any:
        builder = self.builder
        value = builder.load(self._place(at), align=2 if self.half else 4)
        if not self.half:
            return value
        words = builder.shl(builder.zext(value, _WORDS), ir.Constant(_WORDS, [16] * LANES))
        return builder.bitcast(words, _FLOATS)

    def store(self, at: Any, value: Any) -> None:
        builder = self.builder
        if self.half:  # to the nearest, away from zero on a tie
            words = builder.bitcast(value, _WORDS)
            words = builder.add(words, ir.Constant(_WORDS, [0x8000] * LANES))
            words = builder.lshr(words, ir.Constant(_WORDS, [16] * LANES))
            value = builder.trunc(words, _HALVES)
        builder.store(value, self._place(at), align=2 if self.half else 4)


def _product(builder: Any, matrix: Any, vectors: list[Any]) -> list[Any]:
    """A constant matrix times vectors; zeros and ones cost nothing."""
    results = []
    for row in matrix:
        total = None
        for factor, vector in zip(row, vectors, strict=True):
            if factor == 0:
                continue
            size = vector if abs(factor) == 1 else None
            if size is None:
                size = builder.fmul(vector, _vector(abs(factor)), flags=("contract",))
            if total is None:
                total = size if factor > 0 else builder.fneg(size)
            elif factor > 0:
                total = builder.fadd(total, size, flags=("contract",))
            else:
                total = builder.fsub(total, size, flags=("contract",))
        results.append(total)
    return results


def _both(builder: Any, matrix: Any, square: list[list[Any]]) -> list[list[Any]]:
    """`M X M^T` of a square of vectors."""
    rows = [_product(builder, matrix, row) for row in square]  # X M^T
    columns = [_product(builder, matrix, list(column)) for column in zip(*rows, strict=True)]
    return [list(row) for row in zip(*columns, strict=True)]


def _larger(builder: Any, value: Any, floor: Any) -> Any:
    return builder.select(builder.fcmp_ordered(">", value, floor), value, floor)


def _make_input(size: int, line: bool) -> Any:
    """Transform of 16 channels of an input tile."""

    @intrinsic
    def transform(
        typing: Any, x: Any, rows: Any, columns: Any, downs: Any, acrosses: Any,
        scale: Any, shift: Any, e: Any, out: Any, place: Any, step: Any,
    ) -> Any:  # fmt: skip
        def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            x, rows, columns, downs, acrosses, scale, shift, e, out, place, step = arguments
            kinds = signature.args
            source = _Lanes(context, builder, kinds[0], x)
            target = _Lanes(context, builder, kinds[8], out)
            square = []
            if line:
                slope = _Lanes(context, builder, kinds[5], scale).load(e)
                level = _Lanes(context, builder, kinds[6], shift).load(e)
            for i in range(size):
                row = []
                for j in range(size):
                    at = builder.add(
                        builder.extract_value(rows, i), builder.extract_value(columns, j)
                    )
                    value = source.load(builder.add(at, e))
                    if line:
                        value = builder.fmul(value, slope, flags=("contract",))
                        value = builder.fadd(value, level, flags=("contract",))
                        value = _larger(builder, value, _vector(0.0))
                    inside = builder.fmul(
                        builder.extract_value(downs, i), builder.extract_value(acrosses, j)
                    )
                    row.append(builder.fmul(value, _splat(builder, inside)))
                square.append(row)
            at = builder.add(place, e)
            for row in _both(builder, _INPUT[size], square):
                for value in row:
                    target.store(at, value)
                    at = builder.add(at, step)
            return context.get_dummy_value()

        return types.void(
            x, rows, columns, downs, acrosses, scale, shift, e, out, place, step
        ), code

    return transform


def _make_output(m: int, residual: bool) -> Any:
    """Transform back of 16 channels of an output tile."""
    size = len(_OUTPUT[m][0])

    @intrinsic
    def transform(
        typing: Any, products: Any, place: Any, step: Any, bias: Any, floor: Any, kept: Any,
        e: Any, out: Any, corner: Any, row_step: Any, column_step: Any,
    ) -> Any:  # fmt: skip
        def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            products, place, step, bias, floor, kept, e, out, corner, down, right = arguments
            kinds = signature.args
            source = _Lanes(context, builder, kinds[0], products)
            target = _Lanes(context, builder, kinds[7], out)
            beside = _Lanes(context, builder, kinds[5], kept)
            added = _Lanes(context, builder, kinds[3], bias).load(e)
            least = _splat(builder, floor)
            at = builder.add(place, e)
            square = []
            for _ in range(size):
                row = []
                for _ in range(size):
                    row.append(source.load(at))
                    at = builder.add(at, step)
                square.append(row)
            first = builder.add(corner, e)
            for row in _both(builder, _OUTPUT[m], square):
                at = first
                for value in row:
                    value = builder.fadd(value, added)
                    if residual:
                        value = builder.fadd(value, beside.load(at))
                    target.store(at, _larger(builder, value, least))
                    at = builder.add(at, right)
                first = builder.add(first, down)
            return context.get_dummy_value()

        return types.void(
            products, place, step, bias, floor, kept, e, out, corner, row_step, column_step
        ), code

    return transform


_input4, _input6 = _make_input(4, line=False), _make_input(6, line=False)
_line4, _line6 = _make_input(4, line=True), _make_input(6, line=True)
_output2, _output3, _output4 = (_make_output(m, residual=False) for m in (2, 3, 4))
_residual2, _residual4 = _make_output(2, residual=True), _make_output(4, residual=True)


@compiled
def _near(first: int, i: int, length: int, step: int) -> tuple[int, float]:
    """Offset of row `first + i` of `length`, inside; and 0 for one outside, else 1."""
    at = first + i
    inside = np.float32(1.0) if 0 <= at < length else np.float32(0.0)
    return min(max(at, 0), length - 1) * step, inside


@compiled
def _near4(first: int, length: int, step: int) -> tuple[Any, Any]:
    a, b = _near(first, 0, length, step), _near(first, 1, length, step)
    c, d = _near(first, 2, length, step), _near(first, 3, length, step)
    return (a[0], b[0], c[0], d[0]), (a[1], b[1], c[1], d[1])


@compiled
def _near6(first: int, length: int, step: int) -> tuple[Any, Any]:
    a, b = _near4(first, length, step)
    c, d = _near(first, 4, length, step), _near(first, 5, length, step)
    return (a[0], a[1], a[2], a[3], c[0], d[0]), (b[0], b[1], b[2], b[3], c[1], d[1])


@compiled
def transform4(
    x: np.ndarray,
    scale: np.ndarray,
    shift: np.ndarray,
    m: int,
    grid: tuple[int, int],
    first: int,
    count: int,
    out: np.ndarray,
) -> None:
    """`B^T d B` of tiles `first` to `first + count` of 4x4, for F(2, 3) and F(3, 2).

    Args:
        x: (b, h, w, C), C a multiple of 16; zeros lie around.
        scale: (C,) float32, of the line before the ReLU before the convolution; or of size 0.
        shift: (C,) float32.
        m: pixels from one tile to the next; the first begins one pixel outside.
        grid: tiles down and across a frame.
        first: number of a tile, counted along rows, then columns, then frames.
        count: number of tiles.
        out: (16, T, C), the first `count` of T written.
    """
    _, height, width, channels = x.shape
    step = out.shape[1] * channels
    for t in range(count):
        frame, rest = divmod(first + t, grid[0] * grid[1])
        row, column = divmod(rest, grid[1])
        base = frame * height * width * channels
        rows, downs = _near4(m * row - 1, height, width * channels)
        columns, acrosses = _near4(m * column - 1, width, channels)
        rows = (rows[0] + base, rows[1] + base, rows[2] + base, rows[3] + base)
        for e in range(0, channels, 16):
            if scale.size:
                _line4(x, rows, columns, downs, acrosses, scale, shift, e, out, t * channels, step)
            else:
                _input4(x, rows, columns, downs, acrosses, scale, shift, e, out, t * channels, step)


@compiled
def transform6(
    x: np.ndarray,
    scale: np.ndarray,
    shift: np.ndarray,
    m: int,
    grid: tuple[int, int],
    first: int,
    count: int,
    out: np.ndarray,
) -> None:
    """`B^T d B` as `transform4`, of tiles of 6x6, for F(4, 3): `out` is (36, T, C)."""
    _, height, width, channels = x.shape
    step = out.shape[1] * channels
    for t in range(count):
        frame, rest = divmod(first + t, grid[0] * grid[1])
        row, column = divmod(rest, grid[1])
        base = frame * height * width * channels
        rows, downs = _near6(m * row - 1, height, width * channels)
        columns, acrosses = _near6(m * column - 1, width, channels)
        a, b, c, d, f, g = rows
        rows = (a + base, b + base, c + base, d + base, f + base, g + base)
        for e in range(0, channels, 16):
            if scale.size:
                _line6(x, rows, columns, downs, acrosses, scale, shift, e, out, t * channels, step)
            else:
                _input6(x, rows, columns, downs, acrosses, scale, shift, e, out, t * channels, step)


@compiled
def restore(
    products: np.ndarray,
    bias: np.ndarray,
    floor: float,
    residual: np.ndarray,
    first: int,
    count: int,
    m: int,
    out: np.ndarray,
) -> None:
    """`A^T M A` of tiles, with bias, residual and ReLU.

    Args:
        products: (16 or 36, T, O).
        bias: (O,) float32.
        floor: float32; 0 for a ReLU, minus infinity for none.
        residual: (b, h, w, O), added before the ReLU; or of size 0.
        first: as in `transform4`.
        count: as in `transform4`.
        m: 2, 3 (without a residual) or 4.
        out: (b, h, w, O), h and w whole tiles; the tiles' pixels are written.
    """
    _, height, width, channels = out.shape
    across, each = width // m, (height // m) * (width // m)
    step, row_step = products.shape[1] * channels, width * channels
    for t in range(count):
        frame, rest = divmod(first + t, each)
        row, column = divmod(rest, across)
        corner = ((frame * height + row * m) * width + column * m) * channels
        place = t * channels
        for e in range(0, channels, 16):
            if m == 2 and residual.size:
                _residual2(
                    products, place, step, bias, floor, residual, e, out, corner, row_step, channels
                )
            elif m == 2:
                _output2(
                    products, place, step, bias, floor, residual, e, out, corner, row_step, channels
                )
            elif m == 3:
                _output3(
                    products, place, step, bias, floor, residual, e, out, corner, row_step, channels
                )
            elif residual.size:
                _residual4(
                    products, place, step, bias, floor, residual, e, out, corner, row_step, channels
                )
            else:
                _output4(
                    products, place, step, bias, floor, residual, e, out, corner, row_step, channels
                )
