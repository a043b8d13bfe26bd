"""Types that a device computes in natively, and which one a name means there."""

import torch

PRECISIONS = {"fp32": torch.float32, "bf16": torch.bfloat16, "fp16": torch.float16}
"""Types of the convolutions, by name."""


def native_bf16(device: torch.device) -> bool:
    """Whether a device multiplies bfloat16 itself, in place of emulating it."""
    if device.type == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    if device.type == "cpu":
        names = ("_is_avx512_bf16_supported", "_is_amx_tile_supported")  # torch 2.6 and newer
        return any(getattr(torch.cpu, name, bool)() for name in names)
    return False


def choose_precision(name: str, device: torch.device) -> torch.dtype:
    """Type of the convolutions for "auto", "fp32", "bf16" or "fp16" on a device.

    Raises:
        ValueError: an unknown name, or a type that the device has not.
    """
    if name == "auto":
        if native_bf16(device):
            return torch.bfloat16
        return torch.float16 if device.type == "cuda" else torch.float32
    if name not in PRECISIONS:
        raise ValueError(f"there are auto, {', '.join(PRECISIONS)}")
    if name == "bf16" and not native_bf16(device):
        raise ValueError(f"this {device.type} has no bfloat16 of its own; take auto or fp32")
    if name == "fp16" and device.type == "cpu":
        raise ValueError("float16 is for GPUs; take auto or fp32")
    return PRECISIONS[name]
