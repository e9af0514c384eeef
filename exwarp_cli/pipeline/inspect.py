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
from exwarp_cli.errors import MotionError, OutputExistsError, UsageError
from exwarp_cli.io.channel_map import channel_map_text
from exwarp_cli.io.channels import UNKNOWN, ChannelRef, Role
from exwarp_cli.io.cryptomatte import Cryptomatte, Manifest
from exwarp_cli.io.depth import DepthKind
from exwarp_cli.io.exr.header import Part
from exwarp_cli.io.files import atomic_write_text
from exwarp_cli.io.footage import describe_footage
from exwarp_cli.io.shot import MAIN, Shot
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

    def as_dict(self) -> dict[str, Any]:
        """Return the findings as plain data, for JSON."""
        sequence, layout = self.shot.sequence, self.shot.layout
        moving = None if self.shot.ids is None else self.shot.ids.dynamic
        return {
            "schema": "exwarp.inspect/1",
            "pattern": sequence.pattern,
            "frames": ranges(sequence.numbers),
            "count": len(sequence.numbers),
            "naming_note": sequence.version_note,
            "width": self.shot.display.width,
            "height": self.shot.display.height,
            "fps": {
                "base": float(self.fps),
                "source": self.fps_source,
                # How the rate of frames that are numbered in steps is read.
                "note": step_note(sequence.numbers, self.fps, self.fps_source),
            },
            "producer": layout.producer,
            "views": list(self.shot.views),
            "view": self.shot.view or None,
            "parts": [
                {
                    "name": part.name,
                    "view": part.view,
                    "views": list(part.views),
                    "deep": part.deep,
                    "tiled": part.tiled,
                    "data_window": list(part.data_window.corners),
                    "display_window": list(part.display_window.corners),
                    "channels": {channel.raw_name: channel.pixel_type for channel in part.channels},
                }
                for part in self.parts
            ],
            "aovs": {aov: member.pattern for aov, member in self.shot.aovs.items()},
            "roles": {
                role.value: [ref.label for ref in refs] for role, refs in layout.roles.items()
            },
            "channels": dict(self.types),
            "depth_kind": self.shot.depth.kind.value if Role.DEPTH in layout else None,
            "depth_evidence": self.shot.depth.evidence or None,
            "cryptomattes": [
                {
                    "name": matte.name,
                    "aov": matte.aov or None,
                    "kind": matte.kind.name.lower(),
                    "names": sorted(manifest.ids),
                    "problem": manifest.problem or None,
                }
                for matte, manifest in self.cryptomattes
            ],
            "dynamic": None if moving is None else list(moving.names),
            "pictures": self.pictures,
            "motion": self._motion_as_dict(),
        }

    def _motion_as_dict(self) -> dict[str, Any] | None:
        """Return how the vectors are read; None without motion."""
        layout, finding = self.shot.layout, self.finding
        if Role.MOTION not in layout:
            return None
        names = motion_names(self.shot)
        measured = ("source", "evidence", "error", "still_error", "runner_up_error")
        return {
            "named": None if layout.guess is None else layout.guess.describe(names),
            "convention": None if finding is None else finding.convention.describe(names),
            **{key: None if finding is None else getattr(finding, key) for key in measured},
            "problem": self.problem,
        }


def inspect(settings: SourceSettings) -> Inspection:
    """Read the first frame of a sequence and measure its motion convention.

    Raises InputError when the sequence is absent, has gaps or frames of several sizes, or cannot be
    read.
    """
    plain = open_plain(settings)
    shot, settings = open_keys(settings) if plain is None else (plain, settings)
    Timeline.of(shot.sequence.numbers)
    require_one_size(shot, shot.sequence.numbers)
    fps, fps_source = rate_of(shot, settings.fps)
    if plain is not None:
        pictures = describe_footage(plain.sequence)
        return Inspection(plain, (), None, None, fps, fps_source, pictures=pictures)
    shot, _ = read_ids(settings.dynamic, shot, None)
    types: dict[str, str] = {}
    parts: tuple[Part, ...] = ()
    for aov, path in shot.files(shot.first).items():
        header = shot.headers.read(path)
        parts = parts or header.parts
        for name, channel in shot.channels(header.parts, aov).items():
            types[ChannelRef(aov, name).label] = channel.pixel_type
    finding, problem = None, None
    try:
        finding = find_motion(shot, settings.motion)
    except MotionError as error:
        problem = str(error)
    shot = with_depth_ordered(shot, None if finding is None else finding.convention)
    mattes = tuple(sound_cryptomattes(shot))
    return Inspection(shot, parts, finding, problem, fps, fps_source, types, mattes)


def save_channel_map(inspection: Inspection, path: Path, overwrite: bool) -> None:
    """Write an inspection as a channel map.

    A motion convention that was not measured, as vectors were too short, is left out. Raises
    OutputError when the file exists and is not to be replaced, or cannot be written; UsageError for
    videos and stills.
    """
    shot, finding = inspection.shot, inspection.finding
    if inspection.pictures is not None:
        raise UsageError(
            f"--write-channel-map is for EXR, and {shot.sequence.pattern} has colour alone; "
            "leave it out"
        )
    layout = shot.layout

    def name_in_file(ref: ChannelRef) -> str:
        # Also where colour comes from another sequence.
        return (replace(ref, aov="") if ref.aov == MAIN else ref).label

    channels = {role: tuple(map(name_in_file, refs)) for role, refs in layout.roles.items()}
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
    # What the table [channels] of a map can name: [aovs] names the others, and where it names the
    # colour, also the main file.
    aovs = {aov.role.value for aov in shot.aov_files}
    if any(aov.role is Role.COLOUR for aov in shot.aov_files):
        aovs.add("")
    unused = [name_in_file(ref) for ref in shot.unused if ref.aov not in aovs]
    if path.exists() and not overwrite:
        raise OutputExistsError(f"{path} exists; choose another name, or add --overwrite")
    text = channel_map_text(about, texts, channels, shot.aov_files, unused)
    atomic_write_text(path, text)
