"""What a session holds, apart from how it is stored."""

from __future__ import annotations

import uuid
from collections.abc import Iterable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid import __version__
from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.records import Record

SIGNAL_UNITS = {
    "time": "s",
    "command": "V",
    "voltage": "V",
    "current": "A",
    "force": "N",
    "position": "m",
    "temperature": "degC",
    "acceleration_x": "m s-2",
    "acceleration_y": "m s-2",
}
SIGNAL_NAMES = {
    "time": "time from the start of the test",
    "command": "voltage asked for by the host",
    "voltage": "voltage across the coil",
    "current": "current through the coil",
    "force": "force of the coil, force constant times current, positive into the tissue",
    "position": "position on the actuator, growing into the tissue",
    "temperature": "temperature of the coil",
    "acceleration_x": "acceleration of the frame, first axis",
    "acceleration_y": "acceleration of the frame, second axis",
    "input": "input of a system that is no instrument of this kind",
    "output": "output of a system that is no instrument of this kind",
}
STAND_INS = {"force": "input", "position": "output"}
"""What stands in where a test has no force, or no position: signals of any unit, kept in the test's ``units``."""
KINDS = ("stochastic", "quiet", "slow_ramp", "step_hold", "spring", "free_air")
STATUSES = ("completed", "aborted", "recovered")


@dataclass(frozen=True)
class Subject:
    """Who was measured: a pseudonym, never a name, and what else the study wants to know."""

    pseudonym: str = "anonymous"
    demographics: dict[str, str | float] = field(default_factory=dict)


@dataclass(frozen=True)
class Test:
    """One test. ``signals`` maps names to arrays of shape (n,), SI; NaN marks a sample that was not received.

    ``units`` has the SI units of signals that are none of the format's own (``SIGNAL_UNITS``), where they have one.
    """

    __test__ = False  # not a test case, whatever pytest thinks of the name

    number: int
    kind: str
    signals: dict[str, NDArray[np.float64]]
    sample_rate_hz: float
    configuration: str = "indentation"
    site: str = ""
    preload_s: float = 0.0
    surface_position_m: float = float("nan")
    stimulus: dict[str, Any] = field(default_factory=dict)
    seed: int = 0
    repeat_of: int | None = None
    status: str = "completed"
    notes: dict[str, str | float] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)

    def unit(self, name: str) -> str:
        """The SI unit of a signal; "" where it has none, or none is known."""
        return SIGNAL_UNITS.get(name) or self.units.get(name, "")

    @property
    def samples(self) -> int:
        """Number of samples, received or not."""
        return next(iter(self.signals.values())).size

    def record(self, input_name: str = "force", output_name: str = "position", *, preload: bool = False) -> Record:
        """Input and output of this test; the preload is cut off unless ``preload`` asks for it.

        Where there is no force, or no position, a bare ``input`` or ``output`` from elsewhere is taken in its place,
        under its own name and with its own unit.

        Raises:
            UnusableInputError: the test lacks one of the signals.
        """
        input_name, output_name = self._present(input_name), self._present(output_name)
        for name in (input_name, output_name):
            if name not in self.signals or name == "time":
                have = ", ".join(sorted(set(self.signals) - {"time"}))
                raise UnusableInputError(f"test {self.number} has no signal {name!r}; it has: {have}")
        first = 0 if preload else round(self.preload_s * self.sample_rate_hz)
        if first >= self.samples:
            raise UnusableInputError(f"test {self.number} ends within its preload")
        return Record(
            self.signals[input_name][first:],
            self.signals[output_name][first:],
            self.sample_rate_hz,
            input_name,
            output_name,
            self.unit(input_name),
            self.unit(output_name),
        )

    def _present(self, name: str) -> str:
        stand_in = STAND_INS.get(name, name)
        return stand_in if name not in self.signals and stand_in in self.signals else name


@dataclass(frozen=True)
class Session:
    """One sitting: one subject, one instrument, any number of tests."""

    instrument: DeviceDescription
    subject: Subject = field(default_factory=Subject)
    tests: tuple[Test, ...] = ()
    session_id: str = field(default_factory=lambda: str(uuid.uuid4()))
    created: str = field(default_factory=lambda: datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"))
    software: str = f"tissueid {__version__}"
    audit_head: str = ""
    """Number and hash of the newest line of the audit log when this was written; empty where none was kept."""

    def test(self, number: int | None = None) -> Test:
        """A test by its number; without one the first stochastic test, or else the first of all.

        Raises:
            UnusableInputError: there is no such test.
        """
        if not self.tests:
            raise UnusableInputError("the session holds no tests")
        if number is None:
            return next((test for test in self.tests if test.kind == "stochastic"), self.tests[0])
        for test in self.tests:
            if test.number == number:
                return test
        raise UnusableInputError(f"the session has no test {number}; it has {_ranges(t.number for t in self.tests)}")


def _ranges(numbers: Iterable[int]) -> str:
    return ", ".join(str(number) for number in numbers)
