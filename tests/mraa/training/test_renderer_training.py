import colorsys
import dataclasses

import numpy as np
import pytest
import torch
from lightning_fabric.plugins.precision import MixedPrecision
from safetensors.torch import load_file, save_file

from data_prep.errors import BadInput
from mraa.renderer import GeneratorConfig, HourglassConfig, Renderer, RendererConfig
from mraa.training.objective import Objective, RendererTraining, images
from mraa.training.pairs import Augmentation, FramePairs, MixedPairs, Share, augment
from mraa.training.renderer import (
    adam,
    load_initial,
    perceptual_loss,
    reduced_estimator,
    train_renderer,
)
from mraa.training.run import RunConfig, launch

SMALL = RendererConfig(
    regions=3,
    estimator=HourglassConfig(4, 3, 16),
    background=HourglassConfig(4, 3, 16),
    background_scale=0.25,
    flow=HourglassConfig(4, 3, 16),
    generator=GeneratorConfig("lite", width=16, bottleneck_blocks=1),
)


def test_a_tiny_renderer_beats_copying_the_source(bundle):
    score = bundle.manifest["parts"]["renderer"]["report"]["reconstruction"]
    assert score["frames"] >= 10
    assert score["psnr"] > score["copy_psnr"]
    assert score["l1"] < score["copy_l1"]


def few_steps(dataset, folder, steps, resume=False, also=(), **changes):
    settings = {"batch": 2, "perceptual_width": 4, "perceptual_scales": (0.25,), "milestones": ()}
    training = RendererTraining(steps=steps, **{**settings, **changes})
    how = RunConfig(log_every=1)
    return train_renderer(
        dataset, SMALL, training, folder, run_config=how, resume=resume, also=also
    )


def test_resumed_training_is_the_uninterrupted_one(dataset, tmp_path):
    """Bit for bit, from any step, with averaged weights and a batch in parts."""
    stop = int(np.random.default_rng().integers(1, 4))
    changes = {"ema": 0.5, "accumulate": 2, "batch": 4}
    whole = few_steps(dataset, tmp_path / "whole", 4, **changes).state_dict()
    few_steps(dataset, tmp_path / "parts", stop, **changes)
    parts = few_steps(dataset, tmp_path / "parts", 4, resume=True, **changes).state_dict()
    assert all(torch.equal(whole[k], parts[k]) for k in whole)
    for name in ("curves/renderer.csv", "sheets/renderer-0000003.png"):
        files = [(tmp_path / folder / name).read_bytes() for folder in ("whole", "parts")]
        assert files[0] == files[1] and len(files[0]) > 300
    last = load_file(tmp_path / "whole" / "renderer.safetensors")
    kernel = "renderer.generator.final.weight"
    assert torch.equal(last["model.average.module." + kernel[9:]], whole[kernel[9:]])
    assert not torch.equal(
        last["model.renderer." + kernel], whole[kernel[9:]]
    )  # averaged, not the last


def test_a_frozen_estimator_stays_and_the_rest_learns(dataset, tmp_path):
    torch.manual_seed(3)
    given = Renderer(SMALL).state_dict()
    save_file(given, tmp_path / "given.safetensors")
    training = RendererTraining(
        steps=2,
        batch=2,
        perceptual_width=4,
        perceptual_scales=(0.25,),
        initial=str(tmp_path / "given.safetensors"),
        freeze_estimator=True,
        blend=0.5,
        occlusion_cost=1.0,
    )
    learned = train_renderer(dataset, SMALL, training, tmp_path / "run").state_dict()
    changed = {k.split(".")[0] for k in given if not torch.equal(given[k], learned[k])}
    assert changed == {"background", "flow", "generator"}


def test_one_pass_over_memory_takes_the_steps_of_the_plain_optimiser():
    weights = []
    for fused in (False, True):
        torch.manual_seed(0)
        estimator = Renderer(SMALL).estimator
        optimizer = adam(estimator, RendererTraining(rate=1e-3), fused=fused)
        for _ in range(3):
            for parameter in estimator.parameters():
                parameter.grad = torch.randn_like(parameter)
            optimizer.step()
        weights.append([p.detach() for p in estimator.parameters()])
    torch.testing.assert_close(*weights, rtol=1e-5, atol=1e-7)


