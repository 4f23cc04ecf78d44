"""What each figure of the reproduction cannot share with the thesis, whatever a run gives: no result is stated here."""

from __future__ import annotations

from collections.abc import Mapping

from tissueid.language import marked

REMARKS: Mapping[str, str] = {
    "2.12": marked(
        "The simulated spring is linear and has no friction. The simulated coil leaves its field by an error "
        "function, because the thesis prints no values."
    ),
    "3.1": marked("The tails of the force are cut at two standard deviations to stay below 12 N."),
    "3.2": marked(
        "The simulated converter has 16 bits and 2 mV of noise; the thesis does not print those of its figure."
    ),
    "3.4": marked("The force is low-passed at 200 Hz, so that its autocorrelation is not a single peak."),
    "3.5": marked(
        "Damping of the simulated skin differs by direction, and a linear fit finds one value. The tissue was "
        "chosen for mass, stiffness and VAF."
    ),
    "3.8": marked("This tissue was made after the stiffness of 3.1.3, which is higher than that of Table 3.1."),
    "3.12": marked("The thesis prints no widths."),
    "3.13": marked("Nothing but its force moves the simulated probe."),
    "Table 3.1": marked(
        "The simulated tissues were made after VAF, scaled mass, scaled damping and C1 of the thesis. The scatter"
        " is that of the input and of the sensors: the probe is not repositioned."
    ),
    "4.2": marked(
        "The solution step of the thesis' algorithm is a loop in Python. Times depend on the computer and its load."
    ),
    "4.3": marked("An exponential is more than a square, so that a second-order series describes it in part."),
    "4.5": marked("The thesis does not print the noise of its simulation."),
    "4.6": marked("AIC depends on the length and the scatter of the record, which the thesis does not print."),
    "4.8": marked("The lags leave three rows for each parameter: 41 at every 3rd sample, 31 at every 5th."),
    "4.12": marked("The thesis prints no peaks."),
    "4.15": marked("Regularisation is not in the thesis."),
    "5.1": marked("The bias of the partitions is corrected here."),
    "5.2": marked("Fewer samples than parameters are refused here."),
    "5.5": marked("The simulated tissue has less noise than skin."),
    "5.6": marked("The simulated systems have less noise than those of the thesis."),
    "5.9": marked(
        "The thesis explains its difference of stiffness by cross terms of skin, of which the simulated tissue has few."
    ),
    "5.10": marked(
        "The figure needs skin that relaxes within 0.03 s. The input ends at 50 Hz, near the natural frequency, "
        "so that mass is uncertain. The thesis prints no ratio."
    ),
    "5.11": marked(
        "The simulated skin has only its damping by direction, and the engine assumes one mass for both "
        "directions. The test goes into the skin only, from 0 to 11 N."
    ),
    "6.1": marked("The search starts from a surrogate with the right spectrum and chooses its partners."),
    "6.3": marked(
        "The score of ALS is that of responses that followed the measured position, not of a free run. As in the "
        "thesis, each of them counts as a set of parameters in its AIC."
    ),
    "6.4": marked(
        "A response of 250 lags adapts more slowly than the position moves; partitions (Fig. 5.4) separate the "
        "depths better."
    ),
    "6.7": marked("Forces here stay below 10 N, so that the ranges of depth are smaller."),
    "6.12": marked("The estimates of the loop steer the stimulus during the test; those of dpn are of the whole test."),
    "Table 8.1": marked(
        "The ranges of the thesis hold for people. Times are of this run; those of the thesis are of a computer "
        "of 2010."
    ),
}
"""Remarks by number of figure. Agreement is read from the rows, and doubts about a fit from its warnings."""

__all__ = ["REMARKS"]
