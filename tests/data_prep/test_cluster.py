"""Work on a local Ray cluster: as in one process, and done again where a process died."""

import os
from pathlib import Path

import pytest

pytest.importorskip("ray")

from data_prep.cluster import spread_on_ray  # noqa: E402
from data_prep.dataset import Dataset  # noqa: E402
from data_prep.errors import BadInput  # noqa: E402
from data_prep.prepare.prepare import prepare  # noqa: E402

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module", autouse=True)
def cluster():
    import ray

    here = Path(__file__).parent  # the workers import the functions below from it
    there = {"PYTHONPATH": os.pathsep.join([str(here), str(here.parents[1])])}
    ray.init(
        address="local", num_cpus=2, include_dashboard=False, log_to_driver=False,
        runtime_env={"env_vars": there},
    )  # fmt: skip
    yield
    ray.shutdown()


def square(number):
    return number * number


def dies_once(mark: Path) -> str:
    if not mark.exists():
        mark.touch()
        os._exit(1)
    return "done again"


def refuses(number):
    raise BadInput(f"{number}: is no number")


def test_results_are_those_of_one_process_and_lost_work_is_done_again(tmp_path):
    assert dict(spread_on_ray(square, [1, 2, 3], "local")) == {1: 1, 2: 4, 3: 9}
    mark = tmp_path / "mark"
    assert dict(spread_on_ray(dies_once, [mark], "local")) == {mark: "done again"}
    with pytest.raises(BadInput, match="7: is no number"):
        list(spread_on_ray(refuses, [7], "local"))


def test_a_dataset_is_the_same(phantom_videos, dataset, tmp_path):
    prepare([phantom_videos], tmp_path / "dataset", ray="local")
    other = Dataset(tmp_path / "dataset")
    assert [clip.id for clip in other.clips()] == [clip.id for clip in dataset.clips()]
    for clip in dataset.clips():
        one, two = dataset.frames(clip), other.frames(clip)
        assert (one[0] == two[0]).all() and len(one) == len(two)
