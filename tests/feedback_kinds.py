"""Feedback stimuli of the tests' own: what is asked of them is plain, so that what the run does with them shows."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from tissueid.stimuli.base import BLOCK, FeedbackKind, FeedbackSource


class PushBack(FeedbackKind):
    """Each block pushes less where the last samples that were known were deeper: any of them changes what follows."""

    name: ClassVar[str] = "push_back"

    @property
    def preload_n(self) -> float:
        return 4.0

    def start(self, surface_m: float) -> PushBackSource:
        return PushBackSource(self, surface_m)


class PushBackSource(FeedbackSource):
    def __init__(self, kind: PushBack, surface_m: float) -> None:
        self.kind = kind
        self.surface = surface_m
        self.taken: list[tuple[int, int]] = []
        self.force = np.empty(0)
        self.position = np.empty(0)
        self.blocks = 0

    def take(self, force, position, first):
        self.taken.append((first, force.size))
        self.force = np.append(self.force, force)
        self.position = np.append(self.position, position)

    def next_block(self):
        known = self.position[np.isfinite(self.position)]
        depth = float(known[-1]) - self.surface if known.size else 0.0
        self.blocks += 1
        wave = np.sin(2.0 * np.pi * (np.arange(BLOCK) + self.kind.seed) / BLOCK)
        return np.clip(5.0 - 300.0 * depth + wave, self.kind.force_min_n, self.kind.force_max_n)

    def report(self):
        return {"blocks": self.blocks, "samples": int(self.force.size), "lost": int(np.isnan(self.position).sum())}


class Runaway(PushBack):
    """After a while it leaves its range."""

    name: ClassVar[str] = "runaway"
    after: int = 20

    def start(self, surface_m: float) -> RunawaySource:
        return RunawaySource(self, surface_m)


class RunawaySource(PushBackSource):
    def next_block(self):
        block = super().next_block()
        return block + 20.0 if self.blocks > self.kind.after and self.surface > 0.0 else block
