"""Demonstration: a complete test with simulated firmware over a real serial link, with a report; samples."""

from __future__ import annotations

import contextlib
import json
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import Field

from tissueid.atomic_write import private_folder
from tissueid.child_process import run, start
from tissueid.errors import InstrumentError, UnusableInputError
from tissueid.language import marked
from tissueid.messages import Message, Verbatim
from tissueid.plan_options import Option, Plan
from tissueid.procedures.audit_queries import audit_note
from tissueid.procedures.control import Control
from tissueid.procedures.output_files import check_result_folder, check_session_path, json_text, write_text
from tissueid.procedures.test_plan import LARGE_CLIPPED, LARGE_N, TestPlan
from tissueid.test_settings import TestSettings

if TYPE_CHECKING:  # each takes long to import
    from tissueid.analysis import Analysis
    from tissueid.audit import AuditTrail
    from tissueid.calibration import ElectricalCheck
    from tissueid.instrument import Instrument
    from tissueid.reports import ComparisonTable
    from tissueid.sessions import Session


SMALL_N = 0.75
"""Half the force range of the small-amplitude test, N, about the mean load of the main test (thesis 3.4)."""
OUTPUTS = ("session.h5", "results.json", "report.html")
_SPEED = 4.0
"""Speed of the simulated instrument, in seconds of the instrument per second."""
_COMPARED = {"mass_kg": "kg", "damping_n_s_per_m": "N s/m", "stiffness_n_per_m": "N/m"}
_STARTING = marked("Starting the simulated instrument")
_COIL = marked("Checking the coil")
_PLACING = marked("Placing the probe")
_MAIN = marked("Main test")
_SMALL = marked("Small-amplitude test")
_IDENTIFYING = marked("Identifying")
_WRITING = marked("Writing the report")


class DemoPlan(Plan):
    """Folder, seed and tissue of a demonstration."""

    out: Annotated[Path, Option("--out", metavar="DIR", help="folder for session.h5, results.json, report.html")]
    seed: Annotated[int, Option("--seed", help="seed of stimulus and sensor noise"), Field(ge=0, le=2**31 - 1)] = 1
    preset: Annotated[str, Option("--preset", help="tissue; see 'tissueid-firmware-sim --list'")] = (
        "left-posterior-forearm"
    )


@dataclass(frozen=True)
class DemoResult:
    """The analyses by test and engine, their comparison with the plant, and the content of the JSON file."""

    page: Path
    analyses: dict[int, dict[str, Analysis]]
    comparison: ComparisonTable
    answer: dict[str, Any]


def run_demo(plan: DemoPlan, control: Control, trail: AuditTrail) -> DemoResult:
    """Run the demonstration. The three output files appear together at the end, or not at all.

    Raises:
        UnusableInputError: the folder cannot be used, or there is no such tissue.
        InstrumentError: the simulated instrument did not start.
    """
    from tissueid.analysis import analyse_all
    from tissueid.instrument import open_instrument
    from tissueid.reports import write_report

    check_result_folder(plan.out, OUTPUTS, OUTPUTS[1], "tissueid demo")
    audit_note(trail, control, "demo.begun", subject="DEMO", new={"preset": plan.preset, "seed": plan.seed})
    with tempfile.TemporaryDirectory(dir=plan.out, prefix=".demo-") as folder:
        work = Path(folder)
        control.progress(0.0, _STARTING)
        with firmware_process(plan.preset, plan.seed) as url:
            instrument = open_instrument(url)
            control.progress(1.0, _STARTING)
            try:
                session, check = _measure(instrument, work / OUTPUTS[0], plan, control)
            finally:
                instrument.close()
        control.progress(0.0, _IDENTIFYING)
        analyses: dict[int, dict[str, Analysis]] = {}
        for number, test in enumerate(session.tests):
            analyses[test.number] = analyse_all(session, test=test)
            control.progress((number + 1) / len(session.tests), _IDENTIFYING)
        comparison = _compare(session, analyses, plan.preset)
        control.progress(0.0, _WRITING)
        answer = _answer(plan, session, check, analyses, comparison)
        write_text(work / OUTPUTS[1], json_text(answer))
        write_report(work / OUTPUTS[2], session, analyses, comparison=comparison)
        for name in OUTPUTS:
            (work / name).replace(plan.out / name)
        control.progress(1.0, _WRITING)
    return DemoResult(plan.out / OUTPUTS[2], analyses, comparison, answer)


