"""Work in processes: all of it comes back, and a process that dies takes only its own task."""

import os
import signal

import pytest

from data_prep.processes import spread


def square(number: int) -> int:
    return number * number


def square_or_die(number: int) -> int:
    if number == 3:
        os.kill(os.getpid(), getattr(signal, "SIGKILL", signal.SIGTERM))
    return number * number


def test_one_job_works_here() -> None:
    assert list(spread(square, [1, 2], 1)) == [(1, 1), (2, 4)]
    assert list(spread(square, [], 4)) == []


def test_a_process_that_dies_takes_only_its_own_task() -> None:
    done = dict(spread(square_or_die, range(8), 2))
    assert done == {n: None if n == 3 else n * n for n in range(8)}


def fail(number: int) -> int:
    raise ValueError(f"number {number}")


def test_an_exception_comes_through() -> None:
    with pytest.raises(ValueError, match="number"):
        list(spread(fail, [1, 2, 3], 2))


def deaf(_: int) -> bool:
    return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, [])


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="no masks of signals here")
def test_an_interrupt_is_for_the_parent_alone() -> None:
    assert sorted(spread(deaf, [1, 2], 2)) == [(1, True), (2, True)]
    assert not deaf(0)
