"""The protocol of a study: sites, repeats, conditions and order, and the next step of a subject's sitting.

``protocol.json`` in the folder of a study holds it. The order of steps is: conditions in the order of the protocol,
below each the sites, and at each site the repeats. A randomised order shuffles the sites and orientations under one
product and time; products stay in order, because they cannot be taken off the skin.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    StringConstraints,
    ValidationError,
    model_validator,
)

from tissueid.errors import UnusableInputError
from tissueid.formatting import clean
from tissueid.language import marked
from tissueid.messages import Action, Message, Verbatim, joined
from tissueid.plan_options import option_error
from tissueid.procedures.study_plans import RESULTS
from tissueid.procedures.test_plan import MAX_TEXT, PRESETS, Preset, TestPlan, reads_like_name
from tissueid.test_settings import SECONDS, Circumstances, SetUp, circumstance_text
from tissueid.untrusted_input import json_value

PROTOCOL_FILE = "protocol.json"
"""Name of the protocol in the folder of a study."""
_LARGEST_PROTOCOL = 1_000_000
_MOST_STEPS = 10_000
"""Most steps of one sitting."""
PHOTOGRAPHS = "photographs"
"""Folder of a study with its photographs."""
_OTHER_FOLDERS = (RESULTS, PHOTOGRAPHS)
_PSEUDONYM = re.compile(r"[A-Za-z0-9][A-Za-z0-9._ -]{0,39}")

Demographic = Literal["age_years", "weight_kg", "height_m", "gender", "handedness", "ethnicity", "skin_conditions"]
"""Values of a subject that a protocol can ask for."""
_Line = Annotated[str, StringConstraints(strip_whitespace=True, max_length=MAX_TEXT)]


class Site(BaseModel):
    """A site and the number of tests there; None for that of the protocol."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    site: _Line
    repeats: Annotated[int, Field(ge=1, le=100)] | None = None


class Condition(Circumstances):
    """What is tested: product ("" without one), and its circumstances."""

    product: _Line = ""

    @property
    def text(self) -> str:
        """The condition in one line; "" for none."""
        parts: list[str] = [Verbatim(self.product)] if self.product else []
        given = {name: value for name in Circumstances.model_fields if (value := getattr(self, name)) is not None}
        return joined([*parts, *(circumstance_text(name, value) for name, value in given.items())])


def _site(given: Any) -> Any:
    return {"site": given} if isinstance(given, str) else given


class Protocol(SetUp):
    """The protocol of a study.

    ``repeats`` are the tests at each site under each condition. ``attempts`` limits the tests of one repeat: the
    sitting continues after this number of tests whose quality is "repeat". ``stimulus`` is the name of a preset,
    ``seconds`` another length of its stimulus. With ``photograph`` the window offers to add a photograph of each site.
    """

    name: _Line
    sites: tuple[Annotated[Site, BeforeValidator(_site)], ...]
    repeats: Annotated[int, Field(ge=1, le=100)] = 5
    conditions: tuple[Condition, ...] = (Condition(),)
    demographics: tuple[Demographic, ...] = ("age_years", "weight_kg", "height_m", "gender", "handedness")
    order: Literal["fixed", "randomised"] = "fixed"
    seed: Annotated[int, Field(ge=0, lt=2**31)] = 0
    stimulus: str = PRESETS[0].name
    seconds: Annotated[float, Field(ge=SECONDS[0], le=SECONDS[1])] | None = None
    limits: str = "clinical"
    attempts: Annotated[int, Field(ge=1, le=20)] = 3
    photograph: bool = False

    @model_validator(mode="after")
    def _usable(self) -> Self:
        if not self.sites:
            raise ValueError(Message("protocol.no_site", "'sites': give at least one site"))
        names = [site.site for site in self.sites]
        for text in (self.name, *names, *(condition.product for condition in self.conditions)):
            if not text.isprintable():
                raise ValueError(
                    Message(
                        "protocol.text", "'name', 'sites' and products must each be one line of printable characters"
                    )
                )
        if not self.name.strip() or not all(name.strip() for name in names):
            raise ValueError(Message("protocol.empty", "'name' and the name of each of the 'sites' must not be empty"))
        for what, values in ((marked("sites"), names), (marked("conditions"), self.conditions)):
            if len(set(values)) < len(values):
                raise ValueError(Message("protocol.twice", "two of the {what} are the same", what=what))
        if not self.conditions:
            raise ValueError(
                Message("protocol.no_condition", "'conditions': give at least one condition; it may be empty")
            )
        if any(item.minutes_since_application is not None and not item.product for item in self.conditions):
            raise ValueError(Message("protocol.minutes", "'conditions': 'minutes_since_application' needs a 'product'"))
        if self.stimulus not in {preset.name for preset in PRESETS}:
            raise ValueError(
                Message(
                    "protocol.stimulus",
                    "'stimulus' must be one of {known}, got '{name}'",
                    known=joined(Verbatim(preset.name) for preset in PRESETS),
                    name=Verbatim(clean(self.stimulus)[:MAX_TEXT]),
                )
            )
        if sum(self.repeats_at(site) for site in self.sites) * len(self.conditions) > _MOST_STEPS:
            raise ValueError(
                Message(
                    "protocol.long",
                    "'sites', 'repeats' and 'conditions': a sitting may have at most {most} tests",
                    most=_MOST_STEPS,
                )
            )
        return self

    def repeats_at(self, site: Site) -> int:
        """Return the number of tests at a site under each condition."""
        return self.repeats if site.repeats is None else site.repeats

    @property
    def preset(self) -> Preset:
        """The test that is run."""
        return next(preset for preset in PRESETS if preset.name == self.stimulus)

    def settings(self, step: SittingStep) -> dict[str, Any]:
        """Return the fields of ``TestSettings`` of the test of a step."""
        values = {name: getattr(self, name) for name in SetUp.model_fields}
        values |= {name: getattr(step.condition, name) for name in Circumstances.model_fields}
        return values | {"site": step.site, "condition": step.condition.product}

    def plan(self, step: SittingStep, url: str, out: Path, **values: Any) -> TestPlan:
        """Return the plan of the test of a step; ``values`` replace fields of it."""
        given: dict[str, Any] = {
            "url": url,
            "out": out,
            "subject": step.subject,
            "limits": self.limits,
        }
        return TestPlan(**(given | self.settings(step) | self.preset.plan_values(self.seconds) | values))


