"""Presliding friction: springs that slip one after the other, parallel to a bristle with creeping loops. Private.

Iwan, J. Applied Mechanics 33 (1966) 893-900 (parallel slip); Canudas de Wit et al., IEEE Trans. Automatic Control 40
(1995) 419-425 (bristle).
"""

from __future__ import annotations

import math

from numba import njit

STOPS = 6
"""Number of springs. Their states come first, followed by that of the bristle."""


@njit(cache=True)  # type: ignore[untyped-decorator]
def friction_share(s, velocity, give, bristle_share, dt):  # type: ignore[no-untyped-def]
    """Return the mean friction over a step relative to sliding friction, from -1 to 1, and update the state ``s``."""
    together = 0.0
    for k in range(STOPS):
        most = give * (2 * k + 1) / STOPS
        stretch = min(max(s[k] + dt * velocity, -most), most)
        # The mean over the step; a spring that does not slip stretches linearly.
        together += 0.5 * (s[k] + stretch) / most
        s[k] = stretch
    # Exact for a velocity that is constant over the step.
    path = abs(velocity) * dt / give
    settled = 1.0 if velocity > 0.0 else -1.0
    left = s[STOPS] - settled
    mean = settled + left * (1.0 - 0.5 * path if path < 1e-6 else (1.0 - math.exp(-path)) / path)
    s[STOPS] = settled + left * math.exp(-path)
    return (1.0 - bristle_share) * together / STOPS + bristle_share * mean
