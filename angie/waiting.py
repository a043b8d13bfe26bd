"""How threads of a parallel loop wait for the next one; for the environment, before torch comes."""

WAITING = {"OMP_WAIT_POLICY": "PASSIVE", "GOMP_SPINCOUNT": "10000"}
"""Variables of GNU OpenMP. Spinning threads starve a shared machine, so they sleep; but not before
some 100 microseconds: from one product of the GPT to the next they stay awake, which takes a
quarter off its time."""
