"""``tissueid calibrate`` as a technician meets it: files, pages, states in words, refusals that say what to give."""

import io
import json
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from coded import made, message, says, shows
from shell import answer, complaint

from tissueid.calibration import read_calibration, save_calibration, write_calibration
from tissueid.calibration.file import utc_date
from tissueid.calibration.status import VARIABLE, label_of, problems_of
from tissueid.cli import main

SPRING = "simulated://spring?seed=4"
STATIC = ["calibrate", "static", "--device", SPRING, "--push-only"]


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """A calibration with its page and its JSON, as the command leaves them."""
    folder = tmp_path_factory.mktemp("calibrate")
    files = ["--out", folder / "a.toml", "--report", folder / "a.html", "--json", folder / "a.json"]
    assert main([*STATIC, "--ambient", "25", "--repeats", "2", *map(str, files)]) == 0
    return folder


def test_static_leaves_a_calibration_a_page_and_json(kept):
    found = read_calibration(kept / "a.toml")
    assert found.verdict == "passed"
    assert found.serial_number == "TWIN-4"
    assert found.conditions["ambient_c"] == 25.0
    assert str(found.conditions["audit_head"])
    page = (kept / "a.html").read_text()
    assert "Static calibration passed" in page
    assert "Force constant" in page
    assert page.count("<svg") == 4
    answer = json.loads((kept / "a.json").read_text())
    assert answer["verdict"] == "passed"
    assert answer["quantities"]["force_constant_n_per_a"]["value"] == pytest.approx(3.0, rel=0.005)
    assert answer["seconds"] > 0
    assert answer["quantities"] == {name: q.model_dump() for name, q in found.quantities.items()}


def test_without_a_file_a_calibration_goes_where_tests_look_for_it(tmp_path, monkeypatch, capsys):
    """From any folder, whatever that folder holds."""
    monkeypatch.delenv(VARIABLE)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "home"))
    (tmp_path / "calibration_data").mkdir()
    monkeypatch.chdir(tmp_path)
    assert main([*STATIC, "--steps", "temperature", "--json", "made.json"]) == 0
    made = Path(json.loads((tmp_path / "made.json").read_text())["file"])
    assert made.parent == tmp_path / "home" / "tissueid" / "calibration_data"
    monkeypatch.chdir("/")
    capsys.readouterr()
    assert [row["file"] for row in answer(capsys, "calibrate", "list")["calibrations"]] == [str(made)]
    elsewhere = tmp_path / "calibration_data" / "b.toml"
    assert main([*STATIC, "--steps", "temperature", "--out", str(elsewhere)]) == 0
    assert str(made.parent) in capsys.readouterr().out  # where to copy it, so that tests find it


def test_show_tells_it(kept, capsys):
    assert main(["calibrate", "show", str(kept / "a.toml"), "--report", str(kept / "again.html")]) == 0
    out = capsys.readouterr().out
    assert "Coil resistance" in out
    assert shows(out, "calibration.verdict.passed")
    assert "<svg" in (kept / "again.html").read_text()
    assert answer(capsys, "calibrate", "show", str(kept / "a.toml"))["kind"] == "static"


