"""Block structure indicated by Volterra kernels: Wiener, Hammerstein, LNL, or none of them.

The second-order kernel of a Hammerstein system is diagonal and proportional to the first-order kernel there; each of
its slices is proportional to the first-order kernel for a Wiener system, and the sum of the slices is for an LNL system
(Chen, Ishii and Suzumura 1986; Haber and Keviczky 1999; Westwick and Kearney 2003, chapter 4). Parameters that vary
with depth give none of these, but a narrow main lobe between two of opposite sign (Chen 2010, 4.2, Fig. 4.5).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import ndimage

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array, Model
from tissueid.identification.preparation import complete_after_rest
from tissueid.identification.second_order_fit import SecondOrderFit
from tissueid.identification.volterra.methods import simulate_third
from tissueid.identification.volterra.regressors import Kernels
from tissueid.language import marked
from tissueid.messages import Listing, Message

_ENTRIES_AT_ONCE = 1 << 16
"""Number of lagged inputs processed at a time, so that they fit the processor cache."""


@dataclass(frozen=True, eq=False)
class ImpulseResponse:
    """Response to an input sample of ``height`` about the operating point, order by order (Eq. 4.15).

    ``zeroth`` is a level, the others have shape (lags,); all are in the unit of the output.
    """

    lag_s: Array
    height: float
    zeroth: float
    first: Array
    second: Array
    third: Array

    @property
    def total(self) -> Array:
        """h0 + h1(t) + h2(t, t) + h3(t, t, t) times powers of the height, (lags,)."""
        return self.zeroth + self.first + self.second + self.third


@dataclass(frozen=True, eq=False)
class VolterraModel(Model):
    """Eq. 4.1 about an operating point: the kernels act on the input minus ``input_mean``.

    ``kernel0`` is the level of the output there (not its mean, to which even kernels contribute), ``kernel1`` (lags,)
    is in output units per input unit and second, ``kernel2`` (lags, lags) per input unit squared and second squared,
    ``kernel3`` (lags, lags, lags) per input unit cubed and second cubed; all are symmetric, and None above ``order``.
    ``lag_s`` (lags,) are the times of their lags, ``lag_spacing`` samples apart. ``kernel1_std`` and ``kernel2_std``
    have the shapes of the kernels; None if unknown. ``unfiltered`` is the model before its second-order kernel was
    smoothed.
    """

    order: int
    kernel0: float
    kernel1: Array | None
    kernel2: Array | None
    kernel3: Array | None
    kernel1_std: Array | None
    kernel2_std: Array | None
    lag_s: Array
    lag_spacing: int
    input_mean: float
    second_order: SecondOrderFit | None
    unfiltered: VolterraModel | None = None

    @property
    def per_lag(self) -> Kernels:
        """The kernels as factors of samples: in output units per power of the input unit."""
        step = self.lag_spacing / self.sample_rate_hz
        return Kernels(
            self.kernel0,
            None if self.kernel1 is None else self.kernel1 * step,
            None if self.kernel2 is None else self.kernel2 * step**2,
            None if self.kernel3 is None else self.kernel3 * step**3,
        )

    def simulate(self, u: Array) -> Array:
        """Simulate in free run: input (n,), output (n,), at rest at the mean input before the first sample."""
        return np.asarray(np.sum(self.contributions(u), axis=0), dtype=np.float64)

    def contributions(self, u: Array) -> tuple[Array, ...]:
        """Return the contribution of each order, from 0 on, to the simulation of an input (n,): arrays (n,)."""
        x = np.asarray(u, dtype=np.float64) - self.input_mean
        finite = np.isfinite(x)
        parts = np.vstack(
            [
                np.full((1, x.size), self.kernel0),
                kernel_outputs(self.per_lag, np.where(finite, x, 0.0), self.lag_spacing, self.order),
            ]
        )
        if not finite.all():
            parts[:, ~complete_after_rest(finite, self.memory_samples)] = np.nan
        return tuple(parts)

    def impulse_response(self, height: float = 1.0) -> ImpulseResponse:
        """Return the response to an input of ``height`` for one lag, relative to the operating point."""
        kernels = self.per_lag
        nothing = np.zeros(self.lag_s.size)
        lag = np.arange(self.lag_s.size)
        return ImpulseResponse(
            lag_s=self.lag_s,
            height=height,
            zeroth=kernels.zeroth,
            first=nothing if kernels.first is None else height * kernels.first,
            second=nothing if kernels.second is None else height**2 * kernels.second[lag, lag],
            third=nothing if kernels.third is None else height**3 * kernels.third[lag, lag, lag],
        )


def kernel_outputs(kernels: Kernels, x: Array, spacing: int, order: int) -> Array:
    """Return the outputs (order, n) of the kernels of order 1 to ``order`` for an input (n,), at rest before it."""
    first, second, third = kernels.first, kernels.second, kernels.third
    outputs = np.zeros((order, x.size))
    if first is None:
        return outputs
    lags = first.size
    padded = np.concatenate([np.zeros((lags - 1) * spacing), x])
    windows = np.lib.stride_tricks.sliding_window_view(padded, (lags - 1) * spacing + 1)[:, ::-spacing]  # (n, lags)
    rows = max(1, _ENTRIES_AT_ONCE // lags)
    for begin in range(0, x.size, rows):
        some = slice(begin, begin + rows)
        window = np.ascontiguousarray(windows[some])  # (rows, lags)
        outputs[0, some] = window @ first
        if second is not None:
            outputs[1, some] = np.einsum("ij,ij->i", window @ second, window)
    if third is not None:
        outputs[2] = simulate_third(third, x, spacing)
    return outputs


KernelName = Literal["linear", "wiener", "hammerstein", "lnl", "neither", "undetermined"]

_SMOOTHING_WIDTHS = (0.0, 0.5, 1.0, 1.5, 2.0)
"""Widths, in lags, by which an estimated kernel may be smoothed across its diagonal, as regularised kernels are."""

_PROPORTIONAL_COSINE = 0.95
"""Cosine above which kernels without a standard deviation are proportional."""

_TOLERANCE = 0.02
"""Tolerance of a cosine below its band: the distortion of kernels by priors and short memories."""

_DRAWS = 100
_LEVEL = 0.05
_LOBE = 0.1
_PRESENT_STD = 4.0
"""Threshold of the largest value of a kernel, in standard errors, for the kernel to differ from zero."""

_LEAST = 0.1
"""Lower bound on the share of an estimated kernel's energy that is not noise."""


