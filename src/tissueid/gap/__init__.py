"""The gap between simulation and recording: where it lies, which effect causes it, how much the effect closes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tissueid.lazy_import import lazy_attributes

if TYPE_CHECKING:
    from tissueid.gap.answer import as_answer
    from tissueid.gap.dataset import Dataset
    from tissueid.gap.diagnosis import Diagnosis, diagnose
    from tissueid.gap.preparation import prepare
    from tissueid.gap.workers import executor
else:
    __getattr__ = lazy_attributes(
        __name__,
        {
            "answer": ("as_answer",),
            "dataset": ("Dataset",),
            "diagnosis": ("Diagnosis", "diagnose"),
            "preparation": ("prepare",),
            "workers": ("executor",),
        },
    )

__all__ = ["Dataset", "Diagnosis", "as_answer", "diagnose", "executor", "prepare"]
