import numpy as np
import torch

from mraa.extract import estimate, extract_dataset, measure_motion
from mraa.motion import read_motion
from mraa.renderer import HourglassConfig, Renderer, RendererConfig


def test_processes_measure_what_one_does(dataset, bundle, tmp_path):
    estimator = bundle.renderer().estimator
    for jobs in (0, 2):
        extract_dataset(dataset, estimator, tmp_path / f"{jobs}", "mine", jobs=jobs)
    for clip in dataset.clips():
        one, two = (read_motion(tmp_path / f"{jobs}" / f"{clip.id}.npz", "mine") for jobs in (0, 2))
        assert torch.allclose(one.vector(), two.vector(), atol=1e-5)
        assert one.frames == clip.n_frames


def test_measured_clips_are_kept_unless_another_estimator_measured_them(dataset, bundle, tmp_path):
    estimator = bundle.renderer().estimator
    extract_dataset(dataset, estimator, tmp_path, "mine")
    path = tmp_path / f"{dataset.clips()[0].id}.npz"
    before = path.stat().st_mtime_ns
    extract_dataset(dataset, estimator, tmp_path, "mine", jobs=2)
    assert path.stat().st_mtime_ns == before
    (tmp_path / f"{dataset.clips()[-1].id}.npz").unlink()
    threads = torch.get_num_threads()
    extract_dataset(dataset, estimator, tmp_path, "mine", jobs=2)
    assert torch.get_num_threads() == threads  # for a single clip no process is begun
    extract_dataset(dataset, estimator, tmp_path, "another's")
    assert path.stat().st_mtime_ns > before


def test_frames_are_taken_as_they_are_needed():
    config = RendererConfig(regions=2, estimator=HourglassConfig(4, 3, 16))
    estimator, taken = Renderer(config).estimator.eval(), []

    def pictures():
        for i in range(9):
            taken.append(i)
            yield np.full((64, 64, 3), 20 * i, np.uint8)

    chunks = estimate(estimator, pictures(), 4)
    assert next(chunks).shift.shape == (4, 2, 2) and len(taken) == 4
    assert not next(chunks).shift.requires_grad and len(taken) == 8
    assert next(chunks).shift.shape == (1, 2, 2)
    motion = measure_motion(estimator, pictures(), 4)
    assert motion.shift.shape == (9, 2, 2) and motion.cholesky.shape == (9, 2, 3)
