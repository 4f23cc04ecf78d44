"""Records of other systems and recorders: white or held inputs, dead times, slow tanks, fast circuits."""

from functools import cache
from typing import ClassVar

import numpy as np
import pytest
from scipy import signal

from firmware_sim.bench import Bench
from firmware_sim.local_values import local_values
from tests.coded import refused
from tests.identification import simulated
from tests.plant_support import VOLTS_PER_NEWTON, preloaded
from tissueid.analysis.comparison import compare, specifications
from tissueid.analysis.fitting import fit_split
from tissueid.analysis.split import split_records
from tissueid.identification.base import Engine, Model
from tissueid.identification.engines import cascade
from tissueid.identification.memory import LONGEST_SAMPLES, automatic_memory
from tissueid.identification.registry import get_engine
from tissueid.messages import code_of
from tissueid.records import Record
from tissueid.stimuli.kinds.noise import Noise


def volts(u: np.ndarray, y: np.ndarray, rate: float) -> Record:
    return Record(u, y, rate, "drive", "response", "V", "V")


def held_white(n: int, seed: int = 5) -> tuple[np.ndarray, np.ndarray]:
    """White input held between samples, and the response of 60 Hz, damping ratio 0.2, at 2 kHz."""
    w, zeta = 2.0 * np.pi * 60.0, 0.2
    system = ([[0.0, 1.0], [-w * w, -2.0 * zeta * w]], [[0.0], [1.5 * w * w]], [[1.0, 0.0]], [[0.0]])
    a, b, c, d, _ = signal.cont2discrete([np.array(part) for part in system], 1.0 / 2000.0)
    numerator, denominator = signal.ss2tf(a, b, c, d)
    u = np.random.default_rng(seed).standard_normal(n)
    return u, signal.lfilter(numerator[0], denominator, u)


def noisy(y: np.ndarray, share: float = 0.05, seed: int = 6) -> np.ndarray:
    return y + share * y.std() * np.random.default_rng(seed).standard_normal(y.size)


@cache
def bent_white() -> Record:
    u, v = held_white(8000)
    return volts(u, noisy(v + 0.3 * v**2), 2000.0)


# -- white inputs ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("method", "least"),
    [
        ("laguerre", 99.0),
        # 2926 coefficients from 6000 samples of 5 % noise: the memory is shortened, with a warning.
        ("exact", 98.5),
        pytest.param("regularised", 99.5, marks=pytest.mark.soak),
    ],
)
def test_kernels_leave_no_sample_of_a_white_input_out(method: str, least: float):
    found = fit_split(get_engine("volterra").from_options({"method": method}), split_records([bent_white()])).model
    assert found.report.details["lag_spacing"] == 1.0
    assert found.report.vaf_validation_percent > least
    shortened = "volterra.memory_shortened" in map(code_of, found.report.warnings)
    assert shortened == (method == "exact")
    assert "structure.linear" not in map(code_of, found.report.findings)


@pytest.mark.parametrize("name", ["lms", "wiener"])
def test_a_held_input_is_recognised(name: str):
    u, y = held_white(20_000)
    found = get_engine(name).from_options({}).fit(volts(u, noisy(y), 2000.0)).report
    assert found.options["hold"] == "zero-order"
    frequency, ratio = found.parameters["natural_frequency_rad_per_s"], found.parameters["damping_ratio"]
    assert abs(frequency.value / (2.0 * np.pi) - 60.0) < 3.0 * frequency.std / (2.0 * np.pi) < 0.05
    assert abs(ratio.value - 0.2) < 3.0 * ratio.std


def test_a_hold_that_is_given_is_kept_and_its_misfit_is_stated():
    u, y = held_white(20_000)
    found = get_engine("lms").from_options({"hold": "band-limited"}).fit(volts(u, noisy(y), 2000.0)).report
    assert found.options["hold"] == "band-limited"
    assert "second_order.dead_time" in map(code_of, found.warnings)


# -- dead time ---------------------------------------------------------------------------------------------


@cache
def known_system() -> tuple[np.ndarray, np.ndarray]:
    """Force and position of 90 g, 20 N s/m, 4 kN/m at 2 kHz, without a discretisation error."""
    rng = np.random.default_rng(3)
    rate, n, fine = 2000, 8000, 8
    shape = signal.butter(6, 150.0 / (rate * fine / 2), output="sos")
    u = signal.sosfilt(shape, rng.standard_normal(n * fine + 8000))[8000:]
    u = 4.0 + 1.5 * u / u.std()
    y = signal.lsim(([1 / 0.09], [1.0, 20.0 / 0.09, 4000.0 / 0.09]), u - 4.0, np.arange(u.size) / (rate * fine))[1]
    return u[::fine], y[::fine] + 1e-3 + 2e-6 * rng.standard_normal(n)


