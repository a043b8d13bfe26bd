import dataclasses
from pathlib import Path

import pytest

from angie.bundle import BUNDLE, Bundle
from angie.commands.train import weighted
from angie.config import parse_overrides, preset
from angie.opening import initial_weights, teacher_of
from angie.training import train
from data_prep.errors import BadInput
from mraa.training.objective import RendererTraining
from mraa.training.pairs import Augmentation

SHIPPED = Bundle.open(BUNDLE).preset.renderer


def test_a_bundle_gives_the_file_of_its_renderer():
    training = RendererTraining(initial=str(BUNDLE))
    assert initial_weights(training, SHIPPED) == BUNDLE / "renderer.safetensors"


def test_the_setting_that_differs_is_named():
    training = RendererTraining(initial=str(BUNDLE))
    generator = dataclasses.replace(SHIPPED.generator, width=96)
    other = dataclasses.replace(SHIPPED, generator=generator)
    width = SHIPPED.generator.width
    with pytest.raises(BadInput, match=f"has renderer.generator.width={width}, not 96"):
        initial_weights(training, other)
    file = RendererTraining(initial=str(BUNDLE / "renderer.safetensors"))
    with pytest.raises(BadInput, match="there and .* here"):
        initial_weights(file, other)
    with pytest.raises(BadInput, match="not the weights of a renderer"):
        initial_weights(RendererTraining(initial="/nonexistent"), SHIPPED)


def test_a_teacher_may_have_other_sizes_but_as_many_regions():
    training = RendererTraining(teacher=str(BUNDLE), distill_weight=1.0)
    paper = preset("paper").renderer
    estimator = teacher_of(training, paper)
    assert estimator is not None and not estimator.training
    assert not any(p.requires_grad for p in estimator.parameters())
    with pytest.raises(BadInput, match="has 20 regions, this renderer 10; set renderer.regions=20"):
        teacher_of(training, preset("tiny").renderer)
    with pytest.raises(BadInput, match="not a speaker bundle"):
        teacher_of(dataclasses.replace(training, teacher="/nonexistent"), paper)
    assert teacher_of(RendererTraining(), paper) is None


def test_settings_that_make_no_sense_together_are_told():
    for changes, words in (
        ({"teacher": "a", "distill_weight": 0.0}, "needs a distill_weight above 0"),
        ({"distill_weight": -1.0}, "ema must lie"),
        ({"teacher": "a", "distill_weight": 1.0, "freeze_estimator": True}, "learns nothing"),
        ({"ema": 1.0}, "ema must lie"),
        ({"batch": 9, "accumulate": 2}, "does not divide"),
        ({"perceptual_width": 0}, "perceptual_width"),
        ({"blend": -1.0}, "weights must not"),
        ({"perceptual_scales": (2.0,)}, "perceptual_scales are of"),
        ({"milestones": (2.0,)}, "milestones"),
    ):
        with pytest.raises(ValueError, match=words):
            RendererTraining(**changes)
    for changes, words in (({"hue": -1.0}, "colour"), ({"time_flip": 2.0}, "probabilities")):
        with pytest.raises(ValueError, match=words):
            Augmentation(**changes)


def test_a_renderer_trained_on_keeps_the_motion_of_the_bundle_it_comes_from(
    bundle, dataset, tmp_path
):
    changes = parse_overrides(["train_renderer.steps=1", "train_renderer.batch=2"])
    made = train(
        dataset.path, tmp_path / "new", changes=changes, stage="renderer", origin=bundle.folder
    )
    assert made.regions() == bundle.regions()
    assert made.hash_of("renderer") != bundle.hash_of("renderer")
    assert made.preset.train_renderer.freeze_estimator
    assert made.hash_of("angie.gpt") == bundle.hash_of("angie.gpt")
    assert made.generator() is not None and made.manifest["speakers"] == ["adam", "bella"]
    report = made.report("renderer")
    assert report["initial"] == bundle.hash_of("renderer") and "reconstruction" in report
    assert report["clips"] == len(dataset.clips("train"))
    with pytest.raises(BadInput, match="exists already; leave --from out"):
        train(dataset.path, made.folder, stage="renderer", origin=bundle.folder)


def test_further_datasets_are_reported_and_refused_where_they_are_of_no_use(
    bundle, dataset, tmp_path
):
    (tmp_path / "other").symlink_to(dataset.path)
    for also, words in (
        ([(tmp_path / "none", 1.0)], "not a dataset"),
        ([(tmp_path / "other", 1.0)], "named twice"),
        ([(tmp_path / "other", 0.0)], "the weight is a number above 0"),
    ):
        with pytest.raises(BadInput, match=words):
            train(dataset.path, tmp_path / "new", also=also, stage="renderer")
    with pytest.raises(BadInput, match="only a renderer learns from several"):
        train(dataset.path, bundle.folder, also=[(tmp_path / "other", 1.0)], stage="vq")
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("text", "meant"),
    [("a", ("a", 1)), ("a:0.5", ("a", 0.5)), ("C:/a", ("C:/a", 1)), ("C:/a:2", ("C:/a", 2))],
)
def test_a_weight_stands_behind_the_last_colon(text, meant):
    assert weighted(text) == (Path(meant[0]), meant[1])
