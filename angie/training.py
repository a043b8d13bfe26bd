"""Training a speaker bundle: renderer, motion, the stages of a generator; AVD if asked."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from lightning_fabric import Fabric
from numpy.typing import NDArray

from angie.bundle import Bundle
from angie.config import Preset, of_points
from angie.generators import family
from angie.generators.base import Family
from angie.generators.stages import Stage, StageContext, digest
from angie.motion.clips import MotionClip, read_clips
from angie.motion.keypoints import KeypointClip, KeypointDataset
from angie.motion.statistics import measure
from angie.opening import (
    check_data,
    initial_weights,
    open_data,
    open_or_create,
    shares_of,
    teacher_of,
)
from data_prep.dataset import Clip, Dataset
from data_prep.errors import BadInput, check_choice, check_seed
from data_prep.files import alone, check_apart
from data_prep.progress import console
from data_prep.rates import FPS
from data_prep.speaker.crop import FACE_DOWN, SIDE_IN_FACES
from mraa.extract import extract_dataset
from mraa.motion import Motion, read_motion
from mraa.perceptual import PerceptualDistance
from mraa.reconstruction import reconstruct, spread
from mraa.renderer import Renderer
from mraa.training.avd import recovery, train_avd
from mraa.training.devices import keep_memory
from mraa.training.pairs import Share
from mraa.training.renderer import train_renderer
from mraa.training.run import RunConfig, launch, native_precision


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
    also: Sequence[Share] = ()

    @property
    def data_digest(self) -> str:
        """Hash of what the dataset says of its sources, crops and clips."""
        return self.dataset.digest

    def check_dataset(self, part: str) -> None:
        """Refuse to go on from a part that was trained on other data.

        Raises:
            BadInput: the hash of the dataset that the part was trained on is another one.
        """
        report = self.bundle.report(part)
        if "imported" not in report and report.get("dataset_sha256") != self.data_digest:
            raise BadInput(
                f"{self.bundle.folder}: {part} was trained on another dataset than "
                f"{self.dataset.path}; give that one, or --force to start anew"
            )

    def publish(self, part: str, make: Callable[[], Any], **report: Any) -> None:
        """Put what `make` returns into the bundle as a part: once, whatever the processes."""
        if self.fabric.global_rank == 0:
            everyone = part == "renderer"  # whose motion is learnt counts for the others
            clips = [c for c in self.dataset.clips("train") if everyone or self.wanted(c)]
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
            run_config=self.how(
                "renderer", self.run.precision, {"also": self.others} if self.also else None
            ),
            resume=self.resume,
            teacher=teacher_of(training, preset.renderer),
            also=self.also,
        )
        report: dict[str, Any] = {"perceptual": training.backend, "precision": self.run.precision}
        origin = Path(preset.train_renderer.initial)
        if preset.train_renderer.initial and origin.is_dir():
            before = Bundle.open(origin)
            report["initial"] = before.hash_of("renderer")
            if "credits" in before.report("renderer"):
                report["credits"] = before.report("renderer")["credits"]
        if self.fabric.global_rank == 0:
            report |= self.measured(renderer)
        if not self.bundle.has("statistics"):  # else they are whose motion it is
            self.bundle.manifest["speakers"] = self.dataset.speakers()
        self.bundle.manifest["crop"] = {"side_in_faces": SIDE_IN_FACES, "face_down": FACE_DOWN}
        self.publish("renderer", renderer.state_dict, **report)

    def measured(self, renderer: Renderer) -> dict[str, Any]:
        """How well a renderer reconstructs test clips of each dataset, for its report."""
        assert isinstance(self.dataset, Dataset)
        measure_by = PerceptualDistance(self.bundle.preset.train_renderer.perceptual_weights)
        own: dict[str, Any] = {}
        entries = [own, *self.others]
        datasets = [self.dataset, *(share.dataset for share in self.also)]
        for entry, data in zip(entries, datasets, strict=True):
            some = spread(data.clips("test"))
            if some:
                score = reconstruct(renderer, data, some, perceptual=measure_by)
                entry["reconstruction"] = {**score.as_dict(), "clips": len(some)}
                of = f" of {data.path.name}" if self.also else ""
                console.print(f"renderer, on held-out frames{of}: {score}", soft_wrap=True)
        return own | ({"also": entries[1:]} if self.also else {})

    @property
    def others(self) -> list[dict[str, Any]]:
        """The further datasets that the renderer learns from, for reports."""
        return [
            {
                "dataset": share.dataset.path.resolve().name,
                "sha256": share.dataset.digest,
                "weight": share.weight,
                "clips": len(clips := share.dataset.clips("train")),
                "minutes": round(sum(c.n_frames for c in clips) / FPS / 60, 2),
            }
            for share in self.also
        ]

    def motion(self) -> None:
        """Measure the motion of all clips, if it is not given, and its statistics."""
        path = self.bundle.train / "statistics.safetensors"
        self.bundle.name_regions()

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
            self.dataset, estimator, self.motion_folder, self.motion_identity, jobs=self.run.workers
        )

    def generator(self, family: Family, stage: Stage) -> None:
        """Train a stage of a generator."""
        context = self.context(family, stage)
        trained = stage.train(context)
        report = trained.report | ({"steps": context.steps} if context.steps else {})
        self.publish(f"{family.name}.{stage.name}", lambda: trained.tensors, **report)

    def context(self, family: Family, stage: Stage) -> StageContext:
        """What a stage of a generator is given."""
        statistics = self.bundle.statistics()

        def clips(split: str) -> list[MotionClip]:
            """Others than the measured speakers have no style that could be learnt."""
            return [clip for clip in self.clips(split) if clip.speaker in statistics.speakers]

        return StageContext(
            stage=stage.name,
            settings=self.bundle.settings(family.name),
            bundle=self.bundle,
            statistics=statistics,
            read_clips=clips,
            sound=self.sound,
            folder=self.bundle.train / family.name,
            seed=self.seed,
            run=self.how(
                f"{family.name}.{stage.name}",
                resumes=stage.resumes(self.bundle.settings(family.name)),
            ),
            resume=self.resume,
            place=self.dataset.path,
        )

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
        return self.bundle.motion_identity(self.data_digest)

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

    def how(
        self, part: str, precision: str = "32-true", resumes: Mapping[str, Any] | None = None
    ) -> RunConfig:
        """How to run a stage; those of motion are small and stay in float32."""
        upstream = list(self.bundle.chain(part).values())
        sizes = self.bundle.sizes_of(part)
        identity = digest(part, sizes, self.seed, self.data_digest, upstream, dict(resumes or {}))
        return replace(self.run, precision=precision, identity=identity)


SHARED: dict[str, tuple[str, Callable[[Trainer], None]]] = {
    "renderer": ("renderer", Trainer.renderer),
    "motion": ("statistics", Trainer.motion),
    "avd": ("avd", Trainer.avd),
}
"""Stages that all generators share: the part that each makes, and what makes it."""


def train(
    dataset: Path,
    output: Path,
    *,
    preset: Preset | None = None,
    changes: dict[str, Any] | None = None,
    generator: str | None = None,
    stage: str = "all",
    resume: bool = False,
    force: bool = False,
    seed: int = 0,
    speaker: str | None = None,
    also: Sequence[tuple[Path, float]] = (),
    origin: Path | None = None,
    run: RunConfig | None = None,
) -> Bundle:
    """Train the stages of a speaker bundle.

    Args:
        dataset: folder that `angie prepare` made, or a folder of joints (`angie.motion.keypoints`).
        output: folder of the bundle.
        preset: sizes; for a bundle that exists already its own are kept.
        changes: settings that differ from the preset (or from the bundle's own).
        generator: name of the family whose generator is trained; a bundle may have several. None
            is the bundle's own, of a new one the default.
        stage: "renderer", "motion", "avd", a stage of the generator, or "all": those that
            gesturing to speech needs, and "avd" where `train_avd.with_all` is set.
        resume: go on with an interrupted training; finished stages are kept.
        force: throw an existing bundle away first.
        seed: everything random follows from it.
        speaker: whose motion alone is learnt; None learns that of all. The motion stage settles
            it for those after it.
        also: further datasets for the renderer alone, with the number of pairs drawn of each for
            every pair of `dataset`.
        origin: bundle whose renderer is trained on with its regions frozen; a new one of which
            the renderer alone is trained keeps its motion, too.
        run: device, precision and so on.

    Raises:
        BadInput: no dataset, unknown generator, stage or setting, or a bundle that exists already.
    """
    if generator is not None or not (Path(output) / "bundle.json").exists():
        own = (one.name for one in family(generator).stages)
        check_choice("--stage", stage, [*SHARED, *own, "all"])
    check_seed(seed)
    check_apart(output, [dataset, *(place for place, _ in also), *([origin] if origin else [])])
    data = open_data(dataset, output)
    check_data(data, speaker, stage)
    shares = shares_of(data, also, stage)
    if isinstance(data, KeypointDataset):
        preset = None if preset is None else of_points(preset, data.joints())
        data.check_sound()
    run = run or RunConfig()
    if run.precision == "auto":
        run = replace(run, precision=native_precision(run.device))
    fabric = launch(run)
    with alone(output) if fabric.global_rank == 0 else nullcontext():
        if fabric.global_rank == 0:
            open_or_create(
                Path(output), preset, changes or {}, generator, stage, resume, force, origin
            )
        fabric.barrier()
        keep_memory()
        bundle = Bundle.open(output)
        if isinstance(data, KeypointDataset) != bundle.preset.points:
            raise BadInput(f"{output}: regions and joints do not mix; name another folder")
        measured = bundle.manifest["speakers"] if bundle.has("statistics") else [speaker]
        if speaker is not None and stage != "motion" and measured != [speaker]:
            raise BadInput(
                f"--speaker {speaker}: {output} was measured on others; --stage motion first"
            )
        trainer = Trainer(data, bundle, seed, run, resume, fabric, speaker, shares)
        found = family(bundle.chosen(generator))
        stages = stages_of(bundle, found)
        for name in _chosen(stage, bundle, found):
            part, action = stages[name]
            if stage == "all" and resume and trainer.bundle.has(part):
                trainer.check_dataset(part)
                console.print(f"{name}: done before")
                continue
            action(trainer)
        return trainer.bundle


def stages_of(bundle: Bundle, found: Family) -> dict[str, tuple[str, Callable[[Trainer], None]]]:
    """Stages of training a bundle with a generator, in order: the part each makes, and how."""

    def make(stage: Stage) -> Callable[[Trainer], None]:
        return lambda trainer: trainer.generator(found, stage)

    own = {
        stage.name: (f"{found.name}.{stage.name}", make(stage))
        for stage in found.wanted(bundle.settings(found.name))
    }
    first = {name: SHARED[name] for name in ("renderer", "motion")}
    stages = {**first, **own, "avd": SHARED["avd"]}
    return {name: stage for name, stage in stages.items() if stage[0] in bundle.parts}


def _chosen(stage: str, bundle: Bundle, found: Family) -> list[str]:
    """Stages to run for `--stage`; the motion of an imported renderer is measured by the way.

    Raises:
        BadInput: a stage that a model of joints, or one with these settings, does not have.
    """
    stages = list(stages_of(bundle, found))
    if stage not in (*stages, "all"):
        raise BadInput(f"--stage {stage}: this bundle has {', '.join(stages)}")
    if stage == found.stages[0].name and not bundle.has("statistics"):
        return ["motion", stage]
    if stage != "all":
        return [stage]
    return [name for name in stages if name != "avd" or bundle.preset.train_avd.with_all]
