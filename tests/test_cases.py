"""Small records of other people through the commands, each with its right value.

The same kinds are tested without these files in ``sessions/test_import_cases.py``, ``sessions/test_file_policy.py``,
``test_slow_records.py``, ``identification/test_foreign_records.py``, ``gap/test_machines.py`` and
``app/test_number_field.py``.
"""

from __future__ import annotations

import csv
import json
import os
import runpy
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from coded import shows
from outside_data import CASES
from PySide6.QtCore import QLocale, Qt
from PySide6.QtTest import QTest

import tissueid
from tissueid.cli import main
from tissueid.identification.base import NEGATIVE_MASS
from tissueid.sessions import Test, read_session

pytestmark = pytest.mark.skipif(not CASES.exists(), reason="the small records are not next to the project")
POSITION = ("--map", "position=3")
FORCE = ("--map", "force=2")


def case(number: int) -> Path:
    (found,) = CASES.glob(f"{number:02d}-*")
    return found


def made(number: int, folder: Path) -> Path:
    """Run the generator of a case in a folder, and return the folder."""
    before = Path.cwd()
    os.chdir(folder)
    try:
        runpy.run_path(str(case(number) / "make.py"))
    finally:
        os.chdir(before)
    return folder


def run(*arguments: object) -> int:
    return main([str(one) for one in arguments])


def imported(folder: Path, *arguments: object) -> Test:
    """Import a record and return its first test."""
    out = folder / "session.h5"
    out.unlink(missing_ok=True)
    assert run("import", *arguments, "--out", out) == 0
    return read_session(out).test()


def answered(folder: Path, *arguments: object) -> dict[str, Any]:
    out = folder / "answer.json"
    assert run(*arguments, "--json", out) == 0
    return json.loads(out.read_text(encoding="utf-8"))


def fitted(folder: Path, record: Path, engine: str, *maps: str) -> dict[str, Any]:
    imported(folder, record, *maps)
    return answered(folder, "identify", folder / "session.h5", "--engine", engine)


@pytest.mark.soak
@pytest.mark.timeout(600)
def test_01_structures_are_not_mixed(tmp_path: Path) -> None:
    study = made(1, tmp_path) / "study"
    study.mkdir()
    names = sorted(path.stem for path in (tmp_path / "csv").glob("*.csv"))
    for name in names:
        out = ("--out", study / f"{name}.h5", "--kind", "slow_ramp", "--subject", name, "--site", "pad")
        record = tmp_path / "csv" / f"{name}.csv"
        assert run("import", record, *out, "--map", "force=force", "--map", "position=displacement") == 0
    with (study / "subjects.csv").open("w", newline="") as file:
        csv.writer(file).writerows([("subject", "group"), *((name, name[0]) for name in names)])
    engine = ("--engine", "viscoelastic", "--workers", 1)
    assert run("study", "run", study, *engine) == 0
    answer = answered(tmp_path, "study", "report", study, *engine, "--factor", "group")
    found = {row["parameter"]: row for row in answer["comparisons"] if row["kind"] == "group"}
    truth = np.loadtxt(tmp_path / "truth.csv", delimiter=",")
    for name, column, spread in (("relaxation_time_s", 3, 0.05), ("spring_1_n_per_m", 2, 10.0)):
        means = [truth[rows, column].mean() for rows in (slice(0, 10), slice(10, 20))]
        assert abs(found[name]["estimate"]) == pytest.approx(abs(means[1] - means[0]), abs=spread)
    assert "mass_kg" not in found


@pytest.mark.parametrize("structure", ["maxwell", "burger"])
def test_02_a_drift_is_not_due_to_the_force(structure: str, tmp_path: Path) -> None:
    assert imported(tmp_path, case(2) / "unrelated.csv", *FORCE, *POSITION).kind == "stochastic"
    engine = ("--engine", "viscoelastic", "--option", f"structure={structure}")
    assert answered(tmp_path, "identify", tmp_path / "session.h5", *engine)["vaf_validation_percent"] < 1.0


def test_02_depth_is_not_credited_with_a_drift(tmp_path: Path) -> None:
    imported(tmp_path, case(2) / "unrelated.csv", *FORCE, *POSITION)
    assert answered(tmp_path, "identify", tmp_path / "session.h5", "--engine", "depth")["predicts_nothing"]


