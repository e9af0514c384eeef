"""Every view of a shot at once: the hero decides, and each is made from its own frames."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING

from exwarp_cli.domain.settings import SourceSettings
from exwarp_cli.errors import InputError, UsageError
from exwarp_cli.pipeline.loaded import Loaded, Unmade
from exwarp_cli.pipeline.opening import each_view
from exwarp_cli.pipeline.source import Source, open_source

if TYPE_CHECKING:
    from exwarp_cli.domain.cuts import Cut
    from exwarp_cli.io.nonfinite import NonFinite
    from exwarp_cli.pipeline.early_frames import Beginning
    from exwarp_cli.pipeline.loading import IntervalLoader
    from exwarp_cli.pipeline.recipes import Recipes

Needed = Callable[[int, dict[int, str]], bool]


class JointLoader:
    """Reads an interval of every view; as `IntervalLoader`, whose others are in `Loaded.views`.

    Parameters
    ----------
    leader
        Of the view that decides, where its cuts are found too.
    others
        Of the other views.
    """

    def __init__(self, leader: IntervalLoader, others: tuple[IntervalLoader, ...]) -> None:
        self._leader, self._others = leader, others
        for other in others:
            other.follow(leader)

    @property
    def leading_recipes(self) -> Recipes:
        """What digests the frames of the view that decides."""
        return self._leader.recipe_book

    @property
    def cuts(self) -> tuple[Cut, ...] | None:
        """The cuts that were met so far; None where none are looked for or given."""
        return self._leader.shots.cuts

    @property
    def truth_nonfinite(self) -> NonFinite:
        """What was found in ground truth so far."""
        return self._leader.truth.nonfinite

    def load(self, key: int, needed: Needed) -> Loaded | Unmade:
        """Read an interval; see `IntervalLoader.load`. A frame depends on all its views.

        Where losses are bearable it is read again when it meets one, without what lies behind that.
        """
        losses, told = self._leader.losses, self._leader.told
        if not losses.bearable:
            return self._whole(key, needed)
        while True:
            known = len(losses)
            try:
                return self._whole(key, needed)
            except InputError as error:
                self._leader.told = told  # no interval brought along what this one did
                if len(losses) == known:
                    return self._unmade(key, str(error))

    def _unmade(self, key: int, reason: str) -> Unmade:
        """Leave an interval out, but for its key frame if that is sound."""
        passed, begin = None, time.perf_counter()
        with suppress(InputError):
            passed = self._leader.rendered(key)
            passed = replace(passed, read_ms=1e3 * (time.perf_counter() - begin))
        for loader in (self._leader, *self._others):
            loader.forget(key)
        return Unmade(key, reason, passed)

    def _whole(self, key: int, needed: Needed) -> Loaded:
        if not self._others:
            return self._leader.load(key, needed)
        each = [loader.recipes(key) for loader in (self._leader, *self._others)]
        recipes = {slot: _joined([found[slot] for found in each]) for slot in each[0]}
        loaded = self._leader.load(key, lambda index, _: needed(index, recipes))
        wanted = loaded.frame is not None
        views = tuple(loader.load(key, lambda *_: wanted) for loader in self._others)
        taken = loaded.read_ms + sum(view.read_ms for view in views)
        return replace(loaded, recipes=recipes, views=views, read_ms=taken)


def open_sources(
    settings: SourceSettings,
    motion_needed: bool,
    pictures: bool = False,
    run: Beginning | None = None,
) -> tuple[Source, ...]:
    """Open the view that is asked for; of all views every one, the hero first.

    See :func:`exwarp_cli.pipeline.source.open_source`.

    Raises
    ------
    UsageError
        When all views are asked for, and each has files of its own.
    ExwarpError
        As :func:`exwarp_cli.pipeline.source.open_source` does.
    """
    sources = tuple(open_source(view, motion_needed, pictures, run) for view in each_view(settings))
    leader, *others = sources
    for other in others:
        if other.keys.sequence.files != leader.keys.sequence.files:
            raise UsageError(
                f"--view all writes all views into one file, and here each has its own "
                f"({leader.keys.sequence.pattern}); run once for each: "
                + ", ".join(f"--view {source.keys.view}" for source in sources)
            )
    return sources


def _joined(recipes: list[str]) -> str:
    return hashlib.sha256(" ".join(recipes).encode()).hexdigest()
