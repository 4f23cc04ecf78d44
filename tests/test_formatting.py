from __future__ import annotations

import pytest

from tissueid.formatting import (
    clean,
    fixed,
    grouped,
    label_and_unit,
    label_and_value,
    number,
    plain_text,
    plus_minus,
)
from tissueid.messages import MISSING
from tissueid.records import Estimate


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (4738.2, "4738"),
        (-0.05213, "−0.05213"),
        (1e-12, "1 × 10⁻¹²"),
        (1.837e-5, "1.837 × 10⁻⁵"),
        (123456.0, "123500"),
        (9.99999, "10"),
        (99999999.0, "1 × 10⁸"),
        (float("nan"), MISSING),
        (float("-inf"), MISSING),
        (None, MISSING),
    ],
)
def test_number(value: float | None, text: str) -> None:
    assert number(value) == text


@pytest.mark.parametrize(
    ("estimate", "scale", "text"),
    [
        (Estimate(0.08702, 0.0031), 1e3, "87.0 ± 3.1"),
        (Estimate(4738.0, 160.0), 1.0, "4740 ± 160"),
        (Estimate(4738.0, 1600.0), 1.0, "4700 ± 1600"),
        (Estimate(1.837e-5, 1.7e-7), 1.0, "(1.837 ± 0.017) × 10⁻⁵"),
        (Estimate(-3.306, 2.3), 1.0, "−3.3 ± 2.3"),
        (Estimate(0.0, 0.5), 1.0, "0.00 ± 0.50"),
        (Estimate(21.0), 1.0, "21"),
        (Estimate(2959.73969462, 1e-13), 1.0, "2960"),
        (Estimate(21.0, float("nan")), 1.0, "21"),
        (Estimate(float("nan"), 1.0), 1.0, MISSING),
        (Estimate(1.0, float("inf")), 1.0, "1"),
    ],
)
def test_plus_minus(estimate: Estimate, scale: float, text: str) -> None:
    assert plus_minus(estimate, scale) == text


def test_names_carry_their_units() -> None:
    assert label_and_unit("damping_n_s_per_m") == ("Damping", "N s/m")
    assert label_and_unit("damping_ratio") == ("Damping ratio", "")
    assert label_and_value("stroke_m", 0.032) == ("Stroke", "32 mm")
    assert label_and_value("moving_mass_kg", 0.06) == ("Moving mass", "60 g")
    assert label_and_value("memory", 0.125) == ("Memory", "0.125 s")
    assert label_and_value("natural_frequency_rad_per_s", 226.0)[1].startswith("35.96")
    assert label_and_value("current_offset_a", float("nan")) == ("Current offset", MISSING)
    assert label_and_value("refine", True) == ("Refine", "yes")
    assert label_and_value("surface_position_m", None) == ("Surface of the tissue", "not set")
    assert label_and_value("", 3)[1] == "3"


def test_plain_text_of_anything() -> None:
    assert plain_text(None) == "not set"
    assert plain_text("") == MISSING
    assert plain_text([1, 2.5, "a"]) == "1, 2.5, a"
    assert plain_text(list(range(50))).endswith("… (50 in all)")
    assert plain_text("x" * 5000).endswith(" …")
    assert len(plain_text(10**400)) < 1100
    nested: dict = {}
    for _ in range(900):
        nested = {"a": nested}
    assert "…" in plain_text(nested)


def test_clean_replaces_what_a_page_must_not_hold() -> None:
    assert clean("plain é µ") == "plain é µ"
    assert clean("a\x00b\nc\u202ed\ud800") == "a\ufffdb c\ufffdd\ufffd"


def test_fixed_and_grouped() -> None:
    assert fixed(-0.04, 1) == "0.0"
    assert fixed(-0.06, 1) == "−0.1"
    assert fixed(None, 1) == MISSING
    assert grouped(-95824.2) == "−95\u202f824"
    assert grouped(float("-inf")) == MISSING


def test_a_digest_is_one_piece() -> None:
    assert label_and_value("audit_head", 8 * "0123abcd") == ("Audit head", "0123abcd0123abcd…")
    assert plain_text("0123abcd") == "0123abcd"
