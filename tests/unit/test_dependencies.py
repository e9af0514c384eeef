"""The package uses the public interfaces of its dependencies, but for one named module."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

import exwarp_cli

PACKAGE = Path(exwarp_cli.__file__).parent
EXEMPT = (PACKAGE / "kernels" / "_compile.py",)
"""The module that may use numba's and llvmlite's insides."""

INSIDES = ("numba.core", "numba.extending", "llvmlite")
DOCUMENTED = {"os._exit"}
OWN = {"exwarp_cli", *sys.stdlib_module_names}

SOURCES = {path: path.read_text(encoding="utf-8") for path in sorted(PACKAGE.rglob("*.py"))}


def is_private(name: str) -> bool:
    return name.startswith("_") and not name.endswith("__")


def imported(tree: ast.AST) -> Iterator[str]:
    """Yield the dotted name of everything that is imported."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (name.name for name in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield from (f"{node.module}.{name.name}" for name in node.names)


def is_forbidden(name: str) -> bool:
    parts = name.split(".")
    inside = any(f"{name}.".startswith(f"{start}.") for start in INSIDES)
    return inside or (parts[0] not in OWN and any(map(is_private, parts)))


def defined(tree: ast.AST) -> Iterator[str]:
    """Yield the names that a module defines: functions, classes, variables, attributes, fields."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.name
        elif isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.id if isinstance(node, ast.Name) else node.attr


def private_attributes(tree: ast.AST, own: set[str]) -> Iterator[str]:
    """Yield accesses to private attributes that this package does not define, and getattr's."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and is_private(node.attr):
            chain = ast.unparse(node)
            is_dependency = chain.split(".")[0] in ("numba", "np", "numpy", "click", "rich", "ort")
            if chain not in DOCUMENTED and (node.attr not in own or is_dependency):
                yield chain
        elif isinstance(node, ast.Call) and ast.unparse(node.func) in ("getattr", "setattr"):
            name = node.args[1]
            if isinstance(name, ast.Constant) and is_private(str(name.value)):
                yield ast.unparse(node)


def violations(sources: dict[Path, str]) -> list[str]:
    trees = {path: ast.parse(text) for path, text in sources.items()}
    own = {name for path, tree in trees.items() if path not in EXEMPT for name in defined(tree)}
    return [
        f"{path.name}: {name}"
        for path, tree in trees.items()
        if path not in EXEMPT
        for name in (
            *filter(is_forbidden, imported(tree)),
            *private_attributes(tree, own),
        )
    ]


def test_only_two_modules_use_the_insides_of_dependencies():
    assert violations(SOURCES) == []


def test_violations_are_seen():
    text = """
import llvmlite.binding
import numba
from numba.core import types
from numba import extending
from rich._log_render import LogRender
from exwarp_cli.kernels import _compile
self._own = 1
print(self._own, kernel._cache, numba._helperlib, numba.typed)
getattr(kernel, "_compiler")
"""
    assert set(violations({Path("a.py"): text})) == {
        "a.py: llvmlite.binding",
        "a.py: numba.core.types",
        "a.py: numba.extending",
        "a.py: rich._log_render.LogRender",
        "a.py: kernel._cache",
        "a.py: numba._helperlib",
        "a.py: getattr(kernel, '_compiler')",
    }
