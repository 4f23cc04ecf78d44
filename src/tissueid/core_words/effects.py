"""What the core says of each effect: title, what it leaves, what to do, and what its parameters mean."""

from __future__ import annotations

from tissueid.language import marked

TITLES = {
    "amplifier_clipping": marked("Amplifier clips below its rating"),
    "amplifier_deadband": marked("Dead zone of the amplifier round zero"),
    "amplifier_drift": marked("Amplifier drifts"),
    "amplifier_lag": marked("Slow amplifier"),
    "latency": marked("Extra delay in the drive"),
    "coil_heating": marked("The coil warms up"),
    "eddy_currents": marked("Eddy currents make the inductance lossy"),
    "flux_saturation": marked("The force constant depends on current"),
    "force_constant_position": marked("The force constant changes along the stroke"),
    "inductance_position": marked("Inductance changes along the stroke"),
    "reluctance_force": marked("Reluctance force"),
    "cogging": marked("Periodic force along the stroke"),
    "directional_friction": marked("Dry friction that differs by direction"),
    "dry_friction": marked("Dry friction in the bearing"),
    "end_stop": marked("Contact with the end of the stroke"),
    "mount_resonance": marked("The frame moves"),
    "quadratic_drag": marked("Drag that grows faster than speed"),
    "added_mass": marked("Mass recruited with depth"),
    "contact_loss": marked("The probe lifts off"),
    "directional_damping": marked("Pushing damped otherwise than pulling"),
    "preconditioning": marked("Stiffness drifts as the tissue is worked"),
    "reflex": marked("A reflex answers stretch"),
    "tissue_hysteresis": marked("Loops that do not depend on speed"),
    "tissue_stiffening": marked("Another static law: a layer engages"),
    "viscoelasticity": marked("Relaxation of the tissue"),
    "clock_skew": marked("Position timed by another clock"),
    "dropped_samples": marked("Samples lost without a mark"),
    "quantization": marked("Position in coarse steps"),
    "sensor_backlash": marked("Play between probe and position sensor"),
    "sensor_lag": marked("Slow position channel"),
    "sensor_nonlinearity": marked("Position reading not linear along the stroke"),
    "mains_hum": marked("Mains hum on the channels"),
    "physiological_motion": marked("Breathing, pulse or tremor moves the surface"),
}
"""By the effect's name, because the core also names effects so, and begins titles with a small letter."""
SIGNATURES = (
    marked(
        "voltage against command bends at large commands, at once and without memory; odd and even distortion in "
        "voltage that is gone at smaller amplitude; current against voltage unchanged"
    ),
    marked(
        "voltage missing where the command is small, by up to the width; with k = 1 it stays behind by the width "
        "at every command, towards zero; strongest in the spring test, whose command has no mean"
    ),
    marked(
        "voltage in proportion to the command at any one time, by a factor or with an offset that moves over "
        "seconds; the offset shows in quiet records; current against voltage unchanged"
    ),
    marked(
        "voltage late and smaller against the command at high frequencies, its steps rounded; nothing at constant "
        "or slow command; current against voltage unchanged"
    ),
    marked(
        "voltage, current and position all late by the same time against the command, phase growing in proportion "
        "to frequency, no change of amplitude; nothing at constant command; current against voltage unchanged"
    ),
    marked(
        "current falls against voltage over seconds, the faster the larger the current; resistance follows the "
        "dissipated energy; nothing in quiet records; force against current unchanged"
    ),
    marked(
        "current against voltage at high frequencies: resistance rises and inductance falls with frequency, the "
        "same at every depth and amplitude; nothing in slow or quiet records; seen with the coil held still"
    ),
    marked(
        "force per ampere and back-EMF change with current wherever the probe stands, at once; even distortion of "
        "position under a mean current, odd without one; current itself but little"
    ),
    marked(
        "force per ampere and back-EMF fall together with position, static force curve bent in the ramp; current "
        "rises where the probe moves fast far from the plateau; there on the spring as well"
    ),
    marked(
        "current against voltage at high frequencies, more at one end of the stroke than at the other: the lag of "
        "current follows position; resistance unchanged; a force with the square of current that energy demands, "
        "unless iron elsewhere makes up for it"
    ),
    marked(
        "force with the square of current in one direction only: even distortion of position, a mean shift in the "
        "spring test, twice the frequency of the command; current and back-EMF untouched"
    ),
    marked(
        "a static force that waves with position, the same in every test, tissue or spring; in the ramp position "
        "goes in steps; its stiffness changes sign along the stroke"
    ),
    marked(
        "as dry friction, but one branch of every loop is shifted further than the other: a steady force while it "
        "slides that is absent while it sticks, so mean position depends on whether and how the probe moves"
    ),
    marked(
        "position lags and flattens at reversals, the more the smaller the amplitude; loops in the slow ramp; in "
        "the spring test as well as on tissue; current untouched but for back-EMF"
    ),
    marked(
        "position cut off at one value, the same in every test, with short impacts; nothing away from it; current "
        "shows the impacts by back-EMF"
    ),
    marked(
        "a narrow resonance and antiresonance in the response of position to force at one frequency, the same in "
        "every test; linear: no distortion; current only near that frequency"
    ),
    marked(
        "odd distortion where speed is highest, at frequencies round the resonance; less at lower amplitude; none "
        "in the slow ramp; in the spring test as well; position alone, current by back-EMF"
    ),
    marked(
        "resonance lower the deeper the probe, at equal stiffness in the slow ramp; error at high frequency, even "
        "distortion; nothing on the spring"
    ),
    marked(
        "where the command is lowest or falls fastest the probe flies further out than tissue would let it, and "
        "comes back late; without a command it drifts off if the device hangs; nothing at depth, nothing on the spring"
    ),
    marked(
        "even distortion that grows with speed: mean depth falls with amplitude, position faster one way than the "
        "other; none in the slow ramp, nothing on the spring"
    ),
    marked(
        "mean depth and resonance drift over the test, fast at first; error grows or falls with time; nothing on "
        "the spring; a repeat begins again"
    ),
    marked(
        "position pushed out 20 to 150 ms after every fast push in, never the other way; ripples in the response "
        "against frequency, spaced by the inverse of the delay; nothing on the spring"
    ),
    marked(
        "loops of force against depth that are as wide in the slow ramp as in the fast test and grow with depth; "
        "odd distortion and phase at low frequency; nothing on the spring"
    ),
    marked(
        "position at large depth against current: stiffness rises (or falls) from one depth on, slow ramp and "
        "stochastic test alike; no loops, nothing on the spring"
    ),
    marked(
        "stiffness rises with frequency where damping alone would not do it, with phase over a wide band; creep "
        "after the mean is switched on; linear in small motion; nothing on the spring"
    ),
    marked(
        "position runs ahead of voltage and current, or falls behind, by an interval that grows from the start of "
        "every test; a pure delay, so its phase grows with frequency and its gain stays"
    ),
    marked(
        "from some sample on, voltage, current and position all come early against the command by whole samples, "
        "at other places in every test; or the position alone comes early against the current's back-EMF"
    ),
    marked(
        "recorded positions lie on a grid, none between; errors of s / sqrt(12) at most, white once the motion "
        "spans several steps; voltage and current untouched"
    ),
    marked(
        "position stands still after each reversal until the play is taken up, at any speed: loops of constant "
        "width in the slow ramp, small motions swallowed; current shows by back-EMF that the probe did move"
    ),
    marked(
        "position lags what current and voltage say of it by back-EMF, the more the faster: gain falls and phase "
        "grows with frequency, alike in every test and at every depth; voltage and current untouched"
    ),
    marked(
        "an error of position alone that is a function of position, the same in every test, at any speed and on "
        "tissue as on the spring; back-EMF in current contradicts it"
    ),
    marked(
        "sharp lines at 50 or 60 Hz and twice, three and five times that, in quiet tests as well, unrelated to the "
        "command; each channel has its own strength, every test its own phase"
    ),
    marked(
        "position sways at 0.1 to 0.5, 0.8 to 2 or 8 to 12 Hz, in quiet tests as well and whatever the command, "
        "with other phases in every test; none of it on the spring"
    ),
)
"""What effects leave in the records."""
REMEDIES = (
    marked("Check the supply under load and the amplifier's current limit; lower the amplitude until it is gone."),
    marked("Set the amplifier's bias current; measure voltage against a slow ramp through zero."),
    marked("Let the amplifier warm up; calibrate voltage gain and offset again after a test as well as before it."),
    marked("Measure the amplifier's step response into the coil; check its compensation and any filter before it."),
    marked("Look for buffering between host and amplifier; measure the delay with a step into a resistor."),
    marked("Wait between tests; put the winding's temperature and copper's 0.39 %/K into the resistance in use."),
    marked("Measure the blocked coil's impedance against frequency; put the lossy inductance into the calibration."),
    marked("Measure force against current with the coil blocked; keep to smaller currents."),
    marked("Run the dynamic sweep along the stroke and put its force-constant table in force."),
    marked("Measure the blocked coil's impedance at several places along the stroke."),
    marked("Measure force against current of either sign with the coil blocked; compensate in the force estimate."),
    marked("Look for iron or magnetic dirt in the gap; map the force along the stroke in free air."),
    marked("Look for a bent or one-sidedly loaded bearing; turn the device over and measure again in free air."),
    marked("Clean and realign the bearing; measure again in free air."),
    marked("Bring the device nearer to the surface, or press less deep, so that the stroke does not end in the test."),
    marked("Clamp the frame or make its stand heavier; rest the device on the bench."),
    marked("Open the vents of the coil's housing, or keep speeds lower; tissue's figures stand once it is modelled."),
    marked("Report mass by depth; a smaller probe recruits less."),
    marked("Raise the mean of the command or lower its amplitude so that the probe stays on the surface."),
    marked("Report damping in and out apart."),
    marked("Work the tissue for some seconds before the test, or let it rest as long before every test."),
    marked("Ask the person to relax, and test with smaller amplitude, below the reflex."),
    marked("Report loading and unloading apart; precondition the tissue with a few slow cycles."),
    marked("Take the depth from which it acts as a finding; test at a mean depth either side of it."),
    marked("Report the relaxation times with the stiffness; let the tissue rest under the mean before the test."),
    marked("Let one clock time all channels; else record its count beside the position."),
    marked("Look at the link's counters and cable; record with sample numbers."),
    marked("Use the sensor's finer range or a converter of more bits."),
    marked("Tighten or preload the coupling between probe and sensor."),
    marked("Switch the position sensor's filter to its widest, or measure it against a step and set the twin's."),
    marked("Calibrate the position channel along the stroke against gauge blocks."),
    marked("Break ground loops, twist and screen the leads, keep them from transformers."),
    marked("Have the subject hold the breath; rest the limb; test longer or average over pulses."),
)
"""What to do about them."""
