"""Training of the renderer's flow and generator: its state, and one step of the optimisers.

The critic's and the losses' gradients at the picture are scaled to parts of the multi-scale loss's.
"""

import argparse
import copy
import json
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import torch
from pictures.frames import PairMaker, Pairs
from pictures.losses import (
    Critic,
    PictureLoss,
    classes_of,
    critic_loss,
    critic_places,
    painter_terms,
    parts_of,
    places,
)
from safetensors.torch import load_file
from torch import Tensor, nn

from mraa.blocks import PostResBlock
from mraa.imagenet import ImagenetDistance, load_imagenet
from mraa.renderer import GeneratorConfig, HourglassConfig, Renderer, RendererConfig

PULLS = {"parts": 0.6, "natural": 1.5, "natural_parts": 1.2}
"""Size of each term's gradient at the picture, in parts of the multi-scale loss's."""

HAND_BOX = 48
"""Side in pixels of the boxes around hands that are measured."""


def architecture(path: Path, changes: dict[str, Any]) -> RendererConfig:
    """The renderer's architecture of a JSON file, with other settings of the generator."""
    values = json.loads(path.read_text())
    for name in ("estimator", "background", "flow"):
        values[name] = HourglassConfig(**values[name])
    values["generator"] = GeneratorConfig(**{**values["generator"], **changes})
    return RendererConfig(**values)


def begin(config: RendererConfig, initial: Path) -> Renderer:
    """A renderer that draws what the initial one draws; blocks that are new do nothing yet."""
    renderer = Renderer(config)
    given = {k: v.float() for k, v in load_file(initial).items()}
    own = renderer.state_dict()
    for name, value in given.items():
        if own[name].shape != value.shape:  # a fine occlusion adds channels to the last layer
            grown = torch.zeros_like(own[name])
            grown[: len(value)] = value
            given[name] = grown
    for name, module in renderer.named_modules():
        if isinstance(module, PostResBlock) and f"{name}.conv1.weight" not in given:
            nn.init.zeros_(module.norm2.weight)
    missing = renderer.load_state_dict(given, strict=False)
    if missing.unexpected_keys:
        raise SystemExit(f"{initial}: {missing.unexpected_keys[0]} has no place")
    return renderer


class Average:
    """Moving average of weights and running statistics."""

    def __init__(self, model: nn.Module) -> None:
        self.model = copy.deepcopy(model).eval().requires_grad_(False)
        names = [k for k, v in model.state_dict().items() if v.is_floating_point()]
        mine, theirs = self.model.state_dict(), model.state_dict()
        self.mine, self.theirs = [mine[k] for k in names], [theirs[k] for k in names]
        self.count = 0

    @torch.no_grad()
    def update(self) -> None:
        """Follow the model."""
        self.count += 1
        decay = min(0.999, (1 + self.count) / (10 + self.count))
        torch._foreach_lerp_(self.mine, self.theirs, 1 - decay)


def psnr(error: Tensor) -> Tensor:
    """Decibels of mean squared errors."""
    return -10 * torch.log10(error.clamp_min(1e-8))


@torch.no_grad()
def drawn(renderer: Renderer, source: Tensor, driving: Tensor) -> tuple[Tensor, Tensor]:
    """Pictures and coarse occlusion of an evaluated renderer."""
    made, hidden = [], []
    for s, d in zip(source.split(32), driving.split(32), strict=True):
        both = renderer.estimator(torch.cat([s, d]))
        background = renderer.background(s, d)
        image, flow = renderer(s, both[: len(s)], both[len(s) :], background)
        made.append(image.float())
        hidden.append(flow.occlusion.float())
    return torch.cat(made), torch.cat(hidden)


