"""The calls of `exwarp` that a farm makes: one a chunk, and those that come after all chunks."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

from exwarp_cli.farm.places import Place

ALONE = ("--isolated",)
"""What keeps a worker's environment, and files of settings there, from changing the job."""

SCORING = ("ground_truth", "metrics")
LAST = ("report_folder", "video")
"""Parameters of `upsample` that are no part of a chunk as they are."""


class Blank(Enum):
    """What is filled in for every chunk."""

    FRAMES = "key frames of the chunk"
    ALL_FRAMES = "key frames of the job"


Word = str | Place | Blank
"""One word of a command line, without the program's name in front."""


@dataclass(frozen=True)
class Given:
    """An option of `upsample`, as the user gave it.

    Attributes
    ----------
    parameter
        Its name in the command.
    flag
        How it is written; "" for the argument.
    value
        None for a flag without value.
    """

    parameter: str
    flag: str
    value: str | Place | None = None

    @property
    def words(self) -> list[Word]:
        """The option in a command line."""
        flag: list[Word] = [self.flag] if self.flag else []
        return flag if self.value is None else [*flag, self.value]


@dataclass(frozen=True)
class FarmJob:
    """A run of `upsample` that is going to be done in chunks.

    Attributes
    ----------
    given
        Argument and options, without those that say which frames, how often and how loudly.
    numbers
        Key frames to do, by their input numbers, ascending.
    size
        Key frames of a chunk.
    title
        Names it for people.
    overwrite
        Whether frames that are there are made again. Else good ones are kept, so that a chunk that
        was killed and is done again goes on.
    judged
        Whether the frames depend on ground truth.
    """

    given: tuple[Given, ...]
    numbers: tuple[int, ...]
    size: int
    title: str
    overwrite: bool = False
    judged: bool = False

    def place(self, parameter: str) -> Place | None:
        """Return what an option names, None where it is not given."""
        return next(
            (
                g.value
                for g in self.given
                if g.parameter == parameter and isinstance(g.value, Place)
            ),
            None,
        )

    @property
    def chunk(self) -> list[Word]:
        """The call that does a chunk."""
        report = self.place("report_folder")
        reported: list[Word] = [] if report is None else ["--report", report, "--as-chunk"]
        again = "--overwrite" if self.overwrite else "--skip-existing"
        given = self._without(LAST)
        return ["upsample", *ALONE, *given, *reported, again, "--frames", Blank.FRAMES]

    @property
    def merging(self) -> list[Word] | None:
        """The call that joins the chunks' reports; None without a report."""
        report = self.place("report_folder")
        return None if report is None else ["merge-reports", *ALONE, report, "--overwrite"]

    @property
    def filming(self) -> list[Word] | None:
        """The call that makes the video of the finished frames, which it keeps; None without."""
        video = self.place("video")
        if video is None:
            return None
        left_out = LAST if self.judged else (*LAST, *SCORING)
        given = self._without((*left_out, "write_holes"))
        again: list[Word] = ["--skip-existing", "--video", video]
        return ["upsample", *ALONE, *given, *again, "--frames", Blank.ALL_FRAMES]

    def _without(self, parameters: Iterable[str]) -> list[Word]:
        return [w for g in self.given if g.parameter not in parameters for w in g.words]
