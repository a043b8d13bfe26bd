"""The options of an evaluation, and the networks it trains and stores in the report."""

import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from angie.evaluation.images import FrameChoice, FrameJudge
from angie.evaluation.space import JointReader, RegionSpace, fit_reader
from angie.metrics.autoencoder import (
    AutoencoderTraining,
    MotionAutoencoder,
    MotionScale,
    StoredAutoencoder,
    explained,
    load_autoencoder,
    save_autoencoder,
    train_autoencoder,
    windows,
)
from angie.metrics.images import IdentityNetwork, IdentityTraining, train_identity
from angie.motion.clips import MotionClip
from data_prep.dataset import Dataset
from data_prep.errors import BadInput
from data_prep.files import sha256
from data_prep.rates import FPS
from data_prep.tensors import save_tensors
from mraa.perceptual import PerceptualDistance
from mraa.renderer import Renderer

IDENTITY_FRAMES = 12
"""Frames of a training clip from which identities are learnt."""

IDENTITY_CLIPS = 400
"""Training clips from which identities are learnt, at most."""


LEAST_SECONDS = 0.12
"""Least beginning of a clip that has image scores: two frames after the first one."""


@dataclass(frozen=True)
class EvaluationConfig:
    """How an evaluation is made.

    Attributes:
        seeds: runs of what is random; run i has the seed `seed + i`.
        seed: of the first run and of all that is trained for scoring.
        start: "truth" (the beginning of the recorded motion) or "pose" (stillness).
        images: render frames: image scores and videos.
        image_stride: every so many frames two in a row are rendered for image scores.
        image_seconds: of the beginning of each clip that are scored so; 0 for all.
        videos_shown: clips of which side-by-side videos are made.
        fgd: stored auto-encoder of an earlier report; None to train one.
        fgd_steps: most steps of its training.
        aed_steps: training steps of AED's network.
        truth: folder of `angie phantom`, or of avatars, with the true joints; None without.
        models: folder of the networks that see people; None without.
        detected: folder with NAME.npz of other networks' embeddings and points for `--videos`.
        greedy: always the likeliest gesture, whatever a bundle's own sampling.
        perceptual_weights: file of VGG19's weights; empty for the random network.
        from_sound: also score pictures of generated motion, beside those of reconstructions.
    """

    seeds: int = 1
    seed: int = 0
    start: str = "truth"
    images: bool = True
    image_stride: int = 25
    image_seconds: float = 0.0
    videos_shown: int = 2
    fgd: Path | None = None
    fgd_steps: int = 3000
    aed_steps: int = 300
    truth: Path | None = None
    models: Path | None = None
    detected: Path | None = None
    greedy: bool = False
    perceptual_weights: str = ""
    from_sound: bool = False

    def __post_init__(self) -> None:
        seconds = self.image_seconds
        if seconds and not LEAST_SECONDS <= seconds < float("inf"):
            raise BadInput(
                f"--image-seconds {seconds:g}: give {LEAST_SECONDS} or more, or 0 for all"
            )

    @property
    def run_seeds(self) -> list[int]:
        """The seed of every run."""
        return [self.seed + i for i in range(self.seeds)]

    @property
    def choice(self) -> FrameChoice:
        """Which frames have image scores."""
        return FrameChoice(self.image_stride, self.image_seconds)

    def as_dict(self) -> dict[str, Any]:
        """Plain values for the report, without the paths of this machine."""
        plain = asdict(self)
        for key in ("fgd", "truth", "models", "detected"):
            plain[key] = None if plain[key] is None else Path(plain[key]).name
        plain["perceptual_weights"] = Path(self.perceptual_weights).name
        return plain


def stored_autoencoder(path: Path, estimator: str) -> StoredAutoencoder:
    """The auto-encoder of an earlier report.

    Raises:
        BadInput: not readable, or of other regions or joints.
    """
    stored = load_autoencoder(path)
    if stored.estimator != estimator:
        raise BadInput(
            f"{path}: trained on regions of another renderer, or on other joints "
            f"({stored.estimator[:12]}, not {estimator[:12]}); leave --fgd out"
        )
    return stored


def check_networks(config: EvaluationConfig, *estimators: str) -> None:
    """See that stored networks can be used with renderers of these hashes, before minutes of work.

    Raises:
        BadInput: they cannot.
    """
    if config.images and config.perceptual_weights:
        PerceptualDistance(config.perceptual_weights)
    for estimator in estimators:
        if config.fgd is not None:
            stored_autoencoder(config.fgd, estimator)


