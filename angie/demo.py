"""What ships with the package: a speaker bundle, a photo and a recording of our own."""

from pathlib import Path

DEFAULT = Path(__file__).parent / "default"
"""Folder of the shipped files; all of it was drawn, spoken and trained by this project."""

BUNDLE = DEFAULT / "bundle"
"""Speaker bundle trained on the phantom speaker."""

PHOTO = DEFAULT / "photo.png"
"""A phantom presenter at rest."""

SPEECH = DEFAULT / "speech.flac"
"""Speech of the built-in synthesiser."""