def scores(image: Tensor, pairs: Pairs) -> tuple[float, float]:
    """PSNR of pictures, whole and in boxes around the hands that are in them."""
    error = (image - pairs.driving).square().mean(1)  # (B, H, W)
    whole = psnr(error.mean((1, 2))).mean()
    size = error.shape[-1]
    at = torch.arange(size, device=error.device)
    near = (at - pairs.centres[:, :2, :, None]).abs() <= HAND_BOX / 2  # (B, 2, 2, size)
    boxes = near[:, :, 1, :, None] & near[:, :, 0, None, :]
    inside = (error[:, None] * boxes).sum((2, 3)) / boxes.sum((2, 3)).clamp_min(1)
    seen = pairs.seen[:, :2]
    hands = psnr(inside)[seen].mean() if bool(seen.any()) else error.new_tensor(math.nan)
    return float(whole), float(hands)


class Training:
    """Everything that a course of training holds."""

    def __init__(self, given: argparse.Namespace, maker: PairMaker, device: torch.device) -> None:
        self.given, self.maker, self.device = given, maker, device
        changes = {
            "refine_blocks": given.refine,
            "half_blocks": given.half,
            "bottleneck_blocks": given.bottleneck,
            "fine_occlusion": bool(given.fine),
        }
        torch.manual_seed(given.seed)
        self.config = architecture(given.initial.with_suffix(".json"), changes)
        layout = torch.channels_last
        self.renderer = begin(self.config, given.initial).to(device, memory_format=layout)
        natural = ImagenetDistance(load_imagenet(given.natural)) if given.natural else None
        self.loss = PictureLoss(natural).to(device, memory_format=layout)
        self.loss.requires_grad_(False)
        self.critic = Critic().to(device, memory_format=layout)
        learning = [
            *self.renderer.flow.parameters(),
            *self.renderer.background.parameters(),
            *self.renderer.generator.parameters(),
        ]
        self.renderer.estimator.requires_grad_(False)
        self.learning = learning
        self.optimizer = self._adam(learning, given.rate, 0.5)
        self.critic_optimizer = self._adam(self.critic.parameters(), given.rate, 0.0)
        self.average = Average(self.renderer)
        self.weights: dict[str, Tensor] = {}
        self.pulls: dict[str, Tensor] = {}
        self.classes = classes_of(given.batch, device)
        self.steps = 0
        self.seen: dict[str, Tensor] = {}

    def _adam(self, parameters: Iterable[Tensor], rate: float, first: float) -> torch.optim.Adam:
        fused = self.device.type == "cuda"
        return torch.optim.Adam(parameters, lr=rate, betas=(first, 0.999), fused=fused)

    def autocast(self) -> torch.autocast:
        """bfloat16 for convolutions, but on a CPU, where gradients in it are slow."""
        return torch.autocast(self.device.type, torch.bfloat16, self.device.type == "cuda")

    def modes(self) -> None:
        """Norms learn, but for the regions' ones."""
        self.renderer.train()
        self.renderer.estimator.eval()

    def step(self, progress: float) -> None:
        """One step of the optimisers."""
        given, renderer = self.given, self.renderer
        ramp = min(1.0, self.steps / 60)
        rate = ramp * (0.5 * (1 + math.cos(math.pi * progress)) * 0.98 + 0.02)
        for group in self.optimizer.param_groups:
            group["lr"] = given.rate * rate
        pairs = self.maker.batch(given.batch)
        with self.autocast():
            with torch.no_grad():
                both = renderer.estimator(torch.cat([pairs.source, pairs.driving]))
            count = len(pairs.source)
            background = renderer.background(pairs.source, pairs.driving)
            flow = renderer.flow(pairs.source, both[:count], both[count:], background)
            features = renderer.generator.encode(pairs.source)
            painted = renderer.generator.paint(features, flow)
            image = renderer.generator.blend(pairs.source, painted, flow).float()
            shown = renderer.generator.shown(painted, flow).float()
            small = renderer.flow.down(pairs.driving)
            blend = given.blend * self.loss.multi(flow.blend, small)
        hidden = given.occlusion_cost * (1 - shown).mean()
        leaf = image.detach().requires_grad_()
        size = image.shape[-1]
        centres = places(pairs.centres, pairs.seen, size, self.maker.random)
        gradient = self._pull(leaf, pairs.driving, centres)
        if given.critic > 0 and progress > given.critic_from - 0.05:
            more = self._critic(leaf, pairs.driving, centres, progress, gradient)
            gradient = gradient if more is None else gradient + more
        self.optimizer.zero_grad(set_to_none=True)
        torch.autograd.backward([image, blend + hidden], [gradient, None])
        norm = nn.utils.clip_grad_norm_(self.learning, given.clip)
        self.optimizer.step()
        self.average.update()
        self.steps += 1
        error = (leaf.detach() - pairs.driving).abs().mean()
        self._note(blend=blend, hidden=hidden, norm=norm, l1=error, shown=shown.mean())

    def _note(self, **values: Tensor) -> None:
        for name, value in values.items():
            value = value.detach()
            old = self.seen.get(name)
            self.seen[name] = value if old is None else torch.lerp(old, value, 0.05)

    def _pull(self, leaf: Tensor, truth: Tensor, centres: Tensor) -> Tensor:
        """Gradient of all terms at the picture; the first steps find their weights."""
        with self.autocast():
            terms = self.loss(leaf, truth, centres)
        if self.steps < 12:
            gradients = {
                k: torch.autograd.grad(v, leaf, retain_graph=True)[0] for k, v in terms.items()
            }
            for name, pull in PULLS.items():
                if name in gradients:
                    wanted = pull * gradients["multi"].norm() / gradients[name].norm()
                    old = self.weights.get(name, wanted)
                    self.weights[name] = torch.lerp(old, wanted, 1 / (1 + self.steps))
        weighted = [v * self.weights[k] if k in self.weights else v for k, v in terms.items()]
        self._note(**terms)
        return torch.autograd.grad(torch.stack(weighted).sum(), leaf)[0]

    def _critic(
        self, leaf: Tensor, truth: Tensor, centres: Tensor, progress: float, pull: Tensor
    ) -> Tensor | None:
        """Teach the critic; its pull at the picture once it has learnt a little."""
        given, size = self.given, leaf.shape[-1]
        where = critic_places(centres, size, self.maker.random)
        true = parts_of(truth, where)
        with self.autocast():
            made = parts_of(leaf.detach(), where)
            loss = critic_loss(self.critic, made, true, self.classes)
        for group in self.critic_optimizer.param_groups:
            group["lr"] = given.critic_rate * min(1.0, 2 * (1 - progress) + 0.1)
        self.critic_optimizer.zero_grad(set_to_none=True)
        loss.backward()
        self.critic_optimizer.step()
        self._note(critic=loss)
        strength = min(1.0, (progress - given.critic_from) / 0.08)
        if strength <= 0:
            return None
        self.critic.requires_grad_(False)
        with self.autocast():
            terms = painter_terms(self.critic, parts_of(leaf, where), true, self.classes)
        total = torch.zeros_like(leaf)
        names = {"fool": given.critic, "alike": given.alike}
        for i, (name, share) in enumerate(names.items()):
            gradient = torch.autograd.grad(terms[i], leaf, retain_graph=i == 0)[0]
            ratio = pull.norm() / gradient.norm().clamp_min(1e-12)
            ratio = torch.lerp(self.pulls.get(name, ratio), ratio, 0.05)
            self.pulls[name] = ratio
            total += strength * share * ratio * gradient
            self._note(**{name: terms[i]})
        self.critic.requires_grad_(True)
        return total

    def refresh_norms(self, batches: int) -> Renderer:
        """A copy of the average whose running statistics are its own."""
        model = copy.deepcopy(self.average.model)
        norms = [m for m in model.modules() if isinstance(m, nn.BatchNorm2d)]
        kept = {id(m) for m in model.estimator.modules()}
        for norm in norms:
            if id(norm) not in kept:
                norm.reset_running_stats()
                norm.momentum = None
                norm.train()
        with torch.no_grad(), self.autocast():
            for _ in range(batches):
                pairs = self.maker.batch(self.given.batch)
                drawn(model, pairs.source, pairs.driving)
        for norm in norms:
            norm.momentum = 0.1
        return model.eval()
