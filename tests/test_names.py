"""Names in the program: those that say nothing of a value are not used, and a public class name means one thing."""

import ast
import collections
from pathlib import Path

SOURCE = Path(__file__).parents[1] / "src"
BANNED = frozenset({"found", "one", "place", "known", "words", "left", "people"})
"""Names of values that do not say what the value is (docs/architecture.md)."""
TREES = {path.relative_to(SOURCE): ast.parse(path.read_text(encoding="utf-8")) for path in SOURCE.rglob("*.py")}


def bound_names(tree):
    """The names that a module binds: variables, parameters and annotated fields."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.id
        elif isinstance(node, ast.arg):
            yield node.lineno, node.arg


def test_values_are_named_by_what_they_are():
    assert [
        f"{path}:{line}: {name}" for path, tree in TREES.items() for line, name in bound_names(tree) if name in BANNED
    ] == []


def test_a_public_class_name_means_one_thing():
    classes = collections.defaultdict(list)
    for path, tree in TREES.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                classes[node.name].append(str(path))
    assert {name: paths for name, paths in classes.items() if len(paths) > 1} == {}
