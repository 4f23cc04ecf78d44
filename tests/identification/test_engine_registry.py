"""Registry of engines: built-in ones, plug-ins, and plug-ins that fail to load."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from typing import ClassVar

import pytest
from coded import coded
from plugged import Plugin, plugged_in

from tissueid.errors import UnusableInputError
from tissueid.identification import Engine, Model, engine_names, get_engine, registry
from tissueid.records import Record


class Foreign(Engine):
    """An engine of another package."""

    name: ClassVar[str] = "foreign"

    def fit(self, record: Record, fit_part: slice | None = None) -> Model:
        raise UnusableInputError("not today")


@pytest.fixture
def plugins() -> Iterator[list[Plugin]]:
    installed: list[Plugin] = []
    with plugged_in("tissueid.engines", installed, registry.engines):
        yield installed


def test_built_in_engines_are_found():
    assert {"lms", "spectral", "wiener"} <= set(engine_names())
    for name in engine_names():
        assert get_engine(name).name == name


def test_an_unknown_name_lists_those_there_are():
    with pytest.raises(UnusableInputError, check=coded("registry.unknown_name", name="lsm")) as error:
        get_engine("lsm")
    assert {"lms", "wiener"} <= set(error.value.message.values["names"].items)


def test_third_parties_add_engines_by_entry_point(plugins: list[Plugin]):
    plugins.append(Plugin("foreign", Foreign))
    assert get_engine("foreign") is Foreign


def test_a_broken_plugin_gives_a_warning_and_affects_no_other(plugins: list[Plugin]):
    plugins += [
        Plugin("broken", ImportError("no module named 'gone'"), "broken:Engine"),
        Plugin("foreign", Foreign),
    ]
    with pytest.warns(UserWarning, match=r"'broken' \(broken:Engine\) was left out: no module named 'gone'"):
        names = engine_names()
    assert {"foreign", "lms"} <= set(names)


@pytest.mark.parametrize(
    ("loaded", "why"),
    [
        (SystemExit(3), "SystemExit"),
        (RuntimeError("\x1b[31mred\nsecond line"), r"\?\[31mred second line"),
        (5, "neither a class of the kind Engine nor a module"),
        (type("Nameless", (Foreign,), {"name": ""}), "has the name ''"),
        (type("Escape", (Foreign,), {"name": "\x1b[31m"}), "has the name"),
        (type("Abstract", (Engine,), {"name": "abstract"}), "lacks fit"),
    ],
)
def test_a_plugin_of_any_other_content_is_left_out(plugins: list[Plugin], loaded: object, why: str):
    plugins += [Plugin("odd", loaded, "odd:Odd"), Plugin("foreign", Foreign)]
    with pytest.warns(UserWarning, match=rf"'odd' \(odd:Odd\) was left out: .*{why}"):
        assert {"foreign", "lms"} <= set(engine_names())


def test_a_plugin_may_not_take_a_name_that_is_held(plugins: list[Plugin]):
    impostor = type("Impostor", (Foreign,), {"name": "lms", "__module__": "elsewhere"})
    plugins.append(Plugin("impostor", impostor, "elsewhere:Impostor"))
    with pytest.warns(UserWarning, match="of the kind engine are called 'lms'"):
        assert get_engine("lms") is not impostor


def test_loading_is_silent_when_all_is_well(plugins: list[Plugin]):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert "lms" in engine_names()
