"""Motion windows to codes and to pattern motion, and how much of the motion patterns keep."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager

import torch
from torch import Tensor, nn

from angie.generators.angie.channels import Channels
from angie.generators.angie.gpt import CoSpeechGPT
from angie.generators.angie.tokenizer import DirectMotion, VQMotionExtractor
from angie.motion.clips import MotionClip
from angie.motion.drift import activity
from angie.motion.windows import WINDOW, MotionWindows
from data_prep.rates import FRAMES_PER_TOKEN

STREAMS = ("shift", "cholesky", "affine")
"""Names of the streams in curves and reports."""


@contextmanager
def evaluating(model: nn.Module) -> Iterator[None]:
    """A model in evaluation mode and without gradients, and afterwards as it was."""
    training = model.training
    model.eval()
    with torch.no_grad():
        yield
    model.train(training)


@torch.no_grad()
def encode_windows(vq: VQMotionExtractor, windows: MotionWindows) -> Tensor:
    """Codes (n, streams, 12) on the CPU of all windows."""
    channels = Channels.of(windows.statistics, vq.config.quant)
    values = (channels.normalise(group["poses"]) for group in windows.groups("poses"))
    return torch.cat([vq.encode(value.to(vq.mean.device)).cpu() for value in values])


@torch.no_grad()
def encode_whole(vq: VQMotionExtractor, poses: Tensor, channels: Channels) -> Tensor:
    """Codes (streams, S) on the CPU of motion (T, 5K) of any length, in one pass.

    Motion that ends inside a token is continued with stillness.
    """
    missing = -len(poses) % FRAMES_PER_TOKEN
    poses = torch.cat([poses[:1], poses, poses[-1:].expand(missing, -1)])
    return vq.encode(channels.normalise(poses)[None].to(vq.mean.device))[0].cpu()


def encode_clips(vq: VQMotionExtractor, windows: MotionWindows) -> dict[int, Tensor]:
    """Codes (streams, S) of the clips that windows are of, by the clips' places."""
    channels = Channels.of(windows.statistics, vq.config.quant)
    places = sorted({index for index, _ in windows.places})
    return {i: encode_whole(vq, windows.clips[i].motion.vector(), channels) for i in places}