@pytest.mark.parametrize("name", ["lms", "spectral", "rls", "als", "wiener"])
@pytest.mark.parametrize("late", [0, 1, 3, -2])
def test_a_late_channel_is_no_mass(name: str, late: int):
    u, y = known_system()
    first, end = max(late, 0), u.size + min(late, 0)
    record = Record(u[first:end], y[first - late : end - late], 2000.0)
    found = get_engine(name).from_options({}).fit(record).report
    assert found.parameters["mass_kg"].value == pytest.approx(0.09, rel=0.01)
    assert ("second_order.dead_time" in map(code_of, found.warnings)) == (late != 0)
    if late and name != "wiener":
        assert found.parameters["dead_time_s"].value == pytest.approx(late / 2000.0, abs=2e-5)


@pytest.mark.parametrize("name", ["dpn", "depth"])
def test_an_engine_without_dead_time_says_that_a_channel_is_late(name: str):
    u, y = known_system()
    record = Record(u[3:5003], y[:5000], 2000.0)
    options = {"mass_degree": 0, "damping_degree": 0, "stiffness_degree": 0} if name == "dpn" else {"correct": False}
    found = get_engine(name).from_options(options).fit(record).report
    assert "second_order.dead_time_left_out" in map(code_of, found.warnings)


def test_parameters_that_explain_less_than_the_response_say_so():
    rng = np.random.default_rng(1)
    u = rng.standard_normal(6000)
    two = signal.lfilter([0.02], [1.0, -1.9, 0.92], u) - 1.5 * signal.lfilter([0.02], [1.0, -1.2, 0.7], u)
    found = get_engine("lms").from_options({}).fit(volts(u, noisy(two, 0.01), 2000.0)).report
    assert found.vaf_percent > found.details["vaf_parametric_percent"] + 1.0
    assert "second_order.explains_less" in map(code_of, found.warnings)


# -- memory ------------------------------------------------------------------------------------------------


