"""How a generator is trained: stages, what each is given, and the part of a bundle it makes."""

import hashlib
import json
import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from safetensors import SafetensorError
from torch import Tensor, nn

from angie.motion.clips import MotionClip
from angie.motion.statistics import MotionStatistics
from angie.motion.windows import STRIDE, WINDOW, MotionWindows, other_grids
from data_prep.errors import BadInput
from data_prep.files import whole_file
from data_prep.rates import FPS
from data_prep.tensors import load_tensors, open_tensors, save_tensors

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mraa.training.run import Run, RunConfig

HELD_OUT = 10
"""Every so many training clips one is kept to choose weights by, where the split "val" of the
dataset has none."""


class Parts(Protocol):
    """What stages and generators read of a bundle; see `angie.bundle.Bundle`."""

    folder: Path

    def settings(self, family: str) -> Any:
        """Settings of a family."""
        ...

    def statistics(self) -> MotionStatistics:
        """Scales, ranges and rest poses of the motion, and the speakers' names."""
        ...

    def tensors(self, part: str) -> dict[str, Tensor]:
        """Tensors of a part, such as "mine.decoder", after checking that it is whole."""
        ...

    def load(self, part: str, model: Any) -> Any:
        """The part's weights put into `model`, in evaluation mode, without gradients."""
        ...

    def report(self, part: str) -> dict[str, Any]:
        """What was said of a part when it was trained."""
        ...

    def hash_of(self, part: str) -> str:
        """SHA-256 of a part."""
        ...


@dataclass(frozen=True)
class Trained:
    """What a stage has trained, fitted or built.

    Attributes:
        tensors: its state, of any types; or a safetensors file, which is moved into the bundle.
        report: how well it does; plain values for `bundle.json`.
    """

    tensors: Mapping[str, Tensor] | Path
    report: dict[str, Any] = field(default_factory=dict)


@dataclass
class StageContext:
    """What a stage of training is given.

    Attributes:
        stage: its name.
        settings: of the family.
        bundle: with the parts that the stage needs.
        statistics: of the motion of the training clips.
        read_clips: clips of a split of the dataset, of the bundle's speakers alone.
        sound: sound (N,) of a clip by its name, float32 at 16 kHz.
        folder: for checkpoints, curves and caches.
        seed: everything random follows from it.
        run: device, precision, and the identity of what is trained on what.
        resume: go on from the checkpoint in `folder`.
        place: the dataset, for messages.
        begun: the run of this stage.
    """

    stage: str
    settings: Any
    bundle: Parts
    statistics: MotionStatistics
    read_clips: Callable[[str], list[MotionClip]]
    sound: "Callable[[str], NDArray]"
    folder: Path
    seed: int
    run: "RunConfig"
    resume: bool
    place: Path
    begun: "Run | None" = None

    @property
    def steps(self) -> int:
        """Steps after which the training run of this stage ended; 0 where there was none."""
        return 0 if self.begun is None else self.begun.step

    def begin(self, steps: int, **options: Any) -> "Run":
        """The training run of this stage; `options` are those of `Run`."""
        from mraa.training.run import Run

        options = {"seed": self.seed, "config": self.run, "resume": self.resume, **options}
        self.begun = Run(self.folder, self.stage, steps=steps, **options)
        return self.begun

    def clips(self, frames: int = WINDOW) -> tuple[list[MotionClip], list[MotionClip]]:
        """Training clips, and others to choose weights by, of at least `frames` frames.

        The others are of the split "val", or where it has none, every tenth training clip. The
        test split stays out of training altogether.

        Raises:
            BadInput: no training clip is as long.
        """
        train, kept = (
            [clip for clip in self.read_clips(split) if clip.motion.frames >= frames]
            for split in ("train", "val")
        )
        if not train:
            raise too_short(self.place, frames)
        if not kept:
            kept = train[HELD_OUT - 1 :: HELD_OUT]
            train = [clip for i, clip in enumerate(train, 1) if i % HELD_OUT]
        return train, kept

    def windows(
        self, stride: int = STRIDE, grids: int = 1, sound: str = "onset"
    ) -> tuple[MotionWindows, MotionWindows | None]:
        """Training windows of 96 frames, and those of other clips to choose weights by, if any.

        Args:
            stride: frames from one training window to the next; the others are 32 apart.
            grids: of tokens, on which training clips are read; see `other_grids`.
            sound: name of the feature of tokens.

        Raises:
            BadInput: no clip is as long as a window.
        """
        train, kept = self.clips()
        train = [*train, *other_grids(train, self.sound, grids, sound)]
        windows = MotionWindows(train, self.statistics, stride=stride, sound=sound)
        return windows, MotionWindows(kept, self.statistics, sound=sound) if kept else None

    def cached(self, name: str, make: Callable[[], Mapping[str, Tensor]]) -> dict[str, Tensor]:
        """An artefact between stages, such as tokens: made once, and anew if its origin changes.

        Its origin is what this stage is trained on: data, upstream parts, settings and seed.
        """
        path = self.folder / f"{name}.safetensors"
        if path.is_file():
            with suppress(SafetensorError), open_tensors(path) as file:  # damaged: made again
                if (file.metadata() or {}).get("identity") == self.run.identity:
                    return load_tensors(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        made = {key: value.contiguous().cpu() for key, value in make().items()}
        if int(os.environ.get("LOCAL_RANK", "0")) == 0:  # the same in every process
            with whole_file(path, force=True) as part:
                save_tensors(part, made, {"identity": self.run.identity})
        return made


def too_short(folder: Path, frames: int = WINDOW) -> BadInput:
    """The refusal of a dataset whose clips are all shorter than a window."""
    return BadInput(
        f"{folder}: no training clip has {frames} frames at {FPS} a second, as long as a window; "
        "longer clips are needed"
    )


def always(settings: Any) -> bool:
    """A stage that there is whatever the settings."""
    return True


@dataclass(frozen=True)
class Stage:
    """One step of training a generator; it makes the part `<family>.<name>` of a bundle.

    Attributes:
        name: of the stage, unique in the family.
        needs: what the part is trained on: "renderer", "statistics", or stages before it.
        train: does it.
        sizes: the settings that a part of this stage depends on, as plain values or dataclasses
            by name: with others the part is no longer usable.
        build: makes the network once, so that sizes that cannot be are told before anything is
            trained; None where there is nothing to build.
        wanted: whether there is such a stage under these settings.
        resumes: further settings that a training cannot be resumed across.
        more: further stages that the part is trained on under these settings.
    """

    name: str
    needs: tuple[str, ...]
    train: Callable[[StageContext], Trained]
    sizes: Callable[[Any], Mapping[str, Any]] = lambda settings: {}
    build: Callable[[Any], nn.Module] | None = None
    wanted: Callable[[Any], bool] = always
    resumes: Callable[[Any], Mapping[str, Any]] = lambda settings: {}
    more: Callable[[Any], tuple[str, ...]] = lambda settings: ()


def plain(values: Mapping[str, Any]) -> dict[str, Any]:
    """Settings as JSON has them: dataclasses become mappings, tuples lists."""
    made = {k: asdict(v) if is_dataclass(v) else v for k, v in values.items()}  # type: ignore[arg-type]
    result: dict[str, Any] = json.loads(json.dumps(made))
    return result


def digest(*words: Any) -> str:
    """Hash of plain values, for what is trained on what."""
    return hashlib.sha256(json.dumps(words, sort_keys=True).encode()).hexdigest()
