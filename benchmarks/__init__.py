"""Benchmarks: speed as ratios, measured in one run: ``python -m benchmarks [name ...]``. One file for each benchmark.

Linear algebra runs on one thread, set here before numpy is loaded: on a shared machine, two threads wait for each
other, and the ratio would include this.
"""

import os

for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