@contextmanager
def firmware_process(
    preset: str, seed: int, *, speed: float = _SPEED, coil: str = "ideal", rate_hz: float = 2000.0
) -> Iterator[str]:
    """Run the simulated firmware in its own process; yield the URL of its serial port.

    Args:
        preset: tissue.
        seed: of the sensor noise.
        speed: seconds of the instrument per second.
        coil: force constant along the stroke: ideal or finite.
        rate_hz: samples per second.

    Raises:
        UnusableInputError: the preset is unknown.
        InstrumentError: the process did not start.
    """
    options = {"preset": preset, "seed": seed, "speed": speed, "coil": coil, "rate": rate_hz}
    command = ["-m", "firmware_sim", *(part for name, value in options.items() for part in (f"--{name}", str(value)))]
    with tempfile.TemporaryFile("w+") as complaints:
        process = start(*command, stdout=subprocess.PIPE, stderr=complaints, text=True)
        assert process.stdout is not None
        try:
            url = process.stdout.readline().strip()
            if not url:
                status = process.wait()
                complaints.seek(0)
                reason = (complaints.read().strip().splitlines() or ["no reason given"])[-1]
                error = UnusableInputError if status == 2 else InstrumentError
                raise error(
                    Message(
                        "demo.not_started",
                        "the simulated instrument did not start: {reason}",
                        reason=Verbatim(reason.removeprefix("tissueid-firmware-sim: ")),
                    )
                )
            yield url
        finally:
            process.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(timeout=5)
            process.kill()
            process.stdout.close()


def _measure(instrument: Instrument, path: Path, plan: DemoPlan, control: Control) -> tuple[Session, ElectricalCheck]:
    """Check the coil, place the probe, run the main test and a small-amplitude test about the same mean load."""
    from tissueid.acquisition import GuidedTest, Progress, SessionRecorder, run_guided_test
    from tissueid.acquisition.guided import find_surface
    from tissueid.calibration import check_coil
    from tissueid.instrument import CLINICAL
    from tissueid.sessions import Subject
    from tissueid.stimuli.base import with_preload
    from tissueid.stimuli.kinds.noise import Noise

    def shown(step: str) -> Callable[[Progress], None]:
        return lambda progress: control.progress(progress.fraction, step)

    check = check_coil(instrument, progress=lambda fraction: control.progress(fraction, _COIL))
    device = replace(instrument.device, calibration=check.as_calibration())
    surface = find_surface(instrument, progress=shown(_PLACING))
    recorder = SessionRecorder(path, device, Subject("DEMO"))
    mean, rate = sum(LARGE_N) / 2, device.sample_rate_hz
    noises = {
        _MAIN: Noise(
            seed=plan.seed, force_min_n=LARGE_N[0], force_max_n=LARGE_N[1], clipped=LARGE_CLIPPED, sample_rate=rate
        ),
        _SMALL: Noise(seed=plan.seed + 1, force_min_n=mean - SMALL_N, force_max_n=mean + SMALL_N, sample_rate=rate),
    }
    for step, noise in noises.items():
        test = GuidedTest(
            with_preload(noise.build()), TestSettings(site=plan.preset.replace("-", " ")), limits=CLINICAL
        )
        run_guided_test(instrument, test, recorder, surface_m=surface, progress=shown(step))
    return recorder.finish(), check


