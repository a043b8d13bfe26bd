"""What is said of the motion parts in the bundle: how well they do on held-out clips."""

from typing import Any

import torch
from torch import Tensor

from angie.gpt import CoSpeechGPT
from angie.hearing import hearing
from angie.patterns import decoding_errors, encode_clips, encode_windows, reconstruction
from angie.quantisation import Channels
from angie.train_gpt import code_windows
from angie.vq import VQMotionExtractor
from angie.windows import MotionWindows

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
    gpt: CoSpeechGPT,
    vq: VQMotionExtractor,
    windows: MotionWindows,
    held_out: MotionWindows | None,
) -> dict[str, Any]:
    """Cross-entropy on held-out windows, against other sound's and an order-2 model's."""
    if held_out is None:
        return {}
    heard = hearing(gpt, code_windows(vq, windows), code_windows(vq, held_out))
    return {} if heard is None else {"hearing": heard.as_dict()}


def _rounded(scores: dict[str, float]) -> dict[str, float]:
    return {name: round(value, 4) for name, value in scores.items()}
