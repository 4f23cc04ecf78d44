"""Translations: every text of the program has one in every catalogue, and the pages show it."""

import functools
import string
from io import BytesIO
from pathlib import Path
from symtable import symtable

import pytest
from app.benches import WAIT_MS
from PySide6.QtCore import QLocale, QSettings
from PySide6.QtWidgets import QAbstractButton, QComboBox, QLabel

from tissueid import language
from tissueid.app.panels import FOLDER
from tissueid.app.views.start.view import WHAT_ROLES_DO
from tissueid.app.window_state import chosen
from tissueid.formatting import fixed, number, plus_minus
from tissueid.language import _, plural, set_language
from tissueid.messages import Message, Verbatim, translated
from tissueid.records import Estimate
from tools import translations

SOURCE = Path(language.__file__).parents[1]


def fields(text):
    parts = string.Formatter().parse(text)
    return sorted((name, spec, kind or "") for _text, name, spec, kind in parts if name is not None)


def entries():
    """Every text of every catalogue with its translation, plural forms one by one."""
    for path in translations.paths():
        for entry in translations.read(path):
            if isinstance(entry.id, tuple):
                yield from zip((entry.id[0], *entry.id[1:] * (len(entry.string) - 1)), entry.string, strict=True)
            elif entry.id:
                yield entry.id, entry.string


@pytest.fixture(scope="module", autouse=True)
def _extracted_once():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(translations, "extracted", functools.cache(translations.extracted))
        yield


@pytest.fixture(autouse=True)
def english_again():
    yield
    set_language("en")


def test_every_text_is_translated_and_no_entry_is_unused():
    assert len(translations.extracted()) > 250
    assert translations.problems() == []


def test_an_update_changes_nothing_but_texts(tmp_path):
    for path in translations.paths():
        found = translations.updated(path, translations.extracted())
        assert translations.text_of(found) == path.read_bytes()


def test_what_is_missing_unused_or_untranslated_is_found(tmp_path, monkeypatch):
    monkeypatch.setattr(translations, "FOLDER", tmp_path)
    path = tmp_path / "fr" / translations.CATALOGUE
    path.parent.mkdir(parents=True)
    head = 'msgid ""\nmsgstr ""\n"Language: fr\\n"\n'
    path.write_text(f'{head}\nmsgid "gone"\nmsgstr "parti"\n\nmsgid "Stiffness"\nmsgstr ""\n', encoding="utf-8")
    found = translations.problems()
    assert "fr: not used by the program: 'gone'" in found
    assert "fr: not translated: 'Stiffness'" in found
    assert "fr: not in the catalogue: 'Damping'" in found


def test_texts_inside_f_strings_plurals_and_messages_are_extracted():
    code = b"""f"{_('one')}"; plural("two", "twos", n); Message("code", "three {a}", a=marked("four"))"""
    found = list(translations.from_python(BytesIO(code), translations.KEYWORDS, (), {}))
    assert {(name, texts if isinstance(texts, str) else texts[:2]) for _line, name, texts, _ in found} == {
        ("_", "one"),
        ("plural", ("two", "twos")),
        ("Message", ("code", "three {a}")),
        ("marked", "four"),
    }


def test_placeholders_agree_and_are_named():
    for english, said in entries():
        assert fields(english) == fields(said), english
        assert all(name.isidentifier() for name, _spec, _kind in fields(english)), english


def test_a_mnemonic_stays_a_mnemonic_and_spaces_at_the_ends_stay():
    for english, said in entries():
        assert english.count("&") == said.count("&"), english
        assert english[0].isspace() == said[0].isspace(), english


