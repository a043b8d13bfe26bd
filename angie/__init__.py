"""Speech and a photo to a gesture video: motion, generators, bundles and the `angie` command."""

__version__ = "0.1.0"
