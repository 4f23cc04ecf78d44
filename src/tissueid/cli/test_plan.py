"""What ``tissueid test`` is asked for, and what of it is refused before an instrument is opened."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from tissueid.acquisition.choice import FIXTURES
from tissueid.cli.output import check_json
from tissueid.cli.stimulus_options import CommonOptions
from tissueid.configuration import Configuration
from tissueid.errors import UnusableInputError
from tissueid.instrument import PROFILES
from tissueid.stimuli import get_stimulus
from tissueid.stimuli.kinds.noise import Noise

MAX_TEXT = 200
LEAST_DEPTH_RANGE_M = 1e-4


@dataclass(frozen=True, kw_only=True)
class TestPlan:
    """What the command line asks for; ``depth_range_m`` is least and greatest depth from the surface."""

    __test__ = False  # not a test case, whatever pytest thinks of the name

    url: str
    site: str
    out: Path
    stimulus: str | None = None
    stimulus_file: Path | None = None
    distribution: str | None = None
    common: CommonOptions = field(default_factory=CommonOptions)
    options: tuple[str, ...] = ()
    depth_range_m: tuple[float, float] | None = None
    multistep: int | None = None
    target: float | None = None
    stop_when: tuple[str, ...] = ()
    live: bool = False
    repeats: int = 1
    rest_s: float = 0.0
    limits: str = "clinical"
    subject: str = "anonymous"
    configuration: str = "indentation"
    probe: str | None = None
    external_spring_n_per_m: float = 0.0
    calibrations: Path | None = None
    calibration: bool = True
    kind: str | None = None
    json_file: Path | None = None

    def check(self) -> None:
        """Refuse what can be seen to be wrong before an instrument is opened.

        Raises:
            UnusableInputError: says which options do not go together, or which text cannot be kept.
        """
        if self.limits not in PROFILES:
            raise UnusableInputError(f"limits are {' or '.join(PROFILES)}, not {self.limits!r}")
        for what, text in (("site", self.site), ("subject", self.subject)):
            if not text.strip() or len(text) > MAX_TEXT or not text.isprintable():
                raise UnusableInputError(f"the {what} must be one line of 1 to {MAX_TEXT} printable characters")
        configuration = self.instrument_configuration()
        if self.depth_range_m is not None and not configuration.has_depth:
            raise UnusableInputError(f"--depth-range asks for depths: there are none in {configuration.name}")
        check_json(self.json_file)
        if self.json_file is not None and self.json_file.absolute() == self.out.absolute():
            raise UnusableInputError("the session and the JSON cannot be the same file")
        if self.rest_s > 0.0 and self.repeats == 1:
            raise UnusableInputError("--rest is between repeats: it goes with --repeats")
        own = bool(self.stimulus or self.options or self.distribution)
        if self.stimulus_file is not None and (own or self.common.given()):
            raise UnusableInputError(f"{self.stimulus_file} is a saved stimulus: its options are in it")
        self._check_kind()
        if self.multistep is None:
            if self.target is not None:
                raise UnusableInputError("--target goes with --multistep")
            return
        if own or self.stimulus_file is not None or self.repeats > 1 or self.stop_when or self.live:
            raise UnusableInputError(
                "--multistep designs its stimuli itself: of the options for what is played it takes --depth-range, "
                "--min-force, --max-force, --seconds, --seed and --target"
            )
        if self.depth_range_m is None:
            raise UnusableInputError("--multistep needs a --depth-range MM:MM from the surface, such as 1:4")

    def _check_kind(self) -> None:
        if self.kind is None:
            return
        if self.kind not in FIXTURES:
            raise UnusableInputError(f"--kind is {' or '.join(FIXTURES)}, where no tissue is met; not {self.kind!r}")
        if self.multistep is not None:
            raise UnusableInputError("--multistep needs tissue: it does not go with --kind")

    def instrument_configuration(self) -> Configuration:
        """How the instrument meets the tissue.

        Raises:
            UnusableInputError: no such configuration or probe, or what does not go together.
        """
        return Configuration.of(self.configuration, self.probe, self.external_spring_n_per_m)

    def all_options(self) -> list[str]:
        """Options of the stimulus as NAME=VALUE, those that have a name of their own on the command line included.

        Raises:
            UnusableInputError: one is given twice.
        """
        options = list(self.options)
        if self.distribution is not None:
            options.append(f"distribution={self.distribution}")
        if self.depth_range_m is not None and "depth_min_m" in get_stimulus(self.stimulus or Noise.name).model_fields:
            options += [f"depth_min_m={self.depth_range_m[0]!r}", f"depth_max_m={self.depth_range_m[1]!r}"]
        names = [option.partition("=")[0] for option in options]
        for name in names:
            if names.count(name) > 1:
                raise UnusableInputError(f"the option {name} of the stimulus is given twice")
        return options


def millimetres(text: str) -> tuple[float, float]:
    """Least and greatest depth, m, from millimetres as ``1:4``.

    Raises:
        UnusableInputError: not two numbers, or not rising.
    """
    least, colon, most = text.partition(":")
    try:
        depths = float(least) * 1e-3, float(most) * 1e-3
    except ValueError:
        depths = 0.0, 0.0
    if not colon or not depths[0] < depths[1]:
        raise UnusableInputError(f"a depth range is least:greatest in mm from the surface, such as 1:4, not {text!r}")
    if depths[1] - depths[0] < LEAST_DEPTH_RANGE_M:
        raise UnusableInputError(
            f"a depth range of {text} mm is too narrow: it is in mm, at least {1e3 * LEAST_DEPTH_RANGE_M:g} wide"
        )
    return depths
