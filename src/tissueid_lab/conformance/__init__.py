"""Conformance of a device to docs/protocol.md: clauses, their checks, and the suite that runs them.

The checks send frames without the driver, so that the limits of the host are not in force: only those of the device
are tested. Nothing stronger is commanded than a person has confirmed.
"""
