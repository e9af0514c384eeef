"""Machine code is made of whole kernels only."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numba.core.callwrapper import PyCallWrapper

from exwarp_cli.compiled import builds, machine_code
from exwarp_cli.compiled.shares import WHOLE
from exwarp_cli.kernels import edges

pytestmark = pytest.mark.usefixtures("uncached")


def test_parts_do_not_become_machine_code(monkeypatch):
    made: list[str] = []
    real = machine_code.DeferredLibrary._make

    def noted(library: Any) -> None:
        if not library._made:
            made.append(library.name)
        real(library)

    monkeypatch.setattr(machine_code.DeferredLibrary, "_make", noted)
    kernel = builds.compiled(edges.find_edges_text)
    depth, edge = np.ones((5, 6), np.float32), np.ones((5, 6), np.bool_)
    depth[:, 3:] = 9
    kernel(depth, np.zeros((0, 0), np.int32), edge, WHOLE)
    assert edge.tolist() == [[False, False, True, True, False, False]] * 5
    assert made == ["find_edges_text"]


def test_entries_are_left_as_they_stand(monkeypatch):
    built: list[str] = []
    real = PyCallWrapper.build

    def noted(self: Any) -> Any:
        entry, api = real(self)
        built.append(str(entry).partition("{")[0])
        return entry, api

    monkeypatch.setattr(PyCallWrapper, "build", noted)
    kernel = builds.compiled(lambda pair, values: pair[0] + pair[1] + values[-1])
    assert kernel((1, 2), np.arange(3)) == 5
    with pytest.raises(TypeError, match="not enough arguments"):
        kernel((1, 2))
    assert len(built) == 1 and "noinline optnone" in built[0]
