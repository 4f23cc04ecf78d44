"""Sentences of the core that people read most, with named places for what changes: how window and reports say them.

The core says everything in English, for files, logs and the shell. Here a sentence is known again by its template and
said by the catalogue's; one that is not known stays as it is.
"""

from __future__ import annotations

import functools
import re

from tissueid.core_words.diagnosis import FINDINGS, MEANINGS, MENU, NEXT, PLACES, REMARKS, SPANS
from tissueid.core_words.effects import TITLES
from tissueid.core_words.recommendation import ADVICE
from tissueid.language import ENGLISH, _, marked, spoken

GATE = (
    marked("The test {how} after {seconds} s of its stimulus: {why}."),
    marked("The test {how} after {seconds} s of its stimulus."),
    marked("The test {how} after {held} of the {preload} s of its preload, without any stimulus: {why}."),
    marked("The test {how} after {held} of the {preload} s of its preload, without any stimulus."),
    marked("was broken off"),
    marked("was recovered after its recording was interrupted"),
    marked("Run it again when the cause is mended; what was recorded can be analysed, but is shorter than planned."),
    marked("{what} for {percent} % of the test: what was recorded there is cut off."),
    marked("A converter was at the end of its range"),
    marked("The amplifier was at its limit"),
    marked("Lower the force, and look whether the instrument is knocked or at the end of its stroke."),
    marked("The probe came within {room} mm of the inner end of its stroke."),
    marked("The probe came within {room} mm of the outer end of its stroke."),
    marked(
        "For {percent} % of the test the probe was outside the stretch of {low} to {high} mm where the coil was "
        "found to be linear."
    ),
    marked("Place the instrument so that the test stays inside it; forces outside are less than they read."),
    marked(
        "For {held} samples ({percent} %) the next force was not there in time, and the instrument held a steady one."
    ),
    marked("Close other programs, or let the stimulus be made further ahead (its option lead)."),
    marked("The reading of the {label} stood still for {seconds} s while the coil was driven."),
    marked("Do not use the test. Check the sensor and its cable, and calibrate before the next one."),
    marked("The coil got {percent} % of the voltage that was asked for."),
    marked("Check the power supply; the force is measured and can be used, but was not the one that was designed."),
    marked("Hardly any current flowed through the coil, for some of the test or for all of it."),
    marked(
        "It was the calculation that ended the test: by its current the winding came to the limit of {limit} °C. "
        "The sensor beside it, which lags, read {read} °C."
    ),
    marked("Let the coil cool for some minutes, and rest between repeats (--rest)."),
    marked("No calibration was in force: nominal figures of the instrument were used."),
    marked("{lost} of {samples} samples ({percent} %) did not arrive, {gap} ms of them in one piece."),
    marked("Check the cable and close other programs. What is missing stays empty and is left out."),
    marked("The coil's resistance looks like {found} Ω; {expected} Ω was expected."),
    marked("The coil was at {hottest} °C."),
    marked("Let it cool before the next test, and keep it off the skin."),
    marked("The calibration is out of date. {warnings}"),
    marked("The calibration is out of date."),
    marked("The coil warmed by {kelvin} K in this test, its resistance by some {percent} %."),
    marked("The force is measured by the current and holds; pause between tests."),
    marked("The calibration in force should not be relied on. {warnings}"),
    marked("The calibration in force should not be relied on."),
    marked("Have the instrument calibrated before the next test."),
    marked("Of the calibration: {warnings}"),
    marked("The probe left the skin for {percent} of the test: {how}."),
    marked("nothing pressed it onto the tissue"),
    marked("it stood above the surface"),
    marked(
        "The reference surface moved: the position jumped by {size} mm at {seconds} s beyond what force and creep"
        " account for."
    ),
    marked("The reference surface moved: the position drifted by {size} mm beyond what force and creep account for."),
    marked("The instrument was knocked {seconds} s into the test: it felt {peak} m/s² sideways."),
    marked("The instrument was turned by {degrees}° since it was placed."),
    marked("The mean load was held for {seconds} s before the test: too short to see whether the tissue had settled."),
    marked("Hold the preload for 0.5 s or longer."),
    marked(
        "The tissue had not settled when the test began: it still gave way by {size} mm in the last {seconds} s "
        "of the preload."
    ),
    marked("Hold the preload longer, or run the test again at once and discard this one."),
    marked("The surface lies {size} mm deeper than in the tests before at this site: the instrument was moved."),
    marked("The surface lies {size} mm higher than in the tests before at this site: the instrument was moved."),
    marked("The quality gate failed on this test: it was not judged."),
    marked("Look at its signals before you use it."),
    marked(
        "Only {percent} % of the motion goes with the force, by its coherence: something else moved the probe, or"
        " the tissue is strongly nonlinear."
    ),
    marked(
        "The signals hold the mains at {hertz} Hz: {newtons} N, {percent} % of the force's spread, that no motion"
        " accounts for."
    ),
    marked("Use another socket, keep the cable away from power supplies, and check the earth of the instrument."),
    marked("The {label} is noisy: its signal stands {ratio} dB above the noise."),
    marked("Use a larger force, keep cables and phones away, and run the test again."),
    marked(
        "The tissue is still settling: on average the probe stood {size} mm {way} than in {which}, under the same"
        " force."
    ),
    marked("deeper"),
    marked("less deep"),
    marked("the first test at this site"),
    marked("the one before"),
    marked(
        "On average the probe stood {size} mm {way} than in {count} earlier tests with the same command at this site."
    ),
    marked("The response differs by {percent} % from {count} earlier test with the same command at this site."),
    marked(
        "The response differs by {percent} % from {count} earlier tests with the same command at this site; "
        "theirs differ by {theirs} %."
    ),
    marked("The response differs by {percent} % from {count} earlier tests with the same command at this site."),
    marked("The mass is {percent} % off that of {count} earlier tests at this site."),
    marked("The damping is {percent} % off that of {count} earlier tests at this site."),
    marked("The stiffness is {percent} % off that of {count} earlier tests at this site."),
    marked(
        "Raise the lowest force, or place the probe deeper and hold the reference surface firmly; where lifting "
        "off was meant, use a nonlinear description."
    ),
    marked("Hold the reference surface firmly against the tissue, rest the arm, and run the test again."),
    marked("If the reference surface may have moved, run the test again."),
    marked("Hold it still and place it again: the weight of the moving part loads the tissue differently."),
    marked("Rest the arm, hold the reference surface firmly, and run the test again; try a nonlinear description too."),
    marked("Place the instrument so that the surface lies near the middle of the stroke, and run the test again."),
    marked("Look whether the arm or the instrument moved, and run the test once more to see which is right."),
    marked("Compare only tests that were placed alike, or repeat the series without lifting the instrument."),
    marked("Run the test again until two agree, and leave the first of this site out."),
)
"""What the quality gate says of a test on tissue, and what to do about it."""
VERDICT = (
    marked("The test was ended early; only what was recorded until then is analysed."),
    marked("The test was recovered after its recording was interrupted."),
    marked("{lost} of {samples} samples ({share} %) were not received."),
    marked("The probe stood above the surface for {percent} % of the time: it left the tissue."),
    marked("No model could be tried on data that it had not seen."),
    marked("No model accounts for more than {percent} % of motion that it had not seen."),
    marked("The best model accounts for {percent} % of unseen motion; skin usually gives 70 to 95 %."),
    marked(
        "The fitted part is harder to explain than the held-out part, as under drift ({engine}: {seen} % of the "
        "fitted motion, {unseen} % of the unseen)."
    ),
    marked(
        "The models do worse on unseen motion than on what they were fitted to ({engine}: {seen} % of the fitted "
        "motion, {unseen} % of the unseen)."
    ),
    marked("the model predicts nothing of data that it was not fitted to: its parameters are no results"),
    marked("{engine}: the model predicts nothing of data that it was not fitted to: its parameters are no results."),
    marked("Uncertain by more than {percent} %: {names}."),
    marked("mass"),
    marked("damping"),
    marked("stiffness"),
    marked("mass, damping"),
    marked("mass, stiffness"),
    marked("damping, stiffness"),
    marked("mass, damping, stiffness"),
    marked("Averages over {low} to {high} mm of position, which is {above} to {below} mm below the surface."),
    marked("Averages over {low} to {high} mm of position."),
    marked("the last {percent} % of test {number}"),
)
"""What the verdict of a test gives as its reasons, and over what its numbers are averages."""
CALIBRATION = (
    marked("not calibrated: the nominal figures are used"),
    marked("{words}, linear from {low} to {high} mm"),
    marked("{words}, linear region not known"),
    marked("calibration is stale: {words}"),
    marked("calibrated {age}"),
    marked("today"),
    marked("yesterday"),
    marked("{days} days ago"),
    marked("no static calibration: {force}, sweep of {age}"),
    marked("static calibration refused: {force}, sweep of {age}"),
    marked("nominal force"),
    marked("force by the sweep"),
)
"""How an instrument is calibrated, in a line."""
ERRORS = (
    marked("no instrument answers on {name}; check the cable and the power, and that no other program uses it"),
    marked("{name} does not answer {kind}; check the cable and the power"),
    marked(
        "the connection to {name} broke: {why}. Check the cable, and connect again. The instrument's own watchdog "
        "releases the coil within {watchdog} s"
    ),
    marked(
        "{name} went silent for {seconds} s. Check the cable and the power, and connect again. The instrument's own "
        "watchdog releases the coil within {watchdog} s"
    ),
    marked(
        "{name} sent no usable samples for {seconds} s. Check the cable and the power, and connect again. The "
        "instrument's own watchdog releases the coil within {watchdog} s"
    ),
    marked("the instrument contradicts itself about which samples it played: connect again, or update its firmware"),
    marked("the test has not ended after {seconds} s, and ought to have: connect again, and measure again"),
    marked("no samples arrive from {name}: check the cable, and connect again"),
    marked("the coil is at {hottest} °C; the limit is {limit} °C: let it cool"),
    marked("the force reached {force} N; the limit is {limit} N"),
    marked("the stimulus reaches {force} N; the limit is {limit} N"),
    marked("the stimulus lasts {seconds} s in all, preload included; the limit is {limit} s"),
    marked("the probe reached the end of its stroke, at {place} mm"),
    marked("the test ran for {seconds} s; the limit is {limit} s"),
    marked("the probe is at the end of its stroke ({place} mm): push it to the middle and try again"),
    marked("the probe is at the end of its stroke ({place} mm): place it on the tissue and try again"),
    marked("the probe does not keep still: hold the reference surface firmly, and place it again"),
    marked("samples were lost while the probe was placed; check the link and try again"),
    marked("the instrument does not tell where the probe is; check the link and try again"),
    marked("{missing} samples are missing at once; the link cannot be trusted"),
    marked("cancelled; the coil is released and what was recorded is kept"),
    marked("{path} is there already; sessions are never overwritten"),
    marked("there is no folder {folder}"),
    marked("{folder} has {free} MB free, and {wanted} MB are wanted: make room, or name a session on another disk"),
    marked("{error}. Is the instrument in use by another program?"),
    marked("stopped in the window"),
    marked("stopped by key"),
    marked("the window was closed"),
    marked("a defect in the window"),
    marked("{cause}; the coil is released."),
    marked("{cause}; the coil is released"),
    marked("the instrument released the coil: {why}"),
    marked("the instrument refuses after a fault: {why}"),
    marked("the computer was silent for too long: close other programs, then measure again"),
    marked("the force went beyond its limit: choose a weaker stimulus"),
    marked("the probe reached the end of its stroke: place it nearer to the middle"),
    marked("the coil is too hot: let it cool for some minutes"),
    marked("the test lasted too long: choose a shorter stimulus"),
    marked("the button was pressed: let go of it, then measure again"),
    marked("the computer fell behind with the stimulus: close other programs, then measure again"),
    marked("the supply voltage sagged: check the power supply and its plug"),
    marked("the position sensor does not move as the force asks for: check its plug and cable"),
    marked("the coil's current does not follow the voltage: check the coil's plug and cable"),
)
"""What goes wrong while somebody measures."""
GAP = (
    marked("No gap: the twin explains this recording down to its noise"),
    marked("There is a gap that no known effect explains; it arises in {stage}"),
    marked("There is a gap that no known effect explains; no single stage shows it"),
    marked("The gap is explained: {causes}"),
    marked("The gap is probably explained: {causes}"),
    marked(" or "),
    marked("{share} % as a single cause"),
    marked("It arises in {stages}, where the causes belong."),
    marked("It arises in {stage}: {percent} % of what noise does not explain."),
    marked(
        "It arises in {stage}, where the cause belongs. The stages alone would have suspected {other}: what the "
        "cause leaves looks like a fault there."
    ),
    marked("This data cannot tell it from: {names}."),
    marked("The best attempt, {effect}, closes {share} and does not explain it."),
    marked("Nothing needs to be done: the twin may be used as it is."),
    marked("Add the effect to a named twin, so that simulation and later diagnoses have it."),
    marked("Look at {stage}: the cause is there, and none of the known effects fits it."),
    marked("the amplifier"),
    marked("the coil"),
    marked("the moving part (mechanics)"),
    marked("the tissue"),
    marked("the sensors"),
    marked("the surroundings"),
)
"""What a diagnosis says first."""
SAID_FOR_SHELL = (
    (
        "Run 'tissueid calibrate static', and 'tissueid calibrate sweep' where its date has passed.",
        marked("Calibrate on the page Instrument: static, and the sweep where its date has passed."),
    ),
    (
        "Run 'tissueid calibrate static' before the next test.",
        marked("Calibrate on the page Instrument before the next test."),
    ),
    (
        "Run 'tissueid calibrate static' before measurements that are to be compared.",
        marked("Calibrate on the page Instrument before measurements that are to be compared."),
    ),
    (
        "Check that the coil is connected, then run 'tissueid calibrate static'.",
        marked("Check that the coil is connected, then calibrate on the page Instrument."),
    ),
    (
        "there is no static calibration: run 'tissueid calibrate static'",
        marked("there is no static calibration: calibrate on the page Instrument"),
    ),
    (
        "the linear region is not known: run 'tissueid calibrate sweep'",
        marked("the linear region is not known: do a sweep on the page Instrument"),
    ),
    ("run 'tissueid calibrate static'", marked("calibrate on the page Instrument")),
    ("run 'tissueid calibrate sweep'", marked("do a sweep on the page Instrument")),
)
"""What the core advises to somebody at a shell, longest first, and what is to be done instead in the window."""
_FIELD = re.compile(r"\{(\w+)\}")
_LONGEST = 2000
"""Letters of a text that is looked at; what is longer is no sentence of the core."""


