"""TissueID: measure living tissue with a voice coil and nonlinear stochastic system identification.

The names below are the public Python interface; docs/python-interface.md says what may change in it, and when. Their
modules are imported at first use.
"""

import logging
from typing import TYPE_CHECKING

from tissueid.lazy_import import lazy_attributes
from tissueid.version import __version__

if TYPE_CHECKING:
    from tissueid.analysis import Analysis, EngineComparison
    from tissueid.errors import TissueIDError, UnusableInputError
    from tissueid.gap import Diagnosis
    from tissueid.identification import Engine, Model, vaf_percent
    from tissueid.records import Estimate, Record
    from tissueid.scripting import (
        calibrate,
        compare,
        diagnose,
        identify,
        import_records,
        list_devices,
        list_effects,
        list_engines,
        list_stimuli,
        make_stimulus,
        open_session,
        run_test,
        write_report,
    )
    from tissueid.sessions import Session, Test
    from tissueid.stimuli import Stimulus
    from tissueid.twin.effect import Effect
else:
    __getattr__ = lazy_attributes(
        __name__,
        {
            "analysis": ("Analysis", "EngineComparison"),
            "errors": ("TissueIDError", "UnusableInputError"),
            "gap": ("Diagnosis",),
            "identification": ("Engine", "Model", "vaf_percent"),
            "records": ("Estimate", "Record"),
            "scripting": (
                "calibrate",
                "compare",
                "diagnose",
                "identify",
                "import_records",
                "list_devices",
                "list_effects",
                "list_engines",
                "list_stimuli",
                "make_stimulus",
                "open_session",
                "run_test",
                "write_report",
            ),
            "sessions": ("Session", "Test"),
            "stimuli": ("Stimulus",),
            "twin.effect": ("Effect",),
        },
    )

__all__ = [
    "Analysis",
    "Diagnosis",
    "Effect",
    "Engine",
    "EngineComparison",
    "Estimate",
    "Model",
    "Record",
    "Session",
    "Stimulus",
    "Test",
    "TissueIDError",
    "UnusableInputError",
    "__version__",
    "calibrate",
    "compare",
    "diagnose",
    "identify",
    "import_records",
    "list_devices",
    "list_effects",
    "list_engines",
    "list_stimuli",
    "make_stimulus",
    "open_session",
    "run_test",
    "vaf_percent",
    "write_report",
]


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)


logging.getLogger(__name__).addHandler(logging.NullHandler())
