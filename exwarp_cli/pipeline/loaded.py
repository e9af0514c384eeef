"""What was read of one key interval: nothing computed yet."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

from exwarp_cli.domain.frame import GBuffer, Image, KeyFrame
from exwarp_cli.io.frame_files import FrameTemplate
from exwarp_cli.pipeline.layer_frames import LayerFrames
from exwarp_cli.synthesis.interval import QUARTERS


@dataclass(frozen=True)
class Older:
    """A key frame before the interval's own.

    Attributes
    ----------
    frame
        As read.
    instants
        With slot G-buffers those on the way to it, without surface: the key frame after it, the
        slots between from the last to the first, and this key frame; motion reaches over one slot.
        Empty in the key setting.
    held
        True if the key frame after this one shows the same picture: nothing moves between them.
    """

    frame: KeyFrame
    instants: tuple[GBuffer, ...]
    held: bool = False


@dataclass(frozen=True)
class Observed:
    """A key frame's instant whose features a policy wants; neither G-buffer has settled motion.

    Attributes
    ----------
    key
        Index of the key frame.
    now
        Its geometry; with slot G-buffers motion reaches over one slot.
    before
        Geometry of the instant before, a key interval or a slot earlier, which may lack vectors and
        ids; None at a shot's first.
    """

    key: int
    now: GBuffer
    before: GBuffer | None


@dataclass(frozen=True)
class Loaded:
    """One key interval as read: nothing computed yet.

    Attributes
    ----------
    key
        Index of the key frame.
    frame, following
        The key frames on both sides; `following` only for look-ahead methods, and not across a
        cut. None where every slot of the interval was found written: nothing has to be computed.
    slots
        G-buffers of the slots after the key frame, empty in the key setting.
    past
        The key frames before in the same shot, the newest first, as far as motion leads back to
        them; only for methods that extrapolate.
    observed
        The key frame's instant, and before it those of older key frames that no interval before
        brought along; only for the policy.
    truth
        Ground truth by slot, where there is some.
    truth_ends
        The same at slot 0 and, counted on as a slot, at the next key frame's instant; only for
        VMAF.
    times
        When the slots are, as in `Interval`.
    template
        What generated frames take over from the key frame's file.
    recipes
        For each slot, what its frame depends on, digested.
    read_ms
        Milliseconds that reading took.
    followed
        Whether a key frame of the same shot comes after it.
    layers
        Those that are written beside the beauty; None where there are none.
    older
        The key frame before, where layers are led on from there.
    views
        The same interval of the other views that are written.
    late
        Returns the interval with what only extrapolation wants, which is read then: the key frame's
        surface, and `past`; None where it is there, or nothing extrapolates.
    again
        Reads `frame` again, of which only colour is here, as the interval before had it as
        `following`; None where all of it is.
    key_digests
        Digest of the key frames' files on both sides, by input number; the next one only for
        look-ahead methods.
    unscored
        Why ground truth of some slots cannot be used, by slot, as far as that is borne.
    region
        Whether the key frame's data window is all of the picture that there is, and slots keep it.
    held
        True if every slot shows the picture of the key frame: the next key frame repeats it, or at
        the end of a shot the key frame itself repeats the one before.
    after_hold
        True if the key frame shows the same picture as the one before it.
    """

    key: int
    frame: KeyFrame | None
    following: KeyFrame | None
    slots: tuple[GBuffer, ...]
    past: tuple[Older, ...]
    observed: tuple[Observed, ...]
    truth: dict[int, Image]
    template: FrameTemplate
    recipes: dict[int, str]
    read_ms: float
    truth_ends: dict[int, Image] = field(default_factory=dict)
    times: tuple[float, ...] = QUARTERS
    followed: bool = True
    layers: LayerFrames | None = None
    older: KeyFrame | None = None
    views: tuple[Loaded, ...] = ()
    late: Callable[[Loaded], Loaded] | None = None
    again: Callable[[], KeyFrame] | None = None
    unscored: dict[int, str] = field(default_factory=dict)
    region: bool = False
    key_digests: dict[int, str] = field(default_factory=dict)
    held: bool = False
    after_hold: bool = False

    def lean(self) -> Loaded:
        """Return the interval without geometry, once it is staged: with raw vectors and positions,
        a key frame takes three times the memory of its colour."""
        return replace(
            self,
            frame=_colour(self.frame),
            following=_colour(self.following),
            slots=(),
            past=tuple(Older(_colour_of(older.frame), (), older.held) for older in self.past),
            observed=(),
            late=None,
            again=None,
        )


@dataclass(frozen=True)
class Unmade:
    """A key interval that is left out, as something of it cannot be used.

    Attributes
    ----------
    key
        Index of the key frame.
    reason
        What is wrong, in a sentence.
    passed
        What the key frame is passed through by; None where it is lost itself.
    """

    key: int
    reason: str
    passed: Loaded | None = None


def _colour(frame: KeyFrame | None) -> KeyFrame | None:
    return None if frame is None else _colour_of(frame)


def _colour_of(frame: KeyFrame) -> KeyFrame:
    return replace(frame, gbuffer=None)
