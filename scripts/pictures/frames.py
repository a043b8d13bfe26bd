"""Packed frames on a device: decoded once, paired, keyed and augmented there.

Everything random about a batch is drawn on the device, so that a step costs little Python. Frames
are what `pack_frames.py` wrote.
"""

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

GREY = 104 / 255
"""What a keyed person is laid over, as packed."""

KINDS = ("signer", "avatars", "phantom")

TRAIN, VALIDATION = 0, 1

SURE = 0.5
"""Score above which the hand network sees a hand."""


@dataclass(frozen=True)
class Pairs:
    """Sources and drivings of one person each."""

    source: Tensor
    """(B, 3, H, W) float32 in [0, 1], channels last."""
    driving: Tensor
    """(B, 3, H, W), as `source`."""
    centres: Tensor
    """(B, 3, 2) right hand, left hand, face of the driving frame in pixels (x, y)."""
    seen: Tensor
    """(B, 3) bool, whether they are in the picture."""
    left: Tensor
    """(B, 2, 2) the hands of the source frame, where something has to be painted anew."""
    angles: Tensor
    """(B, 2) radians, the direction in which the hand network sees each hand best."""
    sure: Tensor
    """(B, 2) bool, whether it surely sees it."""


@dataclass
class Frames:
    """Frames of one kind; see `pack_frames.py`."""

    pictures: Tensor
    """(N, H, W, 3) uint8 RGB."""
    matte: Tensor | None
    """(N, H, W) uint8, where people are keyed."""
    centres: Tensor
    seen: Tensor
    first: Tensor
    """(N,) number of the first frame of the frame's clip."""
    length: Tensor
    """(N,) frames of the frame's clip."""
    split: Tensor
    pose: Tensor
    pool: Tensor
    """Training frames to draw from; those with hands twice."""
    angles: Tensor
    """(N, 2) and scores (N, 2) as `pictures.hands.best_turns` gives; zeros before."""
    scores: Tensor


def decoded(path: Path) -> np.ndarray:
    """Every frame of a video, (N, H, W, 3) uint8 RGB."""
    reader = cv2.VideoCapture(str(path))
    frames = []
    while True:
        found, frame = reader.read()
        if not found:
            break
        frames.append(frame[:, :, ::-1])
    reader.release()
    if not frames:
        raise OSError(f"{path}: OpenCV decodes no frame of it")
    return np.stack(frames)


def load_frames(folder: Path, kind: str, device: torch.device, pieces: int = 0) -> Frames:
    """The frames of one kind on a device; with `pieces` only so many files of them."""
    with np.load(folder / f"{kind}.npz", allow_pickle=False) as file:
        facts = {name: file[name] for name in file.files}
    paths = sorted(folder.glob(f"{kind}-[0-9][0-9].mp4"))
    mattes = sorted(folder.glob(f"{kind}-matte-[0-9][0-9].mp4"))
    mattes = mattes if kind == "signer" else []
    if pieces:  # the last one too, so that there are frames of all splits
        paths, mattes = paths[:pieces], mattes[:pieces]
    try:
        with ThreadPoolExecutor(16) as pool:
            read = list(pool.map(decoded, [*paths, *mattes]))
    except Exception as error:  # one thread does what sixteen may not
        print(f"decoding with threads failed ({error}); again without", flush=True)
        read = [decoded(p) for p in [*paths, *mattes]]
    pictures = torch.from_numpy(np.concatenate(read[: len(paths)])).to(device)
    matte = None
    if mattes:
        matte = torch.from_numpy(np.concatenate(read[len(paths) :])[..., 0].copy()).to(device)
    count = len(pictures)
    if not pieces and count != len(facts["clip"]):
        raise OSError(f"{folder}: {count} frames of {kind}, not {len(facts['clip'])}")
    clip = facts["clip"][:count]
    starts = np.flatnonzero(np.diff(clip, prepend=-1))
    lengths = np.diff(np.append(starts, count))
    which = np.cumsum(np.diff(clip, prepend=clip[0]) != 0)
    first, length = starts[which], lengths[which]
    train = np.flatnonzero((facts["split"][:count] == TRAIN) & (length > 1))
    hands = train[facts["seen"][train, :2].any(1)]

    def there(x: np.ndarray) -> Tensor:
        return torch.from_numpy(np.ascontiguousarray(x[:count])).to(device)

    return Frames(
        pictures,
        matte,
        there(facts["centres"]),
        there(facts["seen"]),
        there(first),
        there(length),
        there(facts["split"]),
        there(facts["pose"]),
        torch.from_numpy(np.concatenate([train, hands])).to(device),
        torch.zeros(count, 2, device=device),
        torch.zeros(count, 2, device=device),
    )


