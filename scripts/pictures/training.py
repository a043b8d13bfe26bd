"""Training of the renderer's flow and generator: its state, and one step of the optimisers.

The critic's and the losses' gradients at the picture are scaled to parts of the multi-scale loss's.
"""

import argparse
import copy
import dataclasses
import json
import math
from collections.abc import Iterable
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from pictures.frames import PairMaker, Pairs
from pictures.hands import HandNetwork
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

PULLS = {"parts": 0.6, "natural": 1.5, "natural_parts": 1.2, "hands": 0.8}
"""Size of each term's gradient at the picture, in parts of the multi-scale loss's."""

EAGER = 12
"""Steps of each kind before they are captured as a graph; the first find the terms' weights."""

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


@dataclass
class Inputs:
    """Everything random about a step; the tensors of a captured step are filled anew."""

    source: Tensor
    driving: Tensor
    places: Tensor
    critic_places: Tensor
    hands: Tensor
    angles: Tensor
    sure: Tensor

    def fill(self, other: "Inputs") -> None:
        """Copy another step's."""
        for field in dataclasses.fields(self):
            getattr(self, field.name).copy_(getattr(other, field.name))


@dataclass
class Captured:
    """A step's gradients as one CUDA graph."""

    graph: torch.cuda.CUDAGraph
    inputs: Inputs
    gradients: list[tuple[Tensor, Tensor]]


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
        hands = HandNetwork(given.hands) if given.hands else None
        self.loss = PictureLoss(natural, hands).to(device, memory_format=layout)
        self.loss.requires_grad_(False)
        self.critic = Critic().to(device, memory_format=layout)
        self.learning = [
            *self.renderer.flow.parameters(),
            *self.renderer.background.parameters(),
            *self.renderer.generator.parameters(),
        ]
        self.renderer.estimator.requires_grad_(False)
        self.optimizer = self._adam(self.learning, given.rate, 0.5)
        self.critic_optimizer = self._adam(self.critic.parameters(), given.rate, 0.0)
        self.average = Average(self.renderer)
        self.weights: dict[str, Tensor] = {}
        self.pulls: dict[str, Tensor] = {}
        self.classes = classes_of(given.batch, device)
        self.strength = torch.zeros((), device=device)
        self.steps = 0
        self.seen: dict[str, Tensor] = {}
        self.eager = {False: 0, True: 0}
        self.captured: dict[bool, Captured] = {}
        self.graphs = bool(given.graphs) and device.type == "cuda"
        self.stream = torch.cuda.Stream() if device.type == "cuda" else None

    def _adam(self, parameters: Iterable[Tensor], rate: float, first: float) -> torch.optim.Adam:
        fused = self.device.type == "cuda"
        return torch.optim.Adam(parameters, lr=rate, betas=(first, 0.999), fused=fused)

    def autocast(self) -> torch.autocast:
        """bfloat16 for convolutions, but on a CPU, where gradients in it are slow."""
        cuda = self.device.type == "cuda"
        return torch.autocast(self.device.type, torch.bfloat16, cuda, cache_enabled=False)

    def modes(self) -> None:
        """Norms learn, but for the regions' ones."""
        self.renderer.train()
        self.renderer.estimator.eval()

    def step(self, progress: float) -> None:
        """One step of the optimisers, `progress` of the way through the training."""
        given = self.given
        ramp = min(1.0, self.steps / 60)
        rate = ramp * (0.5 * (1 + math.cos(math.pi * progress)) * 0.98 + 0.02)
        for group in self.optimizer.param_groups:
            group["lr"] = given.rate * rate
        for group in self.critic_optimizer.param_groups:
            group["lr"] = given.critic_rate * min(1.0, 2 * (1 - progress) + 0.1)
        critic = given.critic > 0 and progress > given.critic_from - 0.05
        with torch.cuda.stream(self.stream) if self.stream else nullcontext():
            self.strength.fill_(min(1.0, max(0.0, (progress - given.critic_from) / 0.08)))
            inputs = self._inputs()
            if self.graphs and self.eager[critic] >= EAGER:
                self._replay(inputs, critic)
            else:
                self._gradients(inputs, critic)
                self.eager[critic] += 1
            self._note(norm=nn.utils.clip_grad_norm_(self.learning, given.clip))
            self.optimizer.step()
            if critic:
                self.critic_optimizer.step()
            self.average.update()
        self.steps += 1

    def _inputs(self) -> Inputs:
        pairs = self.maker.batch(self.given.batch)
        chosen = places(pairs, self.maker.random)
        more = critic_places(chosen, pairs.source.shape[-1], self.maker.random)
        hands = pairs.centres[:, :2]
        return Inputs(
            pairs.source, pairs.driving, chosen, more, hands, pairs.angles, pairs.sure.float()
        )

    def _replay(self, inputs: Inputs, critic: bool) -> None:
        """The gradients of a step by its graph, which the first call captures."""
        if critic not in self.captured:
            own = Inputs(**{k: v.clone() for k, v in vars(inputs).items()})
            torch.cuda.synchronize()
            graph = torch.cuda.CUDAGraph()
            try:
                with torch.cuda.graph(graph, stream=self.stream):
                    self._gradients(own, critic)
            except Exception as error:
                print(f"no graph: {type(error).__name__}: {str(error)[:300]}", flush=True)
                self.graphs = False
                torch.cuda.synchronize()
                self._gradients(inputs, critic)
                return
            owners = [*self.learning, *(self.critic.parameters() if critic else ())]
            gradients = [(p, p.grad) for p in owners if p.grad is not None]
            self.captured[critic] = Captured(graph, own, gradients)
        captured = self.captured[critic]
        captured.inputs.fill(inputs)
        for parameter, gradient in captured.gradients:
            parameter.grad = gradient
        captured.graph.replay()

    def _gradients(self, inputs: Inputs, critic: bool) -> None:
        """Gradients of the renderer and, with `critic`, of the critic, into their parameters."""
        given, renderer, generator = self.given, self.renderer, self.renderer.generator
        self.optimizer.zero_grad(set_to_none=True)
        self.critic_optimizer.zero_grad(set_to_none=True)
        source, driving = inputs.source, inputs.driving
        with self.autocast():
            with torch.no_grad():
                both = renderer.estimator(torch.cat([source, driving]))
            count = len(source)
            background = renderer.background(source, driving)
            flow = renderer.flow(source, both[:count], both[count:], background)
            painted = generator.paint(generator.encode(source), flow)
            image = generator.blend(source, painted, flow).float()
            shown = generator.shown(painted, flow).float()
            blend = given.blend * self.loss.multi(flow.blend, renderer.flow.down(driving))
        hidden = given.occlusion_cost * (1 - shown).mean()
        leaf = image.detach().requires_grad_()
        gradient = self._pull(leaf, inputs)
        if critic:
            gradient = gradient + self._critic(leaf, inputs, gradient)
        torch.autograd.backward([image, blend + hidden], [gradient, None])
        error = (leaf.detach() - driving).abs().mean()
        self._note(blend=blend, hidden=hidden, l1=error, shown=shown.mean())

    def _note(self, **values: Tensor) -> None:
        for name, value in values.items():
            value = value.detach().float()
            if name in self.seen:
                self.seen[name].lerp_(value, 0.05)
            else:
                self.seen[name] = value.clone()

    def _pull(self, leaf: Tensor, inputs: Inputs) -> Tensor:
        """Gradient of all terms at the picture; the first steps find their weights."""
        where = (inputs.hands, inputs.angles, inputs.sure)
        with self.autocast():
            terms = self.loss(leaf, inputs.driving, inputs.places, where)
        if self.steps < EAGER:
            gradients = {
                k: torch.autograd.grad(v, leaf, retain_graph=True)[0] for k, v in terms.items()
            }
            for name, pull in PULLS.items():
                if name in gradients:
                    size = gradients[name].norm()  # 0 where no pair has a hand that is seen
                    wanted = pull * gradients["multi"].norm() / size.clamp_min(1e-12)
                    old = self.weights.get(name, wanted)
                    wanted = torch.where(size > 0, wanted, old)
                    self.weights[name] = torch.lerp(old, wanted, 1 / (1 + self.steps))
        weighted = [v * self.weights[k] if k in self.weights else v for k, v in terms.items()]
        self._note(**terms)
        return torch.autograd.grad(torch.stack(weighted).sum(), leaf)[0]

    def _critic(self, leaf: Tensor, inputs: Inputs, pull: Tensor) -> Tensor:
        """The critic's gradients into its parameters; its pull at the picture is returned."""
        given = self.given
        true = parts_of(inputs.driving, inputs.critic_places)
        with self.autocast():
            made = parts_of(leaf.detach(), inputs.critic_places)
            loss = critic_loss(self.critic, made, true, self.classes)
        loss.backward()
        self._note(critic=loss)
        with self.autocast():
            made = parts_of(leaf, inputs.critic_places)
            terms = painter_terms(self.critic, made, true, self.classes)
        total = torch.zeros_like(leaf)
        names = {"fool": given.critic, "alike": given.alike}
        for i, (name, share) in enumerate(names.items()):
            gradient = torch.autograd.grad(terms[i], leaf, retain_graph=i == 0)[0]
            ratio = pull.norm() / gradient.norm().clamp_min(1e-12)
            if name in self.pulls:
                self.pulls[name].lerp_(ratio, 0.05)
            else:
                self.pulls[name] = ratio.clone()
            total = total + self.strength * share * self.pulls[name] * gradient
            self._note(**{name: terms[i]})
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
