"""A new property of a test is one field of ``tissueid.test_settings``: it then appears everywhere."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import types
from pathlib import Path

import pytest

import tissueid.test_settings

SOURCE = Path(tissueid.test_settings.__file__)
FIELDS = {
    "    configuration: Annotated[": """
    hydration: Annotated[
        float | None,
        Setting("--hydration", metavar="SHARE", help="water of the skin", choices=NOT_RECORDED),
        Field(title="Skin hydration", description="Water content of the skin", ge=0.0, le=1.0),
    ] = None
""",
    "    minutes_since_application: Annotated[": """
    posture: Annotated[
        str | None,
        Setting("--posture", help="lying or sitting", choices=NOT_RECORDED | {"lying": "Lying", "sitting": "Sitting"}),
        Field(title="Posture"),
    ] = None
""",
}
"""Source of two properties, by the field before which each is added."""


def extended() -> types.ModuleType:
    """Return the module of the settings with two more properties."""
    source = SOURCE.read_text(encoding="utf-8")
    for following, field in FIELDS.items():
        assert source.count(following) == 1
        source = source.replace(following, field + following)
    module = types.ModuleType("tissueid.test_settings")
    sys.modules[module.__name__] = module
    exec(compile(source, str(SOURCE), "exec"), module.__dict__)
    return module


def test_a_property_is_declared_once(monkeypatch):
    monkeypatch.setitem(sys.modules, "tissueid.test_settings", tissueid.test_settings)
    settings = extended()
    assert {"hydration", "posture"} <= set(settings.PROPERTIES)
    assert "hydration" in settings.NUMBERS
    assert "posture" not in settings.NUMBERS
    made = settings.TestSettings(site="arm", hydration=0.4, posture="lying")
    assert made.as_notes()["hydration"] == 0.4
    assert settings.noted(settings.SetUp, made.as_notes())["hydration"] == 0.4
    assert settings.noted(settings.SetUp, {"hydration": 1.4}) == {}
    assert not {"hydration", "posture"} & set(settings.TestSettings(site="arm").as_notes())


@pytest.mark.soak
def test_a_property_appears_everywhere(tmp_path):
    environment = os.environ | {"QT_QPA_PLATFORM": "offscreen", "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    run = subprocess.run(
        [sys.executable, "-W", "ignore", __file__, str(tmp_path)], env=environment, text=True, capture_output=True
    )
    assert run.returncode == 0, run.stdout + run.stderr


def check_command_and_files(folder: Path) -> Path:
    """Check the options of the shell, JSON, HDF5, export and import; return the session."""
    import json

    from tissueid.cli import main
    from tissueid.sessions import read_session
    from tissueid.sessions.imports import Choices, Source, assembled, export_session, import_test

    path, answer = folder / "s.h5", folder / "s.json"
    options = ["--hydration", "0.4", "--posture", "lying", "--seconds", "2", "--no-calibration"]
    where = ["--site", "arm", "--out", str(path), "--json", str(answer)]
    assert main(["test", "--device", "simulated://forearm", *where, *options]) == 0
    given = json.loads(answer.read_text())["tests"][0]
    assert (given["hydration"], given["posture"]) == (0.4, "lying")
    session = read_session(path)
    assert (session.tests[0].notes["hydration"], session.tests[0].notes["posture"]) == (0.4, "lying")
    export_session(session, folder / "out", "csv")
    stored = json.loads((folder / "out" / "test-0001.json").read_text())
    assert stored["test"]["notes"]["hydration"] == 0.4
    again, _notices = assembled(
        [import_test(Source.parsed(str(folder / "out" / "test-0001.csv")), None, Choices())], {}, None
    )
    assert again.tests[0].notes == session.tests[0].notes
    return path


def check_journal(folder: Path) -> None:
    """Check the header of a test in the journal."""
    from tissueid.acquisition import GuidedTest, SessionRecorder, journal_path, run_guided_test
    from tissueid.acquisition.journal import Entry, TestContent, read_entries
    from tissueid.acquisition.stimulus_choice import playable
    from tissueid.instrument import SimulatedInstrument
    from tissueid.procedures.test_plan import TestPlan

    plan = TestPlan(url="x", site="arm", out=folder / "x", seconds=0.5, hydration=0.4)  # type: ignore[call-arg]
    instrument = SimulatedInstrument(seed=1)
    recorder = SessionRecorder(folder / "j.h5", instrument.device)
    run_guided_test(instrument, GuidedTest(playable(plan.specification(2000.0)), plan), recorder, surface_m=0.01)
    recorder.abandon()
    heads = [payload for kind, payload in read_entries(journal_path(folder / "j.h5")) if kind is Entry.TEST]
    assert TestContent.model_validate_json(heads[0]).test.notes["hydration"] == 0.4


def check_protocol() -> None:
    """Check the entries of a protocol, and the test that follows from them."""
    import json

    from tissueid.procedures.study_protocol import next_step, parse_protocol, protocol_text
    from tissueid.procedures.study_sitting import condition_of

    condition = {"product": "lotion", "posture": "sitting"}
    protocol = parse_protocol({"name": "A", "sites": ["arm"], "hydration": 0.3, "conditions": [condition]}, "p")
    text = json.loads(protocol_text(protocol))
    assert (text["hydration"], text["conditions"][0]["posture"]) == (0.3, "sitting")
    step = next_step(protocol, "P1", [])
    assert step is not None
    notes = protocol.plan(step, "x", Path("x.h5")).as_notes()
    assert (notes["hydration"], notes["posture"]) == (0.3, "sitting")
    assert condition_of(notes) == protocol.conditions[0]
    assert protocol.conditions[0].text == "lotion, Posture: Sitting"


def check_table_and_report(path: Path) -> None:
    """Check the table of a study and the report of a session."""
    from tissueid.cli import main
    from tissueid.studies.study_table import DESCRIPTION, KEYS, study_table

    assert {"hydration", "posture"} <= {*KEYS, *DESCRIPTION}
    assert "posture" in KEYS  # a circumstance of the condition
    study, page = path.parent / "study", path.parent / "page.html"
    study.mkdir()
    (study / "s.h5").write_bytes(path.read_bytes())
    assert main(["study", "run", str(study), "--engine", "lms", "--workers", "1"]) == 0
    head, row = (study / "results" / "table.csv").read_text().splitlines()
    values = dict(zip(head.split(","), row.split(","), strict=False))
    assert (float(values["hydration"]), values["posture"]) == (0.4, "lying")
    assert main(["report", str(path), "--out", str(page), "--engines", "lms"]) == 0
    words = " ".join(re.sub("<[^>]*>", " ", page.read_text()).split())
    assert "Skin hydration 0.4 " in words
    assert "Posture Lying " in words  # the declared label of the value
    keys = ("created", "session", "subject", "site", "condition", "configuration", "engine")
    row = dict.fromkeys(keys, "") | {"test": 1, "status": "completed", "quality": "good"}
    odd = study_table([row | {"hydration": "much", "posture": 5.0}, row | {"hydration": "0.2"}])
    assert odd["hydration"].isna().tolist() == [True, False]
    assert odd["hydration"].iloc[1] == 0.2
    assert odd["posture"].iloc[0] == "5.0"


def check_form() -> None:
    """Check the form of a test and the dialog of a protocol."""
    from PySide6.QtWidgets import QApplication

    application = QApplication([])
    from tissueid.app.stimulus_form import ConfigurationChooser
    from tissueid.app.views.studies.request_row import ProtocolDialog
    from tissueid.procedures.study_protocol import parse_protocol
    from tissueid.procedures.test_plan import TestPlan

    form = ConfigurationChooser()
    assert (form.values()["hydration"], form.values()["posture"]) == (None, None)
    form.choose(hydration=0.5, posture="lying")
    notes = TestPlan(url="x", site="arm", out=Path("x"), **form.values()).as_notes()
    assert (notes["hydration"], notes["posture"]) == (0.5, "lying")
    for name, label in (("hydration", "Skin hydration"), ("posture", "Posture")):
        assert form.settings[name].label == label
        assert form.settings[name].isVisibleTo(form)
    form.settings["hydration"].set_value(2.0)
    assert form.values()["hydration"] == 1.0
    condition = {"product": "lotion", "posture": "sitting"}
    given = parse_protocol({"name": "A", "sites": ["arm"], "hydration": 0.3, "conditions": [condition]}, "p")
    dialog = ProtocolDialog(given)
    assert dialog.protocol() == given
    del application


if __name__ == "__main__":
    extended()
    work = Path(sys.argv[1])
    session_path = check_command_and_files(work)
    check_journal(work)
    check_protocol()
    check_table_and_report(session_path)
    check_form()
