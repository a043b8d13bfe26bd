"""Ways in which a file can be wrong, by chance: bytes, texts, arrays and what a path leads to."""

import io
import json
import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

MARK = "payload-was-here"
"""Folder that a pickle would make if it were loaded."""

_NUMBERS = (0, 1, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 2**63 - 1)
_VALUES: tuple[Any, ...] = (
    None, True, -1, 0, 1e308, float("nan"), float("inf"), 2**70, "", "x" * 5000, "../../outside",
    "/etc/passwd", "a\0b", "\ud800", [], {}, [[]] * 3, {"a": {"b": None}},
)  # fmt: skip


class Payload:
    """Makes a folder when it is unpickled."""

    def __init__(self, place: Path) -> None:
        self.place = place

    def __reduce__(self) -> tuple[Any, ...]:
        """What the unpickler would call."""
        return os.mkdir, (str(self.place),)


def of_bytes(data: bytes, rng: np.random.Generator) -> bytes:
    """Truncated, flipped, cut out, doubled, zeroed, or with a number that claims much."""
    out = bytearray(data)
    size = max(len(out), 1)
    at = int(rng.integers(size))
    match int(rng.integers(8)):
        case 0:
            return data[:at]
        case 1:
            for place in rng.integers(size, size=int(rng.integers(1, 20))):
                out[place] ^= 1 << int(rng.integers(8))
        case 2:
            head = min(size, 512)  # where headers are
            for place in rng.integers(head, size=int(rng.integers(1, 8))):
                out[place] = int(rng.integers(256))
        case 3:
            del out[at : at + int(rng.integers(1, 200))]
        case 4:
            out[at:at] = out[at : at + int(rng.integers(1, 2000))]
        case 5:
            length = int(rng.integers(1, 2000))
            out[at : at + length] = bytes(len(out[at : at + length]))
        case 6:
            number, width = int(rng.choice(_NUMBERS[:9])), int(rng.choice([1, 2, 4, 8]))
            order = "little" if rng.integers(2) else "big"
            at = int(rng.integers(min(size, 2000)))
            out[at : at + width] = (number % (1 << 8 * width)).to_bytes(width, order)  # type: ignore[arg-type]
        case _:
            out += rng.integers(256, size=int(rng.integers(1, 3000)), dtype=np.uint8).tobytes()
    return bytes(out)


def of_json(data: bytes, rng: np.random.Generator) -> bytes:
    """A leaf or branch of it replaced, removed, or under another name."""
    tree = json.loads(data)
    spots: list[tuple[Any, Any]] = []

    def walk(node: Any) -> None:
        for key in list(node if isinstance(node, dict) else range(len(node))):
            spots.append((node, key))
            if isinstance(node[key], dict | list):
                walk(node[key])

    if isinstance(tree, dict | list):
        walk(tree)
    for _ in range(int(rng.integers(1, 4))):
        node, key = spots[int(rng.integers(len(spots)))] if spots else ([0], 0)
        if (
            isinstance(node, dict)
            and key not in node
            or isinstance(node, list)
            and key >= len(node)
        ):
            continue
        if rng.integers(5) == 0:
            del node[key]
        else:
            node[key] = _VALUES[int(rng.integers(len(_VALUES)))]
    return json.dumps(tree).encode("utf-8", "surrogatepass")


def of_text(data: bytes, rng: np.random.Generator) -> bytes:
    """Words of it replaced by odd ones, lines lost or doubled."""
    lines = data.decode("utf-8", "replace").split("\n")
    for _ in range(int(rng.integers(1, 4))):
        at = int(rng.integers(len(lines)))
        words = lines[at].split(",") if "," in lines[at] else lines[at].split(" ")
        value = _VALUES[int(rng.integers(len(_VALUES)))]
        words[int(rng.integers(len(words)))] = str(value)
        mark = "," if "," in lines[at] else " "
        lines[at] = mark.join(words)
        if rng.integers(4) == 0:
            lines[at:at] = [lines[at]] * int(rng.integers(1, 50))
        elif rng.integers(4) == 0:
            del lines[at]
        lines = lines or [""]
    return "\n".join(lines).encode("utf-8", "surrogatepass")


