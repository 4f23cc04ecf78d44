"""What the core says in English is said in German where people read it: gate, verdict, calibration, errors."""

import ast
import itertools
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import tissueid
from tissueid.acquisition.quality import setting
from tissueid.app.words import in_words
from tissueid.calibration.in_force import NOT_CALIBRATED
from tissueid.core_words import CALIBRATION, ERRORS, GAP, GATE, VERDICT, for_window, said_by_core
from tissueid.core_words.diagnosis import MEANINGS
from tissueid.core_words.effects import REMEDIES, SIGNATURES, TITLES
from tissueid.errors import UnusableInputError
from tissueid.gap.diagnosis import Ranked
from tissueid.gap.next_experiment import NextExperiment, odds
from tissueid.gap.statement import headline_of, next_steps_of, sentences_of
from tissueid.identification import engine_names, get_engine
from tissueid.identification import recommendation_words as advice
from tissueid.identification.family import Family
from tissueid.identification.recommendation import Choice, Standing
from tissueid.identification.validation.paired import Difference
from tissueid.instrument.answers import describe_faults
from tissueid.language import speak
from tissueid.records import Record
from tissueid.reports.verdict import ENDED_EARLY
from tissueid.twin.catalogue import all_effects
from tissueid.wire import Fault

CORE = Path(tissueid.__file__).parent
FIELDS_OF_SETTING = {"left": "skin", "shifted": "reference surface", "odd": "the tissue is strongly nonlinear"}
FIELDS_OF_SETTING |= {"unsettled": "The tissue is still settling"}
IN_PLACE = {
    "how": ("jumped by 0.4 mm at 1.2 s", "drifted by 0.4 mm"),
    "thing": ("surface",),
    "way": ("deeper", "higher"),
}
IN_PLACE |= {"'inner' if inner else 'outer'": ("inner", "outer"), "label": ("mass", "damping", "stiffness")}
IN_PLACE |= {"others": ("tests",), "against": ("", "; theirs differ by 4 %"), "said": ("", ": the cable was pulled")}
IN_PLACE |= {"when": ("2.0 s of its stimulus", "0.20 of the 0.50 s of its preload, without any stimulus")}
IN_PLACE |= {"warnings": ("mind the spring",), "what": ("The amplifier was at its limit",)}


@pytest.fixture(autouse=True)
def german():
    speak("de")
    yield
    speak("en")


def spoken_by(node):
    """Every text that an expression of the gate can make, with a number where it calculates one."""
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):  # f"...".strip()
        return [text.strip() for text in spoken_by(node.func.value)]
    if isinstance(node, ast.Constant):
        return [node.value]
    if not isinstance(node, ast.JoinedStr):
        return []
    texts = [""]
    for part in node.values:
        words = [part.value] if isinstance(part, ast.Constant) else _filled(ast.unparse(part.value))
        texts = [text + word for text in texts for word in words]
    return texts


def _filled(name):
    if ".setting." in name or name.startswith("setting."):
        return [FIELDS_OF_SETTING[name.rsplit(".", 1)[1]]]
    return IN_PLACE.get(name, ("7",))


