"""Every size and every number of ANGIE's training and generation, its presets and variants."""

from dataclasses import dataclass, field, replace

from angie.generators.angie.generate import GenerationConfig
from angie.generators.angie.gpt import GPTConfig
from angie.generators.angie.refiner import RefinerConfig
from angie.generators.angie.sampling import Sampling, Window
from angie.generators.angie.tokenizer import VQConfig
from angie.generators.angie.train import GPTTraining, VQTraining
from angie.generators.angie.train_refiner import RefinerTraining
from angie.generators.base import Variant
from angie.motion.windows import WINDOW_TOKENS
from data_prep.speech.features import ONSET_SIZE
from mraa.training.checkpoint import Schedule


@dataclass(frozen=True)
class AngieSettings:
    """Sizes and training of every part; the defaults are the paper's.

    Attributes:
        vq: sizes of the VQ motion extractor.
        gpt: sizes of the co-speech GPT.
        refiner: sizes of the refiner.
        generation: how motion is generated.
        train_vq: how the VQ motion extractor is trained.
        train_gpt: how the GPT is trained.
        train_refiner: how the refiner is trained.
    """

    vq: VQConfig = field(default_factory=VQConfig)
    gpt: GPTConfig = field(default_factory=GPTConfig)
    refiner: RefinerConfig = field(default_factory=RefinerConfig)
    generation: GenerationConfig = field(
        default_factory=lambda: GenerationConfig(sampling=Sampling(method="greedy"))
    )
    train_vq: VQTraining = field(default_factory=VQTraining)
    train_gpt: GPTTraining = field(default_factory=GPTTraining)
    train_refiner: RefinerTraining = field(default_factory=RefinerTraining)

    def __post_init__(self) -> None:
        if self.vq.codes != self.gpt.codes or self.vq.regions != self.refiner.regions:
            raise ValueError("the parts disagree: regions or codes are set for one part only")
        if len({self.vq.streams, self.gpt.streams, self.refiner.streams}) > 1:
            raise ValueError("the parts disagree: streams is 1 for points, else 2, in every part")
        if (self.gpt.onset, self.gpt.block) != (ONSET_SIZE, WINDOW_TOKENS - 1):
            raise ValueError(
                f"gpt: onset is {ONSET_SIZE} and block {WINDOW_TOKENS - 1}, as in all windows"
            )

    @property
    def has_codes(self) -> bool:
        """Whether motion is quantised; if not, it is regressed from the sound."""
        return self.vq.quant != "no_quant"


def fit(settings: AngieSettings, regions: int, points: bool) -> AngieSettings:
    """The settings for motion of so many regions; points have the stream of the shift only."""
    streams = 1 if points else 2
    return replace(
        settings,
        vq=replace(settings.vq, regions=regions, streams=streams),
        gpt=replace(settings.gpt, streams=streams),
        refiner=replace(settings.refiner, regions=regions, streams=streams),
    )


def lite() -> AngieSettings:
    """What ships: generates faster than real time on a laptop CPU."""
    return AngieSettings(
        vq=VQConfig(width=64, code_width=64, restart_below=0.1, context="clip"),
        gpt=GPTConfig(width=128, heads=4, layers=4, dropout=0.3),
        refiner=RefinerConfig(sound=96, motion=64, hidden=128),
        generation=GenerationConfig(
            bounding="auto",
            decode="auto",
            blend="hann",
            sampling=Sampling(method="topk", repeat_guard=True, calm=True),
        ),
        train_vq=VQTraining(
            schedule=Schedule(rate=1e-3, milestones=(375, 460), most_steps=6000),
            stride=5,
            path_loss=0.3,
            path_loss_norm="square",
            warmup=0.15,
        ),
        train_gpt=GPTTraining(
            schedule=Schedule(rate=1e-3, milestones=(400,), most_steps=1800),
            stride=8,
            grids=8,
            checks=30,
        ),
        train_refiner=RefinerTraining(
            schedule=Schedule(
                rate=2e-3, betas=(0.9, 0.999), epochs=100, milestones=(80,), most_steps=3000
            ),
            stride=16,
            velocity=20.0,
        ),
    )


def tiny() -> AngieSettings:
    """For tests and first tries: every stage trains in seconds."""
    return AngieSettings(
        vq=VQConfig(regions=10, width=32, code_width=32),
        gpt=GPTConfig(width=64, heads=4, layers=2),
        refiner=RefinerConfig(regions=10, sound=32, motion=32, hidden=32, layers=1),
        generation=GenerationConfig(
            bounding="auto",
            decode="auto",
            window=Window("hop"),
            sampling=Sampling(method="topk", repeat_guard=True),
        ),
        train_vq=VQTraining(schedule=Schedule(rate=1e-3, most_steps=150)),
        train_gpt=GPTTraining(schedule=Schedule(rate=1e-3, most_steps=200), checks=10),
        train_refiner=RefinerTraining(
            schedule=Schedule(rate=2e-3, betas=(0.9, 0.999), most_steps=150), checks=10
        ),
    )


def _quantised(settings: AngieSettings, quant: str) -> AngieSettings:
    generation = replace(settings.generation, refine=True)
    return replace(settings, vq=replace(settings.vq, quant=quant), generation=generation)


def _without_refiner(settings: AngieSettings) -> AngieSettings:
    whole = _quantised(settings, "full")
    return replace(whole, generation=replace(whole.generation, refine=False))


VARIANTS = {
    "no_quant": Variant(lambda settings: _quantised(settings, "no_quant")),
    "mu_L": Variant(lambda settings: _quantised(settings, "mu_L")),
    "dmu_L": Variant(lambda settings: _quantised(settings, "dmu_L")),
    "mu_dL": Variant(lambda settings: _quantised(settings, "mu_dL")),
    "no_cholesky": Variant(lambda settings: _quantised(settings, "no_cholesky")),
    "no_refine": Variant(_without_refiner, parts_of="full"),
    "full": Variant(lambda settings: _quantised(settings, "full")),
}
"""Rows of the paper's Table 3 in its order; `no_cholesky` is of its section 3.2."""
