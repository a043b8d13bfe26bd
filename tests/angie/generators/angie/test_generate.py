import dataclasses
import runpy
from pathlib import Path

import numpy as np
import pytest
import torch

from angie.generators.angie.generate import AngieGenerator, GenerationConfig, voiced_tokens
from angie.generators.angie.gpt import CoSpeechGPT, GPTConfig
from angie.generators.angie.refiner import Refiner, RefinerConfig
from angie.generators.angie.sampling import Sampling, Window
from angie.generators.angie.tokenizer import DirectMotion, VQConfig, VQMotionExtractor
from angie.motion.drift import activity
from angie.motion.statistics import measure
from data_prep.errors import BadInput
from data_prep.speech.features import Speech
from mraa.motion import Motion


@pytest.fixture(scope="module")
def generator(statistics) -> AngieGenerator:
    """Parts with random weights that are large enough to move and to react."""
    torch.manual_seed(0)
    vq = VQMotionExtractor(VQConfig(regions=4, width=16, codes=32, code_width=8)).train()
    vq(torch.randn(8, 96, 20))
    gpt = CoSpeechGPT(GPTConfig(codes=32, width=24, heads=3, layers=2))
    refiner = Refiner(RefinerConfig(regions=4, sound=8, motion=8, hidden=8))
    for parameter in [*gpt.parameters(), refiner.shift.out.weight, refiner.cholesky.out.weight]:
        torch.nn.init.normal_(parameter, std=0.3)
    return AngieGenerator(vq, gpt, refiner, statistics)


def configured(generator: AngieGenerator, **changes) -> AngieGenerator:
    return dataclasses.replace(generator, config=dataclasses.replace(generator.config, **changes))


@pytest.fixture(scope="module")
def speech(make_clip) -> Speech:
    return make_clip(275, 5).speech


@pytest.fixture(scope="module")
def start(make_clip) -> Motion:
    return make_clip(8, 1).motion[:1]