def findings():
    texts = set()
    for path in sorted((CORE / "acquisition" / "quality").glob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "QualityFinding":
                for argument in node.args[2:4]:
                    texts |= set(spoken_by(argument))
    tissue = vars(setting.TISSUE)
    return sorted(filter(None, texts | {words for name, words in tissue.items() if name.startswith("to_")}))


def test_all_that_the_gate_says_of_tissue_is_said_in_german():
    said = findings()
    assert len(said) > 70
    untold = [text for text in said if for_window(text) == text]
    assert untold == []
    assert any("tissueid calibrate" in text for text in said)
    assert not [text for text in said if "tissueid calibrate" in for_window(text)]
    said_in_german = for_window("The probe left the skin for 3 % of the test: nothing pressed it onto the tissue.")
    assert said_in_german == "Die Sonde verließ während 3 % des Tests die Haut: nichts drückte sie auf das Gewebe."


def test_every_reason_of_the_verdict_is_said_in_german():
    texts = [*ENDED_EARLY.values()]
    for node in ast.walk(ast.parse((CORE / "reports" / "verdict.py").read_text(encoding="utf-8"))):
        if (
            isinstance(node, ast.Tuple)
            and len(node.elts) == 2
            and isinstance(node.elts[1], ast.JoinedStr | ast.Constant)
        ):
            level = node.elts[0]
            if isinstance(level, ast.Name) or (isinstance(level, ast.Constant) and level.value in ("check", "poor")):
                texts += [text for text in _reasons(node.elts[1]) if len(text) > 12]
    assert len(texts) >= 9
    assert [text for text in texts if said_by_core(text) == text] == []


def _reasons(node):
    fill = {"both": "(Wiener: 7 % of the fitted motion, 7 % of the unseen)", "usual": "skin usually gives 70 to 95 %"}
    if isinstance(node, ast.Constant):
        return [str(node.value)]
    share = {"share": "7 %"}
    words = [
        part.value if isinstance(part, ast.Constant) else (fill | share).get(ast.unparse(part.value), "7")
        for part in node.values
    ]
    return ["".join(words)]


def test_calibration_of_an_instrument_in_a_line():
    assert for_window(NOT_CALIBRATED) == "nicht kalibriert: Es gelten die Nennwerte"
    lines = {"calibrated today, linear region not known": "kalibriert heute, linearer Bereich unbekannt"}
    lines["calibrated 12 days ago, linear from 4.0 to 27.5 mm"] = "kalibriert vor 12 Tagen, linear 4.0 bis 27.5 mm"
    lines["calibration is stale: calibrated 400 days ago, linear region not known"] = (
        "Kalibrierung veraltet: kalibriert vor 400 Tagen, linearer Bereich unbekannt"
    )
    for english, german_line in lines.items():
        assert for_window(english) == german_line


def test_every_fault_of_the_firmware_is_said_in_german():
    words = [describe_faults(fault) for fault in Fault if fault]
    assert len(words) == 10
    assert [text for text in words if said_by_core(text) == text] == []
    told = in_words(UnusableInputError(f"the instrument released the coil: {describe_faults(Fault.OVER_FORCE)}"))
    assert told == "Das Gerät gab die Spule frei: die Kraft ging über ihre Grenze: Wählen Sie eine schwächere Anregung."


@pytest.mark.parametrize("text", ["", "nobody knows this", "Start test 7; and {braces} \n too", "x" * 5000, "5 days"])
def test_what_is_not_known_stays(text):
    assert said_by_core(text) == text


def test_english_stays_english():
    speak("en")
    for template in (*GATE, *VERDICT, *CALIBRATION, *ERRORS, *GAP):
        assert said_by_core(template) == template


def test_a_value_may_hold_anything():
    path = "/tmp/{x}/a\nb; the coil is released"
    assert said_by_core(f"there is no folder {path}") in (
        f"es gibt den Ordner {path} nicht",
        f"es gibt den Ordner {said_by_core(path)} nicht",
    )


def untold(texts):
    return sorted(text for text in texts if said_by_core(text) == text)


def test_every_effect_is_said_in_german():
    every = all_effects()
    assert len(every) > 30
    assert untold(words for item in every.values() for words in (item.title, item.signature, item.remedy)) == []
    assert untold(part.meaning for item in every.values() for part in item.parameters if part.meaning) == []
    assert {name: item.title for name, item in every.items()} == TITLES  # nothing is left of an effect that has gone
    assert set(SIGNATURES) == {item.signature for item in every.values()}
    assert set(REMEDIES) == {item.remedy for item in every.values()}
    assert set(MEANINGS) & {part.meaning for item in every.values() for part in item.parameters}
    title = every["dry_friction"].title
    assert said_by_core("dry_friction") == said_by_core(title[:1].lower() + title[1:]) == "Trockenreibung im Lager"


def texts_in(path, *called):
    """What the calls of these names, and what is assigned to ``what`` or yielded, is made of."""
    tree = ast.parse((CORE / path).read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and (getattr(node.func, "attr", "") or getattr(node.func, "id", "")) in called:
            yield from (text for argument in node.args for text in spoken_by(argument))
        elif isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") in ("what", "remarks"):
            made = node.value.elt if isinstance(node.value, ast.ListComp) else node.value
            yield from spoken_by(made)
        elif isinstance(node, ast.AugAssign) and isinstance(node.value, ast.ListComp):
            yield from spoken_by(node.value.elt)


def families():
    for node in ast.walk(ast.parse((CORE / "gap" / "forces.py").read_text(encoding="utf-8"))):
        if isinstance(node, ast.Yield) and isinstance(node.value, ast.Tuple):
            yield node.value.elts[1].value


@pytest.fixture
def in_evidence(monkeypatch):
    places = {"_PLACES[name]": ("without tissue", "on tissue"), "chosen.kind": tuple(families())}
    places |= {"answer.channel": ("voltage", "position"), "name": ("current",)}
    places |= {"what": ("from the command", "from voltage and motion", "from the voltage", "from the current")}
    monkeypatch.setattr(f"{__name__}.IN_PLACE", places)


def test_what_speaks_against_a_stage_is_said_in_german(in_evidence):
    kinds = set(families())
    assert len(kinds) > 15
    assert [kind for kind in untold(kinds) if kind != "position"] == []
    found = {text for text in texts_in("gap/evidence.py", "_add", "_without_lines") if len(text) > 12}
    assert len(found) > 40
    assert untold(found) == []
    assert said_by_core("lines of the mains in the voltage, from the command").endswith("gerechnet aus dem Befehl")


def test_what_is_left_out_of_a_diagnosis_is_said_in_german(in_evidence):
    found = [*texts_in("gap/observing.py", "append", "UnusableInputError"), *texts_in("gap/impulses.py")]
    found += texts_in("gap/driving.py", "UnusableInputError")
    assert len(found) > 18
    assert untold(found) == []


def menu_words():
    for node in ast.walk(ast.parse((CORE / "gap" / "menu.py").read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "_item":
            words = [item.value for item in node.args if isinstance(item, ast.Constant)][:2]
            yield words[0], words[1]


def why(words, named):
    """The reason of a next test, as the core would put it together."""
    for node in ast.walk(ast.parse((CORE / "gap" / "next_experiment.py").read_text(encoding="utf-8"))):
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "why":
            titles = "; ".join(all_effects()[name].title for name in named)
            given = {"chosen": SimpleNamespace(words=words), "titles": titles, "odds": odds}
            given |= {"apart": 3.2, "gain": 1.4, "others": [1.4, 0.3]}
            return eval(compile(ast.Expression(node.value), "why", "eval"), given)
    raise AssertionError("the next experiment says no reason any more")


def diagnosis(**changes):
    alike = ("dry_friction", "end_stop", "reflex")
    item = Ranked("coil_heating", "coil", 0.95, 0.4, (0.3, 0.5), alike, {})
    regions = {"bands_hz": ((3.0, 9.0), (20.0, 40.0)), "depth_m": ((1e-3, 2e-3),), "current_a": ((0.1, 0.2),)}
    regions |= {"amplitude_n": ((1.0, 2.0),), "mains_phase_rad": ((0.1, 1.0), (2.0, 3.0)), "mains_hz": 50.0}
    where = {"stage": "coil", "above_floor": True, "shares": dict.fromkeys(STAGES_, 0.1) | {"coil": 0.7}}
    where["regions"] = SimpleNamespace(channel="position", direction="into", **regions)
    found = {"verdict": "effect", "combination": ("coil_heating",), "ranking": (item,), "next_experiment": None}
    found |= {"where": SimpleNamespace(**where), "beside": {}} | changes
    return SimpleNamespace(at_fault=() if found["verdict"] == "no_gap" else ("coil",), **found)


STAGES_ = ("drive", "coil", "mechanics", "tissue", "sensing", "environment")
ENGLISH_WORDS = {"the", "and", "of", "to", "is", "it", "from", "with", "that", "most", "than", "would", "at", "in each"}


def is_german(text):
    return said_by_core(text) != text and not ENGLISH_WORDS & set(said_by_core(text).replace(",", "").split())


def test_where_the_gap_shows_and_what_to_do_is_said_in_german():
    pairs = itertools.combinations(all_effects(), 2)
    for one, other in pairs:
        reason = why("press slowly and let go again", (one, other))
        step = NextExperiment("slow_ramp", reason, (one, other))
        found = diagnosis(combination=(one, other), next_experiment=step)
        assert not ENGLISH_WORDS & set(headline_of(found, said_by_core)[0].replace(",", "").split())
        assert [text for text in next_steps_of(found) if not is_german(text)] == []
    for verdict, way in itertools.product(("effect", "unexplained", "no_gap"), ("into", "out", "both")):
        found = diagnosis(verdict=verdict, combination=("coil_heating",) if verdict == "effect" else ())
        found.where.regions.direction = way
        assert headline_of(found, said_by_core)[0] != headline_of(found)[0]
        assert not ENGLISH_WORDS & set(headline_of(found, said_by_core)[0].replace(",", "").split())
        said = [*sentences_of(found), *next_steps_of(found)]
        assert [text for text in said if not is_german(text)] == []
    assert said_by_core(list(sentences_of(diagnosis()))[1]) == (
        "Am meisten zeigt sie sich in: Position, von 3 bis 9 Hz und 20 bis 40 Hz, in Tiefen von 1 bis 2 mm, bei "
        "Strömen von 0.1 bis 0.2 A, bei einer Amplitude (der Anregung über die letzten 0.1 s) von 1 bis 2 N und bei "
        "Netzphasen (50 Hz) von 5.7 bis 57 Grad und 110 bis 170 Grad, während die Sonde hineingeht."
    )


def test_every_test_of_the_menu_is_said_in_german():
    items = list(menu_words())
    assert len(items) == 9
    for kind, words in items:
        assert is_german(words)
        assert said_by_core(kind.replace("_", " ")) != kind.replace("_", " ")
        assert is_german(why(words, ("dry_friction",)).rstrip("."))


def standing(family, **changes):
    lead = changes.pop("lead", Difference(1.25, 0.5, 0.03, 0.2, 900))
    made = Standing("wiener", family, False, 80.0, 90.0, None, 12.0, lead, lead, True)
    return replace(made, **changes)


def told_in_every_way():
    time = np.linspace(0.0, 30.0, 4000)
    fitted = Record(time, 1e-3 * np.sin(time), 1000.0)
    names = ("position", "force", "acceleration_x")
    unseen = [Record(time, size * np.sin(time), 1000.0, output_name=name) for size in (2e-4, 5e-3) for name in names]
    leads = [Difference(points, 2.5, chance, 0.02, 900) for points in (0.05, 1.0) for chance in (0.0001, 0.3, None)]
    for family, held_out, lead in itertools.product(Family, [*unseen, Record(time[:500], time[:500], 1000.0)], leads):
        chosen = standing(family, lead=lead, engine="lms", vaf_percent=70.0)
        best = standing(Family.OTHER, engine="volterra", vaf_percent=75.0, scheduled_percent=99.0)
        below = standing(Family.LINEAR, engine="rls", second_order=True)
        yield advice.Told(chosen, (best, chosen, below), held_out, fitted, 99.0)
        yield advice.Told(replace(chosen, aicc=1.0, second_order=True), (best, chosen, below), held_out, fitted, None)
        yield advice.Told(replace(chosen, vaf_percent=40.0), (best, chosen), held_out, fitted, None)
        yield advice.Told(chosen, (chosen,), held_out, fitted, None)


def test_what_a_comparison_recommends_is_said_in_german():
    said = set()
    for told in told_in_every_way():
        said |= {advice.headline(told), *advice.reasons(told), *advice.doubts(told), *advice.experiments(told)}
    for option, value in itertools.product(("memory", "partitions", "order", "levels"), (0.1, 4.0)):
        said.add(advice.choice(Choice(option, value, (0.1, 4.0), (80.0, 81.0))))
    assert len(said) > 60
    assert sorted(text for text in said if not is_german(text)) == []
    assert untold({str(family) for family in Family}) == ["linear"]  # the same in both


def test_every_engine_and_option_is_said_in_german():
    kinds = [get_engine(name) for name in engine_names()]
    abouts = [" ".join((kind.__doc__ or "").split("\n\n")[0].split()) for kind in kinds]
    options = {info.description for kind in kinds for info in kind.model_fields.values() if info.description}
    assert len(abouts) > 10
    assert len(options) > 40
    assert untold([*abouts, *options]) == []
