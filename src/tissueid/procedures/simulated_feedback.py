"""Trial of a feedback stimulus on a simulated tissue, which has no samples before its test."""

from __future__ import annotations

import tempfile
from pathlib import Path

from tissueid.acquisition import GuidedTest, SessionRecorder, run_guided_test
from tissueid.acquisition.guided import check_test
from tissueid.errors import UnusableInputError
from tissueid.instrument import Limits, open_instrument
from tissueid.instrument.discovery import IN_PROCESS
from tissueid.language import marked
from tissueid.messages import Message, Verbatim
from tissueid.procedures.control import Control
from tissueid.sessions import Test
from tissueid.stimuli import FeedbackKind

_PLAYING = marked("Playing the stimulus")


def play_on_tissue(kind: FeedbackKind, url: str, limits: Limits, control: Control) -> Test:
    """Run one test on a simulated tissue and return it; nothing is saved.

    Raises:
        UnusableInputError: a real instrument was named.
        LimitError: the stimulus could exceed the limits of the instrument, or did.
    """
    if not url.startswith(IN_PROCESS):
        raise UnusableInputError(
            Message(
                "stimulus.feedback_on_instrument",
                "a feedback stimulus is designed on {tissue}; "
                "'tissueid test --stimulus {kind}' plays it on an instrument",
                tissue=Verbatim(f"{IN_PROCESS}TISSUE"),
                kind=Verbatim(kind.name),
            )
        )
    instrument = open_instrument(url)
    guided = GuidedTest(kind, url, limits=limits)
    try:
        check_test(guided, instrument.device)
        with tempfile.TemporaryDirectory() as folder:
            recorder = SessionRecorder(Path(folder) / "designed.h5", instrument.device)
            try:
                run_guided_test(
                    instrument, guided, recorder, progress=lambda step: control.progress(step.fraction, _PLAYING)
                )
            except BaseException:
                recorder.finish_or_discard()
                raise
            return recorder.finish().tests[0]
    finally:
        instrument.close()
