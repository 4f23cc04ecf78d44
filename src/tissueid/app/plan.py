"""What one test is to be: the choices of the form, and the file that it goes to."""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from platformdirs import user_documents_path

from tissueid.acquisition.choice import PRELOAD_S, NoiseChoice, playable, playable_file
from tissueid.configuration import Configuration
from tissueid.errors import UnusableInputError
from tissueid.instrument import PROFILES, Limits
from tissueid.language import _
from tissueid.stimuli import FeedbackKind, Stimulus, StimulusKind, get_stimulus
from tissueid.stimuli.kinds.noise import Noise
from tissueid.stimuli.redesign import DepthDesign

if TYPE_CHECKING:  # each takes long to import, and the window starts without them
    from tissueid.acquisition.multistep import MultistepTest
    from tissueid.identification.online.stopping import StopRule

DEFAULT_URL = "simulated://forearm"
ANONYMOUS = "anonymous"
FROM_FILE = "file"
MULTISTEP = "multistep"
_ANY_RATE_HZ = 2000.0
"""Options are checked at this rate before it is known which instrument answers."""
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
"""Suggestions; any text will do."""
DISTRIBUTIONS: tuple[str, ...] = tuple(
    name for name in get_args(Noise.model_fields["distribution"].annotation) if name not in ("binary", "quantiles")
)
"""A binary signal is all edges, which hurt (thesis 3.1.1), and quantiles need a table."""


@dataclass(frozen=True, kw_only=True)
class Plan(NoiseChoice):
    """One test as the form describes it. ``limits`` names a profile, ``configuration`` and ``probe`` what they are of.

    Without a ``probe`` it is the first one that is made for the configuration. ``lower_force`` takes the highest force
    down to what the instrument gives where that is less, which is refused otherwise. ``sitting`` is what the tests of
    one sitting have in common, each in a file of its own, and ``repeat`` counts them from 1.

    ``stimulus_kind`` is a kind of stimulus, ``FROM_FILE`` for the one saved in ``stimulus_file``, or ``MULTISTEP``: as
    many tests as the option ``steps`` says, each designed by those before to spread evenly over the depths.
    ``options`` are those of the kind that have no field here, by name. ``stop_when`` are targets as ``StopRule`` reads
    them. ``under_probe`` is one of ``FIXTURES``, or empty for tissue or a sample.
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
        """Refuse what can be seen to be wrong before an instrument is touched.

        Raises:
            UnusableInputError: says what to fill in.
        """
        if not self.url:
            raise UnusableInputError(_("choose an instrument, or type its address"))
        if not self.site:
            raise UnusableInputError(_("fill in the site: where on the body, or which material"))
        if self.min_force_n >= self.max_force_n:
            raise UnusableInputError(
                _("the lowest force ({low:g} N) must be below the highest ({high:g} N)").format(
                    low=self.min_force_n, high=self.max_force_n
                )
            )
        self.set_up()
        self.stop_rule()
        if self.stimulus_kind == MULTISTEP:
            self._depth_design(_ANY_RATE_HZ)
            if self.stop_when:
                raise UnusableInputError(_("a test in steps designs its stimuli itself: it takes no stop rule"))
        elif self.stimulus_kind != FROM_FILE:
            self._specification(_ANY_RATE_HZ)
        elif self.stimulus_file is None:
            raise UnusableInputError(_("choose the file of the saved stimulus"))

    def prepared(self, sample_rate_hz: float) -> Stimulus | FeedbackKind:
        """Return what the test plays, with its preload, or what generates it.

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
        """Return the rule that ends the test early; None where none is asked for.

        Raises:
            UnusableInputError: a target does not read as one.
        """
        if not self.stop_when:
            return None
        from tissueid.identification.online.stopping import StopRule

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
        """This plan on an instrument that gives so much force at most, N."""
        if not self.lower_force or self.max_force_n <= greatest_n:
            return self
        return replace(self, max_force_n=greatest_n)

    @property
    def notes(self) -> dict[str, str | float]:
        """What a session keeps of the sitting with the test."""
        return {"sitting": self.sitting, "repeat": float(self.repeat)} if self.sitting else {}

    def set_up(self) -> Configuration:
        """How the instrument meets the tissue.

        Raises:
            UnusableInputError: configuration, probe and spring do not go together.
        """
        return Configuration.of(self.configuration, self.probe, self.external_spring_n_per_m)

    @property
    def total_s(self) -> float:
        """Seconds that the stimulus and its preload last, as far as the plan tells; a saved one has its own length."""
        each = PRELOAD_S + self.seconds
        return each * int(dict(self.options)["steps"]) if self.stimulus_kind == MULTISTEP else each


def longest_stimulus_s(limits: str) -> float:
    """What a profile leaves for the stimulus once the preload is played."""
    return PROFILES[limits].max_seconds - PRELOAD_S


def default_folder() -> Path:
    """Where sessions go unless somebody says otherwise."""
    return user_documents_path() / "TissueID"


def dated_path(folder: Path, moment: datetime) -> Path:
    """A session file named by date and time that is not there yet, nor left unfinished."""
    name = f"{moment:%Y-%m-%d_%H-%M-%S}"
    number = 1
    while True:
        path = folder / (f"{name}.h5" if number == 1 else f"{name}_{number}.h5")
        if not path.exists() and not path.with_name(f"{path.name}.journal").exists():
            return path
        number += 1
