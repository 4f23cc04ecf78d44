"""What one test is to be: the choices of the form, and the file that it goes to."""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import get_args

from platformdirs import user_documents_path

from tissueid.acquisition.choice import PRELOAD_S, NoiseChoice
from tissueid.app.language import _
from tissueid.configuration import Configuration
from tissueid.errors import UnusableInputError
from tissueid.instrument import PROFILES
from tissueid.stimuli.kinds.noise import Noise

DEFAULT_URL = "simulated://forearm"
ANONYMOUS = "anonymous"
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
        """Seconds that the stimulus and its preload last."""
        return PRELOAD_S + self.seconds


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
