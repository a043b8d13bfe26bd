"""Training a speaker bundle: renderer, motion, VQ, GPT, refiner, in this order; AVD if asked."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from lightning_fabric import Fabric
from numpy.typing import NDArray

from angie.bundle import OPTIONAL, STAGE_OF, TRAIN, UPSTREAM, Bundle
from angie.config import Preset, of_points
from angie.generators.angie.direct import DirectMotion
from angie.generators.angie.report import gpt_report, vq_report
from angie.generators.angie.tokenizer import VQMotionExtractor
from angie.generators.angie.train_direct import train_direct
from angie.generators.angie.train_gpt import train_gpt
from angie.generators.angie.train_refiner import train_refiner
from angie.generators.angie.train_vq import train_vq
from angie.motion.clips import MotionClip, read_clips
from angie.motion.keypoints import INDEX, KeypointClip, KeypointDataset
from angie.motion.statistics import MotionStatistics, measure
from angie.motion.windows import WINDOW, MotionWindows, other_grids
from angie.opening import initial_weights, open_or_create, teacher_of
from data_prep.dataset import Clip, Dataset
from data_prep.errors import BadInput
from data_prep.files import check_apart
from data_prep.progress import console
from data_prep.rates import FPS
from data_prep.speaker.crop import FACE_DOWN, SIDE_IN_FACES
from mraa.extract import extract_dataset
from mraa.motion import Motion, read_motion
from mraa.perceptual import PerceptualDistance
from mraa.reconstruction import reconstruct, spread
from mraa.training.avd import recovery, train_avd
from mraa.training.devices import keep_memory
from mraa.training.renderer import train_renderer
from mraa.training.run import RunConfig, launch, native_precision

PART_OF = {STAGE_OF.get(part, part): part for part in UPSTREAM}
"""Part of the bundle that each stage of training makes, in their order."""

STAGES = tuple(PART_OF)

HELD_OUT = 10
"""Every so many training clips one is kept from the motion stages to choose weights by, where the
split "val" of the dataset has none."""


@dataclass
class Trainer:
    """What every stage needs: the data, the bundle, the seed and how to run."""

    dataset: Dataset | KeypointDataset
    bundle: Bundle
    seed: int
    run: RunConfig
    resume: bool
    fabric: Fabric
    speaker: str | None = None

    @property
    def data_digest(self) -> str:
        """Hash of what the dataset says of its sources, crops and clips."""
        return self.dataset.digest

    def check_dataset(self, part: str) -> None:
        """Refuse to go on from a part that was trained on other data.

        Raises:
            BadInput: the hash of the dataset that the part was trained on is another one.
        """
        report = self.bundle.manifest["parts"][part]["report"]
        if "imported" not in report and report.get("dataset_sha256") != self.data_digest:
            raise BadInput(
                f"{self.bundle.folder}: {part} was trained on another dataset than "
                f"{self.dataset.path}; give that one, or --force to start anew"
            )

    def publish(self, part: str, make: Callable[[], Any], **report: Any) -> None:
        """Put what `make` returns into the bundle as a part: once, whatever the processes."""
        if self.fabric.global_rank == 0:
            clips = [clip for clip in self.dataset.clips("train") if self.wanted(clip)]
            origin = {
                "dataset": self.dataset.path.resolve().name,
                "dataset_sha256": self.data_digest,
                "clips": len(clips),
                "minutes": round(sum(c.n_frames for c in clips) / FPS / 60, 2),
                "seed": self.seed,
            }
            self.bundle.add(part, make(), {**origin, **report})
        self.fabric.barrier()
        self.bundle = Bundle.open(self.bundle.folder)

    def renderer(self) -> None:
        """Train the renderer and measure its self-reconstruction on the test clips."""
        assert isinstance(self.dataset, Dataset)  # joints have no renderer
        preset = self.bundle.preset
        training = preset.train_renderer
        if training.initial:
            weights = initial_weights(training, preset.renderer)
            training = replace(training, initial=str(weights))
        renderer = train_renderer(
            self.dataset,
            preset.renderer,
            training,
            self.bundle.train,
            seed=self.seed,
            run_config=self.how("renderer", self.run.precision),
            resume=self.resume,
            teacher=teacher_of(training, preset.renderer),
        )
        report: dict[str, Any] = {
            "perceptual": preset.train_renderer.backend,
            "precision": self.run.precision,
        }
        tests = self.dataset.clips("test")
        if tests and self.fabric.global_rank == 0:
            measure_by = PerceptualDistance(preset.train_renderer.perceptual_weights)
            some = spread(tests)
            score = reconstruct(renderer, self.dataset, some, perceptual=measure_by)
            report["reconstruction"] = {**score.as_dict(), "clips": len(some)}
            console.print(f"renderer, on held-out frames: {score}", soft_wrap=True)
        self.bundle.manifest["speakers"] = self.dataset.speakers()
        self.bundle.manifest["crop"] = {"side_in_faces": SIDE_IN_FACES, "face_down": FACE_DOWN}
        self.publish("renderer", renderer.state_dict, **report)

    def motion(self) -> None:
        """Measure the motion of all clips, if it is not given, and its statistics."""
        path = self.bundle.train / "statistics.safetensors"

        def make() -> Path:
            if isinstance(self.dataset, Dataset):
                self.extract()
            path.parent.mkdir(parents=True, exist_ok=True)
            measure([clip for clip in self.clips("train") if self.wanted(clip)]).save(path)
            return path

        speakers = self.dataset.speakers() if self.speaker is None else [self.speaker]
        self.bundle.manifest["speakers"] = speakers
        self.publish("statistics", make)

    def extract(self) -> None:
        """Measure the region motion of all clips that have not been measured yet."""
        assert isinstance(self.dataset, Dataset)  # joints are given
        estimator = self.bundle.renderer().estimator.to(self.fabric.device)
        extract_dataset(
            self.dataset,
            estimator,
            self.motion_folder,
            self.motion_identity,
            jobs=self.run.workers,
        )

    def vq(self) -> None:
        """Train the VQ motion extractor, or the regression in its place without codes."""
        preset = self.bundle.preset
        stride = preset.train_vq.stride
        if preset.vq.quant == "no_quant":
            windows, held_out = self.windows(preset.train_gpt.stride, preset.train_gpt.grids)
            direct = train_direct(
                self.bundle.train,
                windows,
                held_out,
                preset.vq,
                preset.gpt,
                preset.train_gpt,
                seed=self.seed,
                run_config=self.how("vq"),
                resume=self.resume,
            )
            self.publish("vq", direct.state_dict)
            return
        windows, held_out = self.windows(stride)
        vq = train_vq(
            self.bundle.train,
            windows,
            held_out,
            preset.vq,
            preset.train_vq,
            seed=self.seed,
            run_config=self.how("vq"),
            resume=self.resume,
        )
        self.publish("vq", vq.state_dict, **vq_report(vq, windows, held_out))

    def extractor(self) -> VQMotionExtractor | DirectMotion:
        """The VQ motion extractor, or what stands in its place.

        Raises:
            BadInput: its mean and its way of decoding were measured in another context.
        """
        vq, report = self.bundle.vq(), self.bundle.manifest["parts"]["vq"]["report"]
        context = self.bundle.preset.vq.context
        if isinstance(vq, VQMotionExtractor) and report.get("context", "window") != context:
            raise BadInput(
                f"{self.bundle.folder}: the codes were not measured for vq.context={context}; "
                "--stage vq --resume does that"
            )
        return vq

    def gpt(self) -> None:
        """Train the co-speech GPT on the codes of the VQ motion extractor."""
        preset, vq = self.bundle.preset, self.extractor()
        assert isinstance(vq, VQMotionExtractor)  # without codes there is no such stage
        windows, held_out = self.windows(preset.train_gpt.stride, preset.train_gpt.grids)
        gpt = train_gpt(
            self.bundle.train,
            vq,
            windows,
            held_out,
            preset.gpt,
            preset.train_gpt,
            seed=self.seed,
            run_config=self.how("gpt"),
            resume=self.resume,
        )
        self.publish("gpt", gpt.state_dict, **gpt_report(gpt, vq.cpu(), windows, held_out))

    def refiner(self) -> None:
        """Train the refiner on the patterns of the VQ motion extractor."""
        preset, vq = self.bundle.preset, self.extractor()
        windows, held_out = self.windows(preset.train_refiner.stride)
        refiner = train_refiner(
            self.bundle.train,
            vq,
            windows,
            held_out,
            preset.refiner,
            preset.train_refiner,
            seed=self.seed,
            run_config=self.how("refiner"),
            resume=self.resume,
        )
        self.publish("refiner", refiner.state_dict)

    def avd(self) -> None:
        """Train the disentanglement network on the region motion of the clips."""
        preset = self.bundle.preset
        if self.fabric.global_rank == 0:
            self.extract()
        self.fabric.barrier()
        avd = train_avd(
            self.bundle.train,
            self.motions("train"),
            preset.renderer,
            preset.train_avd,
            seed=self.seed,
            run_config=self.how("avd"),
            resume=self.resume,
        )
        report: dict[str, Any] = {}
        tests = self.motions("test")
        if tests and self.fabric.global_rank == 0:
            score = recovery(avd, tests, preset.renderer, preset.train_avd.scale)
            report["recovery"] = asdict(score)
            console.print(f"avd, on held-out clips: {score}", soft_wrap=True)
        self.publish("avd", avd.state_dict, **report)

    @property
    def motion_folder(self) -> Path:
        """Where the region motion of the clips is kept."""
        return self.bundle.train / "motion"

    @property
    def motion_identity(self) -> str:
        """What the region motion was measured by and on."""
        return f"{self.bundle.hash_of('renderer')}-{self.data_digest}"

    def clips(self, split: str) -> list[MotionClip]:
        """Motion and features of a split."""
        if isinstance(self.dataset, KeypointDataset):
            return self.dataset.motion_clips(split)
        return read_clips(self.dataset, self.motion_folder, split, self.motion_identity)

    def sound(self, name: str) -> NDArray:
        """Sound (N,) of a clip, float32 mono at 16 kHz."""
        if isinstance(self.dataset, KeypointDataset):
            return self.dataset.sound(name)
        return self.dataset.sound(next(c for c in self.dataset.clips() if c.id == name))

    def wanted(self, clip: Clip | KeypointClip | MotionClip) -> bool:
        """Whether a clip of the dataset is of the bundle's speakers."""
        return clip.speaker in self.bundle.manifest["speakers"]

    def motions(self, split: str) -> list[Motion]:
        """Motion alone of a split, for clips with and without sound."""
        return [
            read_motion(self.motion_folder / f"{clip.id}.npz", self.motion_identity)
            for clip in self.dataset.clips(split)
        ]

    def windows(self, stride: int, grids: int = 1) -> tuple[MotionWindows, MotionWindows | None]:
        """Training windows, and those of other clips to choose weights by.

        These are of the split "val", or where it has none of this length, every tenth training
        clip. The test split stays out of training altogether.

        Args:
            stride: frames from one training window to the next; the others are 32 apart.
            grids: of tokens, on which training clips are read (`GPTTraining.grids`).

        Raises:
            BadInput: no clip is as long as a window.
        """
        statistics: MotionStatistics = self.bundle.statistics()
        clips, kept = (self._long_clips(split, statistics.speakers) for split in ("train", "val"))
        if not clips:
            raise _too_short(self.dataset.path)
        if not kept:
            kept = clips[HELD_OUT - 1 :: HELD_OUT]
            clips = [clip for i, clip in enumerate(clips, 1) if i % HELD_OUT]
        clips = [*clips, *other_grids(clips, self.sound, grids)]
        windows = MotionWindows(clips, statistics, stride=stride)
        return windows, MotionWindows(kept, statistics) if kept else None

    def _long_clips(self, split: str, speakers: Sequence[str]) -> list[MotionClip]:
        """Clips, as long as a window, of speakers; others have no style that could be learnt."""
        clips = [clip for clip in self.clips(split) if clip.speaker in speakers]
        return [clip for clip in clips if clip.motion.frames >= WINDOW]

    def how(self, part: str, precision: str = "32-true") -> RunConfig:
        """How to run a stage; those of motion are small and stay in float32."""
        upstream = [self.bundle.hash_of(name) for name in self.bundle.upstream(part)]
        words = [part, self.bundle.sizes_of(part), str(self.seed), self.data_digest, *upstream]
        preset = self.bundle.preset
        onsets = part == "gpt" or (part == "vq" and preset.vq.quant == "no_quant")
        if onsets and preset.train_gpt.grids > 1:  # other windows than those of one grid
            words.append(f"{preset.train_gpt.grids} grids")
        identity = hashlib.sha256(" ".join(words).encode()).hexdigest()
        return replace(self.run, precision=precision, identity=identity)


