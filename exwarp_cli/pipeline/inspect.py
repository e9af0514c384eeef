"""What a sequence holds, and how its motion is read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

from exwarp_cli.domain.motion import MotionFinding
from exwarp_cli.domain.settings import SourceSettings
from exwarp_cli.domain.timeline import Timeline, ranges
from exwarp_cli.errors import MotionError, UsageError
from exwarp_cli.io.channel_map import channel_map_text, write_channel_map
from exwarp_cli.io.channels import ChannelRef, Layout, Role
from exwarp_cli.io.cryptomatte import Cryptomatte
from exwarp_cli.io.cryptomatte_manifest import Manifest
from exwarp_cli.io.depth import DepthKind
from exwarp_cli.io.exr.header import Part
from exwarp_cli.io.footage import describe_footage
from exwarp_cli.io.producers import UNKNOWN
from exwarp_cli.io.shot import MAIN, Shot, spelled
from exwarp_cli.pipeline.depth_kind import with_depth_ordered
from exwarp_cli.pipeline.frame_sizes import require_one_size
from exwarp_cli.pipeline.motion_finding import find_motion
from exwarp_cli.pipeline.motion_option import motion_names
from exwarp_cli.pipeline.opening import (
    looked_into,
    open_keys,
    open_plain,
    rate_of,
    read_ids,
    step_note,
)


@dataclass(frozen=True)
class Inspection:
    """What was found.

    Attributes
    ----------
    shot
        The sequence and its layout.
    parts
        Parts of the first frame's main file.
    finding
        The motion convention; None without motion or when it cannot be settled.
    problem
        Why the convention cannot be settled; None when it can.
    fps, fps_source
        Rate, and where it came from.
    types
        Pixel type of each channel of the view, by its name with AOV.
    cryptomattes
        Those of the first frame, the best for ids first, with their manifests.
    pictures
        What is known of a video's or of stills' colour and sound; None for EXR.
    """

    shot: Shot
    parts: tuple[Part, ...]
    finding: MotionFinding | None
    problem: str | None
    fps: Fraction
    fps_source: str
    types: Mapping[str, str] = field(default_factory=dict)
    cryptomattes: tuple[tuple[Cryptomatte, Manifest], ...] = ()
    pictures: Mapping[str, Any] | None = None

    @property
    def fps_note(self) -> str | None:
        """How the rate of frames that are numbered in steps is read; None for others."""
        return step_note(self.shot.sequence.numbers, self.fps, self.fps_source)

    def as_dict(self) -> dict[str, Any]:
        """Return the findings as plain data, for JSON."""
        sequence, layout, finding = self.shot.sequence, self.shot.layout, self.finding
        moving = None if self.shot.ids is None else self.shot.ids.dynamic
        return {
            "schema": "exwarp.inspect/1",
            "pattern": sequence.pattern,
            "frames": ranges(sequence.numbers),
            "count": len(sequence.numbers),
            "naming_note": sequence.version_note,
            "width": self.shot.display.width,
            "height": self.shot.display.height,
            "fps": {"base": float(self.fps), "source": self.fps_source, "note": self.fps_note},
            "producer": layout.producer,
            "views": list(self.shot.views),
            "view": self.shot.view or None,
            "parts": [_part(part) for part in self.parts],
            "aovs": {aov: member.pattern for aov, member in self.shot.aovs.items()},
            "roles": {
                role.value: [spelled(ref) for ref in refs] for role, refs in layout.roles.items()
            },
            "channels": dict(self.types),
            "depth_kind": self.shot.depth.kind.value if Role.DEPTH in layout else None,
            "depth_evidence": self.shot.depth.evidence or None,
            "cryptomattes": [_matte(one, manifest) for one, manifest in self.cryptomattes],
            "dynamic": None if moving is None else list(moving.names),
            "pictures": self.pictures,
            "motion": None
            if Role.MOTION not in layout
            else _motion(self.shot, finding, self.problem),
        }


def inspect(settings: SourceSettings) -> Inspection:
    """Look into a sequence and measure its motion convention.

    Raises
    ------
    InputError
        When the sequence is not there, has gaps or frames of several sizes, or cannot be read.
    """
    plain = open_plain(settings)
    if plain is not None:
        Timeline.of(plain.sequence.numbers)
        require_one_size(plain, plain.sequence.numbers)
        fps, fps_source = rate_of(plain, settings.fps)
        pictures = describe_footage(plain.sequence)
        return Inspection(plain, (), None, None, fps, fps_source, pictures=pictures)
    shot, settings = open_keys(settings)
    Timeline.of(shot.sequence.numbers)
    require_one_size(shot, shot.sequence.numbers)
    shot, _ = read_ids(settings.dynamic, shot, None)
    parts, types = _look(shot)
    finding, problem = None, None
    try:
        finding = find_motion(shot, settings.motion)
    except MotionError as error:
        problem = str(error)
    shot = with_depth_ordered(shot, None if finding is None else finding.convention)
    fps, fps_source = rate_of(shot, settings.fps)
    mattes = tuple(looked_into(shot))
    return Inspection(shot, parts, finding, problem, fps, fps_source, types, mattes)


def save_channel_map(found: Inspection, path: Path, overwrite: bool) -> None:
    """Write what was found as a channel map.

    What was not measured (vectors too short to tell) is left to be measured again.

    Raises
    ------
    OutputError
        When the file exists and is not to be replaced, or cannot be written.
    UsageError
        For videos and stills.
    """
    if found.pictures is not None:
        raise UsageError(
            f"--write-channel-map is for EXR, and {found.shot.sequence.pattern} has colour alone; "
            "leave it out"
        )
    shot, finding = found.shot, found.finding
    layout = shot.layout
    channels = {
        role: tuple(spelled(_as_opened(ref)) for ref in refs) for role, refs in layout.roles.items()
    }
    measured = finding is not None and finding.source != "untested"
    texts = {
        "producer": None if layout.producer == UNKNOWN else layout.producer,
        "view": shot.view if shot.view and shot.view != shot.views[0] else None,
        "motion": finding.convention.describe(motion_names(shot))
        if finding is not None and measured
        else None,
        "depth_kind": None if shot.depth.kind is DepthKind.UNKNOWN else shot.depth.kind.value,
    }
    about = shot.aovs.get(MAIN, shot.sequence).pattern
    unused = [spelled(_as_opened(ref)) for ref in unused_channels(shot) if _in_map(shot, ref)]
    text = channel_map_text(about, texts, channels, shot.aov_files, unused)
    write_channel_map(path, text, overwrite)


def _as_opened(ref: ChannelRef) -> ChannelRef:
    """Return a channel as it is called before a colour sequence of its own leads the shot."""
    return replace(ref, aov="") if ref.aov == MAIN else ref


def _in_map(shot: Shot, ref: ChannelRef) -> bool:
    """Whether the table [channels] of a map can name a channel: not of files that [aovs] names."""
    led = any(aov.role is Role.COLOUR for aov in shot.aov_files)
    return ref.aov not in {aov.role.value for aov in shot.aov_files} and not (led and not ref.aov)


def _look(shot: Shot) -> tuple[tuple[Part, ...], dict[str, str]]:
    """Look into the first frame: parts of the main file, and types of channels."""
    types: dict[str, str] = {}
    parts: tuple[Part, ...] = ()
    for aov, path in shot.files(shot.first).items():
        header = shot.headers.read(path)
        channels = shot.channels(header.parts, aov)
        parts = parts or header.parts
        types |= {spelled(ChannelRef(aov, name)): c.pixel_type for name, c in channels.items()}
    return parts, types


def unused_channels(shot: Shot) -> list[ChannelRef]:
    """Return the channels without a role, Cryptomattes' among them, in the order of the files."""
    used = {ref for refs in shot.layout.roles.values() for ref in refs}
    return [ref for ref in shot.every if ref not in used]


