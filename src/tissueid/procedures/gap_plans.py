"""Plans of a diagnosis and of the acceptance of its effects into a twin."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

from pydantic import Field

from tissueid.errors import UnusableInputError
from tissueid.messages import Verbatim
from tissueid.plan_options import Option, Plan
from tissueid.procedures.cluster import ClusterPlan


def read_test_number(option: str, text: str) -> int:
    """Return one of the test numbers that are given for an option.

    Raises:
        UnusableInputError: the text is something else.
    """
    try:
        return int(text)
    except ValueError:
        raise UnusableInputError(
            "gap.test_numbers",
            "{option} must be test numbers separated by commas, got {text}",
            option=option,
            text=Verbatim(repr(text[:40])),
        ) from None


def _test_numbers(name: str, about: str) -> Option:
    """Return the declaration of an option with test numbers, separated by commas."""
    return Option(name, metavar="N,...", help=about, separator=",", read=partial(read_test_number, name))


class GapPlan(Plan):
    """What is diagnosed: a session, the tests to fit and to check, and the twin to start from."""

    session: Annotated[Path, Option(argument=True, metavar="SESSION", help="a session file")]
    fit: Annotated[
        tuple[int, ...],
        _test_numbers("--fit", "tests to fit; default: chosen automatically"),
    ] = ()
    check: Annotated[
        tuple[int, ...],
        _test_numbers("--check", "tests to hold out; default: chosen automatically"),
    ] = ()
    twin: Annotated[Path | None, Option("--twin", metavar="FILE", help="saved twin to start from")] = None
    workers: Annotated[
        int | None,
        Option("--workers", metavar="N", help="number of processes; default: one per core"),
        Field(ge=1, le=64),
    ] = None


class DiagnosisPlan(GapPlan):
    """A diagnosis and its files."""

    without: Annotated[
        tuple[str, ...], Option("--without", metavar="NAME,...", help="effects that are not tried", separator=",")
    ] = ()
    seconds: Annotated[
        float | None,
        Option("--seconds", metavar="S", help="time after which the search begins no further step; default: no limit"),
        Field(gt=0.0),
    ] = None
    report: Annotated[Path | None, Option("--out", metavar="PAGE", help="write the report, one HTML page")] = None
    twin_out: Annotated[Path | None, Option("--twin-out", metavar="FILE", help="save the resulting twin")] = None


class AcceptPlan(GapPlan):
    """Effects of a session that are saved in a twin: those of ``effects``, or those that a diagnosis names."""

    out: Annotated[Path, Option("--out", metavar="TWIN.toml", help="the twin to write")]
    effects: Annotated[
        tuple[str, ...], Option("--effect", metavar="NAME", help="effect to accept; may be repeated")
    ] = ()
    name: Annotated[
        str | None, Option("--name", metavar="TEXT", help="name of the twin; default: that of the file")
    ] = None

    @property
    def diagnosis(self) -> DiagnosisPlan:
        """The diagnosis that names the effects."""
        return DiagnosisPlan(
            session=self.session,
            fit=self.fit,
            check=self.check,
            twin=self.twin,
            workers=self.workers,
            twin_out=self.out,
        )


class FolderPlan(ClusterPlan):
    """Diagnosis of all sessions of a folder. After a kill the same plan continues where it was."""

    folder: Annotated[Path, Option(argument=True, metavar="FOLDER", help="a folder of session files")]
    workers: Annotated[
        int | None,
        Option("--workers", metavar="N", help="number of processes; default: one per core"),
        Field(ge=1, le=64),
    ] = None


class WatchPlan(FolderPlan):
    """Diagnosis of all sessions of a folder against an accepted twin, in order of time."""

    twin: Annotated[Path, Option("--twin", metavar="FILE", help="accepted twin to compare with")]
    report: Annotated[Path | None, Option("--out", metavar="PAGE", help="write the report, one HTML page")] = None
