"""Figures and tables of the thesis (Chen 2010) from simulated tests, with its numbers and those found here."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tissueid.atomic_write import private_folder
from tissueid.errors import CancelledError, TissueIDError, UnusableInputError
from tissueid.language import marked
from tissueid.messages import Message, Verbatim
from tissueid.procedures.control import Control
from tissueid.procedures.output_files import json_text, unwritable, write_text
from tissueid.procedures.overlay import named_fits, sweep_columns
from tissueid.procedures.plan_options import Option, Plan

if TYPE_CHECKING:  # each takes long to import
    from tissueid.instrument import Instrument
    from tissueid.procedures.thesis_figures import Recording, ThesisFigure
    from tissueid.reports.reproduction import ReproducedFigure

_SESSIONS, _FIGURES = "sessions", "figures"
_RESULTS, _PAGE = "results.json", "report.html"
_MADE_BY = "tissueid reproduce"
_QUICK = 3
"""Number of repeats of a site, and of small tests of a series, that a quick run keeps."""
_SEED = 1
"""Seed of the sensor noise of the simulated instrument."""
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
        Option("--out", metavar="DIR", help="folder for sessions/, figures/, results.json, report.html"),
    ] = None
    sweep: Annotated[
        Path | None, Option("--sweep-file", metavar="FILE", help="dynamic sweep that is drawn under depth profiles")
    ] = None
    quick: Annotated[bool, Option("--quick", help="fewer repeats; the same figures")] = False


def listed_figures() -> tuple[tuple[str, str], ...]:
    """Return number and title of every figure."""
    from tissueid.procedures.thesis_figures import FIGURES

    return tuple((figure.number, figure.title) for figure in FIGURES)


def run_reproduction(plan: ReproductionPlan, control: Control) -> tuple[ReproducedFigure, ...]:
    """Record the tests of the figures, fit them, and write figures, numbers, page and results.

    Sessions of an earlier run in the same folder are used again.

    Raises:
        UnusableInputError: a figure is unknown, the folder holds other files, or a file cannot be written.
        InstrumentError: the simulated instrument did not start.
        CancelledError: it was cancelled; recorded sessions are kept.
    """
    from tissueid.procedures.thesis_figures import FIGURES

    known = {figure.number.casefold(): figure for figure in FIGURES}
    for number in plan.numbers:
        if number.casefold() not in known:
            raise UnusableInputError(
                Message(
                    "reproduce.unknown",
                    "there is no recipe for {number}; there are: {numbers}",
                    number=Verbatim(number),
                    numbers=", ".join(figure.number for figure in FIGURES),
                )
            )
    if plan.out is None:
        raise UnusableInputError(Message("reproduce.no_folder", "--out is required: a folder for the figures"))
    chosen = [known[number.casefold()] for number in plan.numbers] or list(FIGURES)
    chosen = [_quick(figure) for figure in chosen] if plan.quick else chosen
    calibration = None if plan.sweep is None else sweep_columns(plan.sweep)
    _check_folder(plan.out)
    sessions = plan.out / _SESSIONS
    private_folder(sessions)
    failed = _record((source.recording for figure in chosen for source in figure.sources), sessions, control)
    made = []
    for place, figure in enumerate(chosen):
        control.progress(place / len(chosen), Message("reproduce.fitting", _FITTING, number=figure.number))
        control.check()
        made.append(_reproduced(figure, sessions, calibration if figure.calibration else None, failed, plan.quick))
    try:
        _write(plan.out, made)
    except OSError as error:
        raise unwritable(Path(error.filename or plan.out), error) from error
    return tuple(made)


def _quick(figure: ThesisFigure) -> ThesisFigure:
    """Return a figure with at most ``_QUICK`` sources of the same label and fits."""
    from dataclasses import replace

    kept: dict[Any, int] = {}
    sources = []
    for source in figure.sources:
        key = source.label, source.fits
        kept[key] = kept.get(key, 0) + 1
        if kept[key] <= _QUICK:
            sources.append(source)
    return replace(figure, sources=tuple(sources))


def _check_folder(out: Path) -> None:
    """Make the folder, and check that only results of an earlier run are overwritten.

    Raises:
        UnusableInputError: it is a file, or holds other results.
    """
    if out.exists() and not out.is_dir():
        raise UnusableInputError(Message("demo.no_folder", "{path} is not a folder", path=str(out)))
    private_folder(out)
    if not any((out / name).exists() for name in (_RESULTS, _PAGE)):
        return
    try:
        made_by = json.loads((out / _RESULTS).read_text(encoding="utf-8")).get("made_by")
    except (OSError, ValueError, AttributeError):
        made_by = None
    if made_by != _MADE_BY:
        raise UnusableInputError(
            Message(
                "reproduce.other_results",
                "{folder} contains other results; choose another folder",
                folder=str(out),
            )
        )


def _record(recordings: Iterable[Recording], folder: Path, control: Control) -> dict[str, str]:
    """Play the tests that are not yet in the folder, each on a simulated instrument of its own.

    Return why a test could not be recorded, by its name.

    Raises:
        CancelledError: it was cancelled.
    """
    from tissueid.acquisition import journal_path
    from tissueid.instrument import open_instrument
    from tissueid.procedures.demo import firmware_process

    missing = {one.name: one for one in recordings if not (folder / f"{one.name}.h5").exists()}
    failed: dict[str, str] = {}
    for done, one in enumerate(missing.values()):
        control.check()
        control.progress(done / len(missing), Message("reproduce.recording", _RECORDING, name=Verbatim(one.name)))
        path = folder / f"{one.name}.h5"
        journal_path(path).unlink(missing_ok=True)  # of an earlier attempt; it holds a simulated test
        with firmware_process(one.preset, _SEED) as url:  # of its own, with a cool coil
            instrument = open_instrument(url)
            try:
                _play(instrument, one, path)
            except CancelledError:
                raise
            except TissueIDError as error:
                failed[one.name] = error.message
            finally:
                instrument.close()
    return failed


def _play(instrument: Instrument, recording: Recording, path: Path) -> None:
    """Find the surface and play one test into its session."""
    from tissueid.acquisition import GuidedTest, SessionRecorder, run_guided_test
    from tissueid.acquisition.guided import find_surface
    from tissueid.instrument import CLINICAL
    from tissueid.sessions import Subject
    from tissueid.stimuli.base import with_preload
    from tissueid.stimuli.kinds.noise import Noise

    low, high = recording.force_n
    noise = Noise(
        force_min_n=low,
        force_max_n=high,
        seconds=recording.seconds,
        seed=recording.seed,
        distribution=recording.distribution,
        sample_rate=instrument.device.sample_rate_hz,
        **dict(recording.options),
    )
    surface = find_surface(instrument)
    recorder = SessionRecorder(path, instrument.device, Subject("REPRODUCTION"))
    test = GuidedTest(with_preload(noise.build()), site=recording.preset.replace("-", " "), limits=CLINICAL)
    run_guided_test(instrument, test, recorder, surface_m=surface)
    recorder.finish()


def _reproduced(
    figure: ThesisFigure, folder: Path, calibration: Any, failed: Mapping[str, str], quick: bool
) -> ReproducedFigure:
    """Return a figure from its sessions, or the reason why it could not be made."""
    from tissueid.analysis.overlay import TestSource, overlay
    from tissueid.reports.overlay import overlay_report
    from tissueid.reports.reproduction import ReproducedFigure
    from tissueid.sessions import read_session

    if figure.study is not None:
        drawn, studied = figure.study(quick)
        return ReproducedFigure(figure.number, figure.title, tuple(studied), report=drawn)
    if lacking := [failed[s.recording.name] for s in figure.sources if s.recording.name in failed]:
        return ReproducedFigure(figure.number, figure.title, why=lacking[0])
    try:
        sources = [
            TestSource(one.label, read_session(folder / f"{one.recording.name}.h5"), (1,), one.fits)
            for one in figure.sources
        ]
        found = overlay(
            sources,
            named_fits((), figure.fits),
            whole=figure.whole,
            downsample=figure.downsample,
            sweep=figure.sweep,
        )
        rows = tuple(figure.rows(found))
    except UnusableInputError as error:
        return ReproducedFigure(figure.number, figure.title, why=error.message)
    report = overlay_report(found, calibration, figure.pictures)
    return ReproducedFigure(figure.number, figure.title, rows, report=report)


def _write(out: Path, made: Sequence[ReproducedFigure]) -> None:
    """Write the pictures and numbers of each figure, the results and the page.

    Raises:
        OSError: the disk is full or not writable.
    """
    from tissueid.reports.reproduction import write_reproduction

    for one in made:
        if one.report is not None and one.report.pictures:
            folder = out / _FIGURES / one.number.replace(" ", "-").lower()
            private_folder(out / _FIGURES)
            one.report.write_figures(folder)
            write_text(folder / "numbers.csv", one.report.csv())
    write_text(out / _RESULTS, json_text({"made_by": _MADE_BY, "figures": [answer_of(one) for one in made]}))
    write_reproduction(out / _PAGE, made)


def answer_of(figure: ReproducedFigure) -> dict[str, Any]:
    """Return a figure for JSON: number, title, and thesis and present value of each quantity."""
    rows = [asdict(row) for row in figure.rows]
    return {"number": figure.number, "title": str(figure.title), "rows": rows, "why_missing": figure.why or None}
