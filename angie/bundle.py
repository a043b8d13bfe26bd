"""Speaker bundles: a folder with `bundle.json` and one safetensors file a part.

    bundle.json                 format, settings, speakers, crop, hashes, what was trained on what
    renderer.safetensors        region estimator, background, flow, image generator
    statistics.safetensors      scales, ranges and rest poses of the motion
    avd.safetensors             the renderer's disentanglement network; optional, for driving videos
    GENERATOR.PART.safetensors  weights or data of a gesture generator; there may be several
    train/                      checkpoints, curves and caches of training; may be deleted

Every part remembers the hashes of what it was trained on; loading refuses others. Motion knows of
the renderer only its region estimator, so that one that draws better may take its place.

What ships with the package: a speaker bundle, a photo and a recording of our own.
"""

import dataclasses
import json
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from safetensors import SafetensorError
from torch import Tensor

from angie import __version__
from angie.config import Preset, stored
from angie.generators import DEFAULT as DEFAULT_GENERATOR
from angie.generators import family, upgraded
from angie.generators.base import GestureGenerator
from angie.motion.statistics import MotionStatistics
from angie.parts import (
    OPTIONAL,
    REGIONS,
    UPSTREAM,
    changed,
    hash_of_regions,
    load_weights,
    sizes_of,
    source_commit,
    stage_options,
    upstream_of,
)
from data_prep.errors import BadInput
from data_prep.files import sha256, whole_file
from data_prep.rates import FPS, IMAGE_SIZE
from data_prep.tensors import load_tensors, save_tensors
from mraa.avd import AvdNetwork
from mraa.renderer import Renderer, make_avd

FORMAT = 3
"""Version of the bundle's layout; loading refuses newer ones and reads formats 1 and 2."""

TRAIN = "train"
"""Folder in a bundle for checkpoints, curves and caches."""

SAFE = re.compile(r"[\w.-]+\.safetensors")
"""Names of files in a bundle's own folder."""

_ENTRY = {"file", "sha256", "upstream", "settings", "report"}


