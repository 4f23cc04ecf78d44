"""What the core says in English is said in German where people read it: gate, verdict, calibration, errors."""

import ast
from pathlib import Path

import pytest

import tissueid
from tissueid.acquisition.quality import setting
from tissueid.app.core_words import CALIBRATION, ERRORS, GAP, GATE, VERDICT, said_by_core
from tissueid.app.language import speak
from tissueid.app.words import for_window, in_words
from tissueid.calibration.in_force import NOT_CALIBRATED
from tissueid.errors import UnusableInputError
from tissueid.instrument.answers import describe_faults
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
    if isinstance(node, ast.Call):  # f"...".strip()
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
    texts = []
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