def silence(frames: int) -> Speech:
    features = {
        "onset": np.zeros((-(-frames // 8), 426), np.float32),
        "mfcc": np.zeros((frames, 28, 12), np.float32),
    }
    return Speech.of_features(features, frames)


@pytest.mark.parametrize("frames", [1, 7, 8, 9, 96, 275])
@pytest.mark.parametrize("bounding", ["off", "on"])
def test_exactly_the_frames_asked_for_from_the_start_pose(
    generator, speech, start, frames, bounding
):
    motion = configured(generator, bounding=bounding).generate(speech, start, frames)
    assert motion.shift.shape == (frames, 4, 2) and motion.cholesky.shape == (frames, 4, 3)
    assert torch.equal(motion.vector()[0], start.vector()[0])


def test_the_same_seed_gives_the_same_motion_and_another_another(generator, speech, start):
    one = generator.generate(speech, start, 275, seed=1).vector()
    assert torch.equal(one, generator.generate(speech, start, 275, seed=1).vector())
    assert not torch.allclose(one, generator.generate(speech, start, 275, seed=2).vector())


def test_the_global_random_state_plays_no_part(generator, speech, start):
    torch.manual_seed(1)
    one = generator.generate(speech, start, 96, seed=1).vector()
    torch.manual_seed(2)
    assert torch.equal(one, generator.generate(speech, start, 96, seed=1).vector())


def test_greedy_follows_the_sound(generator, speech, start, make_clip):
    one = generator.generate(speech, start, 200, seed=1, greedy=True).vector()
    assert torch.equal(one, generator.generate(speech, start, 200, seed=2, greedy=True).vector())
    greedy = configured(generator, sampling=Sampling(method="greedy"))
    assert torch.equal(one, greedy.generate(speech, start, 200, greedy=None).vector())
    assert not torch.equal(one, greedy.generate(speech, start, 200).vector())  # sampled if asked
    assert generator.random and not greedy.random
    other = generator.generate(make_clip(275, 8).speech, start, 200, greedy=True).vector()
    assert not torch.allclose(one, other)


def test_covariances_stay_positive_definite(generator, speech, start):
    for bounding in ("off", "on"):
        motion = configured(generator, bounding=bounding).generate(speech, start, 275)
        assert torch.linalg.eigvalsh(motion.covariance().double()).min() > 0
        ceiling = 1.5 * generator.statistics.diagonal_high
        assert (motion.cholesky[..., ::2] <= ceiling + 1e-6).all()


def test_a_minute_of_silence_stays_bounded_whatever_the_codes_do(generator, statistics, start):
    # random decoders drift without end; bounded, the pattern stays in the training range, and
    # the residual, which sees one window at a time, cannot accumulate
    bounded = configured(generator, bounding="auto", refine=False)
    motion = bounded.generate(silence(1500), start, 1500)
    moved = (motion.vector() - start.vector())[:, :8]
    assert (moved <= statistics.high[:8] + 1e-4).all()
    assert (moved >= statistics.low[:8] - 1e-4).all()


def test_a_still_person_stays_still_for_a_minute(generator, start):
    # a decoder whose output is one constant has nothing but drift, which `mean` takes away
    still = configured(generator, bounding="on", refine=False)
    state = {name: value.clone() for name, value in still.vq.state_dict().items()}
    try:
        for stream in (still.vq.shift, still.vq.cholesky):
            torch.nn.init.zeros_(stream.decoder.layers[-1].weight)
        constant = still.vq.decode(torch.zeros(1, 2, 1, dtype=torch.int64))[0, :1]
        still.vq.mean.copy_((constant / activity(constant))[0])
        moved = still.generate(silence(1500), start, 1500).vector() - start.vector()
    finally:
        still.vq.load_state_dict(state)
    assert moved.abs().max() < 1e-4


def test_a_known_speaker_returns_to_the_rest_pose(generator, speech, start):
    bounded = configured(generator, bounding="on", refine=False)
    known = bounded.generate(speech, start, 275, speaker="ada")
    anyone = bounded.generate(speech, start, 275)
    assert not torch.allclose(known.vector(), anyone.vector())
    with pytest.raises(BadInput, match="did you mean 'ada'"):
        bounded.generate(speech, start, 275, speaker="adah")


@pytest.fixture(scope="module")
def joint(generator) -> AngieGenerator:
    """The generator with embeddings of ada, bob and anyone."""
    torch.manual_seed(0)
    gpt = CoSpeechGPT(dataclasses.replace(generator.gpt.config, joint=True), speakers=2)
    torch.nn.init.normal_(gpt.speaker.weight, std=2.0)
    gpt.load_state_dict({**gpt.state_dict(), **generator.gpt.state_dict()})
    return dataclasses.replace(generator, gpt=gpt)


def test_a_style_changes_the_motion_of_a_joint_model(joint, generator, speech, start):
    made = [joint.generate(speech, start, 96, style=name).vector() for name in ("ada", "bob", None)]
    for one, other in ((0, 1), (0, 2), (1, 2)):
        assert not torch.allclose(made[one][1:], made[other][1:])
    assert all(torch.equal(motion[0], start.vector()[0]) for motion in made)
    assert torch.equal(made[2], joint.generate(speech, start, 96).vector())
    alone = generator.generate(speech, start, 96, style="bob").vector()
    assert torch.equal(alone, generator.generate(speech, start, 96).vector())
    with pytest.raises(BadInput, match=r"known: ada, bob\); did you mean 'bob'"):
        joint.generate(speech, start, 96, style="bobb")


def test_a_style_keeps_a_stranger_where_the_photo_has_them(joint, statistics, speech, start):
    bounded = configured(joint, bounding="on", refine=False)
    apart = Motion(start.shift + 3.0, start.cholesky)  # far from where ada was
    styled = bounded.generate(speech, apart, 125, style="ada").shift - apart.shift
    low, high = (ends[:8].unflatten(-1, (4, 2)) for ends in (statistics.low, statistics.high))
    assert (styled >= low - 1e-4).all() and (styled <= high + 1e-4).all()
    # ada herself is drawn back to her own place: in 5 s by 1 - exp(-5 / 8) of the three units
    whole = bounded.generate(speech, apart, 125, speaker="ada").shift - apart.shift
    assert (whole[-1] < -1).all()


def test_a_style_replaces_that_of_the_speaker(joint, speech, start):
    one = joint.generate(speech, start, 40, speaker="bob", style="ada").vector()
    assert torch.equal(one, joint.generate(speech, start, 40, speaker="ada").vector())
    assert not torch.equal(one, joint.generate(speech, start, 40, speaker="bob").vector())


def test_short_motion_is_bounded_only_when_asked(generator, speech, start):
    plain = generator.generate(speech, start, 250).vector()
    auto = configured(generator, bounding="auto")
    assert torch.equal(plain, auto.generate(speech, start, 250).vector())
    plain = generator.generate(speech, start, 251).vector()
    assert not torch.equal(plain, auto.generate(speech, start, 251).vector())


def test_motion_without_refinement_is_the_pattern(generator, speech, start):
    refined = generator.generate(speech, start, 96).vector()
    pattern = configured(generator, refine=False).generate(speech, start, 96).vector()
    assert not torch.allclose(refined[20:], pattern[20:], atol=1e-4)
    assert torch.allclose(refined[:1], pattern[:1])


def test_windows_of_codes_can_be_decoded_by_themselves(generator, speech, start):
    chunked = configured(generator, decode="chunked")
    assert torch.allclose(
        chunked.generate(speech, start, 96).vector(),
        generator.generate(speech, start, 96).vector(),
        atol=1e-5,
    )
    assert chunked.generate(speech, start, 275).frames == 275


def test_the_blend_reaches_decoder_and_refiner(generator, speech, start, monkeypatch):
    asked = []

    def blended(frames, window, compute, blend):
        asked.append(blend)
        return torch.zeros(frames, 20)

    for module in ("tokenizer", "refiner"):
        monkeypatch.setattr(f"angie.generators.angie.{module}.cross_fade", blended)
    configured(generator, decode="chunked", blend="hann").generate(speech, start, 200)
    assert asked == ["hann", "hann"]
    with pytest.raises(ValueError, match="blend is one of linear, hann, ahead, not 'Hann'"):
        GenerationConfig(blend="Hann")


def test_seed_codes_begin_the_sequence(generator, speech, start):
    onset = torch.as_tensor(speech["onset"])
    begin = torch.tensor([[1, 2, 3], [4, 5, 6]])
    assert torch.equal(generator.draw_codes(onset, 0, begin)[:, :3], begin)
    assert torch.equal(generator.draw_codes(onset, 0, None)[:, 0], generator.vq.start_codes())


def test_too_little_sound_or_a_foreign_pose_is_refused(generator, speech, start):
    with pytest.raises(ValueError, match="276 frames need"):
        generator.generate(speech, start, 276)
    with pytest.raises(ValueError, match="4 regions"):
        generator.generate(speech, Motion(torch.zeros(1, 5, 2), torch.zeros(1, 5, 3)), 8)


def test_parts_that_do_not_fit_are_refused(generator):
    other = Refiner(RefinerConfig(regions=5, sound=8, motion=8, hidden=8))
    with pytest.raises(ValueError, match="not trained on one another"):
        dataclasses.replace(generator, refiner=other)
    with pytest.raises(ValueError, match="auto, on, off"):
        GenerationConfig(bounding="perhaps")


def test_voiced_tokens_stand_out_of_the_noise_floor():
    onset = torch.zeros(20, 426)
    onset[:, 0] = -300.0
    onset[5:10, 0] = -100.0
    assert voiced_tokens(onset).nonzero().flatten().tolist() == [5, 6, 7, 8, 9]
    assert not voiced_tokens(torch.zeros(20, 426)).any()


def test_codes_of_a_clip_begin_the_motion(generator, speech, start, make_clip):
    clip = make_clip(275, 5).motion
    codes = generator.codes_of(clip)
    assert codes.shape == (2, 35)  # 275 frames are 34 tokens and 3 frames
    poses = torch.cat([clip[:1].vector(), clip.vector(), clip[-1:].vector().repeat(5, 1)])
    values = poses.diff(dim=0) / generator.statistics.delta_scale
    assert torch.equal(codes, generator.vq.encode(values[None])[0])
    begun = generator.generate(speech, start, 96, start_codes=codes)
    other = generator.generate(speech, start, 96, seed=5, start_codes=codes)
    assert torch.equal(begun.vector(), other.vector())  # nothing is left to be drawn
    assert generator.codes_of(clip[:7]).shape == (2, 1)


def test_a_seed_motion_gives_its_first_pair_of_codes(generator, speech, start, make_clip):
    clip = make_clip(275, 5).motion
    first = generator.codes_of(clip[:96])[:, :1]
    begun = generator.generate(speech, start, 96, seed_motion=clip).vector()
    assert torch.equal(begun, generator.generate(speech, start, 96, start_codes=first).vector())
    assert not torch.equal(begun, generator.generate(speech, start, 96).vector())


def test_a_clip_is_reconstructed_through_all_its_codes(generator, make_clip):
    clip = make_clip(275, 5)
    made = configured(generator, bounding="on").reconstruct(clip.speech, clip.motion)
    codes = generator.codes_of(clip.motion)
    plain = generator.generate(clip.speech, clip.motion[:1], 275, start_codes=codes)
    assert torch.equal(made.vector(), plain.vector())


def test_what_the_generator_does_not_have_is_refused(generator, speech, start):
    with pytest.raises(BadInput, match="give ANGIE.s Controls"):
        generator.generate(speech, start, 8, controls=object())
    with pytest.raises(BadInput, match="names of speakers only"):
        generator.generate(speech, start, 8, style=torch.ones(2))
    with pytest.raises(NotImplementedError, match="whole recording at once"):
        generator.stream(start)


def test_auto_decodes_as_training_found_better(generator, speech, start):
    auto = configured(generator, decode="auto")
    for chunked, name in ((False, "full"), (True, "chunked")):
        made = dataclasses.replace(auto, chunked=chunked).generate(speech, start, 275)
        expected = configured(generator, decode=name).generate(speech, start, 275)
        assert torch.equal(made.vector(), expected.vector())


def test_reanchored_motion_differs_only_after_a_pause(generator, start):
    bounded = configured(generator, bounding="on", refine=False)
    anchored = configured(bounded, reanchor=True)
    calm = dataclasses.replace(anchored.statistics, calm=torch.tensor([1e9]))
    anchored = dataclasses.replace(anchored, statistics=calm)
    plain = bounded.generate(silence(500), start, 500).vector()
    moved = anchored.generate(silence(500), start, 500).vector()
    assert torch.equal(plain[:200], moved[:200])
    assert not torch.allclose(plain[230:], moved[230:], atol=1e-4)


@pytest.mark.parametrize("quant", ["mu_L", "dmu_L", "mu_dL", "no_cholesky"])
def test_variants_generate_too(generator, speech, start, quant):
    sizes = dataclasses.replace(generator.vq.config, quant=quant)
    vq = VQMotionExtractor(sizes)
    vq.load_state_dict(generator.vq.state_dict())
    variant = dataclasses.replace(generator, vq=vq)
    motion = configured(variant, bounding="auto").generate(speech, start, 275)
    assert torch.equal(motion.vector()[0], start.vector()[0])
    assert torch.linalg.eigvalsh(motion.covariance().double()).min() > 0
    assert not torch.allclose(motion.vector(), generator.generate(speech, start, 275).vector())


def test_without_codes_motion_is_regressed_from_the_sound(generator, speech, start, make_clip):
    torch.manual_seed(0)
    sizes = dataclasses.replace(generator.vq.config, quant="no_quant")
    direct = DirectMotion(sizes, generator.gpt.config).eval()
    for parameter in direct.transformer.parameters():
        torch.nn.init.normal_(parameter, std=0.3)
    with pytest.raises(ValueError, match="not trained on one another"):
        dataclasses.replace(generator, vq=direct)
    without = dataclasses.replace(generator, vq=direct, gpt=None)
    motion = without.generate(speech, start, 275, seed=1)
    assert motion.frames == 275 and torch.equal(motion.vector()[0], start.vector()[0])
    assert without.codes_of(make_clip(96, 1).motion) is None
    assert torch.equal(without.generate(speech, start, 275, seed=2).vector(), motion.vector())
    onset = without.statistics.standard_onset(torch.as_tensor(speech["onset"]))
    window = direct(onset[None, :12])[0]
    assert torch.allclose(direct.predict(onset[:12]), window, atol=1e-5)
    assert torch.allclose(direct.predict(onset)[:48], window[:48], atol=1e-4)
    later = onset[:12].clone()
    later[6:] += 1  # a step hears nothing later; the decoder alone sees the steps around it
    latent, changed = (
        direct.transformer(torch.zeros(1, 2, 12, dtype=torch.int64), sound[None])
        for sound in (onset[:12], later)
    )
    assert torch.equal(latent[:, :, :6], changed[:, :, :6])


def test_points_without_extent(generator, clips):
    points = [
        dataclasses.replace(clip, motion=Motion.of_points(clip.motion.shift)) for clip in clips[:4]
    ]
    statistics = measure(points)
    torch.manual_seed(0)
    vq = VQMotionExtractor(dataclasses.replace(generator.vq.config, streams=1)).train()
    vq(torch.randn(8, 96, 8))
    gpt = CoSpeechGPT(dataclasses.replace(generator.gpt.config, streams=1))
    refiner = Refiner(dataclasses.replace(generator.refiner.config, streams=1))
    made = AngieGenerator(vq, gpt, refiner, statistics, GenerationConfig(bounding="auto"))
    motion = made.generate(points[0].speech, points[0].motion[:1], 250)
    assert motion.shift.shape == (250, 4, 2) and not motion.has_extent
    assert made.generate(points[0].speech, points[0].motion[:1], 250, speaker="ada").frames == 250
    with pytest.raises(ValueError, match="not trained on one another"):
        dataclasses.replace(made, gpt=generator.gpt)


@pytest.mark.parametrize("context", [3, 6])
def test_windows_of_the_gpt_begin_where_seams_are_looked_for(
    generator, speech, monkeypatch, context
):
    path = Path(__file__).parents[4] / "scripts" / "check_angie.py"
    borders = runpy.run_path(str(path))["borders"]
    hopping = configured(generator, window=Window("hop", context))
    assert hopping.gpt is not None
    seen, advance = [], hopping.gpt.advance

    def watched(codes, *rest):
        seen.append(codes.shape[-1])
        return advance(codes, *rest)

    monkeypatch.setattr(hopping.gpt, "advance", watched)
    onset = torch.as_tensor(speech["onset"])
    hopping.draw_codes(onset, 0, None)
    begun = [step for step, codes in enumerate(seen, 1) if codes > 1]
    assert len(begun) > 1 and (borders(hopping, 8 * len(onset))["gpt"] / 8).tolist() == begun
    sliding = configured(generator, window=Window("slide"))
    assert len(borders(sliding, 8 * len(onset))["gpt"]) == 0


def test_residuals_come_back_in_the_units_of_the_pose(generator, monkeypatch):
    seen = []

    def refine(self, mfcc, pattern, standard, blend):
        seen.append((standard(mfcc), pattern))
        return torch.ones_like(pattern)

    monkeypatch.setattr(Refiner, "refine", refine)
    mfcc, pattern = torch.randn(20, 28, 12), torch.randn(20, 20)
    residual, scale = generator.residual(mfcc, pattern), generator.statistics.pose_scale
    ramp = torch.tensor([min(i / 8, 1.0) for i in range(20)])
    assert torch.allclose(residual, scale * ramp[:, None])
    statistics = generator.statistics
    assert torch.allclose(seen[0][0], (mfcc - statistics.mfcc_mean) / statistics.mfcc_scale)
    assert torch.allclose(seen[0][1] * scale, pattern, atol=1e-6)


def test_the_sound_of_the_frames_reaches_the_motion(generator, speech, start):
    parts = {name: speech[name] for name in ("onset", "mfcc")}
    parts["mfcc"] = parts["mfcc"] + np.float32(1)
    other = Speech.of_features(parts, speech.frames)
    one, two = (generator.generate(s, start, 96, seed=1).vector() for s in (speech, other))
    assert not torch.allclose(one, two, atol=1e-5)
    bare = configured(generator, refine=False)
    one, two = (bare.generate(s, start, 96, seed=1).vector() for s in (speech, other))
    assert torch.equal(one, two)  # only the refiner hears them


def test_without_the_render_floor_factors_are_relu_plus_epsilon(generator, start):
    motion = start.vector().repeat(3, 1)
    motion[1:, 8] = -1.0  # l1 of the first region
    motion[1:, 10] = 5.0  # its l3
    made = configured(generator, render_floor=False).renderable(motion, start.vector()[0])
    assert made.cholesky[1, 0, 0] == pytest.approx(1e-5, rel=1e-3)
    assert made.cholesky[1, 0, 2] == pytest.approx(5 + 1e-5)
    floored = generator.renderable(motion, start.vector()[0])
    low, high = generator.statistics.diagonal_low, generator.statistics.diagonal_high
    assert floored.cholesky[1, 0, 0] == pytest.approx(float(0.3 * low[0, 0]))
    assert floored.cholesky[1, 0, 2] == pytest.approx(float(1.5 * high[0, 1]))
