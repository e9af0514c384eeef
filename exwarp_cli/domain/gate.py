"""The gate: a network makes frames only where it makes this shot's own key frames better."""

from __future__ import annotations

import math
from dataclasses import dataclass

BLOCK = 8
"""Key intervals that one trial decides for."""

NOTHING = "no trial"


@dataclass(frozen=True)
class Trial:
    """What predicting a rendered key frame by two methods showed.

    Attributes
    ----------
    frame
        Input number of the key frame that was predicted; None where none could be.
    cheap_db, dear_db
        PSNR of the predictions by warping and by a network, dB: of `causal`; between key frames the
        mean of their tiles' PSNR, see `exwarp_cli.pipeline.gate`. None where nothing was predicted.
    """

    frame: int | None = None
    cheap_db: float | None = None
    dear_db: float | None = None

    @property
    def pays(self) -> bool:
        """True if the network's prediction was the better one."""
        if self.cheap_db is None or self.dear_db is None:
            return False
        return self.dear_db > self.cheap_db

    @property
    def text(self) -> str:
        """Return the trial on one line: ``1005 34.2011 34.3560``, or ``no trial``."""
        if self.frame is None:
            return NOTHING
        return f"{self.frame} {self.cheap_db:.4f} {self.dear_db:.4f}"

    @classmethod
    def parsed(cls, text: str) -> Trial:
        """Read `text` again; raises ValueError when it is no such text."""
        if text == NOTHING:
            return cls()
        frame, cheap, dear = text.split(" ")
        return cls.measured(int(frame), float(cheap), float(dear))

    @classmethod
    def measured(cls, frame: int, cheap_db: float, dear_db: float) -> Trial:
        """Return a trial whose values are rounded as `text` keeps them.

        So a run that resumes decides by what the header of its frames says.
        """
        if math.isnan(cheap_db) or math.isnan(dear_db):
            raise ValueError(f"a trial of {cheap_db} and {dear_db} dB")
        return cls(frame, round(cheap_db, 4), round(dear_db, 4))
