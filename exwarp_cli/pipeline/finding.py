"""Finding what options name: the method, its networks and policy, and ground truth."""

from __future__ import annotations

import math
from collections import abc
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from exwarp_cli.domain.frame import Image, UInt8
from exwarp_cli.domain.settings import SourceSettings, UpsampleSettings
from exwarp_cli.domain.tiles import TILE_STATE
from exwarp_cli.domain.timeline import FACTOR, Slot, Timeline
from exwarp_cli.errors import InputError, LayoutError, UsageError
from exwarp_cli.io.display_colour import to_display
from exwarp_cli.io.footage import find_frames, read_display_window, read_sequence_picture
from exwarp_cli.io.sequence import Sequence
from exwarp_cli.io.soundness import first_of
from exwarp_cli.io.views import expand
from exwarp_cli.pipeline.source import FrameOf, Source, align
from exwarp_cli.synthesis.methods import CAUSAL, EXWARP, FRAMEWISE, METHODS, Judge, Method

if TYPE_CHECKING:
    from exwarp_cli.io.interpolator import OnnxInterpolator
    from exwarp_cli.io.lookahead_network import OnnxLookAhead
    from exwarp_cli.io.models import OnnxExtrapolator
    from exwarp_cli.io.policy_files import PolicyFile


def find_method(name: str | None, causal: bool = False) -> Method:
    """Return a method by name, or the default.

    Parameters
    ----------
    name
        As on the command line; None where none is named.
    causal
        Whether no frame may be made of a later key frame.

    Raises
    ------
    UsageError
        When there is no such method, or it looks ahead and must not.
    """
    if name in (None, EXWARP):
        return METHODS[CAUSAL if causal else EXWARP]
    if name not in METHODS:
        raise UsageError(f"--method {name} is not one of {', '.join(METHODS)}")
    if causal and METHODS[name].lookahead:
        raise UsageError(
            f"--causal keeps to past key frames, and --method {name} uses the next one, too; leave "
            "out one of the two"
        )
    return METHODS[name]


def find_network(settings: UpsampleSettings, method: Method) -> OnnxExtrapolator | None:
    """Load the network that a method needs; None for methods that do not extrapolate.

    Raises
    ------
    UsageError
        When options ask for a network that the method would not use.
    InputError, MissingExtraError
        When the network cannot be used.
    """
    # Refuse options of networks that the method does not run.
    extrapolating = [m for m in METHODS.values() if m.extrapolates]
    interpolating = [m for m in METHODS.values() if m.interpolates or m.weighs]
    either = [m for m in METHODS.values() if m.runs_network]
    other_device = settings.device != UpsampleSettings.device
    rules = (
        ("--extrapolator", settings.extrapolator is not None, "extrapolate", extrapolating),
        ("--interpolator", settings.interpolator is not None, "interpolate so", interpolating),
        ("--device", other_device, "run a network", either),
    )
    for option, given, what, users in rules:
        if given and method not in users:
            names = ", ".join(user.name for user in users)
            raise UsageError(
                f"{option} is for methods that {what}, and --method {method.name} does not; "
                f"leave it out, or use {'one of ' if len(users) > 1 else ''}{names}"
            )
    if not method.extrapolates:
        return None
    from exwarp_cli.io.models import load_extrapolator

    path = None if settings.extrapolator is None else Path(settings.extrapolator)
    return load_extrapolator(path, settings.threads, settings.device)


def find_interpolator(
    settings: UpsampleSettings, method: Method
) -> OnnxInterpolator | OnnxLookAhead | None:
    """Load the network that a method interpolates with, or weighs key frames with.

    None for methods that do without.

    Raises
    ------
    UsageError
        When none is named.
    InputError, MissingExtraError
        When it or its card cannot be used.
    """
    if method.weighs:
        from exwarp_cli.io.lookahead_network import load_lookahead

        path = None if settings.interpolator is None else Path(settings.interpolator)
        return load_lookahead(path, settings.threads, settings.device)
    if not method.interpolates:
        return None
    if settings.interpolator is None:
        raise UsageError(
            f"--method {method.name} has no network of its own; name an ONNX file with "
            "--interpolator, or use --method softsplat"
        )
    from exwarp_cli.io.interpolator import load_interpolator

    return load_interpolator(Path(settings.interpolator), settings.threads, settings.device)


def find_policy(settings: UpsampleSettings, method: Method) -> PolicyFile | None:
    """Load the policy that a method asks; None for methods that ask none.

    Raises
    ------
    UsageError
        When options name a policy that the method would not ask.
    InputError
        When it cannot be used.
    """
    if method.judge is Judge.TILES:
        from exwarp_cli.io.policy_files import (
            PAPER,
            SHIPPED_POLICY,
            SHIPPED_TILE_POLICY,
            load_policy,
        )

        if settings.policy == PAPER:
            return require_state(load_policy(None, SHIPPED_POLICY))
        path = None if settings.policy is None else Path(settings.policy)
        return require_state(load_policy(path, SHIPPED_TILE_POLICY))
    if settings.policy is not None:
        raise UsageError(
            f"--policy is for --causal, and --method {method.name} asks no policy; leave it out"
        )
    return None


