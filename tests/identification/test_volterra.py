"""Volterra kernels: the exact answer against LAPACK, what known systems leave in them, and what is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest
from coded import Refusal, codes, refused, says
from identification import simulated, simulated_cascades
from identification.simulated import Array, changed
from outside_data import RIG
from scipy import linalg, signal

from tissueid.errors import UnusableInputError
from tissueid.identification import validated
from tissueid.identification.engines.lms import Lms
from tissueid.identification.engines.volterra import Volterra
from tissueid.identification.volterra.regressors import automatic_grid, coefficient_count, smoothed, whiteness
from tissueid.identification.volterra.structure import VolterraModel
from tissueid.records import Record, joined

LAGS = simulated_cascades.LAGS
MEMORY = LAGS / simulated_cascades.RATE
EITHER = pytest.mark.parametrize(("method", "lags"), [("exact", LAGS), ("regularised", 25)])
"""What a memory of 25 lags leaves out of the impulse response is a hundredth of its peak."""


def explicit_matrix(x: Array, rows: Array, lags: int, spacing: int, order: int) -> tuple[Array, list[tuple[int, ...]]]:
    """Every product of lagged inputs up to an order, column by column, with the lags of each."""
    columns, names = [np.ones(rows.size)], [()]
    for i in range(lags if order >= 1 else 0):
        columns.append(x[rows - i * spacing])
        names.append((i,))
    for i in range(lags if order >= 2 else 0):
        for j in range(i, lags):
            columns.append(x[rows - i * spacing] * x[rows - j * spacing])
            names.append((i, j))
    for i in range(lags if order >= 3 else 0):
        for j in range(i, lags):
            for k in range(j, lags):
                columns.append(x[rows - i * spacing] * x[rows - j * spacing] * x[rows - k * spacing])
                names.append((i, j, k))
    return np.column_stack(columns), names


def coefficients(model: VolterraModel, names: list[tuple[int, ...]]) -> Array:
    """The model's kernels as coefficients of those products."""
    kernels = model.per_lag
    values = []
    for lags in names:
        kernel = (np.array(kernels.zeroth), kernels.first, kernels.second, kernels.third)[len(lags)]
        turns = math.factorial(len(lags)) / math.prod(math.factorial(lags.count(lag)) for lag in set(lags))
        values.append(turns * float(kernel[lags]))
    return np.array(values)


@pytest.mark.parametrize("rows", ["every", "downsampled"])
@pytest.mark.parametrize(("order", "lags", "spacing"), [(0, 5, 1), (1, 20, 1), (2, 12, 1), (2, 8, 3), (3, 6, 2)])
def test_the_exact_answer_is_that_of_lapack_on_the_explicit_matrix(order: int, lags: int, spacing: int, rows: str):
    record = simulated_cascades.hammerstein(1, n=3000, snr_db=20.0).record
    u = changed(record.input, (np.s_[900:905], np.nan))
    y = changed(record.output, (np.s_[1700:1730], np.nan))
    record = Record(u, y, record.sample_rate_hz)
    part = slice(100, 2800)
    engine = Volterra(memory=lags * spacing / 500.0, order=order, method="exact", downsample=spacing, rows=rows)
    model = engine.fit(record, part)
    received = np.array(
        [
            n
            for n in range(100, 2800)
            if n - (lags - 1) * spacing >= 0
            and np.isfinite(y[n])
            and np.isfinite(u[n - (lags - 1) * spacing : n + 1]).all()
        ]
    )
    assert model.report.n_samples == received.size
    if rows == "downsampled":
        received = received[received % spacing == 0]
    x = u - np.nanmean(u[part])
    matrix, names = explicit_matrix(x, received, lags, spacing, order)
    assert matrix.shape[1] == coefficient_count(lags, order) == model.report.n_parameters
    scale = 1.0 / np.linalg.norm(matrix, axis=0)
    expected = scale * linalg.lstsq(matrix * scale, y[received])[0]
    found = coefficients(model, names)
    np.testing.assert_allclose(found / scale, expected / scale, rtol=0.0, atol=1e-9 * np.linalg.norm(expected / scale))
    assert np.linalg.norm(found - expected) < 1e-8 * np.linalg.norm(expected)
    simulation = model.simulate(u)
    np.testing.assert_allclose(simulation[received], matrix @ expected, atol=1e-8 * np.std(y[received]))