def missing_roles(layout: Layout) -> list[Role]:
    """Return the roles that were looked for in vain."""
    return [role for role in Role if role not in layout]


def _matte(one: Cryptomatte, manifest: Manifest) -> dict[str, Any]:
    return {
        "name": one.name,
        "aov": one.aov or None,
        "kind": one.kind.name.lower(),
        "names": sorted(manifest.ids),
        "problem": manifest.problem or None,
    }


def _part(part: Part) -> dict[str, Any]:
    return {
        "name": part.name,
        "view": part.view,
        "views": list(part.views),
        "deep": part.deep,
        "tiled": part.tiled,
        "data_window": list(part.data_window.corners),
        "display_window": list(part.display_window.corners),
        "channels": {channel.raw_name: channel.pixel_type for channel in part.channels},
    }


def _motion(shot: Shot, finding: MotionFinding | None, problem: str | None) -> dict[str, Any]:
    guess, names = shot.layout.guess, motion_names(shot)
    return {
        "named": None if guess is None else guess.describe(names),
        "convention": None if finding is None else finding.convention.describe(names),
        "source": None if finding is None else finding.source,
        "evidence": None if finding is None else finding.evidence,
        "error": None if finding is None else finding.error,
        "still_error": None if finding is None else finding.still_error,
        "runner_up_error": None if finding is None else finding.runner_up_error,
        "problem": problem,
    }
