"""Listening to a recording: a task for a process of its own, which loads what it needs."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from data_prep.errors import collected_notes

if TYPE_CHECKING:
    from data_prep.speech.features import Speech


def hear(task: tuple[Path, Sequence[str]]) -> tuple["Speech", list[str]]:
    """The features that a recording (its file) is read for, without its samples.

    In a process of its own, librosa is imported beside the networks' libraries, not after them.

    Returns:
        the speech, and notes of what was odd about the file.
    """
    from data_prep.media.audio import read_sound
    from data_prep.speech.features import Speech

    audio, names = task
    with collected_notes() as notes:
        speech = Speech(read_sound(audio))
        for name in names:
            speech[name]
    speech.forget_samples()
    return speech, notes
