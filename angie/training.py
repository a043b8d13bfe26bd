"""Training a speaker bundle: renderer, motion, VQ, GPT, refiner, in this order."""

import hashlib
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from angie.bundle import Bundle
from angie.clips import MotionClip, read_clips
from angie.extraction import extract_dataset
from angie.presets import Preset, override
from angie.statistics import MotionStatistics, measure
from angie.train_gpt import train_gpt
from angie.train_refiner import train_refiner
from angie.train_vq import train_vq
from angie.windows import WINDOW, MotionWindows
from data_prep.dataset import Dataset
from data_prep.errors import BadInput
from data_prep.output import check_output
from data_prep.progress import console
from data_prep.rates import FPS
from data_prep.speaker import FACE_DOWN, SIDE_IN_FACES
from mraa.allocator import keep_memory
from mraa.losses import backend_of
from mraa.reconstruction import reconstruct
from mraa.run import RunConfig, native_precision
from mraa.training import train_renderer

STAGES = ("renderer", "motion", "vq", "gpt", "refiner")
"""Stages of training in their order; each makes one part of the bundle."""

PART_OF = {"motion": "statistics"}
"""Part that a stage makes, where it is not the stage's own name."""

HELD_OUT = 10
"""Every so many training clips one is kept from the motion stages to choose weights by."""


@dataclass
class Trainer:
    """What every stage needs: the data, the bundle, the seed and how to run."""

    dataset: Dataset
    bundle: Bundle
    seed: int
    run: RunConfig
    resume: bool

    def origin(self) -> dict[str, Any]:
        """What a part's report says of its data."""
        clips = self.dataset.clips("train")
        digest = hashlib.sha256((self.dataset.path / "meta.csv").read_bytes()).hexdigest()
        return {
            "dataset": self.dataset.path.resolve().name,
            "dataset_sha256": digest,
            "clips": len(clips),
            "minutes": round(sum(c.n_frames for c in clips) / FPS / 60, 2),
            "seed": self.seed,
        }

    def renderer(self) -> None:
        """Train the renderer and measure its self-reconstruction on the test clips."""
        preset = self.bundle.preset
        renderer = train_renderer(
            self.dataset,
            preset.renderer,
            preset.train_renderer,
            self.bundle.train,
            seed=self.seed,
            run_config=self.run,
            resume=self.resume,
        )
        score = reconstruct(renderer, self.dataset, self.dataset.clips("test"))
        self.bundle.manifest["speakers"] = sorted({c.speaker for c in self.dataset.clips()})
        self.bundle.manifest["crop"] = {"side_in_faces": SIDE_IN_FACES, "face_down": FACE_DOWN}
        report = {
            **self.origin(),
            "perceptual": backend_of(preset.train_renderer.perceptual_weights),
            "reconstruction": score.as_dict(),
        }
        self.bundle.add("renderer", renderer.state_dict(), report)
        console.print(
            f"renderer: L1 {score.l1:.4f}, PSNR {score.psnr:.2f} dB on held-out frames "
            f"(copying the source: {score.copy_l1:.4f}, {score.copy_psnr:.2f} dB)"
        )

    def motion(self) -> None:
        """Measure the region motion of all clips and its statistics."""
        estimator = self.bundle.renderer().estimator.to(self.run_device())
        folder, identity = self.bundle.train / "motion", self.bundle.hash_of("renderer")
        extract_dataset(self.dataset, estimator, folder, identity)
        statistics = measure(self.clips("train"))
        path = self.bundle.train / "statistics.safetensors"
        statistics.save(path)
        self.bundle.add("statistics", path, self.origin())

    def vq(self) -> None:
        """Train the VQ motion extractor."""
        preset = self.bundle.preset
        windows, _ = self.windows()
        vq = train_vq(self.bundle.train, windows, preset.vq, preset.train_vq, **self.how())
        self.bundle.add("vq", vq.state_dict(), self.origin())

    def gpt(self) -> None:
        """Train the co-speech GPT on the codes of the VQ motion extractor."""
        preset, vq = self.bundle.preset, self.bundle.vq()
        windows, held_out = self.windows()
        gpt = train_gpt(
            self.bundle.train, vq, windows, held_out, preset.gpt, preset.train_gpt, **self.how()
        )
        self.bundle.add("gpt", gpt.state_dict(), self.origin())

    def refiner(self) -> None:
        """Train the refiner on the patterns of the VQ motion extractor."""
        preset, vq = self.bundle.preset, self.bundle.vq()
        windows, held_out = self.windows()
        refiner = train_refiner(
            self.bundle.train,
            vq,
            windows,
            held_out,
            preset.refiner,
            preset.train_refiner,
            **self.how(),
        )
        self.bundle.add("refiner", refiner.state_dict(), self.origin())

    def clips(self, split: str) -> list[MotionClip]:
        """Motion and features of a split."""
        identity = self.bundle.hash_of("renderer")
        return read_clips(self.dataset, self.bundle.train / "motion", split, identity)

    def windows(self) -> tuple[MotionWindows, MotionWindows | None]:
        """Training windows, and those of every tenth training clip to choose weights by.

        The test split stays out of training altogether.
        """
        statistics: MotionStatistics = self.bundle.statistics()
        clips = self.clips("train")
        long = [clip for clip in clips if clip.motion.frames >= WINDOW]
        if len(long) < HELD_OUT:
            return MotionWindows(clips, statistics), None
        kept = long[HELD_OUT - 1 :: HELD_OUT]
        rest = [clip for clip in clips if all(clip is not other for other in kept)]
        return MotionWindows(rest, statistics), MotionWindows(kept, statistics)

    def how(self) -> dict[str, Any]:
        """Arguments that the motion stages share; they are small and stay in float32."""
        run = RunConfig(device=self.run.device, devices=self.run.devices)
        return {"seed": self.seed, "run_config": run, "resume": self.resume}

    def run_device(self) -> torch.device:
        """Device for work outside a training run."""
        cuda = self.run.device in ("auto", "cuda") and torch.cuda.is_available()
        return torch.device("cuda" if cuda else "cpu")


