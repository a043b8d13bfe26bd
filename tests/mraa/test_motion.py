import numpy as np
import pytest
import torch

from data_prep.errors import BadInput
from mraa.affine import decode_cholesky, encode_cholesky
from mraa.motion import (
    Motion,
    amplified,
    deltas,
    integrate,
    positive,
    read_motion,
    render_floor,
    write_motion,
)


def covariances(count: int, seed: int = 0) -> torch.Tensor:
    root = torch.randn(count, 2, 2, generator=torch.Generator().manual_seed(seed)) * 0.2
    return root @ root.mT + 1e-4 * torch.eye(2)


def test_cholesky_of_a_hand_worked_covariance():
    # [[4, 2], [2, 10]] = L L^T with L = [[2, 0], [1, 3]]
    factor = encode_cholesky(torch.tensor([[4.0, 2.0], [2.0, 10.0]]))
    assert factor.tolist() == [2.0, 1.0, 3.0]
    assert decode_cholesky(factor).tolist() == [[4.0, 2.0], [2.0, 10.0]]


def test_cholesky_round_trip():
    covariance = covariances(10_000)
    error = decode_cholesky(encode_cholesky(covariance)) - covariance
    assert error.abs().max() < 1e-6


def test_cholesky_agrees_with_lapack():
    covariance = covariances(1000).double()
    expected = torch.linalg.cholesky(covariance)
    factor = encode_cholesky(covariance)
    assert torch.allclose(factor[:, 0].double(), expected[:, 0, 0], atol=1e-6)
    assert torch.allclose(factor[:, 1].double(), expected[:, 1, 0], atol=1e-6)
    assert torch.allclose(factor[:, 2].double(), expected[:, 1, 1], atol=1e-4)


def test_cholesky_of_a_singular_covariance_is_finite():
    factor = encode_cholesky(torch.tensor([[0.0, 0.0], [0.0, 0.0]]))
    assert torch.isfinite(factor).all() and factor[0] > 0 and factor[2] > 0


def test_the_vector_holds_the_shifts_first():
    shift = torch.arange(4.0).reshape(1, 2, 2)
    cholesky = torch.arange(10.0, 16.0).reshape(1, 2, 3)
    vector = Motion(shift, cholesky).vector()
    assert vector.tolist() == [[0, 1, 2, 3, 10, 11, 12, 13, 14, 15]]
    again = Motion.from_vector(vector)
    assert torch.equal(again.shift, shift) and torch.equal(again.cholesky, cholesky)


def test_shapes_that_do_not_belong_together_are_refused():
    with pytest.raises(ValueError, match="cholesky"):
        Motion(torch.zeros(3, 2, 2), torch.zeros(4, 2, 3))


def test_deltas_and_integrate_are_inverse():
    motion = torch.randn(2, 96, 25).cumsum(1) * 0.01
    relative = deltas(motion)
    assert relative.shape == motion.shape and (relative[:, 0] == 0).all()
    assert torch.allclose(integrate(relative, motion[:, 0]), motion, atol=1e-6)


def test_the_first_delta_is_discarded():
    relative = torch.tensor([[9.0], [1.0], [2.0]])
    assert integrate(relative, torch.tensor([5.0])).tolist() == [[5.0], [6.0], [8.0]]


def test_positivity_touches_the_diagonal_only():
    cholesky = torch.tensor([[[-0.2, -0.3, -0.4], [0.2, -0.3, 0.4]]])
    fixed = positive(Motion(torch.zeros(1, 2, 2), cholesky)).cholesky
    expected = torch.tensor([[[1e-5, -0.3, 1e-5], [0.20001, -0.3, 0.40001]]])
    assert torch.allclose(fixed, expected, atol=1e-8)


def test_a_floored_motion_is_positive_definite():
    wild = positive(Motion(torch.zeros(100, 4, 2), torch.randn(100, 4, 3)))
    floored = render_floor(wild, torch.full((4, 2), 0.05), torch.full((4, 2), 0.2))
    assert torch.linalg.eigvalsh(floored.covariance().double()).min() > 0


def test_render_floor_is_in_units_of_training_percentiles():
    cholesky = torch.tensor([[[0.001, 0.5, 0.9]]])
    low, high = torch.tensor([[0.1, 0.1]]), torch.tensor([[0.2, 0.2]])
    fixed = render_floor(Motion(torch.zeros(1, 1, 2), cholesky), low, high).cholesky
    assert torch.allclose(fixed, torch.tensor([[[0.03, 0.5, 0.3]]]))