@pytest.mark.soak
@pytest.mark.timeout(600)
def test_02_no_model_describes_a_drift(tmp_path: Path) -> None:
    imported(tmp_path, case(2) / "unrelated.csv", *FORCE, *POSITION)
    answer = answered(tmp_path, "compare", tmp_path / "session.h5")
    assert answer["recommendation"]["messages"]["headline"]["code"] == "recommendation.none"


def test_03_a_ramp_and_hold_has_its_parameters(tmp_path: Path) -> None:
    assert imported(tmp_path, case(3) / "hold.csv", *FORCE, *POSITION).kind == "slow_ramp"
    answer = answered(tmp_path, "identify", tmp_path / "session.h5", "--engine", "viscoelastic")
    values = {name: one["value"] for name, one in answer["parameters"].items()}
    assert values["stiffness_n_per_m"] == pytest.approx(400.0, rel=0.01)
    assert values["spring_1_n_per_m"] == pytest.approx(200.0, rel=0.02)
    assert values["relaxation_time_s"] == pytest.approx(1.0, rel=0.02)
    assert answer["vaf_validation_percent"] > 99.0


@pytest.mark.soak
@pytest.mark.timeout(600)
def test_04_a_start_is_no_evidence(tmp_path: Path) -> None:
    made(4, tmp_path)
    axes = [tmp_path / f"axis{number}.csv" for number in (1, 2)]
    imported(tmp_path, *axes, "--map", "input=2", "--map", "output=3")
    parts = ("--fit", 1, "--check", 2, "--workers", 1)
    assert answered(tmp_path, "gap", "diagnose", tmp_path / "session.h5", *parts)["verdict"] == "no_gap"


def test_05_channels_of_lvm_keep_units_and_times(tmp_path: Path) -> None:
    names = ("--map", "force=Load cell", "--map", "position=LVDT")
    position = imported(tmp_path, case(5) / "multi.lvm", *names).signals["position"]
    assert (position.min(), position.max()) == (pytest.approx(0.003, abs=1e-4), pytest.approx(0.027, abs=1e-4))
    for name in ("rates.lvm", "twotriggers.lvm"):
        refused = ("import", case(5) / name, *FORCE, *POSITION, "--out", tmp_path / "refused.h5")
        assert run(*refused) == 2
        assert not (tmp_path / "refused.h5").exists()


@pytest.mark.parametrize(("name", "rate_hz"), [("minutes", 10.0), ("hours", 10.0), ("msecs", 20_000.0)])
def test_06_times_keep_their_unit(name: str, rate_hz: float, tmp_path: Path) -> None:
    maps = ("--map", "force=Load", "--map", "position=Extension")
    assert imported(tmp_path, case(6) / f"{name}.csv", *maps).sample_rate_hz == pytest.approx(rate_hz)


def test_07_thousands_are_asked_for(tmp_path: Path) -> None:
    maps = ("--map", "force=Load", "--map", "position=Travel", "--rate", 100)
    assert run("import", case(7) / "grouped.tsv", *maps, "--out", tmp_path / "refused.h5") == 2
    grouped = imported(tmp_path, case(7) / "grouped.tsv", *maps, "--decimal", "point").signals
    plain = imported(tmp_path, case(7) / "plain.tsv", *maps).signals
    np.testing.assert_allclose(grouped["force"], plain["force"])
    assert (plain["force"].min(), plain["force"].max()) == (pytest.approx(0.6, abs=0.01), pytest.approx(2.4, abs=0.01))


@pytest.mark.soak
@pytest.mark.timeout(600)
def test_08_kernels_of_a_white_input_are_complete(tmp_path: Path) -> None:
    answer = fitted(tmp_path, case(8) / "white.csv", "volterra", "--map", "input=2", "--map", "output=3")
    assert answer["vaf_validation_percent"] > 99.0


@pytest.mark.parametrize("late", [0, 1, 3])
def test_09_a_late_channel_is_no_mass(late: int, tmp_path: Path) -> None:
    answer = fitted(tmp_path, case(9) / f"late{late}.csv", "lms", *FORCE, *POSITION)
    assert answer["parameters"]["mass_kg"]["value"] == pytest.approx(0.09, rel=0.01)


