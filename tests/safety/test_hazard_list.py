"""The hazard list of docs/safety.md: every row is held by tests, and every test that it names exists."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "safety.md").read_text(encoding="utf-8")
COLUMNS = ["no.", "hazard", "cause", "firmware", "host", "remaining risk", "tests"]


def hazard_rows(page):
    """The cells of each row of the table under ``## Hazards``, its head left out."""
    section = page.split("\n## Hazards\n", 1)[1].split("\n## ", 1)[0]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in section.splitlines() if line[:1] == "|"]
    assert rows[0] == COLUMNS
    return rows[2:]


def named_tests(cell):
    return re.findall(r"`(tests/[^`]*)`", cell)


@cache
def functions_of(path):
    tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
    return {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}


def trouble_with(row):
    """What is wrong with a row, in words; nothing when all is well."""
    if len(row) != len(COLUMNS) or not all(row):
        return "has an empty cell, or one too many"
    tests = named_tests(row[-1])
    if not tests:
        return "names no test"
    for test in tests:
        path, _, name = test.partition("::")
        if not name.startswith("test_"):
            return f"{test} is no test"
        if not (ROOT / path).is_file() or name not in functions_of(path):
            return f"{test} does not exist"
    return ""


@pytest.mark.parametrize("row", hazard_rows(PAGE), ids=lambda row: row[1])
def test_a_hazard_is_held_by_tests_that_exist(row):
    assert trouble_with(row) == ""


def test_the_rows_are_numbered_and_there_are_many():
    rows = hazard_rows(PAGE)
    assert [row[0] for row in rows] == [str(number + 1) for number in range(len(rows))]
    assert len(rows) >= 25


@pytest.mark.parametrize(
    ("tests", "words"),
    [
        ("none yet", "names no test"),
        ("`tests/safety/test_motion.py`", "is no test"),
        ("`tests/safety/test_motion.py::test_that_nobody_wrote`", "does not exist"),
        ("`tests/safety/test_nothing.py::test_that_nobody_wrote`", "does not exist"),
        ("", "empty cell"),
    ],
)
def test_a_row_that_holds_nothing_is_found(tests, words):
    assert words in trouble_with(["1", "a", "b", "c", "d", "e", tests])


def test_nothing_is_promised():
    assert "research use only" in PAGE
    assert PAGE.count("<!-- matrix -->") == PAGE.count("<!-- end -->") == 1


def test_the_figures_of_the_page_are_those_of_the_code():
    from firmware_sim import limits, plausibility, thermal
    from tissueid.instrument import limits as host_limits
    from tissueid.instrument import sample_monitor as host_plausibility
    from tissueid.instrument import thermal as host_thermal

    protocol = (ROOT / "docs" / "protocol.md").read_text(encoding="utf-8")
    for model in (thermal, host_thermal):
        assert f"{model.HEAT_CAPACITY_J_PER_K:g} J/K and {model.THERMAL_RESISTANCE_K_PER_W:g} K/W" in PAGE
    for judge in (plausibility, host_plausibility):
        assert f"alarm at {judge.STILL_M * 1e6:g} um" in PAGE
        assert f"alarm at {judge.OPEN_SHARE:g}" in PAGE
        assert f"alarm at {judge.JUMP_M_PER_S:g} m/s" in PAGE
        assert f"while the force changes by {judge.STILL_SWING_N:g} N" in " ".join(protocol.split())
    assert limits.GENTLE_FORCE_N == host_limits.GENTLE_FORCE_N == 2.0
    assert limits.BEYOND_STROKE_M == host_limits.BEYOND_STROKE_M == 1e-3
    assert limits.FORCE_MARGIN == host_limits.FORCE_MARGIN == 1.05
