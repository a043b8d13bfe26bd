"""What is said of ANGIE's parts in the bundle: how well they do on held-out clips.

How much the GPT depends on the sound: its cross-entropy against that with other sound, and
against an order-2 model's.
"""

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from angie.generators.angie.channels import Channels
from angie.generators.angie.codes import (
    decoding_errors,
    encode_clips,
    encode_windows,
    reconstruction,
)
from angie.generators.angie.generate import AngieGenerator
from angie.generators.angie.gpt import CoSpeechGPT
from angie.generators.angie.tokenizer import VQMotionExtractor
from angie.generators.angie.train import code_windows, stream_entropies
from angie.generators.base import GestureGenerator
from angie.motion.clips import MotionClip
from angie.motion.windows import MotionWindows

WEIGHTS = (0.3, 1.0, 3.0, 10.0, 30.0, 100.0)
"""Weights of the shorter context that the order-2 model may take; the best one counts."""


@dataclass(frozen=True)
class AudioSensitivity:
    """Cross-entropy of held-out codes in nats per code, each a value a stream.

    Attributes:
        right: with the sound that belongs to the motion.
        mismatched: with the sound of another clip.
        order2: of a model of the codes alone that sees the two before.
    """

    right: list[float]
    mismatched: list[float]
    order2: list[float]

    def as_dict(self) -> dict[str, list[float]]:
        """For reports, rounded."""
        return {name: [round(v, 4) for v in values] for name, values in asdict(self).items()}


def audio_sensitivity(
    gpt: CoSpeechGPT, windows: MotionWindows, held_out: MotionWindows
) -> AudioSensitivity | None:
    """Measure on held-out windows with `onset` and `codes`.

    The mismatched sound of a window is that of the same speaker's window half of their windows
    away, so that another voice does not give it away; where that is of the same clip the window
    does not count, and without any left there is no result.
    """
    other = far_windows(held_out)
    apart = [i for i, far in enumerate(other) if held_out.places[i][0] != held_out.places[far][0]]
    if not apart:
        return None
    onset = held_out.stack("onset", 0, len(held_out))
    counted = held_out.chosen(apart)
    codes = counted.rows["codes"].numpy()
    train = windows.rows["codes"].numpy()
    sizes = gpt.config
    order2 = [
        order2_entropy(train[:, stream], codes[:, stream], sizes.codes)
        for stream in range(sizes.streams)
    ]
    swapped = onset[torch.tensor([other[i] for i in apart])]
    return AudioSensitivity(
        stream_entropies(gpt, counted).tolist(),
        stream_entropies(gpt, counted, swapped).tolist(),
        order2,
    )


