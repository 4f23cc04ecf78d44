"""The plan of one test: the values of the form and the file of the session."""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from platformdirs import user_documents_path

from tissueid.acquisition.stimulus_choice import PRELOAD_S, NoiseChoice, playable, playable_file
from tissueid.configuration import Configuration
from tissueid.errors import UnusableInputError
from tissueid.formatting import ANONYMOUS
from tissueid.instrument import PROFILES, Limits
from tissueid.messages import Message
from tissueid.stimuli import FeedbackKind, Stimulus, StimulusKind, get_stimulus
from tissueid.stimuli.depth_uniform import DepthDesign
from tissueid.stimuli.kinds.noise import Noise

if TYPE_CHECKING:  # each takes long to import, and the window starts without them
    from tissueid.acquisition.multistep import MultistepTest
    from tissueid.identification.live.stopping import StopRule

DEFAULT_URL = "simulated://forearm"
FROM_FILE = "file"
MULTISTEP = "multistep"
NO_INSTRUMENT = Message("plan.no_instrument", "choose an instrument, or type its address")
_ANY_RATE_HZ = 2000.0
"""Sample rate at which options are checked before an instrument is open, Hz."""
SITES = (
    "left forearm, posterior",
    "left forearm, anterior",
    "right forearm, posterior",
    "right forearm, anterior",
    "left upper arm",
    "right upper arm",
    "left thigh",
    "right thigh",
    "left calf",
    "right calf",
    "abdomen",
    "material sample",
)
"""Suggested sites; any text is allowed."""
DISTRIBUTIONS: tuple[str, ...] = tuple(
    name for name in get_args(Noise.model_fields["distribution"].annotation) if name not in ("binary", "quantiles")
)
"""Distributions offered: without "binary", whose edges hurt (thesis 3.1.1), and "quantiles", which needs a table."""