def window_codes(vq: VQMotionExtractor, windows: MotionWindows) -> Tensor:
    """Codes (n, streams, 12) on the CPU of windows, in the context that `vq` is used in.

    Raises:
        ValueError: codes of clips, and windows that do not begin on tokens.
    """
    if vq.config.context == "window":
        return encode_windows(vq, windows)
    if any(first % FRAMES_PER_TOKEN for _, first in windows.places):
        raise ValueError("codes of clips are of windows that begin on tokens")
    codes, size = encode_clips(vq, windows), windows.frames // FRAMES_PER_TOKEN
    tokens = [(index, first // FRAMES_PER_TOKEN) for index, first in windows.places]
    return torch.stack([codes[index][:, at : at + size] for index, at in tokens])


@torch.no_grad()
def continued_codes(
    gpt: CoSpeechGPT, vq: VQMotionExtractor, windows: MotionWindows, at_once: int = 64
) -> Tensor:
    """Codes (n, streams, 12) on the CPU: the first true ones, continued by the likeliest ones."""
    heard, device = windows.choose(["onset", "speaker"]), gpt.positions.device
    made = []
    for first, true in enumerate(window_codes(vq, windows).split(at_once)):
        onset, who = (
            heard.stack(part, first * at_once, (first + 1) * at_once).to(device)
            for part in ("onset", "speaker")
        )
        codes = true[..., :1].to(device)
        for step in range(1, true.shape[-1]):
            logits = gpt(codes, onset[:, 1 : step + 1], who)[:, :, -1]
            codes = torch.cat([codes, logits.argmax(-1, keepdim=True)], dim=-1)
        made.append(codes.cpu())
    return torch.cat(made)


@torch.no_grad()
def decode_windows(vq: VQMotionExtractor, codes: Tensor, at_once: int = 64) -> Tensor:
    """Normalised deltas (n, T, 5K) on the CPU of codes (n, streams, S)."""
    parts = [vq.decode(group.to(vq.mean.device)).float().cpu() for group in codes.split(at_once)]
    return torch.cat(parts)


@torch.no_grad()
def patterns(model: VQMotionExtractor | DirectMotion, windows: MotionWindows) -> Tensor:
    """Normalised pattern motion (n, T, 5K) on the CPU of all windows.

    Of the codes of the true motion, in the context that `model` is used in, those of clips
    decoded in windows that blend linearly; of the sound, for a model without codes.
    """
    if isinstance(model, VQMotionExtractor) and model.config.context == "window":
        return decode_windows(model, encode_windows(model, windows))
    if isinstance(model, VQMotionExtractor):
        codes = encode_clips(model, windows)
        clips = {i: model.decode_chunked(one.to(model.mean.device)) for i, one in codes.items()}
        return torch.stack([clips[i][at : at + windows.frames] for i, at in windows.places])
    parts = []
    for group in windows.groups("onset", "speaker"):
        onset, who = (part.to(model.mean.device) for part in group.values())
        parts.append(model(onset, who).float().cpu())
    return torch.cat(parts)


def mean_for_activity(decoded: Iterable[Tensor]) -> Tensor:
    """Sum (C,) of deltas (n, T, C), normalised, divided by the sum of their activities."""
    total, moved = torch.zeros(()), 0.0
    for part in decoded:
        total = total + part.double().sum(dim=(0, 1))
        moved += float(activity(part.double()).sum())
    return total / max(moved, 1e-12)


def reconstruction(vq: VQMotionExtractor, windows: MotionWindows) -> dict[str, float]:
    """How well codes of windows by themselves give the motion back, and how many they use.

    Returns:
        `error`, the mean absolute error of the normalised values; `correlation` of the shifts
        that change, integrated over the window from its true first frame, with the true ones;
        for each stream `<name>_perplexity` and `<name>_used` codes, and `joint_perplexity` of
        the pairs of codes.
    """
    channels = Channels.of(windows.statistics, vq.config.quant)
    split, error, made, true = 2 * vq.config.regions, 0.0, [], []
    with evaluating(vq):
        codes = encode_windows(vq, windows)
        for some, group in zip(codes.split(64), windows.groups("poses"), strict=True):
            poses, decoded = group["poses"], decode_windows(vq, some)
            error += float((decoded - channels.normalise(poses)).abs().mean()) * len(poses)
            made.append(channels.integrate(decoded, poses[:, 1])[..., :split])
            true.append(poses[:, 1:, :split])
    pattern, truth = torch.cat(made), torch.cat(true)
    scores = {"error": error / len(windows)}
    scores["correlation"] = correlation(pattern, truth)
    for name, stream in zip(STREAMS, codes.unbind(1), strict=False):
        scores[f"{name}_perplexity"] = perplexity(stream)
        scores[f"{name}_used"] = float(len(stream.unique()))
    if codes.shape[1] > 1:
        scores["joint_perplexity"] = perplexity(codes[:, 0] * vq.config.codes + codes[:, 1])
    return scores


def correlation(made: Tensor, true: Tensor) -> float:
    """Pearson's correlation within windows (n, T, C), all channels together."""
    made, true = (value - value.mean(1, keepdim=True) for value in (made.double(), true.double()))
    size = (made.square().sum() * true.square().sum()).sqrt().clamp_min(1e-20)
    return float((made * true).sum() / size)


def perplexity(codes: Tensor) -> float:
    """exp(H) of the codes as they occur."""
    counts = codes.flatten().unique(return_counts=True)[1].double()
    return float(torch.special.entr(counts / counts.sum()).sum().exp())


@torch.no_grad()
def decoding_errors(
    vq: VQMotionExtractor, clips: Sequence[MotionClip], channels: Channels
) -> dict[str, float]:
    """Error of decoding clips longer than a window in one pass and in windows.

    Each clip is encoded window by window, or in one pass where `vq` is used in the context of
    clips, and its whole sequence of codes is decoded both ways; what is returned is the mean
    absolute error of the normalised values.

    Returns:
        `full` and `chunked`; nothing if no clip is longer than a window.
    """
    errors: dict[str, list[Tensor]] = {"full": [], "chunked": []}
    for clip in clips:
        count = clip.motion.frames // WINDOW
        if count < 2:
            continue
        poses = clip.motion[: count * WINDOW].vector()
        values = channels.normalise(torch.cat([poses[:1], poses])).to(vq.mean.device)
        if vq.config.context == "window":
            codes = vq.encode(values.unflatten(0, (count, WINDOW)))  # (count, streams, 12)
            codes = codes.transpose(0, 1).flatten(1)
        else:
            codes = vq.encode(values[None])[0]
        for name, decode in (("full", vq.decode_whole), ("chunked", vq.decode_chunked)):
            errors[name].append((decode(codes) - values.cpu()).abs().mean(-1))
    return {name: float(torch.cat(parts).mean()) for name, parts in errors.items() if parts}
