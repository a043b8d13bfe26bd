"""Work spread over many machines by Ray, as `data_prep.processes.spread` does over processes.

All machines must see the same files by the same names, and have the same version installed.
"""

import logging
import os
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

from data_prep.errors import BadInput

Task = TypeVar("Task")
Result = TypeVar("Result")

RETRIES = 3
"""Times that work is done again whose process or machine was lost."""


def spread_on_ray(
    work: Callable[[Task], Result], tasks: Sequence[Task], address: str
) -> Iterator[tuple[Task, Result | None]]:
    """Do tasks on a cluster of Ray's.

    Args:
        work: a function at the top level of a module.
        tasks: what to call it with.
        address: of the cluster, "auto" for the one that this machine belongs to, or "local" for
            one of this machine alone, which is begun.

    Yields:
        each task with its result as they come; None where its process died again and again.

    Raises:
        BadInput: Ray is not installed, or no cluster answers.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # nobody is told of the use
    try:
        import ray
    except ImportError as error:
        raise BadInput('--ray: Ray is not installed; pip install "angie[ray]" brings it') from error
    if not ray.is_initialized():
        try:
            ray.init(address=address, include_dashboard=False if address == "local" else None,
                     log_to_driver=False, logging_level=logging.ERROR)  # fmt: skip
        except (ConnectionError, ValueError, RuntimeError) as error:
            why = " ".join(str(error).split())[:200]
            raise BadInput(f"--ray {address}: no cluster answers there ({why})") from error

    def call(task: Task) -> Result:  # a function, which `partial` is not
        return work(task)

    remote = ray.remote(num_cpus=1, max_retries=RETRIES)(call)
    running = {remote.remote(task): task for task in tasks}
    try:
        while running:
            (done, *_), _ = ray.wait(list(running), num_returns=1)
            task = running.pop(done)
            try:
                result = ray.get(done)
            except (ray.exceptions.WorkerCrashedError, ray.exceptions.NodeDiedError):
                yield task, None
                continue
            yield task, result
    finally:
        for left in running:
            ray.cancel(left, force=True)
