from dataclasses import replace

import pytest
import torch
from kornia.filters import gaussian_blur2d

from mraa.blocks import AntiAliasDown
from mraa.flow import FlowPredictor, region_heatmap, sparse_motions
from mraa.grid import coordinate_grid, warp
from mraa.losses import random_thin_plate
from mraa.regions import moments, regions_from_motion
from mraa.renderer import GeneratorConfig, HourglassConfig, Renderer, RendererConfig

SMALL = RendererConfig(
    regions=3,
    estimator=HourglassConfig(4, 3, 16),
    background=HourglassConfig(4, 3, 16),
    flow=HourglassConfig(4, 3, 16),
    generator=GeneratorConfig("lite", width=16, bottleneck_blocks=1),
)


def test_identity_warp_shifts_nothing():
    image = torch.rand(1, 2, 9, 12)
    flow = coordinate_grid(9, 12)[None]
    torch.testing.assert_close(warp(image, flow, align_corners=True), image, atol=1e-5, rtol=0)


def test_warp_keeps_layout_and_gradient():
    image = torch.rand(2, 4, 8, 8)
    flow = (coordinate_grid(8, 8) * 0.7).expand(2, -1, -1, -1)
    planes = image.clone().requires_grad_()
    rows = image.clone().contiguous(memory_format=torch.channels_last).requires_grad_()
    a, b = (warp(x, flow, align_corners=True) for x in (planes, rows))
    assert b.is_contiguous(memory_format=torch.channels_last)
    torch.testing.assert_close(a, b)
    a.square().sum().backward()
    b.square().sum().backward()
    torch.testing.assert_close(planes.grad, rows.grad)


def test_moments_of_two_cells():
    heatmap = torch.zeros(1, 1, 5, 5)
    heatmap[0, 0, 0, 0] = heatmap[0, 0, 4, 0] = 0.5  # both left corners
    shift, covariance = moments(heatmap)
    torch.testing.assert_close(shift[0, 0], torch.tensor([-1.0, 0.0]))
    torch.testing.assert_close(covariance[0, 0], torch.tensor([[0.0, 0.0], [0.0, 1.0]]))


def test_a_region_that_moves_right_fetches_from_the_left():
    covariance = torch.full((1, 1, 1, 1), 0.04) * torch.eye(2)
    source = regions_from_motion(torch.tensor([[[-0.5, 0.0]]]), covariance)
    driving = regions_from_motion(torch.tensor([[[0.25, 0.0]]]), covariance)
    fields = sparse_motions(source, driving, 3, 3, background=None, revert_axis_swap=True)
    grid = coordinate_grid(3, 3)
    torch.testing.assert_close(fields[0, 0], grid)
    torch.testing.assert_close(fields[0, 1], grid - torch.tensor([0.75, 0.0]))


def test_background_homography_moves_only_the_background():
    regions = regions_from_motion(torch.zeros(1, 1, 2), 0.04 * torch.eye(2)[None, None])
    matrix = torch.eye(3)[None].clone()
    matrix[0, 0, 2] = 0.5
    fields = sparse_motions(regions, regions, 2, 2, background=matrix, revert_axis_swap=True)
    grid = coordinate_grid(2, 2)
    torch.testing.assert_close(fields[0, 0], grid + torch.tensor([0.5, 0.0]))
    torch.testing.assert_close(fields[0, 1], grid)


def test_region_heatmap_is_one_at_the_centre_and_falls_by_the_covariance():
    regions = regions_from_motion(
        torch.zeros(1, 1, 2), torch.diag(torch.tensor([0.25, 1.0]))[None, None]
    )
    heatmap = region_heatmap(regions, 5, 5)[0, 0]
    assert float(heatmap[2, 2]) == 1
    assert float(heatmap[2, 3]) == pytest.approx(2.718281828**-0.5, abs=1e-6)  # x = 0.5, sd 0.5
    assert float(heatmap[3, 2]) == pytest.approx(2.718281828**-0.125, abs=1e-6)


