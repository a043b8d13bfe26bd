import dataclasses

import torch

from angie.generators.angie.refiner import Refiner, RefinerConfig

TINY = RefinerConfig(regions=4, sound=8, motion=8, hidden=8, layers=2)


def trained_by_chance() -> Refiner:
    torch.manual_seed(0)
    refiner = Refiner(TINY).eval()
    for stream in (refiner.shift, refiner.cholesky):
        torch.nn.init.normal_(stream.out.weight)
    return refiner


def test_zero_at_start():
    refiner = Refiner(TINY)
    residual = refiner(torch.randn(2, 96, 28, 12), torch.randn(2, 96, 20))
    assert residual.shape == (2, 96, 20) and (residual == 0).all()


def test_the_zero_start_learns():
    refiner = Refiner(TINY)
    refiner(torch.randn(2, 24, 28, 12), torch.randn(2, 24, 20)).sum().backward()
    assert refiner.shift.out.weight.grad.abs().sum() > 0


def test_the_place_of_the_person_does_not_matter():
    refiner = trained_by_chance()
    mfcc, pattern = torch.randn(1, 96, 28, 12), torch.randn(1, 96, 20)
    moved = refiner(mfcc, pattern + torch.randn(20))
    assert torch.allclose(refiner(mfcc, pattern), moved, atol=1e-5)


def test_each_stream_sees_its_own_motion_and_the_sound():
    refiner = trained_by_chance()
    mfcc, pattern = torch.randn(1, 24, 28, 12), torch.randn(1, 24, 20)
    residual = refiner(mfcc, pattern)
    other = pattern.clone()
    other[..., 8:] = torch.randn(1, 24, 12)
    changed = refiner(mfcc, other)
    assert torch.equal(changed[..., :8], residual[..., :8])
    assert not torch.allclose(changed[..., 8:], residual[..., 8:])
    louder = refiner(mfcc + 1, pattern)
    assert not torch.allclose(louder[..., :8], residual[..., :8])


def test_one_window_of_sound_is_one_forward():
    refiner = trained_by_chance()
    for frames in (1, 30, 96):
        mfcc, pattern = torch.randn(frames, 28, 12), torch.randn(frames, 20)
        whole = refiner(mfcc[None], pattern[None])[0]
        assert torch.allclose(refiner.refine(mfcc, pattern), whole, atol=1e-5)


def test_long_sound_is_refined_in_windows():
    refiner = trained_by_chance()
    mfcc, pattern = torch.randn(200, 28, 12), torch.randn(200, 20)
    residual = refiner.refine(mfcc, pattern)
    assert residual.shape == (200, 20)
    # frames 0 to 47 belong to the first window alone
    first = refiner(mfcc[None, :96], pattern[None, :96])[0]
    assert torch.allclose(residual[:48], first[:48], atol=1e-5)
    assert not torch.allclose(residual[60:96], first[60:], atol=1e-3)


def test_sizes_of_the_default():
    with torch.device("meta"):
        refiner = Refiner(RefinerConfig())
    assert refiner.shift.lstm.hidden_size == 256 and refiner.shift.lstm.num_layers == 2
    assert refiner.shift.out.weight.shape == (40, 512)
    assert refiner.cholesky.out.weight.shape == (60, 512)
    assert refiner.shift.lstm.weight_ih_l0.shape == (1024, 384)


def test_one_stream_alone():
    refiner = Refiner(dataclasses.replace(TINY, streams=1))
    assert refiner(torch.randn(2, 9, 28, 12), torch.randn(2, 9, 8)).shape == (2, 9, 8)
    assert not [name for name, _ in refiner.named_parameters() if "cholesky" in name]


def test_mfcc_windows_are_standardised_on_the_way():
    refiner = trained_by_chance()
    mfcc, pattern = torch.randn(120, 28, 12), torch.randn(120, 20)
    expected = refiner.refine(mfcc * 2, pattern)
    assert torch.allclose(refiner.refine(mfcc, pattern, lambda m: m * 2), expected, atol=1e-6)
