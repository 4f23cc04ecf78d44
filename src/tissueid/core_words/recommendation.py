"""What the core says when engines are compared, and of engines and their options."""

from __future__ import annotations

from tissueid.language import marked

ADVICE = (
    marked("None of these descriptions holds; the least bad is {name}: {score}. Check the signals."),
    marked("Of {family}, the only ones that were tried, {name} does best: {score}."),
    marked("A linear model describes this record as well as any that was tried ({name}: {score})."),
    marked("{place} matters in the simplest way: linear dynamics and one curve ({name}: {score})."),
    marked("{place} matters: mass, damping and stiffness each follow it in their own way ({name}: {score})."),
    marked("{place} matters: the response is another one in each range of it ({name}: {score})."),
    marked("{place} and direction matter: the response differs between going in and out ({name}: {score})."),
    marked("The response is nonlinear in a way that only kernels of higher order describe ({name}: {score})."),
    marked("None of the usual families does as well as this engine ({name}: {score})."),
    marked("{percent} % of motion that it had not seen"),
    marked("{percent} % of what was measured that it had not seen"),
    marked("{engine}'s mass, damping and stiffness"),
    marked("the linear models"),
    marked("the static nonlinearities"),
    marked("the models whose parameters follow depth"),
    marked("the depth partitions"),
    marked("the depth and direction partitions"),
    marked("the Volterra kernels"),
    marked("the others"),
    marked("A memory of {value} s is enough; longer ones gain nothing."),
    marked("A memory of {value} s is enough; a still longer one was not tried."),
    marked("{value} partitions are enough; more gain nothing."),
    marked("{value} partitions are enough; more were not tried."),
    marked("Kernels up to order {value} are enough of those that were tried."),
    marked("A value of {value} is enough for the option {option}."),
    marked(
        "{name} accounts for {points} points more than {other} on the same samples, the best of {family}, p {chance}."
    ),
    marked("{name} accounts for {points} points more than {other} on the same samples, the best of {family}."),
    marked("The highest score, {percent} % by {name}, {why}; the simpler one is preferred."),
    marked("The highest score, {percent} % by {name}, {why}; AICc decides."),
    marked("takes away only {percent} % of what is left unexplained"),
    marked("is {points} points away, too little to matter"),
    marked("is within chance ({points} points, p {chance})"),
    marked("is within chance ({points} points)"),
    marked("Mass, damping and stiffness alone do as well as the whole impulse response."),
    marked("AICc on the fitted samples prefers {name} too."),
    marked("Only {seconds} s were held out: differences between descriptions are hardly tested."),
    marked("Differences are known to {points} points only: a longer test would tell more apart."),
    marked(
        "{name} loses {points} points from fitted to unseen samples: it learned the record rather than the "
        "tissue, or the tissue changed."
    ),
    marked(
        "AICc on the fitted samples prefers {name}; it takes errors for independent, which they are not, so "
        "unseen samples decide here."
    ),
    marked(
        "Given the measured {place}, {name} accounts for {percent} %, free-running for {other} %: what it is told "
        "of the output already holds part of the answer."
    ),
    marked("Repeats agree to {percent} %: {points} points are there to be explained and no description explains them."),
    marked("{more} s of unseen motion in place of {seconds} s would tell whether {name} is really better."),
    marked("A test over a larger range of force would show whether {place} matters."),
    marked("Small tests about two or more mean forces would measure stiffness at each {place} directly."),
    marked("Small tests about two or more mean forces would check the parameters at each {place}."),
    marked("A slow ramp in and out would show the loop that a difference between directions leaves."),
    marked("Small tests about two or more mean forces would show whether {place} lies behind it."),
    marked("Small tests about two or more mean forces would show what changes between them."),
    marked("A repeat of the same test would show how much there is to be explained at all."),
    marked("A slow ramp and a hold would show creep and loops, which none of these descriptions holds."),
    marked(
        "The unseen part leaves the range that was fitted (fitted {low} to {high}, unseen {least} to {most}): "
        "part of the error is extrapolation."
    ),
    marked(
        "The unseen part covers little of the range that was fitted (fitted {low} to {high}, unseen {least} to "
        "{most}): nothing tests the rest."
    ),
    marked("the held-out part"),
    marked("every quarter held out in turn"),
    marked("Depth"),
    marked("acceleration_x"),
    marked("Acceleration_x"),
    marked("linear blocks and static nonlinearities"),
    marked("parameters that follow depth"),
    marked("depth partitions"),
    marked("depth and direction partitions"),
    marked("Volterra kernels"),
    marked("other"),
)
"""What a comparison of engines recommends, why, what to doubt, and what to measure."""
ENGINES = (
    marked("Adaptive least-squares finite impulse response (Chen 2010, Eqs. 6.6-6.8)."),
    marked("Block structures: linear, Wiener (LN), Hammerstein (NL), LNL and NLN (Chen 2010, 3.2 and 4.2)."),
    marked("Kernels that depend on depth (Chen 2010, 5.1-5.3)."),
    marked("Kernels that depend on depth and on whether the probe moves in or out (Chen 2010, 5.4, Eqs. 5.3-5.4)."),
    marked("Mass, damping and stiffness as functions of depth (Chen 2010, Eq. 3.33), by the free run's error."),
    marked(
        "A static nonlinearity, then linear dynamics (Chen 2010, 3.2 and 4.2; Bai 1998; Narendra and Gallman 1966)."
    ),
    marked("Least-squares finite impulse response (Chen 2010, 3.1.3), with mass, damping and stiffness."),
    marked(
        "Linear tests about several levels (Chen 2010, 3.4), from one stepped record or from several records joined."
    ),
    marked("Recursive least-squares finite impulse response (Chen 2010, Eqs. 6.1-6.5) with an offset."),
    marked("Welch spectra, coherence and Bode diagram (Chen 2010, 3.1.2), with mass, damping and stiffness."),
    marked(
        "Kernels of order 0 to 3 (Chen 2010, chapter 4): any nonlinearity with a fading memory, for small enough "
        "inputs."
    ),
    marked("Linear dynamics, then a static nonlinearity (Chen 2010, 3.2; Hunter and Korenberg 1986)."),
)
"""What each engine is."""
OPTIONS = (
    marked("How long the impulse response lasts, s"),
    marked("What the input does between samples: a measured force is band-limited, a command is held"),
    marked("Share of the error that one sample corrects; beyond 2 it runs away"),
    marked("Eq. 6.8 as it stands, one over the input's unit squared; replaces the step"),
    marked("Depths of equal count that the responses are sorted into"),
    marked("How long each linear block's response lasts, s"),
    marked("Which blocks, or auto for those that the record speaks for"),
    marked("A polynomial, a spline, or C1 (1 - exp(-C2 x)) with an offset"),
    marked("Degree of the polynomial, or pieces of the spline"),
    marked("How long the kernels last, s"),
    marked("Stretches of depth"),
    marked("Cut depth so that every partition has as many samples, or is as wide"),
    marked("Positions to cut at, rising, m; in place of the number of partitions"),
    marked("Cutoff of the low-pass that the output passes before it chooses a partition; none when not given"),
    marked("Samples between the lags of the kernels; chosen by the input when not given"),
    marked(
        "One offset and the force as measured (common, Eq. 5.1), one offset and the force about its mean, or a "
        "linear model with an offset of its own for each partition; auto takes that for stepped records"
    ),
    marked("Take off the bias that the estimator shows on a tissue simulated with what it found"),
    marked("Stretches of depth; there are twice as many kernels"),
    marked("Cutoff of the low-pass that the output passes before it chooses a partition"),
    marked("The force as measured (Eq. 5.3), or about its mean; all kernels share one offset"),
    marked("How long a start is felt, s; from the slower time constant when not given"),
    marked("Degree of log M(y): 0 constant, 1 exponential; found when not given"),
    marked("Degree of log B(y): 0 constant, 1 exponential; found when not given"),
    marked("Degree of log dF/dy: 0 constant, 1 exponential; found when not given"),
    marked("Largest degree that is found"),
    marked("Degrees beyond those that are found, so that the bands hold what is not seen"),
    marked("Damping that differs between the way in and the way out"),
    marked("Squared speed where the mass changes, of which Eq. 3.33 has none"),
    marked("Where the tissue begins, m: then the stiffness of Eq. 3.33 is told too"),
    marked("Passes of alternating least squares"),
    marked("Refine the best pass by the simulation error over both stages together"),
    marked("Levinson's recursion, or the pseudo-inverse of the whole correlation matrix"),
    marked("With svd: singular values below this share of the largest are dropped"),
    marked("Share of the samples over which both signals fade in and out (C.1.1)"),
    marked("How long a step is felt, s: left out at each level"),
    marked("The levels of the input, in its unit; found from its steps when not given"),
    marked("Weight of a sample in that of the next; 1 forgets nothing"),
    marked("Variance of the response at the start, over that of the noise to the input"),
    marked("Length of a segment, s"),
    marked("Share of a segment that the next one covers again"),
    marked("Window function"),
    marked("How long the simulated impulse response lasts, s"),
    marked("Simulation uses frequencies whose input power is within this of its peak, dB"),
    marked("Highest order of the kernels"),
    marked(
        "Kernels that are smooth and die away as far as the record bears it out, plain least squares, or sums of "
        "Laguerre functions"
    ),
    marked("Fit every sample, or only as many as there are lags in time, as the thesis does"),
    marked("Width of the Gaussian low-pass on the second-order kernel in samples of its transform; thesis: 15"),
    marked("C1 (1 - exp(-C2 z)) with an offset, a polynomial, or a monotone spline"),
    marked("Passes of linear and nonlinear estimation"),
    marked("Stiffness ascribed to the linear stage; 1000 gives the thesis' figures"),
    marked("Load beyond the measured one, such as gravity, N"),
    marked("Where the tissue begins, m; when given, it is held and C3 is estimated"),
)
"""What each option of an engine is."""
