"""Clips as the motion stages see them: region motion and speech features."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from data_prep.dataset import Dataset
from data_prep.errors import BadInput
from data_prep.rates import FPS, SAMPLES_PER_FRAME
from data_prep.speech.features import Speech
from data_prep.speech.words import slice_words
from mraa.motion import Motion, read_motion


@dataclass(frozen=True)
class MotionClip:
    """A clip as the motion stages see it.

    Attributes:
        name: the clip's id.
        speaker: the speaker's name.
        motion: shift (T, K, 2), cholesky (T, K, 3).
        speech: its sound, words and features.
        person: who is seen, where that is another name; else empty.
    """

    name: str
    speaker: str
    motion: Motion
    speech: Speech
    person: str = ""

    def __post_init__(self) -> None:
        if self.motion.frames > self.speech.frames:
            raise BadInput(
                f"{self.name}: {self.motion.frames} frames of motion but {self.speech.frames} of "
                "sound; "
                "prepare the dataset again"
            )


def begun_later(
    clip: MotionClip, samples: NDArray, frames: int, sound: str = "onset"
) -> MotionClip:
    """A clip without its first frames; tokens are counted from where it begins now.

    Unless `frames` is a multiple of 8, the same motion and sound give other codes and onset rows.

    Args:
        clip: longer than `frames`.
        samples: (N,) float32, its sound at 16 kHz.
        frames: left out.
        sound: name of the feature of its tokens, which is computed.
    """
    times = clip.speech["onset_times"] - np.float32(frames / FPS)
    words = clip.speech.words
    speech = Speech(
        samples[frames * SAMPLES_PER_FRAME :],
        None if words is None else slice_words(list(words), frames / FPS, math.inf),
        features={"mfcc": clip.speech["mfcc"][frames:], "onset_times": times[times >= 0]},
    )
    speech[sound]
    speech.forget_samples()  # those of all clips would fill the memory
    name, motion = f"{clip.name}+{frames}", clip.motion[frames:]
    return MotionClip(name, clip.speaker, motion, speech, clip.person)


def read_clips(
    data: Dataset, folder: Path, split: str, estimator: str | None = None
) -> list[MotionClip]:
    """Read motion and features of all clips of a split.

    `folder`: folder of the motion files, `<clip id>.npz`. `estimator`: hash of the region estimator
    that must have measured the motion.

    Raises:
        BadInput: a clip without motion, or measured by another region estimator.
    """
    return [
        MotionClip(
            name=clip.id,
            speaker=clip.speaker,
            motion=read_motion(Path(folder) / f"{clip.id}.npz", estimator),
            speech=data.speech(clip),
            person=clip.person,
        )
        for clip in data.clips(split=split)
    ]
