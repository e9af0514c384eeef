"""Compilation without repetitions: what is spared, and that all else stays."""

from __future__ import annotations

import ast
import gc
import re
import weakref
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from llvmlite.ir.instructions import Instruction
from llvmlite.ir.values import Argument, Block, Function, NamedValue
from numba.core import compiler, errors, ir
from numba.core.runtime import _nrt_python
from numba.core.runtime.nrt import rtsys

from exwarp_cli.compiled import builds, front_end

pytestmark = pytest.mark.usefixtures("uncached")


def test_a_part_is_compiled_once_for_functions_that_count_arrays_and_others(monkeypatch):
    compiled: list[str] = []
    real = compiler.compile_extra

    def noted(typingctx: Any, targetctx: Any, func: Any, *rest: Any, **named: Any) -> Any:
        compiled.append(func.__name__)
        return real(typingctx, targetctx, func, *rest, **named)

    monkeypatch.setattr(compiler, "compile_extra", noted)

    @builds.part
    def doubled(value: float) -> float:
        return value + value

    @builds.part
    def double_one(values: np.ndarray, i: int) -> None:
        values[i] = doubled(values[i])

    def double_all(values: np.ndarray) -> None:
        values[0] = doubled(values[0])
        for i in range(1, values.size):
            double_one(values, i)

    values = np.arange(5.0)
    builds.compiled(double_all)(values)
    assert values.tolist() == [0, 2, 4, 6, 8]
    assert compiled.count("doubled") == 1


def test_parts_made_after_something_was_compiled_are_found():
    def once(value: float) -> float:
        return value + 1

    assert builds.compiled(once)(1.0) == 2

    @builds.part
    def late(value: float) -> float:
        return 3 * value

    def use(value: float) -> float:
        return late(value)

    assert builds.compiled(use)(2.0) == 6


class TestCollecting:
    """Python looks for unreachable objects rarely while something is compiled."""

    @pytest.fixture
    def seen(self, monkeypatch) -> list[tuple[int, ...]]:
        """Thresholds while code is made."""
        found: list[tuple[int, ...]] = []
        real = compiler.Compiler.define_pipelines

        def noted(self: Any) -> Any:
            found.append(gc.get_threshold())
            return real(self)

        monkeypatch.setattr(compiler.Compiler, "define_pipelines", noted)
        return found

    def test_thresholds_come_back(self, seen):
        before = gc.get_threshold()
        assert builds.compiled(lambda value: value + 1)(1) == 2
        assert [first for first, *_ in seen] == [front_end.RARELY]
        assert gc.get_threshold() == before

    def test_what_is_old_is_not_looked_through(self, seen):
        before = gc.get_threshold()
        gc.set_threshold(front_end.RARELY)  # as the command line does for its imports
        try:
            builds.compiled(lambda value: value + 3)(1)
            assert [rest for _, *rest in seen] == [[front_end.NEVER, front_end.NEVER]]
            assert gc.get_threshold()[0] == front_end.RARELY
        finally:
            gc.set_threshold(*before)

    def test_thresholds_come_back_after_an_error(self, seen):
        before = gc.get_threshold()
        with pytest.raises(errors.TypingError):
            builds.compiled(lambda value: value.nothing)(1)
        assert seen and gc.get_threshold() == before

    def test_who_never_collects_goes_on(self, seen):
        before = gc.get_threshold()
        gc.set_threshold(0)
        try:
            builds.compiled(lambda value: value + 2)(1)
            assert [first for first, *_ in seen] == [0]
            assert gc.get_threshold()[0] == 0
        finally:
            gc.set_threshold(*before)


