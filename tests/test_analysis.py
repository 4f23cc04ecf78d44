"""From saved tests to models: what is fitted, what is held out, and figures that can be compared."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import ClassVar

import numpy as np
import pytest
from coded import coded, says
from identification import simulated
from reports.synthetic_sitting import make_session, make_test
from scipy import signal

from tissueid.analysis import (
    analyse,
    compare,
    known_ceiling,
    repeats,
    specifications,
    split,
    split_records,
)
from tissueid.analysis.fitting import candidates, scored, timed_fit
from tissueid.errors import UnusableInputError
from tissueid.identification import Engine, Family, Model, aicc, engine_names, vaf_percent
from tissueid.identification.engines.lms import Lms
from tissueid.identification.engines.wiener import Wiener
from tissueid.messages import code_of
from tissueid.records import Record
from tissueid.sessions import Session

QUICK = ("lms", "spectral")


@pytest.fixture(scope="module")
def session() -> Session:
    repeat = make_test(3, seconds=2.5, repeat_of=1)
    repeat.signals["position"] += 1e-5 * simulated.generator(8).standard_normal(repeat.samples)
    return make_session(make_test(1, seconds=2.5), make_test(2, seconds=2.0, seed=5), repeat)


class TestSplit:
    def test_the_last_quarter_is_held_out(self, session: Session):
        parts = split(session)
        assert parts.tests == (1,)
        assert parts.held_out_record is parts.record
        assert (parts.fit_part, parts.held_out) == (slice(0, 1875), slice(1875, 2500))
        assert says(parts.validated_on, "split.part_of_test", which="last", percent=25.0, number=1)
        known = np.isfinite(parts.unseen.output)
        assert not known[:1875].any()
        assert known[1875:].all()
        np.testing.assert_array_equal(parts.unseen.input, parts.record.input)

    def test_another_test_is_held_out_whole(self, session: Session):
        parts = split(session, test=2, validate=1)
        assert (parts.tests, parts.validated, parts.validated_on) == ((2,), 1, "test 1")
        assert (len(parts.fitted), len(parts.unseen)) == (2000, 2500)
        assert parts.other_quarters == ()

    def test_of_several_tests_the_last_quarter_of_each(self, session: Session):
        parts = split(session, test=1, also=(2,))
        first, second = (session.test(number).record() for number in (1, 2))
        assert says(parts.validated_on, "split.part_of_tests", which="last", percent=25.0)
        assert str(parts.validated_on.values["numbers"]) == "1 and 2"
        np.testing.assert_array_equal(
            parts.fitted.output, np.concatenate([first.output[:1875], [np.nan], second.output[:1500]])
        )
        np.testing.assert_array_equal(parts.unseen.input, np.concatenate([first.input, [np.nan], second.input]))
        hidden = np.full(1, np.nan)
        expected = [np.full(1875, np.nan), first.output[1875:], hidden, np.full(1500, np.nan), second.output[1500:]]
        np.testing.assert_array_equal(parts.unseen.output, np.concatenate(expected))

    def test_every_quarter_is_held_out_once_and_never_fitted_with_itself(self, session: Session):
        for also in ((), (2,)):
            parts = split(session, test=1, also=also)
            quarters = (parts, *parts.other_quarters)
            known = np.array([np.isfinite(quarter.unseen.output) for quarter in quarters])
            received = np.isfinite(parts.held_out_record.input)
            np.testing.assert_array_equal(known.sum(axis=0), received)
            for quarter in quarters:
                held_out = quarter.unseen.output[np.isfinite(quarter.unseen.output)]
                assert not np.isin(held_out, quarter.fitted.output).any()
                assert np.isfinite(quarter.fitted.output).sum() + held_out.size == received.sum()

    @pytest.mark.parametrize(
        ("choice", "code", "values"),
        [
            (dict(also=(1,)), "split.repeated_test", {"number": 1}),
            (dict(test=2, also=(1,), validate=1), "split.validates_fitted_test", {"number": 1}),
            (dict(input_name="position"), "split.same_signal", {"signal": "position"}),
        ],
    )
    def test_what_cannot_be_split_is_refused(self, session: Session, choice: dict, code: str, values: dict):
        with pytest.raises(UnusableInputError, check=coded(code, **values)):
            split(session, **choice)

    @pytest.mark.parametrize(
        ("choice", "code", "value"),
        [
            (dict(test=9), "session.no_test", {"number": 9}),
            (dict(also=(9,)), "session.no_test", {"number": 9}),
            (dict(output_name="torque"), "session.no_signal", {"signal": "torque"}),
        ],
    )
    def test_missing_tests_and_signals_are_refused(self, session: Session, choice: dict, code: str, value: dict):
        with pytest.raises(UnusableInputError, check=coded(code, **value)):
            split(session, **choice)

    def test_tests_at_different_rates_are_not_fitted_together(self, session: Session):
        slow = replace(make_test(4), sample_rate_hz=500.0)
        with pytest.raises(UnusableInputError, check=coded("record.rates_differ", first=1000.0, other=500.0)):
            split(replace(session, tests=(*session.tests, slow)), also=(4,))


class TestAnalyse:
    def test_several_tests_give_one_fit_nearer_to_the_truth(self):
        truth = dict(mass=0.09, damping=20.0, stiffness=4000.0)
        records = [simulated.linear_record(seed, snr_db=10.0, n=2000, **truth) for seed in range(6)]
        one, six = (Lms().fit(split_records(some).fitted).report for some in (records[:1], records))
        for name, value in zip(("mass_kg", "damping_n_s_per_m", "stiffness_n_per_m"), truth.values(), strict=True):
            found = six.parameters[name]
            assert found.std is not None
            assert abs(found.value - value) < 4.0 * found.std
            assert found.std < one.parameters[name].std

    def test_held_out_parts_of_several_tests_are_pooled(self, session: Session):
        analysis = analyse(session, "lms", test=1, also=(2,))
        assert (analysis.test, analysis.tests) == (1, (1, 2))
        measured, simulated_output = [], []
        for number, cut in ((1, 1875), (2, 1500)):
            record = session.test(number).record()
            measured.append(record.output[cut:])
            simulated_output.append(analysis.model.simulate(record.input)[cut:])
        pooled = vaf_percent(np.concatenate(measured), np.concatenate(simulated_output))
        assert analysis.model.report.vaf_validation_percent == pytest.approx(pooled, abs=1e-9)

    def test_compiling_is_not_counted(self):
        from numba import njit

        class Slow(Engine):
            name = "slow"

            def fit(self, record: Record, fit_part: slice | None = None) -> Model:
                total = njit(lambda x: x.sum() + x.mean())(record.input)
                assert np.isfinite(total)
                return Lms().fit(record, fit_part)

        record = simulated.linear_record(1)[:2000]
        begin = time.perf_counter()
        _, seconds = timed_fit(Slow(), record, None)
        assert seconds < 0.5 * (time.perf_counter() - begin)


class TestScores:
    def test_all_engines_are_scored_on_the_samples_that_they_share(self, session: Session):
        found = compare((Lms(memory=0.02), Wiener(memory=0.1)), split(session))
        rows = [entry.scored for entry in found.entries]
        assert [row.n_fitted for row in rows] == [1875 - 99] * 2
        short = rows[0].analysis
        own = Lms(memory=0.02).fit(short.record, short.fit_part)
        residual = own.residuals(short.record)[99:1875]
        assert short.model.report.aicc == pytest.approx(aicc(residual, 21), rel=1e-9)
        assert short.model.report.vaf_percent == pytest.approx(
            vaf_percent(short.record.output[99:1875], short.record.output[99:1875] - residual), rel=1e-9
        )

    def test_the_second_order_system_is_scored_on_the_same_samples(self, session: Session):
        parts = split(session)
        found = compare((Lms(memory=0.02), Wiener(memory=0.1)), parts)
        rows = [entry.scored for entry in found.entries]
        row, model = rows[0], rows[0].analysis.model
        reduced = candidates(rows, (Family.LINEAR, Family.STATIC), parts)[-1]
        force = parts.record.input - model.input_mean
        residual = parts.record.output - model.output_mean - model.second_order.simulate(force)
        assert reduced.second_order
        assert reduced.aicc == pytest.approx(aicc(residual[np.isfinite(row.residual)], 4), rel=1e-9)

    def test_one_that_needs_most_of_the_record_does_not_cost_the_others_their_samples(self, session: Session):
        found = compare((Lms(memory=0.02), Lms.model_construct(**Lms(memory=0.02).options())), split(session))
        parts = split(session)
        analyses = [entry.scored.analysis for entry in found.entries]
        greedy = replace(analyses[1], model=replace(analyses[1].model, memory_samples=1800))
        rows = scored([analyses[0], greedy], parts)
        assert [row.own_samples for row in rows] == [False, True]
        assert [row.n_fitted for row in rows] == [1875 - 19, 76]
        assert candidates(rows, (Family.LINEAR, Family.LINEAR), parts)[1].aicc is None

    def test_effective_parameters_count_where_an_engine_reports_them(self, session: Session):
        parts = split(session)
        analysis = analyse(session, "lms")
        report = analysis.model.report
        held_back = replace(
            analysis.model, report=replace(report, details=report.details | {"effective_parameters": 9.5})
        )
        full, few = scored([analysis, replace(analysis, model=held_back)], parts)
        assert (full.parameters, few.parameters) == (report.n_parameters, 9.5)
        assert few.analysis.model.report.aicc < full.analysis.model.report.aicc


class TestCompare:
    def test_every_engine_gets_a_row(self, session: Session):
        found = compare(specifications(QUICK), split(session))
        assert [entry.engine for entry in found.entries] == list(QUICK)
        assert list(found.analyses) == list(QUICK)
        assert found.memory_sweep == ()
        assert found.recommendation.engine in QUICK
        assert [choice.option for choice in found.recommendation.choices] == ["memory"]
        for analysis in found.analyses.values():
            assert analysis.model.report.seconds > 0

    def test_one_that_refuses_gets_its_reason(self, session: Session):
        specified = specifications(("lms", "spectral"), own={"spectral": {"window": 0.05}})
        entries = compare(specified, split(session)).entries
        assert entries[0].refused is None
        assert entries[1].scored is None
        assert code_of(entries[1].refused) == "spectral.window_shorter_than_memory"

    def test_when_all_refuse_there_is_nothing_to_compare(self, session: Session):
        with pytest.raises(UnusableInputError, check=coded("record.shorter_than_memory", memory=9.0)):
            compare(specifications(QUICK, {"memory": 9.0}, {"spectral": {"window": 10.0}}), split(session))
        with pytest.raises(UnusableInputError, check=coded("compare.all_refused", engines=2)):
            compare(specifications(QUICK, {}, {"lms": {"memory": 9.0}, "spectral": {"window": 0.05}}), split(session))

    def test_progress_is_reported_engine_by_engine(self, session: Session):
        steps: list[tuple[str, float]] = []
        compare(specifications(QUICK), split(session), progress=lambda what, share: steps.append((what, share)))
        for name in QUICK:
            assert steps.index((name, 0.0)) < steps.index((name, 1.0))
        assert all(0.0 <= share <= 1.0 for _, share in steps)

    def test_scores_against_memory(self, session: Session):
        found = compare((Lms(), Lms.from_options({})), split(session), sweep=False)
        assert found.memory_sweep == ()
        rows = compare((Lms(),), split(session), sweep=True).memory_sweep
        assert len(rows) > 4
        assert all(row.refused is None for row in rows)
        scores = [row.analysis.model.report.vaf_percent for row in rows]
        assert scores[0] < scores[-1] - 5.0  # 10 ms are too few for a system that rings for 30
        assert [row.parameters for row in rows] == [round(row.memory * 1000) + 1 for row in rows]

    def test_all_that_are_installed_are_compared_by_default(self):
        assert tuple(engine.name for engine in specifications()) == engine_names()

    def test_every_engine_of_ours_says_of_what_family_it_is(self):
        ours = [e for e in specifications() if type(e).__module__.startswith("tissueid.")]
        assert not [e.name for e in ours if e.family is Family.OTHER]

    @pytest.mark.parametrize(
        ("arguments", "code", "values"),
        [
            (([],), "compare.no_engine", {}),
            ((["magic"],), "registry.unknown_name", {"name": "magic"}),
            ((["lms", "lms"],), "compare.repeated_engine", {}),
            ((["lms"], {"colour": 1}), "compare.no_such_option", {"option": "colour"}),
            ((["lms"], {}, {"wiener": {"degree": 3}}), "compare.options_of_other_engine", {"name": "wiener"}),
            ((["lms"], {}, {"lms": {"memory": -1}}), "option.refused", {"option": "memory"}),
        ],
    )
    def test_engines_that_cannot_be_compared_are_refused(self, arguments: tuple, code: str, values: dict):
        with pytest.raises(UnusableInputError, check=coded(code, **values)):
            specifications(*arguments)


class TestCeiling:
    def test_repeats_are_found_from_either_end(self, session: Session):
        assert [test.number for test in repeats(session, 1)] == [1, 3]
        assert [test.number for test in repeats(session, 3)] == [3, 1]
        assert [test.number for test in repeats(session, 2)] == [2]

    def test_repeats_say_how_much_there_is_to_be_explained(self, session: Session):
        for choice in (dict(test=1), dict(test=1, also=(3,)), dict(test=2, validate=1)):
            found = known_ceiling(session, split(session, **choice))
            assert found is not None
            assert 99.0 < found.vaf_percent.value < 100.0

    def test_a_repeat_that_broke_off_is_left_out_and_said(self, session: Session):
        whole, _, repeat = session.tests
        cut = {name: values[:1200] for name, values in repeat.signals.items()}
        short = replace(repeat, number=4, status="aborted", signals=cut)
        none = replace(repeat, number=5, status="aborted", signals=cut, preload_s=2.0)
        lost = {name: values.copy() for name, values in repeat.signals.items()}
        lost["position"][1000:] = np.nan
        gappy = replace(repeat, number=6, signals=lost)
        together = replace(session, tests=(*session.tests, short, none, gappy))
        alone = known_ceiling(session, split(session))
        found = known_ceiling(together, split(together))
        assert alone is not None
        assert found is not None
        assert found.vaf_percent == alone.vaf_percent
        assert found.repeats == 2
        reasons = [(text.values["number"], text.values["reason"].code) for text in found.left_out]
        assert reasons == [(4, "ceiling.ended_early"), (5, "ceiling.ended_in_preload"), (6, "ceiling.incomplete")]
        only = replace(session, tests=(whole, short))
        with pytest.raises(UnusableInputError, check=coded("ceiling.no_repeat")) as refused:
            known_ceiling(only, split(only))
        assert [text.values["number"] for text in refused.value.message.values["left_out"].items] == [4]

    def test_without_repeats_nothing_is_known(self, session: Session):
        assert known_ceiling(session, split(session, test=2)) is None
        assert known_ceiling(session, split(session, test=1, also=(2,))) is None


class Faulty(Engine):
    """An engine of another package that fails."""

    name: ClassVar[str] = "faulty"
    fault: str = "raises"

    def fit(self, record: Record, fit_part: slice | None = None) -> Model:
        if self.fault == "raises":
            raise TypeError("a fault of its own\nover two lines")
        return None  # type: ignore[return-value]


@pytest.mark.parametrize(
    ("fault", "problem"),
    [("raises", "TypeError: a fault of its own"), ("nothing", "TypeError: fit returned NoneType, not a model")],
)
def test_a_fault_in_an_engine_of_another_package_affects_no_other(fault: str, problem: str):
    record = simulated.linear_record(1, n=3000)
    found = compare((*specifications(["lms"]), Faulty(fault=fault)), split_records([record]))
    assert set(found.analyses) == {"lms"}
    refused = found.entries[1].refused
    assert refused is not None
    assert says(refused, "engine.failed", name="faulty", problem=problem)


def test_a_fault_in_an_engine_of_ours_is_a_defect(monkeypatch: pytest.MonkeyPatch):
    def fail(*_: object, **__: object) -> Model:
        raise TypeError("ours")

    monkeypatch.setattr(Lms, "fit", fail)
    with pytest.raises(TypeError, match="ours"):
        compare(specifications(["lms"]), split_records([simulated.linear_record(1, n=3000)]))


class TestKnownPlacement:
    """What the test knows about its placement is handed to the engine (Chen 2010, Fig. 3.8)."""

    WEIGHT = 0.06 * 9.80665

    def _session(self, **changes: object) -> Session:
        true = simulated.wiener_record(3)
        signals = {"force": true.input - self.WEIGHT, "position": true.output}
        notes = {"gravity_along_stroke_m_s2": 9.80665, "gravity_across_stroke_m_s2": 0.0}
        about = {"preload_s": 0.0, "sample_rate_hz": 2000.0, "surface_position_m": simulated.SURFACE, "notes": notes}
        return make_session(make_test(signals=signals, **about | changes))

    def test_the_surface_gives_c1_of_the_thesis(self):
        report = analyse(self._session(), "wiener").model.report
        assert report.parameters["c1_m"].value == pytest.approx(simulated.C1, rel=0.02)
        assert report.parameters["c3_n"].value == pytest.approx(self.WEIGHT, abs=0.1)
        assert report.details["known_surface_position_m"] == simulated.SURFACE
        assert report.options["surface_position_m"] is None

    def test_without_a_surface_the_weight_does(self):
        report = analyse(self._session(surface_position_m=float("nan")), "wiener").model.report
        assert report.parameters["c3_n"].value == report.details["known_c3_n"] == pytest.approx(self.WEIGHT)
        assert report.parameters["c1_m"].value == pytest.approx(simulated.C1, rel=0.05)

    def test_options_that_are_given_win(self):
        report = analyse(self._session(), "wiener", {"c3_n": 0.0}).model.report
        assert report.parameters["c3_n"].value == 0.0
        assert "known_surface_position_m" not in report.details
        assert report.parameters["c1_m"].value < 0.93 * simulated.C1

    def test_a_load_that_is_not_the_weight_is_reported(self):
        report = analyse(self._session(surface_position_m=simulated.SURFACE - 1e-3), "wiener").model.report
        assert "analysis.load_is_not_weight" in [code_of(text) for text in report.findings]


class TestTissueAlone:
    """Mass and damping of the actuator are subtracted on request (Chen 2010, 2.1)."""

    def _session(self, **calibration: float) -> Session:
        signals = {"force": simulated.linear_record(6).input, "position": simulated.linear_record(6).output}
        about = {"preload_s": 0.0, "sample_rate_hz": 2000.0}
        session = make_session(make_test(signals=signals, **about))
        return replace(session, instrument=replace(session.instrument, calibration=dict(calibration)))

    def test_it_is_beside_the_total(self):
        calibrated = {"moving_mass_kg_std": 0.004, "bearing_damping_n_s_per_m_std": 0.5}
        analysis = analyse(self._session(**calibrated), "lms", tissue_alone=True)
        parameters = analysis.model.report.parameters
        total, alone = parameters["mass_kg"], parameters["tissue_mass_kg"]
        assert total.value == pytest.approx(simulated.MASS, rel=0.01)
        assert alone.value == pytest.approx(total.value - 0.060)
        assert alone.std == pytest.approx(np.hypot(total.std, 0.004))
        assert parameters["tissue_damping_n_s_per_m"].value == pytest.approx(simulated.DAMPING - 3.5, rel=0.01)
        assert parameters["tissue_damping_n_s_per_m"].std == pytest.approx(0.5, rel=0.05)
        assert "tissue_stiffness_n_per_m" not in parameters
        assert code_of(analysis.model.report.findings[-1]) == "analysis.actuator_of_sweep"
        answer = analysis.as_answer()
        assert answer["actuator"] == {
            "mass_kg": {"value": 0.060, "std": 0.004},
            "damping_n_s_per_m": {"value": 3.5, "std": 0.5},
            "calibrated": True,
        }

    def test_without_a_sweep_the_nominal_actuator_is_uncertain(self):
        analysis = analyse(self._session(), "lms", tissue_alone=True)
        assert analysis.model.report.parameters["tissue_mass_kg"].std == pytest.approx(0.08 * 0.060, rel=0.05)
        assert code_of(analysis.model.report.findings[-1]) == "analysis.actuator_nominal"

    def test_profiles_have_it_too_and_nothing_changes_without_the_request(self):
        session = self._session()
        asked, plain = (analyse(session, "dpn", tissue_alone=on) for on in (True, False))
        rows, alone = (asked.as_answer()[name] for name in ("depth_profile", "tissue_depth_profile"))
        assert alone[3]["mass_kg"] == pytest.approx(rows[3]["mass_kg"] - 0.060)
        assert alone[3]["stiffness_n_per_m"] == rows[3]["stiffness_n_per_m"]
        assert "actuator" not in plain.as_answer()
        assert set(asked.model.report.parameters) - set(plain.model.report.parameters) == {
            "tissue_mass_kg",
            "tissue_damping_n_s_per_m",
        }


class TestVoltageInput:
    """Mass, damping and stiffness from the voltage, without the back-EMF of the coil (Chen 2010, C.2.3)."""

    RESISTANCE, FORCE_CONSTANT = 9.0, 4.0

    def _session(self, inductance: float = 0.0, **figures: float) -> Session:
        """A coil on the forearm under a band-limited voltage, integrated at sixteen times the sample rate."""
        r, bl, (m, b, k) = (
            self.RESISTANCE,
            self.FORCE_CONSTANT,
            (simulated.MASS, simulated.DAMPING, simulated.STIFFNESS),
        )
        rng, fine = simulated.generator(31), 16 * 2000.0
        volts = signal.sosfilt(signal.butter(8, 200.0, fs=fine, output="sos"), rng.standard_normal(16 * 10_000))
        volts *= 6.0 / np.std(volts)
        if inductance:  # states: position, speed, current
            a = np.array([[0, 1, 0], [-k / m, -b / m, bl / m], [0, -bl / inductance, -r / inductance]])
            drive = np.array([[0.0], [0.0], [1.0 / inductance]])
        else:
            a = np.array([[0.0, 1.0], [-k / m, -(b + bl**2 / r) / m]])
            drive = np.array([[0.0], [bl / (r * m)]])
        output = np.eye(a.shape[0])[:1]
        a, drive, output, through, _ = signal.cont2discrete((a, drive, output, [[0.0]]), 1.0 / fine, method="foh")
        position = signal.lfilter(*(np.ravel(part) for part in signal.ss2tf(a, drive, output, through)), volts)
        volts, position = volts[32_000::16], position[32_000::16]
        signals = {"voltage": volts, "position": 0.012 + position + simulated.noise(rng, position, 40.0)}
        session = make_session(make_test(signals=signals, preload_s=0.0, sample_rate_hz=2000.0))
        known = {"coil_resistance_ohm": r, "force_constant_n_per_a": bl} | figures
        return replace(session, instrument=replace(session.instrument, **known))

    @pytest.mark.parametrize("engine", ["lms", "spectral", "volterra"])
    def test_mass_damping_and_stiffness_are_those_of_the_force(self, engine: str):
        report = analyse(self._session(), engine, input_name="voltage").model.report
        found = [report.parameters[name] for name in ("mass_kg", "damping_n_s_per_m", "stiffness_n_per_m")]
        for estimate, true in zip(found, (simulated.MASS, simulated.DAMPING, simulated.STIFFNESS), strict=True):
            assert estimate.value == pytest.approx(true, rel=0.01)
            assert 0.02 < estimate.std / true < 0.05  # 2 % of each figure of the coil
        assert says(report.findings[-1], "analysis.behind_coil", resistance=9.0, force_constant=4.0, damping=16.0 / 9.0)

    def test_the_deviations_are_those_of_fit_and_calibration(self):
        stds = {"coil_resistance_ohm_std": 0.09, "force_constant_n_per_a_std": 0.02}
        stiffness = analyse(self._session(calibration=stds), "lms", input_name="voltage").model.report.parameters
        assert stiffness["stiffness_n_per_m"].std == pytest.approx(np.hypot(0.01, 0.005) * simulated.STIFFNESS, rel=0.1)

    def test_an_inductance_of_a_tenth_of_a_millisecond_biases_little(self):
        report = analyse(self._session(inductance=0.9e-3), "lms", input_name="voltage").model.report
        assert report.parameters["stiffness_n_per_m"].value == pytest.approx(simulated.STIFFNESS, rel=0.02)
        assert report.parameters["mass_kg"].value == pytest.approx(simulated.MASS, rel=0.1)

    @pytest.mark.parametrize("missing", ["coil_resistance_ohm", "force_constant_n_per_a"])
    def test_without_a_figure_of_the_coil_there_is_gain_alone(self, missing: str):
        report = analyse(self._session(**{missing: np.nan}), "lms", input_name="voltage").model.report
        assert ("gain" in report.parameters, "mass_kg" in report.parameters, report.findings) == (True, False, ())
