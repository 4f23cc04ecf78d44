"""Run all benchmarks of the package, or the named ones, and print one table. Status 1 if a target is missed."""

from __future__ import annotations

import importlib
import pkgutil
import sys
from typing import Any

from rich.console import Console
from rich.table import Table

import benchmarks
from benchmarks.base import Comparison, Latency, run, run_latency


def collected(names: list[str], kind: str) -> list[Any]:
    """Collect ``comparisons()`` or ``latencies()`` from every module whose name begins with ``bench_``."""
    found: list[Any] = []
    for module in pkgutil.iter_modules(benchmarks.__path__):
        if module.name.startswith("bench_") and (not names or module.name.removeprefix("bench_") in names):
            found += getattr(importlib.import_module(f"benchmarks.{module.name}"), kind, list)()
    return found


def main() -> int:
    console = Console(width=140 if not sys.stdout.isatty() else None)
    passed = ratios(console, collected(sys.argv[1:], "comparisons"))
    return 0 if percentiles(console, collected(sys.argv[1:], "latencies")) and passed else 1


def percentiles(console: Console, latencies: list[Latency]) -> bool:
    """Time single calls and print their percentiles; return False if a target is missed."""
    if not latencies:
        return True
    columns = ("50 %", "99 %", "99.9 %")
    table = Table("one call, us", "setting", *(f"plain {c}" for c in columns), *columns, "target", "difference")
    passed = True
    for latency in latencies:
        outcome = run_latency(latency)
        passed &= outcome.passed
        table.add_row(
            latency.title,
            latency.setting,
            *(f"{1e6 * seconds:.1f}" for seconds in (*outcome.plain_s, *outcome.product_s)),
            ("" if latency.limit_s is None else f"{1e6 * latency.limit_s:g}") + ("" if outcome.passed else " !"),
            "" if latency.tolerance is None else f"{outcome.difference:.1e}",
        )
    console.print(table)
    return passed


def ratios(console: Console, comparisons: list[Comparison]) -> bool:
    """Time two implementations of each comparison and print the ratios; return False if a target is missed."""
    if not comparisons:
        return True
    table = Table("benchmark", "setting", "plain, ms", "here, ms", "ratio", "target", "difference")
    passed = True
    for comparison in comparisons:
        outcome = run(comparison)
        passed &= outcome.passed
        promised = "" if comparison.floor is None else f"{comparison.floor:g}"
        table.add_row(
            comparison.title,
            comparison.setting,
            f"{1e3 * outcome.plain_s:.2f}",
            f"{1e3 * outcome.product_s:.2f}",
            f"{outcome.ratio:.1f}" + ("" if outcome.passed else " !"),
            promised,
            f"{outcome.difference:.1e}",
        )
    console.print(table)
    return passed


if __name__ == "__main__":
    sys.exit(main())
