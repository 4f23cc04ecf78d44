"""Closed loop over a cable, in real time."""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from engine_claims.base import Claim
from firmware_sim_process import firmware_process

from tissueid.acquisition import GuidedTest, SessionRecorder, run_guided_test
from tissueid.acquisition.guided import find_surface
from tissueid.instrument import Limits, SerialInstrument, SerialLink
from tissueid.stimuli.kinds.rtig import Rtig
from tissueid.test_settings import TestSettings

SECONDS = 60.0
TISSUE = "left-posterior-forearm"
CABLES = {"--pty": "pseudo-terminal", "--tcp=0": "TCP"}
LIMITS = Limits(max_force_n=12.0, max_seconds=SECONDS + 1.0)
BAR = 0.08


def claims() -> Iterator[Claim]:
    """A minute of RTIG with identification on each cable, the firmware a process of its own in real time."""
    for option, cable in CABLES.items():
        kind = Rtig(seconds=SECONDS, seed=1)
        with (
            tempfile.TemporaryDirectory() as folder,
            firmware_process(option, "--preset", TISSUE) as (url, _),
            SerialInstrument(SerialLink(url)) as instrument,
        ):
            recorder = SessionRecorder(Path(folder) / "session.h5", instrument.device)
            surface = find_surface(instrument, LIMITS)
            begin = time.monotonic()
            run_guided_test(
                instrument, GuidedTest(kind, TestSettings(site=TISSUE), limits=LIMITS), recorder, surface_m=surface
            )
            elapsed = time.monotonic() - begin
            margin = instrument.setpoint_margin_s
            notes = recorder.finish().test().notes
        late, held = int(float(notes["late_blocks"])), int(float(notes["held_samples"]))
        in_time = elapsed < 1.05 * (SECONDS + 0.5)
        yield Claim(
            f"{cable}, {SECONDS:g} s of `rtig` on {TISSUE}, {kind.lead} blocks ahead: late blocks, held samples, and "
            "the closest block",
            "0 late",
            f"{late}, {held}, {1e3 * (margin or 0.0):.0f} ms ahead{'' if in_time else ' (the device lost time)'}",
            late == 0 and in_time,
        )
        distance = json.loads(str(notes["stimulus_report"]))["kolmogorov_distance"]
        yield Claim(
            f"{cable}: distance of depth from uniform; time in the source, of the test, and for its slowest block",
            f"{BAR:g}; 15 %",
            f"{distance:.3f}; {100 * float(notes['generating_share']):.1f} %, "
            f"{1e3 * float(notes['generating_longest_s']):.0f} ms",
            distance <= BAR and float(notes["generating_share"]) <= 0.15,
        )
