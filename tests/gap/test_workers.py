"""Executors: order, progress, cancellation and failures."""

from __future__ import annotations

import math
import operator
import os
import signal
import threading
from pathlib import Path

import pytest
from coded import coded

from tissueid.errors import CancelledError, UnusableInputError
from tissueid.gap.workers import Pool, SerialExecutor, executor


def never() -> bool:
    return False


def test_one_worker_works_in_this_process():
    with executor(1) as people:
        assert isinstance(people, SerialExecutor)
        done: list[int] = []
        assert people.do(operator.neg, [3, 1, 2], never, done.append) == [-3, -1, -2]
        assert done == [3, 1, 2]
        assert people.do(operator.neg, [], never, done.append) == []


def test_the_serial_executor_stops_before_the_next_item():
    done: list[int] = []
    with pytest.raises(CancelledError):
        SerialExecutor().do(operator.neg, [1, 2, 3], lambda: len(done) == 2, done.append)
    assert done == [1, 2]


def test_several_workers_answer_in_order_raise_and_can_be_cancelled():
    with executor(2) as people:
        assert isinstance(people, Pool)
        done: list[int] = []
        assert people.do(math.factorial, [5, 1, 4, 3], never, done.append) == [120, 1, 24, 6]
        assert sorted(done) == [1, 3, 4, 5]
        assert people.do(math.factorial, [], never, done.append) == []
        with pytest.raises(ValueError, match="negative"):
            people.do(math.factorial, [2, -1], never, done.append)
        with pytest.raises(CancelledError):
            people.do(math.factorial, list(range(100)), lambda: True, done.append)
        assert people.do(math.factorial, [3], never, done.append) == [6]


def answer_or_wait(thing: tuple[int, bytes]) -> int:
    number, _ = thing
    if number:
        threading.Event().wait()
    return number


LARGE = bytes(1 << 20)
"""More than the buffer of a pipe: sending blocks while the process does not read."""


@pytest.mark.parametrize("killed", [False, True])
def test_an_interrupt_ends_the_pool_even_if_its_processes_are_gone(killed: bool):
    things = [(number, LARGE) for number in range(9)]
    with pytest.raises(KeyboardInterrupt), executor(2) as people:
        assert isinstance(people, Pool)
        started: list[object] = []

        def interrupt(_: object) -> None:
            started.extend(people.processes)
            if killed:  # as a signal to the whole group does
                for process in people.processes:
                    process.kill()
                    process.join()
            raise KeyboardInterrupt

        people.do(answer_or_wait, things, never, interrupt)
    assert len(started) == 2
    assert people.processes == ()


def negative_or_die(thing: tuple[int, Path | None]) -> int:
    """Return the negative number; end the process as the system does if the file is missing, or always without one."""
    number, once = thing
    if once is None or (number == 2 and not once.exists()):
        if once is not None:
            once.touch()
        os.kill(os.getpid(), getattr(signal, "SIGKILL", signal.SIGTERM))
    return -number


def test_the_work_of_a_process_that_dies_is_repeated_once(tmp_path: Path):
    done: list[object] = []
    things = [(number, tmp_path / "tried") for number in range(4)]
    with executor(2) as people:
        assert isinstance(people, Pool)
        assert people.do(negative_or_die, things, never, done.append) == [0, -1, -2, -3]
        assert len(done) == 4
        with pytest.raises(UnusableInputError, check=coded("workers.ended")):
            people.do(negative_or_die, [(1, None)], never, done.append)
        for process in people.processes:  # while they have nothing to do
            process.kill()
            process.join()
        assert people.do(math.factorial, [3], never, lambda _: None) == [6]


class OnlyHere(Exception):
    """An error that cannot be unpickled."""

    def __init__(self, one: int, other: int) -> None:
        super().__init__(f"{one} and {other}")


def fail(_: int) -> None:
    raise OnlyHere(1, 2)


def test_an_error_that_cannot_be_sent_names_its_class():
    with executor(2) as people, pytest.raises(RuntimeError, match="OnlyHere: 1 and 2"):
        people.do(fail, [1], never, lambda _: None)