def find_autoencoder(
    space: RegionSpace, folder: Path, number: int, config: EvaluationConfig
) -> tuple[MotionAutoencoder | None, MotionScale, dict[str, Any]]:
    """The auto-encoder of FGD, trained or stored, as a file of the report.

    Returns:
        the network, None where there are too few training windows; its standardisation; and what
        the report says of it.

    Raises:
        BadInput: the stored one is of other regions.
    """
    path = folder / f"fgd-{number}.safetensors"
    training = AutoencoderTraining(most_steps=config.fgd_steps)
    if config.fgd is not None:
        stored = stored_autoencoder(config.fgd, space.estimator)
        path.write_bytes(Path(config.fgd).read_bytes())
        model, scale, settings = stored.model, stored.scale, stored.training
    else:
        scale, settings = space.scale, {**asdict(training), "seed": config.seed}
        cut = _standard_windows(space.train, scale)
        if len(cut) < 2:
            return None, scale, {"auto-encoder of FGD": "none, too few training windows"}
        model = _train(cut, folder / "train", training, config.seed)
        save_autoencoder(path, model, scale, space.estimator, FPS, training, config.seed)
    kept = {
        name: f"{explained(model, cut):.3f}"
        for name, clips in (("training", space.train), ("test", space.test))
        if len(cut := _standard_windows(clips, scale))
    }
    return model, scale, {
        "auto-encoder of FGD": f"{path.name} sha256 {sha256(path)}",
        "its training": settings,
        "variance it keeps": kept,
    }  # fmt: skip


def _train(
    cut: NDArray, folder: Path, training: AutoencoderTraining, seed: int
) -> MotionAutoencoder:
    """The auto-encoder trained on windows; what the training leaves in `folder` goes again."""
    from mraa.training.run import Run, RunConfig

    with torch.random.fork_rng(devices=[]):
        run = Run(folder, "fgd", steps=training.steps(len(cut)), seed=seed, config=RunConfig("cpu"))
        model = train_autoencoder(cut, run, training)
    shutil.rmtree(folder)
    return model


def _standard_windows(clips: Sequence[MotionClip], scale: MotionScale) -> NDArray:
    return windows([scale.standard(c.motion.vector().numpy(), c.speaker) for c in clips])


def make_frame_judge(
    data: Dataset,
    space: RegionSpace,
    renderer: Renderer,
    joints: dict[str, NDArray],
    folder: Path,
    number: int,
    config: EvaluationConfig,
) -> tuple[FrameJudge, dict[str, Any]]:
    """The networks that look at frames, and what the report says of them."""
    device = next(renderer.parameters()).device
    perceptual = PerceptualDistance(config.perceptual_weights).to(device)
    origin: dict[str, Any] = {"perceptual distance": perceptual.backend}
    training = IdentityTraining(steps=config.aed_steps)
    identity = _identity(data, space, training, config.seed)
    if identity is None:
        origin["network of AED"] = "none, too few training clips"
    else:
        path = folder / f"identity-{number}.safetensors"
        save_tensors(path, {k: v.contiguous() for k, v in identity.state_dict().items()})
        origin["network of AED"] = f"{path.name} sha256 {sha256(path)}, {asdict(training)}"
    reader, error = _reader(space, joints)
    if error is not None:
        origin["reader of joints"] = f"{error:.2f} px from the truth on true test frames"
    return FrameJudge(renderer, perceptual, identity, reader), origin


def _identity(
    data: Dataset, space: RegionSpace, training: IdentityTraining, seed: int
) -> IdentityNetwork | None:
    if len(space.train) < 2:
        return None
    stored = {clip.id: clip for clip in data.clips()}
    rng = np.random.default_rng(seed)
    chosen = np.sort(rng.permutation(len(space.train))[:IDENTITY_CLIPS])
    pictures = []
    for index in chosen:
        store = data.frames(stored[space.train[index].name])
        numbers = np.linspace(0, len(store) - 1, min(IDENTITY_FRAMES, len(store))).astype(int)
        pictures.append(np.stack([store[int(i)][::2, ::2] for i in numbers]))
    return train_identity(pictures, training, seed)


def _reader(
    space: RegionSpace, joints: dict[str, NDArray]
) -> tuple[JointReader | None, float | None]:
    """A reader of joints fitted to the training clips, and its mean error on test clips, pixels."""
    known = [clip for clip in space.train if clip.name in joints]
    tests = [clip for clip in space.test if clip.name in joints]
    if not known or not tests:
        return None, None
    reader = fit_reader(
        np.concatenate([clip.motion.vector().double().numpy() for clip in known]),
        np.concatenate([joints[clip.name] for clip in known]),
    )
    errors = [
        np.abs(reader(clip.motion.vector().double().numpy()) - joints[clip.name]).mean((1, 2))
        for clip in tests
    ]
    return reader, float(np.concatenate(errors).mean())