def train(
    dataset: Path,
    output: Path,
    *,
    preset: Preset | None = None,
    changes: dict[str, Any] | None = None,
    stage: str = "all",
    resume: bool = False,
    force: bool = False,
    seed: int = 0,
    run: RunConfig | None = None,
) -> Bundle:
    """Train the stages of a speaker bundle.

    Args:
        dataset: folder that `angie prepare` made.
        output: folder of the bundle.
        preset: sizes; for a bundle that exists already its own are kept.
        changes: settings that differ from the preset (or from the bundle's own).
        stage: one of `STAGES`, or "all".
        resume: go on with an interrupted training; finished stages are kept.
        force: throw an existing bundle away first.
        seed: everything random follows from it.
        run: device, precision and so on.

    Raises:
        BadInput: no dataset, unknown stage or setting, or a bundle that exists already.
    """
    if stage not in (*STAGES, "all"):
        raise BadInput(f"--stage {stage}: there are {', '.join(STAGES)} and all")
    data = Dataset(dataset)
    bundle = _open_or_create(Path(output), preset, changes or {}, stage, resume, force)
    run = run or RunConfig()
    if run.precision == "auto":
        run = RunConfig(**{**vars(run), "precision": native_precision(run.device)})
    keep_memory()
    trainer = Trainer(data, bundle, seed, run, resume)
    for name in STAGES if stage == "all" else (stage,):
        if stage == "all" and resume and bundle.has(PART_OF.get(name, name)):
            console.print(f"{name}: done before")
            continue
        action: Callable[[], None] = getattr(trainer, name)
        action()
    return bundle


def _open_or_create(
    output: Path,
    preset: Preset | None,
    changes: dict[str, Any],
    stage: str,
    resume: bool,
    force: bool,
) -> Bundle:
    exists = (output / "bundle.json").exists()
    if exists and force and not resume:
        check_output(output, force=True)
        shutil.rmtree(output)
        exists = False
    if not exists:
        if output.is_dir() and any(output.iterdir()):
            raise BadInput(f"{output}: holds other files; name a new folder for the bundle")
        check_output(output, force=output.is_dir())
        return Bundle.create(output, override(preset or Preset(), changes))
    if not resume and stage == "all":
        raise BadInput(f"{output}: exists already; go on with --resume or start anew with --force")
    bundle = Bundle.open(output)
    if preset is not None and preset.name != bundle.preset.name:
        raise BadInput(
            f"{output}: made with --preset {bundle.preset.name}; leave --preset out to go on"
        )
    if changes:
        changed = Bundle.create(output, override(bundle.preset, changes))
        changed.manifest.update(
            {key: bundle.manifest[key] for key in ("speakers", "crop", "parts")}
        )
        changed.write()
        return changed
    return bundle
