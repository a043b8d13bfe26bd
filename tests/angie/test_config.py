import dataclasses
import json

import pytest

from angie.config import PRESETS, override, parse_overrides, preset, stored
from angie.parts import upstream_of
from data_prep.errors import BadInput

# Typed from the papers and the code their authors released, not from this project's settings.
ANGIE = {  # NeurIPS 2022, sections 3.2 to 4; what it leaves open is Bailando's
    "renderer.regions": 20,
    "angie.vq": dict(
        regions=20, codes=512, code_width=512, width=512, streams=2, quant="full",
        update="loss", decay=0.99, restart_below=0.1, context="window",
    ),
    "angie.train_vq": dict(
        commitment=0.1, latent=1.0, stride=32, path_loss=0.0, path_loss_norm="absolute",
        warmup=0.0, checks=50,
    ),
    "angie.train_vq.schedule": dict(
        rate=3e-5, betas=(0.5, 0.999), batch=32, epochs=500, milestones=(), most_steps=0, clip=1.0,
    ),
    "angie.gpt": dict(
        codes=512, onset=426, width=768, heads=12, layers=12, block=11, dropout=0.1, streams=2,
        joint=False, sound="onset",
    ),
    "angie.train_gpt": dict(stride=32, grids=1, checks=100, patience=20),
    "angie.train_gpt.schedule": dict(
        rate=3e-4, betas=(0.5, 0.999), batch=32, epochs=500, milestones=(250, 400), most_steps=0,
        clip=1.0,
    ),
    "angie.refiner": dict(
        regions=20, sound=256, motion=128, hidden=256, layers=2, dropout=0.1, streams=2,
        sees="pose",
    ),
    "angie.train_refiner": dict(pattern="gpt", drifting=0.0, velocity=0.0, stride=32, checks=50),
    "angie.train_refiner.schedule": dict(
        rate=1e-4, betas=(0.9, 0.999), batch=32, epochs=100, milestones=(), most_steps=0, clip=1.0,
    ),
    "angie.generation": dict(
        bounding="off", decode="full", blend="linear", refine=True, reanchor=False,
        render_floor=False,
    ),
    "angie.generation.sampling": dict(
        method="greedy", k=20, temperature=1.0, repeat_guard=False, calm=False,
        voice="recording",
    ),
    "angie.generation.window": dict(move="slide", context=6),
}  # fmt: skip
MRAA = {  # CVPR 2021 and its configuration for 256x256
    "renderer": dict(
        estimator_scale=0.25, temperature=0.1, heatmap_padding=0, background_kind="affine",
        background_scale=1.0, flow_scale=0.25, skips=True, avd_id_width=64, avd_pose_width=64,
        affine_mode="svd", covariance_floor=1e-4, align_corners=True, revert_axis_swap=True,
    ),
    "renderer.estimator": dict(width=32, blocks=5, max_width=1024),
    "renderer.background": dict(width=32, blocks=5, max_width=1024),
    "renderer.flow": dict(width=64, blocks=5, max_width=1024),
    "renderer.generator": dict(
        design="paper", width=64, max_width=512, down_blocks=2, bottleneck_blocks=6,
        refine_blocks=2, half_blocks=0, fine_occlusion=False,
    ),
    "train_renderer": dict(
        epochs=100, repeats=75, steps=0, batch=14, accumulate=1, ema=0.0, rate=2e-4,
        betas=(0.5, 0.999), milestones=(0.6, 0.9), perceptual_backend="auto",
        perceptual_weights="", perceptual_width=32, perceptual_scales=(1.0, 0.5, 0.25, 0.125),
        perceptual=10.0, equivariance_shift=10.0, equivariance_affine=10.0, occlusion_cost=0.0,
        blend=0.0, clip=10.0, initial="", teacher="", distill_weight=10.0,
        freeze_estimator=False, sheet_every=500, warmup_steps=0, warmup_size=128, warmup_gap=12,
    ),
    "train_renderer.augmentation": dict(
        time_flip=0.5, horizontal_flip=0.5, brightness=0.1, contrast=0.1, saturation=0.1, hue=0.1,
        zoom=0.0, background=0.0,
    ),
    "train_avd": dict(repeats=150, scale=0.25, with_all=False),
    "train_avd.schedule": dict(
        rate=1e-3, betas=(0.5, 0.999), batch=256, epochs=30, milestones=(20, 25), most_steps=0,
        clip=1.0,
    ),
}  # fmt: skip


def flat(values, prefix=""):
    """Nested settings as one mapping of dotted names."""
    found = {}
    for key, value in values.items():
        name = f"{prefix}{key}"
        found |= flat(value, f"{name}.") if isinstance(value, dict) else {name: value}
    return found


def test_paper_numbers():
    """Every number of the preset stands in the table, and every number of the table in it."""
    settings = dataclasses.asdict(preset("paper"))
    settings |= settings.pop("generators")
    assert (settings.pop("name"), settings.pop("points")) == ("paper", False)
    assert flat(settings) == flat({**MRAA, **ANGIE})


