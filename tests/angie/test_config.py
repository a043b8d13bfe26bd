import dataclasses
import json

import pytest

from angie.config import PRESETS, Preset, override, parse_overrides, preset, stored
from angie.generators.angie.settings import AngieSettings
from data_prep.errors import BadInput


def test_paper_numbers():
    paper = preset("paper")
    angie = paper.settings("angie")
    assert paper == Preset(generators={"angie": AngieSettings()})
    assert paper.renderer.regions == angie.vq.regions == angie.refiner.regions == 20
    assert (angie.vq.codes, angie.vq.code_width, angie.vq.width) == (512, 512, 512)
    assert (angie.gpt.width, angie.gpt.heads, angie.gpt.dropout) == (768, 12, 0.1)
    assert paper.renderer.affine_mode == "svd" and paper.renderer.temperature == 0.1
    assert angie.generation.bounding == "off" and angie.generation.sampling.method == "greedy"
    assert not angie.generation.sampling.repeat_guard
    assert angie.train_vq.schedule.rate == 3e-5 and angie.train_vq.commitment == 0.1
    assert angie.vq.restart_below == 1 and angie.train_vq.path_loss == angie.train_vq.warmup == 0
    assert paper.train_renderer.rate == 2e-4 and paper.train_renderer.augmentation.zoom == 0


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
        ("missing.yaml", "cannot be read"),
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