def method_of(method: Method, policy: PolicyFile | None, settings: UpsampleSettings) -> Method:
    """Return a method as its policy decides: for whole frames, or tile by tile.

    Raises
    ------
    UsageError
        For ``--effort`` where no policy decides tile by tile.
    """
    by_tiles = policy is not None and policy.of_tiles
    if settings.effort is not None and not by_tiles:
        chooser = (
            "--policy chooses for whole frames" if policy else f"{method.name} chooses nothing"
        )
        raise UsageError(
            f"--effort is for --causal with a policy of tiles, and {chooser}; leave it out"
        )
    return method if policy is None or by_tiles else FRAMEWISE


def require_state(policy: PolicyFile) -> PolicyFile:
    """Refuse a policy that was trained on other inputs than a state has."""
    from exwarp_cli.policy.state import INPUTS, STATE_VERSION

    inputs, version = policy.network.sizes[0], policy.metadata.get("state")
    if inputs != INPUTS or version not in (STATE_VERSION, TILE_STATE):
        raise LayoutError(
            f"{policy.path} takes {inputs} inputs of version {version!r}, and a state has {INPUTS} "
            f"of version {STATE_VERSION}, or of {TILE_STATE!r} for tiles; train the policy again"
        )
    return policy


def require_truth(settings: UpsampleSettings, method: Method) -> None:
    """Refuse an oracle without ground truth."""
    if method.needs_truth and settings.ground_truth is None:
        raise UsageError(
            f"--method {method.name} decides by ground truth; give it with --ground-truth, or use "
            "--causal"
        )


def require_gate(settings: UpsampleSettings, method: Method) -> None:
    """Refuse ``--no-gate`` for a method without a gate; raises UsageError."""
    if not (settings.gate or method.gated):
        raise UsageError(
            f"--no-gate is for exwarp and --causal, and --method {method.name} has no gate; leave "
            "it out"
        )


def is_usual(source: Source) -> bool:
    """Whether there are decisions: for the paper's factor alone, and along a renderer's motion."""
    return source.timeline.factor == FACTOR and not source.estimated


def require_factor(
    source: Source, method: Method, interpolator: OnnxInterpolator | OnnxLookAhead | None = None
) -> None:
    """Refuse a factor at which a method makes no frames; raises UsageError."""
    timeline = source.timeline
    if not (method.any_factor or is_usual(source)):
        names = ", ".join(other.name for other in METHODS.values() if other.any_factor)
        raise UsageError(
            f"--method {method.name} decides between slots of {FACTOR} times the rate, and "
            f"{float(timeline.factor):g} times are asked for; use one of {names}"
        )
    if interpolator is None:
        return
    times = {timeline.time(slot) for key in range(3) for slot in timeline.between(key)}
    if out := sorted(t for t in times if not interpolator.reaches(t)):
        raise UsageError(
            f"--interpolator {interpolator.name} has no input for the time and makes the middle "
            f"frame only, so it does not reach {out[0]} of a key interval; give "
            "--factor 2, 4 or 8, or a network with an input for the time"
        )


def find_truth(
    spec: str, source: Source, bearable: bool = False, scan: str = SourceSettings.scan
) -> tuple[Sequence, FrameOf]:
    """Find ground truth of any kind, and refuse one of another size before any work.

    Its first frame tells, or where some may be of no use (`bearable`) the first that is of any.
    Where it is certainly at another rate than the output, its frames go to the slots at their
    instants; see `OtherRate`.

    Raises
    ------
    InputError
        When it is not found, has gaps, is of another size, or has no frame at any slot's instant.
    """
    sequence = find_frames(expand(spec, source.keys.view or None)[0], bearable, scan)
    frame_of = align(source.timeline, sequence, "--ground-truth")
    display = source.keys.display

    def require_alike(number: int) -> None:
        window = read_display_window(sequence, number)
        if window.shape != display.shape:
            raise LayoutError(
                f"--ground-truth {sequence.pattern} is {window.width}x{window.height} and the "
                f"input is {display.width}x{display.height}; give one of the same resolution"
            )

    numbers = sequence.numbers
    first_of(numbers if bearable else numbers[:1], require_alike)
    return sequence, _at_its_rate(source, sequence, frame_of)


