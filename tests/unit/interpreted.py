"""Kernels run in a fresh interpreter without numba's compiler."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[2]


def same_when_interpreted(
    module: str, target: Path, compiled: Mapping[str, np.ndarray], *ignored: str
) -> None:
    """Judge that a module, run with the path of an .npz to write, finds these arrays there too.

    Warnings are errors, but for the `ignored` ones.
    """
    filters = ["error", *(f"ignore::{name}" for name in ignored)]
    flags = [flag for each in filters for flag in ("-W", each)]
    subprocess.run(
        [sys.executable, *flags, "-m", module, str(target)],
        check=True,
        cwd=ROOT,
        env=os.environ | {"NUMBA_DISABLE_JIT": "1"},
    )
    with np.load(target) as interpreted:
        for name, array in compiled.items():
            np.testing.assert_array_equal(interpreted[name], array, err_msg=name)
