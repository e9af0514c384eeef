"""What generated frames of footage without vectors are made by: estimated motion, and videos."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING

from exwarp_cli.domain.frame import GBuffer, KeyFrame, Window, place_on_canvas, require_canvas
from exwarp_cli.domain.settings import UpsampleSettings
from exwarp_cli.domain.timeline import Slot
from exwarp_cli.errors import LayoutError, UsageError
from exwarp_cli.io.footage import digest_of, is_plain, look_of, own_rate
from exwarp_cli.io.layers import BEAUTY
from exwarp_cli.io.video import VideoLook, video_note
from exwarp_cli.pipeline.recipes import Recipes, key_recipe
from exwarp_cli.pipeline.source import Source
from exwarp_cli.synthesis.holds import stands_one_way
from exwarp_cli.synthesis.methods import Method
from exwarp_cli.synthesis.optical_flow import Flow, estimate, moving

if TYPE_CHECKING:
    from exwarp_cli.pipeline.frame_writer import OutputPlan
    from exwarp_cli.pipeline.rendered_frames import RenderedFrames

BY_EXWARP = "ExWarp"
"""How the comment of every written video begins."""


def require_able(source: Source, method: Method, settings: UpsampleSettings) -> None:
    """Refuse before any work what cannot be done without AOVs.

    Raises
    ------
    LayoutError
        When the method wants vectors or surfaces.
    UsageError
        When layers of a video or of stills are asked for.
    """
    pattern, plain = source.keys.sequence.pattern, is_plain(source.keys.sequence)
    if plain and settings.layers != BEAUTY:
        raise UsageError(f"--layers is for EXR, and {pattern} has colour alone; leave it out")
    if not source.estimated:
        return
    problem = f"{pattern} has no motion vectors that are recognised; render the motion pass"
    if method.extrapolates:
        if not plain:
            raise LayoutError(f"{problem}, or use --method softsplat, for which it is estimated")
        raise LayoutError(
            f"--method {method.name} goes by depth, normals and materials, and {pattern} has "
            "colour alone; use --method softsplat or s6"
        )


def video_look(source: Source, keys: tuple[int, ...], note: str = "") -> VideoLook:
    """Return what a video of some key intervals is like, with the input's sound if it has one.

    Parameters
    ----------
    source
        The input.
    keys
        Indices of the key frames that are written. Sound goes along with those that lie side by
        side, as cut up it would be of no use; and where the rate is the input's own.
    note
        What the video says of itself.
    """
    timeline = source.timeline
    first, last = keys[0], keys[-1]
    shown = [slot for slot in timeline.slots_of(first)] or [Slot(first, 0)]
    begin = first + timeline.time(shown[0])
    end: Fraction | None = Fraction(last + 1)
    if last == len(timeline.numbers) - 1:
        end = None
    own, apart = own_rate(source.keys.sequence), None
    if last - first + 1 != len(keys):
        apart = "the key frames that are written do not follow each other"
    elif own is not None and source.fps != own:
        apart = f"--fps {float(source.fps):g} is not its own rate of {float(own):g}"
    return look_of(source.keys, begin, end, note, apart)


def note_of(
    recipes: Recipes,
    settings: UpsampleSettings,
    keys: tuple[int, ...],
    rendered: RenderedFrames | None = None,
) -> str:
    """Digest what a video depends on that is written alone; it keeps that as its comment.

    "" where it may lack something whose files are as they were: it is made again then.
    """
    if settings.source.keep_going:
        return ""
    source = recipes.source
    count = len(source.timeline.numbers)
    instants: list[Slot] = []
    if source.slots is not None:
        instants = [slot for key in range(count) for slot in source.timeline.between(key)]
    found = {
        "frames": recipes.of(keys[0], range(count), instants),
        # Needed as "frames" is empty where no frame is made after the first key frame.
        "key": key_recipe(source.keys, source.timeline.numbers[keys[0]]),
        "keys": list(keys),
        "exposure": settings.exposure,
        "tail": settings.source.tail,
        "cuts": repr(source.cuts),
    }
    if rendered is not None:
        sequence = rendered.sequence
        found["rendered"] = [[n, digest_of(sequence, n)] for n in sequence.numbers]
    look = video_look(source, keys)
    if look.pixel_aspect != 1 or look.primaries is not None:
        found["look"] = [str(look.pixel_aspect), repr(look.primaries)]
    digest = hashlib.sha256(json.dumps(found, sort_keys=True).encode()).hexdigest()
    return f"{BY_EXWARP} {digest}"


def is_kept(targets: OutputPlan, settings: UpsampleSettings, note: str) -> bool:
    """Whether a video that is written alone is there already, as this run would make it."""
    wanted = settings.skip_existing and settings.ground_truth is None
    if not (wanted and note) or targets.frames is not None or targets.video is None:
        return False
    return video_note(targets.video) == note


class Estimates:
    """Key frames and the flows between neighbouring ones; each is read and estimated once.

    A flow depends on its two frames alone, so any part of a sequence finds the same.

    Parameters
    ----------
    read
        Called with the index of a key frame; reads its colour.
    count
        Number of key frames.
    lost
        Whether a key frame cannot be read, by its index: none moves towards it.
    """

    def __init__(
        self,
        read: Callable[[int], KeyFrame],
        count: int,
        lost: Callable[[int], bool] = lambda key: False,
    ) -> None:
        self._read = read
        self._count = count
        self._lost = lost
        self._frames: dict[int, KeyFrame] = {}
        self._flows: dict[int, tuple[Flow, Flow]] = {}

    def frame(self, key: int) -> KeyFrame:
        """Return a key frame, colour alone."""
        if key not in self._frames:
            self._frames[key] = replace(self._read(key), gbuffer=None)
        return self._frames[key]

    def flowing(self, key: int) -> KeyFrame:
        """Return a key frame with all that was estimated, as cuts are found by it."""
        frame = self.frame(key)
        flows = self._to_previous(key), self._to_next(key)
        back, ahead = (None if flow is None else flow.motion for flow in flows)
        window = frame.image.data_window
        return replace(frame, gbuffer=GBuffer(window, to_previous=back, to_next=ahead))

    def moving(self, key: int, back: bool, ahead: bool, before: bool = False) -> KeyFrame:
        """Return a key frame for synthesis.

        Where the picture stands towards one neighbour and moves towards the other, the motion
        between them is no parabola, and what fits the repeated picture best is no motion. Then the
        flow across the interval counts alone.

        Parameters
        ----------
        key
            Its index.
        back, ahead
            Whether the key frames before and after it may tell how it moves.
        before
            True for the interval before the key frame, False for the one after it.
        """
        to_previous = self._to_previous(key) if back else None
        to_next = self._to_next(key) if ahead else None
        both = None if to_previous is None or to_next is None else (to_previous, to_next)
        if both is not None and stands_one_way(*(flow.motion for flow in both)):
            to_previous, to_next = (to_previous, None) if before else (None, to_next)
        return moving(self.frame(key), to_previous, to_next)

    def forget(self, oldest: int) -> None:
        """Drop what no key frame from one on needs."""
        self._frames = {i: frame for i, frame in self._frames.items() if i >= oldest}
        self._flows = {i: pair for i, pair in self._flows.items() if i >= oldest - 1}

    def _to_previous(self, key: int) -> Flow | None:
        return self._between(key - 1)[1] if key > 0 and not self._lost(key - 1) else None

    def _to_next(self, key: int) -> Flow | None:
        leads = key + 1 < self._count and not self._lost(key + 1)
        return self._between(key)[0] if leads else None

    def _between(self, key: int) -> tuple[Flow, Flow]:
        """Return the flows from a key frame to the next, and back."""
        if key not in self._flows:
            images = self.frame(key).image, self.frame(key + 1).image
            windows = images[0].data_window, images[1].data_window
            canvas = windows[0].union(windows[1])
            require_canvas(f"frame {self.frame(key).number} and the next one", canvas)
            there, back = estimate(*(image.on(canvas).pixels for image in images))
            self._flows[key] = _on(there, canvas, windows[0]), _on(back, canvas, windows[1])
        return self._flows[key]


def _on(flow: Flow, canvas: Window, window: Window) -> Flow:
    """Return the part of a flow over the window of its frame."""
    return Flow(
        place_on_canvas(flow.motion, canvas, window), place_on_canvas(flow.mismatch, canvas, window)
    )
