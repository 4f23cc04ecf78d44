"""What dry friction holds with: springs that slip one after the other, beside a bristle whose loops creep. Private.

Iwan, J. Applied Mechanics 33 (1966) 893-900 (parallel slip); Canudas de Wit et al., IEEE Trans. Automatic Control 40
(1995) 419-425 (the bristle).
"""

from __future__ import annotations

import math

from numba import njit

STOPS = 6
"""Springs; their states come first, the bristle's after them."""


@njit(cache=True)  # type: ignore[untyped-decorator]
def held(s, velocity, give, bristle_share, dt):  # type: ignore[no-untyped-def]
    """The mean over a step of what is held, by what is held while sliding: from -1 to 1; ``s`` is moved on."""
    together = 0.0
    for k in range(STOPS):
        most = give * (2 * k + 1) / STOPS
        stretch = min(max(s[k] + dt * velocity, -most), most)
        # The mean over the step: half of the way is not yet covered where the spring is not slipping.
        together += 0.5 * (s[k] + stretch) / most
        s[k] = stretch
    # Exact for a velocity that is constant over the step.
    path = abs(velocity) * dt / give
    settled = 1.0 if velocity > 0.0 else -1.0
    left = s[STOPS] - settled
    mean = settled + left * (1.0 - 0.5 * path if path < 1e-6 else (1.0 - math.exp(-path)) / path)
    s[STOPS] = settled + left * math.exp(-path)
    return (1.0 - bristle_share) * together / STOPS + bristle_share * mean
