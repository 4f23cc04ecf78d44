"""Set-points against the firmware as a process of its own, on a real cable and by the clock."""

import sys
import time

import numpy as np
import pytest
from firmware_sim_process import firmware_process

from tissueid.instrument import Limits, SerialInstrument, SerialLink
from tissueid.wire import Flag

CABLES = ["--pty", "--tcp=0"] if sys.platform != "win32" else ["--tcp=0"]
PRELOAD, BLOCK, LEAD = 1000, 50, 3


def follow_a_wave(instrument, seconds, lead):
    """A gentle wave made block by block, ``lead`` blocks ahead of what was received; gives the samples of the run."""
    count = round(seconds * 2000)
    wave = 8.0 + 5.0 * np.sin(2 * np.pi * 3.0 * np.arange(count) / 2000)
    instrument.load(np.full(PRELOAD, 8.0))
    instrument.follow(count, 8.0)
    instrument.arm(Limits(max_seconds=seconds + 1.0))
    run = instrument.start()
    blocks, made, last = [], 0, run.first_index
    while last < run.end_index:
        samples = instrument.poll(0.05)
        if samples.size:
            blocks.append(samples)
            last = int(samples["index"][-1]) + 1
        while made * BLOCK < count and (made - lead) * BLOCK <= last - run.first_index - PRELOAD:
            instrument.send(PRELOAD + made * BLOCK, wave[made * BLOCK : (made + 1) * BLOCK])
            made += 1
    samples = np.concatenate(blocks)
    samples = samples[(samples["index"] >= run.first_index + PRELOAD) & (samples["index"] < run.end_index)]
    return samples, wave


@pytest.mark.parametrize("cable", CABLES)
def test_a_fast_clock_waits_for_its_set_points(cable):
    with firmware_process(cable, "--speed", "10") as (url, _), SerialInstrument(SerialLink(url)) as instrument:
        samples, wave = follow_a_wave(instrument, 4.0, lead=1)
        assert instrument.late_blocks == instrument.held_samples == 0
        np.testing.assert_allclose(samples["command"], wave, atol=60 / 32768)


@pytest.mark.soak
@pytest.mark.parametrize("cable", CABLES)
def test_no_block_is_late_in_a_minute(cable):
    with firmware_process(cable) as (url, _), SerialInstrument(SerialLink(url)) as instrument:
        begin = time.monotonic()
        samples, wave = follow_a_wave(instrument, 60.0, LEAD)
        elapsed = time.monotonic() - begin
        assert instrument.late_blocks == 0
        assert instrument.held_samples == 0
        assert not np.any(samples["flags"] & Flag.HELD)
        np.testing.assert_allclose(samples["command"], wave, atol=60 / 32768)
        assert instrument.setpoint_margin_s > 0.0
        assert elapsed < 1.05 * (60.0 + PRELOAD / 2000), "the device itself was kept from running in real time"
        print(f"{cable}: the closest block came {instrument.setpoint_margin_s * 1e3:.1f} ms ahead")
