"""Live identification during a test: prints converging parameters and ends the test by a stop rule."""

from __future__ import annotations

from collections.abc import Callable
from types import TracebackType
from typing import Self

from tissueid.acquisition import Phase, Progress
from tissueid.acquisition.background_work import run_while_polling
from tissueid.acquisition.live import LiveIdentification
from tissueid.cli.output import console
from tissueid.formatting import fixed, plus_minus
from tissueid.identification.live.live_view import LiveView
from tissueid.identification.live.stopping import StopRule
from tissueid.instrument import Instrument, SimulatedInstrument

_UNITS = {"mass": ("g", 1e3), "damping": ("N·s/m", 1.0), "stiffness": ("N/m", 1.0)}


class LiveMonitor:
    """Live identification of one test, active with a stop rule or when parameters are printed.

    A simulation in this process has no clock: its samples wait for each identification step.
    """

    def __init__(
        self,
        instrument: Instrument,
        preload_s: float,
        rule: StopRule | None,
        printed: bool,
        external_spring_n_per_m: float = 0.0,
    ) -> None:
        self._instrument = instrument
        self._waits = isinstance(instrument, SimulatedInstrument)
        self._printed = printed
        self._rule = rule
        self._shown = 0.0
        self._identification: LiveIdentification | None = None
        if rule is not None or printed:
            self._identification = LiveIdentification(
                instrument.device,
                preload_s=preload_s,
                stop=rule,
                separate_process=not self._waits,
                external_spring_n_per_m=external_spring_n_per_m,
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._identification is None:
            return
        if error is None:
            run_while_polling(self._instrument, self._identification.close)  # the last step may take a while
        else:
            self._identification.close()
        self._print_latest(self._identification)
        if error is None and self._rule is not None and not self._identification.enough():
            console.print(_not_enough(self._rule, self._identification.latest()), markup=False)
        if self._identification.problem:
            console.print(f"live identification: {self._identification.problem}", markup=False)

    def with_progress(self, bar: Callable[[Progress], None]) -> Callable[[Progress], None]:
        """Return a progress callback that feeds the identification and then calls ``bar``."""
        identification = self._identification
        if identification is None:
            return bar

        def take(progress: Progress) -> None:
            if progress.phase in (Phase.PRELOAD, Phase.STIMULUS):
                identification.feed(progress.samples)
                if self._waits:
                    identification.step()
                self._print_latest(identification)
            bar(progress)

        return take

    def enough(self) -> bool:
        """Return whether the stop rule is met."""
        return self._identification is not None and self._identification.enough()

    def why(self) -> str:
        """Return the reason why the stop rule is met."""
        return "" if self._identification is None else self._identification.reason

    def _print_latest(self, identification: LiveIdentification) -> None:
        latest = identification.latest() if self._printed else None
        if latest is not None and latest.seconds > self._shown and (latest.parameters or latest.missing):
            self._shown = latest.seconds
            console.print(view_line(latest), markup=False)


def _not_enough(rule: StopRule, view: LiveView | None) -> str:
    """Return how well the parameters of a stop rule are known at the end of a test that it did not end."""
    words = []
    for name, target in rule.targets.items():
        found = None if view is None else view.parameters.get(name)
        spread = None if found is None or not found.std else found.std / abs(found.value)
        known = "is not known" if spread is None else f"has an uncertainty of {fixed(100.0 * spread, 1)} %"
        words.append(f"{name} {known} (target {fixed(100.0 * target, 1)} %)")
    return f"the test was too short for the requested uncertainty: {', '.join(words)}"


def view_line(view: LiveView) -> str:
    """Return the current state of a running test as one line."""
    words = [f"{fixed(view.seconds, 2)} s"]
    for name, found in view.parameters.items():
        unit, scale = _UNITS[name]
        words.append(f"{name} {plus_minus(found, scale)} {unit}")
    if view.vaf_percent is not None:
        words.append(f"VAF {fixed(view.vaf_percent, 1)} %")
    return ", ".join(words if view.parameters else [*words, view.missing])
