"""TriCon (TOG 2020): gestures from words, sound and identity, with a discriminator."""
