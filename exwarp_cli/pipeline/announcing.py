"""What a run says of itself: messages at its start, and its part of the report."""

from __future__ import annotations

import math
from collections import abc
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

from exwarp_cli.domain.results import (
    InputSummary,
    InterpolatorSummary,
    LeftOut,
    NetworkSummary,
    PolicySummary,
    RunSummary,
)
from exwarp_cli.domain.settings import UpsampleSettings
from exwarp_cli.domain.timeline import RATE_TOLERANCE, Slot, Timeline, ranges
from exwarp_cli.domain.wording import pluralise
from exwarp_cli.errors import IncompleteError
from exwarp_cli.io.channels import Role
from exwarp_cli.io.clip import is_clip
from exwarp_cli.io.cryptomatte_manifest import SHOWN, shown
from exwarp_cli.io.footage import is_plain, lost_alpha, unevenness_of
from exwarp_cli.io.model_files import shipped_folder
from exwarp_cli.io.shot import alpha_left_out
from exwarp_cli.pipeline.contents import Content, files_apart
from exwarp_cli.pipeline.finding import OtherRate
from exwarp_cli.pipeline.frame_writer import frame_suffix
from exwarp_cli.pipeline.opening import step_note
from exwarp_cli.pipeline.progress import Progress
from exwarp_cli.pipeline.without_vectors import video_look

if TYPE_CHECKING:
    from exwarp_cli.io.interpolator import OnnxInterpolator
    from exwarp_cli.io.lookahead_network import OnnxLookAhead
    from exwarp_cli.io.models import OnnxExtrapolator
    from exwarp_cli.io.policy_files import PolicyFile
    from exwarp_cli.io.sequence import Sequence
    from exwarp_cli.pipeline.progress import Progress
    from exwarp_cli.pipeline.source import FrameOf, Source
    from exwarp_cli.synthesis.methods import Method

SURFACE_COLOURS = {Role.ALBEDO: "diffuse", Role.SPECULAR: "glossy"}
"""What `synthesis.modulation` divides by, both together, as the user knows it."""


@dataclass(frozen=True)
class Models:
    """What a run's networks and policy are, for its report; None for what it does without."""

    extrapolator: NetworkSummary | None
    interpolator: InterpolatorSummary | None
    policy: PolicySummary | None

    @classmethod
    def of(
        cls,
        source: Source,
        network: OnnxExtrapolator | None,
        interpolator: OnnxInterpolator | OnnxLookAhead | None,
        policy: PolicyFile | None,
    ) -> Models:
        """Summarise what was loaded."""
        extrapolating = interpolating = None
        if network is not None:
            extrapolating = NetworkSummary(
                str(network.path), network.checksum, network.device, not _missing_colours(source)
            )
        if interpolator is not None:
            interpolating = InterpolatorSummary(
                *(interpolator.name, str(interpolator.path), interpolator.checksum),
                *(interpolator.card_checksum, interpolator.device),
            )
        decided = None if policy is None else _policy_summary(policy, source, network)
        return cls(extrapolating, interpolating, decided)


def announce_models(progress: Progress, models: Models, source: Source) -> None:
    """Say what makes frames and decides, and what it does not see of the input."""
    network, interpolator, policy = models.extrapolator, models.interpolator, models.policy
    if network is not None:
        progress.message(
            f"extrapolation by {Path(network.file).name} (sha256 {network.sha256[:8]}) on "
            f"{network.device}"
        )
        if missing := _missing_colours(source):
            progress.message(
                f"no {' and no '.join(missing)} colour: shading is extrapolated together with "
                "surface colour"
            )
    if interpolator is not None:
        seen = "both key frames, warped" if interpolator.card_sha256 is None else "colour alone"
        progress.message(
            f"interpolation by {interpolator.name}, {Path(interpolator.file).name} (sha256 "
            f"{interpolator.sha256[:8]}) on {interpolator.device}, from {seen}"
        )
    if policy is None:
        return
    progress.message(
        f"decisions by {Path(policy.file).name} (sha256 {policy.sha256[:8]}), 8-bit integers"
    )
    if policy.note is not None:
        progress.message(policy.note)
    if policy.objects_from == "motion":
        progress.message("no object ids: what moves otherwise than the camera counts as an object")
    if policy.objects_from == "cryptomatte" and _dynamic(source) is None:
        progress.message(
            "of the Cryptomatte's objects those count as moving that move otherwise than the camera"
        )
    if policy.missing:
        progress.message(
            f"the policy sees 0 for {', '.join(policy.missing)}, as the AOVs for it are missing"
        )