_LISTS = ("; ", ", ", marked(" and "))
_OF_SPANS = re.compile("(, | and )")
_CAUSES = TITLES | {title[:1].lower() + title[1:]: title for title in TITLES.values()}
"""The other forms in which the core names an effect: by its name, and by its title within a sentence."""
_FORMS = {"rival": "|".join([*map(re.escape, _CAUSES), ".+?"]), "spans": ".+"}
"""Fields that are no shortest match: a title may hold a colon, and spans commas, as the sentences around them do."""
_DEEDS = {words[:1].upper() + words[1:]: words for words in MENU}
"""What is done in a test that could be run next, as it stands at the beginning of a sentence."""


def said_by_core(text: str) -> str:
    """A sentence of the core in the language of the window; as it is where that is English, or nobody knows it."""
    if spoken() == ENGLISH or len(text) > _LONGEST:
        return text
    if (said := _(text)) != text:
        return said
    if text in _CAUSES:
        return _(_CAUSES[text])
    if text in _DEEDS:
        said = _(_DEEDS[text])
        return said[:1].upper() + said[1:]
    return _by_templates(text, _patterns())


def for_window(text: str) -> str:
    """What the core says, without commands: what it is and what to do about it in the window, in its language."""
    text = said_by_core(text)
    for shell, window in SAID_FOR_SHELL:
        if "'tissueid calibrate" not in text:
            break
        text = text.replace(shell, _(window)).replace(_capital(shell), _capital(_(window)))
    return text


