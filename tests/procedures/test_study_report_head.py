"""The table of a study says which tests are simulated; the report has the name of the protocol."""

from dataclasses import replace

from reports.synthetic_sitting import make_session, make_test

from tissueid.device import SIMULATED_SERIAL
from tissueid.procedures.control import Control
from tissueid.procedures.study_plans import StudyPlan
from tissueid.procedures.study_protocol import PROTOCOL_FILE
from tissueid.procedures.study_run import run_study, study_name
from tissueid.sessions import write_session


def test_the_table_says_which_tests_are_simulated(tmp_path):
    for serial in ("A-1", f"{SIMULATED_SERIAL}1"):
        made = make_session(make_test(1, seconds=1.0))
        session = replace(made, session_id=serial, instrument=replace(made.instrument, serial_number=serial))
        write_session(tmp_path / f"{serial}.h5", session)
    table = run_study(StudyPlan(folder=tmp_path, engine="lms", workers=1), Control()).table
    assert dict(zip(table["session_id"], table["simulated"], strict=True)) == {
        "A-1": False,
        f"{SIMULATED_SERIAL}1": True,
    }


def test_the_name_of_a_study_is_that_of_its_protocol_or_of_its_folder(tmp_path):
    assert study_name(tmp_path) == tmp_path.name
    (tmp_path / PROTOCOL_FILE).write_text('{"name": "Lotion trial", "sites": ["cheek"]}')
    assert study_name(tmp_path) == "Lotion trial"
    (tmp_path / PROTOCOL_FILE).write_text("{")
    assert study_name(tmp_path) == tmp_path.name
