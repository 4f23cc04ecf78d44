"""Texts of the quality gate that depend on the contact: tissue, a calibration spring or air."""

from __future__ import annotations

from dataclasses import dataclass, replace

from tissueid.language import marked


@dataclass(frozen=True)
class ContactTexts:
    """Templates and advice for one kind of contact.

    Templates: ``no_contact_force`` and ``above`` for loss of contact, ``position_jump`` and ``position_drift`` for a
    shifted reference, ``incoherent`` for motion that the force does not explain, ``deeper`` and ``higher`` for a
    changed surface position, ``settling`` for a mean depth that changes from test to test. Each ``*_advice`` says what
    to do about the finding of that name.
    """

    no_contact_force: str
    above: str
    position_jump: str
    position_drift: str
    incoherent: str
    deeper: str
    higher: str
    settling: str
    contact_advice: str
    reference_advice: str
    knock_advice: str
    orientation_advice: str
    coherence_advice: str
    stroke_advice: str
    unusual_advice: str
    surface_advice: str
    settling_advice: str


TISSUE = ContactTexts(
    no_contact_force=marked(
        "The probe left the skin for {percent:.1f} % of the test: no force pressed it onto the tissue."
    ),
    above=marked("The probe left the skin for {percent:.1f} % of the test: it was above the surface."),
    position_jump=marked(
        "The reference surface moved: the position jumped by {size:.2f} mm at {seconds:.1f} s, more than force and "
        "creep explain."
    ),
    position_drift=marked(
        "The reference surface moved: the position drifted by {size:.2f} mm, more than force and creep explain."
    ),
    incoherent=marked(
        "The force explains only {percent:.0f} % of the motion (coherence): something else moved the probe, or the "
        "tissue is strongly nonlinear."
    ),
    deeper=marked(
        "The surface is {size:.2f} mm deeper than in the earlier tests at this site: the instrument was moved."
    ),
    higher=marked(
        "The surface is {size:.2f} mm higher than in the earlier tests at this site: the instrument was moved."
    ),
    settling=marked(
        "The tissue is still settling: under the same force the mean probe position was {size:.2f} mm {direction} than "
        "in {earlier}."
    ),
    contact_advice=marked(
        "Raise the lowest force, or place the probe deeper and hold the reference surface firmly. If the probe is "
        "meant to lift off, use a nonlinear model."
    ),
    reference_advice=marked(
        "Hold the reference surface firmly against the tissue, rest the arm, and run the test again."
    ),
    knock_advice=marked("If the reference surface may have moved, run the test again."),
    orientation_advice=marked(
        "Hold it still and place it again: the weight of the moving part loads the tissue differently."
    ),
    coherence_advice=marked(
        "Rest the arm, hold the reference surface firmly, and run the test again. Also try a nonlinear model."
    ),
    stroke_advice=marked(
        "Place the instrument so that the surface is near the middle of the stroke, and run the test again."
    ),
    unusual_advice=marked(
        "Check whether the arm or the instrument moved, and repeat the test to see which result is right."
    ),
    surface_advice=marked(
        "Compare only tests with the same placement, or repeat the series without lifting the instrument."
    ),
    settling_advice=marked("Repeat the test until two agree, and leave out the first test at this site."),
)
SPRING = ContactTexts(
    no_contact_force=marked(
        "The probe left the calibration spring for {percent:.1f} % of the test: no force pressed it onto the spring."
    ),
    above=marked("The probe left the calibration spring for {percent:.1f} % of the test: it was above the surface."),
    position_jump=marked(
        "The base of the spring moved: the position jumped by {size:.2f} mm at {seconds:.1f} s, more than force and "
        "creep explain."
    ),
    position_drift=marked(
        "The base of the spring moved: the position drifted by {size:.2f} mm, more than force and creep explain."
    ),
    incoherent=marked(
        "The force explains only {percent:.0f} % of the motion (coherence): something else moved the probe, or the "
        "spring rubs or strikes something."
    ),
    deeper=marked(
        "The spring is {size:.2f} mm deeper than in the earlier tests at this site: the instrument was moved."
    ),
    higher=marked(
        "The spring is {size:.2f} mm higher than in the earlier tests at this site: the instrument was moved."
    ),
    settling=marked(
        "The spring does not return to its position: under the same force the mean probe position was {size:.2f} mm "
        "{direction} than in {earlier}."
    ),
    contact_advice=marked(
        "Fix both ends of the spring, or place it deeper under the probe so that it stays compressed: a spring that is "
        "not fixed loses contact when the probe swings back."
    ),
    reference_advice=marked(
        "Screw the instrument and the base of the spring to the same table, and run the test again."
    ),
    knock_advice=marked("If the spring or the instrument may have moved, run the test again."),
    orientation_advice=marked(
        "Screw it down and repeat the calibration: the weight of the moving part stretches the spring differently."
    ),
    coherence_advice=marked(
        "Check that the spring touches only the probe and its base, screw both down, and run the test again."
    ),
    stroke_advice=marked(
        "Place the spring so that the probe is near the middle of the stroke, and run the test again."
    ),
    unusual_advice=marked(
        "Check whether the spring or the instrument moved, and repeat the test to see which result is right."
    ),
    surface_advice=marked("Compare only tests with the spring in the same place, or repeat the series."),
    settling_advice=marked("Check for friction and a loose base, and repeat the test until two agree."),
)
AIR = replace(
    SPRING,
    deeper=TISSUE.deeper,
    higher=TISSUE.higher,
    settling=marked(
        "The free probe does not return to its position: under the same force the mean probe position was {size:.2f} "
        "mm {direction} than in {earlier}."
    ),
    knock_advice=marked("Screw the instrument down, and run the test again without touching the table."),
    orientation_advice=marked(
        "Screw it down and run the test again: the component of gravity along the stroke changed."
    ),
    unusual_advice=marked(
        "Check whether something touched the probe or the instrument was turned, and repeat the test to see which "
        "result is right."
    ),
    surface_advice=marked("Compare only tests with the same orientation of the instrument, or repeat the series."),
    settling_advice=marked("Check for friction and a dragging cable, and repeat the test until two agree."),
)
"""Texts for a free probe, whose contact is not judged."""
_BY_KIND = {"spring": SPRING, "free_air": AIR}


def texts_for(kind: str) -> ContactTexts:
    """Return the texts for a kind of test: those of tissue unless the kind is a fixture."""
    return _BY_KIND.get(kind, TISSUE)