def of_arrays(data: bytes, rng: np.random.Generator) -> bytes:
    """An .npz whose arrays have other numbers, types, shapes or names, or claim more."""
    with np.load(io.BytesIO(data), allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    name = str(rng.choice(list(arrays)))
    values = arrays[name]
    match int(rng.integers(8)):
        case 0 if values.dtype.kind == "f" and values.size:
            values = values.copy()
            values.flat[int(rng.integers(values.size))] = rng.choice([np.nan, np.inf, -1e38, 1e300])
        case 1:
            kind = str(rng.choice(["S3", "U2", "?", "c16", "i1", "f2"]))
            values = np.ones(values.shape, kind)
        case 2:
            values = values[..., None]
        case 3:
            values = values[:0] if values.ndim else values[None]
        case 4:
            values = np.array([Payload(Path(MARK))], object)
        case 5:
            arrays["other"] = values
            values = np.zeros(3)
        case 6:
            return _claiming(data, rng)
        case _:
            del arrays[name]
            arrays["../" + name] = values
            name = "x"
    arrays[name] = values
    out = io.BytesIO()
    np.savez(out, allow_pickle=True, **arrays)
    return out.getvalue()


def _claiming(data: bytes, rng: np.random.Generator) -> bytes:
    """A shape in a header that claims a million times as much."""
    at = data.find(b"'shape': (")
    out = bytearray(data)
    if at >= 0:
        number = b"9999999999" if rng.integers(2) else b"-1        "
        out[at + 10 : at + 10 + len(number)] = number
    return bytes(out)


def of_safetensors(data: bytes, rng: np.random.Generator) -> bytes:
    """Its header changed as JSON, with a right or a wrong length."""
    size = int.from_bytes(data[:8], "little")
    header = of_json(data[8 : 8 + size], rng)
    length = len(header) if rng.integers(4) else int(rng.choice(_NUMBERS))
    return length.to_bytes(8, "little") + header + data[8 + size :]


def of_place(path: Path, rng: np.random.Generator) -> None:
    """Another thing under the file's name: nothing, a folder, a pipe, a link, a pickle."""
    path.unlink()
    match int(rng.integers(9)):
        case 0:
            path.touch()
        case 1:
            path.mkdir()
        case 2:
            os.mkfifo(path)
        case 3:
            path.symlink_to(path.name)
        case 4:
            path.symlink_to("/dev/zero")
        case 5:
            path.symlink_to("missing")
        case 6:
            path.write_bytes(b"<!doctype html><html></html>")
        case 7:
            pass
        case _:
            path.write_bytes(pickle.dumps(Payload(path.parent / MARK), int(rng.integers(6))))


BY_ENDING: dict[str, Callable[[bytes, np.random.Generator], bytes]] = {
    ".json": of_json,
    ".npz": of_arrays,
    ".safetensors": of_safetensors,
    **dict.fromkeys((".csv", ".srt", ".vtt", ".ctm", ".txt", ".TextGrid", ".yaml"), of_text),
}
"""What knows how files of an ending are made."""


def spoil(path: Path, rng: np.random.Generator) -> str:
    """Make a file wrong in one of these ways; which, in words."""
    way = int(rng.integers(12))
    if way == 0:
        of_place(path, rng)
        return "another thing under the name"
    data = path.read_bytes()
    knows = BY_ENDING.get(path.suffix)
    if knows is not None and way < 8:
        path.write_bytes(knows(data, rng))
        return knows.__name__
    for _ in range(int(rng.integers(1, 3))):
        data = of_bytes(data, rng)
    path.write_bytes(data)
    return "bytes"
