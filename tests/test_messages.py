"""Messages: English as a string, code and values, translation, storage."""

import json
import math
import pickle

import pytest
from coded import templates

from tissueid.errors import UnusableInputError
from tissueid.identification.registry import get_engine
from tissueid.instrument.simulated import SimulatedInstrument
from tissueid.language import set_language
from tissueid.messages import Action, Listing, Message, Quantity, Verbatim, code_of, message_from, sentences, translated
from tissueid.sessions.imports.imported_table import Column, ImportedTable
from tissueid.test_settings import TestSettings


@pytest.fixture(autouse=True)
def english_again():
    yield
    set_language("en")


def lost():
    named = Listing((Message("x.mass", "mass"), Message("x.damping", "damping"), Message("x.k", "stiffness")), " and ")
    return Message(
        "x.lost", "Lost {share} and {count:,d} of {names}.", share=Quantity(-3.42, "%", 1), count=1234, names=named
    )


def test_a_message_is_its_english_text_with_code_and_values():
    message = lost()
    assert message == "Lost −3.4 % and 1,234 of mass, damping and stiffness."
    assert json.dumps({"text": message}) == json.dumps({"text": str(message)})
    assert (message.code, message.values["count"]) == ("x.lost", 1234)
    assert (code_of(message), code_of("plain")) == ("x.lost", "")


def test_values_that_are_messages_are_translated_and_others_are_not():
    set_language("de")
    assert translated(lost()) == "Lost −3.4 % and 1,234 of Masse, Dämpfung und Steifigkeit."
    assert translated(Message("x", "{name}", name="mass")) == "Masse"
    assert translated("") == ""
    assert translated(Message("x", "{a}: {b}", a=1.5, b=Quantity(math.nan, "mm"))) == "1.5: — mm"


def test_data_among_the_values_keep_their_text_although_the_catalogue_has_the_same():
    names = Listing((Verbatim("mass"), Verbatim("noise")))
    message = Message("x", "{column}: {names} ({unit})", column=Verbatim("Force"), names=names, unit="Force")
    stored = json.loads(json.dumps(message.as_dict()))
    set_language("de")
    for copy in (message, message_from(stored), pickle.loads(pickle.dumps(message))):  # noqa: S301 - its own
        assert copy == "Force: mass, noise (Force)"
        assert translated(copy) == "Force: mass, noise (Kraft)"


def refused(error):
    with pytest.raises(UnusableInputError) as caught:
        error()
    return caught.value.message


@pytest.mark.parametrize(
    "error",
    [
        lambda: get_engine("noise"),
        lambda: get_engine("lms").from_options({"mass": 1}),
        lambda: ImportedTable("csv", (Column("Time"),), lambda places, rows: ([], range(0))).column_index("Force"),
        lambda: TestSettings(configuration="Surface"),
        lambda: SimulatedInstrument("Tissue"),
    ],
)
def test_a_name_that_a_user_or_a_file_gave_stays_itself_in_german(error):
    message = refused(error)
    set_language("de")
    data = [text for text in values_of(message) if type(text) is Verbatim]
    assert data
    assert all(text in translated(message) for text in data)


def values_of(value):
    """Return the texts among the values of a message, also those in its lists."""
    items = value.values.values() if isinstance(value, Message) else value.items if isinstance(value, Listing) else ()
    return [value, *(text for item in items for text in values_of(item))]


def test_an_action_is_a_command_in_the_shell_and_a_place_in_the_window():
    action = Action("calibrate.static", "tissueid calibrate static", "Instrument")
    message = Message("x", "Calibrate before the next test: {how}.", how=action)
    assert message == "Calibrate before the next test: 'tissueid calibrate static'."
    assert translated(message) == "Calibrate before the next test: Instrument."
    set_language("de")
    assert translated(message_from(message.as_dict())) == "Calibrate before the next test: Gerät."


def test_a_message_survives_another_process_and_a_file():
    for message in (lost(), sentences(lost(), "", Message("x.end", "The end"))):
        copy = pickle.loads(pickle.dumps(message))  # noqa: S301 - its own
        assert (copy, copy.code, copy.values) == (message, message.code, message.values)
        stored = json.loads(json.dumps(message.as_dict()))
        again = message_from(stored)
        assert (again, code_of(again), again.as_dict()) == (message, message.code, message.as_dict())


def test_a_template_reaches_no_attribute_and_no_large_width():
    for template in (
        "{a.__class__}",
        "{a[0]}",
        "{a!r}",
        "{a:>999999999}",
        "{a:.999999999f}",
        "{missing}",
        "{}",
        "{{a}}",
    ):
        text = Message("x", template, a=2.0)
        assert len(text) <= len(template) + 2
        assert "class" not in text.replace("__class__}", "")


@pytest.mark.parametrize(
    "stored",
    [
        None,
        3,
        "text",
        [],
        {},
        {"code": "x", "template": "{a}"},
        {"code": "x", "template": 3, "values": {}},
        {"code": "x", "template": "y", "values": []},
        {"code": "x", "template": "{a}", "values": {"a": {"value": 1, "unit": "mm", "decimals": 10**9}}},
        {"code": "x", "template": "{a}", "values": {"a": {"value": [], "unit": "mm", "decimals": 1}}},
        {"code": "x", "template": "{a}", "values": {"a": [1]}},
        {"code": "x", "template": "y" * 30_000, "values": {}},
        {"code": "x", "template": "{a}", "values": {str(number): 1 for number in range(1000)}},
    ],
)
def test_what_no_message_stored_is_the_plain_text(stored):
    assert message_from(stored, "as it was") == "as it was"


def test_nesting_is_limited():
    stored = {"code": "x", "template": "y", "values": {}}
    for _depth in range(50):
        stored = {"code": "x", "template": "{a}", "values": {"a": stored}}
    assert message_from(stored, "too deep") == "too deep"


def test_a_small_file_cannot_make_a_large_text():
    stored = {"code": "x", "template": "y" * 1000, "values": {}}
    for _depth in range(5):
        stored = {"code": "x", "template": "{a}" * 90, "values": {"a": stored}}
    assert message_from(stored, "too large") == "too large"


def test_a_code_has_one_meaning():
    """The same code in two modules has the same template; variants of a text share a code within one module."""
    found = templates()
    assert len(found) > 1000
    shared = {code: places for code, places in found.items() if len(places) > 1}
    assert {code: places for code, places in shared.items() if len(set().union(*places.values())) > 1} == {}
