"""The reference firmware, built once: with sanitizers for this computer, and for the emulated microcontroller.

Without the tools these tests are skipped.
"""

import pytest

from firmware_sim.reference.build import QEMU, SANITIZERS, build, build_posix
from firmware_sim.reference.emulator import emulator_command
from firmware_sim.reference.tools import MissingToolError


@pytest.fixture(scope="session")
def program(tmp_path_factory):
    try:
        return build_posix(options=SANITIZERS)
    except MissingToolError as error:
        pytest.skip(f"needs a C compiler: {error}")
    except RuntimeError as error:
        if "cannot find" not in str(error):  # no libraries of the sanitizers
            raise
        return build_posix()


@pytest.fixture(scope="session")
def emulated():
    """The firmware for the emulated microcontroller."""
    try:
        emulator_command(built := build(QEMU))
    except MissingToolError as error:
        pytest.skip(str(error))
    return built