def other_extrapolator(policy: PolicyFile, network: OnnxExtrapolator) -> str | None:
    """Say that a policy was trained for another network than the one that extrapolates.

    It learned by how much that network's frames are better than warps, so its choices may be wrong.

    Returns
    -------
    str or None
        A sentence; None where it is the one, where the policy does not say, and where both came
        with ExWarp, whose policy is still that of the network before.
    """
    if not policy.trained_for or network.checksum in policy.trained_for:
        return None
    if policy.path.parent == network.path.parent == shipped_folder():
        return None
    known = " or ".join(digest[:8] for digest in policy.trained_for)
    kind = "tile-policy" if policy.of_tiles else "policy"
    used = f"{network.path.name} has {network.checksum[:8]}"
    return (
        f"{policy.path.name} was trained for the extrapolator with sha256 {known}, and {used}: its "
        f"decisions may be wrong; train a policy for this one with 'exwarp train {kind}', and name "
        "it with --policy"
    )


def _policy_summary(
    policy: PolicyFile, source: Source, network: OnnxExtrapolator | None
) -> PolicySummary:
    """Say what the policy sees of the input: of tiles, what the warp itself goes by."""
    note = None if network is None else other_extrapolator(policy, network)
    if policy.of_tiles:
        return PolicySummary(str(policy.path), policy.checksum, None, (), policy.trained_for, note)
    shot = source.slots or source.keys
    layout = shot.layout
    placed = Role.POSITION in layout or Role.DEPTH in layout
    objects_from: str | None
    if Role.STENCIL in layout:
        objects_from = "ids"
    elif shot.ids is not None and (placed or shot.ids.dynamic is not None):
        objects_from = "cryptomatte"
    else:
        objects_from = "motion" if placed else None
    needed = {"EMD_Wn": Role.NORMAL, "EMD_Wp": Role.POSITION}
    missing = [name for name, role in needed.items() if role not in layout]
    if objects_from is None:
        missing.insert(0, "N_d")
    return PolicySummary(
        str(policy.path),
        policy.checksum,
        objects_from,
        tuple(missing),
        policy.trained_for,
        note,
    )


def _missing_colours(source: Source) -> list[str]:
    """Name the surface colours that shading would have to be divided by, and that are not there."""
    layout = (source.slots or source.keys).layout
    return [name for role, name in SURFACE_COLOURS.items() if role not in layout]


