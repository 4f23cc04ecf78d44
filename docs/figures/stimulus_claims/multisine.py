"""Multisines: crest factors, silent lines, and noise, even and odd levels beside the truth."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import known_distortion as known
import numpy as np
from engine_claims.base import Claim

from firmware_sim.bench import Bench
from tissueid.device import DeviceDescription
from tissueid.identification.validation.distortion import distortion
from tissueid.records import Record
from tissueid.stimuli.base import to_voltage, with_preload
from tissueid.stimuli.kinds.multisine import Multisine, minimise_crest_factor, multisine_crest_factor, schroeder_phases
from tissueid.stimuli.stimulus_check import assess_stimulus

RANGE = {"force_min_n": known.LOW_N, "force_max_n": known.HIGH_N}
RANDOM = Multisine(phases="random", draws=20, **RANGE)
LOW_CREST = Multisine(draws=1, **RANGE)
SKIN = ("left-posterior-forearm", "left-anterior-forearm")


def claims() -> Iterator[Claim]:
    """What the stimulus itself promises, then what a record of it tells, then skin and coil of the simulation."""
    yield from _crest_factors()
    yield _silent()
    yield _single("random", RANDOM, 100, None)
    yield _single("random", RANDOM.model_copy(update={"period_s": 4.0}), 100, 0.95)
    yield _single("low-crest", LOW_CREST, 30, 0.95)
    yield from _several()
    yield from _skin()
    yield _warmth()


def _crest_factors() -> Iterator[Claim]:
    """Between the samples too; 31 lines are those of Guillaume et al. 1991."""
    lines, flat = np.arange(1, 32), np.ones(31)
    start = schroeder_phases(flat)
    reached = multisine_crest_factor(lines, flat, minimise_crest_factor(lines, flat, start, 512), 512)
    before = multisine_crest_factor(lines, flat, start, 512)
    yield Claim(
        "crest factor of 31 flat lines, begun with Schroeder's phases",
        "about 1.4",
        f"{reached:.3f} (Schroeder {before:.2f})",
        reached < 1.42,
    )
    for lined, most in (("full", "1.42"), ("odd", None), ("odd_random", None)):
        spec = Multisine.from_options({"lines": lined, "period_s": 1.0})
        found = spec.build().crest_factor
        schroeder, drawn = (spec.model_copy(update=u).build().crest_factor for u in _PLAINER)
        yield Claim(
            f"crest factor, {lined.replace('_', ' ')} lines to 200 Hz, period 1 s",
            f"at most {most}" if most else "below Schroeder's and the best of 20 random",
            f"{found:.2f} (Schroeder {schroeder:.2f}, best of 20 random {drawn:.2f})",
            found <= float(most) if most else found < min(schroeder, drawn),
        )


_PLAINER = ({"phases": "schroeder"}, {"phases": "random", "draws": 20})


def _silent() -> Claim:
    """Largest level on any line that is not driven, over the smallest driven one, in the command as it is played."""
    worst = 0.0
    for options in ({}, {"group": 4, "seed": 3}, {"notches": ((30.0, 50.0),)}, {"phases": "random", "seed": 9}):
        spec = LOW_CREST.model_copy(update=options)
        volts = to_voltage(spec.build().values, DeviceDescription())[-spec.period :]
        level = np.abs(np.fft.rfft(volts))
        driven = spec.driven_lines()
        undriven = np.setdiff1d(np.arange(1, level.size), driven)
        worst = max(worst, float(level[undriven].max() / level[driven].min()))
    decibels = known.decibels(worst)
    return Claim(
        "detection lines, even lines and notches in the command", "nothing", f"{decibels:.0f} dB", worst < 1e-12
    )


def _errors(played: Sequence[Multisine], linear: np.ndarray) -> tuple[float, float, float]:
    """Noise, even and odd levels of a record of each realisation over the truth of these phases, dB."""
    exact = known.truth(played, linear)
    spec = played[0]
    records = [known.recorded(one) for one in played]
    found = distortion(records, spec.period, spec.driven_lines().tolist(), spec.settling_s)
    levels = (found.noise_rms, found.even_rms, found.odd_rms)
    truths = (exact.noise, exact.even, exact.odd)
    noise, even, odd = (
        known.decibels(level.value / true) if level is not None and level.value > 0.0 else -np.inf
        for level, true in zip(levels, truths, strict=True)
    )
    return noise, even, odd


def _row(what: str, errors: np.ndarray, share: float | None) -> Claim:
    """``errors`` (sittings, 3) in dB; kept where the ``share`` of the sittings has each level within 1 dB.

    Without a share it is the root mean square over the sittings that is to be within 1 dB.
    """
    within = np.mean(np.abs(errors) <= 1.0, axis=0)
    rms = np.sqrt(np.mean(errors**2, axis=0))
    told = ", ".join(
        f"{name} {size:.2f} dB ({100.0 * part:.0f} % within 1 dB, worst {np.abs(column).max():.2f} dB)"
        for name, size, part, column in zip(("noise", "even", "odd"), rms, within, errors.T, strict=True)
    )
    asked = "within 1 dB" if share is None else f"{100.0 * share:.0f} % within 1 dB"
    kept = np.all(rms <= 1.0) if share is None else np.all(within >= share)
    return Claim(f"{what}, {len(errors)} times: root mean square error", asked, told, bool(kept))


def _single(phases: str, spec: Multisine, sittings: int, share: float | None) -> Claim:
    linear = known.linear_answer(spec, range(1000, 1040))
    errors = [_errors([spec.model_copy(update={"seed": seed})], linear) for seed in range(sittings)]
    seconds = spec.settling_s + spec.periods * spec.period / spec.sample_rate
    return _row(f"one realisation of {phases} phases, {seconds:g} s", np.array(errors), share)


def _several() -> Iterator[Claim]:
    """Six realisations against their own phases, and against the mean power of 200 others."""
    linear = known.linear_answer(RANDOM, range(1000, 1040))
    groups = [[RANDOM.model_copy(update={"seed": 6 * k + j}) for j in range(6)] for k in range(10)]
    yield _row("six realisations", np.array([_errors(group, linear) for group in groups]), 1.0)
    ensemble = known.truth([RANDOM.model_copy(update={"seed": seed}) for seed in range(2000, 2200)], linear)
    even, odd = [], []
    for group in groups:
        found = distortion([known.recorded(one) for one in group], RANDOM.period, RANDOM.driven_lines().tolist())
        assert found.even_rms is not None
        assert found.odd_rms is not None
        even.append(known.decibels(found.even_rms.value / ensemble.even))
        odd.append(known.decibels(found.odd_rms.value / ensemble.odd))
    yield Claim(
        "the same against 200 other sets of phases: median, worst",
        "median within 1 dB",
        f"even {np.median(even):+.2f}, {max(even, key=abs):+.2f} dB, odd {np.median(odd):+.2f}, "
        f"{max(odd, key=abs):+.2f} dB",
        abs(float(np.median(even))) <= 1.0 and abs(float(np.median(odd))) <= 1.0,
    )


def _measured(preset: str, spec: Multisine) -> tuple[Record, float]:
    """Force by current and position of a preset after the preload, and by how much the coil got warmer, K."""
    played = with_preload(spec.build())
    bench = Bench(preset, seed=1)
    codes = bench.block(to_voltage(played.values, DeviceDescription()), energised=True).codes
    values = {c.name: c.decode(codes[:, k]) for k, c in enumerate(bench.channels)}
    first = round(played.preload_s * played.sample_rate_hz)
    record = Record(3.0 * values["current"][first:], values["position"][first:], played.sample_rate_hz)
    return record, float(values["temperature"].max() - values["temperature"][:200].mean())


def _skin() -> Iterator[Claim]:
    """Levels relative to the output: what a test on skin shows. Nobody knows the truth; a linear tissue shows none."""
    for preset in (*SKIN, "linear-demo"):
        record, _ = _measured(preset, LOW_CREST)
        found = distortion(record, LOW_CREST.period, LOW_CREST.driven_lines().tolist(), LOW_CREST.settling_s)
        levels = [found.relative_db(level) for level in (found.noise_rms, found.even_rms, found.odd_rms)]
        told = ", ".join(
            f"{name} {'none' if level is None else f'{level:.1f} dB'}"
            for name, level in zip(("noise", "even", "odd"), levels, strict=True)
        )
        linear = preset == "linear-demo"
        noise = levels[0] if levels[0] is not None else -np.inf
        beyond = [level is not None and level > noise for level in levels[1:]]
        yield Claim(
            f"{preset}, 0.5 to 10.5 N, relative to the position's root mean square",
            "no distortion above the noise" if linear else "shown",
            told,
            not any(beyond) if linear else True,
        )


def _warmth() -> Claim:
    limits = {"max_force_n": 12.0, "max_seconds": 30.0, "max_temperature_c": 80.0}
    foretold = assess_stimulus(with_preload(LOW_CREST.build()), DeviceDescription(), **limits).heating
    _, warmer = _measured(SKIN[0], LOW_CREST)
    return Claim(
        "warming of the simulated coil, whose thermal figures the appraisal does not know",
        "within the range foretold",
        f"{warmer:.1f} K; foretold {foretold.expected_k:.1f} ({foretold.least_k:.1f} to {foretold.most_k:.1f}), "
        f"at most {foretold.bound_k:.1f} K",
        foretold.least_k <= warmer <= foretold.most_k,
    )
