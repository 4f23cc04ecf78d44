"""Run every benchmark of the package, or those named, and print one table. Status 1 when a promise is not kept."""

from __future__ import annotations

import importlib
import pkgutil
import sys

from rich.console import Console
from rich.table import Table

import benchmarks
from benchmarks.base import Comparison, run


def comparisons(names: list[str]) -> list[Comparison]:
    """Collect ``comparisons()`` from every module whose name begins with ``bench_``."""
    found: list[Comparison] = []
    for module in pkgutil.iter_modules(benchmarks.__path__):
        if module.name.startswith("bench_") and (not names or module.name.removeprefix("bench_") in names):
            found += importlib.import_module(f"benchmarks.{module.name}").comparisons()
    return found


def main() -> int:
    table = Table("benchmark", "setting", "plain, ms", "here, ms", "times faster", "promised", "differ by")
    kept = True
    for comparison in comparisons(sys.argv[1:]):
        outcome = run(comparison)
        kept &= outcome.kept
        promised = "" if comparison.floor is None else f"{comparison.floor:g}"
        table.add_row(
            comparison.title,
            comparison.setting,
            f"{1e3 * outcome.plain_s:.2f}",
            f"{1e3 * outcome.product_s:.2f}",
            f"{outcome.ratio:.1f}" + ("" if outcome.kept else " !"),
            promised,
            f"{outcome.difference:.1e}",
        )
    Console(width=140 if not sys.stdout.isatty() else None).print(table)
    return 0 if kept else 1


if __name__ == "__main__":
    sys.exit(main())
