"""The C library's allocator, told to keep the memory of large tensors between steps."""

import ctypes
import ctypes.util
import sys

_TRIM_THRESHOLD, _TOP_PAD, _MMAP_THRESHOLD = -1, -2, -3  # glibc's malloc.h


def keep_memory(threshold: int = 1 << 30, pad: int = 256 << 20) -> bool:
    """Make glibc reuse freed memory in place of returning it to the system.

    Activations of a training step are large; by default each is mapped and unmapped anew, and
    the system clears its pages every time. Does nothing where the C library is not glibc.

    Args:
        threshold: bytes below which memory is kept.
        pad: bytes that are taken from the system at a time.

    Returns:
        Whether the settings were taken.
    """
    if sys.platform != "linux":
        return False
    library = ctypes.CDLL(None)
    if not hasattr(library, "gnu_get_libc_version") or not hasattr(library, "mallopt"):
        return False
    settings = ((_MMAP_THRESHOLD, threshold), (_TRIM_THRESHOLD, threshold), (_TOP_PAD, pad))
    return all(library.mallopt(name, value) == 1 for name, value in settings)
