"""Calibration files: what is written comes back, and what comes from elsewhere is judged."""

import math
import os
from datetime import UTC, datetime
from pathlib import Path

import pytest
from coded import coded, codes, says
from hypothesis import given, settings
from hypothesis import strategies as st

from tissueid.calibration import CalibratedQuantity, Calibration, read_calibration, write_calibration
from tissueid.calibration.file import MAX_BYTES, to_toml, utc_date
from tissueid.calibration.status import notes_of, problems_of
from tissueid.errors import UnusableInputError
from tissueid.messages import Message, code_of
from tissueid.messages import Quantity as ShownQuantity


def calibration(**changes):
    figures = {
        "kind": "static",
        "model": "desktop indenter",
        "serial_number": "A-1",
        "date": "2026-03-01T09:30:00Z",
        "software": "tissueid 0",
        "verdict": "passed",
        "conditions": {"ambient_c": 23.0, "by": 'a "person" \\ at a bench, 21 °C'},
        "quantities": {"coil_resistance_ohm": CalibratedQuantity(value=12.31, std=0.01, unit="ohm")},
        "tables": {"position": {"position_m": (0.1 + 0.2, 1e-300), "reading_m": (-0.0, 5e-324)}},
    }
    return Calibration(**figures | changes)


def test_what_is_written_comes_back(tmp_path):
    path = tmp_path / "a.toml"
    write_calibration(path, calibration(problems=("one", "two"), valid_days=30))
    assert read_calibration(path) == calibration(problems=("one", "two"), valid_days=30)
    assert path.read_text().startswith("# Static calibration of desktop indenter, A-1.\n")
    assert list(tmp_path.iterdir()) == [path]


finite = st.floats(allow_nan=False, allow_infinity=False)
text = st.text(st.characters(exclude_categories=("Cs", "Cc")), max_size=200)


@settings(max_examples=50)
@given(value=finite, std=st.none() | st.floats(0, 1e300), note=text, column=st.lists(finite, max_size=5))
def test_every_number_and_text_comes_back(tmp_path_factory, value, std, note, column):
    path = tmp_path_factory.mktemp("files") / "a.toml"
    made = calibration(
        conditions={"note": note},
        quantities={"mass_kg": CalibratedQuantity(value=value, std=std, unit="kg")},
        tables={"x": {"y": tuple(column)}},
    )
    write_calibration(path, made)
    assert read_calibration(path) == made


def test_comments_are_allowed(tmp_path):
    path = tmp_path / "a.toml"
    path.write_text("# by hand\n" + to_toml(calibration()).replace("value = 12.31", "value = 12.31 # cold"))
    assert read_calibration(path) == calibration()


@pytest.mark.parametrize(
    ("old", "new", "field", "reason"),
    [
        ("12.31", "nan", "quantities.coil_resistance_ohm.value", "option.finite"),
        ("12.31", "true # ", "quantities.coil_resistance_ohm.value", "option.number"),
        ("0.01", "-0.01", "quantities.coil_resistance_ohm.std", "option.least"),
        ('kind = "static"', 'kind = "guess"', "kind", "option.choice"),
        ('"A-1"', '""', "serial_number", ""),
        ("2026-03-01T09:30:00Z", "2026-03-01T09:30:00", "date", ""),
        ("2026-03-01T09:30:00Z", "yesterday", "date", ""),
        ("valid_days = 90", "valid_days = 0", "valid_days", "option.least"),
        ('verdict = "passed"', "", "verdict", "option.missing"),
        ("1e-300,", "", "tables", ""),
        ("ambient_c", '"Ambient, C"', "conditions.Ambient, C", ""),
        ('format_version = "1.0"', 'format_version = "2.0"', "format_version", "option.choice"),
        ('software = "', 'surprise = 1\nsoftware = "', "surprise", "option.extra"),
    ],
)
def test_a_wrong_field_is_named(tmp_path, old, new, field, reason):
    path = tmp_path / "a.toml"
    whole = to_toml(calibration())
    assert old in whole
    path.write_text(whole.replace(old, new, 1))
    with pytest.raises(UnusableInputError, check=coded("calibration.field", path=str(path), field=field)) as caught:
        read_calibration(path)
    assert code_of(caught.value.message.values["reason"]) == reason
    assert "\n" not in caught.value.message


