"""What holds for all tests."""

from __future__ import annotations

from hypothesis import settings

# A busy machine is no defect: examples may take any time.
settings.register_profile("exwarp", deadline=None)
settings.load_profile("exwarp")
