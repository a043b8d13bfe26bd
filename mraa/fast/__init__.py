"""The fast render session: folded networks and compiled kernels."""
