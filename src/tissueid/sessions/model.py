"""A session, its tests and its subject, independent of their storage."""

from __future__ import annotations

import json
import math
import uuid
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from datetime import UTC, datetime
from functools import cache
from typing import Annotated, Any, get_type_hints

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PlainValidator, TypeAdapter

from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.formatting import ANONYMOUS
from tissueid.messages import Listing, Message, codes_in, message_from
from tissueid.records import Record
from tissueid.untrusted_input import (
    MAX_TESTS,
    RATES_HZ,
    StoredName,
    StoredNumber,
    StoredText,
    StoredValue,
    json_value,
)
from tissueid.version import SOFTWARE

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
KINDS = ("stochastic", "quiet", "slow_ramp", "step_hold", "spring", "free_air")
STATUSES = ("completed", "aborted", "recovered")
TestNumber = Annotated[int, Field(ge=0, le=MAX_TESTS)]


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
    """Return the codes of why a test ended; none of a plain text."""
    return codes_in(reason) if isinstance(reason, Message) else frozenset()


@dataclass(frozen=True)
class Subject:
    """The person who was measured: a pseudonym, never a name, and demographic values of the study."""

    pseudonym: StoredText = ANONYMOUS
    demographics: dict[StoredName, StoredValue] = field(default_factory=dict)


@dataclass(frozen=True)
class Test:
    """One test. ``signals`` maps names to arrays of shape (n,), SI; NaN marks a sample that was not received.

    ``units`` has the SI units of signals that are not in ``SIGNAL_UNITS``. The other fields are its attributes in the
    header of the journal, in HDF5 and next to an export: a field that is added here is stored and read there. What is
    set for a test is a field of ``TestSettings``, and is stored in ``notes``.
    """

    __test__ = False  # keeps pytest from collecting the class

    number: TestNumber
    kind: StoredText
    signals: Annotated[dict[str, NDArray[np.float64]], PlainValidator(lambda _given: {})]
    sample_rate_hz: Annotated[float, Field(ge=RATES_HZ[0], le=RATES_HZ[1])]
    configuration: StoredText = "indentation"
    site: StoredText = ""
    preload_s: Annotated[float, Field(ge=0.0, le=1e9)] = 0.0
    surface_position_m: StoredNumber = math.nan
    stimulus: dict[str, Any] = field(default_factory=dict)
    seed: Annotated[int, Field(ge=-(2**63), lt=2**64)] = 0
    repeat_of: TestNumber | None = None
    status: StoredText = "completed"
    notes: dict[StoredName, StoredValue] = field(default_factory=dict)
    units: dict[StoredName, StoredText] = field(default_factory=dict)

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


_ATTRIBUTES = tuple(f.name for f in fields(Test) if f.name not in ("number", "signals", "notes", "units"))


@cache
def attribute_types() -> Mapping[str, Any]:
    """Return the type of each attribute of a test in a file, by name; notes are further attributes."""
    types = get_type_hints(Test)
    return {name: types[name] for name in _ATTRIBUTES}


def attributes_of(test: Test) -> dict[str, Any]:
    """Return the attributes of a test, and its notes in one of them."""
    return {name: getattr(test, name) for name in (*_ATTRIBUTES, "notes")}


@cache
def _stored() -> TypeAdapter[Test]:
    return TypeAdapter(Test)


def stored_test(number: int, attributes: Mapping[str, Any]) -> Test:
    """Return a test without signals from its attributes in a file; unknown ones are ignored.

    Raises:
        ValueError: one is missing or not valid.
    """
    return _stored().validate_json(json.dumps({"number": number, "signals": {}} | dict(attributes)), strict=True)


@dataclass(frozen=True, kw_only=True)
class Origin:
    """When and by what a session was recorded."""

    session_id: StoredText = field(default_factory=lambda: str(uuid.uuid4()))
    created: StoredText = field(default_factory=lambda: datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"))
    software: StoredText = SOFTWARE
    audit_head: StoredText = ""
    """Number and hash of the newest line of the audit log when the session was written; "" without a log."""


ORIGIN = tuple(f.name for f in fields(Origin))


@dataclass(frozen=True)
class Session(Origin):
    """One sitting: a subject, an instrument and any number of tests."""

    instrument: DeviceDescription
    subject: Subject = field(default_factory=Subject)
    tests: tuple[Test, ...] = ()

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
