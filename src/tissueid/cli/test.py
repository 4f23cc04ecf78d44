"""``tissueid test``."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from tissueid.acquisition import GuidedTest, NoiseChoice, Progress, SessionRecorder, run_guided_test
from tissueid.acquisition.guided import check_test, find_surface
from tissueid.cli.output import check_json, console, progress_bars, write_json
from tissueid.errors import TissueIDError, UnusableInputError
from tissueid.instrument import PROFILES, open_instrument
from tissueid.sessions import Session, Subject

MAX_TEXT = 200


def show_progress(show: Callable[[str, float], None], label: str) -> Callable[[Progress], None]:
    """Progress of a test as one bar."""
    return lambda progress: show(label, progress.fraction)


def run_tests(
    url: str,
    site: str,
    out: Path,
    choice: NoiseChoice,
    repeats: int,
    limits_name: str,
    pseudonym: str,
    json_file: Path | None,
) -> None:
    """Place once, then run the test as often as asked, all into one session."""
    if limits_name not in PROFILES:
        raise UnusableInputError(f"limits are {' or '.join(PROFILES)}, not {limits_name!r}")
    limits = PROFILES[limits_name]
    for what, text in (("site", site), ("subject", pseudonym)):
        if not text.strip() or len(text) > MAX_TEXT or not text.isprintable():
            raise UnusableInputError(f"the {what} must be one line of 1 to {MAX_TEXT} printable characters")
    check_json(json_file)
    if json_file is not None and json_file.absolute() == out.absolute():
        raise UnusableInputError("the session and the JSON cannot be the same file")
    instrument = open_instrument(url)
    try:
        stimulus = choice.stimulus(instrument.device.sample_rate_hz)
        check_test(GuidedTest(stimulus, site, limits=limits), instrument.device)
        recorder = SessionRecorder(out, instrument.device, Subject(pseudonym))
        try:
            with progress_bars() as show:
                surface = find_surface(instrument, limits, progress=show_progress(show, "placing the probe"))
                for repeat in range(repeats):
                    test = GuidedTest(stimulus, site, limits=limits, repeat_of=1 if repeat else None)
                    label = f"test {repeat + 1} of {repeats}"
                    run_guided_test(instrument, test, recorder, surface_m=surface, progress=show_progress(show, label))
        except (TissueIDError, KeyboardInterrupt):
            _keep(recorder)
            raise
        session = recorder.finish()
    finally:
        instrument.close()
    _tell(out, session)
    if json_file is not None:
        tests = [{"test": test.number, "status": test.status, "samples": test.samples} for test in session.tests]
        write_json(json_file, {"session": str(out), "session_id": session.session_id, "tests": tests})


def _keep(recorder: SessionRecorder) -> None:
    """Whatever was recorded before it went wrong becomes a session; an empty one leaves nothing."""
    session = recorder.finish_or_discard()
    if session is not None:
        _tell(recorder.path, session)


def _tell(path: Path, session: Session) -> None:
    console.print(f"session: {path}", markup=False)
    for test in session.tests:
        console.print(f"  test {test.number}: {test.status}, {test.samples} samples", markup=False)
        if lost := test.notes.get("samples_lost"):
            console.print(f"    {lost:.0f} samples were lost and are marked as such", markup=False)
