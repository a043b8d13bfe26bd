"""What TriCon generates: begun with a pose, window by window, in a style."""

import itertools

import numpy as np
import pytest
import torch

from angie.generators.base import begin_at, read_style, resample
from angie.generators.tricon.generate import fade_in
from data_prep.errors import BadInput
from data_prep.speech.features import Speech
from data_prep.speech.words import Word
from mraa.motion import Motion

NAMES = ("ada", "bob")


UP = (Word("up", 1.0, 1.2),)


def speech(seconds, words=UP, seed=0):
    rng = np.random.default_rng(seed)
    return Speech((0.01 * rng.normal(size=int(seconds * 16_000))).astype(np.float32), words)


@pytest.fixture(scope="module")
def start(talks):
    return talks[0].motion[:1]


def test_windows_fade_into_one_another():
    faded = fade_in(torch.zeros(4, 1), torch.ones(4, 1))
    assert torch.allclose(faded[:, 0], torch.tensor([0.2, 0.4, 0.6, 0.8]))


def test_it_begins_with_the_pose_and_is_as_long_as_wanted(generator, start):
    for frames in (1, 2, 57, 58, 140):
        motion = generator.generate(speech(6), start, frames)
        assert motion.frames == frames
        assert torch.equal(motion.vector()[0], start.vector()[0])
        assert motion.vector().isfinite().all() and (motion.cholesky[..., ::2] > 0).all()


def test_a_far_pose_does_not_jump(generator, talks, start):
    vector = start.vector().clone()
    vector[:, :6] += 0.5  # sits elsewhere than anybody
    vector[:, 6:] *= 2
    motion = generator.generate(speech(6), start.like(vector), 150, speaker="ada")
    step = motion.shift.diff(dim=0).norm(dim=-1)
    fastest = max(float(clip.motion.shift.diff(dim=0).norm(dim=-1).max()) for clip in talks)
    assert step[0].max() <= fastest


def test_every_seed_style_word_and_sound_counts(generator, start):
    said = speech(4)

    def vector(given=said, **options):
        return generator.generate(given, start, 100, **options).vector()

    plain = vector(style="ada")
    assert torch.equal(plain, vector(style="ada"))
    others = [
        vector(style="ada", seed=1), vector(style="bob"), vector(style="ada:0.5,bob:0.5"),
        vector(speech(4, ()), style="ada"), vector(speech(4, seed=1), style="ada"),
        vector(style="ada", greedy=True), vector(speaker="ada"),
    ]  # fmt: skip
    for i, other in enumerate(others):
        assert all(not torch.equal(other, one) for one in [plain, *others[:i]]), i
    assert torch.equal(others[5], vector(style="ada", greedy=True, seed=9))
    with pytest.raises(ValueError, match="no controls"):
        vector(controls=1)


def test_recorded_motion_may_begin_it(generator, talks, start):
    motion = talks[0].motion
    own = generator.generate(speech(4), start, 60, speaker="bob", seed_motion=motion[:96])
    held = generator.generate(speech(4), start, 60, speaker="bob")
    assert not torch.equal(own.vector(), held.vector())


def test_long_sound_is_made_window_by_window(generator, start, monkeypatch):
    seen = []
    gesture = generator.model.gesture

    def watched(seeds, context, style):
        seen.append((seeds[0, :4, :-1].clone(), style, gesture(seeds, context, style)[0]))
        return seen[-1][2][None]

    monkeypatch.setattr(generator.model, "gesture", watched)
    generator.generate(speech(12), start, 300)
    # 12 s are 180 frames at 15 a second, and the last of 300 is at 11.96 s: ceil(146.4 / 30) + 1
    assert len(seen) == 6
    assert all(torch.equal(style, seen[0][1]) for _, style, _ in seen)  # drawn once
    for before, after in itertools.pairwise(seen):
        assert torch.allclose(after[0], before[2][-4:], atol=1e-6)


