"""How the accelerator's arithmetic is compiled: for one thread, and cached."""

from __future__ import annotations

from exwarp_cli.compiled import builds
from exwarp_cli.compiled.builds import Kernel


def compiled(text: Kernel) -> Kernel:
    """Compile on the first call."""
    return builds.compiled(text)


def inlined(text: Kernel) -> Kernel:
    """Have a function compiled into the loops of those that call it."""
    return builds.part(text, forceinline=True)
