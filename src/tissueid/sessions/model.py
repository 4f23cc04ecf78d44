"""A session, its tests and its subject, independent of their storage."""

from __future__ import annotations

import json
import uuid
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid import __version__
from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.formatting import ANONYMOUS
from tissueid.messages import Listing, Message, codes_in, message_from
from tissueid.records import Record
from tissueid.untrusted_input import json_value

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
IMPORTED = "source_format"
"""Note of every imported test: the format of its file."""
DATE_NOTE = "source_date"
"""Note of an imported test with the origin of its date: "header" of its file, or "modified" (modification time)."""
STAND_INS = {"force": "input", "position": "output"}
"""Signals of imported tests that replace a missing force or position; ``Test.units`` has their units."""
_REASON_MESSAGE = "reason_message"
"""Note that holds code, template and values of the note ``reason`` as JSON."""
_WORDS_OF_EARLIER_VERSIONS = {
    "stopped in the window": "stop.button",
    "stopped by key": "stop.key",
    "released the coil": "instrument.released",
    "restarted by itself": "instrument.restarted",
    "the computer was silent for too long": "fault.watchdog",
    "the force exceeded its limit": "fault.over_force",
    "the probe reached the end of its stroke": "fault.stroke",
    "the coil is too hot": "fault.over_temperature",
    "the test lasted too long": "fault.over_time",
    "the button was pressed": "fault.button",
    "the computer sent the stimulus too late": "fault.starved",
    "the supply voltage dropped": "fault.brown_out",
    "the position reading does not follow the force": "fault.sensor",
    "the coil current does not follow the voltage": "fault.open_coil",
    "the force reached": "limit.force",
    "by its current": "limit.winding_temperature",
    "sent no usable samples": "link.unusable",
    "went silent": "link.silent",
    "the connection to": "link.broken",
}
"""Codes of the reasons that versions before the note ``reason_message`` stored as text only."""
KINDS = ("stochastic", "quiet", "slow_ramp", "step_hold", "spring", "free_air")
STATUSES = ("completed", "aborted", "recovered")


def reason_notes(reason: str) -> dict[str, str | float]:
    """Return the notes that store why a test ended early; ``Test.reason`` reads them."""
    notes: dict[str, str | float] = {"reason": str(reason)}
    if isinstance(reason, Message):
        notes[_REASON_MESSAGE] = json.dumps(reason.as_dict(), allow_nan=False)
    return notes


def reason_of(notes: Mapping[str, object]) -> str:
    """Return why a test ended early: a message if its code and values are stored; "" if no reason is stored."""
    text = notes.get("reason")
    if not isinstance(text, str):
        return ""
    try:
        return message_from(json_value(str(notes.get(_REASON_MESSAGE)).encode()), text)
    except ValueError:
        return text


def reason_codes(reason: str) -> frozenset[str]:
    """Return the codes of why a test ended; a plain text of an earlier version is recognised by its words."""
    if isinstance(reason, Message):
        return codes_in(reason)
    text = reason.casefold()
    return frozenset(code for words, code in _WORDS_OF_EARLIER_VERSIONS.items() if words in text)


@dataclass(frozen=True)
class Subject:
    """The person who was measured: a pseudonym, never a name, and demographic values of the study."""

    pseudonym: str = ANONYMOUS
    demographics: dict[str, str | float] = field(default_factory=dict)


@dataclass(frozen=True)
class Test:
    """One test. ``signals`` maps names to arrays of shape (n,), SI; NaN marks a sample that was not received.

    ``units`` has the SI units of signals that are not in ``SIGNAL_UNITS``.
    """

    __test__ = False  # keeps pytest from collecting the class

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

    @property
    def reason(self) -> str:
        """Why the test ended early, by ``reason_of``."""
        return reason_of(self.notes)

    def unit(self, name: str) -> str:
        """Return the SI unit of a signal; "" if it has none or it is unknown."""
        return SIGNAL_UNITS.get(name) or self.units.get(name, "")

    @property
    def samples(self) -> int:
        """Number of samples, including those not received."""
        return next(iter(self.signals.values())).size

    def record(self, input_name: str = "force", output_name: str = "position", *, preload: bool = False) -> Record:
        """Return input and output of this test; without the preload unless ``preload`` is true.

        A missing force is replaced by an imported signal ``input``, a missing position by ``output``; they keep their
        names and units.

        Raises:
            UnusableInputError: the test lacks one of the signals.
        """
        input_name, output_name = self._present(input_name), self._present(output_name)
        for name in (input_name, output_name):
            if name not in self.signals or name == "time":
                raise UnusableInputError(
                    "session.no_signal",
                    "test {number} has no signal '{signal}'; it has: {signals}",
                    number=self.number,
                    signal=name,
                    signals=Listing(tuple(sorted(set(self.signals) - {"time"}))),
                )
        first = 0 if preload else round(self.preload_s * self.sample_rate_hz)
        if first >= self.samples:
            raise UnusableInputError(
                "session.only_preload", "test {number} ends within its preload", number=self.number
            )
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
    """One sitting: a subject, an instrument and any number of tests."""

    instrument: DeviceDescription
    subject: Subject = field(default_factory=Subject)
    tests: tuple[Test, ...] = ()
    session_id: str = field(default_factory=lambda: str(uuid.uuid4()))
    created: str = field(default_factory=lambda: datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"))
    software: str = f"tissueid {__version__}"
    audit_head: str = ""
    """Number and hash of the newest line of the audit log when the session was written; "" without a log."""

    def test(self, number: int | None = None) -> Test:
        """Return a test by its number; by default the first stochastic test, or else the first test.

        Raises:
            UnusableInputError: there is no such test.
        """
        if not self.tests:
            raise UnusableInputError("session.empty", "the session holds no tests")
        if number is None:
            return next((test for test in self.tests if test.kind == "stochastic"), self.tests[0])
        for test in self.tests:
            if test.number == number:
                return test
        raise UnusableInputError(
            "session.no_test",
            "the session has no test {number}; it has {numbers}",
            number=number,
            numbers=", ".join(str(test.number) for test in self.tests),
        )


@dataclass(frozen=True)
class TestOutline:
    """A test without its signals: ``test.signals`` is empty. ``signals`` are their names, ``samples`` their length."""

    __test__ = False

    test: Test
    samples: int
    signals: tuple[str, ...]

    @property
    def seconds(self) -> float:
        """Length of the test, s."""
        return self.samples / self.test.sample_rate_hz


@dataclass(frozen=True)
class Outline:
    """A session without its tests (``head``), and the outlines of the tests in the order of their numbers."""

    head: Session
    tests: tuple[TestOutline, ...]
