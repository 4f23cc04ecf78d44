"""Noise about a load, as large as makes mass, damping and stiffness there known soonest."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar, Self

from pydantic import Field, model_validator

from tissueid.errors import UnusableInputError
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.records import Estimate
from tissueid.stimuli.amplitude_design import DesignPrecision, LocalTissue, predicted_precision
from tissueid.stimuli.base import OpenLoopKind, Stimulus, stimulus
from tissueid.stimuli.kinds.noise import Noise
from tissueid.stimuli.spectra import Butterworth

_GROWTH_PER_M = 1000.0
"""Growth of log K with depth without a test: e-fold in a millimetre, skin under some newtons."""

_MOST_OF_RANGE = 1.0 / math.sqrt(3.0)
"""Root-mean-square of an even distribution over its half range."""

_FIRST_TEST = ("mass_kg", "damping_n_s_per_m", "stiffness_n_per_m", "stiffness_growth_per_m")
"""Parameters of a fitted test that are options of the design under the same name."""

_SOFTEST = 0.1
"""Share of the first test's stiffness to which its growth is followed back at most."""


@stimulus
class Designed(OpenLoopKind):
    """Evenly distributed noise about one load, as large as the tissue's own bend and the noise of the force allow.

    For the question "mass, damping and stiffness under this load", and no other load: the swing is some half a newton
    either way. Smaller, it drowns in the noise of the measured force; larger, the line no longer holds and the answer
    is an average over depths that depends on the stimulus. The defaults are for skin that was not tested before;
    :meth:`after` takes what a first test has found.
    """

    name: ClassVar[str] = "designed"
    title: ClassVar[str] = marked("Noise about one load")

    load_n: float = Field(5.5, gt=0.0, le=100.0, description=marked("Load about which the tissue is to be known, N"))
    force_min_n: float = Field(0.5, ge=-100.0, le=100.0, description=marked("Force below which it never goes, N"))
    force_max_n: float = Field(10.5, ge=-100.0, le=100.0, description=marked("Force beyond which it never goes, N"))
    seconds: float = Field(2.0, gt=0.0, le=600.0, description=marked("Length, s"))
    sample_rate: float = Field(2000.0, gt=0.0, le=1e6, description=marked("Samples a second"))
    seed: int = Field(0, ge=0, le=2**63 - 1, description=marked("The same seed gives the same samples"))
    cutoff_hz: float = Field(
        100.0, gt=0.0, description=marked("Cut-off frequency, Hz: twice the natural frequency will do")
    )
    mass_kg: float = Field(0.09, gt=0.0, le=10.0, description=marked("Mass that is expected, kg, moving part included"))
    damping_n_s_per_m: float = Field(12.0, gt=0.0, le=1e4, description=marked("Damping that is expected, N s/m"))
    stiffness_n_per_m: float | None = Field(
        None, gt=0.0, le=1e7, description=marked("Stiffness under the load, N/m; growth times load when not given")
    )
    stiffness_growth_per_m: float = Field(
        _GROWTH_PER_M, ge=0.0, le=1e5, description=marked("Growth of the logarithm of the stiffness with depth, 1/m")
    )
    damping_turn_n_s2_per_m2: float = Field(
        70.0,
        ge=0.0,
        le=1e4,
        description=marked("Growth of the damping with speed, N s2/m2: more on the way in than out"),
    )
    force_noise_n_per_root_hz: float = Field(
        1.2e-3, gt=0.0, le=1.0, description=marked("Noise density of the measured force, N per root Hz")
    )

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if not self.force_min_n < self.load_n < self.force_max_n:
            raise UnusableInputError(
                Message(
                    "designed.load",
                    "the load of {load_n:g} N must lie between the least and the greatest force, "
                    "{force_min_n:g} and {force_max_n:g} N",
                    load_n=self.load_n,
                    force_min_n=self.force_min_n,
                    force_max_n=self.force_max_n,
                )
            )
        Butterworth(self.cutoff_hz).check(self.sample_rate)
        self._noise()
        return self

    @classmethod
    def after(cls, parameters: Mapping[str, Estimate], first_load_n: float, load_n: float, **options: float) -> Self:
        """Design from what a first test has found.

        The stiffness is taken from one load to the other along its exponential growth, K = K0 + g (F - F0).

        Args:
            parameters: of a fit to the first test, as ``dpn`` reports them at its median, or ``lms``.
            first_load_n: mean load of the first test.
            load_n: the load that is asked about.
            options: further options of the kind, such as ``seconds``.

        Raises:
            UnusableInputError: an option does not hold.
        """
        found = {name: parameters[name].value for name in _FIRST_TEST if name in parameters}
        growth = max(0.0, found.get("stiffness_growth_per_m", _GROWTH_PER_M))
        found["stiffness_growth_per_m"] = growth
        if "stiffness_n_per_m" in found:
            first = found["stiffness_n_per_m"]
            found["stiffness_n_per_m"] = max(first + growth * (load_n - first_load_n), _SOFTEST * first)
        return cls.from_options(found | {"load_n": load_n} | options)

    @property
    def tissue(self) -> LocalTissue:
        """Return the mass, damping and stiffness expected under the load."""
        stiffness = self.stiffness_n_per_m
        if stiffness is None:  # what an exponential law has under this load
            stiffness = max(self.stiffness_growth_per_m, 1.0) * self.load_n
        return LocalTissue(
            self.mass_kg,
            self.damping_n_s_per_m,
            stiffness,
            self.stiffness_growth_per_m,
            self.damping_turn_n_s2_per_m2,
        )

    @property
    def precision(self) -> DesignPrecision:
        """What a fit will know of such a tissue."""
        return predicted_precision(self.tissue, self.cutoff_hz, self.force_noise_n_per_root_hz)

    @property
    def swing_n(self) -> float:
        """Force to either side of the load, N: the best, or what the range of force leaves of it."""
        room = min(self.load_n - self.force_min_n, self.force_max_n - self.load_n)
        return float(min(self.precision.best_rms_n / _MOST_OF_RANGE, room))

    @property
    def predicted_std(self) -> tuple[float, float, float]:
        """Relative standard deviations of mass, damping and stiffness after the whole length, as designed."""
        mass, damping, stiffness = self.precision.std(_MOST_OF_RANGE * self.swing_n, self.seconds)
        return float(mass), float(damping), float(stiffness)

    def build(self) -> Stimulus:
        """Build the force history, shape (seconds * sample_rate,), N."""
        played = self._noise().build()
        return Stimulus(
            values=played.values,
            sample_rate_hz=self.sample_rate,
            description=self.describe(),
            seed=self.seed,
            crest_factor=played.crest_factor,
        )

    def _noise(self) -> Noise:
        swing = self.swing_n
        return Noise(
            distribution="uniform",
            force_min_n=self.load_n - swing,
            force_max_n=self.load_n + swing,
            cutoff_hz=self.cutoff_hz,
            seconds=self.seconds,
            sample_rate=self.sample_rate,
            seed=self.seed,
        )
