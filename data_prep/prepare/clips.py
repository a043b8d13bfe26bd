"""Clips: where to cut a long video, whether a clip is worth keeping, and the files of one."""

import functools
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy.ndimage import uniform_filter1d

from data_prep.dataset import encode_frame, write_frames
from data_prep.media.audio import write_wav
from data_prep.media.writer import VideoWriter
from data_prep.prepare.source import IngestionConfig
from data_prep.prepare.spans import Take
from data_prep.rates import FPS, IMAGE_SIZE, SAMPLE_RATE, SAMPLES_PER_FRAME
from data_prep.speaker.tracking import jumps
from data_prep.speech.features import Speech, write_features
from data_prep.speech.words import Word, slice_words, write_words

SHORTEST = 4 * FPS
"""Frames of the shortest clip that is planned (ANGIE's clips have 4 to 14 s)."""

USUAL = 10 * FPS
"""Frames of a clip where the sound does not ask for another length."""

LONGEST = 14 * FPS
_SMOOTHING = FPS // 5
_FLOOR_DB = -80.0

FOLDERS = ("video", "frames", "audio", "features", "words")
"""Folders of a dataset that hold one file for each clip."""

COMMENT = "Clip of a dataset prepared by angie"

MIN_MOTION = 0.05
"""Mean grey level by which neighbouring frames differ, of 255; below it nothing moves."""

MAX_JUMP = 30.0
"""Mean grey level difference of two frames that only a cut or a flash makes."""

_SMALL = 64

_INSIDE = 0.9
"""Part of the sightings in which the whole face must be in the crop."""


def loudness(samples: np.ndarray, frames: int) -> np.ndarray:
    """Level of the sound over 0.2 s around the start of each frame, `(frames,)` in dB."""
    padded = np.zeros(frames * SAMPLES_PER_FRAME)
    count = min(len(samples), len(padded))
    padded[:count] = samples[:count]
    power = np.mean(padded.reshape(frames, SAMPLES_PER_FRAME) ** 2, axis=1)
    # The mean over an odd window is centred on a frame; a cut is at its start.
    smooth = uniform_filter1d(power, _SMOOTHING, mode="nearest")
    return np.maximum(10 * np.log10(np.maximum(smooth, 1e-12)), _FLOOR_DB)


def clip_bounds(
    samples: np.ndarray, frames: int, shortest: int = SHORTEST, longest: int = LONGEST
) -> list[tuple[int, int]]:
    """Cut a part of a video into clips that cover it without a gap.

    Each cut is where loudness, and distance from the usual length, are least.

    Args:
        samples: `(N,)` mono sound at 16 kHz from the first frame on.
        frames: of the part, at 25 a second.
        shortest: frames of the shortest clip.
        longest: frames of the longest clip; at least twice the shortest, or else the last may
            be shorter than that.

    Returns:
        first and one past the last frame of each clip. All have `shortest` to `longest`
        frames, unless the part itself is shorter.
    """
    level = loudness(samples, frames)
    usual = min(max(USUAL, shortest), longest)
    bounds: list[tuple[int, int]] = []
    start = 0
    while frames - start > longest:
        most = max(min(longest, frames - start - shortest), shortest)
        lengths = np.arange(shortest, most + 1)
        cost = level[start + lengths] / 10 + ((lengths - usual) / SHORTEST) ** 2
        stop = start + int(lengths[np.argmin(cost)])
        bounds.append((start, stop))
        start = stop
    bounds.append((start, frames))
    return bounds


@dataclass(frozen=True)
class Piece:
    """Frames and sound of a clip before it is written.

    Attributes:
        id: name of its files.
        first: number of its first frame in the video at 25 fps.
        frames: `(256, 256, 3)` uint8 RGB each.
        samples: `(640 T,)` float32 mono at 16 kHz.
    """

    id: str
    first: int
    frames: list[np.ndarray]
    samples: np.ndarray

    @functools.cached_property
    def changes(self) -> np.ndarray:
        """Mean grey level, of 255, by which each frame differs from the one before."""
        return _changes(self.frames)


def piece_of_sound(samples: np.ndarray, first: int, count: int) -> np.ndarray:
    """Samples under `count` frames from frame `first` on; silence where the sound is over."""
    part = samples[first * SAMPLES_PER_FRAME : (first + count) * SAMPLES_PER_FRAME]
    return np.pad(part, (0, count * SAMPLES_PER_FRAME - len(part)))


def _changes(frames: list[np.ndarray]) -> np.ndarray:
    """Mean grey level, of 255, by which each frame differs from the one before."""
    small = np.stack(
        [
            cv2.resize(
                cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY),
                (_SMALL, _SMALL),
                interpolation=cv2.INTER_AREA,
            )
            for frame in frames
        ]
    ).astype(np.float32)
    return np.asarray(np.abs(np.diff(small, axis=0)).mean(axis=(1, 2)))


def fault(piece: Piece, config: IngestionConfig) -> str | None:
    """Why a clip must be dropped by its pictures, or None."""
    if len(piece.frames) < config.fewest:
        return config.too_short
    change = piece.changes
    if change.mean() < MIN_MOTION:
        return "without motion"
    if change.max() > MAX_JUMP:
        return "a cut or flash inside"
    return None


def tracking_fault(take: Take, first: int, stop: int) -> str | None:
    """Why frames `[first, stop)` of a take must be dropped by where the face is, or None."""
    faces = [(frame, face) for frame, face in take.faces if first <= frame < stop]
    crop = take.span.crop
    if crop is None or not faces:
        return None
    if jumps(faces):
        return "a tracking jump inside"
    inside = [
        crop.x <= face.centre_x - face.w / 2
        and face.centre_x + face.w / 2 <= crop.x + crop.size
        and crop.y <= face.centre_y
        and face.centre_y + face.h / 2 <= crop.y + crop.size
        for _, face in faces
    ]
    return None if sum(inside) >= _INSIDE * len(inside) else "speaker leaves the crop"


def write_clip(folder: Path, piece: Piece, words: list[Word] | None) -> None:
    """Write all files of a clip into the folders of a dataset.

    Args:
        folder: the dataset; its `FOLDERS` exist.
        piece: the clip.
        words: of the whole video, with times from its first frame; None when unknown.
    """
    write_wav(folder / "audio" / f"{piece.id}.wav", piece.samples, SAMPLE_RATE)
    write_features(folder / "features" / f"{piece.id}.npz", Speech(piece.samples))
    write_frames(folder / "frames" / f"{piece.id}.safetensors", map(encode_frame, piece.frames))
    if words is not None:
        start = piece.first / FPS
        inside = slice_words(words, start, start + len(piece.frames) / FPS)
        write_words(folder / "words" / f"{piece.id}.json", inside)
    video = VideoWriter(
        folder / "video" / f"{piece.id}.mp4",
        (IMAGE_SIZE, IMAGE_SIZE),
        FPS,
        sound=(piece.samples, SAMPLE_RATE),
        comment=COMMENT,
        threads=1,
    )
    with video:
        for frame in piece.frames:
            video.write(frame)
