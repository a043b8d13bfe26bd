import torch

from mraa.extract import extract_dataset
from mraa.motion import read_motion


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
