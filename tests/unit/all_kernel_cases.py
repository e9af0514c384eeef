"""A case for every kernel, run in whatever build is asked for; as a script, writes the results.

``python -m tests.unit.all_kernel_cases OUT.npz`` with NUMBA_DISABLE_JIT=1 runs the plain Python
text.
"""

from __future__ import annotations

import sys

import numpy as np

from tests.unit import kernel_cases, slot_kernel_calls
from tests.unit.kernel_cases import ONE_BUILD

CASES = kernel_cases.CASES | slot_kernel_calls.CASES


def run_all(serial: bool) -> dict[str, np.ndarray]:
    """Return every output of every case by name and position."""
    found = {name: case(serial) for name, case in CASES.items()}
    found |= {name: case() for name, case in ONE_BUILD.items()}
    return {
        f"{name}.{i}": array for name, arrays in found.items() for i, array in enumerate(arrays)
    }


if __name__ == "__main__":
    np.savez(sys.argv[1], **run_all(serial=True))
