"""Watching a test while it runs: its parameters as they converge, and when they are known well enough."""

from __future__ import annotations

from collections.abc import Callable
from types import TracebackType
from typing import Self

from tissueid.acquisition import Phase, Progress
from tissueid.acquisition.live import LiveIdentification
from tissueid.acquisition.waiting import meanwhile
from tissueid.cli.output import console
from tissueid.identification.online.live_view import LiveView
from tissueid.identification.online.stopping import StopRule
from tissueid.instrument import Instrument, SimulatedInstrument
from tissueid.wording import fixed, plus_minus

_UNITS = {"mass": ("g", 1e3), "damping": ("N·s/m", 1.0), "stiffness": ("N/m", 1.0)}


class Watch:
    """Live identification of one test where there is a rule to end it by, or somebody to tell.

    A simulation in this process has no clock of its own: there every look is taken before the next samples come.
    """

    def __init__(
        self,
        instrument: Instrument,
        preload_s: float,
        rule: StopRule | None,
        told: bool,
        external_spring_n_per_m: float = 0.0,
    ) -> None:
        self._instrument = instrument
        self._waits = isinstance(instrument, SimulatedInstrument)
        self._told = told
        self._rule = rule
        self._shown = 0.0
        self._identification: LiveIdentification | None = None
        if rule is not None or told:
            self._identification = LiveIdentification(
                instrument.device,
                preload_s=preload_s,
                stop=rule,
                apart=not self._waits,
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
            meanwhile(self._instrument, self._identification.close)  # the last look may take a while
        else:
            self._identification.close()
        self._tell(self._identification)
        if error is None and self._rule is not None and not self._identification.enough():
            console.print(_not_enough(self._rule, self._identification.latest()), markup=False)
        if self._identification.problem:
            console.print(f"live identification: {self._identification.problem}", markup=False)

    def beside(self, bar: Callable[[Progress], None]) -> Callable[[Progress], None]:
        """Progress that is looked at and then shown as before."""
        identification = self._identification
        if identification is None:
            return bar

        def take(progress: Progress) -> None:
            if progress.phase in (Phase.PRELOAD, Phase.STIMULUS):
                identification.feed(progress.samples)
                if self._waits:
                    identification.step()
                self._tell(identification)
            bar(progress)

        return take

    def enough(self) -> bool:
        """True once the rule is met."""
        return self._identification is not None and self._identification.enough()

    def why(self) -> str:
        """Why it is enough, in words."""
        return "" if self._identification is None else self._identification.reason

    def _tell(self, identification: LiveIdentification) -> None:
        latest = identification.latest() if self._told else None
        if latest is not None and latest.seconds > self._shown and (latest.parameters or latest.missing):
            self._shown = latest.seconds
            console.print(view_line(latest), markup=False)


def _not_enough(rule: StopRule, view: LiveView | None) -> str:
    """How well the parameters are known that a rule asked for, at the end of a test that it did not end."""
    words = []
    for name, target in rule.targets.items():
        found = None if view is None else view.parameters.get(name)
        spread = None if found is None or not found.std else found.std / abs(found.value)
        known = "is not known" if spread is None else f"is known to {fixed(100.0 * spread, 1)} %"
        words.append(f"{name} {known} ({fixed(100.0 * target, 1)} % was asked)")
    return f"the test was not long enough for what was asked: {', '.join(words)}"


def view_line(view: LiveView) -> str:
    """One look at a running test on one line."""
    words = [f"{fixed(view.seconds, 2)} s"]
    for name, found in view.parameters.items():
        unit, scale = _UNITS[name]
        words.append(f"{name} {plus_minus(found, scale)} {unit}")
    if view.vaf_percent is not None:
        words.append(f"VAF {fixed(view.vaf_percent, 1)} %")
    return ", ".join(words if view.parameters else [*words, view.missing])