@dataclass(frozen=True)
class SittingStep:
    """One test of a sitting: ``position`` of ``total`` steps and ``repeat`` of ``repeats`` at the site, all from 1.

    ``attempt`` is 2 where the test before was of no use.
    """

    subject: str
    site: str
    condition: Condition
    repeat: int
    repeats: int
    position: int
    total: int
    attempt: int = 1


@dataclass(frozen=True)
class RecordedTest:
    """A test of the subject that was recorded; ``counts`` is whether it is completed and need not be repeated."""

    site: str
    condition: Condition
    counts: bool


def sitting_steps(protocol: Protocol, subject: str) -> list[SittingStep]:
    """Return all steps of a subject's sitting in order; a randomised order depends on seed and subject only."""
    places: list[tuple[Condition, Site]] = []
    for _application, group in itertools.groupby(protocol.conditions, _application_of):
        block = [(condition, site) for condition in group for site in protocol.sites]
        if protocol.order == "randomised":
            block.sort(key=lambda pair: _rank(protocol.seed, subject, *pair))
        places += block
    total = sum(protocol.repeats_at(site) for _condition, site in places)
    steps: list[SittingStep] = []
    for condition, site in places:
        repeats = protocol.repeats_at(site)
        for repeat in range(1, repeats + 1):
            steps.append(SittingStep(subject, site.site, condition, repeat, repeats, len(steps) + 1, total))
    return steps


def next_step(protocol: Protocol, subject: str, recorded: Sequence[RecordedTest]) -> SittingStep | None:
    """Return the next step of a subject's sitting, or None when it is complete.

    A step is done when a test that counts was recorded for it, or ``attempts`` tests that do not count. The minutes
    since an application need not be those of the protocol: of its conditions with the product, the nearest one counts.

    Args:
        protocol: the protocol.
        subject: pseudonym.
        recorded: the subject's tests in the order of recording.
    """
    unassigned: dict[tuple[str, Condition], list[bool]] = {}
    for test in recorded:
        if (condition := _planned(protocol, test.condition)) is not None:
            unassigned.setdefault((test.site, condition), []).append(test.counts)
    for step in sitting_steps(protocol, subject):
        tests = unassigned.get((step.site, step.condition), [])
        attempts = 0
        while tests and attempts < protocol.attempts:
            attempts += 1
            if tests.pop(0):
                attempts = protocol.attempts
        if attempts < protocol.attempts:
            return SittingStep(**(vars(step) | {"attempt": attempts + 1}))
    return None


def finished_sites(protocol: Protocol, subject: str, step: SittingStep | None) -> set[str]:
    """Return the sites that are done under the product and time of the next step; all where the sitting is complete."""
    steps = sitting_steps(protocol, subject)
    if step is None:
        return {other.site for other in steps}
    now = [other for other in steps if _application_of(other.condition) == _application_of(step.condition)]
    return {other.site for other in now} - {other.site for other in now if other.position >= step.position}


def _application_of(condition: Condition) -> tuple[str, float | None]:
    return condition.product, condition.minutes_since_application