@dataclass(frozen=True)
class StructureScore:
    """Similarity of kernels to a structure: a cosine, and the ``band`` that it would exceed in 95 % of cases."""

    cosine: float
    band: float

    @property
    def holds(self) -> bool:
        """Whether the kernels agree with the structure within their uncertainty."""
        return self.cosine >= self.band


@dataclass(frozen=True)
class StructureVerdict:
    """Structure indicated by kernels: a name, the score of each structure that was tested, and a sentence.

    ``scores`` has the keys ``hammerstein``, ``wiener`` and ``lnl``; it is empty without a second-order kernel.
    ``side_lobes`` is the largest value of the second-order kernel with the sign opposite to its peak, relative to the
    peak.
    """

    name: KernelName
    scores: dict[str, StructureScore]
    side_lobes: float
    sentence: str


def kernel_structure(
    kernel1: Array, kernel2: Array, kernel1_std: Array | None = None, kernel2_std: Array | None = None
) -> StructureVerdict:
    """Return the block structure indicated by a first-order kernel (L,) and a symmetric second-order kernel (L, L).

    Args:
        kernel1: first-order kernel about the operating point; its scale is irrelevant.
        kernel2: second-order kernel on the same lags.
        kernel1_std: standard deviations (L,); without them, a cosine of 0.95 is required and no kernel counts as zero.
        kernel2_std: standard deviations (L, L).

    Raises:
        UnusableInputError: the shapes do not match, or a value is not finite.
    """
    kernel1, kernel2 = np.asarray(kernel1, dtype=np.float64), np.asarray(kernel2, dtype=np.float64)
    _check(kernel1, kernel2)
    kernel2 = 0.5 * (kernel2 + kernel2.T)
    if not _is_present(kernel2, kernel2_std):
        return StructureVerdict("linear", {}, 0.0, _LINEAR)
    first = kernel1 if _is_present(kernel1, kernel1_std) else None
    scores = _scores(first, kernel2, kernel1_std, kernel2_std)
    lobes = _side_lobes(kernel2)
    name = _name(scores)
    shown = Listing(tuple(f"{which} {score.cosine:.2f}" for which, score in scores.items()))
    if name != "neither":
        return StructureVerdict(name, scores, lobes, Message(f"structure.{name}", _SENTENCES[name], cosines=shown))
    tried = (
        marked("neither Wiener nor Hammerstein nor LNL")
        if "lnl" in scores
        else marked("neither Wiener nor Hammerstein")
    )
    if lobes > _LOBE:
        sentence = Message(
            "structure.side_lobes",
            "{tried} (cosines: {cosines}); the peak has side lobes of {percent:.0f} %: parameters that vary with depth "
            "would look like this",
            tried=tried,
            cosines=shown,
            percent=100.0 * lobes,
        )
    else:
        sentence = Message(
            "structure.neither",
            "{tried} (cosines: {cosines}); parameters that vary with depth would look like this",
            tried=tried,
            cosines=shown,
        )
    return StructureVerdict("neither", scores, lobes, sentence)