def _compare(session: Session, analyses: dict[int, dict[str, Analysis]], preset: str) -> ComparisonTable:
    """Return the estimates of both tests and the known values of the plant at the depth of the small test."""
    from tissueid.reports import ComparisonRow, ComparisonTable

    position = float(np.nanmean(session.test(2).record().output))
    command = ("-m", "firmware_sim", "--preset", preset, "--local-values", repr(position))
    truth = json.loads(run(*command, capture_output=True, text=True, check=True).stdout)
    large, small = (analyses[number]["lms"].model.report.parameters for number in (1, 2))
    rows = tuple(
        ComparisonRow(name, unit, small[name], truth[name], large[name])
        for name, unit in _COMPARED.items()
        if name in small and name in large
    )
    return ComparisonTable(position, rows)


def _answer(
    plan: DemoPlan,
    session: Session,
    check: ElectricalCheck,
    analyses: dict[int, dict[str, Analysis]],
    comparison: ComparisonTable,
) -> dict[str, Any]:
    return {
        "made_by": "tissueid demo",
        "software": session.software,
        "session_id": session.session_id,
        "seed": plan.seed,
        "preset": plan.preset,
        "calibration": asdict(check),
        "tests": {
            str(number): {engine: analysis.as_answer() for engine, analysis in engines.items()}
            for number, engines in analyses.items()
        },
        "small_amplitude": asdict(comparison),
    }


@dataclass(frozen=True)
class Sample:
    """One sample session: instrument, values of its ``TestPlan``, and a command that shows what it is good for."""

    url: str
    values: Mapping[str, Any]
    about: str
    command: str


SAMPLES: Mapping[str, Sample] = {
    "forearm.h5": Sample(
        "simulated://forearm?seed=1",
        {"site": "left forearm", "subject": "P-001", "seconds": 3.0, "seed": 1, "repeats": 2},
        "noise on a forearm, two repeats",
        "tissueid compare forearm.h5 --engines lms,wiener,dpn",
    ),
    "anterior-forearm.h5": Sample(
        "simulated://anterior-forearm?seed=1&subject=2",
        {"site": "left anterior forearm", "subject": "P-002", "seconds": 3.0, "seed": 1, "repeats": 2},
        "the same on the softer side of another person",
        "tissueid repeats forearm.h5 anterior-forearm.h5 --engines lms",
    ),
    "steps.h5": Sample(
        "simulated://forearm?seed=2",
        {"site": "left forearm", "subject": "P-001", "stimulus": "step_hold", "min_force_n": 1.0, "max_force_n": 4.0},
        "a step of force that is held, for creep",
        "tissueid readings steps.h5 --model-session forearm.h5",
    ),
    "spring.h5": Sample(
        "simulated://spring?seed=1",
        {"site": "calibration spring", "subject": "none", "kind": "spring", "seconds": 2.0, "seed": 1},
        "noise on the calibration spring, a linear system",
        "tissueid identify spring.h5 --engine lms --test 1",
    ),
}
"""The samples by the name of their file."""


class SamplesPlan(Plan):
    """The folder of the samples."""

    out: Annotated[Path, Option("--out", metavar="DIR", help="folder for the sample sessions")]


def make_samples(plan: SamplesPlan, control: Control) -> dict[str, Session]:
    """Record all samples, and return them by the name of their file.

    Raises:
        UnusableInputError: a file exists, or the folder cannot be used.
        CancelledError: it was cancelled; the complete samples are kept.
    """
    from tissueid.procedures.test_run import TestControl, run_test

    private_folder(plan.out)
    for name in SAMPLES:
        check_session_path(plan.out / name)
    made = {}
    for done, (name, sample) in enumerate(SAMPLES.items()):
        control.follow(Message("samples.step", "Recording {name}", name=Verbatim(name)), done / len(SAMPLES))
        test = TestPlan(url=sample.url, out=plan.out / name, calibration=False, **sample.values)
        made[name] = run_test(test, TestControl(), None).saved()
    return made
