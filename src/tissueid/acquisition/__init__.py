"""Running a test: crash-safe journal, guided procedure, live estimates, quality gate and recovery."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tissueid.lazy_import import lazy_attributes

if TYPE_CHECKING:
    from tissueid.acquisition.guided import GuidedTest, Phase, Progress, play, run_guided_test
    from tissueid.acquisition.journal import JournalError, journal_path
    from tissueid.acquisition.multistep import MultistepTest, Step, check_multistep, run_multistep
    from tissueid.acquisition.recorder import SessionRecorder
    from tissueid.acquisition.recovery import recover
    from tissueid.acquisition.stimulus_choice import PRELOAD_S, usual_noise
else:
    __getattr__ = lazy_attributes(
        __name__,
        {
            "stimulus_choice": ("PRELOAD_S", "usual_noise"),
            "guided": ("GuidedTest", "Phase", "Progress", "play", "run_guided_test"),
            "journal": ("JournalError", "journal_path"),
            "multistep": ("MultistepTest", "Step", "check_multistep", "run_multistep"),
            "recorder": ("SessionRecorder",),
            "recovery": ("recover",),
        },
    )

__all__ = [
    "PRELOAD_S",
    "GuidedTest",
    "JournalError",
    "MultistepTest",
    "Phase",
    "Progress",
    "SessionRecorder",
    "Step",
    "check_multistep",
    "journal_path",
    "play",
    "recover",
    "run_guided_test",
    "run_multistep",
    "usual_noise",
]