def test_code_that_llvm_has_read_needs_no_search_to_be_let_go(monkeypatch):
    kinds = (Instruction, Block, Argument, Function)
    made: dict[type, list[weakref.ref]] = {kind: [] for kind in kinds}
    real = NamedValue.__init__

    def noted(self: Any, *rest: Any, **named: Any) -> None:
        for kind in kinds:
            if isinstance(self, kind):
                made[kind].append(weakref.ref(self))
        real(self, *rest, **named)

    monkeypatch.setattr(NamedValue, "__init__", noted)

    @builds.part
    def double_all(values: np.ndarray) -> None:
        for i in range(values.size):
            values[i] = (values[i] + 1) // 2 * 4 if values[i] % 2 == 1 else values[i] * 2

    def run(values: np.ndarray) -> None:
        double_all(values[1:])

    values = np.arange(4.0)
    gc.disable()
    try:
        builds.compiled(run)(values)
        left = {kind: sum(one() is not None for one in made[kind]) for kind in kinds}
    finally:
        gc.enable()
    assert values.tolist() == [0, 4, 4, 8]
    assert len(made[Instruction]) > 100
    assert left[Instruction] < len(made[Instruction]) / 10  # those of what Python calls
    for kind in kinds:
        assert left[kind] < len(made[kind]) / 5, kind.__name__


def test_variables_of_instructions_are_those_that_numba_lists():
    where = ir.Loc("here.py", 1)
    a, b, c = (ir.Var(None, name, where) for name in "abc")
    call = ir.Expr.call(a, (b, 2, "word"), {"x": c, "y": [None, (b,)]}, where)
    assert call.list_vars() == [a, b, c, b]
    assert sorted(v.name for v in ir.Assign(call, a, where).list_vars()) == list("aabbc")
    assert call._rec_list_vars(a) == [a] and call._rec_list_vars(7) == []


def test_operators_of_arrays_are_typed_as_before():
    def mixed(values: np.ndarray, factor: float) -> np.ndarray:
        values += 1
        return -(values * factor) + values

    values = np.arange(4.0)
    expected = -((values + 1) * 3) + values + 1
    assert builds.compiled(mixed)(values, 3.0).tolist() == expected.tolist()


def test_matrices_are_multiplied_though_scipy_was_not_asked_for():
    pytest.importorskip("scipy")
    product = builds.compiled(lambda one, other: np.dot(one, other))
    assert product(np.eye(2), np.ones((2, 3))).tolist() == np.ones((2, 3)).tolist()


def test_generators_still_know_what_lives():
    def squares(count: int) -> Any:
        for k in range(count):
            yield k * k

    assert list(builds.compiled(squares)(4)) == [0, 1, 4, 9]


def test_arrays_are_counted_where_some_are_made():
    @builds.part
    def total(values: np.ndarray) -> float:
        found = 0.0
        for value in values:
            found += value
        return found

    def run(count: int) -> float:
        kept = np.ones(count)
        return total(kept[1:]) + total(kept.reshape(-1)[:1])

    assert builds._counting(run) == {"_nrt": True}
    assert builds._counting(total) == {"_nrt": False}
    compiled = builds.compiled(run)
    _nrt_python.memsys_enable_stats()
    before = rtsys.get_allocation_stats()
    assert compiled(7) == 7
    after = rtsys.get_allocation_stats()
    assert after.alloc - before.alloc == after.free - before.free


NUMBERS = re.compile(r"None|bool|int|float|np\.\w+|tuple\[(?:bool|int|float|np\.\w+|, |\.\.\.)+\]")


def test_parts_that_do_not_count_arrays_return_none():
    """Nobody would own them: an alias is taken for arrays unless it is known for numbers."""
    root = Path(builds.__file__).parents[1]
    seen = 0
    for path in [*(root / "kernels").glob("*.py"), *(root / "accel").glob("*.py")]:
        for node in ast.walk(ast.parse(path.read_text())):
            if not isinstance(node, ast.FunctionDef) or node.returns is None:
                continue
            if not {"part", "inlined"} & {ast.unparse(d) for d in node.decorator_list}:
                continue
            seen += 1
            named = {a.attr for a in ast.walk(node) if isinstance(a, ast.Attribute)}
            counted = bool(named & builds.MAKERS)
            told = ast.unparse(node.returns)
            aliases = {"Columns", "Matrix"}  # of numbers
            assert counted or NUMBERS.fullmatch(told) or told in aliases, f"{path.name} {node.name}"
    assert seen > 100