def announce(
    progress: Progress,
    settings: UpsampleSettings,
    source: Source,
    method: Method,
    keys: tuple[int, ...],
) -> None:
    """Say what was found and what is going to happen."""
    count, sequence = len(source.timeline.numbers), source.keys.sequence
    geometry = f"G-buffers for {'every slot' if source.slots is not None else 'the key frames'}"
    if source.estimated or is_plain(sequence):
        geometry = "no AOVs" if is_plain(sequence) else "no motion vectors"
    progress.message(
        f"{sequence.pattern}: {pluralise(count, 'key frame')} at "
        f"{float(source.fps):g} fps ({source.fps_source}), {geometry}"
    )
    for note in (
        sequence.version_note,
        step_note(source.timeline.numbers, source.fps, source.fps_source),
        _compatible_note(settings, source),
        unevenness_of(sequence),
        _lost_alpha(settings, source),
        alpha_left_out(source.keys.layout),
    ):
        if note is not None:
            progress.message(note)
    if settings.source.gbuffers is not None and source.slots is None:
        progress.message(
            "--gbuffers is left out: it has no readable vectors to the previous slot, and "
            f"{method.name} does without"
        )
    if source.motion_origin is not None:
        progress.message("motion {}: {}".format(*source.motion_origin))
    if (depth := _depth(source)) is not None:
        progress.message(f"depth {depth}")
    if (names := _dynamic(source)) is not None:
        listed = ", ".join(shown(name) for name in names[:SHOWN])
        more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
        progress.message(f"moving by name: {listed}{more}")
    elif (source.slots or source.keys).ids is not None and method.needs_motion:
        progress.message(
            "the only ids are a Cryptomatte's: objects of which a tenth moves otherwise than the "
            "camera count as moving; --dynamic says by name what does"
        )
    last = count - 1
    if method.lookahead and last in keys and source.timeline.made_of(last):
        fallback = "s6" if source.moves else "hold"
        progress.message(
            f"after the last key frame there is no next one, so {method.name} falls back to "
            f"{fallback} there; --no-tail leaves those frames out"
        )


def _compatible_note(settings: UpsampleSettings, source: Source) -> str | None:
    """Say that the output's rate is not the one asked for, but one that keeps key frames."""
    asked, rate = settings.source.to_fps, source.output_fps
    if asked is None or abs(asked - rate) <= RATE_TOLERANCE * rate:
        return None
    every, seldom = source.timeline.factor.denominator, (asked / source.fps).denominator
    shown = "every key frame" if every == 1 else f"one key frame in {every}"
    return (
        f"--to-fps {float(asked):g} is taken as {rate}, exactly "
        f"{float(source.timeline.factor):g} times the input's {source.fps}, which keeps {shown}; "
        f"{float(asked):g} itself keeps one in {seldom}"
    )


def announce_truth(progress: Progress, truth: Sequence, frame_of: FrameOf, source: Source) -> None:
    """Say where ground truth is at another rate; or longer than the output, so that it may be."""
    if isinstance(frame_of, OtherRate):
        progress.message(frame_of.note)
        return
    count = math.ceil(len(source.timeline.numbers) * source.timeline.factor)
    if len(truth.numbers) > count:
        progress.message(
            f"--ground-truth has {len(truth.numbers)} frames, and the whole output {count}; scores "
            f"only hold if it is at {float(source.output_fps):g} fps, too"
        )


def announce_video(progress: Progress, source: Source, keys: tuple[int, ...]) -> None:
    """Say that a video's colour is not the frames' own."""
    primaries = video_look(source, keys).primaries
    if primaries is not None:
        progress.message(
            f"the video is converted from {primaries.name}, as the header says, to Rec. 709"
        )


def _lost_alpha(settings: UpsampleSettings, source: Source) -> str | None:
    """Say that frames lose alpha; a video says so itself."""
    if is_clip(settings.output):
        return None
    return lost_alpha(source.keys, frame_suffix(settings.output, source.keys.sequence))


def announce_contents(progress: Progress, contents: tuple[Content, ...]) -> None:
    """Say what generated frames hold beside the beauty."""
    leader = contents[0]
    shot = leader.source.keys
    if len(contents) > 1:
        views = ", ".join(content.source.keys.view for content in contents)
        progress.message(f"views {views} in one file; decisions and scores are of {shot.view}")
        for content in contents[1:]:
            finding = content.source.finding
            if finding is not None:
                found = f"motion {finding.source}: {finding.evidence}"
                progress.message(f"{content.source.keys.view}: {found}")
    if leader.names:
        many = pluralise(len(leader.names), "layer")
        progress.message(f"{many} beside the beauty: {', '.join(leader.names)}")
    if leader.layers and (apart := files_apart(shot)):
        progress.message(
            f"layers in files of their own are not written: {', '.join(apart)}; generated frames "
            "hold those of the file with the colour"
        )


