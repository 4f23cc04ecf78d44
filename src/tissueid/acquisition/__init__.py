"""Running a test: the journal that survives a dead host, the guided procedure, recovery."""

from tissueid.acquisition.choice import PRELOAD_S, NoiseChoice
from tissueid.acquisition.guided import GuidedTest, Phase, Progress, play, run_guided_test
from tissueid.acquisition.journal import JournalError, journal_path
from tissueid.acquisition.multistep import MultistepTest, Step, check_multistep, run_multistep
from tissueid.acquisition.recorder import SessionRecorder
from tissueid.acquisition.recovery import recover

__all__ = [
    "PRELOAD_S",
    "GuidedTest",
    "JournalError",
    "MultistepTest",
    "NoiseChoice",
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
]