def test_nothing_called_underscore_hides_the_lookup():
    """A loop or a parameter called ``_`` would shadow it in the whole function."""
    for path in sorted(SOURCE.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        if "_(" in text:
            hidden = [scope for scope in scopes(symtable(text, path.name, "exec")) if hides_the_lookup(scope)]
            assert not hidden, f"{path.name}: {hidden}"


def scopes(table):
    yield table
    for inner in table.get_children():
        yield from scopes(inner)


def hides_the_lookup(scope):
    if scope.get_type() != "function" or "_" not in scope.get_identifiers():
        return False
    symbol = scope.lookup("_")
    return symbol.is_local() and symbol.is_referenced()


def test_a_lookup_falls_back_and_knows_one_from_many():
    assert _("Stiffness") == "Stiffness"
    set_language("de")
    assert _("Stiffness") == "Steifigkeit"
    assert _("no such text") == "no such text"
    one, many = (plural("{count} session", "{count} sessions", count).format(count=count) for count in (1, 3))
    assert (one, many) == ("1 Sitzung", "3 Sitzungen")
    set_language("en")
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
    set_language("de")
    set_language("tlh")
    assert language.current_language() == "en"
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
    assert page.cards["technician"].accessibleName().startswith("Technik: Das Gerät warten")
    assert not shown & set(WHAT_ROLES_DO.values())
    heads = [page.recent.horizontalHeaderItem(column).text() for column in range(4)]
    assert heads == ["Datum", "Messort", "Person", "Qualität"]
    assert window.panels.help.reader.toPlainText().startswith("Start\n")
    assert "Medizinprodukt" in window.panels.help.reader.toPlainText()

    chooser = page.language.choice
    assert [chooser.itemText(place) for place in range(chooser.count())] == ["English", "Deutsch"]
    assert chooser.currentData() == "de"
    chooser.setCurrentIndex(0)
    assert window.settings.value("language") == "en"
    assert window.ui.notice.offer.isVisible()
    assert window.ui.start.text() == "Test &starten"  # not before

    window.pages.show("measure")
    ui = window.ui
    assert ui.stop.text() == "STOPP – Spule freigeben"
    assert ui.guidance.instruction.text().startswith("Setzen Sie die Sonde auf die Haut")
    assert ui.form.summary.text() == "4 s, bis 10,5 N"
    ui.form.fold.setChecked(True)
    assert ui.form.summary.text() == "Rauschen, Gauß: 0,5–10,5 N, 4 s, Startwert 1"
    assert ui.safety.keys.text() == "Kein Test läuft"
    assert [button.text() for button in ui.rail.buttons.values()] == [
        "Start",
        "Messen",
        "Forschung",
        "Abgleich",
        "Gerät",
        "Studien",
    ]


def test_a_new_language_is_taken_on_by_a_new_window(qtbot, open_window):
    window = open_window()
    palette = {action.title: action for action in window.declare_actions()}
    palette["Language: Deutsch"].run()
    assert window.settings.value("language") == "de"
    assert not window.restarts
    window.ui.notice.offer.click()
    qtbot.waitUntil(lambda: not window.isVisible(), timeout=WAIT_MS)
    assert window.restarts
    assert open_window(language="").ui.start.text() == "Test &starten"


def test_numbers_have_the_decimal_mark_of_the_language():
    share = Message("a.share", "{percent:.1f} % of {what}", percent=1.25, what=Verbatim("v1.5"))
    shown = [fixed(-1.25, 2), plus_minus(Estimate(93.4, 3.2)), number(2.5e-7), translated(share)]
    assert shown == ["−1.25", "93.4 ± 3.2", "2.5 × 10⁻⁷", "1.2 % of v1.5"]
    set_language("de")
    shown = [fixed(-1.25, 2), plus_minus(Estimate(93.4, 3.2)), number(2.5e-7), translated(share)]
    assert shown == ["−1,25", "93,4 ± 3,2", "2,5 × 10⁻⁷", "1,2 % of v1.5"]
    assert str(share) == "1.2 % of v1.5"
    assert _("{low:g} to {high:g}{unit}").format(low=0.5, high=2.0, unit=" v1.5") == "0,5 bis 2 v1.5"


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