@pytest.mark.parametrize(
    ("old", "new"), [('format = "tissueid-calibration"', 'format = "recipe"'), ("[cond", "[[cond")]
)
def test_other_toml_is_not_a_calibration(tmp_path, old, new):
    path = tmp_path / "a.toml"
    path.write_text(to_toml(calibration()).replace(old, new, 1))
    with pytest.raises(UnusableInputError, check=coded("calibration.not_one", path=str(path))):
        read_calibration(path)


def test_files_that_are_none_are_refused(tmp_path):
    with pytest.raises(UnusableInputError, check=coded("calibration.unreadable", reason="No such file or directory")):
        read_calibration(tmp_path / "nothing.toml")
    with pytest.raises(UnusableInputError, check=coded("calibration.not_a_file")):
        read_calibration(tmp_path)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(UnusableInputError, check=coded("calibration.not_a_file")):
        read_calibration(tmp_path / "pipe")
    (tmp_path / "large.toml").write_bytes(b"#" * (MAX_BYTES + 1))
    with pytest.raises(UnusableInputError, check=coded("calibration.too_large", limit=1024)):
        read_calibration(tmp_path / "large.toml")
    (tmp_path / "binary.toml").write_bytes(b"\x89PNG\xff")
    with pytest.raises(UnusableInputError, check=coded("calibration.not_one", reason="it is not a text file")):
        read_calibration(tmp_path / "binary.toml")
    (tmp_path / "deep.toml").write_text("a = " + "[" * 5000 + "]" * 5000)
    with pytest.raises(UnusableInputError, check=coded("calibration.not_one", reason="nested too deeply")):
        read_calibration(tmp_path / "deep.toml")


def test_nothing_but_a_calibration_is_written_over(tmp_path):
    other = tmp_path / "pyproject.toml"
    other.write_text("[project]\n")
    with pytest.raises(UnusableInputError, check=coded("calibration.other_file", path=str(other))):
        write_calibration(other, calibration())
    assert other.read_text() == "[project]\n"
    old = tmp_path / "old.toml"
    write_calibration(old, calibration())
    write_calibration(old, calibration(valid_days=7))
    assert read_calibration(old).valid_days == 7
    with pytest.raises(UnusableInputError, check=coded("file.no_folder", folder=str(tmp_path / "nowhere"))):
        write_calibration(tmp_path / "nowhere" / "a.toml", calibration())


def test_dates_are_in_utc():
    assert utc_date(datetime(2026, 3, 1, 9, 30, tzinfo=UTC)) == "2026-03-01T09:30:00Z"
    assert calibration().age_days(datetime(2026, 3, 3, 9, 30, tzinfo=UTC)) == pytest.approx(2.0)


def test_the_example_is_a_calibration_that_passed():
    example = Path(__file__).parents[2] / "calibration_data" / "example" / "SIM-EXAMPLE-static.toml"
    found = read_calibration(example)
    assert found.verdict == "passed"
    assert found.quantities["force_constant_n_per_a"].value == pytest.approx(2.93 / 1.012, rel=0.005)


def test_problems_and_notes_are_restored_as_messages(tmp_path):
    problem = Message("calibration.leak", "{current} flow at 0 V", current=ShownQuantity(12.0, "mA"))
    note = Message("calibration.note", "a note on {name}", name="the spring")
    made = calibration(
        verdict="failed",
        problems=(str(problem), "only a text"),
        conditions={"note_1": str(note), "note_2": "another text"},
        messages=(problem.as_dict(), note.as_dict(), {"code": 3}, Message("a.b", "{x}", x=math.nan).as_dict()),
    )
    path = tmp_path / "a.toml"
    write_calibration(path, made)
    found = read_calibration(path)
    assert len(found.messages) == 2
    assert says(problems_of(found)[0], "calibration.leak", current=ShownQuantity(12.0, "mA"))
    assert says(notes_of(found)[0], "calibration.note", name="the spring")
    assert (problems_of(found)[1], notes_of(found)[1]) == ("only a text", "another text")
    edited = found.model_copy(update={"problems": ("13 mA flow at 0 V",)})
    assert codes(problems_of(edited)) == [""]


@pytest.mark.parametrize("hostile", ["1", '"text"', "[1, [2]]", "[{code = 1, template = 2, values = 3}]"])
def test_damaged_messages_are_left_out(tmp_path, hostile):
    path = tmp_path / "a.toml"
    path.write_text(f"messages = {hostile}\n" + to_toml(calibration()))
    assert read_calibration(path).messages == ()
