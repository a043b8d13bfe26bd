"""Work spread over processes, of which one may die without the others' work being lost."""

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import resource_tracker
from typing import TypeVar

MOST = 61 if sys.platform == "win32" else 512
"""Processes of one pool; Windows cannot wait for more."""

Task = TypeVar("Task")
Result = TypeVar("Result")


def spread(
    work: Callable[[Task], Result], tasks: Sequence[Task], jobs: int
) -> Iterator[tuple[Task, Result | None]]:
    """Do tasks in processes of their own, or here if one job is enough.

    Args:
        work: a function at the top level of a module.
        tasks: what to call it with.
        jobs: processes.

    Yields:
        each task with its result as they come; None where the process died of it.
    """
    jobs = min(jobs, len(tasks), MOST)
    if jobs <= 1:
        yield from ((task, work(task)) for task in tasks)
        return
    left = list(range(len(tasks)))
    while left:
        broken = False
        for index, result in _run(work, tasks, left, jobs):
            if result is None:
                broken = True
                break
            left.remove(index)
            yield tasks[index], result[0]
        if broken:  # one of the running jobs did it: each is tried again in a process of its own
            for index in left[: jobs + 1]:
                done = next(_run(work, tasks, [index], 1))[1]
                yield tasks[index], None if done is None else done[0]
            left = left[jobs + 1 :]


def begin(work: Callable[[Task], Result], task: Task) -> Callable[[], Result]:
    """Begin `work(task)` in a process of its own; the function returned waits for its result.

    Args:
        work: a function at the top level of a module; what it raises is raised by the wait.
        task: what to call it with. Should the process die, it is called here.
    """
    pool = ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), initializer=_begin)
    with _held_back_interrupts():
        future = pool.submit(work, task)
    pool.shutdown(wait=False)

    def wait() -> Result:
        try:
            return future.result()
        except BrokenProcessPool:
            return work(task)

    return wait


def _run(
    work: Callable[[Task], Result], tasks: Sequence[Task], indices: Sequence[int], jobs: int
) -> Iterator[tuple[int, tuple[Result] | None]]:
    """Results by the tasks' indices; None as soon as a process has died, and then no more."""
    context = multiprocessing.get_context("spawn")
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(jobs, context, initializer=_begin)
    futures: dict[Future[Result], int] = {}
    done = False
    try:
        with _held_back_interrupts():
            futures = {pool.submit(work, tasks[i]): i for i in indices}
        for future in as_completed(futures):
            try:
                result = future.result()
            except BrokenProcessPool:
                yield futures[future], None
                return
            yield futures[future], (result,)
        done = True
    finally:
        if not done:  # stopped early: do not wait for the jobs still running
            for process in set(multiprocessing.active_children()) - others:
                process.terminate()
        pool.shutdown(cancel_futures=True)


@contextmanager
def _held_back_interrupts() -> Iterator[None]:
    """Ctrl-C comes after the block; processes begun in it never see it, not even as they start."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows: `_begin` ignores it, a moment later
        yield
        return
    resource_tracker.ensure_running()  # its own start would let the signal through
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin() -> None:
    """Leave Ctrl-C to the parent, and end with it even if it is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_follow_parent, daemon=True).start()


def _follow_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
