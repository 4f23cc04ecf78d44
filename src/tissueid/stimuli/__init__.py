"""Stimuli: what to play. Specifications that build the same history every time, or generate it while a test runs."""

from tissueid.stimuli.base import (
    OpenLoopKind,
    Ranged,
    Stimulus,
    StimulusKind,
    build_specified,
    build_stimulus,
    get_stimulus,
    guided,
    rebuild,
    specified,
    stimulus,
    stimulus_names,
    to_voltage,
)
from tissueid.stimuli.feedback import FeedbackKind, FeedbackSource

__all__ = [
    "FeedbackKind",
    "FeedbackSource",
    "OpenLoopKind",
    "Ranged",
    "Stimulus",
    "StimulusKind",
    "build_specified",
    "build_stimulus",
    "get_stimulus",
    "guided",
    "rebuild",
    "specified",
    "stimulus",
    "stimulus_names",
    "to_voltage",
]
