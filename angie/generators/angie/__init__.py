"""ANGIE (NeurIPS 2022): codes from a GPT, deltas from VQ decoders, a refiner."""
