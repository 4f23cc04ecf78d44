"""Executor on a cluster, by a Dask scheduler: the same interface as the executors on one machine.

A scheduler has the rights of the account: the client and the workers load pickles from it. It is therefore reached by
TLS with certificates of both sides, unless it is on this machine or plain TCP is asked for by name.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from queue import Empty, Queue
from threading import Thread
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

from pydantic import Field

from tissueid.errors import CancelledError, UnusableInputError
from tissueid.extras import check_packages
from tissueid.messages import Verbatim
from tissueid.plan_options import Option, Plan

if TYPE_CHECKING:
    from tissueid.gap.workers import Executor

T = TypeVar("T")
R = TypeVar("R")

CONNECT_TIMEOUT_S = 20.0
POLL_S = 0.2
"""Interval of the check for cancellation, s."""
_TLS = ("tls", "wss")
_OF_THIS_PROCESS = "inproc"
_THIS_MACHINE = ("localhost", "127.0.0.1", "[::1]")


class ClusterPlan(Plan):
    """Options of a procedure that can run on a cluster."""

    scheduler: Annotated[
        str | None,
        Option("--scheduler", metavar="ADDRESS", help="Dask scheduler, such as tls://host:8786, for a cluster"),
    ] = None
    tls_ca: Annotated[
        Path | None, Option("--tls-ca", metavar="FILE", help="certificate authority of the cluster, PEM")
    ] = None
    tls_cert: Annotated[
        Path | None, Option("--tls-cert", metavar="FILE", help="certificate for the scheduler, PEM; may hold the key")
    ] = None
    tls_key: Annotated[Path | None, Option("--tls-key", metavar="FILE", help="key of --tls-cert, PEM")] = None
    plain_tcp: Annotated[
        bool,
        Option("--plain-tcp", help="permit a scheduler on another machine without TLS: it can run code as you"),
    ] = False
    cluster_timeout_s: Annotated[
        float,
        Option("--cluster-timeout", metavar="S", help="longest time in which a cluster finishes nothing"),
        Field(ge=0.1, le=1e6),
    ] = 1800.0


class ClusterExecutor:
    """Executor on the workers of a Dask scheduler. Work of a worker that is killed goes to another.

    ``timeout_s`` is the longest time in which nothing is finished.
    """

    def __init__(self, client: Any, timeout_s: float) -> None:
        self._client = client
        self._timeout_s = timeout_s

    def do(
        self, work: Callable[[T], R], things: Sequence[T], cancelled: Callable[[], bool], done: Callable[[T], None]
    ) -> list[R]:
        """Return results in the order of ``things``; drop unfinished items when cancelled.

        Raises:
            CancelledError: ``cancelled`` returned True.
            UnusableInputError: nothing was finished for too long, or the cluster lost the work.
        """
        from concurrent.futures import CancelledError as DroppedError

        from distributed import KilledWorker, wait

        futures = self._client.map(work, things, pure=False)
        open_items = dict(zip(futures, things, strict=True))
        latest = time.monotonic() + self._timeout_s
        try:
            while open_items:
                if cancelled():
                    raise CancelledError
                if time.monotonic() > latest:
                    raise _stopped(TimeoutError(f"nothing was finished within {self._timeout_s:g} s"))
                try:
                    with self._client.as_current():
                        finished = wait(list(open_items), timeout=POLL_S, return_when="FIRST_COMPLETED").done
                except TimeoutError:
                    continue
                latest = time.monotonic() + self._timeout_s
                for future in finished:
                    done(open_items.pop(future))
            return [future.result(timeout=self._timeout_s) for future in futures]
        except (KilledWorker, DroppedError, OSError) as error:
            raise _stopped(error) from error
        finally:
            self._client.cancel(list(open_items))


@contextmanager
def cluster_executor(plan: ClusterPlan) -> Iterator[ClusterExecutor]:
    """Yield an executor on the scheduler of a plan.

    Raises:
        UnusableInputError: the address needs TLS, a certificate cannot be used, or no scheduler answers.
    """
    from distributed import Client
    from distributed.security import Security

    address = plan.scheduler or ""
    scheme, _, rest = address.rpartition("://")
    host = rest.partition("/")[0].rpartition(":")[0] or rest
    if scheme in _TLS:
        if plan.tls_ca is None or plan.tls_cert is None:
            raise UnusableInputError(
                "cluster.certificates",
                "a scheduler at {address} needs --tls-ca and --tls-cert",
                address=Verbatim(address),
            )
    elif not (plan.plain_tcp or scheme == _OF_THIS_PROCESS or host in _THIS_MACHINE):
        raise UnusableInputError(
            "cluster.plain",
            "{address} is another machine and not encrypted: a program that answers there can run code as you. Use "
            "tls://, or --plain-tcp in a network that you trust",
            address=Verbatim(address),
        )
    try:
        security = None
        if scheme in _TLS:
            files = {"tls_ca_file": plan.tls_ca, "tls_client_cert": plan.tls_cert, "tls_client_key": plan.tls_key}
            named = {name: str(path) for name, path in files.items() if path is not None}
            security = Security(require_encryption=True, **named)
        client = _within(
            2.0 * CONNECT_TIMEOUT_S,
            lambda: Client(address, timeout=CONNECT_TIMEOUT_S, set_as_default=False, security=security),
        )
    except (OSError, ValueError, TypeError, TimeoutError) as error:
        raise UnusableInputError(
            "cluster.no_scheduler",
            "no scheduler answers at {address}: {reason}",
            address=Verbatim(address),
            reason=_reason(error),
        ) from error
    try:
        yield ClusterExecutor(client, plan.cluster_timeout_s)
    finally:
        client.close(timeout=CONNECT_TIMEOUT_S)


def _within(seconds: float, work: Callable[[], Any]) -> Any:
    """Return the result of work: a client waits for ever for a scheduler that takes the connection and is silent."""
    results: Queue[tuple[Any, Exception | None]] = Queue()

    def run() -> None:
        try:
            results.put((work(), None))
        except Exception as error:  # noqa: BLE001 - raised again below
            results.put((None, error))

    Thread(target=run, daemon=True).start()
    try:
        value, error = results.get(timeout=seconds)
    except Empty:
        raise TimeoutError(f"it is silent for {seconds:g} s") from None
    if error is not None:
        raise error
    return value


def plan_executor(workers: int | None, plan: ClusterPlan) -> AbstractContextManager[Executor]:
    """Return the executor of a plan: processes of this machine, or the workers of a Dask scheduler.

    Args:
        workers: number of processes; None for one per processor.
        plan: with the scheduler, or None for this machine.

    Raises:
        UnusableInputError: the package is missing, or no scheduler answers.
    """
    from tissueid.gap.workers import executor

    if plan.scheduler is None:
        return executor(workers)
    check_packages("distributed")
    return cluster_executor(plan)


def _reason(error: BaseException) -> Verbatim:
    return Verbatim((str(error).splitlines() or [type(error).__name__])[0])


def _stopped(error: BaseException) -> UnusableInputError:
    return UnusableInputError("cluster.stopped", "the cluster stopped: {reason}", reason=_reason(error))
