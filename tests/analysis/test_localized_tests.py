"""A localized test in one go: recognised, held out at every level, fitted by default, and compared with the plant."""

import numpy as np
import pytest
from coded import says
from plant_support import PRELOAD, VOLTS_PER_NEWTON, bench_record

from firmware_sim.bench import Bench
from firmware_sim.local_values import local_values
from firmware_sim.plant import SAMPLE_RATE_HZ
from tissueid.analysis import engines_of, fit_split, split_records
from tissueid.analysis.curves.results import plots_of_test
from tissueid.identification import get_engine, report_engines
from tissueid.identification.depth_levels import localized_levels
from tissueid.records import Record, joined
from tissueid.reports.verdict import key_numbers, linear_engine
from tissueid.sessions import Test
from tissueid.stimuli.kinds.noise import SteppedNoise
from tissueid.stimuli.kinds.quasi_static import StepHold

PRESET = "left-posterior-forearm"
LEVELS = 4
WAYS = [0, 1, 1, 1, -1, -1, -1]


def recorded(values: np.ndarray, preset: str = PRESET) -> Record:
    """Force and position of a preset under a force (n,), N, without the preload."""
    bench = Bench(preset, seed=1)
    force = np.concatenate([np.full(PRELOAD, values[0]), values])
    codes = bench.block(force * VOLTS_PER_NEWTON, energised=True).codes[PRELOAD:]
    decoded = {c.name: c.decode(codes[:, k]) for k, c in enumerate(bench.channels)}
    return Record(3.0 * decoded["current"], decoded["position"], SAMPLE_RATE_HZ)


@pytest.fixture(scope="module")
def stepped() -> Record:
    return recorded(SteppedNoise(levels=LEVELS, level_s=1.0, seed=1).build().values)


@pytest.fixture(scope="module")
def analysis(stepped):
    return fit_split(get_engine("localized")(), split_records([stepped]))


def test_the_report_of_a_localized_test_has_its_engine(stepped):
    assert [one.direction for one in localized_levels(stepped)] == WAYS
    assert report_engines(stepped) == (*report_engines(), "localized")


@pytest.mark.parametrize("distribution", ["gaussian", "uniform", "small"])
def test_other_tests_are_no_localized_tests(distribution):
    assert report_engines(bench_record(PRESET, distribution)) == report_engines()


def test_bare_steps_are_no_localized_test():
    bare = recorded(StepHold(force_min_n=0.5, force_max_n=8.5).build().values)
    assert localized_levels(bare) == ()


def test_a_quarter_of_every_level_is_held_out(stepped, analysis):
    parts = split_records([stepped])
    hidden = np.isnan(parts.record.output)
    assert hidden.mean() == pytest.approx(0.25, abs=0.001)
    for level in localized_levels(stepped):
        assert hidden[level.first : level.end].mean() == pytest.approx(0.25, abs=0.001)
    assert np.array_equal(np.isnan(parts.held_out_record.output), ~hidden)
    assert says(parts.validated_on, "split.part_of_levels", number=1)
    first = parts.other_quarters[0].record
    assert np.isnan(first.output[:100]).all()
    # Outputs that are held out on purpose are not reported as lost.
    assert analysis.model.report.warnings == ()
    assert len(parts.record[2000:4000].withheld) == 2
    assert joined([stepped, parts.record]).withheld[0] == tuple(len(stepped) + 1 + n for n in parts.record.withheld[0])


def test_each_level_is_linear_and_is_that_of_the_plant(analysis):
    levels = analysis.model.levels
    assert [one.level.direction for one in levels] == WAYS
    assert min(one.fit.vaf_percent for one in levels) > 95.0  # thesis 3.4: over 90 %
    assert analysis.model.report.vaf_validation_percent > 99.0
    for one in levels:
        truth, system = local_values(PRESET, one.position), one.fit.system
        assert system.mass == pytest.approx(truth["mass_kg"], rel=0.05)
        assert system.damping == pytest.approx(truth["damping_n_s_per_m"], rel=0.08)
        assert system.stiffness == pytest.approx(truth["stiffness_n_per_m"], rel=0.05)


def test_the_result_shows_the_levels(analysis):
    analyses = {"localized": analysis}
    assert linear_engine(analyses) == "localized"
    stiffness = next(number for number in key_numbers(analyses) if number.unit.startswith("N/m"))
    assert "to" in stiffness.note
    plots = plots_of_test(analyses, "localized")
    assert len(plots.impulse.curves) == len(plots.magnitude.curves) == len(WAYS)
    assert not plots.nonlinearity.missing
    assert not plots.prediction.missing


def test_direction_outlasts_lost_samples(stepped):
    """Lost samples within a level keep its direction; over a step, they hide it, but not its direction."""
    levels = localized_levels(stepped)
    force, position = stepped.input.copy(), stepped.output.copy()
    for at in (levels[2].first + 1000, levels[5].first):
        force[at - 10 : at + 10] = position[at - 10 : at + 10] = np.nan
    found = localized_levels(Record(force, position, stepped.sample_rate_hz))
    assert [one.direction for one in found] == [0, 1, 1, 1, 1, -1, -1, -1]


def test_a_test_without_a_record_has_the_usual_engines():
    signals = {"force": np.zeros(100), "position": np.zeros(100)}
    stopped = Test(number=1, kind="stochastic", signals=signals, sample_rate_hz=2000.0, preload_s=0.5)
    assert engines_of(stopped) == report_engines()
