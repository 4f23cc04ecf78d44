"""What is asked of instruments without a test; the coil stays free."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from tissueid.device import DeviceDescription
from tissueid.instrument import (
    PROFILES,
    RESEARCH,
    FoundInstrument,
    Instrument,
    Limits,
    SerialInstrument,
    find_instruments,
    open_instrument,
)
from tissueid.instrument.replies import describe_faults
from tissueid.plan_options import Option, Plan

LISTEN_S = 1.0
"""Duration over which samples are read, s."""
_POLL_S = 0.1
_MOST_POLLS = 400

Opener = Callable[[str], Instrument]
Calibrate = Callable[[Instrument], object]


class DevicesPlan(Plan):
    """A search for instruments."""

    probe: Annotated[bool, Option(help="connect to each instrument")] = True


def listed_instruments(plan: DevicesPlan) -> list[FoundInstrument]:
    """Return connected and simulated instruments; a probed one is closed again."""
    return find_instruments(probe=plan.probe)


def described_device(url: str | None) -> DeviceDescription:
    """Return the device of a URL; None is the desktop device of the thesis.

    Raises:
        InstrumentError: there is no such instrument, or it does not answer.
    """
    if url is None:
        return DeviceDescription()
    instrument = open_instrument(url)
    try:
        return instrument.device
    finally:
        instrument.close()


def greatest_force_n(instrument: Instrument) -> float:
    """Return the maximum force of an instrument, N in whole tenths, by its amplifier and its own limits."""
    own = math.floor(10.0 * instrument.effective_limits(RESEARCH).max_force_n) / 10.0
    return min(instrument.device.greatest_force_n, own)


@dataclass(frozen=True)
class InstrumentSurvey:
    """Found instruments, and device and maximum force, N, of those that answered, by address."""

    found: Sequence[FoundInstrument]
    devices: Mapping[str, DeviceDescription]
    forces_n: Mapping[str, float]


def survey_instruments(
    finder: Callable[..., list[FoundInstrument]], opener: Opener, calibrate: Calibrate
) -> InstrumentSurvey:
    """Ask every port, and activate the calibration of each instrument that answers.

    Raises:
        TissueIDError, OSError: the ports cannot be listed.
    """
    devices: dict[str, DeviceDescription] = {}
    forces_n: dict[str, float] = {}

    def open_and_ask(url: str) -> Instrument:
        instrument = opener(url)
        try:
            calibrate(instrument)
            forces_n[url] = greatest_force_n(instrument)
        except BaseException:
            instrument.close()
            raise
        devices[url] = instrument.device
        return instrument

    return InstrumentSurvey(finder(probe=True, opener=open_and_ask), devices, forces_n)


@dataclass(frozen=True)
class LinkStatistics:
    """Statistics of the link while the instrument was open; ``round_trip_s`` None if not measured."""

    frames: int
    damaged: int
    repeated: int
    round_trip_s: float | None


@dataclass(frozen=True)
class Checkup:
    """What an instrument answered: its ``nominal`` figures, and as ``device`` those by the active calibration.

    ``link`` is None where there is no cable. Values without a sensor are NaN.
    """

    url: str
    nominal: DeviceDescription
    device: DeviceDescription
    limits: dict[str, Limits]
    samples: int
    lost: int
    temperature_c: float
    resting_a: float
    faults: str
    link: LinkStatistics | None


def run_checkup(url: str, opener: Opener, calibrate: Calibrate, check: Callable[[], object]) -> Checkup:
    """Open an instrument, activate its calibration, read samples, and close it. The coil stays free throughout.

    ``check`` is called between the polls, and raises CancelledError to end it.

    Raises:
        TissueIDError, OSError: it does not answer, or not as it should.
    """
    instrument = opener(url)
    try:
        check()
        calibrate(instrument)
        device = instrument.device
        wanted = round(LISTEN_S * device.sample_rate_hz)
        samples = lost = 0
        temperatures: list[float] = []
        currents: list[float] = []
        for _ in range(_MOST_POLLS):
            check()
            block = instrument.poll(_POLL_S)
            samples += block.size
            received = np.isfinite(block["position"])
            lost += int(np.count_nonzero(~received))
            for kept, name in ((temperatures, "temperature"), (currents, "current")):
                values = block[name][np.isfinite(block[name])]
                if values.size:
                    kept.append(float(values.mean()))
            if samples >= wanted:
                break
        return Checkup(
            url,
            instrument.nominal,
            device,
            {name: instrument.effective_limits(limits) for name, limits in PROFILES.items()},
            samples,
            lost,
            float(np.mean(temperatures)) if temperatures else np.nan,
            float(np.mean(currents)) if currents else np.nan,
            _faults(instrument),
            _link(instrument),
        )
    finally:
        instrument.close()


def _faults(instrument: Instrument) -> str:
    """Return the faults that remain after they were cleared at opening; empty if there are none."""
    status = instrument.status if isinstance(instrument, SerialInstrument) else None
    return describe_faults(status.faults) if status is not None and status.faults else ""


def _link(instrument: Instrument) -> LinkStatistics | None:
    if not isinstance(instrument, SerialInstrument):
        return None
    frames = instrument.statistics
    return LinkStatistics(frames.accepted, frames.refused, instrument.repeated_requests, instrument.round_trip_s)
