"""ANGIE (NeurIPS 2022) as a family of generators: its stages, and how a bundle's is loaded."""

from pathlib import Path
from typing import Any

from angie.generators.angie.generate import AngieGenerator, Controls
from angie.generators.angie.gpt import CoSpeechGPT
from angie.generators.angie.refiner import Refiner
from angie.generators.angie.report import broken_share, gpt_report, in_words, vq_report
from angie.generators.angie.settings import VARIANTS, AngieSettings, fit, lite, paper, tiny
from angie.generators.angie.tokenizer import DirectMotion, VQMotionExtractor
from angie.generators.angie.train import train_direct, train_gpt, train_vq
from angie.generators.angie.train_refiner import train_refiner
from angie.generators.base import Family, GestureGenerator
from angie.generators.stages import Parts, Stage, StageContext, Trained
from angie.layers.packed_linear import pack, product_type
from angie.motion.clips import MotionClip
from data_prep.errors import BadInput
from mraa.motion import Motion

NAME = "angie"


def make_vq(settings: AngieSettings, speakers: int = 1) -> VQMotionExtractor | DirectMotion:
    """The VQ motion extractor, or what stands in its place without codes, untrained."""
    if settings.has_codes:
        return VQMotionExtractor(settings.vq)
    return DirectMotion(settings.vq, settings.gpt, speakers)


def load_vq(bundle: Parts) -> VQMotionExtractor | DirectMotion:
    """The trained VQ motion extractor of a bundle, or what stands in its place."""
    settings = bundle.settings(NAME)
    model: VQMotionExtractor | DirectMotion = bundle.load(
        f"{NAME}.vq", make_vq(settings, _speakers(bundle))
    )
    return model


def load_gpt(bundle: Parts) -> CoSpeechGPT:
    """The trained GPT of a bundle."""
    model: CoSpeechGPT = bundle.load(
        f"{NAME}.gpt", CoSpeechGPT(bundle.settings(NAME).gpt, _speakers(bundle))
    )
    return model


def load_generator(bundle: Parts, precision: str = "fp32") -> AngieGenerator:
    """ANGIE on the CPU, its parts in evaluation mode.

    Args:
        bundle: where they lie.
        precision: of the GPT's large products: bfloat16 for "bf16" and "auto" where the
            processor has it natively and PyTorch can pack it; else float32. Rounding parts two
            sequences of codes where two codes are about equally likely; either is as good.
    """
    settings: AngieSettings = bundle.settings(NAME)
    gpt = None
    if settings.has_codes:
        gpt = load_gpt(bundle)
        pack(gpt, product_type(precision))
    refiner: Refiner = bundle.load(f"{NAME}.refiner", Refiner(settings.refiner))
    errors = bundle.report(f"{NAME}.vq").get("decoding", {})
    chunked = errors.get("chunked", 1.0) < errors.get("full", 0.0)
    statistics = bundle.statistics()
    vq = load_vq(bundle)
    return AngieGenerator(vq, gpt, refiner, statistics, settings.generation, chunked=chunked)


def _speakers(bundle: Parts) -> int:
    """Speakers of the training set; only joint models need to know."""
    return len(bundle.statistics().speakers) if bundle.settings(NAME).gpt.joint else 1


def _vq(context: StageContext) -> Trained:
    """Train the VQ motion extractor, or the regression in its place without codes."""
    settings: AngieSettings = context.settings
    if not settings.has_codes:
        training = settings.train_gpt
        windows, held_out = context.windows(training.stride, training.grids, settings.gpt.sound)
        direct = train_direct(context.begin, windows, held_out, settings.vq, settings.gpt, training)
        return Trained(direct.state_dict())
    windows, held_out = context.windows(settings.train_vq.stride)
    vq = train_vq(context.begin, windows, held_out, settings.vq, settings.train_vq)
    return Trained(vq.state_dict(), vq_report(vq, windows, held_out))


