"""How object ids are read from a Cryptomatte: as a stencil of what moves, or of whatever is shown.

Ids must never pass :func:`exwarp_cli.io.frames.clean_stencil`: they are bits, not numbers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from exwarp_cli.domain.frame import Float32, Int32
from exwarp_cli.io.cryptomatte import Cryptomatte
from exwarp_cli.io.cryptomatte_ids import by_depth, dynamic_stencil, require_sound, surfaces
from exwarp_cli.io.cryptomatte_manifest import Dynamic


@dataclass(frozen=True)
class IdReading:
    """How a shot's ids are read.

    Attributes
    ----------
    cryptomatte
        Where they are.
    rounded
        Whether some of the ids that they are compared with were rounded; see
        :func:`exwarp_cli.io.cryptomatte_ids.surfaces`.
    dynamic
        What moves, as the user names it; None where nothing says so.
    """

    cryptomatte: Cryptomatte
    rounded: bool = False
    dynamic: Dynamic | None = None

    @property
    def identity(self) -> list[Any]:
        """What frames depend on, beside the pixels, as plain data."""
        moving = None if self.dynamic is None else list(self.dynamic.ids)
        return [self.cryptomatte.aov, self.cryptomatte.name, self.rounded, moving]

    def read(
        self, ranks: Float32, depth: Float32 | None, where: object
    ) -> tuple[Int32 | None, Int32 | None]:
        """Return a frame's `GBuffer.stencil` and `GBuffer.objects`: one of them, None the other.

        Parameters
        ----------
        ranks
            float32 [H, W, 4]: id, share, id, share.
        depth
            float32 [H, W], +inf background; None where there is none.
        where
            The file, for messages.

        Raises
        ------
        DamagedFileError
            When the ids were destroyed on their way.
        """
        require_sound(ranks, f"{where}, layer {self.cryptomatte.name!r},")
        if self.dynamic is None:
            ids = surfaces(ranks, self.rounded)
        else:
            ids = dynamic_stencil(ranks, self.dynamic.ids, self.rounded)
        if depth is not None:
            ids = by_depth(ids, depth)
        return (None, ids) if self.dynamic is None else (ids, None)