def far_windows(windows: MotionWindows) -> list[int]:
    """For each window the place of its speaker's window half of the speaker's windows away."""
    speakers = [windows.clips[index].speaker for index, _ in windows.places]
    far = [0] * len(windows)
    for name in set(speakers):
        own = [place for place, speaker in enumerate(speakers) if speaker == name]
        for i, place in enumerate(own):
            far[place] = own[(i + len(own) // 2) % len(own)]
    return far


def order2_entropy(train: NDArray, test: NDArray, size: int) -> float:
    """Cross-entropy in nats per code of an order-2 model of code sequences.

    Codes 2 and later of each window are predicted from the two before (the second one from
    one). Counts of each context are filled up by `weight` times the distribution of the next
    shorter one, down to the uniform one; the weight is the best for the test codes, which favours
    this baseline.

    Args:
        train: (n, S) codes.
        test: (m, S) codes.
        size: V.
    """
    counts: list[dict[tuple[int, ...], Counter[int]]] = [defaultdict(Counter) for _ in range(3)]
    for row in train.tolist():
        for place, code in enumerate(row):
            for order in range(min(2, place) + 1):
                counts[order][tuple(row[place - order : place])][code] += 1

    def probability(row: list[int], place: int, weight: float) -> float:
        value = 1 / size
        for order in range(min(2, place) + 1):
            seen = counts[order].get(tuple(row[place - order : place]), Counter())
            total = sum(seen.values())
            value = (seen[row[place]] + weight * value) / (total + weight)
        return value

    rows = test.tolist()
    return min(
        float(-np.mean([np.log(probability(r, p, weight)) for r in rows for p in range(1, len(r))]))
        for weight in WEIGHTS
    )


PAIRS = 24
"""Pairs of codes named in the report, the most frequent ones."""


def vq_report(
    vq: VQMotionExtractor, windows: MotionWindows, held_out: MotionWindows | None
) -> dict[str, Any]:
    """Reconstruction and use of the codes, on training and held-out windows.

    `context` is that of the rest but `training` and `held_out`, which are of windows by
    themselves. `decoding` is the error of decoding long clips in one pass and in windows, on
    held-out clips where there are any; `pairs` are the most frequent pairs of codes with their
    counts.
    """
    report: dict[str, Any] = {"training": _rounded(reconstruction(vq, windows))}
    report["context"] = vq.config.context
    if held_out is not None:
        report["held_out"] = _rounded(reconstruction(vq, held_out))
    channels = Channels.of(windows.statistics, vq.config.quant)
    clips = (held_out or windows).clips
    report["decoding"] = _rounded(decoding_errors(vq, clips, channels))
    codes = _all_codes(vq, windows)
    pairs, counts = codes.unique(dim=0, return_counts=True)
    order = torch.argsort(counts, descending=True, stable=True)[:PAIRS]
    report["pairs"] = [[*pairs[i].tolist(), int(counts[i])] for i in order.tolist()]
    return report


def _all_codes(vq: VQMotionExtractor, windows: MotionWindows) -> Tensor:
    """Codes (n, streams) of windows, or of their clips, in the context that `vq` is used in."""
    if vq.config.context == "window":
        return encode_windows(vq, windows).transpose(1, 2).flatten(0, 1)
    return torch.cat(list(encode_clips(vq, windows).values()), dim=1).T


def gpt_report(
    gpt: CoSpeechGPT, vq: VQMotionExtractor, windows: MotionWindows, held_out: MotionWindows | None
) -> dict[str, Any]:
    """Cross-entropy on held-out windows, against other sound's and an order-2 model's."""
    if held_out is None:
        return {}
    found = audio_sensitivity(gpt, code_windows(vq, windows), code_windows(vq, held_out))
    return {} if found is None else {"audio_sensitivity": found.as_dict()}


def _rounded(scores: dict[str, float]) -> dict[str, float]:
    return {name: round(value, 4) for name, value in scores.items()}


def in_words(stage: str, report: dict[str, Any], settings: Any) -> list[str]:
    """What `angie info` says of a part: how well codes give motion back, how sound counts."""
    words = []
    if "held_out" in report:
        score = report["held_out"]
        words.append(
            f"held-out shifts correlate {score['correlation']:.3f}, "
            f"perplexity {score['shift_perplexity']:.0f} of {settings.vq.codes} codes"
        )
    if "audio_sensitivity" in report:
        scores = report["audio_sensitivity"]
        right, other = (sum(scores[name]) for name in ("right", "mismatched"))
        words.append(f"held-out cross-entropy {right:.2f} nats, {other:.2f} with other sound")
    return words


@torch.no_grad()
def broken_share(generator: GestureGenerator, clips: Sequence[MotionClip]) -> float:
    """Share of the frames of clips, through their own codes, that cannot be drawn.

    Summed changes of C, and codes of C and of its root, need not be positive definite; Cholesky
    factors always are. See `Channels.broken`.
    """
    assert isinstance(generator, AngieGenerator)
    broken, frames = 0, 0
    for clip in clips:
        codes = generator.codes_of(clip.motion)
        if codes is not None and isinstance(generator.vq, VQMotionExtractor):
            values = generator.vq.decode_whole(codes)[: clip.motion.frames]
            found = generator.channels.broken(values, clip.motion[:1].vector()[0])
            broken += int(found.sum())
        frames += clip.motion.frames
    return broken / max(frames, 1)
