"""The plan of a test: its options, the rule for its subject, the tests that are offered by name, and their checks."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import Field

from tissueid.errors import UnusableInputError
from tissueid.formatting import ANONYMOUS, clean
from tissueid.language import _, marked
from tissueid.messages import Action, Message, Verbatim
from tissueid.plan_options import Option, name_and_value, named_values
from tissueid.procedures.control import Control
from tissueid.stimuli.kinds.noise import Noise
from tissueid.test_settings import USUAL_FORCE_N, USUAL_SECONDS, FilePlayback, Setting, StimulusSettings, TestSettings

if TYPE_CHECKING:  # each takes long to import
    from tissueid.identification.live.stopping import StopRule
    from tissueid.instrument.limits import Limits
    from tissueid.stimuli import OpenLoopKind, Stimulus, StimulusKind
    from tissueid.stimuli.depth_uniform import DepthDesign
    from tissueid.stimuli.interchange import InterchangeProgress, InterchangeResult


LARGE_N = (-5.0, 11.8)
"""Force range of the large test, N. Below zero the coil pulls and the probe lifts off at times (thesis Fig. 3.8)."""
LARGE_CLIPPED = 0.0455
"""Share of samples clipped to that range: the share of a Gaussian beyond two standard deviations."""


class Preset(StimulusSettings):
    """A test that is chosen in one step, as fields of a ``TestPlan``.

    With ``lower_force`` the highest force is lowered to that of the instrument. Else the test is offered only where the
    limits and the instrument allow its forces.
    """

    name: str
    title: str
    stimulus: str
    min_force_n: float
    max_force_n: float
    seconds: float = USUAL_SECONDS
    options: tuple[tuple[str, Any], ...] = ()
    lower_force: bool = True

    def plan_values(self, seconds: float | None = None) -> dict[str, Any]:
        """Return the fields of a ``TestPlan`` for this test, with another length, s, if one is given."""
        values = self.model_dump(exclude={"name", "title"}, exclude_none=True)
        return values if seconds is None else values | {"seconds": seconds}

    def why_not(self, most_n: float) -> Message | None:
        """Return why the test is not offered where limits and instrument allow ``most_n``, N; None where it is."""
        needed_n = 0.0 if self.lower_force else max(abs(self.min_force_n), abs(self.max_force_n))
        if needed_n <= most_n:
            return None
        return Message(
            "form.preset_force",
            "{title} is not offered: it needs {needed:g} N, and limits and instrument allow {most:g} N.",
            title=_(self.title),
            needed=needed_n,
            most=most_n,
        )


PRESETS = (
    Preset(
        name="standard",
        title=marked("Standard skin test"),
        stimulus=Noise.name,
        min_force_n=USUAL_FORCE_N[0],
        max_force_n=USUAL_FORCE_N[1],
    ),
    Preset(
        name="thesis",
        title=marked("Thesis test, −5 to 12 N"),
        stimulus=Noise.name,
        min_force_n=LARGE_N[0],
        max_force_n=LARGE_N[1],
        options=(("clipped", LARGE_CLIPPED),),
        lower_force=False,
    ),
    Preset(
        name="depths", title=marked("Equal depths"), stimulus="rtig", min_force_n=-0.6, max_force_n=10.0, seconds=5.0
    ),
)
"""Tests that are offered by name; the thesis test is that of the demonstration (thesis 3.1.3 and Fig. 3.8)."""


PseudonymConfirmed = Annotated[
    bool, Option("--confirm-pseudonym", help="the subject is a pseudonym although it looks like a name")
]
"""Field of a plan with a subject."""
_CONFIRM = Action("subject.confirm", "--confirm-pseudonym", marked("“This is a pseudonym, not a name”"))
_WORD = re.compile(r"[^\W\d_]+(?:['’-][^\W\d_]+)*\.?")
_JOINT = re.compile(r",|_|(?<=[^\W\d_])\.(?=[^\W\d_]{2})")
"""What stands between two words: comma, low line, or a dot within a word; that of an initial stays."""
_PARTICLES = frozenset(
    {"de", "den", "der", "del", "di", "da", "du", "la", "le", "van", "von", "zu", "zur", "bin", "al"}
)
_TITLES = frozenset({"mr", "mrs", "ms", "dr", "prof", "herr", "frau"})
_SHORTEST_SHOUTED = 3
"""Letters of a word in capitals that may be a name; shorter ones are abbreviations."""
_MOST_WORDS = 6
_LONGEST = 80


def reads_like_name(text: str) -> bool:
    """Whether a pseudonym looks like a real name: two capitalised words and nothing else, as in "John Smith".

    Initials, titles, particles and the order "Smith, John" are known, also with dots or low lines between the words;
    anything with a digit in it is a code.
    """
    parts = _JOINT.sub(" ", text).split()
    if not 2 <= len(parts) <= _MOST_WORDS or not all(_WORD.fullmatch(part) for part in parts):
        return False
    significant = [part for part in parts if part.lower() not in _PARTICLES]
    named = [word for word in significant if word.lower().rstrip(".") not in _TITLES]
    titled = len(named) < len(significant)
    full = [word for word in named if _capitalised(word)]
    initials = [word for word in named if len(word.rstrip(".")) == 1 and word[0].isupper()]
    return len(full) + len(initials) == len(named) and (len(named) >= 2 or titled) and bool(full)


def _capitalised(word: str) -> bool:
    letters = word.rstrip(".")
    if letters.isupper():
        return len(letters) >= _SHORTEST_SHOUTED
    return len(letters) > 1 and letters[0].isupper()


def check_subject(text: str, *, confirmed: bool) -> None:
    """Refuse a subject that looks like a person's name, unless a person confirmed that it is a pseudonym.

    Raises:
        UnusableInputError: it looks like a name.
    """
    if not confirmed and reads_like_name(text):
        raise UnusableInputError(
            "subject.name",
            "the subject '{text}' looks like a person's name: use a pseudonym such as P-001, or confirm that it is one "
            "with {option}",
            text=Verbatim(clean(text)[:_LONGEST]),
            option=_CONFIRM,
        )


NO_INSTRUMENT = Message("plan.no_instrument", "choose an instrument, or type its address")
MAX_TEXT = 200
"""Longest site or pseudonym in characters."""
LEAST_DEPTH_RANGE_M = 1e-4
"""Smallest width of a depth range, m."""
LiveMethod = Literal["sliding", "rls", "als"]
"""Methods of the impulse response while a test runs, the default first; those of ``identification.live``."""
LIVE_METHODS: dict[LiveMethod, str] = {
    "sliding": marked("Sliding (LMS)"),
    "rls": marked("Recursive (RLS)"),
    "als": marked("Adaptive (ALS)"),
}
"""Short titles of the methods, for forms."""
_ANY_RATE_HZ = 2000.0
"""Sample rate at which options are checked before an instrument is open, Hz."""
SPECIFIED = {
    "force_min_n": "min_force_n",
    "force_max_n": "max_force_n",
    "seconds": "seconds",
    "seed": "seed",
}
"""Option of a stimulus: field of the plan."""


def depth_range(text: str) -> tuple[float, float]:
    """Return least and greatest depth, m, from a text in millimetres such as ``1:4``.

    Raises:
        UnusableInputError: the text is not two increasing numbers.
    """
    least, colon, most = text.partition(":")
    try:
        depths = float(least) * 1e-3, float(most) * 1e-3
    except ValueError:
        depths = 0.0, 0.0
    if not colon or not depths[0] < depths[1]:
        raise UnusableInputError(
            "plan.depth_range",
            "a range of depth must be LEAST:GREATEST in mm below the surface, such as 1:4, got '{text}'",
            text=Verbatim(text),
        )
    return depths


class TestPlan(FilePlayback, TestSettings):
    """One or several tests at one place, in one session; ``None`` leaves a value to the stimulus.

    ``options`` are options of the stimulus without a field here, by name. ``stop_when`` are targets in the notation of
    ``StopRule``. ``kind`` is one of ``FIXTURES``, or None for tissue or a sample. ``limits`` is the name of a profile.
    With ``multistep`` each test is designed from the previous ones to cover ``depth_range_m`` evenly. ``lower_force``
    reduces the highest force to that of the instrument where it is less; without it such a plan is refused.
    """

    __test__ = False  # not a test case for pytest

    url: Annotated[
        str,
        Option(
            "--device", metavar="URL", help="a port, socket://HOST:PORT or simulated://forearm; see 'tissueid devices'"
        ),
    ]
    out: Annotated[Path, Option("--out", metavar="SESSION", help="new session file; never overwritten")]
    options: Annotated[
        tuple[tuple[str, Any], ...],
        Option(
            "--option",
            metavar="NAME=VALUE",
            help="another option of the stimulus; may be repeated",
            read=name_and_value,
        ),
    ] = ()
    stimulus_file: Annotated[
        Path | None,
        Option(
            "--stimulus-file",
            metavar="FILE",
            help="stimulus saved by 'tissueid stimulus', or a waveform: .csv, .txt or .npy, in N",
        ),
    ] = None
    depth_range_m: Annotated[
        tuple[float, float] | None,
        Option(
            "--depth-range",
            metavar="MM:MM",
            help="intended depths below the surface, such as 1:4",
            read=depth_range,
        ),
    ] = None
    multistep: Annotated[
        int | None,
        Option(
            "--multistep",
            metavar="N",
            help="up to N tests, each designed from the previous ones for a uniform depth",
        ),
        Field(ge=1, le=20),
    ] = None
    target: Annotated[
        float | None,
        Option("--target", help="with --multistep: distance from uniform at which to stop; default: 0.05"),
        Field(ge=0.0, le=1.0),
    ] = None
    stop_when: Annotated[
        tuple[str, ...],
        Option("--stop-when", metavar="NAME=SHARE", help="stop at this relative uncertainty, such as stiffness=0.02"),
    ] = ()
    live: Annotated[bool, Option("--live", help="print the parameters as they converge")] = False
    live_method: Annotated[
        LiveMethod | None,
        Option(
            "--live-method",
            help="impulse response of --live: sliding (default, least squares of the last 10 s), rls or als",
        ),
    ] = None
    repeats: Annotated[
        int,
        Setting("--repeats", help="number of runs of the test", offered=(1, 20)),
        Field(
            title=marked("Repeats"), description=marked("Tests one after another, in one session file"), ge=1, le=100
        ),
    ] = 1
    place_again: Annotated[
        bool, Option("--place-again", help="find the surface before each repeat, not only before the first")
    ] = False
    rest_s: Annotated[
        float,
        Setting("--rest", metavar="SECONDS", help="pause between repeats, to cool the coil", step=10.0),
        Field(
            title=marked("Rest between repeats"),
            description=marked("Pause between the tests, to cool the coil"),
            ge=0.0,
            le=600.0,
        ),
    ] = 0.0
    limits: Annotated[str, Option("--limits", help="clinical (12 N) or research (15 N)")] = "clinical"
    subject: Annotated[str, Option("--subject", metavar="PSEUDONYM", help="pseudonym, never a name")] = ANONYMOUS
    pseudonym_confirmed: PseudonymConfirmed = False
    calibrations: Annotated[
        Path | None, Option("--calibrations", metavar="DIR", help="folder of calibrations; see 'calibrate list'")
    ] = None
    calibration: Annotated[bool, Option(help="use the newest calibration")] = True
    lower_force: bool = False

    def check(self) -> None:
        """Check the plan before an instrument is opened.

        Raises:
            UnusableInputError: a value is missing, not valid, or does not fit the others.
        """
        limits_of(self.limits)
        if not self.url:
            raise UnusableInputError(NO_INSTRUMENT)
        if not self.site.strip():
            raise UnusableInputError("plan.no_site", "fill in the site: where on the body, or which material")
        for what, text in ((marked("the site"), self.site), (marked("the subject"), self.subject)):
            if not text.strip() or len(text) > MAX_TEXT or not text.isprintable():
                raise UnusableInputError(
                    "plan.text", "{what} must be one line of 1 to {most} printable characters", what=what, most=MAX_TEXT
                )
        check_subject(self.subject, confirmed=self.pseudonym_confirmed)
        if len(self.condition) > MAX_TEXT or not self.condition.isprintable():
            raise UnusableInputError(
                "plan.condition", "the condition must be one line of at most {most} characters", most=MAX_TEXT
            )
        if self.minutes_since_application is not None and not self.condition:
            raise UnusableInputError("plan.minutes", "--minutes-since needs --condition")
        low, high = self.min_force_n, self.max_force_n
        if low is not None and high is not None and low >= high:
            raise UnusableInputError(
                "plan.force_range",
                "the lowest force ({low:g} N) must be below the highest ({high:g} N)",
                low=low,
                high=high,
            )
        self._check_depths()
        if self.live_method is not None and not self.live:
            raise UnusableInputError("plan.live_method", "--live-method needs --live")
        if self.rest_s > 0.0 and self.repeats == 1:
            raise UnusableInputError("plan.rest", "the rest is the pause between repeats: it needs --repeats")
        self._check_kind()
        for option in () if self.stimulus_file else self.file_options:
            raise UnusableInputError(
                "plan.file_options",
                "{option} needs --stimulus-file: other stimuli have a range of force",
                option=Verbatim(option),
            )
        self.stop_rule()
        if self.multistep is not None:
            self._check_multistep()
            self.depth_design(_ANY_RATE_HZ)
            return
        if self.target is not None:
            raise UnusableInputError("plan.target", "--target needs --multistep")
        if self.stimulus_file is None:
            self.specification(_ANY_RATE_HZ)
        elif self._own_stimulus or any(getattr(self, name) is not None for name in SPECIFIED.values()):
            raise saved_stimulus_options(self.stimulus_file)

    def _check_depths(self) -> None:
        if self.depth_range_m is None:
            return
        if not self.has_depth:
            raise UnusableInputError(
                "plan.no_depth",
                "a range of depth needs a depth: the configuration {name} has none",
                name=Verbatim(self.configuration),
            )
        least_m, most_m = self.depth_range_m
        if not most_m - least_m >= LEAST_DEPTH_RANGE_M:
            raise UnusableInputError(
                "plan.narrow_depth",
                "a range of depth must be at least {width:g} mm wide, got {least:g} to {most:g} mm",
                width=1e3 * LEAST_DEPTH_RANGE_M,
                least=1e3 * least_m,
                most=1e3 * most_m,
            )

    def _check_kind(self) -> None:
        from tissueid.acquisition.stimulus_choice import FIXTURES

        if self.kind is not None and self.kind not in FIXTURES:
            raise UnusableInputError(
                "plan.kind",
                "the kind must be one of {known} (tests without tissue), got '{name}'",
                known=Verbatim(", ".join(FIXTURES)),
                name=Verbatim(self.kind),
            )
        if self.kind is not None and self.multistep is not None:
            raise UnusableInputError("plan.multistep_tissue", "--multistep needs tissue: leave out --kind")

    def _check_multistep(self) -> None:
        if self.stop_when:
            raise UnusableInputError(
                "plan.no_stop_rule", "a test in steps designs its stimuli itself: it takes no stop rule"
            )
        if self._own_stimulus or self.stimulus_file is not None or self.repeats > 1 or self.live:
            raise UnusableInputError(
                "plan.multistep_options",
                "--multistep designs its own stimuli: the only stimulus options that it accepts are --depth-range, "
                "--min-force, --max-force, --seconds, --seed and --target",
            )
        if self.depth_range_m is None:
            raise UnusableInputError(
                "plan.multistep_depth", "--multistep needs --depth-range MM:MM below the surface, such as 1:4"
            )

    @property
    def _own_stimulus(self) -> bool:
        return bool(self.stimulus or self.options or self.distribution)

    def stop_rule(self) -> StopRule | None:
        """Return the rule that ends the test early; None for a plan without one.

        Raises:
            UnusableInputError: a target is not valid.
        """
        if not self.stop_when:
            return None
        from tissueid.identification.live.stopping import StopRule

        return StopRule.from_words(self.stop_when)

    def specification(self, sample_rate_hz: float) -> StimulusKind:
        """Return the specification of the stimulus.

        Raises:
            UnusableInputError: the stimulus or an option is unknown, not valid, or given twice.
        """
        from tissueid.acquisition.stimulus_choice import usual_options
        from tissueid.stimuli import get_stimulus

        noise = self.stimulus in (None, Noise.name)
        kind = Noise if noise else get_stimulus(str(self.stimulus))  # without a look at the other kinds for noise
        pairs = list(self.options)
        if self.distribution is not None:
            pairs.append(("distribution", self.distribution))
        if self.depth_range_m is not None and "depth_min_m" in kind.model_fields:
            pairs += zip(("depth_min_m", "depth_max_m"), self.depth_range_m, strict=True)
        usual: dict[str, Any] = {"sample_rate": sample_rate_hz}
        if noise:
            usual = usual_options(sample_rate_hz)
        return specified(kind, pairs, self._given(), usual)

    def depth_design(self, sample_rate_hz: float) -> DepthDesign:
        """Return the design of a test in steps.

        Raises:
            UnusableInputError: an option is not valid.
        """
        from tissueid.stimuli.depth_uniform import DepthDesign

        assert self.depth_range_m is not None
        options: dict[str, Any] = dict(zip(("force_min_n", "force_max_n"), USUAL_FORCE_N, strict=True))
        options |= {name: value for name, (_, value) in self._given().items() if name != "seed"}
        least_m, most_m = self.depth_range_m
        return DepthDesign.from_options(
            options | {"depth_min_m": least_m, "depth_max_m": most_m, "sample_rate": sample_rate_hz}
        )

    def _given(self) -> dict[str, tuple[str, float]]:
        """Return name on the command line and value of the stimulus options that are given, by option of the kind."""
        return named_values(self, SPECIFIED)

    def within(self, greatest_n: float) -> Self:
        """Return this plan for an instrument with a maximum force of ``greatest_n``, N: the usual force is lowered."""

        wanted, lower = self.max_force_n, self.lower_force
        usual = self.stimulus_file is None and self.stimulus in (None, Noise.name)
        if wanted is None and usual and "force_max_n" not in dict(self.options):
            wanted, lower = USUAL_FORCE_N[1], True
        if wanted is None or not lower or wanted <= greatest_n:
            return self
        return self.model_copy(update={"max_force_n": greatest_n})

    @property
    def shown_method(self) -> LiveMethod:
        """Method of the impulse response while the test runs."""
        return self.live_method or "sliding"

    @property
    def force_range_n(self) -> tuple[float, float]:
        """Expected range of force, N. A saved stimulus has its own."""
        given = self.min_force_n, self.max_force_n
        low_n, high_n = (usual if n is None else n for n, usual in zip(given, USUAL_FORCE_N, strict=True))
        return low_n, high_n

    @property
    def stimulus_s(self) -> float:
        """Expected duration of one stimulus after its preload, s. A saved stimulus has its own."""
        return USUAL_SECONDS if self.seconds is None else self.seconds

    @property
    def total_s(self) -> float:
        """Expected duration of one stimulus, or of all of a test in steps, with the preloads, s."""
        from tissueid.acquisition.stimulus_choice import PRELOAD_S

        return (PRELOAD_S + self.stimulus_s) * (self.multistep or 1)


def limits_of(name: str) -> Limits:
    """Return the profile of limits with this name.

    Raises:
        UnusableInputError: there is none.
    """
    from tissueid.instrument.limits import PROFILES

    if name not in PROFILES:
        raise UnusableInputError(
            "plan.limits",
            "the limits must be one of {known}, got '{name}'",
            known=Verbatim(", ".join(PROFILES)),
            name=Verbatim(name),
        )
    return PROFILES[name]


def saved_stimulus_options(path: Path) -> UnusableInputError:
    """Return the error for options that are given together with a saved stimulus."""
    return UnusableInputError(
        "plan.saved_stimulus",
        "{path} is a saved stimulus and contains its options: leave out other stimulus options",
        path=Verbatim(path),
    )


def specified(
    kind: type[StimulusKind],
    options: list[tuple[str, Any]],
    given: Mapping[str, tuple[str, float]],
    usual: Mapping[str, Any] | None = None,
) -> StimulusKind:
    """Return the specification of a kind of stimulus.

    Args:
        kind: the kind.
        options: name and value of options.
        given: options that have a name of their own on the command line: that name, and the value.
        usual: values of options that are not given, as far as the kind has them.

    Raises:
        UnusableInputError: an option is unknown, not valid, or given twice.
    """
    if not kind.listed:
        raise UnusableInputError(
            "plan.from_file", "the stimulus '{name}' comes from a file: give that file", name=Verbatim(kind.name)
        )
    chosen = dict(options)
    if len(chosen) < len(options):
        names = [name for name, _ in options]
        raise UnusableInputError(
            "plan.option_twice",
            "the option {name} of the stimulus is given twice",
            name=Verbatim(next(name for name in names if names.count(name) > 1)),
        )
    for field, (name, value) in given.items():
        if field not in kind.model_fields:
            raise UnusableInputError(
                "plan.no_option",
                "the stimulus {kind} has no option {name}; 'tissueid stimulus {kind} --options' lists its options",
                kind=Verbatim(kind.name),
                name=Verbatim(name),
            )
        if field in chosen:
            raise UnusableInputError(
                "plan.option_both",
                "{field} is given twice, by {name} and by --option",
                field=Verbatim(field),
                name=Verbatim(name),
            )
        chosen[field] = value
    for field, default in (usual or {}).items():
        if field in kind.model_fields:
            chosen.setdefault(field, default)
    return kind.from_options(chosen)


def design_stimulus(specification: OpenLoopKind, control: Control) -> tuple[Stimulus, InterchangeResult | None]:
    """Build a stimulus; also return the interchange search if there was one.

    Raises:
        UnusableInputError: the stimulus cannot be built.
        CancelledError: it was cancelled.
    """
    from tissueid.stimuli.kinds.interchange import Interchange

    specification.check_size()
    step = Message("stimulus.designing", "designing {name}", name=Verbatim(specification.name))
    control.progress(0.0, step)
    search: InterchangeResult | None = None
    if isinstance(specification, Interchange):
        first: list[InterchangeProgress] = []

        def follow(state: InterchangeProgress) -> None:
            control.check()
            first[:] = first or [state]
            control.progress(_share(first[0], state), step)

        search = specification.design(follow)
        built = specification.stimulus_from(search)
    else:
        built = specification.build()
    control.progress(1.0, step)
    return built, search


def _share(first: InterchangeProgress, step: InterchangeProgress) -> float:
    """Return the completed share of a search: of the decades of error, or of the allowed swaps."""
    tried = step.tried / step.max_trials
    if not first.error > step.tolerance:
        return tried
    fallen = math.log(first.error / step.error) / math.log(first.error / step.tolerance)
    return min(max(fallen, tried), 1.0)