def _gpt(context: StageContext) -> Trained:
    """Train the co-speech GPT on the codes of the VQ motion extractor."""
    settings, vq = context.settings, _extractor(context)
    assert isinstance(vq, VQMotionExtractor)  # without codes there is no such stage
    training = settings.train_gpt
    windows, held_out = context.windows(training.stride, training.grids, settings.gpt.sound)
    gpt = train_gpt(context.begin, vq, windows, held_out, settings.gpt, training)
    return Trained(gpt.state_dict(), gpt_report(gpt, vq.cpu(), windows, held_out))


def _refiner(context: StageContext) -> Trained:
    """Train the refiner on the patterns of the VQ motion extractor."""
    settings, vq = context.settings, _extractor(context)
    training = settings.train_refiner
    windows, held_out = context.windows(training.stride, sound=settings.gpt.sound)
    gpt = load_gpt(context.bundle) if _refined(settings) else None
    refiner = train_refiner(context.begin, vq, windows, held_out, settings.refiner, training, gpt)
    return Trained(refiner.state_dict())


def _refined(settings: AngieSettings) -> tuple[str, ...]:
    """What the refiner learns from beside the extractor: the GPT, if its patterns are refined."""
    return ("gpt",) if settings.train_refiner.pattern == "gpt" and settings.has_codes else ()


def _extractor(context: StageContext) -> VQMotionExtractor | DirectMotion:
    """The VQ motion extractor, or what stands in its place.

    Raises:
        BadInput: its mean and its way of decoding were measured in another context.
    """
    vq, report = load_vq(context.bundle), context.bundle.report(f"{NAME}.vq")
    wanted = context.settings.vq.context
    if isinstance(vq, VQMotionExtractor) and report.get("context", "window") != wanted:
        raise BadInput(
            f"{context.bundle.folder}: the codes were not measured for vq.context={wanted}; "
            "--stage vq --resume does that"
        )
    return vq


def _vq_sizes(settings: AngieSettings) -> dict[str, Any]:
    sizes = {entry: value for entry, value in vars(settings.vq).items() if entry != "context"}
    return {"vq": sizes} | ({} if settings.has_codes else {"gpt": settings.gpt})


def _refiner_sizes(settings: AngieSettings) -> dict[str, Any]:
    context = {"context": settings.vq.context} if settings.has_codes else {}
    return {"refiner": settings.refiner, **context}


def _grids(settings: AngieSettings) -> dict[str, Any]:
    """Windows of several grids are others than those of one."""
    return {"grids": settings.train_gpt.grids}


def _codes_shown(bundle: Any, photos: list[Path], output: Path, **options: Any) -> str:
    """Draw codes on photos; what was made, in a line."""
    from angie.generators.angie.code_sheet import code_sheet

    sheet = code_sheet(bundle, photos, output, **options)
    return f"{sheet.picture}, {sheet.video}: {len(sheet.pairs)} pairs of codes"


def _reconstruct(generator: GestureGenerator, clip: MotionClip, speaker: str | None) -> Motion:
    assert isinstance(generator, AngieGenerator)
    return generator.reconstruct(clip.speech, clip.motion, speaker)


FAMILY = Family(
    name=NAME,
    title="ANGIE",
    settings=AngieSettings,
    presets={"paper": paper, "lite": lite, "tiny": tiny},
    stages=(
        Stage(
            "vq", ("renderer", "statistics"), _vq, _vq_sizes, make_vq,
            resumes=lambda settings: {} if settings.has_codes else _grids(settings),
        ),
        Stage(
            "gpt", ("statistics", "vq"), _gpt,
            lambda settings: {"gpt": settings.gpt, "context": settings.vq.context},
            lambda settings: CoSpeechGPT(settings.gpt),
            wanted=lambda settings: settings.has_codes, resumes=_grids,
        ),
        Stage(
            "refiner", ("statistics", "vq"), _refiner, _refiner_sizes,
            lambda settings: Refiner(settings.refiner), more=_refined,
        ),
    ),
    load=load_generator,
    fit=fit,
    styles=lambda settings, statistics: statistics.speakers if settings.gpt.joint else (),
    style_advice="gpt.joint=true",
    variants=VARIANTS,
    controls=Controls,
    columns={"cannot be drawn": broken_share},
    report=in_words,
    codes_shown=_codes_shown,
    reconstruct=_reconstruct,
)  # fmt: skip
