"""Messages of a run at its start and end, and summaries of its models for the report."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from exwarp_cli.domain import results
from exwarp_cli.domain.timeline import RATE_TOLERANCE, ranges
from exwarp_cli.domain.wording import pluralise
from exwarp_cli.errors import IncompleteError
from exwarp_cli.io.channels import Role
from exwarp_cli.io.cryptomatte import MAX_NAMES, quote_name
from exwarp_cli.io.footage import is_plain, lost_alpha_message, uneven_rate_message
from exwarp_cli.io.shot import alpha_note
from exwarp_cli.io.video_reader import is_clip
from exwarp_cli.models.model_file import shipped_folder
from exwarp_cli.pipeline.ground_truth import OtherRate
from exwarp_cli.pipeline.output_plan import frame_suffix, video_look
from exwarp_cli.pipeline.progress import Progress
from exwarp_cli.pipeline.source import step_note

if TYPE_CHECKING:
    from exwarp_cli.models.interpolator import OnnxInterpolator
    from exwarp_cli.models.picture_network import OnnxExtrapolator, OnnxLookAhead
    from exwarp_cli.models.policy_files import PolicyFile
    from exwarp_cli.pipeline.job import Job
    from exwarp_cli.pipeline.source import Source

# What `synthesis.extrapolation` divides by, both together, in the user's words.
SURFACE_COLOURS = {Role.ALBEDO: "diffuse", Role.SPECULAR: "glossy"}


@dataclass(frozen=True)
class Models:
    """The networks and the policy of a run, for its report; None for those that it lacks."""

    extrapolator: results.NetworkSummary | None
    interpolator: results.InterpolatorSummary | None
    policy: results.PolicySummary | None

    @classmethod
    def of(
        cls,
        source: Source,
        network: OnnxExtrapolator | None,
        interpolator: OnnxInterpolator | OnnxLookAhead | None,
        policy: PolicyFile | None,
        look_ahead_policy: PolicyFile | None,
        effort: float,
    ) -> Models:
        """Summarise loaded models; the last policy chooses the tiles that `interpolator` makes."""
        extrapolator = interpolator_summary = policy_summary = None
        if network is not None:
            extrapolator = results.NetworkSummary(
                str(network.path),
                network.checksum,
                network.device,
                all(role in source.geometry.layout for role in SURFACE_COLOURS),
            )
        if interpolator is not None:
            interpolator_summary = results.InterpolatorSummary(
                interpolator.name,
                str(interpolator.path),
                interpolator.checksum,
                interpolator.card_checksum,
                interpolator.device,
                None if look_ahead_policy is None else look_ahead_policy.checksum,
                None if look_ahead_policy is None else effort,
            )
        if policy is not None:
            note = None if network is None else other_extrapolator(policy, network)
            objects_from, missing = None, []
            if not policy.of_tiles:  # one of tiles uses what the warp uses, so it lacks nothing
                shot = source.geometry
                layout = shot.layout
                placed = Role.POSITION in layout or Role.DEPTH in layout
                if Role.STENCIL in layout:
                    objects_from = "ids"
                elif shot.ids is not None and (placed or shot.ids.dynamic is not None):
                    objects_from = "cryptomatte"
                elif placed:
                    objects_from = "motion"
                else:
                    missing.append("N_d")
                needed = {"EMD_Wn": Role.NORMAL, "EMD_Wp": Role.POSITION}
                missing += [name for name, role in needed.items() if role not in layout]
            policy_summary = results.PolicySummary(
                str(policy.path),
                policy.checksum,
                objects_from,
                tuple(missing),
                policy.trained_for,
                note,
            )
        return cls(extrapolator, interpolator_summary, policy_summary)


def model_messages(job: Job) -> Iterator[str]:
    """Name the models of a job, and what they lack of its input."""
    network, policy = job.models.extrapolator, job.models.policy
    interpolator = job.models.interpolator
    if network is not None:
        yield (
            f"extrapolation by {Path(network.file).name} (sha256 {network.sha256[:8]}) on "
            f"{network.device}"
        )
        layout = job.source.geometry.layout
        if missing := [name for role, name in SURFACE_COLOURS.items() if role not in layout]:
            yield (
                f"no {' and no '.join(missing)} colour: shading is extrapolated together with "
                "surface colour"
            )
    if interpolator is not None:
        views = "both key frames, warped" if interpolator.card_sha256 is None else "colour alone"
        if interpolator.effort is not None:
            views += f", in tiles where they disagree (effort {interpolator.effort:g})"
        yield (
            f"interpolation by {interpolator.name}, {Path(interpolator.file).name} (sha256 "
            f"{interpolator.sha256[:8]}) on {interpolator.device}, from {views}"
        )
    if policy is None:
        return
    yield f"decisions by {Path(policy.file).name} (sha256 {policy.sha256[:8]}), 8-bit integers"
    if policy.note is not None:
        yield policy.note
    if policy.objects_from == "motion":
        yield "no object ids: what moves otherwise than the camera counts as an object"
    ids = job.source.geometry.ids
    is_named = ids is not None and ids.dynamic is not None
    if policy.objects_from == "cryptomatte" and not is_named:
        yield (
            "of the Cryptomatte's objects those count as moving that move otherwise than the camera"
        )
    if policy.missing:
        yield f"the policy sees 0 for {', '.join(policy.missing)}, as the AOVs for it are missing"


def other_extrapolator(policy: PolicyFile, network: OnnxExtrapolator) -> str | None:
    """Return a warning if the policy was trained for another network than the one that is used.

    None where the policy does not name its network.
    """
    # A policy learned by how much one network's frames are better than warps.
    if not policy.trained_for or network.checksum in policy.trained_for:
        return None
    # The policy that comes with ExWarp is still that of the network before.
    if policy.path.parent == network.path.parent == shipped_folder():
        return None
    trained = " or ".join(digest[:8] for digest in policy.trained_for)
    kind = "tile-policy" if policy.of_tiles else "policy"
    used = f"{network.path.name} has {network.checksum[:8]}"
    return (
        f"{policy.path.name} was trained for the extrapolator with sha256 {trained}, and "
        f"{used}: its decisions may be wrong; train a policy for this one with 'exwarp train "
        f"{kind}', and name it with --policy"
    )


def input_messages(job: Job) -> Iterator[str]:
    """Describe the input of a job and how it is read."""
    settings, source, method = job.settings, job.source, job.method
    sequence, fps, timeline = source.keys.sequence, source.fps, source.timeline
    geometry = f"G-buffers for {'every slot' if source.slots is not None else 'the key frames'}"
    if source.estimated or is_plain(sequence):
        geometry = "no AOVs" if is_plain(sequence) else "no motion vectors"
    yield (
        f"{sequence.pattern}: {pluralise(len(timeline.numbers), 'key frame')} at "
        f"{float(fps):g} fps ({source.fps_source}), {geometry}"
    )
    notes = [sequence.version_note, step_note(timeline.numbers, fps, source.fps_source)]
    target, rate = settings.source.to_fps, source.output_fps
    if target is not None and abs(target - rate) > RATE_TOLERANCE * rate:
        # One that keeps key frames is taken in its place.
        every, seldom = timeline.factor.denominator, (target / fps).denominator
        kept = "every key frame" if every == 1 else f"one key frame in {every}"
        notes.append(
            f"--to-fps {float(target):g} is taken as {rate}, exactly {float(timeline.factor):g} "
            f"times the input's {fps}, which keeps {kept}; {float(target):g} itself keeps one in "
            f"{seldom}"
        )
    notes.append(uneven_rate_message(sequence))
    if not is_clip(settings.output):  # a video's writer announces it
        notes.append(lost_alpha_message(source.keys, frame_suffix(settings.output, sequence)))
    yield from filter(None, (*notes, alpha_note(source.keys.layout)))
    if settings.source.gbuffers is not None and source.slots is None:
        yield (
            "--gbuffers is left out: it has no readable vectors to the previous slot, and "
            f"{method.name} does without"
        )
    if source.motion_origin is not None:
        yield "motion {}: {}".format(*source.motion_origin)
    if depth := source.geometry.depth.evidence:
        yield f"depth {depth}"
    ids = source.geometry.ids
    if ids is not None and ids.dynamic is not None:
        names = ids.dynamic.names
        listed = ", ".join(quote_name(name) for name in names[:MAX_NAMES])
        more = f" and {len(names) - MAX_NAMES} more" if len(names) > MAX_NAMES else ""
        yield f"moving by name: {listed}{more}"
    elif ids is not None and method.needs_motion:
        yield (
            "the only ids are a Cryptomatte's: objects of which a tenth moves otherwise than the "
            "camera count as moving; --dynamic says by name what does"
        )
    last = len(timeline.numbers) - 1
    if method.lookahead and last in job.keys and timeline.made_of(last):
        warped = "s6" if source.estimated or source.finding is not None else "hold"
        fallback = warped if method.tail is None else "what --causal does"
        yield (
            f"after the last key frame there is no next one, so {method.name} falls back to "
            f"{fallback} there; --no-tail leaves those frames out"
        )


def output_messages(job: Job) -> Iterator[str]:
    """Describe what is written, and what frames that are there already are used for."""
    source, contents = job.source, job.contents
    if job.rendered is not None:
        yield job.rendered.note
    if job.truth is not None:
        truth, frame_of = job.truth
        count = math.ceil(len(source.timeline.numbers) * source.timeline.factor)
        if isinstance(frame_of, OtherRate):
            yield frame_of.note
        elif len(truth.numbers) > count:
            yield (
                f"--ground-truth has {len(truth.numbers)} frames, and the whole output {count}; "
                f"scores only hold if it is at {float(source.output_fps):g} fps, too"
            )
    if job.targets.video is not None:
        primaries = video_look(source, job.keys).primaries
        if primaries is not None:
            yield f"the video is converted from {primaries.name}, as the header says, to Rec. 709"
    shot, leader = source.keys, contents[0]
    if len(contents) > 1:
        views = ", ".join(content.source.keys.view for content in contents)
        yield f"views {views} in one file; decisions and scores are of {shot.view}"
    for content in contents[1:]:
        finding = content.source.finding
        if finding is not None:
            yield f"{content.source.keys.view}: motion {finding.source}: {finding.evidence}"
    if leader.names:
        many = pluralise(len(leader.names), "layer")
        yield f"{many} beside the beauty: {', '.join(leader.names)}"
    if leader.layers and (apart := [aov for aov in shot.aovs if aov]):
        yield (
            f"layers in files of their own are not written: {', '.join(apart)}; generated frames "
            "hold those of the file with the colour"
        )


def announce_skipped(progress: Progress, skipped: results.LeftOut) -> None:
    """Announce what is left out, and why."""
    numbers = skipped.frames or skipped.scores or skipped.rendered
    fate = "left out" if skipped.frames else "not scored" if skipped.scores else "generated"
    progress.message(f"{fate} {_named(numbers)}: {skipped.reason}")


def require_complete(run: results.RunSummary) -> None:
    """Raise IncompleteError if a run left something out."""
    if not run.left_out:
        return
    intervals = [skipped for skipped in run.left_out if skipped.frames]
    scores = sorted({number for skipped in run.left_out for number in skipped.scores})
    rendered = sorted({number for skipped in run.left_out for number in skipped.rendered})
    clauses, causes = [], []
    if intervals:
        frames = [number for skipped in intervals for number in skipped.frames]
        total = pluralise(len(run.selected), "key interval")
        clauses.append(f"{len(intervals)} of {total} {_was(intervals)} left out ({_named(frames)})")
        causes.append("the input")
    if scores:
        clauses.append(f"{_named(scores)} {_was(scores)} not scored")
        causes.append("the ground truth")
    if rendered:
        clauses.append(f"{_named(rendered)} {_was(rendered)} generated, although rendered")
        causes.append("the rendered frames")
    raise IncompleteError(
        f"{', and '.join(clauses)}, see above or left_out in report.json; "
        f"mend {' and '.join(causes)} and run again with --skip-existing"
    )


def _was(items: Sequence[object]) -> str:
    return "was" if len(items) == 1 else "were"


def _named(frames: Sequence[int]) -> str:
    return f"frame{'s' if len(frames) != 1 else ''} {ranges(frames)}"
