"""Form of a recipe: tests on simulated tissues, fits, pictures, and what the thesis found."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

from tissueid.analysis.overlay import Overlay
from tissueid.reports.overlay import DrawnFigures
from tissueid.sessions import Session
from tissueid_lab.thesis.page import Row

Outcome = tuple[DrawnFigures, Sequence[Row]]
"""Pictures and comparison of a figure."""
_QUICK_SECONDS = 2.0
"""Longest test of a quick run, s."""
_QUICK_STEP_M = 0.005
"""Distance of the positions of the sweep of a quick run, m."""


@dataclass(frozen=True)
class Recording:
    """A test on a simulated tissue: noise over a range of force, N, after its preload.

    ``options`` are further options of the stimulus. ``name`` is that of its file. With ``stimulus`` "rtig" the depth is
    distributed by feedback; "sweep" is a dynamic sweep, whose ``options`` are those of the sweep. ``coil`` is that
    of the instrument: ideal, or finite. A ``quick`` recording
    is shorter, and played on an instrument that is not restarted for each test.
    """

    name: str
    preset: str
    force_n: tuple[float, float] = (-3.5, 10.5)
    seconds: float = 4.0
    seed: int = 1
    distribution: str = "uniform"
    options: tuple[tuple[str, Any], ...] = ()
    stimulus: Literal["noise", "rtig", "sweep"] = "noise"
    coil: str = "ideal"
    quick: bool = False

    def shortened(self) -> Recording:
        """Return the recording of a quick run, with a file of its own."""
        options = dict(self.options) | ({"step_m": _QUICK_STEP_M} if self.stimulus == "sweep" else {})
        seconds = min(self.seconds, _QUICK_SECONDS)
        return replace(self, name=f"{self.name}-quick", seconds=seconds, options=tuple(options.items()), quick=True)


@dataclass(frozen=True)
class Source:
    """A recording in a figure: its label, and the labels of the fits that are run on it; empty for all."""

    label: str
    recording: Recording
    fits: tuple[str, ...] = ()


def _no_rows(_found: Overlay) -> Sequence[Row]:
    return ()


@dataclass(frozen=True)
class ThesisFigure:
    """A figure or table: tests, fits ([LABEL=]ENGINE,OPTION=VALUE), pictures, and the comparison.

    ``pictures`` are keys of ``reports.overlay``, ``drawn`` makes further ones from the fits; the other arguments are
    those of ``analysis.overlay.overlay``. ``recorded`` makes figures and rows from the sessions by label instead, and
    ``study`` makes them without tests; its argument is whether the run is quick. ``remark`` says what
    differs by construction.
    """

    number: str
    title: str
    sources: tuple[Source, ...] = ()
    fits: tuple[str, ...] = ()
    pictures: tuple[str, ...] = ()
    rows: Callable[[Overlay], Sequence[Row]] = _no_rows
    remark: str = ""
    whole: bool = True
    downsample: int = 1
    sweep: tuple[str, tuple[float, ...]] = ("", ())
    calibration: bool = False
    drawn: Callable[[Overlay], DrawnFigures] | None = None
    recorded: Callable[[Mapping[str, Session]], Outcome] | None = None
    study: Callable[[bool], Outcome] | None = None


__all__ = ["Outcome", "Recording", "Source", "ThesisFigure"]
