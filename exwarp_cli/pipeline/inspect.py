"""The content of a sequence, and its motion convention, for ``exwarp inspect``."""

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
from exwarp_cli.io.cryptomatte import Cryptomatte, Manifest
from exwarp_cli.io.depth import DepthKind
from exwarp_cli.io.exr.header import Part
from exwarp_cli.io.footage import describe_footage
from exwarp_cli.io.producers import UNKNOWN
from exwarp_cli.io.shot import MAIN, Shot, channel_label
from exwarp_cli.pipeline.depth_and_ids import read_ids, sound_cryptomattes, with_depth_ordered
from exwarp_cli.pipeline.motion_convention import find_motion, motion_names
from exwarp_cli.pipeline.source import open_keys, open_plain, rate_of, require_one_size, step_note


@dataclass(frozen=True)
class Inspection:
    """The content of a sequence."""

    shot: Shot  # the sequence and its layout
    parts: tuple[Part, ...]  # parts of the first frame's main file
    # The motion convention; None without motion or when it cannot be settled
    finding: MotionFinding | None
    problem: str | None  # why the convention cannot be settled; None when it can
    # fps, fps_source: rate, and where it came from
    fps: Fraction
    fps_source: str
    # Pixel type of each channel of the view, by its name with AOV
    types: Mapping[str, str] = field(default_factory=dict)
    # Those of the first frame, the best for ids first, with their manifests
    cryptomattes: tuple[tuple[Cryptomatte, Manifest], ...] = ()
    # Colour and sound of a video or of stills; None for EXR
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
                role.value: [channel_label(ref) for ref in refs]
                for role, refs in layout.roles.items()
            },
            "channels": dict(self.types),
            "depth_kind": self.shot.depth.kind.value if Role.DEPTH in layout else None,
            "depth_evidence": self.shot.depth.evidence or None,
            "cryptomattes": [_matte(matte, manifest) for matte, manifest in self.cryptomattes],
            "dynamic": None if moving is None else list(moving.names),
            "pictures": self.pictures,
            "motion": None
            if Role.MOTION not in layout
            else _motion(self.shot, finding, self.problem),
        }


def inspect(settings: SourceSettings) -> Inspection:
    """Read the first frame of a sequence and measure its motion convention.

    Raises
    ------
    InputError
        When the sequence is absent, has gaps or frames of several sizes, or cannot be read.
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
    parts, types = _read_headers(shot)
    finding, problem = None, None
    try:
        finding = find_motion(shot, settings.motion)
    except MotionError as error:
        problem = str(error)
    shot = with_depth_ordered(shot, None if finding is None else finding.convention)
    fps, fps_source = rate_of(shot, settings.fps)
    mattes = tuple(sound_cryptomattes(shot))
    return Inspection(shot, parts, finding, problem, fps, fps_source, types, mattes)


def save_channel_map(inspection: Inspection, path: Path, overwrite: bool) -> None:
    """Write an inspection as a channel map.

    A motion convention that was not measured, as vectors were too short, is left out.

    Raises
    ------
    OutputError
        When the file exists and is not to be replaced, or cannot be written.
    UsageError
        For videos and stills.
    """
    shot, finding = inspection.shot, inspection.finding
    if inspection.pictures is not None:
        raise UsageError(
            f"--write-channel-map is for EXR, and {shot.sequence.pattern} has colour alone; "
            "leave it out"
        )
    layout = shot.layout
    channels = {
        role: tuple(channel_label(_as_opened(ref)) for ref in refs)
        for role, refs in layout.roles.items()
    }
    motion = None
    if finding is not None and finding.source != "untested":
        motion = finding.convention.describe(motion_names(shot))
    texts = {
        "producer": None if layout.producer == UNKNOWN else layout.producer,
        "view": shot.view if shot.view and shot.view != shot.views[0] else None,
        "motion": motion,
        "depth_kind": None if shot.depth.kind is DepthKind.UNKNOWN else shot.depth.kind.value,
    }
    about = shot.aovs.get(MAIN, shot.sequence).pattern
    unused = [channel_label(_as_opened(ref)) for ref in unused_channels(shot) if _in_map(shot, ref)]
    text = channel_map_text(about, texts, channels, shot.aov_files, unused)
    write_channel_map(path, text, overwrite)


def _as_opened(ref: ChannelRef) -> ChannelRef:
    """Return a channel by its name in the file, also where colour comes from another sequence."""
    return replace(ref, aov="") if ref.aov == MAIN else ref


def _in_map(shot: Shot, ref: ChannelRef) -> bool:
    """Return whether the table [channels] of a map can name a channel."""
    # [aovs] names the others, and where it names the colour, also the main file.
    has_colour_file = any(aov.role is Role.COLOUR for aov in shot.aov_files)
    is_in_aov = ref.aov in {aov.role.value for aov in shot.aov_files}
    return not is_in_aov and not (has_colour_file and not ref.aov)


def _read_headers(shot: Shot) -> tuple[tuple[Part, ...], dict[str, str]]:
    """Return the parts of the first frame's main file, and types of all channels by name."""
    types: dict[str, str] = {}
    parts: tuple[Part, ...] = ()
    for aov, path in shot.files(shot.first).items():
        header = shot.headers.read(path)
        channels = shot.channels(header.parts, aov)
        parts = parts or header.parts
        types |= {
            channel_label(ChannelRef(aov, name)): c.pixel_type for name, c in channels.items()
        }
    return parts, types


def unused_channels(shot: Shot) -> list[ChannelRef]:
    """Return the channels without a role, with those of Cryptomattes, in the order of the files."""
    used = {ref for refs in shot.layout.roles.values() for ref in refs}
    return [ref for ref in shot.every if ref not in used]


def missing_roles(layout: Layout) -> list[Role]:
    """Return the roles without a channel."""
    return [role for role in Role if role not in layout]


def _matte(matte: Cryptomatte, manifest: Manifest) -> dict[str, Any]:
    return {
        "name": matte.name,
        "aov": matte.aov or None,
        "kind": matte.kind.name.lower(),
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
