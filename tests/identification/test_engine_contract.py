"""The contract of engines, models and reports, whatever the engine."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from coded import Refusal, coded, codes, refused
from identification import simulated
from pydantic import ValidationError

from tissueid.errors import UnusableInputError
from tissueid.identification import Engine, FitReport, Model, engine_names, get_engine
from tissueid.language import set_language
from tissueid.messages import translated
from tissueid.records import Estimate, Record

CONTRACT = {
    "engine",
    "options",
    "n_samples",
    "n_parameters",
    "vaf_percent",
    "vaf_validation_percent",
    "vaf_scheduled_percent",
    "aicc",
    "parameters",
    "seconds",
    "warnings",
}
NAMED = {"lms", "spectral", "rls", "als", "wiener", "hammerstein", "volterra", "depth", "direction", "localized", "dpn"}
"""The engines that scripts may rely on."""

EVERY = engine_names()
A_WEIGHT_A_LAG = ("lms", "spectral", "rls", "als", "wiener")
QUICKER: dict[str, dict[str, Any]] = {"cascade": {"structure": "wiener"}, "depth": {"correct": False}}


@pytest.fixture
def german() -> Iterator[None]:
    set_language("de")
    yield
    set_language("en")


def specification(name: str) -> Engine:
    return get_engine(name).from_options(QUICKER.get(name, {}))


@pytest.fixture(scope="module")
def record() -> Record:
    return simulated.wiener_record(1)


@pytest.fixture(scope="module", params=[name for name in EVERY if name != "localized"])
def model(request: pytest.FixtureRequest, record: Record) -> Model:
    return specification(request.param).fit(record)


def test_report_has_the_keys_of_the_contract(model: Model):
    report = model.report.as_dict()
    assert set(report) >= CONTRACT
    assert json.loads(json.dumps(report, allow_nan=False)) == report
    if model.report.engine in NAMED:
        assert {"mass_kg", "damping_n_s_per_m", "stiffness_n_per_m"} <= set(report["parameters"])
    for estimate in report["parameters"].values():
        assert set(estimate) == {"value", "std"}


def test_what_is_not_finite_becomes_null():
    report = FitReport(
        engine="lms",
        options={},
        n_samples=3,
        n_parameters=1,
        vaf_percent=math.nan,
        vaf_validation_percent=math.inf,
        aicc=math.nan,
        parameters={"mass_kg": Estimate(math.nan, math.inf)},
    ).as_dict()
    assert report["vaf_percent"] is None
    assert report["vaf_validation_percent"] is None
    assert report["aicc"] is None
    assert report["seconds"] is None
    assert report["parameters"]["mass_kg"] == {"value": None, "std": None}


def test_simulation_sees_the_input_alone(model: Model, record: Record):
    simulated_output = model.simulate(record.input)
    assert simulated_output.shape == record.input.shape
    forgotten = Record(record.input, np.full_like(record.output, 7.0), record.sample_rate_hz)
    np.testing.assert_array_equal(model.predict(forgotten, horizon=1), simulated_output)
    np.testing.assert_allclose(model.residuals(record), record.output - simulated_output)


def test_an_output_error_model_predicts_alike_at_every_horizon(model: Model, record: Record):
    np.testing.assert_array_equal(model.predict(record, horizon=1), model.predict(record, horizon=50))
    refused(lambda: model.predict(record, horizon=0), "engine.horizon", horizon=0)


def test_simulation_rests_at_the_operating_point_before_the_record(model: Model, record: Record):
    u = np.full(2000, np.mean(record.input))
    output = model.simulate(u)
    np.testing.assert_allclose(output, output[0], rtol=0, atol=1e-9)
    assert abs(output[0] - np.mean(record.output)) < 0.2 * np.std(record.output)


def test_a_missing_input_leaves_its_memory_unknown_and_nothing_else(model: Model, record: Record):
    u = simulated.changed(record.input, (3000, np.nan))
    output = model.simulate(u)
    unknown = np.flatnonzero(np.isnan(output))
    np.testing.assert_array_equal(unknown, np.arange(3000, 3000 + model.memory_samples))
    error = np.abs(output - model.simulate(record.input))[np.isfinite(output)]
    just_before = slice(2990, 3000)  # between samples, a band-limited force depends on the one that is missing
    assert np.max(error[just_before]) < 5e-5 * np.std(record.output)
    error[just_before] = 0.0
    assert np.max(error) < 1e-9


def test_another_sample_rate_is_refused(model: Model, record: Record):
    slower = Record(record.input, record.output, 1000.0)
    refused(lambda: model.residuals(slower), "engine.other_sample_rate", fitted=2000.0, given=1000.0)


def test_models_and_engines_are_frozen(model: Model):
    with pytest.raises(AttributeError):
        model.memory_samples = 3  # type: ignore[misc]
    engine = get_engine(model.report.engine)()
    for option in type(engine).model_fields:
        with pytest.raises(ValidationError):
            setattr(engine, option, None)
    assert model.with_report(seconds=0.2).report.seconds == 0.2
    assert model.report.seconds is None


@pytest.mark.parametrize("name", EVERY)
def test_unknown_options_are_refused(name: str):
    refused(lambda: get_engine(name).from_options({"memry": 0.1}), "option.unknown", option="memry")


@pytest.mark.parametrize("name", EVERY)
def test_options_out_of_their_bounds_are_refused(name: str):
    kind = get_engine(name)
    for option, schema in kind.model_json_schema()["properties"].items():
        limits = [schema[bound] for bound in ("maximum", "exclusiveMaximum") if bound in schema]
        for value in (*(2.0 * abs(limit) + 1.0 for limit in limits), *[float("nan")] * len(limits)):
            with pytest.raises(UnusableInputError, check=coded("option.refused", option=option)):
                kind.from_options({option: value})


@pytest.mark.parametrize("name", EVERY)
def test_options_carry_bounds_and_descriptions_for_a_form(name: str):
    for option, schema in get_engine(name).model_json_schema()["properties"].items():
        assert schema.get("description"), option
        if schema.get("type") in ("number", "integer"):
            assert {"minimum", "exclusiveMinimum"} & set(schema), option
            assert {"maximum", "exclusiveMaximum"} & set(schema), option


@pytest.mark.parametrize("name", EVERY)
def test_engine_and_options_have_texts_in_both_languages(name: str, german: None):
    kind = get_engine(name)
    assert kind.label
    assert translated(kind.title) != kind.title
    for info in kind.model_fields.values():
        assert info.title
        assert translated(info.description) != info.description


def _empty_records() -> list[tuple[str, Record, Refusal]]:
    noise = simulated.generator(9).standard_normal(4000)
    missing = np.full(4000, np.nan)
    return [
        (
            "constant input",
            Record(np.ones(4000), noise, 2000.0),
            Refusal("record.constant", signal="the input (force)"),
        ),
        (
            "constant output",
            Record(noise, np.ones(4000), 2000.0),
            Refusal("record.constant", signal="the output (position)"),
        ),
        ("no input", Record(missing, noise, 2000.0), Refusal("record.no_sample", signal="the input (force)")),
        ("no output", Record(noise, missing, 2000.0), Refusal("record.no_sample", signal="the output (position)")),
    ]


@pytest.mark.parametrize("name", EVERY)
@pytest.mark.parametrize(("record", "refusal"), [pytest.param(r, t, id=i) for i, r, t in _empty_records()])
def test_records_that_hold_nothing_are_refused(name: str, record: Record, refusal: Refusal):
    with pytest.raises(UnusableInputError, check=refusal.check):
        get_engine(name)().fit(record)


def _scant_records() -> list[tuple[str, Record, Refusal]]:
    noise = simulated.generator(9).standard_normal(4000)
    holed = simulated.changed(noise, (np.s_[::100], np.nan))
    return [
        (
            "short",
            Record(noise[:100], noise[:100], 2000.0),
            Refusal("record.shorter_than_memory", memory=0.125, seconds=0.05),
        ),
        ("few", Record(noise[:300], noise[:300], 2000.0), Refusal("record.too_few_samples", count=51)),
        ("full of holes", Record(holed, noise, 2000.0), Refusal("record.too_few_samples", count=0)),
    ]


@pytest.mark.parametrize("name", A_WEIGHT_A_LAG)
@pytest.mark.parametrize(("record", "refusal"), [pytest.param(r, t, id=i) for i, r, t in _scant_records()])
def test_records_that_carry_no_fit_are_refused(name: str, record: Record, refusal: Refusal):
    with pytest.raises(UnusableInputError, check=refusal.check):
        get_engine(name)().fit(record)


@pytest.mark.parametrize("name", sorted(set(EVERY) - set(A_WEIGHT_A_LAG)))
@pytest.mark.parametrize("record", [pytest.param(r, id=i) for i, r, _ in _scant_records()])
def test_engines_of_few_parameters_fit_a_scant_record_or_refuse_it(name: str, record: Record):
    refusal = ""
    try:
        model = get_engine(name)().fit(record)
    except UnusableInputError as refused:
        refusal = str(refused)
    assert "\n" not in refusal
    assert refusal or model.report.n_samples >= model.report.n_parameters


@pytest.mark.parametrize("name", A_WEIGHT_A_LAG)
def test_fewer_than_three_samples_a_parameter_warns(name: str, record: Record):
    model = get_engine(name).from_options({"window": 0.2} if name == "spectral" else {}).fit(record[:900])
    assert "record.few_samples" in codes(model.report.warnings)


@pytest.mark.parametrize("name", EVERY)
def test_a_part_that_is_not_there_is_refused(name: str, record: Record):
    refused(lambda: get_engine(name)().fit(record, slice(9000, 9500)), "record.no_sample")
    refused(lambda: get_engine(name)().fit(record, slice(0, 8000, 2)), "record.not_contiguous")


def test_the_engines_that_scripts_rely_on_are_here():
    assert set(EVERY) >= NAMED


def test_every_engine_fits_a_plain_record(model: Model, record: Record):
    assert model.report.vaf_percent > 90.0
    assert model.report.options == specification(model.report.engine).for_record(record, None).options()
