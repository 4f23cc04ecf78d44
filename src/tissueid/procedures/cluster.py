"""Executor on a cluster, by a Dask scheduler: the same interface as the executors on one machine."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from typing import Any, TypeVar

from tissueid.errors import CancelledError, UnusableInputError
from tissueid.extras import check_packages
from tissueid.gap.workers import Executor, executor
from tissueid.messages import Message, Verbatim

T = TypeVar("T")
R = TypeVar("R")

CONNECT_TIMEOUT_S = 20.0
POLL_S = 0.2
"""Interval of the check for cancellation, s."""


class ClusterExecutor:
    """Executor on the workers of a Dask scheduler. Work of a worker that is killed goes to another."""

    def __init__(self, client: Any) -> None:
        self._client = client

    def do(
        self, work: Callable[[T], R], things: Sequence[T], cancelled: Callable[[], bool], done: Callable[[T], None]
    ) -> list[R]:
        """Return results in the order of ``things``; drop unfinished items when cancelled.

        Raises:
            CancelledError: ``cancelled`` returned True.
        """
        from distributed import wait

        futures = self._client.map(work, things, pure=False)
        open_items = dict(zip(futures, things, strict=True))
        try:
            while open_items:
                if cancelled():
                    raise CancelledError
                try:
                    with self._client.as_current():
                        finished = wait(list(open_items), timeout=POLL_S, return_when="FIRST_COMPLETED").done
                except TimeoutError:
                    continue
                for future in finished:
                    done(open_items.pop(future))
        finally:
            self._client.cancel(list(open_items))
        return [future.result() for future in futures]


@contextmanager
def cluster_executor(address: str) -> Iterator[ClusterExecutor]:
    """Yield an executor on the scheduler at an address such as ``tcp://host:8786``.

    Raises:
        UnusableInputError: there is no scheduler at the address.
    """
    from distributed import Client

    try:
        client: Any = Client(address, timeout=CONNECT_TIMEOUT_S, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        why = Verbatim((str(error).splitlines() or [type(error).__name__])[0])
        raise UnusableInputError(
            Message("cluster.no_scheduler", "no scheduler answers at {address}: {reason}", address=address, reason=why)
        ) from error
    try:
        yield ClusterExecutor(client)
    finally:
        client.close()


def plan_executor(workers: int | None, scheduler: str | None) -> AbstractContextManager[Executor]:
    """Return the executor of a plan: processes of this machine, or the workers of a Dask scheduler.

    Args:
        workers: number of processes; None for one per processor.
        scheduler: address such as ``tcp://host:8786``, or None for this machine.

    Raises:
        UnusableInputError: the package is missing, or no scheduler answers.
    """
    if scheduler is None:
        return executor(workers)
    check_packages("distributed")
    return cluster_executor(scheduler)
