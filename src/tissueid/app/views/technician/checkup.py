"""Checkup of an instrument with released coil, and its evaluation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tissueid.app.views.technician.events import Event, LogPage, read_events, read_log
from tissueid.app.words import calibration_state, sentence
from tissueid.calibration.status import Stored, calibration_folder, stored_calibrations
from tissueid.errors import CancelledError, TissueIDError
from tissueid.formatting import fixed, grouped
from tissueid.instrument.thermal import PLAUSIBLE_C
from tissueid.language import _, marked
from tissueid.messages import Message, translated
from tissueid.procedures.instruments import Checkup
from tissueid.sessions import read_outline, read_test
from tissueid.sessions.model import IMPORTED

RECENT_FILES, RECENT_BYTES = 20, 2 * 1024 * 1024
"""Number of sessions and bytes of the audit log that are searched for the newest test."""
DAMAGED_SHARE = 0.01
"""Largest share of damaged frames; the host can handle more, but such a cable gets worse."""
LOST_SHARE = 0.01
WARM_C = 50.0
RESTING_A = 0.3
"""A free coil carries no current: beyond this the current channel is off, by as much as a calibration may say."""

Cancelled = Callable[[], object]


@dataclass(frozen=True)
class LastTest:
    """The newest test in the folder of sessions and its lost samples."""

    path: Path
    created: str
    status: str
    samples: int
    lost: int
    late_blocks: int
    held_samples: int
    model: str = ""
    serial_number: str = ""


@dataclass(frozen=True)
class Background:
    """What is known without asking: the newest test, every calibration of the folder, how the newest test ended.

    ``fault`` is there where that was with a fault. ``problem`` is why the calibrations cannot be read.
    """

    last: LastTest | None
    stored: tuple[Stored, ...]
    fault: Event | None = None
    problem: str = ""


@dataclass(frozen=True)
class Light:
    """The traffic light: ``level`` is good, check, poor, or none before anything was asked."""

    level: str
    headline: str
    reasons: tuple[str, ...]


NOT_ASKED = Light(
    "",
    marked("Not checked yet"),
    (marked("Press “Check the instrument”. It is opened, listened to for a second and closed; the coil stays free."),),
)


def light(checkup: Checkup | None, problem: str, fault: Event | None) -> Light:
    """Return the traffic light of an instrument with all reasons.

    ``problem`` is why it could not be asked; ``fault`` how its newest test ended, where that was with a fault.
    """
    if problem:
        return Light("poor", _("Do not measure with this instrument"), (problem,))
    if checkup is None:
        return NOT_ASKED
    poor, check = _concerns(checkup)
    if fault is not None:
        check.append(
            _("The newest test, of {time}, ended with a fault: {reason}").format(time=fault.time, reason=fault.reason)
        )
    if poor:
        return Light("poor", _("Do not measure with this instrument"), tuple(poor + check))
    if check:
        return Light("check", _("Usable, with remarks"), tuple(check))
    temperature = _("the coil is at {temperature} °C").format(temperature=fixed(checkup.temperature_c, 0))
    reasons = (
        _(
            "The instrument answers; {temperature}; no data was lost; its calibration is active. Only"
            " a test or a calibration shows whether the coil pushes correctly."
        ).format(temperature=temperature),
    )
    return Light("good", _("No problem found"), reasons)


def _concerns(checkup: Checkup) -> tuple[list[str], list[str]]:
    """Return the reasons against measuring, and the remarks."""
    poor: list[str] = []
    check: list[str] = []
    hottest = min(limits.max_temperature_c for limits in checkup.limits.values())
    temperature = checkup.temperature_c
    if not checkup.samples:
        poor.append(_("It sends no samples: check the cable, and ask again."))
    elif not PLAUSIBLE_C[0] <= temperature <= PLAUSIBLE_C[1]:
        poor.append(_("The coil's temperature sensor gives no usable reading: check its plug and cable."))
    elif temperature > hottest:
        poor.append(
            _("The coil is at {temperature} °C; the limit is {hottest:g} °C: let it cool.").format(
                temperature=fixed(temperature, 0), hottest=hottest
            )
        )
    elif temperature > WARM_C:
        check.append(
            _("The coil is warm, {temperature} °C: let it cool before a calibration.").format(
                temperature=fixed(temperature, 0)
            )
        )
    if abs(checkup.resting_a) > RESTING_A:
        poor.append(
            _("The current reads {current} A although the coil is free: check the current channel.").format(
                current=fixed(checkup.resting_a, 2)
            )
        )
    if checkup.faults:
        poor.append(sentence(_("a fault stays: {faults}").format(faults=checkup.faults)))
    if checkup.lost > LOST_SHARE * checkup.samples:
        check.append(
            translated(
                Message(
                    "checkup.lost",
                    "{lost} of {samples} samples did not arrive: check the cable, and close other programs.",
                    lost=grouped(checkup.lost),
                    samples=grouped(checkup.samples),
                )
            )
        )
    link = checkup.link
    if link is not None and link.damaged > DAMAGED_SHARE * max(1, link.frames):
        check.append(
            _("{damaged} frames were damaged on the way, {frames} were not: check the cable.").format(
                damaged=grouped(link.damaged), frames=grouped(link.frames)
            )
        )
    if link is not None and link.repeated:
        check.append(
            _("{repeated} requests had to be sent again: check the cable.").format(repeated=grouped(link.repeated))
        )
    calibration = calibration_state(checkup.device)
    if calibration.level != "good":
        check.append(sentence(_(calibration.summary)))
    check += [line for line in calibration.warnings if line not in check]
    return poor, check


def background(folder: Path, calibrations: Path | None, log: Path, cancelled: Cancelled) -> Background:
    """What is known without the instrument; a folder of calibrations that cannot be read is said in words.

    Raises:
        CancelledError: by ``cancelled``.
    """
    files = newest_first(folder, ".h5")
    try:
        page = read_log(log, cancelled, RECENT_BYTES)
    except (TissueIDError, OSError) as error:
        if isinstance(error, CancelledError):
            raise
        page = LogPage()  # its own tab says so
    recent = read_events(files[:RECENT_FILES], page, cancelled)
    problem = ""
    stored: tuple[Stored, ...] = ()
    try:
        stored = stored_calibrations(calibration_folder(calibrations))
    except TissueIDError as error:
        problem = sentence(str(error))
    return Background(_last_test(files, cancelled), stored, recent.newest_fault, problem)


def _last_test(files: list[Path], cancelled: Cancelled) -> LastTest | None:
    for path in files[:RECENT_FILES]:
        cancelled()
        try:
            outline = read_outline(path)
            if not outline.tests or IMPORTED in outline.tests[-1].test.notes:
                continue  # an imported record says nothing of this instrument and its cable
            test = read_test(path, outline.tests[-1].test.number)
        except (TissueIDError, OSError):
            continue  # the list of events names it
        columns = [values for name, values in test.signals.items() if name in ("position", "current")]
        missing = int(np.any([np.isnan(values) for values in columns], axis=0).sum()) if columns else 0
        late, held = (test.notes.get(name, 0.0) for name in ("late_blocks", "held_samples"))
        device = outline.head.instrument
        return LastTest(
            path,
            outline.head.created,
            test.status,
            test.samples,
            missing,
            _count(late),
            _count(held),
            device.model,
            device.serial_number,
        )
    return None


def _count(value: float | str) -> int:
    return int(value) if isinstance(value, int | float) and np.isfinite(value) else 0


def newest_first(folder: Path, suffix: str) -> list[Path]:
    """The files of a folder with this suffix, newest first; none where there is no folder."""
    try:
        files = [path for path in folder.iterdir() if path.suffix == suffix and path.is_file()]
    except OSError:
        return []
    return sorted(files, key=lambda path: (_changed(path), path.name), reverse=True)


def _changed(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except OSError:  # taken away meanwhile
        return 0.0