def test_seams_are_faded(generator, monkeypatch):
    seen = []
    gesture = generator.model.gesture

    def watched(seeds, context, style):
        seen.append(gesture(seeds, context, style)[0])
        return seen[-1][None]

    monkeypatch.setattr(generator.model, "gesture", watched)
    poses = generator.poses(speech(40), torch.zeros(4, 15), 600, torch.zeros(8))
    assert len(poses) == 600 and len(seen) == 20
    assert torch.equal(poses[:30], seen[0][:30])
    for number, (before, after) in enumerate(itertools.pairwise(seen), 1):
        seam = poses[30 * number : 30 * number + 4]
        for j in range(4):
            wanted = (before[30 + j] * (4 - j) + after[j] * (j + 1)) / 5
            assert torch.allclose(seam[j], wanted, atol=1e-6)
        assert torch.equal(poses[30 * number + 4 : 30 * number + 30], after[4:30])


def test_windows_before_do_not_know_what_comes(generator):
    whole = speech(20, None)
    changed = whole.samples.copy()
    changed[3 * 16_000 :] = 0
    long = [
        generator.poses(s, torch.zeros(4, 15), 300, torch.zeros(8))
        for s in (whole, Speech(changed))
    ]
    assert torch.equal(long[0][:30], long[1][:30]) and not torch.equal(long[0][60:], long[1][60:])


def test_styles_are_read():
    assert read_style("bob", NAMES, 8) == {"bob": 1.0}
    assert read_style("ada:0.3, bob:0.9", NAMES, 8) == {"ada": 0.3, "bob": 0.9}
    assert read_style("1,-2.5,3e-1", NAMES, 3).tolist() == pytest.approx([1, -2.5, 0.3])


@pytest.mark.parametrize(
    ("style", "size", "text"),
    [("bib", 8, "did you mean 'bob'"), ("ada:1,bib:1", 8, "did you mean 'bob'"),
     ("1,2", 8, "8 numbers"), ("1,x", 2, "2 numbers"), ("ada:-1,bob:2", 8, "ada:0.3,bob:0.7"),
     ("ada:0", 8, "mixture"), ("ada:x", 8, "mixture"), ("1,nan", 2, "numbers"),
     ("ada:1,bob:1", 0, "not a speaker")],
)  # fmt: skip
def test_styles_that_are_none(style, size, text):
    with pytest.raises(BadInput, match=text):
        read_style(style, NAMES, size)


def test_a_mixture_lies_between(generator):
    ada, bob, mixed, point = (
        generator.style_of(style, 3, True)
        for style in ("ada", "bob", "ada:1,bob:3", torch.arange(8.0))
    )
    assert torch.allclose(mixed, 0.25 * ada + 0.75 * bob, atol=1e-6)
    assert point.tolist() == list(range(8))
    assert torch.allclose(generator.style_of(None, 0, True), (ada + bob) / 2, atol=1e-6)
    anyone = {tuple(generator.style_of(None, seed, False).tolist()) for seed in range(4)}
    assert len(anyone) == 4
    with pytest.raises(BadInput, match="8 numbers"):
        generator.style_of(torch.zeros(3), 0, True)


def test_splines_keep_what_is_smooth():
    time = torch.arange(46) / 15
    shift = torch.stack([time.sin(), time.cos()], -1)[:, None]
    factor = torch.stack([time.sin().exp(), time, time.cos().exp()], -1)[:, None]
    motion = resample(Motion(shift, factor), 15, 25, 75, smooth=True)
    wanted = torch.arange(75) / 25
    assert torch.allclose(motion.shift[:, 0, 0], wanted.sin(), atol=1e-4)
    assert torch.allclose(motion.cholesky[:, 0, 0].log(), wanted.sin(), atol=1e-4)
    assert torch.equal(motion.shift[0], shift[0])
    coarse = resample(Motion(shift, factor), 15, 25, 75)
    assert (coarse.shift[:, 0, 0] - wanted.sin()).abs().max() > 1e-4


def test_what_is_off_at_first_dies_away():
    shift, factor = torch.zeros(31, 1, 2), torch.ones(31, 1, 3)
    start = Motion(torch.ones(1, 1, 2), torch.full((1, 1, 3), 2.0))
    motion = begin_at(Motion(shift, factor), start, 15)
    left = np.exp(-1)  # after a second
    assert torch.equal(motion.vector()[0], start.vector()[0])
    assert motion.shift[15].flatten().tolist() == pytest.approx([left, left])
    # l1 and l3 by the logarithm: 2 to the power of 1 / e; l2 as it is
    assert motion.cholesky[15, 0].tolist() == pytest.approx([2**left, 1 + left, 2**left])
