"""The window in German: every text that the code says has its translation, and the pages show it."""

import ast
import re
import string
import tomllib
from pathlib import Path

import pytest
from PySide6.QtCore import QLocale, QSettings
from PySide6.QtWidgets import QAbstractButton, QComboBox, QLabel

from tissueid import language
from tissueid.app.help_panel import FOLDER
from tissueid.app.language_choice import chosen
from tissueid.app.views.start.view import WHAT_ROLES_DO
from tissueid.language import _, plural, speak

SOURCE = Path(language.__file__).parent
IN_TEMPLATES = re.compile(r'\b_\("([^"]*)"\)')
LOOKS_UP = {"_": 1, "marked": 1, "plural": 2}


def literals():
    """Every text that the code looks up, with the files that do."""
    found = {}
    for path in sorted(SOURCE.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in LOOKS_UP:
                for text in node.args[: LOOKS_UP[node.func.id]]:
                    if isinstance(text, ast.Constant):
                        found.setdefault(text.value, set()).add(path.relative_to(SOURCE).as_posix())
    for path in sorted(SOURCE.rglob("*.j2")):
        for text in IN_TEMPLATES.findall(path.read_text(encoding="utf-8")):
            found.setdefault(text, set()).add(path.name)
    return found


def fields(text):
    parts = string.Formatter().parse(text)
    return sorted((name, spec, kind or "") for _text, name, spec, kind in parts if name is not None)


@pytest.fixture(scope="module")
def german():
    return language.catalogue("de")


@pytest.fixture(autouse=True)
def english_again():
    yield
    speak("en")


def test_every_text_has_a_german_entry_and_no_entry_is_unused(german):
    said = literals()
    assert len(said) > 250
    assert {text: files for text, files in said.items() if text not in german} == {}
    assert set(german) - set(said) == set()


def test_the_catalogue_says_each_text_once():
    pages = tomllib.loads((language.FOLDER / "de.toml").read_text(encoding="utf-8"))
    texts = [text for page in pages.values() for text in page]
    assert sorted(texts) == sorted(set(texts))


def test_placeholders_agree_and_are_named(german):
    for english, said in german.items():
        assert fields(english) == fields(said), english
        assert all(name.isidentifier() for name, _spec, _kind in fields(english)), english


def test_a_mnemonic_stays_a_mnemonic_and_nothing_is_empty(german):
    for english, said in german.items():
        assert english.count("&") == said.count("&"), english
        assert said.strip(), english
        assert english[0].isspace() == said[0].isspace(), english


def test_nothing_called_underscore_hides_the_lookup():
    """A loop or a parameter called ``_`` would shadow it in the whole function."""
    for path in sorted(SOURCE.rglob("*.py")):
        for function in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(function, ast.FunctionDef):
                own = set(ast.walk(function))
                inner = [n for n in own if isinstance(n, ast.GeneratorExp | ast.ListComp | ast.DictComp | ast.SetComp)]
                own -= {node for part in inner for node in ast.walk(part)}
                calls = any(isinstance(n, ast.Call) and isinstance(n.func, ast.Name) and n.func.id == "_" for n in own)
                binds = any(isinstance(n, ast.Name) and n.id == "_" and isinstance(n.ctx, ast.Store) for n in own)
                binds |= any(isinstance(n, ast.arg) and n.arg == "_" for n in own)
                assert not (calls and binds), f"{path.name}: {function.name}"


def test_a_lookup_falls_back_and_knows_one_from_many():
    assert _("Stiffness") == "Stiffness"
    speak("de")
    assert _("Stiffness") == "Steifigkeit"
    assert _("no such text") == "no such text"
    one = plural("One instrument answers ({names})", "{count} instruments answer ({names})", 1)
    assert one.format(count=1, names="A") == "Ein Gerät antwortet (A)"
    many = plural("One instrument answers ({names})", "{count} instruments answer ({names})", 3)
    assert many.format(count=3, names="A") == "3 Geräte antworten (A)"
    speak("en")
    assert _("Stiffness") == "Stiffness"


def test_the_language_is_the_wanted_the_kept_or_the_systems(tmp_path, monkeypatch):
    settings = QSettings(str(tmp_path / "w.ini"), QSettings.Format.IniFormat)
    here = QLocale("de_AT")
    monkeypatch.setattr(QLocale, "system", staticmethod(lambda: here))
    assert chosen("", settings) == "de"
    settings.setValue("language", "en")
    assert chosen("", settings) == "en"
    assert chosen("de", settings) == "de"
    settings.setValue("language", "tlh")
    assert chosen("", settings) == "en"
    settings.remove("language")
    there = QLocale("fr_FR")
    monkeypatch.setattr(QLocale, "system", staticmethod(lambda: there))
    assert chosen("", settings) == "en"


def test_a_language_that_is_not_known_is_english():
    speak("de")
    speak("tlh")
    assert language.spoken() == "en"
    assert _("Stiffness") == "Stiffness"


def test_every_page_has_german_help():
    english = {path.name for path in FOLDER.glob("*.md")}
    assert {path.name for path in (FOLDER / "de").glob("*.md")} == english
    for name in english:
        there = [(FOLDER / name).read_text(encoding="utf-8"), (FOLDER / "de" / name).read_text(encoding="utf-8")]
        headings, rows = ([sum(line.startswith(mark) for line in text.splitlines()) for text in there] for mark in "#|")
        assert headings[0] == headings[1], name
        assert rows[0] == rows[1], name


def test_start_and_measure_are_german_and_the_choice_is_kept(open_window):
    window = open_window(language="de", first_page="start")
    page = window.pages.start
    shown = {label.text() for label in page.findChildren(QLabel)}
    shown |= {button.text() for button in page.findChildren(QAbstractButton)}
    assert {"Wer arbeitet?", "Letzte Sitzungen", "Geräte", "Sprache", "Ordner zeigen"} <= shown
    assert page.cards["technician"].accessibleName().startswith("Technik: Das Gerät betreuen")
    assert not shown & set(WHAT_ROLES_DO.values())
    heads = [page.recent.horizontalHeaderItem(column).text() for column in range(4)]
    assert heads == ["Datum", "Messort", "Person", "Qualitätsprüfung"]
    assert window.panels.help.reader.toPlainText().startswith("Start\n")
    assert "Medizinprodukt" in window.panels.help.reader.toPlainText()

    chooser = page.language.choice
    assert [chooser.itemText(place) for place in range(chooser.count())] == ["English", "Deutsch"]
    assert chooser.currentData() == "de"
    chooser.setCurrentIndex(0)
    assert window.settings.value("language") == "en"
    assert window.ui.notice.text.text() == "English gilt ab dem nächsten Start."
    assert window.ui.start.text() == "Test &starten"  # not before

    window.pages.show("measure")
    ui = window.ui
    assert ui.stop.text() == "STOPP – Spule freigeben"
    assert ui.guidance.instruction.text().startswith("Setzen Sie die Sonde auf die Haut")
    assert ui.form.summary.text() == "Rauschen, Gauß: 0.5–10.5 N, 4 s, Startwert 1"
    assert ui.safety.keys.text() == "Kein Test läuft"
    assert [button.text() for button in ui.rail.buttons.values()] == [
        "Start",
        "Messen",
        "Forschung",
        "Abgleich",
        "Gerät",
    ]


def test_letters_for_alt_are_taken_once_on_a_page(open_window):
    window = open_window(language="de")
    parts = [*window.ui.stack.currentWidget().findChildren(QLabel), window.ui.open, window.ui.report]
    parts += [*window.ui.stack.currentWidget().findChildren(QAbstractButton), window.ui.notice.dismiss]
    texts = [part.text() for part in parts if "&" in part.text().replace("&nbsp;", "")]
    texts += [window.ui.pages.tabText(place) for place in range(window.ui.pages.count())]
    letters = [text[text.index("&") + 1].lower() for text in texts if "&" in text]
    assert len(letters) > 15
    assert sorted(letters) == sorted(set(letters)), " ".join(texts)


def test_an_unknown_language_in_the_settings_is_english(open_window, tmp_path):
    settings = QSettings(str(tmp_path / "other.ini"), QSettings.Format.IniFormat)
    settings.setValue("language", "tlh")
    window = open_window(language="", settings=lambda: settings)
    assert window.ui.start.text() == "&Start test"
    box = window.pages.start.language.choice
    assert isinstance(box, QComboBox)
    assert box.currentData() == "en"
