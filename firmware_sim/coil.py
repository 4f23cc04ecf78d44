"""Force constant of the coil along the stroke: constant, or decreasing where a finite coil leaves the field.

Force and back-EMF have the same constant: k(x) N/A equals k(x) V s/m. A profile is relative to the force constant of
the plant's parameters, which is its plateau.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

COILS = ("ideal", "finite")
LINEAR_SHARE = 0.05
"""Largest relative deviation from the plateau within the linear region."""

_FINE_M = 1e-5


@dataclass(frozen=True)
class CoilProfile:
    """Relative force constant at equally spaced positions, both of shape (n,), n 4 or more.

    Without values the force constant is constant. Values are interpolated by a cubic spline and constant beyond the
    ends.

    Raises:
        ValueError: positions that are not equally spaced and increasing, or values that are not positive.
    """

    position_m: tuple[float, ...] = ()
    relative: tuple[float, ...] = ()
    _spline: CubicSpline | None = field(default=None, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if not self.position_m and not self.relative:
            return
        at, values = np.asarray(self.position_m), np.asarray(self.relative)
        if at.size < 4 or at.shape != values.shape:
            raise ValueError("a coil profile needs four positions or more, and a value for each")
        steps = np.diff(at)
        if not (np.all(np.isfinite(at)) and steps.min() > 0 and np.ptp(steps) < 1e-6 * steps.mean()):
            raise ValueError("the positions of a coil profile must rise in equal steps")
        if not (np.all(np.isfinite(values)) and values.min() > 0):
            raise ValueError("the force constant must be positive all along the stroke")
        from scipy.interpolate import CubicSpline  # imported late: an ideal coil does not need it

        object.__setattr__(self, "_spline", CubicSpline(at, values))

    def at(self, position_m: float) -> float:
        """Return the relative force constant at a position in metres."""
        return 1.0 if self._spline is None else float(self.along(position_m))

    def along(self, position_m: ArrayLike) -> NDArray[np.float64]:
        """Return the relative force constant at positions in metres, in their shape."""
        where = np.asarray(position_m, dtype=np.float64)
        if self._spline is None:
            return np.ones_like(where)
        return np.asarray(self._spline(np.clip(where, self.position_m[0], self.position_m[-1])))

    def to_array(self) -> NDArray[np.float64]:
        """Return the arguments of the compiled loop: number of nodes, first, spacing, then value and slope per spacing
        of each node.
        """
        if self._spline is None:
            return np.zeros(3)
        at = np.asarray(self.position_m)
        spacing = float((at[-1] - at[0]) / (at.size - 1))
        pairs = np.stack([self._spline(at), spacing * self._spline(at, 1)], axis=1)
        return np.concatenate([[at.size, at[0], spacing], pairs.ravel()])


IDEAL = CoilProfile()


def finite_coil(stroke_m: float) -> CoilProfile:
    """Return the profile of a coil that leaves its field at both ends of the stroke, more at the far one (thesis 2.4.1,
    Fig. 2.12).

    Each edge of the field is an error function, which resembles the fringe field of a magnet. The values are chosen,
    because the thesis gives none: 0.80 of the plateau at zero, 0.62 at the far end, and 5 % loss at about 4 and 27 mm,
    for its "region of about 20 to 25 mm". The median over the middle half is 1.
    """
    from scipy.special import erfc

    near, near_width = 0.595, 7.4e-3  # erfc(0.595) / 2 = 0.20
    far, far_width = 0.216, 5.3e-3  # erfc(0.216) / 2 = 0.38

    def relative(position: NDArray[np.float64]) -> NDArray[np.float64]:
        lost = erfc(near + position / near_width) + erfc(far + (stroke_m - position) / far_width)
        return np.asarray(1.0 - 0.5 * lost)

    # The end stops yield by some tenths of a millimetre.
    nodes = np.linspace(-1e-3, stroke_m + 1e-3, 69)
    plateau = float(np.median(relative(_middle_half(stroke_m))))
    return CoilProfile(tuple(nodes.tolist()), tuple((relative(nodes) / plateau).tolist()))


def coil_profile(name: str, stroke_m: float) -> CoilProfile:
    """Return the profile of a coil by its name, "ideal" or "finite".

    Raises:
        ValueError: there is no such coil.
    """
    if name not in COILS:
        raise ValueError(f"unknown coil {name!r}; known: {', '.join(COILS)}")
    return IDEAL if name == "ideal" else finite_coil(stroke_m)


def _middle_half(stroke_m: float) -> NDArray[np.float64]:
    return np.linspace(0.25 * stroke_m, 0.75 * stroke_m, 1 + round(0.5 * stroke_m / _FINE_M))


def profile_values(profile: CoilProfile, force_constant_n_per_a: float, stroke_m: float) -> dict[str, object]:
    """Return the true values of a profile for comparison with a calibration, as JSON.

    ``plateau_n_per_a`` is the median over the middle half of the stroke; the linear region is the range about the
    middle within 5 % of it.
    """
    shown = np.linspace(0.0, stroke_m, 129)
    fine = np.linspace(0.0, stroke_m, 1 + round(stroke_m / _FINE_M))
    plateau = float(np.median(profile.along(_middle_half(stroke_m))))
    off = np.abs(profile.along(fine) / plateau - 1.0) > LINEAR_SHARE
    middle = fine.size // 2
    below, above = np.flatnonzero(off[:middle]), np.flatnonzero(off[middle:])
    first = int(below[-1]) + 1 if below.size else 0
    last = middle + int(above[0]) - 1 if above.size else fine.size - 1
    return {
        "position_m": shown.round(9).tolist(),
        "force_constant_n_per_a": (force_constant_n_per_a * profile.along(shown)).tolist(),
        "plateau_n_per_a": force_constant_n_per_a * plateau,
        "linear_region_min_m": round(float(fine[first]), 9),
        "linear_region_max_m": round(float(fine[last]), 9),
        "linear_share": LINEAR_SHARE,
        "stroke_m": stroke_m,
    }
