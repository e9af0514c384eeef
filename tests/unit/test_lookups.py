"""Functions and types are found as numba finds them, with less of a look."""

from __future__ import annotations

import math
import operator

import numba
import numpy as np
import pytest
from numba.core import base, types
from numba.core.datamodel.manager import DataModelManager
from numba.core.imputils import builtin_registry
from numba.core.lowering import Lower
from numba.core.registry import cpu_target
from numba.core.typing.context import BaseContext

from exwarp_cli.compiled import builds

pytestmark = pytest.mark.usefixtures("uncached")


@pytest.fixture
def typing() -> BaseContext:
    numba.njit(lambda value: np.sqrt(value) + math.floor(value))(2.0)  # all there is, is known
    return cpu_target.typing_context


def test_what_takes_a_place_in_the_source(typing):
    real = base._has_loc.__wrapped__
    written = [function for function, *_ in builtin_registry.functions]
    assert len(written) > 400
    assert [base._has_loc(one) for one in written] == [real(one) for one in written]
    for function, expected in ((lambda loc: 0, True), (lambda loc_of: 0, False), (print, False)):
        assert base._has_loc(function) == real(function) == expected

    def local(value):
        loc = value
        return loc

    assert not base._has_loc(local)


def test_functions_are_typed_as_before(typing):
    real = BaseContext.resolve_value_type.__wrapped__
    for value in (
        max,
        operator.add,
        operator.getitem,
        np.empty,
        math.sqrt,
        np.sqrt,
        3,
        2.5,
        "word",
    ):
        assert typing.resolve_value_type(value) == real(typing, value)
    with pytest.raises(ValueError, match="Cannot determine Numba type"):
        typing.resolve_value_type(lambda: None)


def test_what_may_be_called_is_called(typing):
    kind = typing.resolve_value_type(np.float32)
    assert typing.resolve_getattr(kind, "__call__") is not None
    assert typing.resolve_getattr(typing.resolve_value_type(max), "__call__") is None
    assert builds.compiled(lambda value: np.float32(value))(0.1) == np.float32(0.1)


def test_a_model_is_that_of_its_type():
    models = cpu_target.target_context.data_model_manager
    real = DataModelManager.lookup
    for kind in (types.int64, types.boolean, types.Array(types.float32, 2, "C")):
        assert models[kind] is models.lookup(kind) is real(models, kind)
        assert models.copy()[kind] is not models[kind]


def test_debugging_is_a_matter_of_each_function(monkeypatch):
    seen = {}
    real = Lower.lower

    def lower(self):
        seen[self.func_ir.func_id.func_name] = self._disable_sroa_like_opt
        return real(self)

    monkeypatch.setattr(Lower, "lower", lower)

    def plain(value):
        return value + 1

    def debugged(value):
        return value + 2

    assert builds.compiled(plain)(1) == 2
    assert numba.njit(debugged, debug=True)(1) == 3
    assert not seen["plain"] and seen["debugged"]


class TestBytecode:
    def test_dictionaries_of_many_words(self):
        def look(k):
            found = {
                0: k, 1: 2, 2: 3, 3: 5, 4: 7, 5: 11, 6: 13, 7: 17, 8: 19, 9: 23,
                10: 29, 11: 31, 12: 37, 13: 41, 14: 43, 15: 47, 16: 53, 17: k,
            }  # fmt: skip
            return found[k], len(found)

        assert builds.compiled(look)(16) == (53, 18)

    def test_what_comes_after_a_with_is_reached(self):
        def run(value):
            with numba.objmode(found="int64"):
                found = int(str(value))
            return found + 1

        assert numba.njit(run)(41) == 42

    def test_errors_are_caught_in_loops(self):
        def run(values):
            failed = 0
            for value in values:
                try:
                    if value < 0:
                        raise ValueError
                    failed += 10
                except Exception:
                    failed += 1
            return failed

        assert builds.compiled(run)(np.array([1, -1, -2, 3])) == 22
