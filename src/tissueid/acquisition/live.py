"""Live identification during a test: the polling loop passes samples on without waiting for results.

No sample is skipped: a late estimate uses all samples so far. Errors are stored in ``problem`` and never end a test.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissueid.acquisition.live_process import LiveEstimator, LiveProcess, LiveSettings
from tissueid.device import DeviceDescription
from tissueid.identification.live.live_view import LiveView, Method
from tissueid.identification.live.stopping import StopRule
from tissueid.identification.online_identifier import RECENT_S
from tissueid.instrument.force_profile import recorded_force


class LiveIdentification:
    """Identification of a running test. Call ``feed`` from the polling loop and ``latest`` from any thread.

    Create it before the probe is placed: the process takes a second or two to start. Samples until then are buffered.

    Args:
        device: gives the sample rate and the force constant.
        preload_s: seconds at the start of the run that are not used.
        method: method of the impulse response; the parameters are estimated in the same way for all methods.
        memory: length of the impulse response, s.
        window_s: length of the sliding window, s; all samples if None.
        stop: rule that ends the test when the estimates are precise enough; never if None.
        separate_process: estimate in a separate process. Otherwise estimates are made by calls of ``step``.
        external_spring_n_per_m: stiffness of a spring parallel to the tissue, which is subtracted from the reported
            stiffness. The stop rule uses the sum of both, which the test determines.

    Raises:
        UnusableInputError: invalid settings of the method.
        pydantic.ValidationError: a number is out of bounds.
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
        separate_process: bool = True,
        external_spring_n_per_m: float = 0.0,
    ) -> None:
        self._spring = external_spring_n_per_m
        self._shown: tuple[LiveView, LiveView] | None = None
        self._device = device
        self._preload = round(preload_s * device.sample_rate_hz)
        self._first_index: int | None = None
        self._fed = 0
        settings = LiveSettings(
            sample_rate_hz=device.sample_rate_hz, method=method, memory=memory, window_s=window_s, stop=stop
        )
        self.estimator = LiveProcess(settings) if separate_process else LiveEstimator(settings)

    def feed(self, samples: NDArray[np.void]) -> None:
        """Add samples of the run, shape (k,) of instrument.SAMPLE; never waits.

        The first sample must be the first of the run. Missing samples are gaps.
        """
        if not samples.size:
            return
        if self._first_index is None:
            self._first_index = int(samples["index"][0])
        index = samples["index"].astype(np.int64) - self._first_index - self._preload - self._fed
        new = index >= 0
        if not new.any():
            return
        index = index[new]
        block = np.full((2, int(index[-1]) + 1), np.nan)
        block[0, index] = recorded_force(samples[new], self._device)
        block[1, index] = samples["position"][new]
        self._fed += block.shape[1]
        self.estimator.take(block[0], block[1])

    def step(self) -> bool:
        """Without a separate process: make an estimate if one is due; return whether one was made."""
        return self.estimator.step() if isinstance(self.estimator, LiveEstimator) else False

    def latest(self) -> LiveView | None:
        """Return the newest estimate; None before the first."""
        view = self.estimator.update.view
        if view is None or not self._spring:
            return view
        if self._shown is None or self._shown[0] is not view:
            self._shown = view, view.without_spring(self._spring)
        return self._shown[1]

    def enough(self) -> bool:
        """Return whether the stop rule is met."""
        return bool(self.estimator.update.enough)

    @property
    def reason(self) -> str:
        """Why the stop rule is met; "" until it is."""
        return self.estimator.update.enough

    @property
    def problem(self) -> str:
        """The error that ended the estimates; "" without one."""
        return self.estimator.update.problem

    @property
    def busy_s(self) -> float:
        """Processor time of the estimates so far, s."""
        return self.estimator.update.busy_s

    def close(self) -> None:
        """Make a final estimate from all samples, and end. May be called more than once."""
        if isinstance(self.estimator, LiveEstimator):
            self.estimator.step(last=True)
        else:
            self.estimator.close()
