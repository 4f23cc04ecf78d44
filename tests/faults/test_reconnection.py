"""An instrument that comes back is ready at once, in the same program, and no test is lost with its cable."""

import random
import time

import numpy as np
import pytest
from faults.cells import PRELOAD_S, SECONDS, SURFACE_M, feedback, open_loop
from faults.desk import Desk, virtual_time
from firmware_sim_process import firmware_thread

from tissueid.acquisition import run_guided_test
from tissueid.errors import LinkLostError
from tissueid.instrument import CLINICAL, SerialInstrument, SerialLink

READY_S = 2.0
"""Time from the return of an instrument until it can be used, s."""
LONGEST_S = PRELOAD_S + SECONDS + 1.0


def pulled_once(desk, recorder, chance):
    """A test with the cable pulled at any time, and put back: tests begun, and s until the instrument is ready."""
    instrument = desk.open()
    pulled_s = desk.link.now + chance.uniform(0.0, LONGEST_S)
    desk.link.moments.append((lambda link: link.now >= pulled_s, desk.link.unplug))
    before = recorder.tests_begun
    test = feedback(seed=1) if chance.random() < 0.3 else open_loop(seed=1)
    with pytest.raises(LinkLostError):
        run_guided_test(instrument, test, recorder, surface_m=SURFACE_M)
        while True:
            instrument.poll(0.05)
    instrument.close()
    desk.link.run_for(chance.uniform(0.0, 2.0))
    desk.link.replug()
    came_back_s = desk.link.now
    instrument = desk.open()
    instrument.load(np.full(100, 1.0))
    instrument.close()
    return recorder.tests_begun - before, desk.link.now - came_back_s


@pytest.mark.parametrize("times", [8, pytest.param(1000, marks=pytest.mark.soak)])
def test_an_instrument_that_comes_back_is_ready_and_every_test_is_saved(tmp_path, times):
    chance, begun = random.Random(times), 0
    for sitting in range(0, times, 50):
        desk = Desk(seed=sitting)
        instrument = desk.open()
        recorder = desk.recorder(tmp_path / f"{sitting}.h5", instrument)
        instrument.close()
        with virtual_time():
            for _ in range(min(50, times - sitting)):
                tests, ready_s = pulled_once(desk, recorder, chance)
                begun += tests
                assert ready_s <= READY_S
                assert not desk.firmware.energised
        if recorder.tests_begun:
            session = recorder.finish()
            assert desk.invented(recorder, session) == []
            recorded = {number for number, given in recorder.given.items() if any(block.size for block in given.blocks)}
            assert {test.number for test in session.tests} >= recorded
            assert all(test.status in ("completed", "aborted") for test in session.tests)
    assert begun > 0.4 * times


def test_a_watchdog_that_fires_while_the_instrument_is_opened_leaves_no_fault():
    """The cable is put back about 0.5 s after the last heartbeat, so that opening and the watchdog coincide."""
    desk = Desk(seed=1)
    with virtual_time():
        for away_s in np.arange(0.36, 0.56, 0.002):
            instrument = desk.open()
            instrument.load(np.full(8000, 1.0))
            instrument.arm(CLINICAL)
            instrument.start()
            for _ in range(4):
                instrument.poll(0.05)
            desk.link.unplug()
            instrument.close()
            desk.link.run_for(float(away_s))
            desk.link.replug()
            with desk.open() as again:
                again.load(np.full(100, 1.0))


def test_a_serial_server_that_is_connected_again_is_ready():
    command = np.full(8000, 4.0)
    with firmware_thread("--tcp=0") as port:
        for _ in range(3):
            link = SerialLink(port.url)
            instrument = SerialInstrument(link)
            instrument.load(command)
            instrument.arm(CLINICAL)
            instrument.start()
            instrument.poll(0.1)
            link.close()  # the connection breaks in the middle of a run
            began = time.monotonic()
            with SerialInstrument(SerialLink(port.url)) as again:
                again.load(command)
                assert time.monotonic() - began < READY_S
