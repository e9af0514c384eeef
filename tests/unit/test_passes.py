"""What numba's passes are spared: where there is something to be found, it still is."""

from __future__ import annotations

from functools import reduce
from typing import Any

import numba
import numpy as np
import pytest
from numba.core import event

from exwarp_cli.compiled import builds

pytestmark = pytest.mark.usefixtures("uncached")


def test_functions_inside_functions_are_found():
    def run(values: np.ndarray, factor: float) -> float:
        def scaled(value: float) -> float:
            return factor * value

        return scaled(values[0]) + reduce(lambda a, b: a + b, values)

    assert builds.compiled(run)(np.arange(4.0), 3.0) == 6


def test_lists_become_arrays():
    def run(count: int) -> np.ndarray:
        return np.array([k * k for k in range(count)]) + np.array([1, 2, 3])

    assert builds.compiled(run)(3).tolist() == [1, 3, 7]


def test_stencils_are_found():
    @numba.stencil
    def mean(values):
        return 0.5 * (values[-1] + values[1])

    assert builds.compiled(lambda values: mean(values))(np.arange(5.0) ** 2).tolist() == [
        *(0, 2, 5, 10, 0)
    ]


def test_what_is_left_to_python_is_told_what_lives():
    @numba.jit(forceobj=True)
    def run(values: Any) -> Any:
        total = None
        for value in values:
            total = value if total is None else total + value
        return total

    assert run(("a", "b", "c")) == "abc"


def test_who_listens_is_told_of_every_pass():
    told: list[str] = []

    class Listener(event.Listener):
        def on_start(self, event: Any) -> None:
            told.append(event.data["name"])

        def on_end(self, event: Any) -> None:
            pass

    with event.install_listener("numba:run_pass", Listener()):
        builds.compiled(lambda value: value + 1)(1)
    assert any(name.startswith("native_lowering") for name in told)