@pytest.mark.parametrize("design", ["paper", "lite", "deep"])
def test_shapes_and_ranges(design):
    config = RendererConfig(**{**vars(SMALL), "generator": GeneratorConfig(design, 16, 32, 2, 1)})
    renderer = Renderer(config).eval()
    image = torch.rand(2, 3, 64, 64)
    regions = renderer.estimator(image)
    assert regions.shift.shape == (2, 3, 2)
    torch.testing.assert_close(regions.heatmap.sum(dim=(2, 3)), torch.ones(2, 3))
    assert (torch.linalg.eigvalsh(regions.covariance) > 0).all()
    background = renderer.background(image, image)
    torch.testing.assert_close(background, torch.eye(3).expand(2, 3, 3))  # before training
    prediction, flow = renderer(image, regions, regions, background)
    assert prediction.shape == image.shape
    assert 0 <= float(prediction.min()) and float(prediction.max()) <= 1
    assert flow.flow.shape == (2, 16, 16, 2)
    torch.testing.assert_close(flow.masks.sum(1), torch.ones(2, 16, 16))
    # the driving pose is the source's: every sparse motion is the identity
    grid = coordinate_grid(16, 16).expand(2, -1, -1, -1)
    torch.testing.assert_close(flow.flow, grid, atol=1e-3, rtol=0)


def test_thin_plate_jacobian_is_the_derivative():
    torch.manual_seed(0)
    transform = random_thin_plate(2)
    points = torch.rand(2, 5, 2) * 1.2 - 0.63
    jacobian = transform.jacobian(points)
    step = 1e-3
    for axis in range(2):
        offset = torch.zeros(2)
        offset[axis] = step
        slope = (transform.points(points + offset) - transform.points(points - offset)) / (2 * step)
        torch.testing.assert_close(jacobian[..., axis], slope, atol=2e-3, rtol=0)


def test_the_deep_generator_paints_by_the_pose():
    torch.manual_seed(0)
    config = RendererConfig(**{**vars(SMALL), "generator": GeneratorConfig("deep", 16, 32, 2, 1)})
    renderer = Renderer(config).eval()
    image = torch.rand(1, 3, 64, 64)
    features = renderer.generator.encode(image)
    flow = renderer.flow(image, *[renderer.estimator(image)] * 2)
    painted = renderer.generator.paint(features, flow)
    elsewhere = replace(flow, features=flow.features.flip(3))
    assert (renderer.generator.paint(features, elsewhere) - painted).abs().max() > 1e-3
    # the last blend keeps the source wherever the occlusion says that it shows
    shown = replace(flow, occlusion=torch.ones_like(flow.occlusion))
    torch.testing.assert_close(
        renderer.generator.decode(image, features, shown), image, atol=2e-3, rtol=0
    )


@pytest.mark.parametrize("scale", [0.5, 0.25, 0.125])
def test_the_low_pass_is_the_gaussian_blur_of_kornia(scale):
    """MRAA's sigma for a reduction by s is (s - 1) / 2, its window 2 round(4 sigma) + 1."""
    torch.manual_seed(0)
    image, step = torch.rand(1, 3, 64, 64), round(1 / scale)
    sigma = (step - 1) / 2
    size = 2 * round(4 * sigma) + 1
    wanted = gaussian_blur2d(image, (size, size), (sigma, sigma), border_type="constant")
    small = AntiAliasDown(3, scale)(image)
    torch.testing.assert_close(small, wanted[..., ::step, ::step], atol=1e-6, rtol=0)


def test_the_flow_predictor_sees_where_regions_went():
    torch.manual_seed(0)
    predictor = FlowPredictor(2, 8, 2, 16).eval()
    seen = []
    predictor.hourglass.register_forward_pre_hook(lambda _, inputs: seen.append(inputs[0]))
    covariance = 0.02 * torch.eye(2).expand(1, 2, 2, 2)
    here, there = (
        regions_from_motion(torch.tensor([[[x, 0.0], [0.5, 0.5]]]), covariance) for x in (-0.5, 0.5)
    )
    image = torch.rand(1, 3, 64, 64)
    predictor(image, here, there)
    stack = seen[0].view(1, 3, 4, 16, 16)  # background and two regions: heatmap, then RGB
    went = region_heatmap(there, 16, 16) - region_heatmap(here, 16, 16)
    assert torch.allclose(stack[0, 1:, 0], went[0]) and (stack[0, 0, 0] == 0).all()
    assert stack[0, 1, 0].max() > 0.8 and stack[0, 1, 0].min() < -0.8
    small = predictor.down(image)[0]
    assert torch.allclose(stack[0, 0, 1:], small, atol=1e-5)  # the background stays
    assert torch.allclose(stack[0, 2, 1:], small, atol=1e-5)  # and so does what did not move
    # the first region comes from 0.5 - -0.5 = 7.5 cells to the left
    moved = stack[0, 1, 1:, :, 8:]
    between = (small[:, :, :8] + small[:, :, 1:9]) / 2
    assert torch.allclose(moved, between, atol=1e-4)
