"""One text, three builds: serial, parallel and interpreted give the same numbers."""

from __future__ import annotations

import importlib
import pkgutil

import numpy as np
import pytest

from exwarp_cli import kernels
from exwarp_cli.kernels._compile import ParallelKernel
from tests.matrix import spread
from tests.unit import kernel_calls as calls
from tests.unit import kernel_cases as cases
from tests.unit.all_kernel_cases import CASES, run_all
from tests.unit.interpreted import same_when_interpreted


def test_every_kernel_with_threads_has_a_case():
    modules = [
        importlib.import_module(f"exwarp_cli.kernels.{module.name}")
        for module in pkgutil.iter_modules(kernels.__path__)
    ]
    kernels_with_threads = {
        name
        for module in modules
        for name, value in vars(module).items()
        if not name.startswith("_")
        and isinstance(value, ParallelKernel)
        and value.__module__ == module.__name__
    }
    # These run two kernels each.
    assert kernels_with_threads | {"blend", "find_fringe"} == set(CASES)


@pytest.mark.parametrize("name", CASES)
def test_serial_and_parallel_agree_bit_for_bit(name):
    for serial, parallel in zip(CASES[name](True), CASES[name](False), strict=True):
        assert serial.tobytes() == parallel.tobytes()
        assert serial.dtype == parallel.dtype


@pytest.mark.parametrize("name", CASES)
def test_a_second_run_gives_the_same_bytes(name):
    for first, second in zip(CASES[name](False), CASES[name](False), strict=True):
        assert first.tobytes() == second.tobytes()


@pytest.mark.parametrize("name", spread(["gather", "follow", "splat", "find_edges", "fringe"], 2))
def test_views_of_any_layout_give_the_same(name):
    def view(array: np.ndarray) -> np.ndarray:
        """The same values, as columns of a wider array."""
        wide = np.zeros((array.shape[0], 2 * array.shape[1] + 1, *array.shape[2:]), array.dtype)
        wide[:, 1::2] = array
        return wide[:, 1::2]

    kernel, arrays = {
        "gather": (calls.gathered, (cases.image(1), cases.field(1))),
        "follow": (calls.followed, (cases.field(2), cases.field(3), cases.field(4))),
        "splat": (calls.splatted, (cases.field(2), cases.depth(2))),
        "find_edges": (calls.edges_found, (cases.depth(15), cases.ids(15))),
        "fringe": (calls.fringe_found, (cases.field(18), cases.depth(18), cases.depth(19))),
    }[name]
    found = kernel(*map(view, arrays), serial=True)
    for one, other in zip(found, kernel(*arrays, serial=True), strict=True):
        np.testing.assert_array_equal(one, other)


def test_compiled_and_interpreted_agree(tmp_path):
    # Numpy scalars warn of NaN, where compiled code just computes.
    same_when_interpreted(
        *("tests.unit.all_kernel_cases", tmp_path / "found.npz", run_all(serial=True)),
        "RuntimeWarning",
    )