def test_several_records_are_one_fit():
    parts = [simulated_cascades.wiener(2, k, n=1200, snr_db=30.0).record for k in range(3)]
    together = joined(parts)
    model = Volterra(memory=0.02, method="exact", downsample=1).fit(together)
    x = [part.input - np.nanmean(together.input) for part in parts]
    blocks = [explicit_matrix(some, np.arange(9, some.size), 10, 1, 2)[0] for some in x]
    names = explicit_matrix(x[0], np.arange(9, 20), 10, 1, 2)[1]
    expected = linalg.lstsq(np.vstack(blocks), np.concatenate([part.output[9:] for part in parts]))[0]
    np.testing.assert_allclose(coefficients(model, names), expected, atol=1e-9 * np.linalg.norm(expected))


def test_a_second_response_to_the_same_stimulus_takes_the_kept_factor():
    record = simulated_cascades.wiener(3, snr_db=30.0).record
    engine = Volterra(memory=0.03, method="exact")
    stimulus = engine.factored(record)
    other = Record(record.input, record.output**2, record.sample_rate_hz)
    for some in (record, other):
        kept, refitted = engine.fit(some, stimulus=stimulus), engine.fit(some)
        np.testing.assert_array_equal(kept.kernel2, refitted.kernel2)
        assert kept.report.vaf_percent == refitted.report.vaf_percent
    refused(lambda: engine.fit(record, slice(0, 2000), stimulus=stimulus), "volterra.other_stimulus")
    refused(lambda: Volterra(memory=0.04, method="exact").fit(record, stimulus=stimulus), "volterra.other_stimulus")


def alike(one: Array, other: Array) -> float:
    """Cosine between two arrays of one shape."""
    return float(np.sum(one * other) / np.linalg.norm(one) / np.linalg.norm(other))


def diagonal_share(kernel2: Array) -> float:
    """Share of a second-order kernel's energy that lies on its diagonal."""
    return float(np.sum(np.diag(kernel2) ** 2) / np.sum(kernel2**2))


@EITHER
def test_an_exponential_after_the_dynamics_leaves_a_negative_kernel_shaped_like_the_first(method: str, lags: int):
    system = simulated_cascades.wiener(4, curve="exponential")
    model = Volterra(memory=lags / 500.0, downsample=1, method=method).fit(system.record)
    h = system.impulse_response[:lags]
    assert alike(model.kernel1, h) > 0.999
    assert alike(model.kernel2, -np.outer(h, h)) > 0.94
    assert diagonal_share(model.kernel2) < 0.25
    assert model.report.vaf_percent > 97.0
    linear = Volterra(memory=lags / 500.0, downsample=1, order=1).fit(system.record)
    assert model.report.vaf_percent > linear.report.vaf_percent + 10.0


@EITHER
def test_an_exponential_before_the_dynamics_leaves_a_diagonal_alone(method: str, lags: int):
    system = simulated_cascades.hammerstein(5, curve="exponential")
    model = Volterra(memory=lags / 500.0, downsample=1, method=method).fit(system.record)
    h = system.impulse_response[:lags]
    assert alike(model.kernel1, h) > 0.999
    assert alike(np.diag(model.kernel2), -h) > 0.99
    assert diagonal_share(model.kernel2) > 0.95
    assert model.report.vaf_percent > 99.8


def test_a_square_after_the_dynamics_is_the_second_kernel_alone():
    system = simulated_cascades.wiener(6, curve="square")
    model = Volterra(memory=MEMORY, downsample=1, method="exact").fit(system.record)
    h = system.impulse_response
    kernels = model.per_lag
    np.testing.assert_allclose(kernels.second, np.outer(h, h), atol=1e-9)
    # About the mean input, the square has the slope of that mean.
    np.testing.assert_allclose(kernels.first, 2.0 * h.sum() * model.input_mean * h, atol=1e-9)
    level = (h.sum() * model.input_mean) ** 2 + simulated_cascades.REST
    assert kernels.zeroth == pytest.approx(level)
    assert model.report.vaf_percent > 99.999


def test_a_square_before_the_dynamics_is_a_diagonal_alone():
    system = simulated_cascades.hammerstein(7, curve="square")
    kernels = Volterra(memory=MEMORY, downsample=1, method="exact").fit(system.record).per_lag
    np.testing.assert_allclose(kernels.second, np.diag(system.impulse_response), atol=1e-9)


