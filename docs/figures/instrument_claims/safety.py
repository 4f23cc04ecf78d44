"""Safety of firmware and host alone: time until release, margin to false alarms, highest temperature."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from unittest.mock import patch

import numpy as np
from engine_claims.base import Claim
from numpy.typing import NDArray
from support import LoopbackLink

from firmware_sim.bench import Bench
from firmware_sim.converters import CHANNELS
from firmware_sim.firmware import Firmware
from firmware_sim.kernel import TEMPERATURE
from firmware_sim.plant import PlantParameters
from firmware_sim.presets import preset_names
from tissueid.errors import TissueIDError
from tissueid.instrument import Limits, SerialInstrument
from tissueid.wire import Fault, Flag

RATE = 2000
SECONDS = 3.0
WIDE = Limits(max_force_n=14.9, max_temperature_c=80.0, max_seconds=60.0)
UPSET_AFTER = 2000
HOST_OFF: dict[str, object] = {
    **{f"tissueid.instrument.run_machine.check_{name}": None for name in ("stimulus", "command", "limits")},
    "tissueid.instrument.sample_monitor.SampleMonitor.check": None,
    "tissueid.instrument.sample_monitor.SampleMonitor.arm": None,
}
FIRMWARE_OFF: dict[str, object] = {
    "firmware_sim.guard.Guard.judge": (0, Fault.NONE),
    "firmware_sim.limits.ArmedLimits.within": True,
    "firmware_sim.limits.ArmedLimits.permits": True,
}
Upset = Callable[[Bench], object]
UPSETS: dict[str, tuple[Upset, float, float]] = {
    # What happens, and within how many ms the firmware and the host, each alone, are to have freed the coil.
    "the position signal is constant": (lambda bench: bench.stuck.add("position"), 120.0, 150.0),
    "the coil's wire breaks": (lambda bench: setattr(bench, "coil_open", True), 30.0, 60.0),
    "the current signal is constant": (lambda bench: bench.stuck.add("current"), 80.0, 110.0),
    "the button is pressed": (lambda bench: setattr(bench, "button", True), 0.5, float("inf")),
}


def _switched_off(what: Mapping[str, object]) -> ExitStack:
    stack = ExitStack()
    for name, answer in what.items():
        stack.enter_context(patch(name, lambda *_, answer=answer: answer))
    return stack


def _shaken(seed: int) -> NDArray[np.float64]:
    noise = np.random.default_rng(seed).standard_normal(round(SECONDS * RATE))
    slow = np.convolve(noise, np.ones(50) / 7.0, "same")
    return np.clip(12.0 + 4.0 * slow, 0.0, 24.0) * np.minimum(np.arange(slow.size) / 500, 1.0)


def _samples_until_free(upset: Upset, off: Mapping[str, object], seed: int) -> int:
    """Samples with the coil energised from the upset on; the whole run when nothing frees it."""
    with _switched_off(off):
        bench = Bench("left-posterior-forearm", seed=seed)
        link = LoopbackLink(Firmware(bench))
        instrument = SerialInstrument(link, clock=link.clock)
        link.firmware.watchdog_s = 1e9
        command = _shaken(seed)
        instrument.load(command)
        instrument.arm(WIDE)
        run = instrument.start()
        blocks, onset, last = [], None, 0
        try:
            while last < run.end_index:
                if onset is None and last - run.first_index > UPSET_AFTER:
                    upset(bench)
                    onset = link.firmware.sample_index
                samples = instrument.poll(0.05)
                if samples.size:
                    blocks.append(samples)
                    last = int(samples["index"][-1]) + 1
        except TissueIDError:
            pass
        samples = np.concatenate(blocks)
    energised = samples["index"][(samples["flags"] & Flag.ENERGISED) > 0]
    return int(np.count_nonzero(energised >= (onset or 0)))


def _times() -> Iterator[Claim]:
    for what, (upset, firmware_ms, host_ms) in UPSETS.items():
        for side, off, bar in (("firmware", HOST_OFF, firmware_ms), ("host", FIRMWARE_OFF, host_ms)):
            if not np.isfinite(bar):
                continue
            taken = [1e3 * _samples_until_free(upset, off, seed) / RATE for seed in range(10)]
            yield Claim(
                f"{what}: the {side} alone releases the coil, slowest of 10 seeds, device time",
                f"{bar:g} ms",
                f"{max(taken):g} ms (median {np.median(taken):g})",
                max(taken) <= bar,
            )


def _commands(seed: int) -> Iterator[NDArray[np.float64]]:
    time = np.arange(RATE) / RATE
    rise = np.minimum(time / 0.25, 1.0)
    yield rise * np.clip(16.0 + 10.0 * np.random.default_rng(seed).standard_normal(RATE), -40.0, 46.0)
    yield rise * (20.0 + 20.0 * np.sin(2 * np.pi * np.cumsum(np.geomspace(1.0, 900.0, RATE)) / RATE))
    yield rise * (24.0 + 20.0 * np.sign(np.sin(2 * np.pi * 3.0 * time)))


def _margins() -> Iterator[Claim]:
    """The judges' own quantities, computed anew from the converters' codes: their extremes over all presets."""
    names = [channel.name for channel in CHANNELS]
    still_um, distinct, share, jump = np.inf, np.inf, np.inf, 0.0
    for preset in preset_names():
        for seed in range(50):
            bench = Bench(preset, seed=seed)
            command = list(_commands(seed))[seed % 3]
            codes = bench.block(command, energised=True).codes
            read = {c.name: c.decode(codes[:, k]).reshape(-1, 20) for k, c in enumerate(CHANNELS)}
            position = codes[:, names.index("position")].astype(int)
            rows = np.lib.stride_tricks.sliding_window_view
            swing = np.ptp(rows(3.0 * read["current"].mean(1), 10), axis=1)
            moved = np.ptp(rows(read["position"].mean(1), 10), axis=1)
            spread = np.ptp(rows(position, 200)[::20], axis=1)
            in_reach = rows(position, 200)[::20].min(axis=1) > -32768
            if np.any(strong := (swing >= 3.0) & in_reach):
                still_um = min(still_um, 1e6 * float(moved[strong].min()))
            if np.any(some := (swing >= 0.3) & in_reach):
                distinct = min(distinct, int(spread[some].min()))
            volts, amperes = (rows(np.abs(read[name]).mean(1), 2).mean(axis=1) for name in ("voltage", "current"))
            share = min(share, float((12.0 * amperes / volts)[volts >= 2.0].min()))
            jump = max(jump, RATE * float(np.abs(np.diff(read["position"].ravel())).max()))
    where = f"{len(preset_names())} presets, 50 seeds each"
    yield Claim(
        f"{where}: smallest motion in 100 ms with a force change of 3 N", "6 um", f"{still_um:.0f} um", still_um > 12.0
    )
    yield Claim(
        f"{where}: fewest position codes in 100 ms with a force change of 0.3 N", "1", f"{distinct + 1}", distinct >= 3
    )
    yield Claim(f"{where}: smallest share of the expected current at 2 V", "0.15", f"{share:.2f}", share > 0.3)
    yield Claim(f"{where}: highest speed", "10 m/s", f"{jump:.2f} m/s", jump < 5.0)


def _hottest(off: Mapping[str, object], volts: float, bench: Bench) -> tuple[float, float]:
    """The true winding's highest temperature, degC, and the seconds until something ended the run."""
    with _switched_off(off):
        bench.stuck.add("temperature")
        link = LoopbackLink(Firmware(bench))
        instrument = SerialInstrument(link, clock=link.clock)
        link.firmware.watchdog_s = 1e9
        command = volts * np.minimum(np.arange(40 * RATE) / 500, 1.0)
        instrument.load(command)
        instrument.arm(Limits(max_force_n=14.9, max_temperature_c=80.0, max_seconds=60.0))
        run = instrument.start()
        last = run.first_index
        try:
            while last < run.end_index:
                samples = instrument.poll(0.05)
                last = int(samples["index"][-1]) + 1 if samples.size else last
        except TissueIDError:
            pass
        return float(bench.plant.state[TEMPERATURE]), (last - run.first_index) / RATE


def _temperature() -> Iterator[Claim]:
    for side, off in (("firmware", HOST_OFF), ("host", FIRMWARE_OFF)):
        for volts in (48.0, 30.0):
            hottest, seconds = _hottest(off, volts, Bench("buna", seed=1))
            yield Claim(
                f"temperature sensor fixed at 23 degC, {volts:g} V held, limit 80 degC: winding temperature when the "
                f"{side} alone stops",
                "80 degC",
                f"{hottest:.0f} degC, after {seconds:.1f} s",
                hottest < 80.0,
            )
    warmer = PlantParameters(heat_capacity_j_per_k=16.5, ambient_degc=30.0)
    hottest, seconds = _hottest(HOST_OFF, 48.0, Bench("buna", seed=1, parameters=warmer, nominal=PlantParameters()))
    yield Claim(
        "the same with a coil of 16.5 J/K in a room of 30 degC, 48 V, firmware alone",
        "80 degC",
        f"{hottest:.0f} degC, after {seconds:.1f} s",
        hottest < 80.0,
    )


def claims() -> Iterator[Claim]:
    """All of it, on the virtual cable: times are the device's own."""
    yield from _times()
    yield from _margins()
    yield from _temperature()
