"""Speaker bundles: a folder with `bundle.json` and one safetensors file a part.

    bundle.json            format, sizes, speakers, crop, hashes, what was trained on what
    renderer.safetensors   region estimator, background, flow, image generator
    statistics.safetensors normalisation, ranges and rest poses of the motion
    vq.safetensors         VQ motion extractor
    gpt.safetensors        co-speech GPT
    refiner.safetensors    refiner
    avd.safetensors        the renderer's disentanglement network; optional, for driving videos
    train/                 checkpoints, curves and caches of training; may be deleted

Every part remembers the hashes of the parts that it was trained on; loading refuses others.

Styles: whose way of gesturing a joint model takes.

A style is a training speaker's embedding in the GPT and nothing else. Pose, place and size stay
those of the photo, or of whatever motion begins with; drawing a stranger toward the rest pose of
the training speaker would move the body to where that one sat.

What ships with the package: a speaker bundle, a photo and a recording of our own.
"""

import dataclasses
import hashlib
import json
import os
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from angie import __version__
from angie.config import Preset, override
from angie.generators.angie.direct import DirectMotion
from angie.generators.angie.generate import AngieGenerator
from angie.generators.angie.gpt import CoSpeechGPT
from angie.generators.angie.refiner import Refiner
from angie.generators.angie.tokenizer import VQConfig, VQMotionExtractor
from angie.layers.packed_linear import pack, product_type
from angie.motion.statistics import MotionStatistics
from data_prep.errors import BadInput
from data_prep.files import whole_file
from data_prep.prepare.source import sha256
from data_prep.rates import FPS, IMAGE_SIZE
from mraa.avd import AvdNetwork
from mraa.renderer import Renderer, make_avd

FORMAT = 1
"""Version of the bundle's layout; loading refuses newer ones."""


_SECTION = {
    "renderer": "renderer",
    "vq": "vq",
    "gpt": "gpt",
    "refiner": "refiner",
    "avd": "renderer",
}


_ENTRY = {"file", "sha256", "upstream", "sizes", "report"}


UPSTREAM = {
    "renderer": (),
    "statistics": ("renderer",),
    "vq": ("renderer", "statistics"),
    "gpt": ("statistics", "vq"),
    "refiner": ("statistics", "vq"),
    "avd": ("renderer",),
}
"""Parts of a bundle in the order of training, each with those that it is trained on."""


OPTIONAL = ("avd",)
"""Parts that a bundle may lack and still be whole."""


PARTS = tuple(part for part in UPSTREAM if part not in OPTIONAL)
"""Parts that gesturing to speech needs, with regions and codes; see `Bundle.parts`."""


STAGE_OF = {"statistics": "motion"}
"""Name of the training stage that makes a part, where it is not the part's own name."""


TRAIN = "train"
"""Folder in a bundle for checkpoints, curves and caches."""


