"""A network that sees hands, as a loss: its features of made hands against those of true ones.

The network (MediaPipe's hand landmarks, `pack_hands.py`) wants a hand upright in its square, so
every hand of the training frames is first looked at in eight directions; the best is kept.
"""

import json
import math
from pathlib import Path

import torch
import torch.nn.functional as F
from safetensors import safe_open
from torch import Tensor, nn

SIDE = 72.0
"""Pixels of a frame that the network's square spans."""

INPUT = 224
"""Side of the network's input."""

TURNS = 8
"""Directions in which a hand is looked at."""

TAPS = (113, 120, 131, 142, 157)
"""Feature maps that are compared, at 1/4, 1/8, 1/16, 1/16 and 1/32 of the input."""

PRESENCE = 163
"""The network's logit that there is a hand."""


class HandNetwork(nn.Module):
    """The layers of a packed network, frozen."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        with safe_open(path, "pt") as file:
            self.plan = json.loads(file.metadata()["layers"])
            for name in file.keys():  # noqa: SIM118
                value = file.get_tensor(name).float()
                self.register_buffer(name.replace(".", "_"), value)

    def forward(self, images: Tensor) -> tuple[list[Tensor], Tensor]:
        """Feature maps `TAPS` of images (N, 3, 224, 224) in [0, 1], and the logit (N,)."""
        known = {self.plan[0]["inputs"][0]: images}
        for layer in self.plan:
            kind, out = layer["kind"], layer["output"]
            if kind == "LOGISTIC" or (kind == "FULLY_CONNECTED" and out != PRESENCE):
                continue
            x = known[layer["inputs"][0]]
            if kind == "ADD":
                known[out] = x + known[layer["inputs"][1]]
            elif kind == "MEAN":
                known[out] = x.mean((2, 3))
            elif kind == "FULLY_CONNECTED":
                known[out] = F.linear(x, *self._weights(out))
            else:
                known[out] = self._convolved(layer, x)
        return [known[i] for i in TAPS], known[PRESENCE][:, 0]

    def _weights(self, out: int) -> tuple[Tensor, Tensor]:
        return getattr(self, f"{out}_weight"), getattr(self, f"{out}_bias")

    def _convolved(self, layer: dict, x: Tensor) -> Tensor:
        weight, bias = self._weights(layer["output"])
        kernel, stride = weight.shape[-1], layer["stride"]
        pads = []
        for size in (x.shape[3], x.shape[2]):  # TensorFlow's "same": more at the far side
            total = max((math.ceil(size / stride) - 1) * stride + kernel - size, 0)
            pads += [total // 2, total - total // 2]
        groups = x.shape[1] if layer["kind"] == "DEPTHWISE_CONV_2D" else 1
        x = F.conv2d(F.pad(x, pads), weight, bias, stride, groups=groups)
        return x.clamp(0, 6) if layer["relu6"] else x


def turned_parts(images: Tensor, centres: Tensor, angles: Tensor, size: int = INPUT) -> Tensor:
    """Squares (B * P, 3, size, size) around centres (B, P, 2), turned by angles (B, P) radians."""
    batch, count = angles.shape
    side = images.shape[-1]
    at = (torch.arange(size, device=images.device) + 0.5) / size - 0.5
    cos, sin = (f(angles)[..., None, None] * SIDE for f in (torch.cos, torch.sin))
    x = centres[..., 0, None, None] + cos * at - sin * at[:, None]  # (B, P, size, size)
    y = centres[..., 1, None, None] + sin * at + cos * at[:, None]
    grid = torch.stack([(x + 0.5) * 2 / side - 1, (y + 0.5) * 2 / side - 1], -1)
    found = F.grid_sample(
        images.float(), grid.view(batch, count * size, size, 2), "bilinear", "border", False
    )
    found = found.view(batch, 3, count, size, size).transpose(1, 2).flatten(0, 1)
    return found.contiguous(memory_format=torch.channels_last)


@torch.no_grad()
def best_turns(
    network: HandNetwork, pictures: Tensor, centres: Tensor, seen: Tensor, batch: int = 64
) -> tuple[Tensor, Tensor]:
    """In which direction the network sees every hand best, and how surely.

    Args:
        network: on the device of `pictures`.
        pictures: (N, H, W, 3) uint8.
        centres: (N, >= 2, 2) of both hands in pixels.
        seen: (N, >= 2) bool, whether they are in the picture.
        batch: frames at a time.

    Returns:
        Angles (N, 2) in radians and scores (N, 2) in [0, 1], zeros for hands not in the picture.
    """
    device = pictures.device
    angles = torch.zeros(len(pictures), 2, device=device)
    scores = torch.zeros(len(pictures), 2, device=device)
    turns = torch.arange(TURNS, device=device) * (2 * math.pi / TURNS)
    there = torch.nonzero(seen[:, :2].any(1))[:, 0]
    for which in there.split(batch):
        images = pictures[which].permute(0, 3, 1, 2).float() / 255
        here = centres[which, :2].repeat_interleave(TURNS, 1)
        looks = turns.repeat(2).expand(len(which), -1)
        with torch.autocast(device.type, torch.bfloat16, device.type == "cuda"):
            logits = network(turned_parts(images, here, looks))[1]
        best = logits.float().view(len(which), 2, TURNS).max(-1)
        angles[which] = turns[best.indices]
        scores[which] = torch.sigmoid(best.values)
    return angles, scores * seen[:, :2]


def hand_distance(
    network: HandNetwork, image: Tensor, truth: Tensor, where: tuple[Tensor, Tensor, Tensor]
) -> Tensor:
    """How unlike the made hands are to the true ones, for the network.

    Args:
        network: frozen.
        image: (B, 3, H, W) in [0, 1].
        truth: as `image`.
        where: centres (B, 2, 2), angles (B, 2) and whether the true hand is surely seen (B, 2).

    Returns:
        A scalar: relative distance of features, and by how much the logit of a hand falls short.
    """
    centres, angles, sure = where
    weight = sure.flatten().float()
    with torch.no_grad():
        wanted, certain = network(turned_parts(truth, centres, angles))
    found, logit = network(turned_parts(image, centres, angles))
    total = 0.05 * F.relu(certain.float().clamp(max=4) - logit.float())
    for a, b in zip(found, wanted, strict=True):
        apart = (a.float() - b.float()).abs().mean((1, 2, 3))
        total = total + apart / b.float().abs().mean((1, 2, 3)).clamp_min(1e-3) / len(TAPS)
    return (total * weight).sum() / weight.sum().clamp_min(1)
