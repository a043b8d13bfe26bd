"""TriCon on joints: directions of bones, whose lengths are those of the start pose."""

from dataclasses import replace

import pytest
import torch

from angie.generators.tricon.family import FAMILY, tiny
from angie.generators.tricon.generate import TriConGenerator
from angie.generators.tricon.model import TriCon
from angie.generators.tricon.train import begin_model
from angie.motion.clips import MotionClip
from angie.motion.statistics import measure
from data_prep.speech.features import Speech
from mraa.motion import Motion


@pytest.fixture(scope="module")
def joints(talks):
    """The talks as three joints."""
    return [
        MotionClip(clip.name, clip.speaker, Motion.of_points(100 * clip.motion.shift), clip.speech)
        for clip in talks
    ]


@pytest.mark.parametrize("bones", [(), (-1, 0, 1)])
def test_bones_keep_their_lengths(joints, make_context, tmp_path, bones):
    settings = FAMILY.fit(tiny(), 3, True)
    settings = replace(settings, model=replace(settings.model, bones=bones))
    assert FAMILY.fit(settings, 3, True) == settings
    context = replace(make_context(tmp_path, settings), statistics=measure(joints))
    model = begin_model(context, joints, [])
    assert isinstance(model, TriCon) and model.poses.size == 4
    if bones:
        assert model.poses.parents.tolist() == list(bones)
    generator = TriConGenerator(model, measure(joints))
    start = joints[3].motion[:1]
    speech = Speech(joints[3].speech.samples, joints[3].speech.words)
    motion = generator.generate(speech, start, 100, speaker="ada")
    assert motion.frames == 100 and not motion.has_extent
    assert torch.equal(motion.shift[0], start.shift[0])
    own = generator.generate_own(speech, start, 60, speaker="ada")
    child = model.poses.parents >= 0

    def lengths(moved):
        above = moved.shift[:, model.poses.parents.clamp_min(0)]
        return (moved.shift - above)[:, child].norm(dim=-1)

    # what is left of the start pose has died away after four seconds
    assert torch.allclose(lengths(own)[-1], lengths(start)[0], rtol=0.1)
