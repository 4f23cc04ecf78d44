"""Names of quantities, settings and values that reports look up as they come, marked for the catalogue."""

from tissueid.language import marked

PARAMETERS = (
    marked("Natural frequency"),
    marked("Damping ratio"),
    marked("Predicted linear output"),
    marked("Measured position"),
    marked("Depth below the surface"),
    marked("Residual"),
    marked("Predicted"),
    marked("Measured"),
    marked("Scaled mass"),
    marked("Scaled damping"),
    marked("Offset"),
    marked("Nonlinear constant C₁"),
    marked("Nonlinear constant C₂"),
    marked("Load beyond the measured one, C₃"),
)
"""Labels that :func:`tissueid.wording.named_unit` makes of names of parameters and of what axes show."""
SETTINGS = (
    marked("Type"),
    marked("Cutoff"),
    marked("Coil resistance"),
    marked("Coil inductance"),
    marked("Bearing damping"),
    marked("Amplifier gain"),
    marked("Amplifier limit"),
    marked("Stroke"),
    marked("Calibration relative uncertainty"),
    marked("Force constant"),
    marked("Moving mass"),
    marked("Serial number"),
    marked("Model"),
    marked("Method"),
    marked("Memory"),
    marked("Tolerance"),
    marked("Taper"),
    marked("Hold"),
    marked("Condition number"),
    marked("VAF of the second-order model"),
    marked("Window"),
    marked("Overlap"),
    marked("Range"),
    marked("Averages"),
    marked("Mean coherence"),
    marked("Nonlinearity"),
    marked("Degree"),
    marked("Iterations"),
    marked("Refine"),
    marked("Scaling"),
    marked("VAF of the linear stage alone"),
    marked("Chosen iteration"),
)
"""Labels of settings of a test, of an instrument, of stimuli and of engines."""
VALUES = (
    marked("stochastic"),
    marked("guided"),
    marked("electrical check"),
    marked("band-limited"),
    marked("exponential"),
    marked("passed"),
    marked("yes"),
    marked("no"),
    marked("not set"),
    marked("years"),
)
"""Words that stand as values of settings."""
STAGES = (
    marked("amplifier"),
    marked("coil"),
    marked("moving part (mechanics)"),
    marked("tissue"),
    marked("sensors"),
    marked("surroundings"),
)
"""Names of the stages of the chain within a sentence."""