def test_a_refiner_of_the_gpt_s_patterns_is_trained_on_the_gpt():
    assert upstream_of("angie.refiner", preset("paper")) == ["statistics", "angie.vq", "angie.gpt"]
    assert upstream_of("angie.refiner", preset("lite")) == ["statistics", "angie.vq"]


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_survives_json(name):
    config = json.loads(json.dumps(dataclasses.asdict(preset(name))))
    assert stored(config).settings("angie") == preset(name).settings("angie")
    assert override(stored(config), {}) == stored(config)


def test_overrides_from_arguments_and_yaml(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text("gpt: {layers: 2, width: 64}\ntrain_vq: {schedule: {rate: 1e-3}}\n")
    changes = parse_overrides([str(file), "gpt.layers=4", "train_renderer.betas=[0.4, 0.9]"])
    changed = override(preset("lite"), changes)
    angie = changed.settings("angie")
    assert (angie.gpt.layers, angie.gpt.width) == (4, 64)
    assert angie.train_vq.schedule.rate == 1e-3
    assert changed.train_renderer.betas == (0.4, 0.9)
    assert angie.refiner == preset("lite").settings("angie").refiner
    named = override(preset("lite"), parse_overrides(["angie.gpt.layers=4"]))
    assert named.settings("angie").gpt.layers == 4


def test_the_number_of_regions_reaches_every_part():
    changed = override(preset("lite"), parse_overrides(["renderer.regions=12"]))
    angie = changed.settings("angie")
    assert changed.renderer.regions == angie.vq.regions == angie.refiner.regions == 12
    with pytest.raises(BadInput, match="disagree"):
        override(preset("lite"), parse_overrides(["vq.regions=12"]))


@pytest.mark.parametrize(
    ("argument", "message"),
    [
        ("gpt.layrs=4", "nearest is gpt.layers"),
        ("gtp.layers=4", "nearest is gpt"),
        ("gpt.layers=many", "a int is wanted"),
        ("gpt=4", "holds several settings"),
        ("generation.bounding=sometimes", "bounding is one of"),
        ("train_renderer.betas=[0.5]", "tuple"),
        ("renderer=5", "holds several settings"),
        ("train_renderer.betas=0.5", "tuple"),
        ("renderer.affine_mode=foo", "affine_mode is one of"),
        ("renderer.generator.design=foo", "paper, lite or deep"),
        ("renderer.flow_scale=0.3", "1 over a whole number"),
        ("train_renderer.batch=0", "must be positive"),
        ("layers", "give key=value"),
        ("missing.yaml", "no such file"),
    ],
)
def test_wrong_settings_are_told(argument, message):
    with pytest.raises(BadInput, match=message):
        override(preset("lite"), parse_overrides([argument]))


@pytest.mark.parametrize(
    ("argument", "message"),
    [
        ("vq.restart_below=-1", "vq: restart_below"),
        ("vq.code_width=0", "vq: .*code_width must be positive"),
        ("train_vq.schedule.milestones=[400, 200]", "train_vq.schedule: milestones are epochs"),
        ("train_gpt.schedule.milestones=[0]", "milestones are epochs from 1 on"),
        ("train_avd.schedule.milestones=[20, 20]", "each later than the one before"),
        ("train_gpt.schedule.milestones=[2.5]", "a int is wanted"),
        ("train_vq.commitment=-1", "commitment and latent"),
        ("gpt.heads=3", "width 128 is not a multiple of 3 heads"),
        ("gpt.heads=0", "must be positive"),
        ("gpt.layers=0", "must be positive"),
        ("gpt.dropout=1", "dropout lies between 0 and 1"),
        ("gpt.block=5", "block 11"),
        ("refiner.hidden=0", "must be positive"),
        ("refiner.dropout=-0.1", "dropout lies between 0 and 1"),
        ("renderer.covariance_floor=-1e-4", "covariance_floor must not be negative"),
        ("renderer.heatmap_padding=-1", "heatmap_padding"),
        ("renderer.avd_id_width=0", "widths of avd"),
        ("renderer.generator.bottleneck_blocks=-1", "renderer.generator: .*not negative"),
        ("renderer.generator={design: paper, down_blocks: 9}", "too often"),
        ("renderer.estimator.blocks=0", "renderer.estimator: width and blocks must be positive"),
        ("renderer.flow.max_width=16", "max_width not below width"),
        ("renderer.estimator.blocks=7", "7 estimator.blocks halve 64 pixels too often"),
        ("renderer.background.blocks=7", "7 background.blocks halve 64 pixels too often"),
        ("train_renderer.perceptual_scales=[0.3]", "are of 1.0, 0.5, 0.25, 0.125"),
        ("train_renderer.augmentation.hue=2", r"colour lie in \[0, 1\]"),
    ],
)
def test_numbers_that_cannot_be_are_told(argument, message):
    with pytest.raises(BadInput, match=message) as told:
        override(preset("lite"), parse_overrides([argument]))
    assert len(str(told.value).splitlines()) == 1


def test_unknown_preset():
    with pytest.raises(BadInput, match="paper, lite, tiny"):
        preset("huge")


def test_on_and_off_are_words_where_a_word_is_wanted():
    for word in ("on", "off", "auto"):
        changed = override(preset("paper"), parse_overrides([f"generation.bounding={word}"]))
        assert changed.settings("angie").generation.bounding == word
    with pytest.raises(BadInput, match="sampling is one of greedy, topk, not 'on'"):
        override(preset("paper"), parse_overrides(["generation.sampling.method=yes"]))
