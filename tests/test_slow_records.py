"""Ramps, holds and drift of other instruments: what is credited to the input, and what is compared."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from coded import codes
from reports.synthetic_sitting import make_session
from scipy import signal

from tissueid.analysis import analyse
from tissueid.analysis.comparison import compare, specifications
from tissueid.analysis.fitting import engines_of
from tissueid.analysis.overlay import NamedFit, TestSource, overlay, repeated_values
from tissueid.analysis.split import split, split_records
from tissueid.errors import UnusableInputError
from tissueid.identification import engine_names, get_engine
from tissueid.identification.base import NEGATIVE_MASS
from tissueid.identification.ramp_stiffness import is_slow, ramp_stiffness
from tissueid.identification.validation import validated
from tissueid.identification.validation.scores import above_noise
from tissueid.messages import code_of
from tissueid.procedures.control import Control
from tissueid.procedures.study_plans import SUBJECTS_FILE, StudyPlan
from tissueid.procedures.study_run import run_study
from tissueid.records import Record
from tissueid.reports.verdict import judge
from tissueid.sessions import Session, Subject, Test, write_session
from tissueid.studies import repeatability
from tissueid.studies.study_statistics import study_statistics
from tissueid.studies.usable_tests import usable_tests

RATE = 50.0


def record_of(force: np.ndarray, position: np.ndarray, rate: float = RATE) -> Record:
    return Record(force, position, rate, "force", "position", "N", "m")


def held(
    seed: int,
    stiffness: float = 400.0,
    spring: float = 200.0,
    time_s: float = 1.0,
    seconds: float = 20.0,
    ramp_s: float = 1.0,
) -> Test:
    """A ramp of 2 mm and a hold of a standard linear solid (cases 01 and 03)."""
    rng = np.random.default_rng(seed)
    n = round(seconds * RATE)
    t = np.arange(n) / RATE
    x = 2e-3 * np.clip((t - 1.0) / ramp_s, 0.0, 1.0)
    decay = np.exp(-1.0 / (RATE * time_s))
    branch = signal.lfilter([spring * time_s * (1.0 - decay)], [1.0, -decay], np.diff(x, prepend=0.0) * RATE)
    force = stiffness * x + branch + 0.002 * rng.standard_normal(n)
    signals = {"time": t, "force": force, "position": 0.01 + x + 5e-7 * rng.standard_normal(n)}
    return Test(1, "slow_ramp", signals, RATE, site="pad")


def session_of(*tests: Test) -> Session:
    return make_session(*tests)


def test_a_ramp_and_hold_is_scored_where_it_varies():
    session = session_of(held(4))
    assert engines_of(session.tests[0]) == ("viscoelastic",)
    analysis = analyse(session, "viscoelastic")
    report = analysis.model.report
    assert code_of(analysis.validated_on) == "split.part_of_stretches"
    assert not report.predicts_nothing
    assert report.vaf_validation_percent > 99.0
    assert report.model == "standard-linear-solid"
    for name, true in {"stiffness_n_per_m": 400.0, "spring_1_n_per_m": 200.0, "relaxation_time_s": 1.0}.items():
        found = report.reportable_parameters[name]
        assert found.value == pytest.approx(true, rel=0.04)
        assert found.std < 0.03 * true
    verdict = judge(session.tests[0], {"viscoelastic": analysis})
    assert not {"verdict.vaf_poor", "verdict.predicts_nothing", "verdict.uncertain"} & set(codes(verdict.reasons))
    every_quarter = split(session).other_quarters
    assert len(every_quarter) == 3
    assert all(quarter.scorable for quarter in every_quarter)


def test_a_slow_relaxation_is_no_mass():
    report = analyse(session_of(held(4, time_s=4.0, seconds=30.0, ramp_s=2.0)), "viscoelastic").model.report
    assert report.model == "standard-linear-solid"
    assert "mass_kg" not in report.reportable_parameters
    assert report.parameters["relaxation_time_s"].value == pytest.approx(4.0, rel=0.04)


def test_a_hold_alone_gives_no_score():
    ramp = held(4)
    hold = replace(held(5), number=2)
    hold.signals["position"] = 0.012 + 5e-7 * np.random.default_rng(1).standard_normal(hold.samples)
    session = session_of(ramp, hold)
    report = analyse(session, "viscoelastic", test=1, validate=2).model.report
    assert report.vaf_validation_percent is None
    assert report.reportable_parameters
    assert "engine.nothing_to_predict" in codes(report.warnings)
    with pytest.raises(UnusableInputError) as refused:
        compare(specifications(["lms"]), split(session, test=1, validate=2))
    assert refused.value.code == "compare.nothing_to_predict"


def test_what_varies_above_its_noise():
    rng = np.random.default_rng(2)
    noise, slow = rng.standard_normal(1000), np.sin(np.arange(1000) / 30.0)
    assert above_noise(slow)
    assert not above_noise(noise)
    assert not above_noise(np.ones(9))
    assert above_noise(noise, noise)
    assert above_noise(0.02 * slow, slow)
    assert not above_noise(0.02 * noise, slow)
    assert not above_noise(1e-3 * slow, slow)


def drifting(n: int = 1200) -> Record:
    """A stage at constant speed, and a force that has nothing to do with it (case 02)."""
    rng = np.random.default_rng(1)
    return record_of(0.5 + 0.05 * rng.standard_normal(n), 1e-4 * np.arange(n) / 100.0, 100.0)


_QUICK = {"cascade": {"structure": "wiener"}}


@pytest.mark.parametrize("name", [name for name in engine_names() if name != "localized"])
def test_drift_is_not_credited_to_an_unrelated_force(name: str):
    parts = split_records([drifting()])
    try:
        model = get_engine(name).from_options(_QUICK.get(name, {})).fit(parts.record, parts.fit_part)
    except UnusableInputError:
        return
    report = validated(model, parts.held_out_record, parts.held_out).report
    assert report.predicts_nothing or report.vaf_validation_percent < 1.0  # one in twenty is significant by chance


@pytest.mark.parametrize("structure", ["maxwell", "burger"])
def test_no_structure_is_credited_with_drift(structure: str):
    record = drifting()
    model = get_engine("viscoelastic").from_options({"structure": structure}).fit(record, slice(0, 900))
    report = validated(model, record, slice(900, None)).report
    assert report.vaf_percent < 1.0
    assert report.predicts_nothing


def test_no_engine_is_recommended_for_drift():
    found = compare(specifications(["lms", "viscoelastic"]), split_records([drifting(500)])).recommendation
    assert code_of(found.headline) == "recommendation.none"
    assert found.standings[0].vaf_percent < 5.0


@pytest.fixture(scope="module")
def reversed_record() -> Record:
    """90 g, 20 N s/m and 4000 N/m with compression as a negative force (case 13)."""
    rng = np.random.default_rng(3)
    n, fine = 1600, 4
    low_pass = signal.butter(6, 150.0, fs=2000.0 * fine, output="sos")
    force = signal.sosfilt(low_pass, rng.standard_normal((n + 500) * fine))
    force *= 1.5 / force.std()
    position = signal.lsim(([1 / 0.09], [1.0, 20 / 0.09, 4000 / 0.09]), force, np.arange(force.size) / (2000.0 * fine))
    kept = slice(500 * fine, None, fine)
    return record_of(-4.0 - force[kept], 1e-2 + position[1][kept] + 2e-6 * rng.standard_normal(n), 2000.0)


@pytest.mark.parametrize("name", [name for name in engine_names() if name != "localized"])
def test_every_engine_warns_about_a_negative_mass(name: str, reversed_record: Record):
    specification = get_engine(name).from_options(_QUICK.get(name, {}))
    if name == "dpn":
        with pytest.raises(UnusableInputError) as refused:
            specification.fit(reversed_record)
        assert refused.value.code == "dpn.falling"
        return
    report = specification.fit(reversed_record).report
    assert report.parameters["mass_kg"].value < 0.0
    assert "engine.negative_mass" in codes(report.warnings)


TIMES_S = {"A": 1.0, "B": 0.48}
SPRINGS = {"A": 200.0, "B": 304.0}


@pytest.fixture(scope="module")
def groups(tmp_path_factory, reversed_record: Record):
    """Three subjects of each of two groups, and one whose force has the other sign (cases 01 and 13)."""
    folder = tmp_path_factory.mktemp("slow") / "study"
    folder.mkdir()
    lines = ["subject,group"]
    for who in range(6):
        group, size = "AB"[who % 2], 1.0 + 0.03 * ((who // 2) - 1.0)
        test = held(who, 400.0 * size, SPRINGS[group] * size, TIMES_S[group] * size, seconds=10.0)
        made = replace(session_of(test), subject=Subject(f"{group}{who}"), session_id=str(who))
        write_session(folder / f"{who}.h5", made)
        lines.append(f"{group}{who},{group}")
    signals = {"force": reversed_record.input, "position": reversed_record.output}
    signals["time"] = np.arange(len(reversed_record)) / 2000.0
    made = replace(session_of(Test(1, "stochastic", signals, 2000.0, site="pad")), subject=Subject("C"))
    write_session(folder / "reversed.h5", made)
    (folder / SUBJECTS_FILE).write_text("\n".join(lines))
    return run_study(StudyPlan(folder=folder, engine="viscoelastic", workers=1), Control()).table


def test_a_study_has_one_structure_and_the_true_differences(groups, monkeypatch):
    monkeypatch.setattr(repeatability, "RESAMPLES", 20)
    assert set(groups["model"].dropna()) == {"standard-linear-solid"}
    found = study_statistics(groups, factors=["group"])
    assert "mass_kg" not in found.parameters
    rows = found.tables["groups"].set_index("parameter")
    for name, true in {"relaxation_time_s": -0.52, "spring_1_n_per_m": 104.0}.items():
        assert rows.loc[name, "difference"] == pytest.approx(true, rel=0.08)
        assert rows.loc[name, "low"] < true < rows.loc[name, "high"]
    assert {"loading_stiffness_n_per_m", "stiffness_n_per_m"} <= set(found.parameters)


def test_a_negative_mass_is_in_the_table_and_does_not_count(groups):
    row = groups[groups["subject"] == "C"].iloc[0]
    assert (row["status"], row["problem"]) == ("not analysed", str(NEGATIVE_MASS))
    left_out = usable_tests(groups).left_out
    assert list(left_out["subject"]) == ["C"]


@pytest.mark.parametrize("column", ["model", "engine", "signals", "configuration"])
def test_tests_with_other_parameters_are_not_compared(groups, column: str):
    mixed = groups[groups["subject"] != "C"].copy()
    mixed.loc[mixed.index[:2], column] = "other"
    found = usable_tests(mixed)
    assert len(found.used) == len(mixed) - 2
    assert [reason.code for reason in found.left_out["reason"]] == [f"study.reason.{column}"] * 2
    assert "study.not_comparable" in codes(found.remarks)


def test_repeats_of_different_structures_are_not_averaged():
    tests = [replace(held(seed, seconds=8.0), number=number) for number, seed in ((1, 0), (2, 1))]
    session = session_of(*tests)
    fit = NamedFit("fit", get_engine("viscoelastic").from_options({"structure": "standard-linear-solid"}))
    found = overlay([TestSource("pad", session, (number,), ()) for number in (1, 2)], [fit])
    pooled = {value.fit for value in repeated_values(found)}
    assert pooled == {"fit"}
    first, second = found.entries
    other = replace(second.analysis, model=second.analysis.model.with_report(model="burger"))
    values = repeated_values(replace(found, entries=(first, replace(second, analysis=other))))
    assert {value.fit for value in values} == {"fit (standard-linear-solid)", "fit (burger)"}
    assert {value.count for value in values} == {1}


def triangle(n: int, cycles: int) -> np.ndarray:
    return 2e-3 * (1.0 - np.abs(2.0 * ((np.arange(n) / n * cycles) % 1.0) - 1.0))


def test_slopes_of_loading_and_unloading():
    rng = np.random.default_rng(4)
    x = triangle(1000, 2)
    rising = np.gradient(x) > 0.0
    force = np.where(rising, 500.0 * x, 400.0 * x + 0.1)
    found = ramp_stiffness(record_of(force + 0.003 * rng.standard_normal(x.size), x))
    assert found["loading_stiffness_n_per_m"].value == pytest.approx(500.0, rel=0.005)
    assert found["unloading_stiffness_n_per_m"].value == pytest.approx(400.0, rel=0.005)


@pytest.mark.parametrize("colour", [0.0, 0.9])
def test_intervals_of_slopes_hold_for_coloured_noise(colour: float):
    rng = np.random.default_rng(5)
    x = triangle(1600, 1)
    inside = []
    for _ in range(40):
        noise = signal.lfilter([1.0], [1.0, -colour], 0.005 * rng.standard_normal(x.size))
        found = ramp_stiffness(record_of(500.0 * x + noise, x))["loading_stiffness_n_per_m"]
        inside.append(abs(found.value - 500.0) < 1.96 * found.std)
    assert np.mean(inside) >= 0.85


def test_noise_after_a_rest_is_not_slow():
    rng = np.random.default_rng(7)
    noise = signal.sosfilt(signal.butter(4, 200.0, fs=2000.0, output="sos"), rng.standard_normal(4000))
    assert not is_slow(np.concatenate([np.zeros(1000), noise]))
    assert is_slow(triangle(1000, 5))
    assert is_slow(held(1).signals["force"])


def test_noise_has_no_ramps():
    rng = np.random.default_rng(6)
    force = rng.standard_normal(2000)
    assert ramp_stiffness(record_of(force, 1e-6 * np.cumsum(force))) == {}
    assert ramp_stiffness(record_of(force, 1e-4 * force)) == {}