def test_10_the_band_takes_a_decimal_comma(qtbot: Any) -> None:
    from tissueid.app.number_field import NumberField
    from tissueid.app.views.researcher.engine_form import PreparationForm

    default = QLocale()
    QLocale.setDefault(QLocale.c())
    try:
        form = PreparationForm()
        qtbot.addWidget(form)
        form.show()
        edges = form.findChildren(NumberField)
        for edge in edges:
            for typed, value in (("0,5", 0.5), ("12,5", 12.5), ("12.5", 12.5)):
                edge.setFocus()
                edge.selectAll()
                QTest.keyClicks(edge, typed)
                QTest.keyClick(edge, Qt.Key.Key_Return)
                assert edge.value() == pytest.approx(value)
    finally:
        QLocale.setDefault(default)
    assert len(edges) == 2


def test_11_units_of_a_header_are_not_replaced(tmp_path: Path) -> None:
    folder, out = case(11), ("--out", tmp_path / "refused.h5")
    assert run("import", folder / "header.csv", *out, "--map", "force=2:N", "--map", "position=3:mm") == 2
    assert run("import", folder / "name.csv", *out, "--map", "input=y_m", "--map", "output=V_C") == 2
    signals = imported(tmp_path, folder / "header.csv", *FORCE, *POSITION).signals
    assert signals["force"][0] == pytest.approx(15.0 * 4.4482, rel=1e-4)
    assert signals["position"][0] == pytest.approx(7.0 * 25.4e-6)
    imported(tmp_path, folder / "machine.csv", "--map", "force=Load", "--map", "position=Extension")
    maps = ("--map", "force=Ch 1 Force", "--map", "position=Ch 1 Displacement", "--map", "time=Running Time")
    assert imported(tmp_path, folder / "torque.txt", *maps).signals["force"][0] == pytest.approx(15.0)


def test_12_a_session_that_is_open_elsewhere_is_not_damaged(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    imported(tmp_path, case(9) / "late0.csv", *FORCE, *POSITION)
    session = tmp_path / "session.h5"
    capsys.readouterr()
    with h5py.File(session, "r+"):
        assert run("identify", session, "--engine", "lms") == 2
        assert shows(capsys.readouterr().err, "session.open_elsewhere")
    assert run("identify", session, "--engine", "lms") == 0


def test_13_a_negative_mass_is_warned_about(tmp_path: Path) -> None:
    answer = fitted(tmp_path, case(13) / "minus.csv", "viscoelastic", *FORCE, *POSITION)
    assert str(NEGATIVE_MASS) in answer["warnings"]


@pytest.mark.parametrize(("name", "rate_hz"), [("iso.csv", 100.0), ("last.csv", 10.0), ("notes.lvm", 100.0)])
def test_14_usual_variants_are_read(name: str, rate_hz: float, tmp_path: Path) -> None:
    assert imported(tmp_path, case(14) / name, *FORCE, *POSITION).sample_rate_hz == pytest.approx(rate_hz)


@pytest.mark.soak
@pytest.mark.timeout(600)
def test_15_a_held_input_is_recognised(tmp_path: Path) -> None:
    record = made(15, tmp_path) / "white.csv"
    answer = fitted(tmp_path, record, "spectral", "--map", "input=2", "--map", "output=3")
    found = answer["parameters"]
    assert found["natural_frequency_rad_per_s"]["value"] / (2 * np.pi) == pytest.approx(60.0, abs=0.006)
    assert found["damping_ratio"]["value"] == pytest.approx(0.2, abs=0.0006)


@pytest.mark.soak
@pytest.mark.timeout(600)
def test_16_one_engine_does_not_end_a_comparison() -> None:
    rng = np.random.default_rng(1)
    u = 5.0 + 2.0 * rng.standard_normal(8000)
    y = np.zeros_like(u)
    for k in range(2, y.size):
        y[k] = 2e-5 * (u[k] - 5.0) + 1.9 * y[k - 1] - 0.92 * y[k - 2]
    record = tissueid.Record(u, 0.01 + y + 1e-6 * rng.standard_normal(8000), 2000.0)
    found = tissueid.compare(record, ["lms", "depth"])
    assert {entry.engine for entry in found.entries} == {"lms", "depth"}