def open_data(folder: Path, output: Path) -> Dataset | KeypointDataset:
    """A dataset of videos, or one of joints if the folder holds `clips.csv`."""
    if (folder / INDEX).is_file():
        return KeypointDataset(folder, output / TRAIN / "features")
    return Dataset(folder)


def _too_short(folder: Path) -> BadInput:
    return BadInput(
        f"{folder}: no training clip has {WINDOW} frames at {FPS} a second, as long as a window; "
        "longer clips are needed"
    )


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
    speaker: str | None = None,
    run: RunConfig | None = None,
) -> Bundle:
    """Train the stages of a speaker bundle.

    Args:
        dataset: folder that `angie prepare` made, or a folder of joints (`angie.motion.keypoints`).
        output: folder of the bundle.
        preset: sizes; for a bundle that exists already its own are kept.
        changes: settings that differ from the preset (or from the bundle's own).
        stage: one of `STAGES`, or "all": those that gesturing to speech needs, and "avd" where
            `train_avd.with_all` is set.
        resume: go on with an interrupted training; finished stages are kept.
        force: throw an existing bundle away first.
        seed: everything random follows from it.
        speaker: whose motion alone is learnt; None learns that of all. The motion stage settles
            it for those after it.
        run: device, precision and so on.

    Raises:
        BadInput: no dataset, unknown stage or setting, or a bundle that exists already.
    """
    if stage not in (*STAGES, "all"):
        raise BadInput(f"--stage {stage}: there are {', '.join(STAGES)} and all")
    check_apart(output, [dataset])
    data = open_data(dataset, output)
    if speaker is not None and speaker not in data.speakers():
        raise BadInput(f"--speaker {speaker}: {dataset} has {', '.join(data.speakers())}")
    if not data.clips("train"):
        raise BadInput(f"{dataset}: has no clips to train on; prepare more videos")
    lengths = [c.n_frames for c in data.clips("train") if speaker in (None, c.speaker)]
    if stage == "all" and max(lengths, default=0) < WINDOW:
        raise _too_short(dataset)  # before hours of the renderer's training, which would do
    if isinstance(data, KeypointDataset):
        preset = None if preset is None else of_points(preset, data.joints())
        data.check_sound()
    run = run or RunConfig()
    if run.precision == "auto":
        run = replace(run, precision=native_precision(run.device))
    fabric = launch(run)
    if fabric.global_rank == 0:
        open_or_create(Path(output), preset, changes or {}, stage, resume, force)
    fabric.barrier()
    keep_memory()
    bundle = Bundle.open(output)
    measured = bundle.manifest["speakers"] if bundle.has("statistics") else [speaker]
    if speaker is not None and stage != "motion" and measured != [speaker]:
        raise BadInput(
            f"--speaker {speaker}: {output} was measured on others; --stage motion first"
        )
    trainer = Trainer(data, bundle, seed, run, resume, fabric, speaker)
    if isinstance(data, KeypointDataset) != trainer.bundle.preset.points:
        raise BadInput(f"{output}: regions and joints do not mix; name another folder")
    for name in _stages(stage, trainer.bundle):
        if stage == "all" and resume and trainer.bundle.has(PART_OF[name]):
            trainer.check_dataset(PART_OF[name])
            console.print(f"{name}: done before")
            continue
        action: Callable[[], None] = getattr(trainer, name)
        action()
    return trainer.bundle


def _stages(stage: str, bundle: Bundle) -> list[str]:
    """Stages to run for `--stage`; the motion of an imported renderer is measured by the way.

    Raises:
        BadInput: a stage that a model of joints, or one without codes, does not have.
    """
    stages = [name for name in STAGES if PART_OF[name] in bundle.parts]
    if stage not in (*stages, "all"):
        raise BadInput(f"--stage {stage}: this bundle has {', '.join(stages)}")
    if stage == "vq" and not bundle.has("statistics"):
        return ["motion", "vq"]
    if stage != "all":
        return [stage]
    with_avd = bundle.preset.train_avd.with_all
    return [name for name in stages if with_avd or PART_OF[name] not in OPTIONAL]
