"""Figures and tables of the thesis (Chen 2010) from simulated tests, with its numbers and those found here."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tissueid.atomic_write import private_folder
from tissueid.errors import CancelledError, TissueIDError, UnusableInputError
from tissueid.language import marked
from tissueid.messages import Message, Verbatim
from tissueid.plan_options import Option, Plan
from tissueid.procedures.control import Control
from tissueid.procedures.output_files import check_result_folder, json_text, unwritable, write_text
from tissueid.procedures.overlay import named_fits, sweep_columns
from tissueid.test_settings import TestSettings

if TYPE_CHECKING:  # each takes long to import
    from tissueid.instrument import Instrument
    from tissueid_lab.thesis.recipe import RecipeSource, Recording, ReproducedFigure, ThesisFigure

_SESSIONS, _FIGURES = "sessions", "figures"
_RESULTS, _PAGE, _TEXT = "results.json", "report.html", "reproduction.md"
_MADE_BY = "tissueid reproduce"
_QUICK = 2
"""Number of repeats of a site, and of small tests of a series, that a quick run keeps: the first and the last."""
_SEED = 1
"""Seed of the sensor noise of the simulated instrument."""
_ATTEMPTS = 3
"""Number of times that a test is tried: a busy computer can miss the deadlines of the instrument."""
_SPEED, _QUICK_SPEED = 4.0, 8.0
"""Seconds of the instrument per second, also in a quick run; divided by the number of the attempt."""
_RECORDING = marked("Recording {name}")
_FITTING = marked("Fitting figure {number}")


class ReproductionPlan(Plan):
    """Figures, and the folder of their files. ``sweep`` is drawn under the depth profiles."""

    numbers: Annotated[
        tuple[str, ...],
        Option(argument=True, metavar="[NUMBER]...", help="figures such as 3.12 or 'Table 3.1'; default: all"),
    ] = ()
    out: Annotated[
        Path | None,
        Option(
            "--out", metavar="DIR", help="folder for sessions/, figures/, results.json, report.html, reproduction.md"
        ),
    ] = None
    sweep: Annotated[
        Path | None,
        Option(
            "--sweep-file",
            metavar="FILE",
            help="dynamic sweep that is drawn under depth profiles; default: a simulated one",
        ),
    ] = None
    silverbox: Annotated[
        Path | None,
        Option("--silverbox", metavar="FILE", help="score engines on this record of the Silverbox benchmark instead"),
    ] = None
    wiener_hammerstein: Annotated[
        Path | None,
        Option("--wiener-hammerstein", metavar="FILE", help="the same for the Wiener-Hammerstein benchmark of 2009"),
    ] = None
    quick: Annotated[
        bool,
        Option("--quick", help="shorter and fewer tests; without numbers, only the figures that share a few of them"),
    ] = False


def run_reproduction(plan: ReproductionPlan, control: Control) -> tuple[ReproducedFigure, ...]:
    """Record the tests of the figures, fit them, and write figures, numbers, page and results.

    Sessions of an earlier run in the same folder are used again.

    Raises:
        UnusableInputError: a figure is unknown, the folder holds other files, or a file cannot be written.
        InstrumentError: the simulated instrument did not start.
        CancelledError: it was cancelled; recorded sessions are kept.
    """
    from tissueid.sessions import read_session
    from tissueid_lab.thesis.field_benchmarks import SILVERBOX, WIENER_HAMMERSTEIN, run_benchmark
    from tissueid_lab.thesis.figures import FIGURES, QUICK_TESTS
    from tissueid_lab.thesis.signals import SWEEP, sweep_of

    by_number = {figure.number.casefold(): figure for figure in FIGURES}
    for number in plan.numbers:
        if number.casefold() not in by_number:
            raise UnusableInputError(
                "reproduce.unknown",
                "there is no recipe for {number}; there are: {numbers}",
                number=Verbatim(number),
                numbers=", ".join(figure.number for figure in FIGURES),
            )
    if plan.out is None:
        raise UnusableInputError("reproduce.no_folder", "--out is required: a folder for the figures")
    records = ((SILVERBOX, plan.silverbox), (WIENER_HAMMERSTEIN, plan.wiener_hammerstein))
    scored = [(benchmark, path) for benchmark, path in records if path is not None]
    chosen = [by_number[number.casefold()] for number in plan.numbers] or ([] if scored else list(FIGURES))
    if plan.quick and not plan.numbers:
        chosen = [figure for figure in chosen if {source.recording.name for source in figure.sources} <= QUICK_TESTS]
    chosen = [_quick(figure) for figure in chosen] if plan.quick else chosen
    calibration = None if plan.sweep is None else sweep_columns(plan.sweep)
    began = time.perf_counter()
    check_result_folder(plan.out, (_RESULTS, _PAGE), _RESULTS, _MADE_BY)
    sessions = plan.out / _SESSIONS
    private_folder(sessions)
    recordings = [source.recording for figure in chosen for source in figure.sources]
    swept = SWEEP.shortened() if plan.quick else SWEEP
    if calibration is None and any(figure.calibration for figure in chosen):
        recordings.append(swept)
    failed = _record(recordings, sessions, control)
    if calibration is None and swept in recordings and swept.name not in failed:
        calibration = sweep_of(read_session(sessions / f"{swept.name}.h5"))
    made = [run_benchmark(benchmark, path, control) for benchmark, path in scored]
    for index, figure in enumerate(chosen):
        control.progress(index / len(chosen), Message("reproduce.fitting", _FITTING, number=figure.number))
        control.check()
        begin = time.perf_counter()
        reproduced = _reproduced(figure, sessions, calibration if figure.calibration else None, failed, plan.quick)
        made.append(replace(reproduced, seconds=time.perf_counter() - begin))
    try:
        _write(plan, plan.out, made, began)
    except OSError as error:
        raise unwritable(Path(error.filename or plan.out), error) from error
    return tuple(made)


def _quick(figure: ThesisFigure) -> ThesisFigure:
    """Return a figure with shorter tests, half of a sweep, and at most ``_QUICK`` sources of a label and its fits."""
    groups: dict[Any, list[RecipeSource]] = {}
    for source in figure.sources:
        groups.setdefault((source.label, source.fits), []).append(source)
    kept = [test for group in groups.values() for test in (group[:: max(1, len(group) - 1)])[:_QUICK]]
    sources = [replace(test, recording=test.recording.shortened()) for test in figure.sources if test in kept]
    option, values = figure.sweep
    return replace(figure, sources=tuple(sources), sweep=(option, values[1::2]))


def _record(recordings: Iterable[Recording], folder: Path, control: Control) -> dict[str, str]:
    """Play the tests that are not yet in the folder, each on a simulated instrument of its own.

    Quick tests of one tissue follow each other on one instrument. Return why a test could not be recorded, by its name.

    Raises:
        CancelledError: it was cancelled.
    """
    from tissueid.instrument import open_instrument
    from tissueid.procedures.demo import firmware_process

    missing = {recording.name: recording for recording in recordings if not (folder / f"{recording.name}.h5").exists()}
    waiting = sorted(missing.values(), key=lambda recording: recording.preset if recording.quick else "")
    tried: dict[str, int] = {}
    failed: dict[str, str] = {}
    while waiting:
        control.check()
        first = waiting[0]
        speed = (_QUICK_SPEED if first.quick else _SPEED) / (1 + tried.get(first.name, 0))
        device = (first.preset, first.coil, first.rate_hz)
        with firmware_process(  # with a cool coil
            first.preset, _SEED, speed=speed, coil=first.coil, rate_hz=first.rate_hz
        ) as url:
            instrument = open_instrument(url)
            try:
                while waiting and (waiting[0].preset, waiting[0].coil, waiting[0].rate_hz) == device:
                    recording = waiting[0]
                    control.check()
                    share = 1.0 - len(waiting) / len(missing)
                    control.progress(share, Message("reproduce.recording", _RECORDING, name=Verbatim(recording.name)))
                    tried[recording.name] = tried.get(recording.name, 0) + 1
                    _play(instrument, recording, folder / f"{recording.name}.h5", control)
                    waiting.pop(0)
                    if not recording.quick:
                        break
            except CancelledError:
                raise
            except TissueIDError as error:
                name = waiting[0].name
                if tried[name] == _ATTEMPTS:
                    failed[name] = error.message
                    waiting.pop(0)
            finally:
                instrument.close()
    return failed


def _play(instrument: Instrument, recording: Recording, path: Path, control: Control) -> None:
    """Record a test, or a sweep, into its session; without a complete one there is no file."""
    from tissueid.acquisition import GuidedTest, SessionRecorder, journal_path, run_guided_test
    from tissueid.acquisition.guided import find_surface
    from tissueid.calibration.plans import SweepPlan
    from tissueid.calibration.sweep import Sweep
    from tissueid.instrument import CLINICAL
    from tissueid.sessions import Subject
    from tissueid.stimuli.base import with_preload
    from tissueid.stimuli.kinds.noise import Noise
    from tissueid.stimuli.kinds.rtig import Rtig

    journal_path(path).unlink(missing_ok=True)  # of an earlier attempt; it holds a simulated test
    recorder = SessionRecorder(path, instrument.device, Subject("REPRODUCTION"))
    low, high = recording.force_n
    given = {"force_min_n": low, "force_max_n": high, "seconds": recording.seconds, "seed": recording.seed}
    given |= {"sample_rate": instrument.device.sample_rate_hz, **dict(recording.options)}
    try:
        if recording.stimulus == "sweep":
            sweep = SweepPlan(seconds=recording.seconds, seed=recording.seed, **dict(recording.options))
            Sweep(instrument, sweep, recorder, cancelled=control.check).run()
        else:
            stimulus = (
                Rtig(**given)
                if recording.stimulus == "rtig"
                else with_preload(Noise(distribution=recording.distribution, **given).build())
            )
            surface = find_surface(instrument, cancelled=control.check)
            settings = TestSettings(site=recording.preset.replace("-", " "), coupling=recording.coupling)
            test = GuidedTest(stimulus, settings, limits=CLINICAL)
            run_guided_test(instrument, test, recorder, surface_m=surface, cancelled=control.check)
    except BaseException:
        recorder.finish_or_discard()
        path.unlink(missing_ok=True)
        raise
    recorder.finish()


def _reproduced(
    figure: ThesisFigure, folder: Path, calibration: Any, failed: Mapping[str, str], quick: bool
) -> ReproducedFigure:
    """Return a figure from its sessions, or the reason why it could not be made."""
    from tissueid.analysis.overlay import TestSource, overlay
    from tissueid.reports.overlay_page import overlay_report
    from tissueid.sessions import read_session
    from tissueid_lab.thesis.recipe import NumberRow, ReproducedFigure, shown_vaf

    if figure.study is not None:
        drawn, rows = figure.study(quick)
        return ReproducedFigure(figure, tuple(rows), report=drawn)
    if lacking := [failed[s.recording.name] for s in figure.sources if s.recording.name in failed]:
        return ReproducedFigure(figure, why=lacking[0])
    try:
        sessions = {test: read_session(folder / f"{test.recording.name}.h5") for test in figure.sources}
        if figure.recorded is not None:
            drawn, rows = figure.recorded({test.label: session for test, session in sessions.items()})
            return ReproducedFigure(figure, tuple(rows), report=drawn)
        overlaid = overlay(
            [TestSource(test.label, session, (1,), test.fits) for test, session in sessions.items()],
            named_fits((), figure.fits),
            whole=figure.whole,
            downsample=figure.downsample,
            sweep=figure.sweep,
        )
        rows = () if figure.rows is None else figure.rows(overlaid)
        report = overlay_report(overlaid, calibration, figure.pictures)
        if figure.drawn is not None:
            drawn, rows = figure.drawn(overlaid)
            report = replace(report, pictures=report.pictures + drawn.pictures, plots=report.plots + drawn.plots)
    except UnusableInputError as error:
        return ReproducedFigure(figure, why=error.message)
    warnings = {  # one that several fits share, once
        warning: Message("reproduce.warning", "{fit}: {warning}", fit=Verbatim(entry.fit.label), warning=warning)
        for entry in overlaid.entries
        for warning in entry.analysis.model.report.warnings
    }
    vafs = (NumberRow(what, said, shown_vaf(overlaid, source, fit)) for what, said, source, fit in figure.vafs)
    return ReproducedFigure(figure, (*vafs, *rows), report=report, warnings=tuple(warnings.values()))


def _write(plan: ReproductionPlan, out: Path, made: Sequence[ReproducedFigure], began: float) -> None:
    """Write the pictures and numbers of each figure, the results, the page and its text.

    Raises:
        OSError: the disk is full or not writable.
    """
    from tissueid.version import SOFTWARE
    from tissueid_lab.thesis.recipe import as_markdown, write_reproduction

    for figure in made:
        # A quick run has the pictures on its page.
        if figure.report is not None and figure.report.pictures and not plan.quick:
            folder = out / _FIGURES / figure.figure.number.replace(" ", "-").lower()
            private_folder(folder.parent)
            figure.report.write_figures(folder)
            write_text(folder / "numbers.csv", figure.report.csv())
    write_reproduction(out / _PAGE, made)
    results = {
        "made_by": _MADE_BY,
        "software": SOFTWARE,
        "quick": plan.quick,
        "seconds": time.perf_counter() - began,
        "figures": [answer_of(figure) for figure in made],
    }
    write_text(out / _RESULTS, json_text(results))
    write_text(out / _TEXT, as_markdown(results))


def answer_of(reproduced: ReproducedFigure) -> dict[str, Any]:
    """Return a figure for JSON: number, title, thesis and present value of each quantity, remark and warnings."""
    return {
        "number": reproduced.figure.number,
        "title": str(reproduced.figure.title),
        "rows": [{name: str(value) for name, value in row._asdict().items()} for row in reproduced.rows],
        "why_missing": str(reproduced.why) or None,
        "remark": reproduced.figure.remark,
        "warnings": [str(text) for text in reproduced.warnings],
        "seconds": reproduced.seconds,
        "against": str(reproduced.figure.against),
    }
