"""Fits in parallel processes, with progress and a way to stop."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from typing import Protocol, TypeVar

from tissueid.gap.fitting import Cancelled

T = TypeVar("T")
R = TypeVar("R")

POLL_S = 0.2
"""How often a wait for other processes looks whether the work was cancelled."""


class Crew(Protocol):
    """Somebody who does the same piece of work for many things."""

    def do(
        self, work: Callable[[T], R], things: Sequence[T], cancelled: Callable[[], bool], done: Callable[[T], None]
    ) -> list[R]:
        """Results in the order of ``things``; ``done`` is told of each; raises ``Cancelled``."""
        ...


class Alone:
    """Does everything in this process, one after the other."""

    def do(
        self, work: Callable[[T], R], things: Sequence[T], cancelled: Callable[[], bool], done: Callable[[T], None]
    ) -> list[R]:
        """Results in the order of ``things``."""
        found = []
        for thing in things:
            if cancelled():
                raise Cancelled
            found.append(work(thing))
            done(thing)
        return found


class Pool:
    """Does the work in processes of its own."""

    def __init__(self, executor: ProcessPoolExecutor) -> None:
        self._executor = executor

    def do(
        self, work: Callable[[T], R], things: Sequence[T], cancelled: Callable[[], bool], done: Callable[[T], None]
    ) -> list[R]:
        """Results in the order of ``things``; what has not begun is dropped when cancelled."""
        futures: list[Future[R]] = [self._executor.submit(work, thing) for thing in things]
        waiting = set(futures)
        while waiting:
            finished, waiting = wait(waiting, POLL_S, FIRST_COMPLETED)
            for future in finished:
                done(things[futures.index(future)])
            if cancelled():
                for future in waiting:
                    future.cancel()
                raise Cancelled
        return [future.result() for future in futures]


@contextmanager
def crew(workers: int | None = None) -> Iterator[Crew]:
    """Workers by number, or as many as there are processors; one works in this process."""
    count = workers or os.cpu_count() or 1
    if count == 1:
        yield Alone()
        return
    executor = ProcessPoolExecutor(count, mp_context=multiprocessing.get_context("spawn"))
    try:
        yield Pool(executor)
    finally:
        executor.shutdown(wait=True, cancel_futures=True)
