"""Number of threads of the linear algebra during a fit.

The matrices of the engines are small. Threads of OpenBLAS that wait for each other on a busy machine then take ten to
twenty times the processor time of one thread, without a gain. A program sets the environment variable
OPENBLAS_NUM_THREADS before numpy is imported; a library cannot, and limits the threads while a fit runs.
"""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache

import numpy as np
import scipy.linalg

_SYMBOLS = (
    ("scipy_openblas_get_num_threads64_", "scipy_openblas_set_num_threads64_"),
    ("scipy_openblas_get_num_threads", "scipy_openblas_set_num_threads"),
    ("openblas_get_num_threads64_", "openblas_set_num_threads64_"),
    ("openblas_get_num_threads", "openblas_set_num_threads"),
)
"""Names of the two functions in the builds of numpy and scipy, and in OpenBLAS itself."""

_lock = threading.Lock()
_fits = 0
_before: list[int] = []


@lru_cache(maxsize=1)
def _libraries() -> tuple[tuple[Callable[[], int], Callable[[int], None]], ...]:
    """Return the functions that read and set the number of threads, for each OpenBLAS of numpy and scipy.

    The symbols are looked up among the dependencies of two extension modules. Empty for other libraries and where the
    system does not search dependencies (Windows): threads are then not limited.
    """
    accessors = []
    for module in (np.linalg._umath_linalg, scipy.linalg._fblas):  # type: ignore[attr-defined]
        try:
            library = ctypes.CDLL(module.__file__)
        except (OSError, TypeError):
            continue
        for get, put in _SYMBOLS:
            if hasattr(library, get) and hasattr(library, put):
                accessors.append((getattr(library, get), getattr(library, put)))
                break
    return tuple(accessors)


def blas_threads() -> tuple[int, ...]:
    """Return the number of threads of each OpenBLAS in use; empty where it is not known."""
    return tuple(int(get()) for get, _ in _libraries())


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit linear algebra to one thread. The limit holds for the process until the last of concurrent uses ends."""
    global _fits
    with _lock:
        if _fits == 0:
            _before[:] = blas_threads()
            _set([1] * len(_before))
        _fits += 1
    try:
        yield
    finally:
        with _lock:
            _fits -= 1
            if _fits == 0:
                _set(_before)


def _set(numbers: list[int]) -> None:
    for (_, put), number in zip(_libraries(), numbers, strict=True):
        put(number)
