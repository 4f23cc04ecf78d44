"""Files that were stored on 27 November 2026, one of each kind: they are read with the same values."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tissueid.acquisition.recovery import recover
from tissueid.acquisition.stimulus_choice import load_stimulus
from tissueid.procedures.study_protocol import parse_protocol, protocol_text, read_protocol
from tissueid.procedures.test_plan import PRESETS, TestPlan
from tissueid.sessions import Session, read_session, write_session
from tissueid.sessions.imports import Choices, Source, assembled, import_test

FOLDER = Path(__file__).parent / "data" / "recorded"


def values(value: Any) -> Any:
    """Return a value as JSON holds it; NaN as text."""
    if isinstance(value, np.ndarray):
        return values(value.tolist())
    if isinstance(value, dict):
        return {str(key): values(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [values(item) for item in value]
    if isinstance(value, float) and value != value:
        return "NaN"
    return value if isinstance(value, str | int | float | None) else values(vars(value))


def session_values(session: Session) -> Any:
    """Return everything that a session holds, without the version of the software."""
    return values(vars(session) | {"software": ""})


def exported() -> Session:
    table = next((FOLDER / "export").glob("*.csv"))
    return assembled([import_test(Source.parsed(str(table)), None, Choices())], {}, None)[0]


def recovered(work: Path) -> Session:
    journal = work / "cut.h5.journal"
    shutil.copyfile(FOLDER / "cut.h5.journal", journal)
    return recover(journal)[1]


def stimulus() -> dict[str, Any]:
    return values(vars(load_stimulus(FOLDER / "stimulus.json")) | {"values": None})


def preset(name: str) -> dict[str, Any]:
    chosen = next(preset for preset in PRESETS if preset.name == name)
    plan = TestPlan(url="x", site="y", out=Path("z"), **chosen.plan_values())
    return values(plan.specification(2000.0).model_dump())


def read_all(work: Path) -> dict[str, Any]:
    return {
        "session": session_values(read_session(FOLDER / "session.h5")),
        "recovered": session_values(recovered(work)),
        "imported": session_values(read_session(FOLDER / "imported.h5")),
        "exported": session_values(exported()),
        "protocol": read_protocol(FOLDER).model_dump(mode="json"),
        "stimulus": stimulus(),
        "presets": {one.name: preset(one.name) for one in PRESETS},
    }


KINDS = ("session", "recovered", "imported", "exported", "protocol", "stimulus", "presets")


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    return read_all(tmp_path_factory.mktemp("recorded"))


@pytest.mark.parametrize("kind", KINDS)
def test_a_stored_file_is_read_with_the_same_values(found, kind):
    stored = json.loads((FOLDER / "values.json").read_text(encoding="utf-8"))
    assert found[kind] == stored[kind]


def test_what_is_read_is_written_with_the_same_values(tmp_path, found):
    session = read_session(FOLDER / "session.h5")
    write_session(tmp_path / "again.h5", session)
    assert session_values(read_session(tmp_path / "again.h5")) == found["session"]
    protocol = parse_protocol(found["protocol"], "protocol")
    assert json.loads(protocol_text(protocol)) == json.loads((FOLDER / "protocol.json").read_text(encoding="utf-8"))
