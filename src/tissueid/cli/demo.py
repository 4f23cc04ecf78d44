"""``tissueid demo``: a complete test with simulated firmware over a real serial link."""

from __future__ import annotations

import contextlib
import json
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from tissueid.acquisition import GuidedTest, SessionRecorder, run_guided_test
from tissueid.acquisition.guided import find_surface
from tissueid.analysis import Analysis, analyse_all
from tissueid.atomic_write import private_folder
from tissueid.calibration import ElectricalCheck, check_coil
from tissueid.child_process import run, start
from tissueid.cli.audit_records import audit_note
from tissueid.cli.identify import identify_answer, readable
from tissueid.cli.output import check_json, human_output, progress_bars, table, write_json
from tissueid.cli.test import show_progress
from tissueid.errors import InstrumentError, UnusableInputError
from tissueid.instrument import CLINICAL, Instrument, open_instrument
from tissueid.records import Estimate
from tissueid.reports import Comparison, ComparisonRow, write_report
from tissueid.sessions import Session, Subject
from tissueid.stimuli.base import with_preload
from tissueid.stimuli.kinds.noise import Noise

LARGE_N = (-5.0, 11.8)
"""Force range of the main test, N. Below zero the coil pulls and the probe lifts off at times (thesis Fig. 3.8)."""
LARGE_CLIPPED = 0.0455
"""Share of samples clipped to that range: the share of a Gaussian beyond two standard deviations."""
SMALL_N = 0.75
"""Half the force range of the small-amplitude test, N, about the mean load of the main test (thesis 3.4)."""
OUTPUTS = ("session.h5", "results.json", "report.html")
_COMPARED = {"mass_kg": "kg", "damping_n_s_per_m": "N s/m", "stiffness_n_per_m": "N/m"}


def run_demo(out: Path, seed: int, preset: str, json_file: Path | None) -> None:
    """Run the demo. The three output files appear together at the end, or not at all."""
    _check_target(out)
    check_json(json_file)
    audit_note("researcher", "demo.begun", subject="DEMO", new={"preset": preset, "seed": seed})
    with tempfile.TemporaryDirectory(dir=out, prefix=".demo-") as folder, progress_bars() as show:
        work = Path(folder)
        show("starting the simulated instrument", 0.0)
        with firmware_process(preset, seed) as url:
            instrument = open_instrument(url)
            show("starting the simulated instrument", 1.0)
            try:
                session, check = _measure(instrument, work / OUTPUTS[0], seed, preset, show)
            finally:
                instrument.close()
        show("identifying", 0.0)
        analyses: dict[int, dict[str, Analysis]] = {}
        for number, test in enumerate(session.tests):
            analyses[test.number] = analyse_all(session, test=test)
            show("identifying", (number + 1) / len(session.tests))
        comparison = _compare(session, analyses, preset)
        show("writing the report", 0.0)
        results = _results(session, check, analyses, comparison, seed, preset)
        write_json(work / OUTPUTS[1], results)
        write_report(work / OUTPUTS[2], session, analyses, comparison=comparison)
        for name in OUTPUTS:
            (work / name).replace(out / name)
        show("writing the report", 1.0)
    _print_result(out, analyses[1], comparison, human_output(json_file))
    if json_file is not None:
        write_json(json_file, results)


def _check_target(out: Path) -> None:
    """Make the folder, and check that only results of an earlier demo are overwritten.

    Raises:
        UnusableInputError: the folder contains other results.
    """
    if out.exists() and not out.is_dir():
        raise UnusableInputError(f"{out} is not a folder")
    private_folder(out)
    if not any((out / name).exists() for name in OUTPUTS):
        return
    made_by = None
    with contextlib.suppress(OSError, ValueError, AttributeError):
        made_by = json.loads((out / OUTPUTS[1]).read_text(encoding="utf-8")).get("made_by")
    if made_by != "tissueid demo":
        raise UnusableInputError(f"{out} contains results that are not of a demo; choose another folder")