def test_render_floor_leaves_the_start_pose_alone():
    start = Motion(torch.zeros(1, 1, 2), torch.tensor([[[0.01, 0.0, 0.7]]]))
    low, high = torch.tensor([[0.1, 0.1]]), torch.tensor([[0.2, 0.2]])
    assert torch.equal(render_floor(start, low, high, start).cholesky, start.cholesky)


def test_a_motion_file_reads_back_and_knows_its_estimator(tmp_path):
    motion = Motion(torch.randn(5, 3, 2), torch.rand(5, 3, 3) + 0.1)
    write_motion(tmp_path / "a.npz", motion, "abc")
    again = read_motion(tmp_path / "a.npz", "abc")
    assert torch.equal(again.vector(), motion.vector())
    with pytest.raises(BadInput, match="another region estimator"):
        read_motion(tmp_path / "a.npz", "def")
    with pytest.raises(BadInput, match=r"b\.npz"):
        read_motion(tmp_path / "b.npz")


def test_generated_regions_are_read_where_any_estimator_will_do(tmp_path):
    motion = Motion(torch.randn(5, 3, 2), torch.rand(5, 3, 3) + 0.1)
    path = tmp_path / "a.npz"
    np.savez(path, shift=motion.shift, cholesky=motion.cholesky, fps=np.array(25.0))
    assert torch.equal(read_motion(path).vector(), motion.vector())
    with pytest.raises(BadInput, match="run the motion stage"):
        read_motion(path, "abc")


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({"points": np.zeros((5, 3, 2))}, "has no 'shift'"),
        ({"shift": np.zeros((5, 3, 2)), "cholesky": np.zeros((5, 2, 3))}, r"\(5, 2, 3\)"),
        ({"shift": np.full((5, 3, 2), 1e300), "cholesky": np.ones((5, 3, 3))}, "not finite"),
        ({"shift": np.zeros((5, 3, 2)), "cholesky": np.full((5, 3, 3), -1)}, "not above 0"),
    ],
)
def test_other_arrays_are_no_motion_of_regions(tmp_path, arrays, words):
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(BadInput, match=rf"a\.npz: .*{words}.*wanted is an \.npz"):
        read_motion(tmp_path / "a.npz")


def test_what_is_no_array_is_told_plainly(tmp_path):
    (tmp_path / "a.npz").write_text("words")
    with pytest.raises(BadInput, match=r"a\.npz: not a motion file \(no array file\); wanted is"):
        read_motion(tmp_path / "a.npz")


def test_motion_of_the_same_kind_of_vectors():
    regions, points = Motion(torch.randn(2, 3, 2), torch.rand(2, 3, 3)), torch.randn(2, 4, 2)
    assert torch.equal(regions.like(regions.vector()).cholesky, regions.cholesky)
    joints = Motion.of_points(points)
    again = joints.like(joints.vector())
    assert torch.equal(again.shift, points) and not again.has_extent


def test_joints_are_no_motion_of_regions(tmp_path):
    np.save(tmp_path / "a.npy", np.zeros((5, 3, 2)))
    with pytest.raises(BadInput, match=r"a\.npy: .*a single array.*wanted is an \.npz"):
        read_motion(tmp_path / "a.npy")


def test_amplitude_scales_the_way_from_a_pose_and_keeps_covariances_proper():
    pose = Motion(torch.zeros(1, 2, 2), torch.tensor([[[0.2, 0.1, 0.1]] * 2]))
    motion = Motion(torch.ones(3, 2, 2), torch.tensor([[[0.1, -0.1, 0.4]] * 2] * 3))
    half = amplified(motion, pose, torch.tensor([0.5, 0.0]))
    assert torch.equal(half.shift[:, 0], torch.full((3, 2), 0.5))
    torch.testing.assert_close(half.cholesky[0], torch.tensor([[0.15, 0.0, 0.25], [0.2, 0.1, 0.1]]))
    assert torch.equal(half.shift[:, 1], torch.zeros(3, 2))
    assert torch.allclose(amplified(motion, pose, 1.0).vector(), motion.vector())
    # 0.2 + 3 (0.1 - 0.2) is negative: l1 stays at half of the lesser of the two
    assert amplified(motion, pose, 3.0).cholesky[0, 0].tolist() == pytest.approx([0.05, -0.5, 1.0])
    joints = Motion.of_points(torch.ones(3, 2, 2))
    assert torch.equal(amplified(joints, joints[:1], 0.3).shift, joints.shift)
