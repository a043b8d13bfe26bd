"""Gesture generators: speech and a start pose in, region motion out."""
