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
from data_prep.speech.features import SOUND_SIZES
from mraa.training.checkpoint import Schedule


@dataclass(frozen=True)
class AngieSettings:
    """Sizes and training of every part.

    What a bundle does not say has the defaults, so they stay as they are; presets say more.

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
        own = {self.vq.streams, self.gpt.streams, max(self.refiner.streams, self.vq.streams)}
        if len(own) > 1 or self.refiner.streams != min(self.vq.streams, 2):
            raise ValueError("the parts disagree: streams is 1 for points, else 2, in every part")
        size = SOUND_SIZES[self.gpt.sound]
        if (self.gpt.onset, self.gpt.block) != (size, WINDOW_TOKENS - 1):
            raise ValueError(
                f"gpt: onset is {size} for sound={self.gpt.sound}, and block {WINDOW_TOKENS - 1}, "
                "as in all windows"
            )

    @property
    def has_codes(self) -> bool:
        """Whether motion is quantised; if not, it is regressed from the sound."""
        return self.vq.quant != "no_quant"


def fit(settings: AngieSettings, regions: int, points: bool) -> AngieSettings:
    """The settings for motion of so many regions; points have the stream of the shift only."""
    streams = 1 if points else 2
    codes = 3 if settings.vq.quant == "naive" else streams
    return replace(
        settings,
        vq=replace(settings.vq, regions=regions, streams=codes),
        gpt=replace(settings.gpt, streams=codes),
        refiner=replace(settings.refiner, regions=regions, streams=streams),
    )


def paper() -> AngieSettings:
    """The paper's sizes and training; README.md tells what it settles where the paper is silent."""
    return AngieSettings(
        refiner=RefinerConfig(sees="pose"),
        generation=GenerationConfig(sampling=Sampling(method="greedy"), render_floor=False),
        train_refiner=RefinerTraining(pattern="gpt"),
    )


def lite() -> AngieSettings:
    """What ships: generates faster than real time on a laptop CPU."""
    return AngieSettings(
        vq=VQConfig(width=64, code_width=64, update="ema", context="clip"),
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
            drifting=0.5,
            stride=16,
            velocity=20.0,
        ),
    )


def tiny() -> AngieSettings:
    """For tests and first tries: every stage trains in seconds."""
    return AngieSettings(
        vq=VQConfig(regions=10, width=32, code_width=32, update="ema"),
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
            schedule=Schedule(rate=2e-3, betas=(0.9, 0.999), most_steps=150),
            drifting=0.5,
            checks=10,
        ),
    )


def _quantised(settings: AngieSettings, quant: str) -> AngieSettings:
    """The settings with another thing quantised, and with the refiner."""
    streams = 3 if quant == "naive" else min(settings.vq.streams, 2)
    return replace(
        settings,
        vq=replace(settings.vq, quant=quant, streams=streams),
        gpt=replace(settings.gpt, streams=streams),
        generation=replace(settings.generation, refine=True),
    )


def _without_codes(settings: AngieSettings) -> AngieSettings:
    """Regression with as many steps as VQ and GPT have together, where these are limited."""
    vq, gpt = settings.train_vq.schedule.most_steps, settings.train_gpt.schedule.most_steps
    schedule = replace(settings.train_gpt.schedule, most_steps=vq + gpt if vq and gpt else 0)
    training = replace(settings.train_gpt, schedule=schedule)
    return replace(_quantised(settings, "no_quant"), train_gpt=training)


def _without_refiner(settings: AngieSettings) -> AngieSettings:
    whole = _quantised(settings, "full")
    return replace(whole, generation=replace(whole.generation, refine=False))


def _paper_loss(settings: AngieSettings) -> AngieSettings:
    """The refiner learns by equation 10 alone."""
    training = replace(settings.train_refiner, velocity=0.0)
    return replace(_quantised(settings, "full"), train_refiner=training)


VARIANTS = {
    "no_quant": Variant(_without_codes, several=True),
    "naive": Variant(lambda settings: _quantised(settings, "naive")),
    "mu_L": Variant(lambda settings: _quantised(settings, "mu_L"), several=True),
    "dmu_L": Variant(lambda settings: _quantised(settings, "dmu_L"), several=True),
    "mu_dL": Variant(lambda settings: _quantised(settings, "mu_dL"), several=True),
    "no_cholesky": Variant(lambda settings: _quantised(settings, "no_cholesky")),
    "no_refine": Variant(_without_refiner, parts_of="full"),
    "paper_loss": Variant(_paper_loss),
    "full": Variant(lambda settings: _quantised(settings, "full"), several=True),
}
"""Rows of the paper's Table 3 in its order; `naive` and `no_cholesky` are of its section 3.2, and
`paper_loss` is `full` with the refiner trained by equation 10 alone."""