@contextmanager
def firmware_process(preset: str, seed: int) -> Iterator[str]:
    """Run the simulated firmware in its own process; yield the URL of its serial port.

    Raises:
        UnusableInputError: the preset is unknown.
        InstrumentError: the process did not start.
    """
    command = ("-m", "firmware_sim", "--preset", preset, "--seed", str(seed))
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
                raise error(f"the simulated instrument did not start: {reason.removeprefix('tissueid-firmware-sim: ')}")
            yield url
        finally:
            process.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(timeout=5)
            process.kill()
            process.stdout.close()


def _measure(instrument: Instrument, path: Path, seed: int, preset: str, show: Any) -> tuple[Session, ElectricalCheck]:
    """Check the coil, place the probe, run the main test and a small-amplitude test about the same mean load."""
    check = check_coil(instrument, progress=lambda fraction: show("checking the coil", fraction))
    device = replace(instrument.device, calibration=check.as_calibration())
    surface = find_surface(instrument, progress=show_progress(show, "placing the probe"))
    recorder = SessionRecorder(path, device, Subject("DEMO"))
    mean, rate = sum(LARGE_N) / 2, device.sample_rate_hz
    noises = {
        "main test": Noise(
            seed=seed, force_min_n=LARGE_N[0], force_max_n=LARGE_N[1], clipped=LARGE_CLIPPED, sample_rate=rate
        ),
        "small-amplitude test": Noise(
            seed=seed + 1, force_min_n=mean - SMALL_N, force_max_n=mean + SMALL_N, sample_rate=rate
        ),
    }
    for label, noise in noises.items():
        test = GuidedTest(with_preload(noise.build()), site=preset.replace("-", " "), limits=CLINICAL)
        run_guided_test(instrument, test, recorder, surface_m=surface, progress=show_progress(show, label))
    return recorder.finish(), check


def _compare(session: Session, analyses: dict[int, dict[str, Analysis]], preset: str) -> Comparison:
    """Return the estimates of both tests and the known values of the plant at the depth of the small test."""
    position = float(np.nanmean(session.test(2).record().output))
    command = ("-m", "firmware_sim", "--preset", preset, "--local-values", repr(position))
    truth = json.loads(run(*command, capture_output=True, text=True, check=True).stdout)
    large, small = (analyses[number]["lms"].model.report.parameters for number in (1, 2))
    rows = tuple(
        ComparisonRow(name, unit, small[name], truth[name], large[name])
        for name, unit in _COMPARED.items()
        if name in small and name in large
    )
    return Comparison(position, rows)


def _results(
    session: Session,
    check: ElectricalCheck,
    analyses: dict[int, dict[str, Analysis]],
    comparison: Comparison,
    seed: int,
    preset: str,
) -> dict[str, Any]:
    return {
        "made_by": "tissueid demo",
        "software": session.software,
        "session_id": session.session_id,
        "seed": seed,
        "preset": preset,
        "calibration": asdict(check),
        "tests": {
            str(number): {engine: identify_answer(analysis) for engine, analysis in engines.items()}
            for number, engines in analyses.items()
        },
        "small_amplitude": asdict(comparison),
    }


def _print_result(out: Path, main: dict[str, Analysis], comparison: Comparison, console: Console) -> None:
    rows = table("Main test", "engine", "VAF fitted %", "VAF held out %", "seconds")
    for engine, analysis in main.items():
        report = analysis.model.report
        rows.add_row(
            engine, f"{report.vaf_percent:.1f}", f"{report.vaf_validation_percent:.1f}", f"{report.seconds:.2f}"
        )
    console.print(rows)
    title = f"Small-amplitude test at {comparison.position_m * 1e3:.2f} mm, against the local values of the plant"
    rows = table(title, "quantity", "estimate", "plant", "error %", "main test", "unit")
    for row in comparison.rows:
        label, small, unit = readable(row.quantity, row.small)
        _, plant, _ = readable(row.quantity, Estimate(row.truth))
        _, large, _ = readable(row.quantity, row.large)
        error = 100.0 * (row.small.value / row.truth - 1.0)
        rows.add_row(label, small, plant, f"{error:+.1f}", large, unit)
    console.print(rows)
    console.print(f"open {out / OUTPUTS[2]} in a browser. Research use only.", markup=False)