def test_list_tells_the_state_of_each(kept, tmp_path, capsys):
    found = read_calibration(kept / "a.toml")
    now = datetime.now(UTC)
    write_calibration(tmp_path / "new.toml", found)
    write_calibration(tmp_path / "middle.toml", found.model_copy(update={"date": utc_date(now - timedelta(days=9))}))
    write_calibration(tmp_path / "old.toml", found.model_copy(update={"date": utc_date(now - timedelta(days=400))}))
    failed = {"verdict": "failed", "problems": ("too noisy",), "serial_number": "B-2"}
    write_calibration(tmp_path / "failed.toml", found.model_copy(update=failed))
    (tmp_path / "broken.toml").write_text("[")
    assert main(["calibrate", "list", "--calibrations", str(tmp_path), "--json", "-"]) == 0
    listed = {
        row["file"].rsplit("/", 1)[-1]: (row["state"], row["newest_that_passed"])
        for row in json.loads(capsys.readouterr().out)["calibrations"]
    }
    assert listed == {
        "new.toml": ("valid", True),
        "middle.toml": ("valid", False),
        "old.toml": ("stale", False),
        "failed.toml": ("failed", False),
        "broken.toml": ("damaged", False),
    }
    assert main(["calibrate", "list", "--calibrations", str(tmp_path), "--serial", "B-2"]) == 0
    out = capsys.readouterr().out
    assert "too noisy" in out
    assert "new.toml" not in out
    assert main(["calibrate", "list", "--calibrations", str(tmp_path)]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "newest that passed" in out
    assert "in force" not in out


def test_an_empty_folder_is_said(tmp_path, capsys):
    assert main(["calibrate", "list", "--calibrations", str(tmp_path)]) == 0
    assert "no calibrations" in capsys.readouterr().out


def test_refusals_say_what_to_give(tmp_path, capsys):
    out = ["--out", tmp_path / "a.toml"]
    static = ["calibrate", "static", "--device", SPRING]
    assert shows(complaint(capsys, *static, *out, "--steps", "x"), "calibration.step", step="x")
    assert "--push-only" in complaint(capsys, *static, *out, "--steps", "electrical")
    assert shows(complaint(capsys, *static, *out, "--weight", 50), "calibration.no_terminal")
    assert "--in-place runs without a person" in complaint(capsys, *static, *out, "--in-place", "--gauge", 5)
    for other in ("--json", "--report"):
        assert shows(complaint(capsys, *static, *out, other, tmp_path / "." / "a.toml"), "file.twice")
    gauges = ("--gauge", 0, "--gauge", 5, "--gauge", "nan")
    assert shows(complaint(capsys, *static, *out, *gauges), "calibration.gauge_height", limit=200.0)
    assert "no folder" in complaint(capsys, *static, "--out", tmp_path / "b" / "a.toml")
    (tmp_path / "notes.toml").write_text("title = 'mine'\n")
    assert "not overwritten" in complaint(capsys, *static, "--out", tmp_path / "notes.toml")
    assert "no calibration folder" in complaint(capsys, "calibrate", "list", "--calibrations", tmp_path / "x")
    assert "No such file" in complaint(capsys, "calibrate", "show", tmp_path / "x.toml")
    assert not (tmp_path / "a.toml").exists()


def test_a_failed_calibration_is_kept_and_says_so(tmp_path, capsys):
    arguments = [*STATIC, "--out", str(tmp_path / "a.toml"), "--steps", "force", "--spring", "1400"]
    assert main(arguments) == 2
    told = capsys.readouterr()
    assert "never used" in told.out
    kept = made("calibration.failed_kept", kind="static", path=str(tmp_path / "a.toml"))
    assert told.err.strip().splitlines()[-1] == f"tissueid: {kept}"
    found = read_calibration(tmp_path / "a.toml")
    assert found.verdict == "failed"
    assert says(problems_of(found)[0], "calibration.off_nominal", percent=20.0)


def test_a_failed_calibration_goes_beside_one_that_passed(kept, tmp_path, capsys):
    out, failed, answer = (tmp_path / name for name in ("a.toml", "a.failed.toml", "a.json"))
    out.write_bytes((kept / "a.toml").read_bytes())
    failing = [*STATIC, "--out", str(out), "--json", str(answer), "--steps", "force", "--spring", "1400"]
    assert shows(complaint(capsys, *failing), "calibration.exists")
    for kept_in in (failed, tmp_path / "a.failed_2.toml"):
        assert main([*failing, "--overwrite"]) == 2
        last = capsys.readouterr().err.splitlines()[-1]
        assert shows(last, "calibration.failed_beside", path=str(kept_in), passed=str(out))
    assert out.read_bytes() == (kept / "a.toml").read_bytes()
    assert read_calibration(failed).verdict == "failed"
    assert json.loads(answer.read_text())["file"] == str(kept_in)
    assert sorted(path.name for path in tmp_path.glob("*.toml")) == ["a.failed.toml", "a.failed_2.toml", "a.toml"]


def test_a_failed_one_never_takes_the_place_of_any_that_passed(kept, tmp_path):
    passed = read_calibration(kept / "a.toml")
    for name in ("a.toml", "a.failed.toml"):
        write_calibration(tmp_path / name, passed)
    failed = passed.model_copy(update={"verdict": "failed", "problems": ("too noisy",)})
    assert save_calibration(tmp_path / "a.toml", failed) == tmp_path / "a.failed_2.toml"
    assert save_calibration(tmp_path / "a.toml", passed) == tmp_path / "a_2.toml"
    assert save_calibration(tmp_path / "a.toml", passed, overwrite=True) == tmp_path / "a.toml"
    assert read_calibration(tmp_path / "a.failed.toml").verdict == "passed"


def test_values_are_printed_in_display_units(kept, capsys):
    assert main(["calibrate", "show", str(kept / "a.toml")]) == 0
    lines = {line.strip().split("  ")[0]: line.split()[-1] for line in capsys.readouterr().out.splitlines() if line}
    assert lines[label_of("spring_slope_m_per_a")] == "mm/A"
    assert lines[label_of("calibration_relative_uncertainty")] == "%"


class Terminal(io.StringIO):
    """Somebody who presses Enter."""

    def isatty(self):
        return True


def test_a_person_at_the_terminal_is_told_what_to_do(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys, "stdin", Terminal("\n\n"))
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    arguments = [*STATIC, "--steps", "acceleration", "--orientations", "2", "--out", str(tmp_path / "a.toml")]
    assert main(arguments) == 2
    told = " ".join(capsys.readouterr().err.split())
    assert shows(told, "calibration.ask.over")
    assert shows(told, "calibration.ask.back")
    # The simulation stays as it is: it was not turned over, which shows.
    gain = message(problems_of(read_calibration(tmp_path / "a.toml")), "calibration.accelerometer").values["gain"]
    assert gain == pytest.approx(0.0, abs=0.005)