_LINEAR = Message(
    "structure.linear", "the second kernel does not differ from zero: the kernels are those of a linear system"
)
_SENTENCES: dict[KernelName, str] = {
    "undetermined": marked("the kernels do not distinguish Wiener and Hammerstein (cosines: {cosines})"),
    "wiener": marked(
        "every slice of the second kernel is proportional to the first kernel, as in a Wiener system (cosines: "
        "{cosines})"
    ),
    "hammerstein": marked(
        "the second kernel is the first along its diagonal, as in a Hammerstein system (cosines: {cosines})"
    ),
    "lnl": marked("the slices of the second kernel sum to the first kernel, as in an LNL system (cosines: {cosines})"),
}


def _name(scores: dict[str, StructureScore]) -> KernelName:
    if scores["wiener"].holds and scores["hammerstein"].holds:
        return "undetermined"
    if scores["wiener"].holds:
        return "wiener"
    if scores["hammerstein"].holds:
        return "hammerstein"
    return "lnl" if "lnl" in scores and scores["lnl"].holds else "neither"


def _check(kernel1: Array, kernel2: Array) -> None:
    lags = kernel1.size
    if kernel1.ndim != 1 or kernel2.shape != (lags, lags):
        raise UnusableInputError(
            "volterra.kernel_shapes",
            "kernels of shapes {first} and {second} do not match: the second must be (L, L)",
            first=str(kernel1.shape),
            second=str(kernel2.shape),
        )
    if not (np.all(np.isfinite(kernel1)) and np.all(np.isfinite(kernel2))):
        raise UnusableInputError(
            "volterra.kernel_not_finite", "a kernel has a value that is not finite: fit it to a longer record"
        )


def _is_present(kernel: Array, std: Array | None) -> bool:
    """Return whether a kernel differs from zero: its largest value exceeds its standard error."""
    if not np.any(kernel):
        return False
    if std is None:
        return True
    return bool(np.max(np.abs(kernel) / np.maximum(std, 1e-300)) > _PRESENT_STD)


def _scores(kernel1: Array | None, kernel2: Array, std1: Array | None, std2: Array | None) -> dict[str, StructureScore]:
    """Return the cosines with bands; without a first-order kernel, Wiener means rank one and LNL is not tested."""
    cosines = {"wiener": _wiener(kernel1, kernel2), "hammerstein": _hammerstein(kernel1, kernel2)}
    if kernel1 is not None:
        cosines["lnl"] = _cosine(kernel2.sum(axis=0), kernel1)
    if std2 is None:
        return {name: StructureScore(cosine, _PROPORTIONAL_COSINE) for name, cosine in cosines.items()}
    bands = _bands(kernel1, kernel2, std1, std2, tuple(cosines))
    return {name: StructureScore(cosine, bands[name]) for name, cosine in cosines.items()}


def _cosine(a: Array, b: Array) -> float:
    """Return the absolute cosine between two arrays of the same shape."""
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return abs(float(np.vdot(a, b))) / size if size > 0.0 else 0.0


