"""Kills a recording host at random moments and checks that everything it had acknowledged is recovered.

Run as ``kill_worker.py FOLDER TIMES SEED``. Each host is a fork of this process, so that fifty of them take seconds;
it runs a guided test on the in-process instrument and tells through a pipe what is acknowledged.
"""

import os
import random
import signal
import struct
import sys
from pathlib import Path

import numpy as np

from tissueid.acquisition import GuidedTest, SessionRecorder, recover, run_guided_test
from tissueid.errors import UnusableInputError
from tissueid.instrument import SimulatedInstrument
from tissueid.stimuli.base import Stimulus
from tissueid.test_settings import TestSettings

WORD = struct.Struct("<qq")
FORCE = 5.0 + np.sin(np.arange(6000) / 20.0)
TEST = GuidedTest(Stimulus(FORCE, 2000.0, {"type": "sine"}, 0, 1.4, preload_s=0.5), TestSettings(site="forearm"))


def host(path: Path, pipe: int) -> None:
    instrument = SimulatedInstrument(seed=1)
    recorder = SessionRecorder(path, instrument.device, sync_s=0.0)

    def tell(_progress: object) -> None:
        os.write(pipe, WORD.pack(recorder.samples_appended, recorder.samples_acknowledged))

    run_guided_test(instrument, TEST, recorder, surface_m=0.01, progress=tell)
    recorder.finish()
    os.write(pipe, WORD.pack(-1, -1))


def kill_once(path: Path, rng: random.Random) -> tuple[int, int]:
    """Kill one host after a random number of words; returns acknowledged and recovered samples."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reader)
        try:
            host(path, writer)
        finally:
            os._exit(0)
    os.close(writer)
    acknowledged = 0
    for _ in range(rng.randrange(1, 310)):
        word = os.read(reader, WORD.size)
        if len(word) < WORD.size:
            break
        acknowledged = max(acknowledged, WORD.unpack(word)[1])
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    # What it said before it died counts too.
    while len(word := os.read(reader, WORD.size)) == WORD.size:
        acknowledged = max(acknowledged, WORD.unpack(word)[1])
    os.close(reader)
    if path.exists() and not path.with_name(path.name + ".journal").exists():
        return acknowledged, FORCE.size
    try:
        return acknowledged, recover(path)[1].test().samples
    except UnusableInputError:
        return acknowledged, 0


def main() -> int:
    folder, times, rng = Path(sys.argv[1]), int(sys.argv[2]), random.Random(int(sys.argv[3]))
    SimulatedInstrument(seed=1).poll(0.0)  # compile before the clock matters
    part_way = 0
    for number in range(times):
        acknowledged, recovered = kill_once(folder / f"{number}.h5", rng)
        part_way += 0 < recovered < FORCE.size
        if recovered < acknowledged:
            print(f"kill {number}: {acknowledged} samples acknowledged, {recovered} recovered")
            return 1
    print(f"{times} kills, {part_way} of them in the middle of a test, nothing acknowledged was lost")
    return 0 if part_way >= times // 3 else 1


if __name__ == "__main__":
    sys.exit(main())
