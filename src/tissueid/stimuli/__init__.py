"""Stimuli: what to play. Specifications that build the same force history every time."""

from tissueid.stimuli.base import (
    Stimulus,
    StimulusKind,
    get_stimulus,
    guided,
    rebuild,
    stimulus,
    stimulus_names,
    to_voltage,
)

__all__ = [
    "Stimulus",
    "StimulusKind",
    "get_stimulus",
    "guided",
    "rebuild",
    "stimulus",
    "stimulus_names",
    "to_voltage",
]