def input_summary(source: Source) -> InputSummary:
    """Return the input as the report names it."""
    motion = source.motion_origin
    return InputSummary(
        pattern=source.keys.sequence.pattern,
        first=source.timeline.numbers[0],
        last=source.timeline.numbers[-1],
        width=source.keys.display.width,
        height=source.keys.display.height,
        producer=(source.slots or source.keys).layout.producer,
        motion_source=None if motion is None else motion[0],
        motion_evidence=None if motion is None else motion[1],
        dynamic=_dynamic(source),
        step=next((b - a for a, b in pairwise(source.timeline.numbers)), 1),
        depth=_depth(source),
    )


def _depth(source: Source) -> str | None:
    """Return how depth is read where that is another way than its name says; None elsewhere."""
    return (source.slots or source.keys).depth.evidence or None


def _dynamic(source: Source) -> tuple[str, ...] | None:
    """Return the names of what the user calls moving; None where nothing is said."""
    ids = (source.slots or source.keys).ids
    return None if ids is None or ids.dynamic is None else ids.dynamic.names


def left_out(timeline: Timeline, key: int, slots: abc.Sequence[Slot], reason: str) -> LeftOut:
    """Return what is recorded of an interval, by its index, that lacks some slots."""
    frames = tuple(timeline.number(slot) for slot in slots)
    return LeftOut(timeline.numbers[key], frames, reason)


def unscored(timeline: Timeline, key: int, reasons: Mapping[int, str]) -> Iterator[LeftOut]:
    """Yield what is recorded of an interval whose ground truth cannot be used, by slot."""
    for slot, reason in sorted(reasons.items()):
        number = timeline.number(Slot(key, slot))
        yield LeftOut(timeline.numbers[key], (), reason, (number,))


def unusable(timeline: Timeline, key: int, reasons: Mapping[int, str]) -> Iterator[LeftOut]:
    """Yield what is recorded of an interval whose rendered frames cannot be used, by slot."""
    for slot, reason in sorted(reasons.items()):
        number = timeline.number(Slot(key, slot))
        yield LeftOut(timeline.numbers[key], (), reason, rendered=(number,))


def tell_left_out(progress: Progress, one: LeftOut) -> None:
    """Say at once what is left out, and why."""
    numbers = one.frames or one.scores or one.rendered
    what = "left out" if one.frames else "not scored" if one.scores else "generated"
    progress.message(f"{what} {_named(numbers)}: {one.reason}")


def require_complete(run: RunSummary) -> None:
    """Refuse to call a run complete that left something out.

    Raises
    ------
    IncompleteError
        When it did.
    """
    if not run.left_out:
        return
    missing = [one for one in run.left_out if one.frames]
    many, frames = len(missing), [n for one in missing for n in one.frames]
    scores = sorted({n for one in run.left_out for n in one.scores})
    clauses, cause = [], []
    if missing:
        verb = "was" if many == 1 else "were"
        whole = pluralise(len(run.selected), "key interval")
        clauses.append(f"{many} of {whole} {verb} left out ({_named(frames)})")
        cause.append("the input")
    if scores:
        clauses.append(f"{_named(scores)} {'was' if len(scores) == 1 else 'were'} not scored")
        cause.append("the ground truth")
    rendered = sorted({n for one in run.left_out for n in one.rendered})
    if rendered:
        verb = "was" if len(rendered) == 1 else "were"
        clauses.append(f"{_named(rendered)} {verb} generated, although rendered")
        cause.append("the rendered frames")
    raise IncompleteError(
        f"{', and '.join(clauses)}, see above or left_out in report.json; "
        f"mend {' and '.join(cause)} and run again with --skip-existing"
    )


def _named(frames: abc.Sequence[int]) -> str:
    return f"frame{'s' if len(frames) != 1 else ''} {ranges(frames)}"
