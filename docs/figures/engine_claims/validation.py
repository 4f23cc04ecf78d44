"""Validation: size and power of the residual tests, prediction, distortion, repeats and bootstrap."""

from __future__ import annotations

import numpy as np
from identification import simulated, test_bootstrap, test_distortion
from identification import simulated_validation as systems
from identification.test_prediction import noisy
from outside_data import REAL, RIG
from scipy import io

from engine_claims.base import Claim
from tissueid.identification import validate
from tissueid.identification.engines.lms import Lms
from tissueid.identification.validation.bootstrap import bootstrap
from tissueid.identification.validation.distortion import distortion
from tissueid.identification.validation.prediction import fit_noise, prediction_curve
from tissueid.identification.validation.repeats import ceiling
from tissueid.identification.validation.residual_tests import MEANINGS, residual_tests
from tissueid.records import Record
from tissueid.sessions import read_session

RUNS = 100


def claims() -> list[Claim]:
    """Each figure of the section on validation that can be had in a minute."""
    return [*_sizes(), *_power(), _prediction(), *_distortion(), *_circuit(), *_repeats(), _bootstrap()]


def _sizes() -> list[Claim]:
    """Rejections at 5 % of right models, all tests together, and the worst of the tests."""
    found: dict[str, list[bool]] = {name: [] for name in MEANINGS}
    for low_pass in (False, True):
        for pole in (0.0, 0.9):
            for run in range(RUNS):
                record = systems.record(200, run, int(low_pass), round(10 * pole), n=6000, low_pass=low_pass, pole=pole)
                model = systems.PlainFir().fit(record, slice(0, 4500))
                for test in residual_tests(model, record, slice(4500, None)).tests:
                    if test.name != "autocorrelation" or pole == 0.0:
                        found[test.name].append(test.passed is False)
    sizes = {name: 100.0 * float(np.mean(rejected)) for name, rejected in found.items()}
    everything = 100.0 * float(np.mean(np.concatenate([np.array(rejected) for rejected in found.values()])))
    low, high = min(sizes.values()), max(sizes.values())
    error = 100.0 * float(np.sqrt(0.05 * 0.95 / (4 * RUNS)))
    return [
        Claim(
            f"size of the residual tests at 5 %, held-out, white and coloured noise and input ({4 * RUNS} records)",
            "3.5 to 6.5 % of all, each test within three standard errors of 5 %",
            f"{everything:.1f} % of all; {low:.1f} to {high:.1f} % by test",
            3.5 <= everything <= 6.5 and low >= 5.0 - 3.0 * error and high <= 5.0 + 3.0 * error,
        )
    ]


def _power() -> list[Claim]:
    """What a linear model of a Wiener system is found out by."""
    caught = 0
    for run in range(10):
        record = simulated.wiener_record(201, run)
        model = Lms().fit(record, slice(0, 6000))
        caught += int(residual_tests(model, record, slice(6000, None))["squared_output"].passed is False)
    return [
        Claim(
            "lms on a Wiener system at 30 dB fails the test of the squared depth",
            "always",
            f"{caught} of 10",
            caught == 10,
        )
    ]


def _prediction() -> Claim:
    record = noisy(202)
    model = systems.PlainFir().fit(record, slice(0, 15000))
    curve = prediction_curve(
        model, record, fit_noise(model, record, slice(0, 15000)), [1, 2, 4, 8, 16, 32], slice(15000, None)
    )
    worst = 100.0 * float(np.max(np.abs(curve.error_std / curve.expected_error_std - 1.0)))
    return Claim(
        "prediction error 1 to 32 samples ahead against its theory",
        "equal within 5 %",
        f"worst {worst:.1f} %; VAF {curve.vaf_percent[0]:.1f} % one ahead, {curve.free_run_vaf_percent:.1f} % free run",
        worst <= 5.0,
    )


def _distortion() -> list[Claim]:
    claimed = []
    linear = test_distortion.response()
    for phases in (1, 8):
        even, odd = test_distortion.truth(linear, phases)
        found = distortion(test_distortion.recorded(phases))
        assert found.even_rms is not None
        assert found.odd_rms is not None
        off = [
            test_distortion.decibels(found.even_rms.value / even),
            test_distortion.decibels(found.odd_rms.value / odd),
        ]
        claimed.append(
            Claim(
                f"error of even and odd distortion of a known system, three periods of {phases} realisation(s)",
                "within 1 dB",
                f"{off[0]:+.2f} and {off[1]:+.2f} dB",
                max(abs(value) for value in off) <= 1.0,
            )
        )
    return claimed


def _circuit() -> list[Claim]:
    path = REAL / "SNLS80mV.mat"
    if not path.exists():
        return []
    data = io.loadmat(path)
    u, y = data["V1"].ravel(), data["V2"].ravel()
    starts = [40580 + 8693 * k for k in range(9)]
    found = distortion([Record(u[s : s + 8585], y[s : s + 8585], 1e7 / 2**14) for s in starts])
    noise, even, odd = (found.relative_db(level) for level in (found.noise_rms, found.even_rms, found.odd_rms))
    assert noise is not None
    assert even is not None
    assert odd is not None
    return [
        Claim(
            "an electronic hardening spring: noise, even, odd distortion relative to the output",
            "odd far above even",
            f"{noise:.1f}, {even:.1f}, {odd:.1f} dB (period {found.period} found)",
            odd > even + 20.0 and found.period == 8192,
        )
    ]


def _repeats() -> list[Claim]:
    path = RIG / "rig-002.h5"
    if not path.exists():
        return []
    session = read_session(path)
    first, second = (session.test(number).record("force", "position") for number in (2, 3))
    cut = round(0.75 * len(first))
    found = ceiling([first, second], slice(cut, None))
    reached = validate(Lms().fit(first, slice(0, cut)), first, slice(cut, None)).vaf_percent
    return [
        Claim(
            "rig-002, held out: VAF limit from repeats, and VAF of lms",
            "limit above the VAF of every model",
            f"{found.vaf_percent.value:.3f} % (noise {1e6 * found.noise_rms.value:.1f} um), lms {reached:.1f} %",
            found.vaf_percent.value > reached,
        )
    ]


def _bootstrap() -> Claim:
    held = test_bootstrap.covered(40, 100, lambda run: test_bootstrap.fir_record(203, run), "residuals")
    record = test_bootstrap.fir_record(204, n=4000)
    engine = Lms(memory=0.015)
    bands = bootstrap(engine, record, None, lambda model: model.impulse_response, 40)  # type: ignore[attr-defined]
    ratio = float(np.mean(bands.std / engine.fit(record).impulse_response_std))
    return Claim(
        "coverage of 95 % bootstrap bands of a kernel, coloured noise; ratio of their standard deviation to the "
        "analytic one of lms",
        "90 to 98 %; 0.9 to 1.1",
        f"{held:.1f} %; {ratio:.2f}",
        90.0 <= held <= 98.0 and 0.9 <= ratio <= 1.1,
    )
