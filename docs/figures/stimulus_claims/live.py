"""Live identification: the engines' answer while a test runs, what it costs, and intervals that hold where it stops."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
from engine_claims.base import Claim
from firmware_sim_process import firmware_process

from firmware_sim.bench import Bench
from tissueid.acquisition.guided import play
from tissueid.acquisition.live import LiveIdentification
from tissueid.device import DeviceDescription
from tissueid.identification.engines.lms import Lms
from tissueid.identification.live.live_view import METHODS, Method, start_identifier, view
from tissueid.identification.live.sliding import SlidingLms
from tissueid.identification.live.stopping import PARAMETERS, Precision, StopRule, precision
from tissueid.instrument import CLINICAL, SAMPLE, SerialInstrument, SerialLink
from tissueid.records import Record
from tissueid.stimuli.base import to_voltage, with_preload
from tissueid.stimuli.kinds.noise import Noise

RATE = 2000.0
DEVICE = DeviceDescription()
PRESET = "left-posterior-forearm"
PRELOAD = 1000
SECONDS = 4.0
VOLTS_PER_NEWTON = 4.0

STOPPED = ("upper-arm", "linear-demo")
LOOSER = (1.3, 2.5)
"""Targets, in what 4 s of the same noise give."""
RUNS = 150
LONG_RUNS, LONG_S = 10, 20.0
LOOKS_S = np.arange(0.5, SECONDS + 0.01, 0.25)
TIMED_RUNS = 3


def claims() -> Iterator[Claim]:
    """Agreement, cost, effect on acquisition, and coverage at the stopping time."""
    record = _record(PRESET, 1, SECONDS)
    yield _window(record)
    yield from _last_view(record)
    yield from _cost(record)
    yield from _beside_a_run()
    for preset in STOPPED:
        yield _stopped(preset)


def _record(preset: str, seed: int, seconds: float) -> Record:
    """Measured force and position under Gaussian noise of 0.5 to 10.5 N after a preload, which is cut off."""
    noise = Noise(force_min_n=0.5, force_max_n=10.5, seconds=seconds, seed=seed).build().values
    bench = Bench(preset, seed=seed)
    command = np.concatenate([np.full(PRELOAD, noise.mean()), noise]) * VOLTS_PER_NEWTON
    codes = bench.block(command, energised=True).codes[PRELOAD:]
    values = {channel.name: channel.decode(codes[:, k]) for k, channel in enumerate(bench.channels)}
    return Record(DEVICE.force_constant_n_per_a * values["current"], values["position"], RATE)


def _apart(ours: np.ndarray, theirs: np.ndarray) -> float:
    return float(np.linalg.norm(ours - theirs) / np.linalg.norm(theirs))


def _window(record: Record) -> Claim:
    """A window of 2 s that slides over the record, its response against a fresh fit at every quarter of a second."""
    sliding = SlidingLms(Lms(), RATE, 2.0)
    worst = 0.0
    for first in range(0, len(record), 500):
        some = slice(first, first + 500)
        sliding.batch(record.input[some], record.output[some])
        begin = max(0, some.stop - 4000)
        worst = max(worst, _apart(sliding.impulse_response, Lms().fit(record[begin : some.stop]).impulse_response))
    return Claim(
        "sliding LMS against a fresh fit of the same window, 250 lags, 16 windows",
        "1e-7",
        f"{worst:.0e}",
        worst < 1e-7,
    )


def _samples(record: Record) -> np.ndarray:
    samples = np.zeros(len(record), SAMPLE)
    samples["index"] = np.arange(len(record))
    samples["current"] = record.input / DEVICE.force_constant_n_per_a
    samples["position"] = record.output
    return samples


def _last_view(record: Record) -> Iterator[Claim]:
    """The last view of a test against the engine on the whole record."""
    live = LiveIdentification(DEVICE, separate_process=False)
    samples = _samples(record)
    for first in range(0, samples.size, 100):
        live.feed(samples[first : first + 100])
        live.step()
    live.close()
    shown, model = live.latest(), Lms().fit(record)
    assert shown is not None
    response = _apart(shown.impulse_response, model.impulse_response)
    yield Claim("last view against lms on the whole record: response", "1e-7", f"{response:.0e}", response < 1e-7)
    expected = (model.report.parameters[name] for name in ("mass_kg", "damping_n_s_per_m", "stiffness_n_per_m"))
    apart = max(
        abs(ours.value - theirs.value) / (theirs.std or np.nan)
        for ours, theirs in zip(shown.parameters.values(), expected, strict=True)
    )
    yield Claim(
        "the same: mass, damping and stiffness, in their standard deviations", "1e-3", f"{apart:.0e}", apart < 1e-3
    )


def _cost(record: Record) -> Iterator[Claim]:
    """Processor time of four looks a second, in that of one core."""
    samples = _samples(record)
    for method in METHODS:
        shares, longest_s = [], 0.0
        for _ in range(TIMED_RUNS):
            live = LiveIdentification(DEVICE, method=method, separate_process=False)
            feeding = []
            for first in range(0, samples.size, 20):
                begin = time.perf_counter()
                live.feed(samples[first : first + 20])
                feeding.append(time.perf_counter() - begin)
                live.step()
            shares.append(100.0 * live.busy_s / SECONDS)
            longest_s = max(longest_s, float(np.median(feeding)))
        share = float(np.median(shares))
        yield Claim(
            f"live identification by {method}, four looks a second: share of a core",
            "20 %",
            f"{share:.0f} %",
            share < 20,
        )
    yield Claim(
        "handing 20 samples over, within the loop that polls, median",
        "0.2 ms",
        f"{1e3 * longest_s:.2f} ms",
        longest_s < 2e-4,
    )
    yield _view_time(record)


def _view_time(record: Record) -> Claim:
    identifier = start_identifier("sliding", RATE)
    identifier.batch(record.input[:4000], record.output[:4000])
    view(identifier)
    seconds = []
    for first in range(4000, len(record), 500):
        some = slice(first, first + 500)
        identifier.batch(record.input[some], record.output[some])
        begin = time.thread_time()
        view(identifier)
        seconds.append(time.thread_time() - begin)
    took = 1e3 * float(np.median(seconds))
    begin = time.thread_time()
    precision(record)
    fit = 1e3 * (time.thread_time() - begin)
    return Claim(
        "one view; mass, damping and stiffness of 4 s at 2 kHz",
        "20 ms; 50 ms",
        f"{took:.0f} ms; {fit:.0f} ms",
        took < 20 and fit < 50,
    )


def _beside_a_run() -> Iterator[Claim]:
    """How late samples reach the loop, in real time over a socket, with and without it, in turn."""
    late: dict[str | None, list[tuple[float, float, float]]] = {None: [], "sliding": [], "rls": []}
    for _ in range(TIMED_RUNS):
        for method, found in late.items():
            found.append(_lateness(method))  # type: ignore[arg-type]
    without, *others = (np.median(found, axis=0) for found in late.values())
    worst = np.max(others, axis=0)
    yield Claim(
        f"real-time run of 4 s: latest sample, median of {TIMED_RUNS} (without live identification)",
        f"within 10 ms of {without[0]:.0f} ms",
        f"{worst[0]:.0f} ms ({without[0]:.0f} ms)",
        bool(worst[0] < without[0] + 10.0),
    )
    yield Claim(
        "the same: 99 % of the samples",
        f"within 5 ms of {without[1]:.0f} ms",
        f"{worst[1]:.0f} ms ({without[1]:.0f} ms)",
        bool(worst[1] < without[1] + 5.0),
    )
    yield Claim(
        "the same: processor time of the process that polls",
        "within 5 % of a core",
        f"{worst[2]:.1f} % ({without[2]:.1f} %)",
        bool(worst[2] < without[2] + 5.0),
    )


def _lateness(method: Method | None) -> tuple[float, float, float]:
    """Greatest and 99th percentile of how late samples came, ms, and the share of a core that this process took, %."""
    with firmware_process("--tcp=0") as (url, _), SerialInstrument(SerialLink(url)) as instrument:
        stimulus = with_preload(Noise(seconds=SECONDS, force_min_n=1.0, force_max_n=6.0, seed=1).build())
        live = None if method is None else LiveIdentification(instrument.device, preload_s=0.5, method=method)
        arrivals: list[tuple[float, float]] = []

        def take(samples: np.ndarray, _fraction: float) -> None:
            if samples.size:
                arrivals.append((time.perf_counter(), float(samples["index"][-1]) / RATE))
                if live is not None:
                    live.feed(samples)

        begin = time.process_time()
        play(instrument, to_voltage(stimulus.values, instrument.device), CLINICAL, on_samples=take)
        share = 100.0 * (time.process_time() - begin) / stimulus.seconds
        if live is not None:
            live.close()
            assert not live.problem, live.problem
        came, due = np.array(arrivals).T
        late = 1e3 * (came - due)
        late -= np.percentile(late, 1.0)
        return float(late.max()), float(np.percentile(late, 99.0)), share


def _stopped(preset: str) -> Claim:
    """Share of 95 % intervals, at the look that ended a test, that hold what much longer tests find."""
    truth = np.mean([_logarithms(precision(_record(preset, 9000 + k, LONG_S))) for k in range(LONG_RUNS)], axis=0)
    courses = [_course(_record(preset, seed, SECONDS)) for seed in range(1, RUNS + 1)]
    at_the_end = {name: float(np.median([course[-1].relative_std[name] for course in courses])) for name in PARAMETERS}
    named = [{name: share} for name, share in at_the_end.items()] + [at_the_end]
    targets = [{name: looser * share for name, share in rule.items()} for rule in named for looser in LOOSER]
    careful, seconds = _held([StopRule(targets=rule) for rule in targets], courses, truth)
    hasty, _ = _held([StopRule(targets=rule, looks=1, min_seconds=0.5) for rule in targets], courses, truth)
    worst = int(np.argmin(careful))
    return Claim(
        f"{preset}, {RUNS} tests, {len(targets)} rules that end them after {min(seconds):.2g} to {max(seconds):.2g} s: "
        f"95 % intervals that hold where the test stops, worst parameter ({PARAMETERS[worst]}); where it stops at the "
        "first look that pleases",
        "93 %",
        f"{careful[worst]:.1f} %; {hasty[worst]:.1f} %",
        bool(careful[worst] >= 93.0),
    )


def _held(rules: list[StopRule], courses: list[list[Precision]], truth: np.ndarray) -> tuple[np.ndarray, list[float]]:
    """Share in percent, for each parameter, of the intervals that hold, over all rules, and each rule's median time."""
    held, seconds = [], []
    for rule in rules:
        stopped = [_until(rule, course) for course in courses]
        seconds.append(float(np.median([look.seconds for look in stopped])))
        errors = np.array([_logarithms(look) for look in stopped]) - truth
        std = np.array([[look.relative_std[name] for name in PARAMETERS] for look in stopped])
        held.append(100.0 * np.mean(np.abs(errors) < 1.96 * std, axis=0))
    return np.mean(held, axis=0), seconds


def _logarithms(look: Precision) -> np.ndarray:
    return np.log([look.estimates[name].value for name in PARAMETERS])


def _course(record: Record) -> list[Precision]:
    return [precision(record[: round(at * RATE)]) for at in LOOKS_S]


def _until(rule: StopRule, course: list[Precision]) -> Precision:
    return next((course[k - 1] for k in range(1, len(course)) if rule.enough(course[:k])), course[-1])