def test_a_loss_scale_trains_too(dataset, tmp_path, monkeypatch):
    """Gradients have to be clipped before the step, which the fused optimiser would unscale."""

    def scaling(config, *, unused_parameters=False):
        fabric = launch(config, unused_parameters=unused_parameters)
        scaler = torch.amp.GradScaler("cpu", init_scale=1024.0)
        fabric.strategy.precision = MixedPrecision("16-mixed", "cpu", scaler)
        return fabric

    monkeypatch.setattr("mraa.training.run.launch", scaling)
    trained = few_steps(dataset, tmp_path, 2).state_dict()
    assert all(bool(value.isfinite().all()) for value in trained.values())


def test_losses_are_those_of_the_parts():
    torch.manual_seed(0)
    renderer = Renderer(SMALL).eval()
    frames = torch.randint(0, 256, (1, 2, 256, 256, 3), dtype=torch.uint8)
    training = RendererTraining(occlusion_cost=3.0, blend=0.5, perceptual_width=4)
    compare = perceptual_loss(training)
    with torch.no_grad():
        terms = Objective(renderer, training, compare).eval()(frames, torch.zeros(1, 31))
        source, driving = images(frames)
        regions, moved = renderer.estimator(source), renderer.estimator(driving)
        prediction, flow = renderer(source, regions, moved, renderer.background(source, driving))
        small = renderer.flow.down(driving)
        perceptual = compare(prediction, driving) + 0.5 * compare(flow.blend, small)
    assert 0 < float(terms["painted"]) < 3 and terms["taught"] == 0
    torch.testing.assert_close(terms["painted"], 3 * (1 - flow.occlusion).mean(), atol=1e-4, rtol=0)
    torch.testing.assert_close(terms["perceptual"], perceptual, rtol=1e-3, atol=0)
    torch.testing.assert_close(terms["l1"], (prediction - driving).abs().mean())
    # the transform of zeros is the identity
    assert float(terms["shift"]) < 1e-3 and float(terms["affine"]) < 1e-2


def test_a_teacher_is_followed():
    """|mu - mu_T| + |L - L_T|, worked out from the regions of both; none between equals."""
    torch.manual_seed(0)
    renderer, other = Renderer(SMALL).eval(), Renderer(SMALL).eval()
    frames = torch.randint(0, 256, (1, 2, 256, 256, 3), dtype=torch.uint8)
    training = RendererTraining(teacher="a", distill_weight=2.0, perceptual_width=4)
    compare = perceptual_loss(training)

    def taught(teacher):
        objective = Objective(renderer, training, compare, teacher).eval()
        assert not any("teacher" in name or "vgg" in name for name in objective.state_dict())
        return float(objective(frames, torch.zeros(1, 31))["taught"])

    with torch.no_grad():
        assert taught(renderer.estimator) == 0
        a, b = (r.estimator(torch.cat(images(frames))) for r in (renderer, other))
        roots = (torch.linalg.cholesky(x.covariance) for x in (a, b))
        lower = torch.tril_indices(2, 2)
        first, second = (root[..., lower[0], lower[1]] for root in roots)
        wanted = 2 * ((a.shift - b.shift).abs().mean() + (first - second).abs().mean())
        assert taught(other.estimator) == pytest.approx(float(wanted), rel=1e-3)


def test_the_teacher_sees_small_images_as_large_ones():
    torch.manual_seed(0)
    estimator = Renderer(RendererConfig()).estimator.eval()
    image = torch.nn.functional.interpolate(torch.rand(1, 3, 8, 8), size=256, mode="bicubic")
    small = torch.nn.functional.interpolate(image, size=128, mode="area")
    with torch.no_grad():
        large, reduced = estimator(image), reduced_estimator(estimator, 128)(small)
    assert estimator.down.step == 4
    torch.testing.assert_close(large.shift, reduced.shift, atol=0.02, rtol=0)


def test_unlike_weights_to_begin_with_are_told(tmp_path):
    renderer = Renderer(SMALL)
    path = tmp_path / "other.safetensors"
    save_file(Renderer(dataclasses.replace(SMALL, regions=4)).state_dict(), path)
    with pytest.raises(BadInput, match="estimator.regions.weight is 4x.* there and 3x.* here"):
        load_initial(renderer, path)
    state = renderer.state_dict()
    save_file({k: v for k, v in state.items() if k != "flow.mask.bias"}, path)
    with pytest.raises(BadInput, match="has no flow.mask.bias"):
        load_initial(renderer, path)
    save_file({**state, "more": torch.zeros(1)}, path)
    with pytest.raises(BadInput, match="more has no place"):
        load_initial(renderer, path)
    path.write_bytes(b"nothing")
    with pytest.raises(BadInput, match="not the weights of a renderer"):
        load_initial(renderer, path)
    given = Renderer(SMALL).state_dict()
    save_file({k: v.half() if v.is_floating_point() else v for k, v in given.items()}, path)
    load_initial(renderer, path)
    weight = renderer.state_dict()["flow.mask.bias"]
    assert weight.dtype == torch.float32 and torch.equal(weight, given["flow.mask.bias"].half())


