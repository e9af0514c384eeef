"""How a raster frame's samples are laid out."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

SCRIPT = Path(__file__).parents[2] / "examples" / "scenes" / "stage" / "quality.py"


@pytest.fixture(scope="module")
def quality() -> ModuleType:
    spec = importlib.util.spec_from_file_location("scene_quality", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules[spec.name]


@pytest.mark.parametrize(
    ("samples", "grid", "own"),
    [(1, 1, 1), (4, 1, 4), (9, 3, 1), (25, 5, 1), (36, 3, 4), (100, 5, 4)],
)
def test_samples_form_a_grid_with_one_at_the_centre(quality, samples, grid, own):
    look = quality.Raster(samples)
    assert (look.grid, look.own, look.total, look.denoiser) == (grid, own, samples, "")
    assert look.sampling.startswith(f"grid of {grid} x {grid} samples")


@pytest.mark.parametrize("samples", [2, 16, 24, 64])
def test_other_samples_are_refused(quality, samples):
    with pytest.raises(SystemExit, match=f"not {samples} and 1"):
        _ = quality.Raster(samples).grid
    with pytest.raises(SystemExit, match="not 9 and 2"):
        _ = quality.Raster(9, 2).grid
