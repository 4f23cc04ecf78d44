"""A second simulated laboratory, independent of the first and of the twin: other machines, stimuli and laws.

It judges the diagnosis of the gap on laws for which nothing was tuned. It shares no code with
``firmware_sim.laboratory``, only the format of the scenarios.
"""