@dataclass(frozen=True, kw_only=True)
class Plan(NoiseChoice):
    """One test as entered in the form.

    ``limits`` is the name of a profile of limits, ``configuration`` and ``probe`` those of the session format. Without
    ``probe`` the first probe of the configuration is used. ``lower_force`` reduces the highest force to that of the
    instrument where it is less; without it such a plan is refused. ``sitting`` is the key shared by the tests of one
    sitting, each in its own file, and ``repeat`` is their number, from 1.

    ``stimulus_kind`` is a kind of stimulus, ``FROM_FILE`` for the one in ``stimulus_file``, or ``MULTISTEP``: a series
    of ``steps`` tests, each designed from the previous ones to cover all depths evenly. ``options`` are the options of
    the kind without a field here, by name. ``stop_when`` are targets in the notation of ``StopRule``. ``under_probe``
    is one of ``FIXTURES``, or empty for tissue or a sample.
    """

    url: str
    site: str
    path: Path
    pseudonym: str = ANONYMOUS
    limits: str = "clinical"
    configuration: str = "indentation"
    probe: str | None = None
    external_spring_n_per_m: float = 0.0
    lower_force: bool = False
    stimulus_kind: str = Noise.name
    options: tuple[tuple[str, Any], ...] = ()
    stimulus_file: Path | None = None
    stop_when: tuple[str, ...] = ()
    under_probe: str = ""
    sitting: str = ""
    repeat: int = 0

    def check(self) -> None:
        """Raise an error for a plan that is wrong before an instrument is opened.

        Raises:
            UnusableInputError: a value is missing or does not fit the others.
        """
        if not self.url:
            raise UnusableInputError(NO_INSTRUMENT)
        if not self.site:
            raise UnusableInputError(Message("plan.no_site", "fill in the site: where on the body, or which material"))
        if self.min_force_n >= self.max_force_n:
            raise UnusableInputError(
                Message(
                    "plan.force_range",
                    "the lowest force ({low:g} N) must be below the highest ({high:g} N)",
                    low=self.min_force_n,
                    high=self.max_force_n,
                )
            )
        self.set_up()
        self.stop_rule()
        if self.stimulus_kind == MULTISTEP:
            self._depth_design(_ANY_RATE_HZ)
            if self.stop_when:
                raise UnusableInputError(
                    Message("plan.no_stop_rule", "a test in steps designs its stimuli itself: it takes no stop rule")
                )
        elif self.stimulus_kind != FROM_FILE:
            self._specification(_ANY_RATE_HZ)
        elif self.stimulus_file is None:
            raise UnusableInputError(Message("plan.no_stimulus_file", "choose the file of the saved stimulus"))

    def prepared(self, sample_rate_hz: float) -> Stimulus | FeedbackKind:
        """Return the stimulus of the test with its preload, or its generator.

        Raises:
            UnusableInputError: the options do not make a stimulus, or the file cannot be used.
        """
        if self.stimulus_kind == FROM_FILE:
            assert self.stimulus_file is not None
            return playable_file(self.stimulus_file)
        return playable(self._specification(sample_rate_hz))

    def multistep(self, sample_rate_hz: float, limits: Limits) -> MultistepTest:
        """Return the tests of a plan in steps.

        Raises:
            UnusableInputError: the options do not make one.
        """
        from tissueid.acquisition.multistep import MultistepTest

        chosen = dict(self.options)
        return MultistepTest(
            self._depth_design(sample_rate_hz),
            self.site,
            steps=int(chosen["steps"]),
            target=float(chosen["target"]),
            seed=self.seed,
            limits=limits,
            configuration=self.set_up(),
        )

    def stop_rule(self) -> StopRule | None:
        """Return the rule that ends the test early; None for a plan without one.

        Raises:
            UnusableInputError: a target does not read as one.
        """
        if not self.stop_when:
            return None
        from tissueid.identification.live.stopping import StopRule

        return StopRule.from_words(self.stop_when)

    def _specification(self, sample_rate_hz: float) -> StimulusKind:
        kind = Noise if self.stimulus_kind == Noise.name else get_stimulus(self.stimulus_kind)
        own = self.noise_options(sample_rate_hz)
        if self.stimulus_kind != Noise.name:
            own.pop("distribution")  # an option of the kind, with names of its own
        known = {name: value for name, value in own.items() if name in kind.model_fields}
        return kind.from_options(known | dict(self.options))

    def _depth_design(self, sample_rate_hz: float) -> DepthDesign:
        chosen = self.noise_options(sample_rate_hz) | dict(self.options)
        return DepthDesign.from_options({name: chosen[name] for name in DepthDesign.model_fields if name in chosen})

    def within(self, greatest_n: float) -> Plan:
        """Return this plan for an instrument with a maximum force of ``greatest_n``, N."""
        if not self.lower_force or self.max_force_n <= greatest_n:
            return self
        return replace(self, max_force_n=greatest_n)

    @property
    def notes(self) -> dict[str, str | float]:
        """Notes on the sitting that the session stores with the test."""
        return {"sitting": self.sitting, "repeat": float(self.repeat)} if self.sitting else {}

    def set_up(self) -> Configuration:
        """Return the configuration: direction, probe and external spring.

        Raises:
            UnusableInputError: configuration, probe and spring do not go together.
        """
        return Configuration.of(self.configuration, self.probe, self.external_spring_n_per_m)

    @property
    def total_s(self) -> float:
        """Duration of the stimulus and its preload, s. A saved stimulus has its own duration."""
        each = PRELOAD_S + self.seconds
        return each * int(dict(self.options)["steps"]) if self.stimulus_kind == MULTISTEP else each


def longest_stimulus_s(limits: str) -> float:
    """Return the longest stimulus that a profile of limits allows after the preload, s."""
    return PROFILES[limits].max_seconds - PRELOAD_S


def default_folder() -> Path:
    """Return the default folder of sessions."""
    return user_documents_path() / "TissueID"


def dated_path(folder: Path, moment: datetime) -> Path:
    """Return an unused path of a session, named by date and time, that has no journal either."""
    name = f"{moment:%Y-%m-%d_%H-%M-%S}"
    number = 1
    while True:
        path = folder / (f"{name}.h5" if number == 1 else f"{name}_{number}.h5")
        if not path.exists() and not path.with_name(f"{path.name}.journal").exists():
            return path
        number += 1