@dataclass(frozen=True)
class OtherRate:
    """Matches ground truth to slots that is at another rate than the output: by the instant.

    Attributes
    ----------
    timeline
        Of the output.
    numbers
        Of the frames of the ground truth, from the first key frame's on.
    rate
        Frames of it per frame of the output.
    """

    timeline: Timeline
    numbers: tuple[int, ...]
    rate: Fraction

    def __call__(self, slot: Slot) -> int | None:
        """Return the number of a slot's frame; None where it has none."""
        place = self.timeline.order(slot) * self.rate
        there = place.denominator == 1 and place < len(self.numbers)
        return self.numbers[int(place)] if there else None

    @property
    def note(self) -> str:
        """What is said of it."""
        scored = "each new frame is scored against the frame of its own instant"
        if self.rate.denominator > 1:
            scored = "new frames at whose instant it has none are not scored"
        return (
            f"--ground-truth has {float(self.timeline.factor * self.rate):g} frames for each key "
            f"frame and the output {float(self.timeline.factor):g}, as the pictures show: {scored}"
        )


def _at_its_rate(source: Source, sequence: Sequence, frame_of: FrameOf) -> FrameOf:
    """Return what matches ground truth to slots at the rate that its pictures show."""
    timeline, keys = source.timeline, source.keys
    first = frame_of(Slot(0, 0))
    numbers = tuple(n for n in sorted(sequence.numbers) if first is not None and n >= first)
    shown = {
        timeline.order(Slot(k, 0)): k for k in range(len(timeline.numbers)) if timeline.shows(k)
    }
    rate = truth_rate(
        sorted(shown),
        math.ceil(len(timeline.numbers) * timeline.factor),
        len(numbers),
        lambda place: read_sequence_picture(
            keys.sequence, timeline.numbers[shown[place]], keys.view
        ),
        lambda place: read_sequence_picture(sequence, numbers[place], keys.view),
    )
    if rate == 1:
        return frame_of
    found = OtherRate(timeline, numbers, rate)
    made = (slot for key in range(len(timeline.numbers)) for slot in timeline.made_of(key))
    if all(found(slot) is None for slot in made):
        raise InputError(
            f"--ground-truth {sequence.pattern} has {float(timeline.factor * rate):g} frames for "
            f"each key frame and the output {float(timeline.factor):g}, so none is of a new "
            f"frame's instant; give a sequence at {float(source.output_fps):g} fps"
        )
    return found


MOST = 8
"""Largest numerator and denominator of a rate."""

USUAL = tuple(Fraction(a, b) for a, b in ((2, 1), (3, 1), (4, 1), (1, 2), (1, 3), (1, 4)))
"""Rates that are tried where the length fits none."""

ANCHORS = 3
"""Frames of the output that are compared, at most."""

CLEAR = 0.75
"""Share of the error at one frame per frame below which another rate is certain. Where nothing
moves, or noise is all that differs, it is not reached."""

Read = Callable[[int], Image]
"""Gives the frame at a position from 0; raises InputError where it cannot be read."""


def truth_rate(
    outputs: abc.Sequence[int], count: int, truth: int, of_output: Read, of_truth: Read
) -> Fraction:
    """Return how many frames a true sequence has per frame of the output; 1 unless it is certain.

    Both begin at the same instant. A length that fits is believed without looking.

    Parameters
    ----------
    outputs
        Positions of output frames that are rendered, ascending, from 0: their truth is the same
        picture. Also others will do, if less surely.
    count
        Length of the output, with frames past the last key frame.
    truth
        Length of the true sequence.
    of_output, of_truth
        Read a frame of either.
    """
    last = outputs[-1] if outputs else 0
    if last < truth <= count:
        return Fraction(1)
    output = cache(lambda place: _shown(of_output(place)))

    def remaining(rate: Fraction) -> float:
        """Return the error at a rate as a share of that at one frame per frame."""
        places = _anchors(outputs, rate, truth)
        known = sum(_difference(output(p), _shown(of_truth(p))) for p in places)
        if not known:
            return math.inf
        return sum(_difference(output(p), _shown(of_truth(int(p * rate)))) for p in places) / known

    try:
        share, rate = min((remaining(r), r) for r in _fitting(last, count, truth) or USUAL)
    except (InputError, ValueError):  # it is said when the frame's turn comes
        return Fraction(1)
    return rate if share < CLEAR else Fraction(1)


def _fitting(last: int, count: int, truth: int) -> tuple[Fraction, ...]:
    """Return the rates at which a true sequence of a length ends where the output does."""
    rates = {Fraction(a, b) for a in range(1, MOST + 1) for b in range(1, MOST + 1)}
    return tuple(
        rate for rate in sorted(rates - {1}) if last * rate + 1 <= truth <= math.ceil(count * rate)
    )


def _anchors(outputs: abc.Sequence[int], rate: Fraction, truth: int) -> list[int]:
    """Choose frames, far apart, that have a truth at one frame per frame and at another rate."""
    able = [
        p for p in outputs if p and p < truth and p * rate < truth and (p * rate).denominator == 1
    ]
    return sorted(
        {able[round(i * (len(able) - 1) / (ANCHORS - 1))] for i in range(ANCHORS)} if able else ()
    )


def _shown(image: Image) -> UInt8:
    return to_display(image.on(image.display_window).pixels)


def _difference(one: UInt8, other: UInt8) -> float:
    return float(np.abs(one.astype(np.int16) - other).mean())
