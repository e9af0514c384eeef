"""Where what extrapolation works on lies between its steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from exwarp_cli.domain.frame import Float32


@dataclass(frozen=True)
class Memory:
    """How much of a large frame is in memory at a time.

    Attributes
    ----------
    keep
        Returns an array's copy that may leave memory, or the array itself.
    rest
        Called where what may leave is not wanted for a while. It comes back as it is used.
    """

    keep: Callable[[Float32], Float32]
    rest: Callable[[], None]


ALL_OF_IT = Memory(lambda array: array, lambda: None)
"""Everything stays."""