def source_commit() -> str:
    """Commit of the source tree that runs, or "" for an installed package."""
    root = Path(__file__).resolve().parents[1]
    if not (root / ".git").exists():
        return ""
    command = ["git", "-C", str(root), "rev-parse", "HEAD"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()
    except OSError:  # git is not installed
        return ""


@dataclass
class Bundle:
    """A bundle folder and its manifest; parts are read when asked for."""

    folder: Path
    manifest: dict[str, Any]
    preset: Preset

    @classmethod
    def create(cls, folder: Path, preset: Preset) -> "Bundle":
        """Start an empty bundle in `folder`, which is made if need be."""
        folder = Path(folder)
        folder.mkdir(exist_ok=True)
        manifest = {
            "format": FORMAT,
            "angie": __version__,
            "preset": preset.name,
            "speakers": [],
            "fps": FPS,
            "size": IMAGE_SIZE,
            "crop": {},
            "config": dataclasses.asdict(preset),
            "parts": {},
        }
        bundle = cls(folder, manifest, preset)
        bundle.write()
        return bundle

    @classmethod
    def open(cls, folder: Path) -> "Bundle":
        """Read the manifest of a bundle.

        Raises:
            BadInput: no bundle, a newer format, or an unreadable manifest.
        """
        folder = Path(folder)
        path = folder / "bundle.json"
        if not path.is_file():
            raise BadInput(f"{folder}: not a speaker bundle, it has no bundle.json")
        try:
            manifest = json.loads(path.read_text())
            if manifest["format"] > FORMAT:
                raise BadInput(
                    f"{folder}: bundle format {manifest['format']} is newer than {FORMAT}; "
                    "update angie"
                )
            preset = override(Preset(), manifest["config"])
            for part, entry in manifest["parts"].items():
                if entry.keys() != _ENTRY or entry["file"] != f"{part}.safetensors":
                    raise BadInput(f"{part} is not described as it should be")
            texts = [manifest[key] for key in ("angie", "preset", "size", "fps", "crop")]
            if not all(isinstance(name, str) for name in manifest["speakers"]) or not texts:
                raise BadInput("speakers must be names")
        except BadInput as error:
            raise BadInput(f"{path}: {error}") from error
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise BadInput(f"{path}: not a readable manifest ({error!r})") from error
        return cls(folder, manifest, preset)

    def write(self) -> None:
        """Write the manifest, whole or not at all."""
        with whole_file(self.folder / "bundle.json", force=True) as part:
            part.write_text(json.dumps(self.manifest, indent=1) + "\n")

    @property
    def train(self) -> Path:
        """Folder for checkpoints, curves and caches of training."""
        return self.folder / TRAIN

    @property
    def parts(self) -> list[str]:
        """Parts that a whole bundle of this preset has, in the order of training."""
        preset = self.preset
        absent = {
            "renderer": preset.points,
            "avd": preset.points,
            "gpt": preset.vq.quant == "no_quant",
        }
        return [part for part in UPSTREAM if not absent.get(part)]

    def upstream(self, part: str) -> list[str]:
        """Parts of this bundle that a part is trained on."""
        return [name for name in UPSTREAM[part] if name in self.parts]

    def has(self, part: str) -> bool:
        """Whether a part is whole, of the present sizes, and trained on the present parts."""
        try:
            self.path_of(part)
        except BadInput:
            return False
        return True

    def sizes_of(self, part: str) -> str:
        """Hash of the settings that make a part's architecture."""
        section = _SECTION.get(part)
        value = {} if section is None else _sizes(getattr(self.preset, section), part)
        if part == "vq" and self.preset.vq.quant == "no_quant":
            value = {**value, "gpt": _sizes(self.preset.gpt, "gpt")}  # holds the transformer too
        vq = self.preset.vq
        has_codes = part in ("gpt", "refiner") and vq.quant != "no_quant"
        if has_codes and vq.context != VQConfig.context:
            value = {**value, "context": vq.context}  # what the codes mean to them
        return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()

    def hash_of(self, part: str) -> str:
        """Hash of a part as the manifest states it."""
        return str(self.manifest["parts"][part]["sha256"])

    def add(self, part: str, tensors: Mapping[str, Tensor] | Path, report: dict[str, Any]) -> None:
        """Put a trained part into the bundle.

        Args:
            part: name of the part.
            tensors: its state, or a safetensors file to take (it is moved).
            report: what it was trained on and how well it does.
        """
        path = self.folder / f"{part}.safetensors"
        if isinstance(tensors, Path):
            os.replace(tensors, path)
        else:
            with whole_file(path, force=True) as new:
                save_file({k: v.detach().contiguous().cpu() for k, v in tensors.items()}, new)
        self.manifest["parts"][part] = {
            "file": path.name,
            "sha256": sha256(path),
            "upstream": {name: self.hash_of(name) for name in self.upstream(part)},
            "sizes": self.sizes_of(part),
            "report": {"angie": __version__, "commit": source_commit(), **report},
        }
        self.write()

    def path_of(self, part: str) -> Path:
        """File of a part, after checking that it is whole and fits its upstream.

        Raises:
            BadInput: missing, changed, or trained on other parts.
        """
        stage = STAGE_OF.get(part, part)
        if part not in self.parts and self.preset.points:
            raise BadInput(
                f"{self.folder}: is a model of joints, which draws no pictures; angie gestures "
                "writes its motion"
            )
        entry = self.manifest["parts"].get(part)
        if entry is None:
            raise BadInput(f"{self.folder}: has no {part} yet; run angie train --stage {stage}")
        path = self.folder / entry["file"]
        if not path.is_file():
            raise BadInput(
                f"{path}: missing from the bundle; copy it again or train --stage {stage}"
            )
        if sha256(path) != entry["sha256"]:
            raise BadInput(f"{path}: not the file that bundle.json describes (wrong hash)")
        if entry["sizes"] != self.sizes_of(part):
            raise BadInput(
                f"{self.folder}: {part} was trained with other settings than bundle.json states; "
                f"run angie train --stage {stage} again"
            )
        for name in self.upstream(part):
            self.path_of(name)
            if entry["upstream"].get(name) != self.hash_of(name):
                raise BadInput(
                    f"{self.folder}: {part} was trained on another {name}; "
                    f"run angie train --stage {stage} again"
                )
        return path

    def renderer(self) -> Renderer:
        """The renderer in eval mode."""
        return self._load("renderer", Renderer(self.preset.renderer))

    def statistics(self) -> MotionStatistics:
        """Normalisation and ranges of the motion."""
        return MotionStatistics.load(self.path_of("statistics"))

    def vq(self) -> VQMotionExtractor | DirectMotion:
        """The VQ motion extractor, or what stands in its place without codes, in eval mode."""
        preset = self.preset
        if preset.vq.quant == "no_quant":
            model: Any = DirectMotion(preset.vq, preset.gpt, self._speakers())
        else:
            model = VQMotionExtractor(preset.vq)
        return self._load("vq", model)

    def gpt(self) -> CoSpeechGPT:
        """The co-speech GPT in eval mode."""
        return self._load("gpt", CoSpeechGPT(self.preset.gpt, self._speakers()))

    def refiner(self) -> Refiner:
        """The refiner in eval mode."""
        return self._load("refiner", Refiner(self.preset.refiner))

    def avd(self) -> AvdNetwork:
        """The disentanglement network in eval mode."""
        return self._load("avd", make_avd(self.preset.renderer))

    def generator(self, precision: str = "fp32") -> AngieGenerator:
        """The gesture generator on the CPU, all its parts in eval mode.

        Args:
            precision: of the GPT's large products: bfloat16 for "bf16" and "auto" where the
                processor has it natively and PyTorch can pack it; else float32. Rounding parts
                two sequences of codes where two codes are about equally likely; either is as good.

        Raises:
            BadInput: parts are missing or unusable.
        """
        wanted = [part for part in self.parts if part not in OPTIONAL]
        missing = [part for part in wanted if part not in self.manifest["parts"]]
        if missing and missing[0] != "renderer":
            stages = ", ".join(STAGE_OF.get(part, part) for part in missing)
            raise BadInput(
                f"{self.folder}: cannot gesture to sound yet; angie train DATASET -o "
                f"{self.folder} --resume trains what it lacks ({stages}); "
                "animate --drive VIDEO works without"
            )
        gpt = self.gpt() if "gpt" in self.parts else None
        if gpt is not None:
            pack(gpt, product_type(precision))
        vq, refiner, statistics = self.vq(), self.refiner(), self.statistics()
        errors = self.manifest["parts"]["vq"]["report"].get("decoding", {})
        chunked = errors.get("chunked", 1.0) < errors.get("full", 0.0)
        config = self.preset.generation
        return AngieGenerator(vq, gpt, refiner, statistics, config, chunked=chunked)

    def _speakers(self) -> int:
        """Speakers of the training set; only joint models need to know."""
        return len(self.statistics().speakers) if self.preset.gpt.joint else 1

    def _load(self, part: str, model: Any) -> Any:
        path = self.path_of(part)
        try:
            load_weights(model, load_file(path))
        except (SafetensorError, RuntimeError) as error:
            raise BadInput(f"{path}: does not fit the sizes in bundle.json") from error
        return model.eval().requires_grad_(False)


def _sizes(config: Any, part: str) -> dict[str, Any]:
    """Settings of a part's architecture as a mapping.

    A setting that came after bundles had been made is marked `metadata={"later": True}`; at its
    default, which must mean what was before it, it does not count: those bundles stay whole. One
    that concerns another part alone is marked `metadata={"of": part}` and counts at its default.
    """
    values: dict[str, Any] = {}
    for entry in dataclasses.fields(config):
        value = getattr(config, entry.name)
        if entry.metadata.get("of", part) != part:
            value = entry.default
        if entry.metadata.get("later") and value == entry.default:
            continue
        values[entry.name] = _sizes(value, part) if dataclasses.is_dataclass(value) else value
    return values


def load_weights(model: nn.Module, tensors: Mapping[str, Tensor]) -> None:
    """Load weights that may be stored in half precision into a float32 model."""
    wanted = model.state_dict()
    model.load_state_dict(
        {k: v.to(wanted[k].dtype) if k in wanted else v for k, v in tensors.items()}
    )


def halve(tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Float tensors in half precision, for bundles that have to be small."""
    return {
        k: v.half() if v.dtype == torch.float32 and v.ndim > 1 else v for k, v in tensors.items()
    }


def styles(bundle: Bundle) -> tuple[str, ...]:
    """Names of the training speakers that a joint model tells apart; none if it is not joint.

    Raises:
        BadInput: the model is joint, but was not measured on anyone yet.
    """
    return bundle.statistics().speakers if bundle.preset.gpt.joint else ()


def check_style(bundle: Bundle, style: str | None) -> None:
    """Refuse a style that a bundle does not have, before anything long begins.

    Args:
        bundle: a speaker bundle.
        style: name of a training speaker; None asks for nothing.

    Raises:
        BadInput: an unknown name, or a model that knows but one style.
    """
    if style is None:
        return
    if not bundle.preset.gpt.joint:
        raise BadInput(
            f"--style {style}: {bundle.folder} has one style alone; "
            "models trained with gpt.joint=true have one for each speaker"
        )
    bundle.statistics().place_of(style)


DEFAULT = Path(__file__).parent / "default"
"""Folder of the shipped files; all of it was drawn, spoken and trained by this project."""


BUNDLE = DEFAULT / "bundle"
"""Speaker bundle trained on the phantom speaker."""


PHOTO = DEFAULT / "photo.png"
"""A phantom presenter at rest."""


SPEECH = DEFAULT / "speech.flac"
"""Speech of the built-in synthesiser."""
