"""What stands under the probe, and so in which words the quality gate says what was seen and what to do about it."""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Setting:
    """The words of the gate for one thing under the probe.

    ``left`` and ``lies`` name its surface, ``pressed`` and ``unsettled`` the thing itself, ``shifted`` what may have
    moved. What begins with ``to_`` is the advice: against losing contact, a moved reference, a knock, a turned
    instrument, motion that the force does not explain, the end of the stroke, an unusual test, a surface that lies
    elsewhere.
    """

    left: str
    pressed: str
    shifted: str
    odd: str
    lies: str
    unsettled: str
    to_press: str
    to_hold: str
    to_bear_a_knock: str
    to_turn_back: str
    to_explain: str
    to_centre: str
    to_look: str
    to_place_alike: str
    to_settle: str


TISSUE = Setting(
    left="skin",
    pressed="tissue",
    shifted="reference surface",
    odd="the tissue is strongly nonlinear",
    lies="surface",
    unsettled="The tissue is still settling",
    to_press="Raise the lowest force, or place the probe deeper and hold the reference surface firmly; where lifting "
    "off was meant, use a nonlinear description.",
    to_hold="Hold the reference surface firmly against the tissue, rest the arm, and run the test again.",
    to_bear_a_knock="If the reference surface may have moved, run the test again.",
    to_turn_back="Hold it still and place it again: the weight of the moving part loads the tissue differently.",
    to_explain="Rest the arm, hold the reference surface firmly, and run the test again; try a nonlinear description "
    "too.",
    to_centre="Place the instrument so that the surface lies near the middle of the stroke, and run the test again.",
    to_look="Look whether the arm or the instrument moved, and run the test once more to see which is right.",
    to_place_alike="Compare only tests that were placed alike, or repeat the series without lifting the instrument.",
    to_settle="Run the test again until two agree, and leave the first of this site out.",
)
SPRING = Setting(
    left="calibration spring",
    pressed="spring",
    shifted="base of the spring",
    odd="the spring rubs or strikes something",
    lies="spring",
    unsettled="The spring does not come back to where it was",
    to_press="Fix the spring to the probe at both its ends, or set it deeper under the probe so that it stays pressed; "
    "a force that only presses loses it where it swings back.",
    to_hold="Screw the instrument and the base of the spring down to one table, and run the test again.",
    to_bear_a_knock="If the spring or the instrument may have moved, run the test again.",
    to_turn_back="Screw it down and calibrate anew: the weight of the moving part stretches the spring differently.",
    to_explain="Look that the spring touches nothing but the probe and its base, screw both down, and run the test "
    "again.",
    to_centre="Set the spring so that the probe stands near the middle of the stroke, and run the test again.",
    to_look="Look whether the spring or the instrument moved, and run the test once more to see which is right.",
    to_place_alike="Compare only tests with the spring in the same place, or repeat the series.",
    to_settle="Look for friction and for a loose base, and run the test again until two agree.",
)
AIR = replace(
    SPRING,
    lies="surface",
    unsettled="The free probe does not come back to where it was",
    to_bear_a_knock="Screw the instrument down, and run the test again with nobody touching the table.",
    to_turn_back="Screw it down and run the test again: gravity pulls the free moving part by another share.",
    to_look="Look whether something touched the probe or the instrument was turned, and run the test once more to see "
    "which is right.",
    to_place_alike="Compare only tests with the instrument held alike, or repeat the series.",
    to_settle="Look for friction and for a cable that drags, and run the test again until two agree.",
)
"""Of a free probe nothing is said about contact."""
_BY_KIND = {"spring": SPRING, "free_air": AIR}


def setting_of(kind: str) -> Setting:
    """The words for a kind of test; what is no fixture is tissue."""
    return _BY_KIND.get(kind, TISSUE)
