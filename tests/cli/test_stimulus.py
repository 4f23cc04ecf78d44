"""``tissueid stimulus``: every kind designed and drawn, saved and read back, and rubbish refused in one line."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from coded import shows
from reports.page_check import checked
from shell import answer, complaint

from tissueid.cli import main
from tissueid.procedures.control import Control
from tissueid.stimuli import get_stimulus, stimulus_names

SHORT: dict[str, tuple[str, ...]] = {
    "noise": ("--seconds", "0.5", "--min-force", "0.5", "--max-force", "7.5", "--option", "distribution=rayleigh"),
    "interchange": ("--seconds", "0.5", "--option", "lags=50", "--option", "tolerance=1e-3"),
    "multisine": (
        "--option",
        "period_s=0.25",
        "--option",
        "notches=[[40, 60]]",
        "--min-volts",
        "2",
        "--max-volts",
        "20",
    ),
    "designed": ("--seconds", "0.5"),
    "quiet": ("--seconds", "0.5"),
    "slow_ramp": ("--seconds", "0.5", "--max-force", "5"),
    "step_hold": ("--seconds", "0.5", "--max-force", "5"),
    "stepped_noise": ("--option", "level_s=0.25", "--option", "levels=2"),
    "rtig": ("--seconds", "1", "--min-force", "-2", "--option", "depth_max_m=0.003"),
}

IMPOSSIBLE = ("interchange", "--option", "spectrum=autocorrelation")


def test_every_kind_is_tried_here():
    assert set(stimulus_names()) == set(SHORT)


@pytest.mark.parametrize("kind", SHORT)
def test_every_kind_is_designed_drawn_and_saved(tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str):
    page, file = tmp_path / "page.html", tmp_path / "stimulus.json"
    found = answer(capsys, "stimulus", kind, *SHORT[kind], "--plot", page, "--out", file)
    assert found["description"]["type"] == kind
    assert found["sample_rate_hz"] == 2000.0
    assert f"Stimulus {kind}" in checked(page.read_text(encoding="utf-8")).text
    assert json.loads(file.read_text())["description"] == found["description"]
    assert {path.name for path in tmp_path.iterdir()} == {"page.html", "stimulus.json"}


@pytest.mark.parametrize("kind", [kind for kind in SHORT if kind != "rtig"])
def test_a_saved_one_is_the_same_again(tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str):
    file = tmp_path / "stimulus.json"
    found = answer(capsys, "stimulus", kind, *SHORT[kind], "--out", file)
    again = answer(capsys, "stimulus", file)
    assert again["sha256"] == found["sha256"]
    assert again | {"interchange": None} == found | {"interchange": None}


def test_a_saved_feedback_stimulus_is_played_as_designed(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    file = tmp_path / "stimulus.json"
    found = answer(capsys, "stimulus", "rtig", *SHORT["rtig"], "--out", file)
    again = answer(capsys, "stimulus", file)
    assert again["kolmogorov_distance"] == found["kolmogorov_distance"]
    assert again["description"] == found["description"]


def test_samples_as_text_come_back_to_the_last_bit(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    samples = tmp_path / "samples.csv"
    found = answer(capsys, "stimulus", "noise", "--seconds", "0.5", "--seed", 3, "--csv", samples)
    rows = list(csv.DictReader(samples.read_text().splitlines()))
    built = get_stimulus("noise").from_options({"seconds": 0.5, "seed": 3}).build()  # type: ignore[attr-defined]
    np.testing.assert_array_equal([float(row["force_n"]) for row in rows], built.values)
    np.testing.assert_allclose([float(row["command_v"]) for row in rows], built.values * 12.0 / 3.0)
    np.testing.assert_allclose([float(row["time_s"]) for row in rows], np.arange(1000) / 2000.0)
    assert found["samples"] == 1000
    assert main(["stimulus", "noise", "--seconds", "0.5", "--csv", str(samples)]) == 0  # its own kind of file


def test_what_is_said_of_a_stimulus_can_be_worked_out_from_its_samples(capsys: pytest.CaptureFixture[str]):
    found = answer(
        capsys, "stimulus", "noise", "--seconds", "1", "--option", "distribution=uniform", "--max-force", "6"
    )
    force = (
        get_stimulus("noise")
        .from_options(  # type: ignore[attr-defined]
            {"seconds": 1.0, "distribution": "uniform", "force_max_n": 6.0}
        )
        .build()
        .values
    )
    assert found["force_max_n"] == pytest.approx(6.0)
    assert found["voltage_max_v"] == pytest.approx(24.0)
    assert found["force_std_n"] == pytest.approx(force.std())
    assert found["crest_factor"] == pytest.approx(np.abs(force - force.mean()).max() / force.std())
    assert found["steepest_edge_n_per_s"] == pytest.approx(np.abs(np.diff(force)).max() * 2000.0)
    assert found["rms_current_a"] == pytest.approx(np.sqrt(np.mean((force / 3.0) ** 2)))
    assert found["amplitude_distance"] < 0.01
    assert found["interchange"] is None


def test_an_interchange_tells_its_swaps_and_its_error(capsys: pytest.CaptureFixture[str]):
    arguments = ("--seconds", "0.5", "--option", "spectrum=band", "--option", "lags=50", "--option", "tolerance=1e-5")
    found = answer(capsys, "stimulus", "interchange", *arguments)
    assert found["autocorrelation_error"] <= 1e-5
    assert found["autocorrelation_lags"] == 50
    assert found["amplitude_distance"] == 0.0
    assert found["interchange"]["error"] == pytest.approx(found["autocorrelation_error"])
    assert 0 < found["interchange"]["accepted"] < found["interchange"]["tried"]


def test_people_get_tables(capsys: pytest.CaptureFixture[str]):
    assert main(["stimulus"]) == 0
    printed = capsys.readouterr().out
    for kind in SHORT:
        assert kind in printed
    assert "during the test" in printed
    assert main(["stimulus", "noise", "--options"]) == 0
    printed = capsys.readouterr().out
    for words in ("cutoff_hz", "whole number, 1 or more, up to 12", "binary, exponential, gaussian", "2⁶³ − 1"):
        assert words in printed
    assert main(["stimulus", "noise", "--seconds", "0.5"]) == 0
    printed = capsys.readouterr().out
    for words in ("Crest factor", "Steepest edge", "Heating of the coil", "Autocorrelation"):
        assert words in printed


def test_a_caution_is_printed(capsys: pytest.CaptureFixture[str]):
    white = ("--option", "spectrum=white", "--option", "distribution=binary")
    assert main(["stimulus", "noise", "--seconds", "0.5", *white]) == 0
    assert shows(capsys.readouterr().out.partition("caution: ")[2], "stimulus.check.hurts")


def test_kinds_and_options_as_json(capsys: pytest.CaptureFixture[str]):
    kinds = answer(capsys, "stimulus")
    assert {item["kind"] for item in kinds if item["generated_while_the_test_runs"]} == {"rtig"}
    schema = answer(capsys, "stimulus", "noise", "--options")
    assert schema["properties"]["order"]["maximum"] == 12


def test_the_device_that_is_named_is_the_one_that_is_designed_for(capsys: pytest.CaptureFixture[str]):
    found = answer(capsys, "stimulus", "noise", "--seconds", "0.5", "--device", "simulated://spring")
    assert found["samples"] == 1000
    assert (
        "simulated://spring"
        in answer(capsys, "stimulus", "rtig", *SHORT["rtig"], "--device", "simulated://spring")["device"]
    )


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["whistle"], "no stimulus 'whistle': choose one of"),
        (["--seed", "3"], "name a stimulus"),
        (["noise", "--options", "--seed", "3"], "name a stimulus"),
        (["noise", "--option", "colour=red"], "option 'colour'"),
        (["noise", "--option", "colour"], "NAME=VALUE"),
        (["noise", "--option", "order=two"], "option 'order'"),
        (["noise", "--seconds", "2", "--option", "seconds=3"], "seconds is given twice, by --seconds and by --option"),
        (["multisine", "--seconds", "2"], "has no option --seconds; 'tissueid stimulus multisine --options' lists"),
        (["noise", "--seconds", "nan"], "seconds"),
        (["noise", "--seconds", "-1"], "seconds"),
        (["noise", "--seconds", "600", "--option", "sample_rate=1e6"], "the maximum is"),
        (["noise", "--option", "sample_rate=4000"], "sample rate is 4000 Hz"),
        (["noise", "--seconds", "30"], "lasts 30.0 s; the maximum is 29.5 s"),
        (["noise", "--min-force", "1", "--max-volts", "9"], "either as force or as voltage"),
        (["noise", "--min-force", "5", "--max-force", "2"], "must be below the greatest"),
        (["noise", "--max-force", "13"], "reaches 13.0 N; the limit is 12 N"),
        (["noise", "--max-force", "16", "--limits", "research"], "reaches 16.0 N; the limit is 15 N"),
        (["noise", "--min-volts", "0", "--max-volts", "60", "--limits", "research"], "the amplifier gives 48 V"),
        (["noise", "--min-volts", "3"], "needs both limits"),
        (["noise", "--option", "cutoff_hz=1000"], "a cutoff of 1000 Hz needs a sample rate above 2000 Hz"),
        (["multisine", "--option", "highest_hz=1000"], "above 2000 Hz"),
        (["multisine", "--option", "notches=[[0, 300]]"], "has no odd line"),
        (
            [*IMPOSSIBLE, "--option", "lags_s=[0, 0.001, 0.002]", "--option", "correlations=[1, 0.9, -0.9]"],
            "no signal has this autocorrelation: its spectrum would be negative",
        ),
        (["interchange", "--option", "distribution=binary"], "autocorrelation"),
        (["noise", "--limits", "none"], "the limits must be one of research, clinical"),
        (["noise", "--device", "/dev/none"], "cannot open /dev/none"),
        (["noise", "--plot", "FOLDER/plot.jpg"], "the file name of a plot must end in"),
        (["noise", "--plot", "FOLDER/no/plot.png"], "no folder"),
        (["noise", "--plot", "LETTER.png"], "already exists and has other content"),
        (["noise", "--csv", "LETTER.png"], "already exists and has other content"),
        (["noise", "--csv", "-"], "only JSON can go to standard output"),
        (["noise", "--out", "SAVED"], "never overwritten"),
        (["noise", "--out", "FOLDER/a.json", "--json", "FOLDER/a.json"], "is named for two outputs"),
        (["FOLDER/none.json"], "no such file"),
        (["RUBBISH"], "damaged, or not a saved stimulus"),
        (["HUGE"], "larger than 4 MB"),
        (["SAVED", "--seed", "4"], "contains its options"),
        (["SAVED", "--limits", "clinical", "--option", "order=2"], "contains its options"),
        (["rtig", "--csv", "FOLDER/a.csv"], "no samples before its test"),
        (["rtig", "--device", "socket://localhost:1"], "'tissueid test --stimulus rtig' plays it"),
        (["rtig", "--device", "simulated://moon"], "no simulated tissue"),
        (["rtig", "--max-force", "13"], "13.0 N; the limit is 12 N"),
    ],
)
def test_rubbish_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], words: str
):
    files = {name: tmp_path / file for name, file in (("SAVED", "s.json"), ("RUBBISH", "r.json"), ("HUGE", "h.json"))}
    (tmp_path / "letter.png").write_text("dear")
    files["RUBBISH"].write_text("{")
    with files["HUGE"].open("wb") as file:
        file.truncate(10**9)
    if "SAVED" in arguments:
        assert main(["stimulus", "noise", "--seconds", "0.5", "--out", str(files["SAVED"])]) == 0
        capsys.readouterr()
    before = sorted(path.name for path in tmp_path.iterdir())
    named = [str(files.get(word, word)) for word in arguments]
    named = [word.replace("FOLDER", str(tmp_path)).replace("LETTER", str(tmp_path / "letter")) for word in named]
    assert words in complaint(capsys, "stimulus", *named)
    assert sorted(path.name for path in tmp_path.iterdir()) == before


def test_interrupted_while_designing_leaves_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Control, "check", interrupted)
    arguments = ("--seconds", "0.5", "--option", "spectrum=band", "--option", "lags=50", "--option", "tolerance=1e-9")
    assert main(["stimulus", "interchange", *arguments, "--out", str(tmp_path / "a.json")]) == 130
    assert capsys.readouterr().err.strip().splitlines()[-1].startswith("tissueid: interrupted")
    assert list(tmp_path.iterdir()) == []
