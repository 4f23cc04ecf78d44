"""Stimuli: specifications of open-loop force or voltage histories and of feedback-generated set-points."""

from tissueid.stimuli.base import (
    FeedbackKind,
    FeedbackSource,
    OpenLoopKind,
    Ranged,
    Stimulus,
    StimulusKind,
    build_from_specification,
    build_stimulus,
    get_stimulus,
    parse_description,
    rebuild,
    stimulus,
    stimulus_names,
    to_voltage,
    with_preload,
)

__all__ = [
    "FeedbackKind",
    "FeedbackSource",
    "OpenLoopKind",
    "Ranged",
    "Stimulus",
    "StimulusKind",
    "build_from_specification",
    "build_stimulus",
    "get_stimulus",
    "parse_description",
    "rebuild",
    "stimulus",
    "stimulus_names",
    "to_voltage",
    "with_preload",
]