def _wiener(kernel1: Array | None, kernel2: Array) -> float:
    if kernel1 is None:
        values = np.abs(np.linalg.eigvalsh(kernel2))
        return float(values.max() / np.linalg.norm(values))
    return _cosine(kernel2, np.outer(kernel1, kernel1))


def _hammerstein(kernel1: Array | None, kernel2: Array) -> float:
    """Return the best cosine with a diagonal kernel, smoothed by the widths in ``_SMOOTHING_WIDTHS``."""
    diagonal = np.diag(kernel2) if kernel1 is None else kernel1
    return max(_cosine(kernel2, _smoothed(np.diag(diagonal), width)) for width in _SMOOTHING_WIDTHS)


def _smoothed(kernel2: Array, width: float) -> Array:
    return ndimage.gaussian_filter(kernel2, width, mode="nearest") if width > 0.0 else kernel2


def _bands(
    kernel1: Array | None, kernel2: Array, std1: Array | None, std2: Array, names: tuple[str, ...]
) -> dict[str, float]:
    """Return the value that each cosine would exceed in 95 % of cases if the structure held, with these errors.

    The correlation of errors between lags is not known from standard deviations; errors are drawn both independent and
    as smooth as the kernel itself, and the wider band is used.
    """
    rng = np.random.Generator(np.random.PCG64(0))  # reproducible
    values, vectors = np.linalg.eigh(kernel2)
    first = kernel1 if kernel1 is not None else vectors[:, int(np.argmax(np.abs(values)))]
    widths = (0.0, _smoothness(first))
    lags = first.size
    energy = float(np.sum(kernel2**2))
    size = np.sqrt(max(energy - float(np.sum(std2**2)), _LEAST * energy))  # energy without that of the errors
    truths = {"wiener": _of_size(np.outer(first, first), size), "hammerstein": _of_size(np.diag(first), size)}
    truths["lnl"] = truths["wiener"]  # the sum of its slices is the first-order kernel as well
    bands = dict.fromkeys(names, 1.0)
    for width in widths:
        scores: dict[str, list[float]] = {name: [] for name in names}
        for _ in range(_DRAWS):
            error2 = std2 * _field(rng, (lags, lags), width)
            error2 = np.triu(error2) + np.triu(error2, 1).T
            noisy1 = kernel1
            if kernel1 is not None and std1 is not None:
                noisy1 = kernel1 + std1 * _field(rng, (lags,), width)
            for name in names:
                noisy2 = truths[name] + error2
                if name == "wiener":
                    scores[name].append(_wiener(noisy1, noisy2))
                elif name == "hammerstein":
                    scores[name].append(_hammerstein(noisy1, noisy2))
                elif noisy1 is not None:
                    scores[name].append(_cosine(noisy2.sum(axis=0), noisy1))
        for name in names:
            bands[name] = min(bands[name], float(np.quantile(scores[name], _LEVEL)) - _TOLERANCE)
    return bands


def _of_size(pattern: Array, size: float) -> Array:
    return np.asarray(pattern * size / np.linalg.norm(pattern))


def _smoothness(kernel: Array) -> float:
    """Return the width, in lags, of the Gaussian filter that makes white noise as smooth as a kernel (L,)."""
    neighbours = float(kernel[1:] @ kernel[:-1]) / float(kernel @ kernel)
    neighbours = min(max(neighbours, 1e-6), 0.999)  # exp(-1 / (4 width^2)) for smoothed white noise
    return float(np.sqrt(-0.25 / np.log(neighbours)))


def _field(rng: np.random.Generator, shape: tuple[int, ...], width: float) -> Array:
    """Return unit-variance Gaussian errors of a shape, independent or smoothed by a width in lags."""
    white = rng.standard_normal(shape)
    if width < 0.3:
        return white
    smooth = ndimage.gaussian_filter(white, width, mode="wrap")
    return np.asarray(smooth / np.std(smooth))


def _side_lobes(kernel2: Array) -> float:
    """Return the largest value with the sign opposite to the peak, relative to the peak."""
    peak = kernel2.flat[int(np.argmax(np.abs(kernel2)))]
    return float(max(0.0, np.max(-np.sign(peak) * kernel2)) / abs(peak)) if peak != 0.0 else 0.0
