"""TOML and JSON from anywhere."""

import pytest

from tissueid.untrusted_input import MAX_DEPTH, MAX_KEY_PARTS, json_value, toml_table


@pytest.mark.parametrize("part", ["a", '"a"', "'a'", r'"\""', "' '", '"."', " a\t"])
@pytest.mark.parametrize("line", ["{}=1", "[{}]", "[[{}]]", "x = {{ {} = 1 }}", "x = 1\n  {} = 2"])
def test_long_keys_are_refused_before_they_are_parsed(part, line):
    with pytest.raises(ValueError, match="parts"):
        toml_table(line.format(".".join([part] * 20_000)))


def test_texts_and_numbers_with_points_are_no_keys():
    text = 'x = "a, b. c. 1.2.3 ... and so on.........................."\ny = [' + "0.5, " * 5000 + "]\na.b.c.d = 1"
    assert toml_table(text)["a"] == {"b": {"c": {"d": 1}}}


@pytest.mark.parametrize("text", ["x = " + "[" * 50_000, "x = [" + "{a = [" * 20_000, "=", b"\xff = 1", "a = 1\na = 2"])
def test_what_is_no_toml(text):
    with pytest.raises(ValueError, match=r"."):
        toml_table(text)


@pytest.mark.parametrize("text", ["." * 200_000, ".a" * (MAX_KEY_PARTS - 1) + "(", ('."' * 100_000), (". ") * 100_000])
def test_the_search_for_long_keys_takes_little_time(text):
    with pytest.raises(ValueError, match=r"."):
        toml_table(text)


def test_json_is_storable():
    assert json_value('{"a\\ud800": ["\\udfff", 1.5, null]}') == {"a\ufffd": ["\ufffd", 1.5, None]}
    assert json_value("[" * MAX_DEPTH + "]" * MAX_DEPTH)
    for text in ("[" * (MAX_DEPTH + 1) + "]" * (MAX_DEPTH + 1), "[" * 200_000, "{", b"\xff"):
        with pytest.raises(ValueError, match=r"."):
            json_value(text)