@pytest.mark.parametrize("method", ["exact", "regularised"])
def test_it_beats_the_line_on_held_out_samples(method: str):
    record = simulated.wiener_record(8)
    line = validated(Lms().fit(record, slice(0, 6000)), record, slice(6000, None)).report
    model = validated(Volterra(method=method).fit(record, slice(0, 6000)), record, slice(6000, None)).report
    assert model.vaf_validation_percent > 99.7
    assert line.vaf_validation_percent < 98.0
    assert model.parameters["stiffness_n_per_m"].value == pytest.approx(
        line.parameters["stiffness_n_per_m"].value, rel=0.01
    )


@pytest.mark.parametrize("method", ["exact", "regularised"])
def test_kernels_are_in_physical_units_whatever_their_spacing(method: str):
    record = simulated.linear_record(9)
    for spacing in (2, 4) if method == "regularised" else (4,):  # at 2, the raw kernel is noise
        model = Volterra(memory=0.1, order=1, downsample=spacing, method=method).fit(record)
        assert model.kernel1_std is not None
        t = model.lag_s
        np.testing.assert_allclose(t, np.arange(200 // spacing) * spacing / 2000.0)
        w = math.sqrt(simulated.STIFFNESS / simulated.MASS - (simulated.DAMPING / simulated.MASS) ** 2 / 4.0)
        truth = np.exp(-0.5 * simulated.DAMPING / simulated.MASS * t) * np.sin(w * t) / (simulated.MASS * w)
        assert np.linalg.norm(model.kernel1 - truth) < 0.05 * np.linalg.norm(truth)
        assert model.kernel1.sum() * spacing / 2000.0 == pytest.approx(1.0 / simulated.STIFFNESS, rel=0.01)


@pytest.fixture(scope="module")
def cubic() -> VolterraModel:
    record = simulated_cascades.hammerstein(10, curve="cubic", snr_db=40.0).record
    return Volterra(memory=0.02, order=3, method="exact", downsample=2).fit(record)


def test_contributions_add_up_and_follow_the_kernels(cubic: VolterraModel):
    rng = simulated.generator(11)
    u = rng.standard_normal(300) + 0.3
    x = np.concatenate([np.zeros(8), u - cubic.input_mean])
    kernels = cubic.per_lag
    parts = cubic.contributions(u)
    np.testing.assert_allclose(np.sum(parts, axis=0), cubic.simulate(u), rtol=1e-12)
    for n in range(0, 300, 37):
        window = x[n + 8 - 2 * np.arange(5)]
        assert parts[0][n] == kernels.zeroth
        assert parts[1][n] == pytest.approx(np.einsum("i,i", kernels.first, window))
        assert parts[2][n] == pytest.approx(np.einsum("ij,i,j", kernels.second, window, window))
        assert parts[3][n] == pytest.approx(np.einsum("ijk,i,j,k", kernels.third, window, window, window))


def test_the_impulse_response_is_what_an_impulse_does(cubic: VolterraModel):
    assert cubic.memory_samples == 9
    u = np.full(20, cubic.input_mean)
    u[4] += 0.7
    response = cubic.impulse_response(0.7)
    np.testing.assert_allclose(response.total, cubic.simulate(u)[4:14:2], rtol=1e-10)
    np.testing.assert_allclose(
        response.total, response.zeroth + response.first + response.second + response.third, rtol=1e-12
    )


def test_lags_are_spaced_by_what_the_input_can_tell():
    rng = simulated.generator(13)
    white = rng.standard_normal(8000)
    slow = signal.sosfilt(signal.butter(8, 150.0, fs=2000.0, output="sos"), rng.standard_normal(8000))
    assert automatic_grid(0.02, white, 2000.0).spacing == 1
    assert automatic_grid(0.02, white, 2000.0).lags == 40
    assert automatic_grid(0.06, white, 2000.0).spacing == 1
    assert automatic_grid(0.06, white, 2000.0).lags == 120
    assert automatic_grid(0.06, slow, 2000.0).spacing == 5  # 1000 Hz over a little more than 150
    assert automatic_grid(0.06, slow, 2000.0).memory_samples == 23 * 5 + 1
    slow[4000] = np.nan
    assert automatic_grid(0.06, slow, 2000.0).spacing == 5
    crawling = np.sin(np.arange(8000) / 2000.0)
    assert automatic_grid(0.01, crawling, 2000.0).lags == 1
    given = Volterra(memory=0.05, downsample=5, order=1).fit(simulated.linear_record(14)[:3000])
    assert (given.lag_spacing, given.lag_s.size) == (5, 20)


def test_whiteness_is_the_cost_of_a_coloured_input_to_a_linear_kernel():
    rng = simulated.generator(15)
    products = linalg.toeplitz(0.9 ** np.arange(20))
    root = linalg.cholesky(products, lower=True)
    white, coloured = [], []
    for _ in range(300):
        x = rng.standard_normal((200, 20))
        e = rng.standard_normal(200)
        white.append(np.linalg.lstsq(x, e, rcond=None)[0])
        coloured.append(np.linalg.lstsq(x @ root.T, e, rcond=None)[0])
    assert whiteness(products) == pytest.approx(np.var(white) / np.var(coloured), rel=0.1)
    assert whiteness(np.eye(9)) == pytest.approx(1.0)
    assert whiteness(np.ones((4, 4))) == 0.0


def test_a_raw_kernel_of_a_coloured_input_is_doubted():
    record = simulated_cascades.wiener(16, cutoff_hz=100.0, snr_db=30.0).record
    raw = Volterra(memory=0.04, downsample=1, method="exact").fit(record)
    assert "volterra.coloured_input" in codes(raw.report.warnings)
    assert raw.report.details["input_whiteness"] < 0.1
    for other in ({"smoothing": 8.0}, {"downsample": 3}, {"method": "regularised"}):
        model = Volterra.from_options({"memory": 0.04, "downsample": 1, "method": "exact"} | other).fit(record)
        assert "volterra.coloured_input" not in codes(model.report.warnings), other
    white = Volterra(memory=0.04, method="exact").fit(simulated_cascades.wiener(16, snr_db=30.0).record)
    assert white.report.details["input_whiteness"] > 0.9
    assert codes(white.report.warnings) == ["second_order.explains_less"]


def test_smoothing_filters_the_second_kernel_and_keeps_the_rest():
    record = simulated_cascades.wiener(17, cutoff_hz=150.0, snr_db=20.0).record
    options = {"memory": MEMORY, "method": "exact", "downsample": 1}
    model = Volterra.from_options(options | {"smoothing": 1.0}).fit(record)
    raw = Volterra.from_options(options).fit(record)
    np.testing.assert_array_equal(model.unfiltered.kernel2, raw.kernel2)
    np.testing.assert_array_equal(model.kernel1, raw.kernel1)
    np.testing.assert_allclose(model.kernel2, model.kernel2.T, atol=1e-9 * np.max(np.abs(model.kernel2)))
    assert model.kernel2.sum() == pytest.approx(raw.kernel2.sum(), rel=1e-6)
    assert np.linalg.norm(np.diff(model.kernel2, axis=0)) < 0.2 * np.linalg.norm(np.diff(raw.kernel2, axis=0))
    assert model.report.vaf_percent < raw.report.vaf_percent
    assert model.report.details["vaf_unfiltered_percent"] == raw.report.vaf_percent
    assert raw.unfiltered is None


def test_the_filter_is_that_of_c_3_1():
    """A window of 15 x 15 lags with a standard deviation of one lag and a sum of one, mirrored at the borders."""
    place = np.arange(-7, 8)
    window = np.exp(-0.5 * (place[:, None] ** 2 + place**2))
    window /= window.sum()
    kernel = simulated.generator(5).standard_normal((21, 21))
    mirrored = np.pad(kernel, 7, mode="symmetric")
    expected = signal.convolve(mirrored, window, mode="valid")
    np.testing.assert_allclose(smoothed(kernel, 1.0), expected, atol=1e-12)
    assert smoothed(kernel[:4, :4], 1.0).sum() == pytest.approx(kernel[:4, :4].sum())


def _coverage(runs: int, colour: float) -> tuple[float, float]:
    """Shares of the lags of both kernels whose 95 % interval holds them, with the exact method."""
    first, second = [], []
    for run in range(runs):
        rng = simulated.generator(18, run)
        h = simulated_cascades.impulse_response()[:15]
        x = rng.standard_normal(3000)
        z = np.convolve(x, h)[:3000]
        y = z - 0.1 * z**2
        model = Volterra(memory=0.03, downsample=1, method="exact").fit(
            Record(x, y + simulated.noise(rng, y, 20.0, colour), 500.0)
        )
        kernels, step = model.per_lag, 1.0 / 500.0
        slope = h - 0.2 * h.sum() * model.input_mean * h
        first.append(np.abs(kernels.first - slope) < 1.96 * model.kernel1_std * step)
        triangle = np.triu_indices(15)
        off = np.abs(kernels.second + 0.1 * np.outer(h, h)) < 1.96 * model.kernel2_std * step**2
        second.append(off[triangle])
    return float(np.mean(first)), float(np.mean(second))


@pytest.mark.parametrize("colour", [pytest.param(0.0, marks=pytest.mark.soak), 0.9])
def test_intervals_hold_the_kernels(colour: float):
    first, second = _coverage(12, colour)
    assert 0.88 < first <= 1.0
    assert 0.91 < second < 0.98


@pytest.mark.soak
@pytest.mark.parametrize("colour", [0.0, 0.9], ids=["white", "coloured"])
def test_coverage_over_200_runs(colour: float):
    first, second = _coverage(200, colour)
    print(f"\nnoise colour {colour}: {100 * first:.1f} % of h1, {100 * second:.1f} % of h2")
    assert 0.91 < first < 0.98
    assert 0.91 < second < 0.98


def test_order_zero_is_the_mean():
    record = simulated.linear_record(19)
    model = Volterra(order=0).fit(record)
    assert model.kernel0 == pytest.approx(float(np.mean(record.output[model.memory_samples - 1 :])))
    assert model.kernel1 is None
    np.testing.assert_array_equal(model.simulate(record.input), np.full(8000, model.kernel0))
    assert model.report.vaf_percent == pytest.approx(0.0)
    assert "mass_kg" not in model.report.parameters


def _noise(n: int) -> Array:
    return simulated.generator(20).standard_normal(n)


@pytest.mark.parametrize(
    ("options", "record", "refusal"),
    [
        (
            {},
            Record(_noise(100), _noise(100), 2000.0),
            Refusal("record.shorter_than_memory", memory=0.06, seconds=0.05),
        ),
        (
            {"method": "exact", "downsample": 3},
            Record(_noise(900), _noise(900), 2000.0),
            Refusal("record.too_few_samples", count=783, parameters=861),
        ),
        (
            {"method": "exact", "memory": 0.1, "downsample": 1},
            Record(_noise(40000), _noise(40000), 2000.0),
            Refusal("volterra.too_many_coefficients", coefficients=20301),
        ),
    ],
)
def test_what_cannot_be_fitted_is_refused(options: dict[str, object], record: Record, refusal: Refusal):
    with pytest.raises(UnusableInputError, check=refusal.check):
        Volterra.from_options(options).fit(record)


def test_rows_that_were_thrown_away_are_missed():
    record = simulated.linear_record(22)
    engine = Volterra(method="exact", downsample=3, rows="downsampled")
    refused(lambda: engine.fit(record[:2500]), "volterra.too_few_rows", rows=795, parameters=861)
    few = engine.fit(record[:5000]).report
    assert any(says(text, "volterra.few_rows", rows=1628, parameters=861) for text in few.warnings)


@pytest.mark.parametrize("options", [{"method": "laguerre"}, {"order": 3}, {"method": "laguerre", "order": 3}])
def test_lean_routes_come_through_the_same_engine(options: dict[str, object]):
    system = simulated_cascades.wiener(23, n=1500, snr_db=30.0)
    model = Volterra.from_options({"memory": 0.04, "downsample": 1} | options).fit(system.record)
    h = system.impulse_response[:20]
    assert model.kernel1_std is not None
    assert model.kernel2_std is not None
    assert (model.kernel3 is not None) == (model.order == 3)
    assert alike(model.kernel1, h) > 0.99
    assert alike(model.kernel2, -np.outer(h, h)) > 0.97
    assert model.report.vaf_percent > 97.0
    assert 10 < model.report.n_parameters < 300


def test_a_memory_shorter_than_the_response_gives_a_warning():
    record = simulated.linear_record(24)
    short = Volterra(memory=0.012, downsample=1, order=1).fit(record).report
    assert "impulse_response.short_memory" in codes(short.warnings)
    assert "impulse_response.short_memory" not in codes(Volterra().fit(record).report.warnings)


def test_fewer_than_three_samples_a_parameter_warns():
    record = simulated.linear_record(21)[:1500]
    report = Volterra(method="exact", downsample=3).fit(record).report
    assert {"record.few_samples", "volterra.few_rows"} & set(codes(report.warnings))


@pytest.mark.skipif(not RIG.is_dir(), reason="the independent rig's sessions are not here")
def test_held_out_simulation_on_the_rig():
    from tissueid.sessions import read_session

    for number in (2, 8, 20):
        record = read_session(RIG / f"rig-{number:03d}.h5").test(None).record("force", "position")
        cut = round(0.75 * len(record))
        for method in ("exact", "regularised"):
            model = validated(Volterra(method=method).fit(record, slice(0, cut)), record, slice(cut, None))
            assert model.report.vaf_validation_percent > 97.0
