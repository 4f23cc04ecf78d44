"""The driver and feedback tests over the line of the emulated microcontroller, in its time; a host that is killed."""

import json
import subprocess
import sys
import time

import numpy as np
import pytest
from reference.lines import EmulatedLine

from tissueid import wire
from tissueid.acquisition import GuidedTest, SessionRecorder, run_guided_test
from tissueid.errors import LinkLostError
from tissueid.instrument import Limits, SerialInstrument, SerialLink
from tissueid.instrument.link import broken_error
from tissueid.stimuli import get_stimulus
from tissueid.test_settings import TestSettings

SURFACE_M = 0.008
RUN_S = 25.0
WATCHDOG_S = 0.5


class EmulatedLink(EmulatedLine):
    """A port of the driver; the time of the emulated board passes while it reads."""

    name = "emulated"
    step = 20
    killed = False

    def __init__(self, program):
        super().__init__(program, "tissue")
        self.written_at = 0.0

    def read(self, timeout_s):
        if self.killed:  # the host is gone, and with it the time that it would have spent
            raise broken_error(self.name, OSError("killed"))
        return super().read(max(timeout_s, self.step / self.rate_hz))

    def write(self, data):
        if not self.killed:
            self.written_at = self.clock()
            super().write(data)

    def close(self):
        if not self.killed:
            super().close()


@pytest.fixture
def link(emulated):
    link = EmulatedLink(emulated)
    yield link
    link.killed = False
    link.close()


def feedback(seconds, seed=1, **options):
    """0.3 to 1 mm into the tissue: ten minutes of it do not warm the coil."""
    kind = get_stimulus("rtig")
    stimulus = kind(
        seconds=seconds, depth_min_m=3e-4, depth_max_m=1e-3, force_max_n=2.5, gain_n_per_m=1500.0, seed=seed, **options
    )
    return GuidedTest(stimulus, TestSettings(site="forearm"), limits=Limits(max_force_n=4.0, max_seconds=28.0))


def test_a_killed_host_releases_the_coil_in_time(link, tmp_path):
    instrument = SerialInstrument(link, clock=link.clock)

    def kill(item):
        if item.fraction > 0.6:
            link.killed = True

    recorder = SessionRecorder(tmp_path / "s.h5", instrument.device)
    with pytest.raises(LinkLostError):
        run_guided_test(instrument, feedback(1.0, identify=False), recorder, surface_m=SURFACE_M, progress=kill)
    recorder.finish_or_discard()
    killed_at = link.written_at
    decoder = wire.FrameDecoder()
    decoder.feed(link.received())
    released_at = on_at = None
    while released_at is None and link.clock() < killed_at + 2.0:
        link.advance(20)
        for frame in decoder.feed(link.received()):
            if frame.type == wire.MessageType.DATA:
                flags = np.frombuffer(frame.payload, wire.SAMPLE)["flags"]
                for k in np.flatnonzero(flags & int(wire.Flag.ENERGISED)):
                    on_at = (frame.sample_index + int(k) + 1) / link.rate_hz
                if not flags[-1] & int(wire.Flag.ENERGISED):
                    released_at = on_at
    print(f"released {released_at - killed_at:.3f} s after the last byte of the host")
    assert WATCHDOG_S - 0.11 <= released_at - killed_at <= WATCHDOG_S + 0.02


@pytest.mark.soak
def test_a_killed_process_releases_the_coil(emulated, tmp_path):
    """In real time: the server of the emulator, and a test of the command line that is killed in its run."""
    server = [sys.executable, "-m", "firmware_sim.reference.emulator"]
    with subprocess.Popen(server, stdout=subprocess.PIPE, text=True) as device:
        url = device.stdout.readline().strip()
        command = [*("--device", url, "--site", "x", "--out", tmp_path / "s.h5", "--stimulus", "noise")]
        command += ["--max-force", "5", "--seconds", "25"]
        with subprocess.Popen([sys.executable, "-m", "tissueid", "test", *command], stdout=subprocess.DEVNULL) as host:
            time.sleep(0.5)
            # The server accepts one host at a time: wait for the journal to grow before the host is killed.
            while host.poll() is None and sum(path.stat().st_size for path in tmp_path.iterdir()) < 600_000:
                time.sleep(0.2)
            host.kill()
        time.sleep(1.5)
        link = SerialLink(url)
        decoder, end, states = wire.FrameDecoder(), time.monotonic() + 10.0, []
        link.write(wire.encode_frame(wire.Frame(wire.MessageType.STATUS_REQUEST)))
        while not states and time.monotonic() < end:
            frames = [frame for frame in decoder.feed(link.read(0.1)) if frame.type == wire.MessageType.STATUS]
            states += [wire.unpack(wire.STATUS, frame.payload, tail=True)[0] for frame in frames]
        link.close()
        device.terminate()
    assert (states[0]["state"], states[0]["faults"]) == (wire.State.FAULT, wire.Fault.WATCHDOG)


@pytest.mark.soak
@pytest.mark.timeout(3000)
def test_ten_minutes_of_feedback_lose_no_sample(link, tmp_path):
    begin = time.monotonic()
    instrument = SerialInstrument(link, clock=link.clock)
    runs = 0
    while link.clock() < 600.0:
        recorder = SessionRecorder(tmp_path / f"{runs}.h5", instrument.device)
        run_guided_test(instrument, feedback(RUN_S, seed=runs), recorder, surface_m=SURFACE_M)
        played = recorder.finish().test()
        report = json.loads(played.notes["stimulus_report"])
        assert (played.status, report["lost"]) == ("completed", 0)
        assert played.notes["late_blocks"] == played.notes["held_samples"] == 0
        assert not np.isnan(played.signals["position"]).any()
        runs += 1
    assert instrument.gaps == []
    assert instrument.statistics.refused == 0
    assert instrument.status.dropped_frames == 0
    print(
        f"{runs} runs, {link.samples} samples, {link.clock():.0f} s of the device in {time.monotonic() - begin:.0f} s; "
        f"longest interrupt {link.device.counted_instructions:.0f} instructions"
    )
