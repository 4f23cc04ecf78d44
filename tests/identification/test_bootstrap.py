"""Bootstrap bands and Bode bands: what they hold, against the spread of repeats and against the analytic ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from coded import coded, refused
from identification import simulated
from identification import simulated_validation as systems

from tissueid.errors import CancelledError, UnusableInputError
from tissueid.identification import Model
from tissueid.identification.engines.lms import Lms, LmsModel
from tissueid.identification.validation.bootstrap import Bands, Method, bootstrap
from tissueid.records import Record

SHORT = systems.PlainFir(lags=15)


def fir_record(*seed: int, n: int = 3000, pole: float = 0.8, low_pass: bool = False, slanted: bool = False) -> Record:
    """The first fifteen lags of the kernel, with noise that may follow the input's size."""
    rng = simulated.generator(*seed)
    u = systems.force(rng, n, low_pass)
    e = systems.coloured(rng, u.size, pole)
    if slanted:
        e = rng.standard_normal(u.size) * np.abs(u)
    y = np.convolve(u, systems.KERNEL[:15])[: u.size] + 0.5 * e
    return Record(u[systems.WARM :], y[systems.WARM :], systems.RATE)


def kernel(model: Model) -> np.ndarray:
    assert isinstance(model, systems.Fir)
    return model.kernel


def covered(runs: int, n: int, make: Callable[[int], Record], method: Method) -> float:
    """Share of the true lags that 95 % bands hold."""
    held = []
    for run in range(runs):
        record = make(run)
        bands = bootstrap(SHORT, record, slice(0, len(record)), kernel, n, run, method=method)
        held.append((bands.low <= systems.KERNEL[:15]) & (systems.KERNEL[:15] <= bands.high))
    return 100.0 * float(np.mean(held))


@pytest.mark.parametrize("method", ["residuals", "blocks"])
def test_bands_hold_the_truth(method: Method):
    assert covered(12, 60, lambda run: fir_record(120, run, n=1500), method) == pytest.approx(93.0, abs=5.0)


def test_only_whole_blocks_know_that_noise_follows_the_input():
    record = fir_record(121, n=4000, slanted=True)
    spread = np.std([SHORT.fit(fir_record(122, k, n=4000, slanted=True)).kernel[0] for k in range(60)], ddof=1)
    blocks, residuals = (
        bootstrap(SHORT, record, slice(0, 4000), kernel, 60, method=m) for m in ("blocks", "residuals")
    )
    assert blocks.std[0] == pytest.approx(spread, rel=0.3)
    assert residuals.std[0] < 0.8 * spread


@pytest.mark.soak
@pytest.mark.timeout(3000)
@pytest.mark.parametrize("method", ["residuals", "blocks"])
@pytest.mark.parametrize("pole", [0.0, 0.9])
def test_coverage_is_that_of_the_level(method: Method, pole: float):
    held = covered(150, 200, lambda run: fir_record(123, run, pole=pole), method)
    print(method, pole, held)
    assert 91.0 <= held <= 97.0


def test_bands_agree_with_the_analytic_ones_of_lms():
    record = fir_record(124, n=4000)
    engine = Lms(memory=0.015)

    def lms_kernel(model: Model) -> np.ndarray:
        assert isinstance(model, LmsModel)
        return model.impulse_response

    bands = bootstrap(engine, record, None, lms_kernel, 30)
    model = engine.fit(record)
    assert np.mean(bands.std / model.impulse_response_std) == pytest.approx(1.0, abs=0.2)
    np.testing.assert_array_equal(bands.estimate, model.impulse_response)


def test_parameters_have_bands_too():
    record = simulated.linear_record(125, snr_db=20.0)[:4000]
    names = ("mass_kg", "damping_n_s_per_m", "stiffness_n_per_m")
    engine = Lms(memory=0.06)
    bands = bootstrap(engine, record, None, lambda m: np.array([m.report.parameters[n].value for n in names]), 25)
    reported = [engine.fit(record).report.parameters[name].std for name in names]
    np.testing.assert_allclose(bands.std, np.array(reported, dtype=float), rtol=0.5)


def test_draws_follow_from_the_seed_alone():
    record = fir_record(126)

    def draw(seed: int) -> Bands:
        return bootstrap(SHORT, record, slice(0, 2000), kernel, 5, seed)

    np.testing.assert_array_equal(draw(1).draws, draw(1).draws)
    assert not np.array_equal(draw(1).draws, draw(2).draws)


@pytest.mark.parametrize("method", ["residuals", "blocks"])
def test_gaps_stay_gaps(method: Method):
    record = fir_record(127)
    # depends on inputs that were not recorded
    u = simulated.changed(record.input, (np.s_[1000:1010], np.nan))
    y = simulated.changed(record.output, (np.s_[1000:1010], np.nan), (np.s_[1010:1024], 1e3))
    bands = bootstrap(SHORT, Record(u, y, systems.RATE), slice(0, 3000), kernel, 40, method=method)
    assert np.all(bands.std < 0.1)
    assert bands.draws.shape == (40, 15)
    assert bands.refused == 0


def test_progress_is_reported_and_cancelling_ends_it():
    steps: list[tuple[int, int]] = []
    record = fir_record(128)
    bootstrap(SHORT, record, slice(0, 3000), kernel, 4, progress=lambda done, of: steps.append((done, of)))
    assert steps == [(1, 4), (2, 4), (3, 4), (4, 4)]
    with pytest.raises(CancelledError, check=coded("bootstrap.cancelled", done=2, draws=9)):
        asked = iter([False, False, True])
        bootstrap(SHORT, record, slice(0, 3000), kernel, 9, cancelled=lambda: next(asked))


def test_refusals_are_one_line():
    record = fir_record(129)
    part = slice(0, 3000)
    refused(lambda: bootstrap(SHORT, record, part, kernel, 1), "bootstrap.arguments")
    refused(
        lambda: bootstrap(SHORT, record, part, kernel, 5, block=1.0), "bootstrap.few_blocks", fewest=5, samples=1000
    )
    holed = replace(record, output=np.where(np.arange(3000) % 40 == 0, np.nan, record.output))
    refused(lambda: bootstrap(SHORT, holed, part, kernel, 5, block=0.1), "bootstrap.gaps")


class Fussy(systems.PlainFir):
    """Refuses every record but the first."""

    def fit(self, record: Record, fit_part: slice | None = None) -> systems.Fir:
        if not np.array_equal(record.output, fir_record(130).output):
            raise UnusableInputError("no")
        return super().fit(record, fit_part)


def test_an_engine_that_refuses_most_draws_is_refused():
    refused(
        lambda: bootstrap(Fussy(lags=15), fir_record(130), slice(0, 3000), kernel, 20), "bootstrap.refused", reason="no"
    )