def tanks(seed: int = 0, n: int = 1024) -> Record:
    """Two tanks, one draining into the other, sampled every 4 s."""
    rng = np.random.default_rng(seed)
    u = np.clip(np.repeat(3.0 + 1.2 * rng.standard_normal(n // 8), 8), 0.5, 6.0)
    upper = lower = 3.0
    level = np.empty(n)
    for k in range(n):
        level[k] = lower
        for _ in range(4):
            flow = 0.05 * np.sqrt(max(upper, 0.0))
            upper += 0.03 * u[k] - flow
            lower += flow - 0.06 * np.sqrt(max(lower, 0.0))
    return volts(u, level + 0.02 * rng.standard_normal(n), 0.25)


@pytest.mark.parametrize("name", ["lms", "wiener", "spectral", "hammerstein"])
def test_a_tank_has_a_memory_of_minutes(name: str):
    found = get_engine(name).from_options({}).fit(tanks()).report
    assert 100.0 < found.options["memory"] < 1000.0
    assert found.vaf_percent > 85.0
    given = get_engine("lms").from_options({"memory": 200.0}).fit(tanks())
    assert given.memory_samples == 50


def test_a_fast_circuit_has_few_lags_and_a_cascade_ends():
    rng = np.random.default_rng(2)
    u = rng.standard_normal(6000)
    inside = signal.lfilter([0.1], [1.0, -0.9], u)
    y = signal.lfilter([0.2], [1.0, -0.8], inside + 0.3 * inside**2)
    record = volts(u, noisy(y, 0.01), 51_200.0)
    memory = automatic_memory(record, None, 0.06, 1.0)
    assert 16 <= round(memory * 51_200.0) <= 128
    found = get_engine("cascade").from_options({"degree": 2, "structure": "linear"}).fit(record)
    assert found.report.options["memory"] * 51_200.0 <= 256


def test_a_memory_is_limited_in_samples_and_not_in_seconds():
    refused(
        lambda: get_engine("lms").from_options({"memory": 30.0}).fit(simulated.linear_record(1, n=3000)),
        "record.memory_too_long",
        limit=LONGEST_SAMPLES,
    )


@pytest.mark.parametrize(("name", "memory"), [("lms", 0.125), ("wiener", 0.125), ("volterra", 0.06), ("depth", 0.06)])
def test_the_memory_of_tissue_is_what_it_was(name: str, memory: float):
    record = simulated.linear_record(1, n=3000)
    assert get_engine(name).from_options({}).for_record(record, None).options()["memory"] == memory


def test_a_cascade_says_what_it_left_out(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(cascade, "_MOST_ROWS_COMPARED", 1500)
    rng = np.random.default_rng(2)
    u = rng.standard_normal(4000)
    record = volts(u, noisy(signal.lfilter([0.1], [1.0, -0.9], u), 0.01), 51_200.0)
    found = get_engine("cascade").from_options({"degree": 1}).fit(record).report
    assert "cascade.part_compared" in map(code_of, found.warnings)


# -- failures ----------------------------------------------------------------------------------------------


def test_a_linear_record_with_little_noise_has_no_change_with_depth():
    rng = np.random.default_rng(1)
    u = 5.0 + 2.0 * rng.standard_normal(4000)
    y = 0.01 + signal.lfilter([2e-5], [1.0, -1.9, 0.92], u - 5.0) + 1e-6 * rng.standard_normal(4000)
    found = get_engine("depth").from_options({"partitions": 4}).fit(Record(u, y, 2000.0)).report
    assert found.parameters["stiffness_n_per_m"].value == pytest.approx(1000.0, rel=0.02)
    assert {code_of(text) for text in found.findings} == {"depth.constant"}


class Failing(Engine):
    """An engine of this package that fails with an exception of its option."""

    name: ClassVar[str] = "failing"
    error: str = "LinAlgError"

    def fit(self, record: Record, fit_part: slice | None = None) -> Model:
        raise {
            "LinAlgError": np.linalg.LinAlgError("singular matrix"),
            "ValueError": ValueError("array must not contain infs or NaNs"),
            "FloatingPointError": FloatingPointError("overflow"),
            "TypeError": TypeError("a defect"),
            "KeyError": KeyError("a defect"),
            "AttributeError": AttributeError("a defect"),
        }[self.error]


Failing.__module__ = "tissueid.identification.engines.failing"


@pytest.mark.parametrize("error", ["LinAlgError", "ValueError", "FloatingPointError"])
def test_a_numerical_failure_is_one_line_of_a_comparison(error: str):
    parts = split_records([simulated.linear_record(1, n=3000)])
    found = compare((*specifications(["lms"]), Failing(error=error)), parts)
    assert set(found.analyses) == {"lms"}
    reason = found.entries[1].refused
    assert code_of(reason) == "engine.not_computed"
    assert "\n" not in reason
    refused(lambda: Failing(error=error).fit(parts.record), "engine.not_computed", name="failing")


@pytest.mark.parametrize("error", ["TypeError", "KeyError", "AttributeError"])
def test_a_programming_error_surfaces(error: str):
    parts = split_records([simulated.linear_record(1, n=3000)])
    with pytest.raises((TypeError, KeyError, AttributeError), match="a defect"):
        compare((*specifications(["lms"]), Failing(error=error)), parts)


# -- effects that an engine cannot represent ---------------------------------------------------------------


def skin(seed: int, seconds: float) -> Record:
    """Force and position of the default tissue under uniform noise from 0 to 11 N."""
    noise = Noise(distribution="uniform", seed=seed, force_min_n=0.0, force_max_n=11.0, seconds=seconds).build()
    bench = Bench("left-posterior-forearm", seed=seed)
    codes = bench.block(preloaded(noise.values) * VOLTS_PER_NEWTON, energised=True).codes[1000:]
    values = {channel.name: channel.decode(codes[:, k]) for k, channel in enumerate(bench.channels)}
    return Record(3.0 * values["current"], values["position"], 2000.0)


@pytest.mark.parametrize(
    ("seed", "seconds"),
    [(3, 4.0), pytest.param(5, 8.0, marks=pytest.mark.soak), pytest.param(10, 8.0, marks=pytest.mark.soak)],
)
def test_damping_by_direction_is_no_change_with_depth(seed: int, seconds: float):
    found = get_engine("depth").from_options({}).fit(skin(seed, seconds))
    said = {text.values["name"]: code_of(text) for text in found.report.findings}
    assert said.get("damping") != "depth.falls"
    assert said.get("mass") != "depth.rises"
    profile = found.depth_profile()
    for row in range(len(profile)):
        true = local_values("left-posterior-forearm", float(profile.position[row]))
        for name, key in (("mass", "mass_kg"), ("damping", "damping_n_s_per_m"), ("stiffness", "stiffness_n_per_m")):
            away = getattr(profile, name)[row] - true[key]
            assert abs(away) < 3.0 * getattr(profile, f"{name}_std")[row]