class PairMaker:
    """Batches of augmented pairs, and the fixed ones to validate with.

    Args:
        frames: of every kind.
        shares: part of a batch that each kind has.
        backgrounds: (M, 320, 320, 3) uint8 to put a keyed person before.
        seed: of everything random.
    """

    def __init__(
        self, frames: dict[str, Frames], shares: dict[str, float], backgrounds: Tensor, seed: int
    ) -> None:
        self.frames, self.shares = frames, shares
        self.device = backgrounds.device
        self.backgrounds = backgrounds.permute(0, 3, 1, 2).contiguous()
        self.random = torch.Generator(self.device).manual_seed(seed)
        # constants live on the device: a copy to it would wait for what is being computed
        self.to_yiq = torch.tensor(_YIQ, device=self.device)
        self.from_yiq = torch.tensor(_RGB, device=self.device)
        self.screen = torch.tensor([0.1, 0.63, 0.8], device=self.device).view(1, 3, 1, 1)

    def batch(self, size: int) -> Pairs:
        """Random pairs of training frames."""
        counts = [round(size * self.shares[kind]) for kind in self.frames]
        counts[0] += size - sum(counts)
        parts = [self._draw(k, n) for k, n in zip(self.frames, counts, strict=True) if n > 0]
        images, *facts = (torch.cat(p) for p in zip(*parts, strict=True))
        source, driving = self._colours(images)
        return Pairs(_last(source), _last(driving), *facts)

    def fixed(self, kind: str, most: int, *, from_open: bool = False) -> Pairs | None:
        """Validation pairs: the source is a clip's first frame, or its most open one."""
        frames = self.frames[kind]
        held = torch.nonzero(frames.split == VALIDATION)[:, 0]
        if from_open:
            clips = {int(frames.first[i]) for i in held if frames.pose[i]}
            held = held[[int(frames.first[i]) in clips for i in held.tolist()]]
        if len(held) < 2:
            return None
        driving = held[torch.linspace(0, len(held) - 1, min(most, len(held))).long()]
        source = frames.first[driving]
        if from_open:
            apart = (frames.centres[:, 0] - frames.centres[:, 1]).norm(dim=-1) * frames.pose
            source = torch.stack(
                [s + apart[s : s + n].argmax() for s, n in zip(source, frames.length[driving])]  # noqa: B905
            )
        driving, source = driving[source != driving], source[source != driving]
        images = self._gathered(frames, torch.stack([source, driving], 1))
        if frames.matte is not None:
            images = images[:, :, :3] + (1 - images[:, :, 3:]) * (self.screen - GREY)
        source_image, driving_image = images[:, 0, :3].clamp(0, 1), images[:, 1, :3].clamp(0, 1)
        return Pairs(
            _last(source_image),
            _last(driving_image),
            frames.centres[driving],
            frames.seen[driving],
            frames.centres[source, :2],
            frames.angles[driving],
            frames.scores[driving] > SURE,
        )

    def _rand(self, *shape: int) -> Tensor:
        return torch.rand(shape, generator=self.random, device=self.device)

    def _between(self, low: float, high: float, *shape: int) -> Tensor:
        return low + (high - low) * self._rand(*shape)

    def _gathered(self, frames: Frames, which: Tensor) -> Tensor:
        """Pictures (B, 2, 3 or 4, H, W) float32 of frames (B, 2), the matte as fourth channel."""
        images = frames.pictures[which].permute(0, 1, 4, 2, 3).float() / 255
        if frames.matte is None:
            return images
        return torch.cat([images, frames.matte[which][:, :, None].float() / 255], 2)

    def _draw(self, kind: str, count: int) -> tuple[Tensor, ...]:
        """Pairs (count, 2, 3, H, W), then what `Pairs` has from `centres` on."""
        frames = self.frames[kind]
        driving = frames.pool[(self._rand(count) * len(frames.pool)).long()]
        first, length = frames.first[driving], frames.length[driving]
        step = 1 + (self._rand(count) * (length - 1)).long()
        source = first + (driving - first + step.clamp_max(length - 1)) % length
        images = self._gathered(frames, torch.stack([source, driving], 1))
        points = torch.cat([frames.centres[driving], frames.centres[source, :2]], 1)
        images, points, mirror = self._placed(images, points)
        centres, left = points[:, :3], points[:, 3:]
        size = images.shape[-1]
        inside = ((centres > 4) & (centres < size - 5)).all(-1)
        if frames.matte is not None:
            images = self._before(images, centres)
        seen = frames.seen[driving] & inside
        angles = frames.angles[driving] * mirror[:, None]
        sure = (frames.scores[driving] > SURE) & seen[:, :2]
        return images, centres, seen, left, angles, sure

    def _placed(self, images: Tensor, centres: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Mirror and cut out both frames of a pair alike; -1 for those that are mirrored."""
        count, size = len(images), images.shape[-1]
        zoomed = (self._rand(count) < 0.4).float()
        scale = 1 - zoomed * self._between(0.0, 0.18, count)
        mirror = torch.where(self._rand(count) < 0.5, -1.0, 1.0)
        offset = (1 - scale)[:, None] * self._between(-1, 1, count, 2)
        theta = torch.zeros(count, 2, 3, device=self.device)
        theta[:, 0, 0], theta[:, 1, 1] = scale * mirror, scale
        theta[:, :, 2] = offset
        grid = F.affine_grid(theta, [count, 1, size, size], align_corners=False)
        moved = F.grid_sample(
            images.flatten(1, 2), grid, "bicubic", padding_mode="border", align_corners=False
        )
        unit = (centres + 0.5) * 2 / size - 1  # x = scale * mirror * x' + offset
        unit = (unit - offset[:, None]) / (scale[:, None] * torch.stack([mirror, mirror**2], 1))[
            :, None
        ]
        centres = (unit + 1) * size / 2 - 0.5
        return moved.view(images.shape).clamp(0, 1), centres, mirror

    def _before(self, images: Tensor, centres: Tensor) -> Tensor:
        """A keyed person (B, 2, 4, H, W), lit anew, before other backgrounds: (B, 2, 3, H, W)."""
        count, size = len(images), images.shape[-1]
        matte = images[:, :, 3:]
        person = images[:, :, :3] - (1 - matte) * GREY  # premultiplied
        ground = self._grounds(count, size)
        light = torch.stack([self._between(*r, count) for r in _LIGHT], 1)
        light = light * self._between(0.8, 1.25, count, 1)
        tint = ground.mean((2, 3))
        tint = tint / tint.mean(1, keepdim=True).clamp_min(0.05)
        light = light * (1 + 0.2 * (tint.clamp(0.5, 1.5) - 1))
        # what is dark below the chin is his shirt: it gets a colour in some of the pairs
        luma = person.mean(2, keepdim=True)
        rows = torch.arange(size, device=self.device).view(1, 1, 1, size, 1)
        below = (rows - centres[:, 2, 1].view(-1, 1, 1, 1, 1) - 26).clamp(0, 10) / 10
        dark = ((0.19 - luma) / 0.08).clamp(0, 1) * below * matte
        colour = self._rand(count, 3) ** 1.5 * 0.6 * (self._rand(count, 1) < 0.4)
        person = (person + dark * colour.view(-1, 1, 3, 1, 1) * (0.6 + 4 * luma)).clamp(0, 1)
        person = person * light.view(-1, 1, 3, 1, 1)
        return (person + (1 - matte) * ground[:, None]).clamp(0, 1)

    def _grounds(self, count: int, size: int) -> Tensor:
        """Backgrounds (B, 3, H, W): of the bank, or plain ones and gradients."""
        which = (self._rand(count) * len(self.backgrounds)).long()
        theta = torch.zeros(count, 2, 3, device=self.device)
        scale = self._between(0.5, 1.0, count)
        theta[:, 0, 0] = scale * torch.where(self._rand(count) < 0.5, -1.0, 1.0)
        theta[:, 1, 1] = scale
        theta[:, :, 2] = (1 - scale)[:, None] * self._between(-1, 1, count, 2)
        grid = F.affine_grid(theta, [count, 3, size, size], align_corners=False)
        bank = F.grid_sample(
            self.backgrounds[which].float() / 255, grid, "bilinear", "border", False
        )
        bank = bank * self._between(0.5, 1.2, count, 1, 1, 1)
        angle = self._between(0, 2 * math.pi, count)
        line = torch.linspace(-0.7, 0.7, size, device=self.device)
        along = (
            torch.cos(angle)[:, None, None] * line
            + torch.sin(angle)[:, None, None] * (line[:, None])
        )
        base = self._rand(count, 3, 1, 1)
        base = base.mean(1, keepdim=True) + self._rand(count, 1, 1, 1) * (
            base - base.mean(1, keepdim=True)
        )
        slope = self._between(-0.3, 0.3, count, 1, 1, 1)
        plain = base + slope * along[:, None] + 0.05 * self._between(-1, 1, count, 3, 1, 1)
        screen = (
            self.screen * self._between(0.8, 1.15, count, 1, 1, 1) * (1 + 0.15 * along[:, None])
        )
        kind = self._rand(count, 1, 1, 1)
        mixed = torch.where(kind < 0.5, bank, torch.where(kind < 0.85, plain, screen))
        return mixed.clamp(0, 1)

    def _colours(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Brightness, contrast, saturation and hue of pairs (B, 2, 3, H, W), both alike."""
        count = len(images)
        strong = self._rand(count) < 0.2
        turn = torch.where(
            strong, self._between(-0.18, 0.18, count), self._between(-0.02, 0.02, count)
        )
        vivid = torch.where(
            strong, self._between(0.3, 1.7, count), self._between(0.75, 1.25, count)
        )
        light = self._between(0.8, 1.2, count) * self._between(0.8, 1.2, count)
        cos, sin = torch.cos(2 * math.pi * turn), torch.sin(2 * math.pi * turn)
        spin = torch.zeros(count, 3, 3, device=self.device)
        spin[:, 0, 0] = 1
        spin[:, 1, 1], spin[:, 1, 2] = vivid * cos, -vivid * sin
        spin[:, 2, 1], spin[:, 2, 2] = vivid * sin, vivid * cos
        matrix = light[:, None, None] * (self.from_yiq @ spin @ self.to_yiq)
        contrast = self._between(0.75, 1.25, count).view(-1, 1, 1, 1, 1)
        changed = torch.einsum("bij,bthwj->btihw", matrix, images.permute(0, 1, 3, 4, 2))
        mean = changed.mean((1, 2, 3, 4), keepdim=True)
        changed = (mean + contrast * (changed - mean)).clamp(0, 1)
        return changed[:, 0], changed[:, 1]


_LIGHT = ((1.0, 1.4), (0.95, 1.15), (0.72, 1.05))
"""Range of the factors of red, green and blue that a keyed person is lit with."""

_YIQ = ((0.299, 0.587, 0.114), (0.596, -0.274, -0.322), (0.211, -0.523, 0.312))
_RGB = ((1.0, 0.956, 0.621), (1.0, -0.272, -0.647), (1.0, -1.106, 1.703))


def _last(images: Tensor) -> Tensor:
    return images.contiguous(memory_format=torch.channels_last)
