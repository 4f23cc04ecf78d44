"""Write files next to this script, one of each kind that the program stores.

They were written on 27 November 2026 and stay as they are: ``tests/test_recorded_files.py`` reads them. Run this
script in an empty folder only to learn how they were made.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tissueid.acquisition.journal import MAGIC, Entry, encode_entry, encode_json
from tissueid.acquisition.stimulus_choice import playable, save_stimulus
from tissueid.device import DeviceDescription
from tissueid.instrument import SAMPLE
from tissueid.messages import Message
from tissueid.procedures.study_protocol import Protocol, protocol_text
from tissueid.procedures.test_plan import PRESETS, TestPlan
from tissueid.sessions import Session, Subject, Test, write_session
from tissueid.sessions.imports import Choices, Source, assembled, export_session, import_test, parse_map
from tissueid.sessions.model import reason_notes
from tissueid.wire import Flag

FOLDER = Path(__file__).parent
RATE = 2000.0
ROUND = {"probe_name": "indenter-4.4mm", "probe_diameter_m": 0.0044, "probe_thickness_m": 0.001}
LONG = {"probe_width_m": 0.005, "probe_length_m": 0.016}
SETTINGS: dict[int, tuple[str, dict[str, Any]]] = {
    1: ("indentation", ROUND | {"external_spring_n_per_m": 0.0, "coupling": "tape"}),
    2: ("indentation", ROUND | {"external_spring_n_per_m": 0.0}),
    3: (
        "extension",
        LONG
        | {"probe_name": "extension-5x16mm", "probe_corner_radius_m": 0.002, "external_spring_n_per_m": 0.0}
        | {"coupling": "adhesive", "orientation_deg": -30.0, "initial_length_m": 0.01},
    ),
    4: (
        "surface",
        LONG
        | {"probe_name": "slider-5x16mm", "probe_corner_radius_m": 0.0015, "external_spring_n_per_m": 800.0}
        | {"normal_preload_n": 1.0},
    ),
    5: ("indentation", ROUND | {"external_spring_n_per_m": 0.0}),
    6: ("indentation", ROUND | {"external_spring_n_per_m": 0.0}),
}
KINDS = ("stochastic", "quiet", "slow_ramp", "step_hold", "spring", "free_air")


def a_test(number: int) -> Test:
    """Return a test whose every field has a value of its own."""
    times = np.arange(24 + number) / RATE
    signals = {
        "command": np.sin(times * 400.0),
        "force": 3.0 + 0.1 * number + np.sin(times * 300.0),
        "position": 0.01 + 1e-4 * np.cos(times * 200.0),
    }
    signals["force"][3] = np.nan
    configuration, settings = SETTINGS[number]
    notes: dict[str, Any] = {"limit_max_force_n": 12.0} | settings
    if number == 1:
        notes |= {"sitting": "2026-11-27T10:00:00Z", "repeat": 2.0, "condition": "lotion"}
        notes["minutes_since_application"] = 15.0
    if number == 2:
        notes |= reason_notes(Message("test.ended", "ended after {seconds:.2f} s: {why}", seconds=1.5, why="precise"))
    return Test(
        number=number,
        kind=KINDS[number - 1],
        signals=signals,
        sample_rate_hz=RATE if number != 5 else 1000.0,
        configuration=configuration,
        site=f"left forearm, é {number}",
        preload_s=0.001 * number,
        surface_position_m=float("nan") if number == 2 else 0.01 + 0.001 * number,
        stimulus={"type": "noise", "seconds": 4.0, "force_max_n": 10.5, "table": [1.0, 2.0]},
        seed=2**31 - number,
        repeat_of=1 if number == 6 else None,
        status=("completed", "aborted", "recovered")[number % 3],
        notes=notes,
    )


def a_session() -> Session:
    """Return a session of one test of each kind."""
    return Session(
        instrument=DeviceDescription(calibration={"state": "valid", "verdict": "passed"}),
        subject=Subject("P-001", {"age_years": 30.0, "gender": "female"}),
        tests=tuple(map(a_test, range(1, 7))),
        session_id="11111111-2222-3333-4444-555555555555",
        created="2026-11-27T10:00:00Z",
        software="tissueid 0.1.0",
        audit_head="7 abc",
    )


def write_journal(path: Path, session: Session) -> None:
    """Write the journal of a sitting whose host stopped in the second test."""
    data = MAGIC + encode_json(
        Entry.SITTING,
        {
            "session_id": session.session_id,
            "created": session.created,
            "device": vars(session.instrument),
            "subject": vars(session.subject),
            "sample_fields": [list(item) for item in SAMPLE.descr],
            "audit_head": session.audit_head,
        },
    )
    first = 0
    for test in session.tests[:2]:
        names = ("kind", "configuration", "site", "sample_rate_hz", "preload_s", "surface_position_m", "stimulus")
        attributes = {name: getattr(test, name) for name in (*names, "seed", "repeat_of", "notes")}
        run = {"first_index": first, "samples": 40}
        entry = {"number": test.number, "run": run, "attributes": attributes}
        samples = np.zeros(40, SAMPLE)
        samples["index"] = first + np.arange(40)
        samples["position"], samples["flags"] = 0.01, Flag.PLAYING
        data += encode_json(Entry.TEST, entry) + encode_entry(Entry.SAMPLES, samples[:30].tobytes())
        data += encode_json(Entry.EVENT, {"kind": "gap", "first_index": 5, "count": 1, "test": test.number})
        if test.number == 1:
            data += encode_entry(Entry.SAMPLES, samples[30:].tobytes())
            end = {"test": 1, "status": "completed", "notes": {"net_force_n": 5.5}, "samples": 40}
            data += encode_json(Entry.TEST_END, end)
        first += 40
    path.write_bytes(data + encode_entry(Entry.SAMPLES, samples.tobytes())[:50])


def main() -> None:
    """Write the files."""
    session = a_session()
    write_session(FOLDER / "session.h5", session)
    write_journal(FOLDER / "cut.h5.journal", session)
    protocol = Protocol(
        name="Lotion",
        sites=({"site": "left forearm", "repeats": 2}, "right forearm"),  # type: ignore[arg-type]
        conditions=(
            {},  # type: ignore[arg-type]
            {"product": "lotion", "minutes_since_application": 15.0, "orientation_deg": 90.0},  # type: ignore[arg-type]
        ),
        stimulus="depths",
        seconds=6.0,
        configuration="extension",
        coupling="tape",
        initial_length_m=0.01,
    )
    (FOLDER / "protocol.json").write_text(protocol_text(protocol), encoding="utf-8")
    plan = TestPlan(url="x", site="y", out=Path("z"), **PRESETS[0].plan_values(1.0))
    save_stimulus(FOLDER / "stimulus.json", playable(plan.specification(RATE)))
    export_session(replace(session, tests=session.tests[2:3]), FOLDER / "export", "csv")
    table = FOLDER / "record.csv"
    table.write_text("time (s);force (N);position (mm)\n" + "".join(f"{k / 100};{k % 7};{k % 5}\n" for k in range(20)))
    columns = parse_map(("time=1:s", "force=2:N", "position=3:mm"))
    choices = Choices(kind="slow_ramp", site="pad", preload_s=0.05, surface_position_m=0.002, configuration="extension")
    test = import_test(Source.parsed(str(table)), columns, choices)
    imported, _notices = assembled([test], {"moving_mass_kg": 0.06}, "P-002")
    write_session(FOLDER / "imported.h5", imported)


if __name__ == "__main__":
    main()
