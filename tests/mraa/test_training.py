import numpy as np
import torch
from safetensors.torch import save_file

from mraa.pairs import Augmentation, FramePairs, augment
from mraa.renderer import GeneratorConfig, HourglassConfig, Renderer, RendererConfig
from mraa.training import RendererTraining, _Objective, train_renderer

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


def test_resumed_training_is_the_uninterrupted_one(dataset, tmp_path):
    def run(folder, steps, resume=False):
        training = RendererTraining(
            steps=steps, batch=2, perceptual_width=4, perceptual_scales=(0.25,), milestones=()
        )
        return train_renderer(dataset, SMALL, training, tmp_path / folder, resume=resume)

    whole = run("whole", 4).state_dict()
    run("parts", 2)
    parts = run("parts", 4, resume=True).state_dict()
    assert all(torch.equal(whole[k], parts[k]) for k in whole)
    assert (tmp_path / "whole" / "sheets" / "renderer-0000003.png").stat().st_size > 10_000


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


def test_painting_costs_what_the_occlusion_hides():
    torch.manual_seed(0)
    renderer = Renderer(SMALL).eval()
    source, driving = torch.rand(2, 1, 3, 256, 256)
    with torch.no_grad():
        terms = _Objective(renderer, RendererTraining(occlusion_cost=3.0)).eval()(source, driving)
        regions, moved = renderer.estimator(source), renderer.estimator(driving)
        flow = renderer.flow(source, regions, moved, renderer.background(source, driving))
    assert 0 < float(terms["painted"]) < 3
    torch.testing.assert_close(terms["painted"], 3 * (1 - flow.occlusion).mean(), atol=1e-4, rtol=0)
    torch.testing.assert_close(terms["blend"], flow.blend, atol=1e-3, rtol=0)


def test_pairs_are_frames_of_one_clip_in_order(dataset):
    clips = dataset.clips("train")
    still = Augmentation(0, 0, 0, 0, 0, 0)
    pairs = FramePairs(dataset, clips, still)
    store = dataset.frames(clips[0])
    frames = np.stack([store[i] for i in range(len(store))])
    for seed in range(5):
        pair = pairs.draw(0, np.random.default_rng(seed)).numpy()
        assert pair.shape == (2, 256, 256, 3) and pair.dtype == np.uint8
        first, second = (int(np.abs(frames.astype(int) - f).sum((1, 2, 3)).argmin()) for f in pair)
        assert first < second
        assert np.abs(frames[first].astype(int) - pair[0]).max() <= 1  # rounding of the jitter


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