def _capital(text: str) -> str:
    return text[0].upper() + text[1:]


def for_report(text: str) -> str:
    """Return what the core says in the language of a report: in English as it is, with its commands."""
    return text if spoken() == ENGLISH else for_window(text)


def _by_templates(text: str, known: tuple[tuple[str, re.Pattern[str]], ...]) -> str:
    for template, pattern in known:
        if (found := pattern.fullmatch(text)) is not None:
            return _(template).format(**{name: _value(name, value) for name, value in found.groupdict().items()})
    return text


def _value(name: str, value: str) -> str:
    """What stands in a field: a text of its own, a list of such, or what is as it is in every language."""
    if name == "spans":
        parts = _OF_SPANS.split(value)
        return "".join(_(" and ") if part == " and " else _by_templates(part, _spans()) for part in parts)
    if (said := said_by_core(value)) != value:
        return said
    between = next((mark for mark in _LISTS if mark in value), None)
    if between is None:
        return value
    parts = value.split(between)
    each = [_value("", part) for part in parts]
    known = all(one != part for one, part in zip(each, parts, strict=True))
    return _(between).join(each) if known else value


@functools.cache
def _patterns() -> tuple[tuple[str, re.Pattern[str]], ...]:
    """The templates with fields, in their order: the first that fits is meant."""
    every = (*GATE, *VERDICT, *CALIBRATION, *ERRORS, *GAP, *FINDINGS, *PLACES, *NEXT, *REMARKS, *MEANINGS, *ADVICE)
    return tuple((template, _pattern(template)) for template in every if _FIELD.search(template))


@functools.cache
def _spans() -> tuple[tuple[str, re.Pattern[str]], ...]:
    return tuple((template, _pattern(template)) for template in SPANS)


def _pattern(template: str) -> re.Pattern[str]:
    parts = _FIELD.split(template)
    fixed, names = parts[::2], parts[1::2]
    fields = [f"(?P<{name}>{_FORMS.get(name, '.+?')})" for name in names] + [""]
    return re.compile("".join(re.escape(text) + field for text, field in zip(fixed, fields, strict=True)), re.DOTALL)
