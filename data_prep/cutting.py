"""Where to cut a long video into clips: at the quietest moments of its sound."""

import numpy as np
from scipy.ndimage import uniform_filter1d

from data_prep.rates import FPS, SAMPLES_PER_FRAME

SHORTEST = 4 * FPS
"""Frames of the shortest clip that is planned (ANGIE's clips have 4 to 14 s)."""

USUAL = 10 * FPS
"""Frames of a clip where the sound does not ask for another length."""

LONGEST = 14 * FPS

MIN_FRAMES = 97
"""A clip with fewer frames gives no window of 96 frame-to-frame differences."""

_SMOOTHING = FPS // 5
_FLOOR_DB = -80.0


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
