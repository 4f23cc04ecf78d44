"""The reference firmware, built once with its sanitizers; without a C compiler these tests are skipped."""

import pytest

from firmware_sim.reference.build import SANITIZERS, MissingToolError, build_posix


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
