"""One text, three builds: serial, parallel and interpreted give the same numbers."""

from __future__ import annotations

import importlib
import os
import pkgutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from exwarp_cli import kernels
from exwarp_cli.kernels.jit import set_threads
from tests.unit.kernel_cases import CASES, run_all

ROOT = Path(__file__).parents[2]


def test_every_pair_of_builds_has_a_case():
    modules = [
        importlib.import_module(f"exwarp_cli.kernels.{module.name}")
        for module in pkgutil.iter_modules(kernels.__path__)
    ]
    pairs = {
        name.removesuffix("_serial")
        for module in modules
        for name in vars(module)
        if name.endswith("_serial") and not name.startswith("_")
    }
    assert pairs == set(CASES)


@pytest.mark.parametrize("name", CASES)
def test_serial_and_parallel_agree_bit_for_bit(name):
    try:
        for threads in (1, None):
            set_threads(threads)
            for serial, parallel in zip(CASES[name](True), CASES[name](False), strict=True):
                assert serial.tobytes() == parallel.tobytes()
                assert serial.dtype == parallel.dtype
    finally:
        set_threads(None)


@pytest.mark.parametrize("name", CASES)
def test_a_second_run_gives_the_same_bytes(name):
    for first, second in zip(CASES[name](False), CASES[name](False), strict=True):
        assert first.tobytes() == second.tobytes()


def test_compiled_and_interpreted_agree(tmp_path):
    target = tmp_path / "interpreted.npz"
    # Numpy scalars warn of NaN, where compiled code just computes.
    flags = ["-W", "error", "-W", "ignore::RuntimeWarning", "-m", "tests.unit.kernel_cases"]
    subprocess.run(
        [sys.executable, *flags, str(target)],
        check=True,
        cwd=ROOT,
        env=os.environ | {"NUMBA_DISABLE_JIT": "1"},
    )
    with np.load(target) as interpreted:
        for name, compiled in run_all(serial=True).items():
            np.testing.assert_array_equal(interpreted[name], compiled, err_msg=name)
