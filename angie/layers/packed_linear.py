"""Linear layers for a few rows at a time on a CPU: weights laid out once for oneDNN.

A GPT that makes one token after another multiplies large matrices by 3 to 33 rows. PyTorch's
`nn.Linear` in float32 then runs at a fraction of what memory and cores can do; the same product
through oneDNN with weights in its own layout takes a third to a half of the time. With 33 rows it
runs at the float32 rate of the cores, which only bfloat16 products, summed in float32, exceed.
"""

import torch
from torch import Tensor, nn

from mraa.fast import enabled
from mraa.training.devices import native_bf16

ROWS = 33
"""Rows that the layout is chosen for."""

LEAST = 512
"""Inputs and outputs below which a layer is left as it is: it gains nothing."""


def product_type(precision: str) -> torch.dtype:
    """bfloat16 for "auto" and "bf16" where the CPU has it natively, else float32 ("fp16" too)."""
    half = precision in ("auto", "bf16") and native_bf16(torch.device("cpu"))
    return torch.bfloat16 if half else torch.float32


class PackedLinear(nn.Module):
    """`nn.Linear` (then GELU if asked) in oneDNN's layout; CPU, no gradient.

    Args:
        linear: the layer to take over.
        gelu: apply GELU to the result.
        dtype: float32, or bfloat16: of weights, input and result of the product.
    """

    def __init__(
        self, linear: nn.Linear, *, gelu: bool = False, dtype: torch.dtype = torch.float32
    ) -> None:
        super().__init__()
        self.dtype = dtype
        weight = linear.weight.detach().to(dtype)
        self.weight = torch.ops.mkldnn._reorder_linear_weight(weight, ROWS)
        self.bias = None if linear.bias is None else linear.bias.detach().to(dtype)
        self.after = ("gelu", "none") if gelu else ("none", "")

    def forward(self, values: Tensor) -> Tensor:
        """(..., in) to (..., out), float32."""
        made = torch.ops.mkldnn._linear_pointwise(
            values.to(self.dtype), self.weight, self.bias, self.after[0], [], self.after[1]
        )
        return made.float()


def can_pack(dtype: torch.dtype = torch.float32) -> bool:
    """Whether this build of PyTorch has what `PackedLinear` calls, and it computes."""
    if not enabled() or not torch.backends.mkldnn.is_available():
        return False
    try:
        layer = PackedLinear(nn.Linear(16, 16), gelu=True, dtype=dtype)
        return layer(torch.zeros(1, 3, 16)).shape == (1, 3, 16)
    except (AttributeError, RuntimeError, NotImplementedError, TypeError):
        return False  # a build without these operators; nn.Linear stays


def packable(dtype: torch.dtype) -> torch.dtype | None:
    """What products wanted in `dtype` are packed in: that, else float32; None if neither can be."""
    return next((kind for kind in (dtype, torch.float32) if can_pack(kind)), None)


def pack(model: nn.Module, dtype: torch.dtype = torch.float32) -> nn.Module:
    """Replace the large linear layers of a float32 model on the CPU, each with a GELU after it.

    The model then computes the same (to rounding of `dtype`) without gradients, and its state can
    no longer be saved. Where PyTorch cannot do it in `dtype`, float32 is taken; where it cannot do
    that either, or the model lies elsewhere, the model is left alone.

    Args:
        model: with float32 weights; it is changed.
        dtype: of the products, float32 or bfloat16; all else stays float32.
    """
    first = next(model.parameters(), None)
    if first is None or first.device.type != "cpu" or first.dtype != torch.float32:
        return model
    kind = packable(dtype)
    if kind is not None:
        _pack(model, kind)
    return model


def _pack(model: nn.Module, dtype: torch.dtype) -> None:
    children = list(model.named_children())
    for place, (name, child) in enumerate(children):
        if not isinstance(child, nn.Linear):
            _pack(child, dtype)
        elif min(child.in_features, child.out_features) >= LEAST:
            follower = children[place + 1] if place + 1 < len(children) else ("", None)
            gelu = isinstance(model, nn.Sequential) and isinstance(follower[1], nn.GELU)
            gelu = gelu and getattr(follower[1], "approximate", "") == "none"
            setattr(model, name, PackedLinear(child, gelu=gelu, dtype=dtype))
            if gelu:
                setattr(model, follower[0], nn.Identity())
