"""The fast render session: folded networks and compiled kernels."""

import os


def enabled() -> bool:
    """Whether compiled kernels are used: always, unless ANGIE_KERNELS=0 is set.

    Without them PyTorch does all of the work, slower, and numba is not imported.
    """
    return os.environ.get("ANGIE_KERNELS", "1") != "0"
