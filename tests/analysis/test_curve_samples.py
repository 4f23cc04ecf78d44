"""Sampled curves of a fit are those of its model at the points of fixed grids."""

import numpy as np
import pytest
from reports.synthetic_sitting import make_session, make_test

from tissueid.analysis.curves.samples import (
    DAMPING,
    GRIDS,
    KERNEL1,
    KERNEL2,
    LAGS,
    MAGNITUDE,
    NONLINEARITY,
    PARTITIONS,
    PHASE,
    STIFFNESS,
    SampledCurve,
    from_json,
    sampled_curves,
    trimmed,
)
from tissueid.analysis.fitting import fit_whole
from tissueid.analysis.split import split
from tissueid.identification import get_engine

SURFACE_M = 0.010


def fitted(engine, **options):
    session = make_session(make_test(1, seconds=2.0, seed=3))
    return fit_whole(get_engine(engine).from_options(options), split(session, test=1))


def sampled(analysis, surface=SURFACE_M):
    return {(curve.name, curve.direction): curve.on_grid for curve in sampled_curves(analysis, surface)}


def test_response_and_static_nonlinearity_of_a_wiener_cascade():
    analysis = fitted("wiener")
    curves = sampled(analysis)
    assert set(curves) == {(MAGNITUDE, 0), (PHASE, 0), (NONLINEARITY, 0)}
    force, depth = GRIDS[NONLINEARITY].x, curves[NONLINEARITY, 0]
    known = np.isfinite(depth)
    assert 2.0 < force[known][0] < 4.0 < 6.0 < force[known][-1] < 9.0  # 5 N with a standard deviation of 1.5 N
    assert depth[known] == pytest.approx(analysis.model.nonlinearity(force[known]) - SURFACE_M, rel=1e-6)
    frequency, size = GRIDS[MAGNITUDE].x, curves[MAGNITUDE, 0]
    known = np.isfinite(size)
    assert frequency[known][0] < 5.0
    assert 100.0 < frequency[known][-1] < 200.0  # the input ends at 150 Hz
    slope = analysis.model.nonlinearity.slope(np.array([5.0]))[0]
    middle = np.argmin(np.abs(frequency - 20.0))
    system = 4000.0 / np.polyval([0.09, 20.0, 4000.0], 2j * np.pi * frequency[middle])
    assert size[middle] == pytest.approx(abs(system) * slope, rel=0.15)
    assert -90.0 < curves[PHASE, 0][middle] < 0.0


def test_kernels_of_a_volterra_model():
    analysis = fitted("volterra")
    model, curves = analysis.model, sampled(analysis)
    assert {MAGNITUDE, PHASE, KERNEL1, KERNEL2} == {name for name, _way in curves}
    lag_s = GRIDS[KERNEL1].x
    inside = lag_s <= model.lag_s[-1] + 1e-12
    assert curves[KERNEL1, 0][inside] == pytest.approx(np.interp(lag_s[inside], model.lag_s, model.kernel1))
    assert np.isnan(curves[KERNEL1, 0][~inside]).all()
    assert GRIDS[KERNEL2].x.size == LAGS * (LAGS + 1) // 2
    first, second = GRIDS[KERNEL2].x[40], GRIDS[KERNEL2].y[40]
    rows = [np.interp(second, model.lag_s, row) for row in model.kernel2]
    assert curves[KERNEL2, 0][40] == pytest.approx(np.interp(first, model.lag_s, rows))


def test_profiles_and_partitions_lie_at_depths_below_the_surface():
    analysis = fitted("depth", partitions=4)
    curves, profile = sampled(analysis), analysis.depth_profile()
    depth = GRIDS[STIFFNESS].x
    for name, values in ((STIFFNESS, profile.stiffness), (DAMPING, profile.damping)):
        found = curves[name, 0]
        known = np.isfinite(found)
        assert known.sum() > 5
        assert depth[known].min() >= profile.position.min() - SURFACE_M - 1e-9
        assert found[known] == pytest.approx(np.interp(depth[known], profile.position - SURFACE_M, values))
    model, kernels = analysis.model, curves[PARTITIONS, 0].reshape(-1, LAGS)
    depths = GRIDS[PARTITIONS].y.reshape(-1, LAGS)[:, 0]
    row = np.flatnonzero(np.isfinite(kernels[:, 0]))[1]
    cell = np.searchsorted(model.breakpoints_m, depths[row] + SURFACE_M, side="right") - 1
    lag_s = GRIDS[PARTITIONS].x[:LAGS]
    assert kernels[row] == pytest.approx(np.interp(lag_s, model.lag_s, model.operating_kernels[cell]))
    unknown = {name for name, _way in sampled(analysis, float("nan"))}
    assert unknown == {MAGNITUDE, PHASE}


def test_directions_are_curves_of_their_own():
    curves = sampled(fitted("direction", partitions=3))
    assert {way for name, way in curves if name == STIFFNESS} == {1, -1}


def test_json_keeps_five_digits_and_gaps():
    values = np.full(GRIDS[STIFFNESS].x.size, np.nan)
    values[[10, 12]] = 1234.5678, 2.0
    curve = trimmed(STIFFNESS, values, -1)
    assert curve.as_json() == [STIFFNESS, -1, 10, [1234.6, None, 2.0]]
    again = from_json(curve.as_json())
    assert again.on_grid == pytest.approx(np.where(np.isnan(values), np.nan, values.round(1)), nan_ok=True)
    assert trimmed(STIFFNESS, np.full_like(values, np.nan)).values.size == 0


@pytest.mark.parametrize(
    "stored",
    [["other", 0, 0, [1.0]], [STIFFNESS, 0, -1, [1.0]], [STIFFNESS, 5, 0, [1.0]], [STIFFNESS, 0, 0, [1.0] * 9999]],
)
def test_a_damaged_curve_is_refused(stored):
    with pytest.raises(ValueError, match=r"."):
        from_json(stored)


def test_a_curve_of_a_test_needs_few_bytes():
    for grid in GRIDS.values():
        assert grid.x.size < 4000
    assert len(str(SampledCurve(KERNEL2, 0, np.full(300, -1.2345e-4)).as_json())) < 5000
