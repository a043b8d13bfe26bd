"""The renderer: unsupervised region motion (MRAA) and the image generator."""
