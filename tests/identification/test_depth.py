"""Depth partitions: Eqs. 5.1-5.2 exactly, both ways to run them, and mass, damping and stiffness against depth."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from coded import codes, refused, says
from identification import simulated, simulated_dpn, simulated_stepped
from numpy.typing import NDArray
from outside_data import RIG
from scipy import linalg

from tissueid.identification import vaf_percent, validated
from tissueid.identification.engines.partitions import Depth
from tissueid.identification.partitions.model import PartitionedModel
from tissueid.records import Record, joined

Array = NDArray[np.float64]


def explicit(record: Record, breakpoints: Array, lags: int, spacing: int, reference: float) -> Array:
    """P of Eq. 5.1, a loop over its columns: rows from the first complete memory on."""
    rows = range((lags - 1) * spacing, len(record))
    matrix = [np.ones(len(rows))]
    for low, high in zip([-np.inf, *breakpoints[1:-1]], [*breakpoints[1:-1], np.inf], strict=True):
        for lag in range(lags):
            at = np.array(rows) - lag * spacing
            inside = (record.output[at] >= low) & (record.output[at] < high)
            matrix.append(np.where(inside, record.input[at] - reference, 0.0))
    return np.array(matrix).T


@lru_cache(maxsize=8)
def fitted(tissue: simulated_dpn.Tissue) -> tuple[Record, PartitionedModel]:
    record = simulated_dpn.record(tissue, 1)
    return record, Depth().fit(record)


@pytest.fixture(scope="module")
def skin() -> tuple[Record, PartitionedModel]:
    return fitted(simulated_dpn.SKIN)


def errors(model: PartitionedModel, tissue: simulated_dpn.Tissue) -> Array:
    """Relative errors of M, B and K at each cell, (3, cells)."""
    found = model.depth_profile()
    y = found.position
    truth = np.array([tissue.masses(y), tissue.dampings(y), tissue.tangents(y)])
    return np.array([found.mass, found.damping, found.stiffness]) / truth - 1.0


# --- the kernels ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("offset", ["common", "mean"])
@pytest.mark.parametrize("spacing", [1, 3])
def test_kernels_are_the_least_squares_answer_of_eq_5_1(offset: str, spacing: int):
    record = simulated_stepped.stochastic_wiener(1, n=2500)
    model = Depth(memory=0.048, partitions=4, downsample=spacing, offset=offset, correct=False, hold="zero-order").fit(
        record
    )
    lags = 24 // spacing
    assert model.kernels.shape == (4, lags)
    reference = 0.0 if offset == "common" else float(np.mean(record.input))
    matrix = explicit(record, model.breakpoints_m, lags, spacing, reference)
    theta = linalg.lstsq(matrix, record.output[(lags - 1) * spacing :])[0]
    found = np.concatenate([[model.offsets[0]], np.ravel(model.kernels) * spacing / 500.0])
    assert np.linalg.norm(found - theta) < 1e-8 * np.linalg.norm(theta)
    scheduled = model.simulate_scheduled(record)[(lags - 1) * spacing :]
    np.testing.assert_allclose(scheduled, matrix @ theta, atol=1e-9 * np.std(record.output))
    np.testing.assert_allclose(model.lag_s, np.arange(lags) * spacing / 500.0)


def test_partitions_hold_as_many_samples_or_are_as_wide_or_are_given(skin: tuple[Record, PartitionedModel]):
    record, model = skin
    profile = model.depth_profile()
    assert np.ptp(profile.support) <= 2
    assert profile.support.sum() == model.report.n_samples
    np.testing.assert_array_equal(profile.low[1:], profile.high[:-1])
    wide = Depth(breakpoints="width", partitions=3, correct=False).fit(record)
    np.testing.assert_allclose(np.diff(wide.breakpoints_m), np.ptp(wide.breakpoints_m) / 3)
    given = Depth(breakpoints_m=(0.0112, 0.0118), correct=False).fit(record)
    np.testing.assert_allclose(given.breakpoints_m[1:-1], [0.0112, 0.0118])
    assert given.kernels.shape[0] == 3


def test_one_partition_is_the_linear_impulse_response():
    record = simulated.linear_record(3)
    model = Depth(partitions=1, offset="mean", memory=0.125).fit(record)
    y = record.output[400:]
    assert vaf_percent(y, model.simulate(record.input)[400:]) == pytest.approx(
        vaf_percent(y, model.simulate_scheduled(record)[400:]), abs=1e-9
    )
    report = model.report.parameters
    simulated.near(report, 0.02, mass_kg=simulated.MASS, stiffness_n_per_m=simulated.STIFFNESS)


@pytest.mark.soak
def test_standard_deviations_of_kernels_are_the_spread_of_repeats():
    found, reported = [], []
    for run in range(40):
        force = 3.0 + simulated.generator(31, run).standard_normal(2500)
        position = simulated_stepped.wiener(force)
        noisy = position + simulated.noise(simulated.generator(32, run), position, 20.0, 0.8)
        model = Depth(
            memory=0.04, breakpoints_m=(0.0031,), downsample=1, offset="mean", correct=False, hold="zero-order"
        ).fit(Record(force[100:], noisy[100:], 500.0))
        found.append(model.kernels)
        reported.append(model.kernels_std)
    ratio = np.mean(reported, axis=0) / np.std(found, axis=0, ddof=1)
    assert (
        0.95 < np.mean(ratio) < 1.25
    )  # what coloured residuals hide is allowed for, and rather too much than too little


# --- the two ways to be run -------------------------------------------------------------------------------------------


def test_the_report_tells_the_free_run_and_beside_it_the_scheduled_one(skin: tuple[Record, PartitionedModel]):
    record, _ = skin
    model = validated(Depth().fit(record, slice(0, 6000)), record, slice(6000, None))
    report = model.report
    assert 97.0 < report.vaf_validation_percent <= 100.0
    assert 97.0 < report.vaf_scheduled_percent <= 100.0
    simulated_output = model.simulate(record.input)
    scored = slice(model.memory_samples - 1, 6000)
    assert report.vaf_percent == pytest.approx(vaf_percent(record.output[scored], simulated_output[scored]), abs=0.05)
    assert report.details["vaf_of_place_percent"] > 90.0  # seven stretches of depth alone, no force at all


def test_the_free_run_sees_the_input_alone_and_cannot_run_away(skin: tuple[Record, PartitionedModel]):
    record, model = skin
    forgotten = replace(record, output=np.full(len(record), 7.0))
    np.testing.assert_array_equal(model.residuals(forgotten), 7.0 - model.simulate(record.input))
    wild = 50.0 * simulated.generator(4).standard_normal(4000)
    bound = np.max(np.abs(model.kernels), axis=0).sum() * model.lag_spacing / model.sample_rate_hz
    output = model.simulate(wild)
    assert np.all(np.isfinite(output))
    assert np.max(np.abs(output - model.offsets[0])) <= bound * np.max(np.abs(wild - model.reference)) * (1 + 1e-12)


@pytest.mark.parametrize("offset", ["common", "mean", "partition"])
def test_the_free_run_rests_at_the_operating_point(offset: str, skin: tuple[Record, PartitionedModel]):
    record, _ = skin
    model = Depth(offset=offset, correct=False).fit(record)
    output = model.simulate(np.full(1500, model.input_mean))
    np.testing.assert_allclose(output, output[0], rtol=0.0, atol=1e-9)
    assert abs(output[0] - np.mean(record.output)) < 0.25 * np.std(record.output)


def test_a_missing_output_leaves_the_scheduled_memory_unknown(skin: tuple[Record, PartitionedModel]):
    record, model = skin
    missing = simulated.changed(record.output, (5000, np.nan))
    scheduled = model.simulate_scheduled(replace(record, output=missing))
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(scheduled)), np.arange(5000, 5000 + model.window))


def test_records_joined_are_fitted_together_and_gaps_are_left_out():
    first, second = (simulated_dpn.record(simulated_dpn.SKIN, 1)[part] for part in (slice(0, 4000), slice(4000, None)))
    both = joined([first, second])
    model = Depth(partitions=4, offset="mean", downsample=4, correct=False).fit(both)
    lags = model.lag_s.size
    parts = [
        explicit(record, model.breakpoints_m, lags, 4, float(np.nanmean(both.input))) for record in (first, second)
    ]
    y = np.concatenate([record.output[(lags - 1) * 4 :] for record in (first, second)])
    theta = linalg.lstsq(np.vstack(parts), y)[0]
    np.testing.assert_allclose(np.ravel(model.kernels) / 500.0, theta[1:], rtol=0, atol=1e-8 * np.linalg.norm(theta))


# --- mass, damping and stiffness --------------------------------------------------------------------------------------


@pytest.mark.parametrize("tissue", [simulated_dpn.SKIN, simulated_dpn.GROWING, simulated_dpn.THESIS])
def test_parameters_of_a_tissue_that_changes_with_depth_are_found(tissue: simulated_dpn.Tissue):
    _, model = fitted(tissue)
    off = errors(model, tissue)
    worst, typical = (0.1, 0.03) if tissue is simulated_dpn.SKIN else (0.03, 0.01)
    assert np.max(np.abs(off)) < worst
    assert np.mean(np.abs(off)) < typical
    assert says(model.report.findings[0], "depth.rises", name="stiffness")
    slope = model.report.parameters["stiffness_slope_n_per_m2"]
    assert slope.value > 4.0 * slope.std


def test_a_tissue_without_depth_shows_none():
    _, model = fitted(simulated_dpn.PLAIN)
    profile = model.depth_profile()
    assert np.ptp(profile.stiffness) < 0.02 * np.mean(profile.stiffness)
    assert set(codes(model.report.findings)) == {"depth.constant"}


def test_the_correction_takes_off_most_of_the_averaging():
    record, model = fitted(simulated_dpn.SKIN)
    plain = errors(Depth(correct=False).fit(record), simulated_dpn.SKIN)
    assert np.mean(np.abs(errors(model, simulated_dpn.SKIN))) < 0.6 * np.mean(np.abs(plain))


@pytest.mark.parametrize(("continuous", "repetitions"), [(50, 2), (20, 5), (20, 20)])
def test_stepped_tests_of_fig_5_2_recover_parameters_within_five_percent(continuous: int, repetitions: int):
    record = simulated_stepped.stepped_wiener(5, continuous=continuous, repetitions=repetitions)
    engine = Depth(memory=0.12, partitions=5, downsample=1, offset="partition", hold="zero-order")
    profile = engine.fit(record).depth_profile()
    truth = simulated_stepped.wiener_local(profile.position).T
    off = np.abs(np.array([profile.mass, profile.damping, profile.stiffness]) / truth - 1.0)
    assert np.all(off.mean(axis=1) < 0.05)


def test_a_stepped_record_is_told_of():
    record = simulated_stepped.stepped_wiener(5, continuous=300, repetitions=1)
    engine = Depth(memory=0.12, partitions=4, downsample=1, offset="common", hold="zero-order", correct=False)
    report = engine.fit(record).report
    assert "partitions.stepped" in codes(report.warnings)
    assert "partitions.stepped" not in codes(fitted(simulated_dpn.SKIN)[1].report.warnings)


def test_by_default_a_stepped_record_has_an_offset_for_each_partition():
    record = simulated_stepped.stepped_wiener(5, continuous=300, repetitions=1)
    options = {"memory": 0.12, "partitions": 4, "downsample": 1, "hold": "zero-order", "correct": False}
    chosen, asked = Depth(**options).fit(record), Depth(**options, offset="partition").fit(record)
    np.testing.assert_array_equal(chosen.kernels, asked.kernels)
    assert "partitions.own_offsets" in codes(chosen.report.findings)


def test_an_output_that_falls_with_the_input_has_negative_parameters():
    record, model = fitted(simulated_dpn.GROWING)
    mirrored = Depth().fit(replace(record, output=0.022 - record.output))
    profile, straight = mirrored.depth_profile(), model.depth_profile()
    np.testing.assert_allclose(profile.stiffness, -straight.stiffness[::-1], rtol=0.02)


def test_what_is_not_force_and_position_has_no_profile():
    record, _ = fitted(simulated_dpn.SKIN)
    model = Depth().fit(replace(record, input_unit="A", input_name="current"))
    assert model.depth_profile() is None
    assert "gain" in model.report.parameters


# --- refusals ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "code"),
    [
        ({"breakpoints_m": (0.0118, 0.0112)}, "partitions.bad_breakpoints"),
        ({"breakpoints_m": (0.5,)}, "partitions.bad_breakpoints"),
        ({"partitions": 25, "breakpoints": "width"}, "partitions.too_few_in_one"),
        ({"partitions": 100}, "record.too_few_samples"),
    ],
)
def test_what_cannot_be_cut_is_refused(options: dict[str, object], code: str, skin: tuple[Record, PartitionedModel]):
    refused(lambda: Depth.from_options(options).fit(skin[0][:2500]), code)


def test_fewer_than_three_samples_a_parameter_warns(skin: tuple[Record, PartitionedModel]):
    report = Depth(correct=False).fit(skin[0][:700]).report
    assert {"record.few_samples", "partitions.few_samples"} & set(codes(report.warnings))


# --- measured tests, and many runs ------------------------------------------------------------------------------------


@pytest.mark.skipif(not RIG.exists(), reason="the sessions of the independent rig are not here")
def test_measured_tests_are_simulated_on_held_out_samples():
    from tissueid.sessions import read_session

    scheduled, free = [], []
    for path in sorted(RIG.glob("rig-*.h5"))[::8]:
        record = read_session(path).test(None).record("force", "position")
        cut = round(0.75 * len(record))
        report = validated(Depth(correct=False).fit(record, slice(0, cut)), record, slice(cut, None)).report
        scheduled.append(report.vaf_scheduled_percent)
        free.append(report.vaf_validation_percent)
    assert np.median(scheduled) > 97.0
    assert np.median(free) > 97.0


@pytest.mark.soak
@pytest.mark.parametrize("tissue", [simulated_dpn.SKIN, simulated_dpn.GROWING, simulated_dpn.PLAIN])
@pytest.mark.parametrize(("snr_db", "colour"), [(40.0, 0.0), (30.0, 0.9)])
def test_intervals_hold_the_truth(tissue: simulated_dpn.Tissue, snr_db: float, colour: float):
    held = []
    for seed in range(60):
        model = Depth().fit(simulated_dpn.record(tissue, 200 + seed, snr_db=snr_db, colour=colour))
        found = model.depth_profile()
        values = np.array([found.mass, found.damping, found.stiffness])
        std = np.array([found.mass_std, found.damping_std, found.stiffness_std])
        truth = values / (1.0 + errors(model, tissue))
        held.append(np.abs(values - truth) < 1.96 * std)
    coverage = np.mean(held, axis=(0, 2))
    print(f"mass, damping, stiffness held in {np.round(100 * coverage, 1)} % of cells")
    assert np.all(coverage > 0.9)
