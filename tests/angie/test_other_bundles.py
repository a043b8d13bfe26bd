import dataclasses

import pytest

from angie.bundle import BUNDLE, Bundle
from angie.config import preset
from angie.opening import initial_weights, teacher_of
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