def _rank(seed: int, subject: str, condition: Condition, site: Site) -> str:
    # A hash and not a random generator: the order is the same with every version of every library.
    minutes, angle_deg = condition.minutes_since_application, condition.orientation_deg
    text = json.dumps([seed, subject, condition.product, minutes, angle_deg, site.site])
    return hashlib.sha256(text.encode()).hexdigest()


def _planned(protocol: Protocol, given: Condition) -> Condition | None:
    """Return the condition of the protocol to which a test belongs; None where it belongs to none."""
    minutes = given.minutes_since_application
    at_minutes = {"minutes_since_application": minutes}
    same = [condition for condition in protocol.conditions if condition.model_copy(update=at_minutes) == given]
    if minutes is None:
        return same[0] if same else None
    return min(same, key=lambda condition: abs((condition.minutes_since_application or 0.0) - minutes), default=None)


def check_pseudonym(text: str) -> str:
    """Return a pseudonym without spaces around it.

    Raises:
        UnusableInputError: it looks like a name or an address, or cannot be the name of a folder.
    """
    pseudonym = text.strip()
    folder = _PSEUDONYM.fullmatch(pseudonym) and not pseudonym.endswith(".") and pseudonym.lower() not in _OTHER_FOLDERS
    if not folder or reads_like_name(pseudonym):
        raise UnusableInputError(
            "protocol.pseudonym",
            "the subject must be a pseudonym such as P-001, never a name: up to 40 letters, digits, spaces, '-', "
            "'_' and '.', got '{text}'",
            text=Verbatim(clean(text)[:MAX_TEXT]),
        )
    return pseudonym


def read_protocol(folder: Path) -> Protocol:
    """Read and check the protocol of a study.

    Raises:
        UnusableInputError: it is missing or not valid; the message names the file and what is wrong.
    """
    path = folder / PROTOCOL_FILE
    if not path.is_file():
        raise UnusableInputError(
            "protocol.none",
            "{folder} has no {file}: {template} writes one to begin with",
            folder=str(folder),
            file=PROTOCOL_FILE,
            template=Action(
                "study.protocol",
                f"tissueid study protocol {folder}",
                marked("New protocol on the page Studies"),
            ),
        )
    from tissueid.acquisition.waveform_file import read_at_most  # it imports scipy

    too_large = Message("protocol.large", "{path} is too large for a protocol", path=str(path))
    try:
        content = json_value(read_at_most(path, _LARGEST_PROTOCOL, too_large))
    except ValueError as error:
        raise UnusableInputError(
            "protocol.not_json",
            "{path} is not JSON: {reason}",
            path=str(path),
            reason=Verbatim(str(error).splitlines()[0]),
        ) from error
    protocol = parse_protocol(content, str(path))
    check_tests(protocol, str(path))
    return protocol


def parse_protocol(content: Any, what: str) -> Protocol:
    """Return the protocol of a parsed file.

    Args:
        content: content of the file.
        what: name of the file in the error.

    Raises:
        UnusableInputError: a value is missing or not valid.
    """
    if not isinstance(content, dict):
        raise UnusableInputError("protocol.no_object", "{path} must hold a JSON object", path=what)
    try:
        return Protocol(**content)
    except ValidationError as error:
        reason = option_error(Verbatim(what), Protocol.model_fields, error)
        if not error.errors()[0]["loc"]:  # of the whole protocol
            reason = Message("protocol.refused", "{path}: {reason}", path=what, reason=reason.values["reason"])
        raise UnusableInputError(reason) from error


def check_tests(protocol: Protocol, what: str) -> None:
    """Check the plan of a test under each condition, as far as that is possible without an instrument.

    Raises:
        UnusableInputError: limits, configuration, probe, coupling, orientation or length do not go together.
    """
    for step in (SittingStep("P", protocol.sites[0].site, condition, 1, 1, 1, 1) for condition in protocol.conditions):
        try:
            protocol.plan(step, "simulated://forearm", Path("test.h5")).check()
        except UnusableInputError as error:
            raise UnusableInputError("protocol.refused", "{path}: {reason}", path=what, reason=error.message) from error


def template() -> Protocol:
    """Return a protocol to begin with: four sites of the forearms, 5 repeats, without a product (thesis 7.1.1)."""
    arms = ("left forearm, posterior", "left forearm, anterior", "right forearm, posterior", "right forearm, anterior")
    return Protocol(name="Repeatability", sites=tuple(Site(site=site) for site in arms))


def protocol_text(protocol: Protocol) -> str:
    """Return a protocol as JSON text; a site with the usual repeats is its name alone."""
    values = protocol.model_dump(mode="json")
    values["sites"] = [site["site"] if site["repeats"] is None else site for site in values["sites"]]
    return json.dumps(values, indent=2, ensure_ascii=False) + "\n"
