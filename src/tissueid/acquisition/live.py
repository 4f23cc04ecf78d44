"""Identification beside a running test: the loop that polls hands its samples over and never waits for an answer.

Nothing that is handed over is lost; when the looking falls behind it takes all that has come at once and looks less
often. What goes wrong here is kept and told; it never ends a test.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissueid.acquisition.live_looks import LiveLooks, LiveSettings
from tissueid.acquisition.live_process import LiveProcess
from tissueid.device import DeviceDescription
from tissueid.identification.online.identifier import RECENT_S
from tissueid.identification.online.live_view import LiveView, Method
from tissueid.identification.online.stopping import StopRule
from tissueid.instrument import force


class LiveIdentification:
    """Identification of one test while it runs. ``feed`` from the loop that polls; ``latest`` from anywhere.

    Make it before the probe is placed: the process takes a second or two until it looks for the first time. What was
    fed until then is not lost.

    Args:
        device: gives the sample rate, and the force that belongs to a current.
        preload_s: seconds at the start of the run that are not identified.
        method: how the response is found; the parameters are found in the same way for all.
        memory: how long the impulse response lasts, s.
        window_s: of the sliding method: how much of the latest samples counts; all of them when None.
        stop: when it is good enough; never when None.
        apart: look in a process of its own. Without it nothing happens until ``step`` is called.
        external_spring_n_per_m: stands beside the tissue and is taken off the stiffness that is told. A rule to stop by
            looks at both together, which is what the test determines.

    Raises:
        UnusableInputError: a method that cannot be started so.
        pydantic.ValidationError: a number out of its bounds.
    """

    def __init__(
        self,
        device: DeviceDescription,
        *,
        preload_s: float = 0.0,
        method: Method = "sliding",
        memory: float = 0.125,
        window_s: float | None = RECENT_S,
        stop: StopRule | None = None,
        apart: bool = True,
        external_spring_n_per_m: float = 0.0,
    ) -> None:
        self._spring = external_spring_n_per_m
        self._told: tuple[LiveView, LiveView] | None = None
        self._device = device
        self._preload = round(preload_s * device.sample_rate_hz)
        self._first_index: int | None = None
        self._fed = 0
        settings = LiveSettings(
            sample_rate_hz=device.sample_rate_hz, method=method, memory=memory, window_s=window_s, stop=stop
        )
        self._looks = LiveProcess(settings) if apart else LiveLooks(settings)

    def feed(self, samples: NDArray[np.void]) -> None:
        """Take samples of the run, shape (k,) of instrument.SAMPLE, from its first on; never waits.

        The first sample fed is the first of the run. Samples that are left out are gaps.
        """
        if not samples.size:
            return
        if self._first_index is None:
            self._first_index = int(samples["index"][0])
        place = samples["index"].astype(np.int64) - self._first_index - self._preload - self._fed
        new = place >= 0
        if not new.any():
            return
        place = place[new]
        block = np.full((2, int(place[-1]) + 1), np.nan)
        block[0, place] = force(samples[new], self._device)
        block[1, place] = samples["position"][new]
        self._fed += block.shape[1]
        self._looks.take(block[0], block[1])

    def step(self) -> bool:
        """Without a process: look, if a look is due; True when one was made."""
        return self._looks.step() if isinstance(self._looks, LiveLooks) else False

    def latest(self) -> LiveView | None:
        """The newest look; None before the first."""
        view = self._looks.news.view
        if view is None or not self._spring:
            return view
        if self._told is None or self._told[0] is not view:
            self._told = view, view.without_spring(self._spring)
        return self._told[1]

    def enough(self) -> bool:
        """True once the rule has been met; it stays true."""
        return bool(self._looks.news.enough)

    @property
    def reason(self) -> str:
        """Why it is enough, in words; empty until it is."""
        return self._looks.news.enough

    @property
    def problem(self) -> str:
        """What ended the looking, in one line; empty while all is well."""
        return self._looks.news.problem

    @property
    def busy_s(self) -> float:
        """Processor time of the looks so far, s."""
        return self._looks.news.busy_s

    def close(self) -> None:
        """Look once more at all that was fed, and end. May be called again."""
        if isinstance(self._looks, LiveLooks):
            self._looks.step(last=True)
        else:
            self._looks.close()
