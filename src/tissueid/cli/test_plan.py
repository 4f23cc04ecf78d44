"""Options of ``tissueid test`` and their checks before an instrument is opened."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from tissueid.acquisition.stimulus_choice import FIXTURES
from tissueid.cli.output import check_json
from tissueid.cli.stimulus_options import CommonOptions
from tissueid.configuration import Configuration
from tissueid.errors import UnusableInputError
from tissueid.instrument import PROFILES
from tissueid.stimuli import get_stimulus
from tissueid.stimuli.kinds.noise import Noise

MAX_TEXT = 200
"""Longest site or pseudonym in characters."""
LEAST_DEPTH_RANGE_M = 1e-4
"""Smallest width of a depth range, m."""


@dataclass(frozen=True, kw_only=True)
class TestPlan:
    """Options of the command; ``depth_range_m`` is the least and greatest depth below the surface."""

    __test__ = False  # not a test case for pytest

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
        """Check the options before an instrument is opened.

        Raises:
            UnusableInputError: options exclude each other, or a text is not valid.
        """
        if self.limits not in PROFILES:
            raise UnusableInputError(f"--limits must be {' or '.join(PROFILES)}, got {self.limits!r}")
        for what, text in (("site", self.site), ("subject", self.subject)):
            if not text.strip() or len(text) > MAX_TEXT or not text.isprintable():
                raise UnusableInputError(f"the {what} must be one line of 1 to {MAX_TEXT} printable characters")
        configuration = self.instrument_configuration()
        if self.depth_range_m is not None and not configuration.has_depth:
            raise UnusableInputError(f"--depth-range needs a depth: the configuration {configuration.name} has none")
        check_json(self.json_file)
        if self.json_file is not None and self.json_file.absolute() == self.out.absolute():
            raise UnusableInputError("the session and the JSON cannot be the same file")
        if self.rest_s > 0.0 and self.repeats == 1:
            raise UnusableInputError("--rest is the pause between repeats: it needs --repeats")
        own = bool(self.stimulus or self.options or self.distribution)
        if self.stimulus_file is not None and (own or self.common.given()):
            raise UnusableInputError(
                f"{self.stimulus_file} is a saved stimulus and contains its options: leave out other stimulus options"
            )
        self._check_kind()
        if self.multistep is None:
            if self.target is not None:
                raise UnusableInputError("--target needs --multistep")
            return
        if own or self.stimulus_file is not None or self.repeats > 1 or self.stop_when or self.live:
            raise UnusableInputError(
                "--multistep designs its own stimuli: the only stimulus options that it accepts are --depth-range, "
                "--min-force, --max-force, --seconds, --seed and --target"
            )
        if self.depth_range_m is None:
            raise UnusableInputError("--multistep needs --depth-range MM:MM below the surface, such as 1:4")

    def _check_kind(self) -> None:
        if self.kind is None:
            return
        if self.kind not in FIXTURES:
            raise UnusableInputError(
                f"--kind must be {' or '.join(FIXTURES)} (tests without tissue), got {self.kind!r}"
            )
        if self.multistep is not None:
            raise UnusableInputError("--multistep needs tissue: leave out --kind")

    def instrument_configuration(self) -> Configuration:
        """Return the configuration of instrument and probe.

        Raises:
            UnusableInputError: the configuration or probe is unknown, or they exclude each other.
        """
        return Configuration.of(self.configuration, self.probe, self.external_spring_n_per_m)

    def all_options(self) -> list[str]:
        """Return all options of the stimulus as NAME=VALUE.

        Raises:
            UnusableInputError: an option is given twice.
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
    """Return least and greatest depth, m, from a text in millimetres such as ``1:4``.

    Raises:
        UnusableInputError: the text is not two increasing numbers, or the range is too narrow.
    """
    least, colon, most = text.partition(":")
    try:
        depths = float(least) * 1e-3, float(most) * 1e-3
    except ValueError:
        depths = 0.0, 0.0
    if not colon or not depths[0] < depths[1]:
        raise UnusableInputError(
            f"--depth-range must be LEAST:GREATEST in mm below the surface, such as 1:4, got {text!r}"
        )
    if depths[1] - depths[0] < LEAST_DEPTH_RANGE_M:
        raise UnusableInputError(f"--depth-range must be at least {1e3 * LEAST_DEPTH_RANGE_M:g} mm wide, got {text}")
    return depths