def test_pairs_are_frames_of_one_clip_in_order(dataset):
    clips = dataset.clips("train")
    still = Augmentation(0, 0, 0, 0, 0, 0)
    pairs = FramePairs(dataset, clips, still)
    store = dataset.frames(clips[0])
    frames = np.stack([store[i] for i in range(len(store))])
    for seed in range(5):
        pair = pairs.draw(0, np.random.default_rng(seed)).frames.numpy()
        assert pair.shape == (2, 256, 256, 3) and pair.dtype == np.uint8
        first, second = (int(np.abs(frames.astype(int) - f).sum((1, 2, 3)).argmin()) for f in pair)
        assert first < second
        assert np.abs(frames[first].astype(int) - pair[0]).max() <= 1  # rounding of the jitter


class Named:
    """Pairs of a dataset, of which only name and clip are known."""

    def __init__(self, name, clips):
        self.name, self.clips = name, clips

    def __len__(self):
        return self.clips

    def draw(self, index, random):
        return self.name, index


def test_datasets_are_drawn_from_by_weight_and_their_clips_evenly():
    mixed = MixedPairs([Named("a", 2), Named("b", 50)], [1.0, 3.0])
    assert len(mixed) == 52
    drawn = [mixed.draw(0, np.random.default_rng(seed)) for seed in range(2000)]
    names, clips = zip(*drawn, strict=True)
    assert names.count("a") == pytest.approx(500, abs=60)  # three standard deviations
    assert clips.count(0) == pytest.approx(250 + 30, abs=60)
    assert drawn[:9] == [mixed.draw(7, np.random.default_rng(seed)) for seed in range(9)]


def test_a_further_dataset_changes_what_is_learnt(dataset, tmp_path):
    alone = few_steps(dataset, tmp_path / "alone", 2).state_dict()
    both = few_steps(dataset, tmp_path / "both", 2, also=[Share(dataset, 2.0)]).state_dict()
    assert not all(torch.equal(alone[k], both[k]) for k in alone)


def test_augmentation_treats_both_frames_alike():
    frame = np.random.default_rng(0).integers(0, 256, (32, 32, 3), dtype=np.uint8)
    pair = np.stack([frame, frame])
    for seed in range(8):
        made = augment(pair, Augmentation(zoom=0.3), np.random.default_rng(seed))
        assert np.array_equal(made[0], made[1]) and made.shape == pair.shape


def test_flips():
    pair = np.zeros((2, 4, 4, 3), np.uint8)
    pair[0, :, 0] = 200
    how = Augmentation(1, 1, 0, 0, 0, 0)
    made = augment(pair, how, np.random.default_rng(0))
    assert made[1, 0, 3, 0] == 200 and made.sum() == pair.sum()


def test_colours_change_by_the_hand_worked_amounts():
    """Grey 100 and 200: contrast pulls both towards their mean over both frames, 150."""
    pair = np.full((2, 4, 4, 3), 100, np.uint8)
    pair[1] = 200
    only = Augmentation(0, 0, 0, 0.5, 0, 0)
    made = augment(pair, only, np.random.default_rng(3))
    random = np.random.default_rng(3)
    random.random(2)  # the flips
    factor = [random.uniform(1 - amount, 1 + amount) for amount in (0, 0.5)][1]
    assert abs(factor - 1) > 0.05
    wanted = np.clip([150 - 50 * factor, 150 + 50 * factor], 0, 255)
    assert np.abs(made[:, 0, 0, 0] - wanted).max() <= 0.51
    red = np.zeros((2, 4, 4, 3), np.uint8)
    red[..., 0] = 255
    turned = augment(red, Augmentation(0, 0, 0, 0, 0, 0.5), np.random.default_rng(1))[0, 0, 0]
    random = np.random.default_rng(1)
    random.random(2)
    random.uniform(size=3)  # the other three
    hue = random.uniform(-0.5, 0.5) % 1
    assert np.abs(turned / 255 - colorsys.hsv_to_rgb(hue, 1, 1)).max() < 0.01