@dataclass
class Bundle:
    """A bundle folder and its manifest; parts are read when asked for."""

    folder: Path
    manifest: dict[str, Any]
    preset: Preset
    format: int = FORMAT
    """Of the manifest as it was read; it is written in the newest one."""

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
            "config": {},
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
            manifest = json.loads(path.read_bytes())
            version = manifest["format"]
            if version > FORMAT:
                raise BadInput(f"bundle format {version} is newer than {FORMAT}; update angie")
            if version == 1:
                manifest = upgraded(manifest)
            preset = stored(manifest["config"])
            bundle = cls(folder, manifest, preset, version)
            for part, entry in manifest["parts"].items():
                if entry.keys() - {REGIONS} != _ENTRY or not SAFE.fullmatch(entry["file"]):
                    raise BadInput(f"{part} is not described as it should be")
                if entry["settings"] is None:
                    entry["settings"] = bundle.sizes_of(part)
            texts = [manifest[key] for key in ("angie", "preset", "size", "fps", "crop")]
            if not all(isinstance(name, str) for name in manifest["speakers"]) or not texts:
                raise BadInput("speakers must be names")
        except BadInput as error:
            raise BadInput(f"{path}: {error}") from error
        except KeyError as error:
            raise BadInput(f"{path}: lacks {error.args[0]!r}; copy the bundle again") from error
        except (OSError, ValueError, TypeError, AttributeError) as error:
            told = isinstance(error, OSError | ValueError)
            reason = " ".join(str(error).split()) if told else "an entry is of another kind"
            raise BadInput(f"{path}: damaged ({reason}); copy the bundle again") from error
        return bundle

    def write(self) -> None:
        """Write the manifest, whole or not at all."""
        self.manifest |= {"format": FORMAT, "config": dataclasses.asdict(self.preset)}
        with whole_file(self.folder / "bundle.json", force=True) as part:
            part.write_text(json.dumps(self.manifest, indent=1) + "\n")

    @property
    def train(self) -> Path:
        """Folder for checkpoints, curves and caches of training."""
        return self.folder / TRAIN

    @property
    def generators(self) -> list[str]:
        """Names of the generators that the bundle has, or that are to be trained."""
        return list(self.preset.generators)

    def chosen(self, name: str | None = None) -> str:
        """Name of the generator that is meant; None is the default one, else the first.

        Raises:
            BadInput: the bundle has no such generator.
        """
        there = self.generators
        if name is None and there:
            return DEFAULT_GENERATOR if DEFAULT_GENERATOR in there else there[0]
        if name not in there:
            known = ", ".join(there) or "none"
            raise BadInput(
                f"--generator {name or DEFAULT_GENERATOR}: {self.folder} has {known}; "
                "angie train DATASET -o BUNDLE --generator NAME adds one"
            )
        return name

    def settings(self, family: str) -> Any:
        """Settings of a generator."""
        return self.preset.settings(family)

    @property
    def parts(self) -> list[str]:
        """Parts that a whole bundle with these generators has, in the order of training."""
        own = [part for name in self.generators for part in self.parts_of(name)]
        return [part for part in [*UPSTREAM, *own] if part not in OPTIONAL and self._used(part)] + [
            part for part in OPTIONAL if self._used(part)
        ]

    def parts_of(self, generator: str) -> list[str]:
        """Parts of one generator in the order of training; not installed, those that are there."""
        try:
            stages = family(generator).wanted(self.settings(generator))
        except BadInput:
            return [part for part in self.manifest["parts"] if part.startswith(f"{generator}.")]
        return [f"{generator}.{stage.name}" for stage in stages]

    def needed(self, generator: str | None = None) -> list[str]:
        """Parts that gesturing to speech with a generator needs."""
        shared = [part for part in UPSTREAM if part not in OPTIONAL and self._used(part)]
        return [*shared, *self.parts_of(self.chosen(generator))]

    def _used(self, part: str) -> bool:
        """Whether there is such a part; models of joints draw nothing."""
        return not (self.preset.points and part in ("renderer", "avd"))

    def upstream(self, part: str) -> list[str]:
        """Parts of this bundle that a part is trained on."""
        there = self.parts
        return [name for name in upstream_of(part, self.preset) if name in there]

    def has(self, part: str) -> bool:
        """Whether a part is whole, of the present sizes, and trained on the present parts."""
        try:
            self.path_of(part)
        except BadInput:
            return False
        return True

    def sizes_of(self, part: str) -> dict[str, Any]:
        """The settings that a part depends on, as plain values."""
        return sizes_of(part, self.preset)

    def hash_of(self, part: str) -> str:
        """Hash of a part as the manifest states it."""
        return str(self.manifest["parts"][part]["sha256"])

    def regions(self) -> str:
        """Hash of the region estimator; BadInput where there is no usable renderer."""
        path = self.path_of("renderer")
        entry = self.manifest["parts"]["renderer"]
        if REGIONS not in entry:  # of format 2
            entry[REGIONS] = hash_of_regions(path)
        return str(entry[REGIONS])

    def chain(self, part: str) -> dict[str, str]:
        """Hashes of what a part is trained on, by name."""
        parts = self.upstream(part)
        known = {name: self.hash_of(name) for name in parts if name != "renderer"}
        return {REGIONS: self.regions(), **known} if "renderer" in parts else known

    def motion_identity(self, data: str) -> str:
        """What the motion of a dataset with the hash `data` is measured by and on."""
        statistics = self.manifest["parts"].get("statistics", {"upstream": {}})
        before = statistics["upstream"].get("renderer")
        return f"{before if before == self.hash_of('renderer') else self.regions()}-{data}"

    def _fits(self, part: str, name: str) -> bool:
        """Whether a part was trained on the present part `name`."""
        before = self.manifest["parts"][part]["upstream"]
        if name == "renderer" and REGIONS in before:
            return bool(before[REGIONS] == self.regions())
        return bool(before.get(name) == self.hash_of(name))

    def name_regions(self) -> None:
        """Let the parts that were trained on the present renderer name its regions alone."""
        if "renderer" not in self.manifest["parts"]:
            return
        for entry in self.manifest["parts"].values():
            before = entry["upstream"]
            if before.get("renderer") == self.hash_of("renderer"):
                del before["renderer"]
                before[REGIONS] = self.regions()

    def report(self, part: str) -> dict[str, Any]:
        """What was said of a part when it was trained."""
        report: dict[str, Any] = self.manifest["parts"][part]["report"]
        return report

    def add(self, part: str, tensors: Mapping[str, Tensor] | Path, report: dict[str, Any]) -> None:
        """Put a trained part into the bundle.

        Args:
            part: name of the part.
            tensors: its state, or a safetensors file to take (it is moved).
            report: what it was trained on and how well it does.
        """
        path = self.folder / f"{part}.safetensors"
        if part == "renderer" and self.has(part):
            self.name_regions()
        if isinstance(tensors, Path):
            os.replace(tensors, path)
        else:
            with whole_file(path, force=True) as new:
                save_tensors(new, {k: v.detach().contiguous().cpu() for k, v in tensors.items()})
        self.manifest["parts"][part] = {
            "file": path.name,
            "sha256": sha256(path),
            "upstream": self.chain(part),
            "settings": self.sizes_of(part),
            "report": {"angie": __version__, "commit": source_commit(), **report},
        }
        if part == "renderer":
            self.manifest["parts"][part][REGIONS] = hash_of_regions(path)
        self.write()

    def path_of(self, part: str) -> Path:
        """File of a part, after checking that it is whole and fits its upstream.

        Raises:
            BadInput: missing, changed, or trained on other parts.
        """
        if part not in self.parts and self.preset.points:
            raise BadInput(
                f"{self.folder}: is a model of joints, which draws no pictures; angie gestures "
                "writes its motion"
            )
        entry, how = self.manifest["parts"].get(part), f"angie train {stage_options(part)}"
        if entry is None:
            raise BadInput(f"{self.folder}: has no {part} yet; run {how}")
        path = self.folder / entry["file"]
        if not path.is_file():
            raise BadInput(f"{path}: missing from the bundle; copy it again or run {how}")
        if sha256(path) != entry["sha256"]:
            raise BadInput(f"{path}: not the file that bundle.json describes (wrong hash)")
        other = changed(part, entry["settings"], self.preset)
        if other:
            raise BadInput(
                f"{self.folder}: {part} was trained with other settings than bundle.json states "
                f"({other}); run {how} again"
            )
        for name in self.upstream(part):
            self.path_of(name)
            if not self._fits(part, name):
                other = "renderer with other regions" if name == "renderer" else name
                raise BadInput(
                    f"{self.folder}: {part} was trained on another {other}; run {how} again"
                )
        return path

    def tensors(self, part: str) -> dict[str, Tensor]:
        """Tensors of a part.

        Raises:
            BadInput: see `path_of`, or not a safetensors file.
        """
        path = self.path_of(part)
        try:
            return load_tensors(path)
        except SafetensorError as error:
            raise BadInput(f"{path}: does not fit the sizes in bundle.json") from error

    def load(self, part: str, model: Any) -> Any:
        """Put a part's weights into `model`; it comes back in eval mode, without gradients.

        Raises:
            BadInput: see `path_of`, or weights of other sizes.
        """
        tensors = self.tensors(part)
        try:
            load_weights(model, tensors)
        except RuntimeError as error:
            path = self.folder / self.manifest["parts"][part]["file"]
            raise BadInput(f"{path}: does not fit the sizes in bundle.json") from error
        return model.eval().requires_grad_(False)

    def renderer(self) -> Renderer:
        """The renderer in eval mode."""
        renderer: Renderer = self.load("renderer", Renderer(self.preset.renderer))
        return renderer

    def statistics(self) -> MotionStatistics:
        """Normalisation and ranges of the motion."""
        return MotionStatistics.load(self.path_of("statistics"))

    def avd(self) -> AvdNetwork:
        """The disentanglement network in eval mode."""
        avd: AvdNetwork = self.load("avd", make_avd(self.preset.renderer))
        return avd

    def generator(self, name: str | None = None, *, precision: str = "fp32") -> GestureGenerator:
        """A gesture generator on the CPU, all its parts in eval mode.

        Args:
            name: of its family; None is the default one, else the first that the bundle has.
            precision: of large products, "fp32", "bf16" or "auto"; see the family's `load`.

        Raises:
            BadInput: parts are missing or unusable.
        """
        name = self.chosen(name)
        missing = [part for part in self.needed(name) if part not in self.manifest["parts"]]
        if missing and missing[0] != "renderer":
            stages = ", ".join(stage_options(part).split()[-1] for part in missing)
            option = "" if name == DEFAULT_GENERATOR else f" --generator {name}"
            raise BadInput(
                f"{self.folder}: cannot gesture to sound yet; angie train DATASET -o "
                f"{self.folder} --resume{option} trains what it lacks ({stages}); "
                "animate --drive VIDEO works without"
            )
        return family(name).load(self, precision)


DEFAULT = Path(__file__).parent / "default"
"""Folder of the shipped files; all of it was drawn, spoken and trained by this project."""


BUNDLE = DEFAULT / "bundle"
"""Speaker bundle trained on the phantom speaker."""


PHOTO = DEFAULT / "photo.png"
"""A phantom presenter at rest."""


SPEECH = DEFAULT / "speech.flac"
"""Speech of the built-in synthesiser."""


WORDS = DEFAULT / "words.json"
"""What is said in it."""
