"""A surface over a plane as polygons on a page: orthographic projection, what hides what, ticks. Nothing here draws."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Points = NDArray[np.intp]

MOST_POINTS = 64
"""Maximum number of cells along either axis: fast enough to draw while the mouse is dragged."""
HALF_HEIGHT = 0.55
"""Of the box that holds the surface; its ground reaches from -1 to 1."""
FLATTEST, STEEPEST = math.radians(5.0), math.radians(90.0)
SMALLEST, LARGEST = 0.5, 4.0


@dataclass(frozen=True)
class Pose:
    """How it is looked at: turned by ``azimuth`` and from ``elevation`` above the ground, rad; ``zoom`` 1 fits it in.

    At an azimuth of zero the first axis runs to the right and the second one away.
    """

    azimuth: float = math.radians(-35.0)
    elevation: float = math.radians(35.0)
    zoom: float = 1.0

    def turned(self, azimuth: float, elevation: float) -> Pose:
        """Turned further, rad; never below the ground or past the zenith."""
        turned = math.remainder(self.azimuth + azimuth, 2.0 * math.pi)
        return replace(self, azimuth=turned, elevation=min(max(self.elevation + elevation, FLATTEST), STEEPEST))

    def zoomed(self, factor: float) -> Pose:
        """Larger by a factor, within limits."""
        return replace(self, zoom=min(max(self.zoom * factor, SMALLEST), LARGEST))

    def seen(self, x: Array, y: Array, z: Array) -> tuple[Array, Array]:
        """Where points of the box appear: to the right, and upwards, in units of half its ground."""
        cos, sin = math.cos(self.azimuth), math.sin(self.azimuth)
        away = x * sin + y * cos
        return x * cos - y * sin, away * math.sin(self.elevation) + z * math.cos(self.elevation)


@dataclass(frozen=True, eq=False)
class Mesh:
    """Points of a surface in its box: ``x`` (columns,), ``y`` (rows,) and ``z`` (columns, rows) from -1 to 1.

    ``level`` (cells,) is the mean value of the corners of each cell over the greatest magnitude, -1 to 1; ``slope``
    (cells,) is how much light falls on it, 0 to 1; a cell without all its corners is NaN in both. Cells are counted
    along the rows of a column first. ``low`` and ``high`` are the values at the bottom and the top of the box.
    """

    x: Array
    y: Array
    z: Array
    level: Array
    slope: Array
    low: float
    high: float

    @property
    def limit(self) -> float:
        """The greatest magnitude: where the colours end."""
        return max(abs(self.low), abs(self.high))

    def height(self, value: float) -> float:
        """How high a value stands in the box."""
        return HALF_HEIGHT * (2.0 * (value - self.low) / (self.high - self.low) - 1.0)


def mesh_of(values: Array) -> Mesh:
    """A mesh of values (columns, rows), thinned to :data:`MOST_POINTS` by means of neighbours; NaN is a hole."""
    thin = _thinned(_thinned(np.asarray(values, np.float64)).T).T
    known = thin[np.isfinite(thin)]
    low, high = (min(0.0, float(known.min())), max(0.0, float(known.max()))) if known.size else (0.0, 1.0)
    high = high if high > low else low + 1.0
    z = HALF_HEIGHT * (2.0 * (thin - low) / (high - low) - 1.0)
    x, y = (np.linspace(-1.0, 1.0, count) if count > 1 else np.zeros(1) for count in thin.shape)
    corners = thin[:-1, :-1], thin[1:, :-1], thin[1:, 1:], thin[:-1, 1:]
    level = np.sum(corners, axis=0) / (4.0 * max(abs(low), abs(high)))
    return Mesh(x, y, z, level.ravel(), _light(x, y, z), low, high)


def drawing_order(mesh: Mesh, pose: Pose) -> tuple[Points, Points]:
    """The cells from the farthest to the nearest (cells,), and the four corners of each as points (cells, 4).

    Holes are left out. The cells of a surface over a grid hide one another in the order of the grid, from far to near.
    """
    columns, rows = mesh.z.shape
    across, along = np.arange(columns - 1), np.arange(rows - 1)
    if math.sin(pose.azimuth) > 0.0:
        across = across[::-1]
    if math.cos(pose.azimuth) > 0.0:
        along = along[::-1]
    cells = (across[:, None] * (rows - 1) + along).ravel()
    cells = cells[np.isfinite(mesh.level[cells])]
    first = cells // max(rows - 1, 1) * rows + cells % max(rows - 1, 1)
    return cells, np.stack([first, first + rows, first + rows + 1, first + 1], axis=1)


def ticks(low: float, high: float, most: int) -> list[float]:
    """Round numbers from ``low`` to ``high``, about ``most`` of them."""
    if not (math.isfinite(low) and math.isfinite(high)) or high <= low:
        return [low]
    from matplotlib.ticker import MaxNLocator

    found = MaxNLocator(nbins=most, steps=[1, 2, 5, 10]).tick_values(low, high)
    slack = 1e-9 * (high - low)
    return [float(value) for value in found if low - slack <= value <= high + slack]


def _thinned(values: Array) -> Array:
    """Return means of neighbouring columns so that at most the allowed number remains; the last may average fewer."""
    step = -(-values.shape[0] // MOST_POINTS)
    if step <= 1:
        return values
    starts = np.arange(0, values.shape[0], step)
    counts = np.diff(np.append(starts, values.shape[0]))
    return np.asarray(np.add.reduceat(values, starts, axis=0) / counts[:, None])


def _light(x: Array, y: Array, z: Array) -> Array:
    """Light from above the first axis' lower end on each cell, 0 to 1 (Lambert's cosine)."""
    if min(z.shape) < 2:
        return np.zeros(0)
    along_x = 0.5 * (z[1:, :-1] + z[1:, 1:] - z[:-1, :-1] - z[:-1, 1:]) / (x[1] - x[0])
    along_y = 0.5 * (z[:-1, 1:] + z[1:, 1:] - z[:-1, :-1] - z[1:, :-1]) / (y[1] - y[0])
    source = np.array([-0.45, -0.35, 0.82])
    source /= np.linalg.norm(source)
    cosine = (source[2] - source[0] * along_x - source[1] * along_y) / np.sqrt(1.0 + along_x**2 + along_y**2)
    return np.asarray(np.clip(cosine, 0.0, 1.0)).ravel()


__all__ = ["HALF_HEIGHT", "MOST_POINTS", "Mesh", "Pose", "drawing_order", "mesh_of", "ticks"]
