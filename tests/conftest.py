"""What holds for all tests."""

from __future__ import annotations

from hypothesis import settings

# A busy machine is no defect: examples may take any time, and are the same ones in every run.
settings.register_profile("exwarp", deadline=None, derandomize=True)
settings.load_profile("exwarp")
