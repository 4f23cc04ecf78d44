"""What agrees with the thesis, what differs, and why: one remark for each figure."""

from __future__ import annotations

from collections.abc import Mapping

from tissueid.language import marked

REMARKS: Mapping[str, str] = {
    "2.12": marked(
        "The ranges agree, and the linear region has the length that the thesis gives. VAF is higher, because the "
        "simulated spring is linear and has no friction. Stiffness rises towards the ends as in the figure: the "
        "simulated coil leaves its field by an error function, chosen because the thesis prints no values."
    ),
    "3.1": marked(
        "As in the figure, a Gaussian force gives a position that is not Gaussian: skewed, because skin stiffens "
        "with depth. The tails of the force are cut at two standard deviations to stay below 12 N."
    ),
    "3.2": marked(
        "Coherence agrees below 100 Hz and from 100 to 200 Hz. The spectrum of the voltage falls by fewer decades: "
        "the simulated converter has 16 bits and 2 mV of noise, and the thesis does not print those of its figure."
    ),
    "3.3": marked(
        "Slope and phase are those of a second-order system, as in the figure. Natural frequency and damping ratio "
        "are lower, because damping by the fit is about half (see Fig. 3.5)."
    ),
    "3.4": marked(
        "The shape agrees: one at lag zero, then decaying. The force is low-passed at 200 Hz, so that its "
        "autocorrelation crosses zero at 2.5 ms and is not a single peak."
    ),
    "3.5": marked(
        "VAF, mass and stiffness agree. Damping is about half: damping of the simulated skin differs by direction, "
        "and a linear fit finds the mean. The tissue was chosen for mass, stiffness and VAF."
    ),
    "3.8": marked(
        "The curve rises and stiffens as in the figure, with loops at low force. C2 agrees; C1, and with it the "
        "travel, is half that of Table 3.1, because this tissue was made after 3.1.3, whose stiffness is higher. The "
        "tissues of Table 3.1 agree with its values."
    ),
    "3.9": marked(
        "The course agrees: most of the change in the first pass, then a slight fall of the VAF of the cascade. This "
        "record settles in fewer passes."
    ),
    "3.10": marked("Both scores agree within half a point, and so does the gain by the static nonlinearity."),
    "3.11": marked(
        "Agrees: only the DPN system has loops, and only at the full range. What remains of the others is sensor "
        "noise relative to the travel."
    ),
    "3.12": marked(
        "The order agrees: the smaller the range, the narrower the loops. Widths cannot be compared, because the "
        "thesis prints none."
    ),
    "3.13": marked(
        "Agrees: every small test is fitted to more than 90 %, the posterior site is stiffer at every depth, and "
        "mass stays the same. VAF is higher, because nothing but its force moves the simulated probe."
    ),
    "Table 3.1": marked(
        "VAF, scaled mass, scaled damping and C1 are close to the thesis, after which these tissues were made. C2 of "
        "two sites is 1.5 times too large: damping that differs by direction bends the curve as well. The scatter is "
        "that of the input and of the sensors alone; it does not contain a new placing of the probe."
    ),
    "4.2": marked(
        "Both algorithms give the same coefficients within 3e-15. Times are of this run. The thesis' algorithm grows "
        "about with M², as in the figure; its solution step is a loop in Python, so that it is less than ten times "
        "faster than the orthonormalisation. The Gram matrix used here makes the whole fit tens of times faster."
    ),
    "4.3": marked(
        "Agrees: the first kernel has the shape of the linear stage; the second one is its negative product for a "
        "Wiener system and lies on the diagonal for a Hammerstein system. An exponential is more than a square, so "
        "that the cosine of the second kernel and VAF stay below one."
    ),
    "4.4": marked("Agrees exactly: a square has no linear part, and a second-order kernel describes it without error."),
    "4.5": marked(
        "The shape agrees: a negative centre that is narrower than that of a Wiener system, with two positive side "
        "lobes. VAF is two points higher, and the noise of the thesis' simulation is not known."
    ),
    "4.6": marked(
        "VAF and number of parameters agree, and the second kernel is noise, as in the figure. The AIC differs by "
        "more than its unit explains: the thesis does not state the length and the scatter of this record."
    ),
    "4.7": marked("Agrees; the residual is largest at the deepest positions, as in the figure."),
    "4.8": marked(
        "The value at every 5th sample agrees. At every 3rd sample it is 1.9 points higher, and the rise does not "
        "appear: with as many lags as leave three rows for each parameter (41 and 31), the share of noise that is "
        "fitted is the same at both rates. A Gaussian input, other sites and relaxing skin give the same."
    ),
    "4.9": marked(
        "The pattern agrees: noise at high spatial frequencies, which the filter removes. The loss of VAF is smaller "
        "(1.3 points, not 4.3), and depends on the spacing of the lags and on the tissue."
    ),
    "4.10": marked(
        "Agrees: before the filter the diagonal of the second kernel is noise many times the first kernel; after it "
        "the diagonal contributes almost nothing, and all of the second kernel still removes the curvature."
    ),
    "4.11": marked("Agrees for the unfiltered model. The filtered one loses less than in the thesis (see Fig. 4.9)."),
    "4.12": marked(
        "The order agrees: the peak of the first kernel rises from the stiffest to the softest site. The thesis "
        "prints no peaks."
    ),
    "4.13": marked(
        "Wiener gains and second-order scores agree within 2.5 points for both inputs. The first kernel of the "
        "low-passed input scores 5 points less than in the thesis: there it scores 11 points more than LMS on the "
        "same record, which a linear model hardly can in free run with the same memory. The filter costs less (see "
        "Fig. 4.9)."
    ),
    "4.14": marked(
        "Agrees: kernels of a white input are smooth without a filter. Two sites have nearly equal peaks; in the "
        "thesis two sites change their order."
    ),
    "4.15": marked(
        "Raw, downsampled and white agree within two points; raw and downsampled are equal (see Fig. 4.8). "
        "Regularisation, which the thesis does not have, gives a smooth kernel at the same VAF as the filter."
    ),
    "5.1": marked(
        "Agrees: both inputs recover the nonlinearity. Errors are below 1 %, because the bias of the partitions is "
        "corrected; the deviations of the thesis at the ends do not appear."
    ),
    "5.2": marked(
        "Agrees: the error falls with length and repetitions and is below 5 % from 500 samples on. Fewer samples "
        "than parameters are refused here, where the thesis shows large errors."
    ),
    "5.3": marked("Agrees: mass stays, damping and stiffness follow their own curves, within a few percent."),
    "5.4": marked(
        "Agrees: with equal counts the outermost partitions are the widest, and kernels are more damped when deeper."
    ),
    "5.5": marked(
        "VAF and number of parameters agree; VAF is 3 to 4 points higher, because the simulated tissue has less noise."
    ),
    "5.6": marked(
        "The order agrees: Wiener above skin, and the DPN resembles skin in that the peak moves with depth. The "
        "simulated systems have less noise than those of the thesis, hence 99.5 % instead of 96 %."
    ),
    "5.9": marked(
        "The trend and the order of the sites agree, and so does damping. Stiffness of partitions is a few percent "
        "above that of small tests, not below. The thesis explains its difference by cross terms of skin, of which "
        "the simulated tissue has few."
    ),
    "5.10": marked(
        "The direction agrees: stiffness is higher with the lower cutoff, and damping the same. Mass is uncertain "
        "from an input that ends at 50 Hz, near the natural frequency: over eight seeds its ratio is 1.00 "
        "(docs/simulated-instrument.md). It needs skin that relaxes within 0.03 s; the other simulated tissues show "
        "it by less than 8 %. The thesis prints no ratio."
    ),
    "5.11": marked(
        "The small loss of VAF agrees, mass is the same in and out, and damping is larger inwards. Stiffness is "
        "almost equal in both directions, because the simulated skin has only its damping by direction. The test "
        "goes into the skin only, from 0 to 11 N: with one that also pulls, the correction of so many partitions "
        "finds no stable system. VAF is higher on such a test."
    ),
    "6.1": marked(
        "Agrees, with an exact distribution. It takes a fraction of a second and no million swaps, because the "
        "search starts from a surrogate with the right spectrum and chooses its partners."
    ),
    "6.2": marked(
        "The order of the methods agrees, and so does their growth: steepest, near n², for the definition, near n "
        "for a swap, level for a swap with fixed lags. The error falls fast and then levels off, as in the figure."
    ),
    "6.3": marked(
        "The order of the scores agrees: RLS like LMS, ALS far above. The score of ALS is that of responses that "
        "followed the measured position, not of a free run; counted as in the thesis, each of them is a set of "
        "parameters, hence its AIC. RLS, too slow for real time there, takes a fraction of the test here."
    ),
    "6.4": marked(
        "The direction agrees: the deeper, the lower the peak of the response. The change is small, because a "
        "response of 250 lags adapts more slowly than the position moves; partitions (Fig. 5.4) separate the depths "
        "better."
    ),
    "6.6": marked(
        "The pattern agrees: shortest at intermediate damping. The shortest times depend on stiffness and lie "
        "between the values that the thesis names."
    ),
    "6.7": marked(
        "Agrees in kind: without identification a stiffer system cycles more slowly, and the depths of a system that "
        "stiffens are not uniform. Forces here stay below 10 N, so that the ranges of depth are smaller."
    ),
    "6.10": marked(
        "Agrees: with identification the cycles are as short as 0.2 s, and all three distributions are near uniform. "
        "It takes a fraction of the test instead of 150 %."
    ),
    "6.12": marked(
        "The linear system shows little variation and the others stiffen with depth. Levels are averaged, as the "
        "thesis warns for ALS: the stochastic part is wide, and mass is the least certain."
    ),
    "8.1": marked(
        "The order of the techniques and the turn of the second-order AICc agree; the crossings lie five lags later. "
        "VAF of LMS is level from 30 lags, and the gain by the static nonlinearity is 3 to 4 points instead of 5."
    ),
    "Table 8.1": marked(
        "Interpretability, and VAF of the second order and of partitions, agree. LMS and Wiener score higher than "
        "the ranges of the thesis, which hold for people; on the record of 3.1.3 they agree (see Fig. 3.10). Times "
        "of both algorithms are of this run; a computer of 2010 took 80 to 100 s where the thesis' algorithm now "
        "takes seconds."
    ),
}
"""Remarks by number of figure."""

__all__ = ["REMARKS"]
