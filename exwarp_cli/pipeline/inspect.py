"""What a sequence holds, and how its motion is read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from exwarp_cli.domain.motion import MotionFinding
from exwarp_cli.domain.settings import SourceSettings
from exwarp_cli.domain.timeline import Timeline, ranges
from exwarp_cli.errors import MotionError
from exwarp_cli.io.channels import Layout, Role
from exwarp_cli.io.exr import ExrReader, Part
from exwarp_cli.io.frames import Shot, open_shot
from exwarp_cli.pipeline.source import find_motion, motion_names, rate_of


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
    """

    shot: Shot
    parts: tuple[Part, ...]
    finding: MotionFinding | None
    problem: str | None
    fps: float
    fps_source: str

    def as_dict(self) -> dict[str, Any]:
        """Return the findings as plain data, for JSON."""
        sequence, layout, finding = self.shot.sequence, self.shot.layout, self.finding
        return {
            "schema": "exwarp.inspect/1",
            "pattern": sequence.pattern,
            "frames": ranges(sequence.numbers),
            "count": len(sequence.numbers),
            "width": self.shot.display.width,
            "height": self.shot.display.height,
            "fps": {"base": self.fps, "source": self.fps_source},
            "producer": layout.producer,
            "parts": [_part(part) for part in self.parts],
            "roles": {
                role.value: [ref.name if not ref.aov else f"{ref.aov}:{ref.name}" for ref in refs]
                for role, refs in layout.roles.items()
            },
            "motion": None
            if Role.MOTION not in layout
            else _motion(self.shot, finding, self.problem),
        }


def inspect(settings: SourceSettings) -> Inspection:
    """Look into a sequence and measure its motion convention.

    Raises
    ------
    InputError
        When the sequence is not there, has gaps, or cannot be read.
    """
    shot = open_shot(settings.sequence)
    Timeline.of(shot.sequence.numbers)
    with ExrReader(shot.sequence.files[shot.sequence.numbers[0]]) as file:
        parts = file.parts
    finding, problem = None, None
    try:
        finding = find_motion(shot, settings.motion)
    except MotionError as error:
        problem = str(error)
    fps, fps_source = rate_of(shot, settings.fps)
    return Inspection(shot, parts, finding, problem, float(fps), fps_source)


def missing_roles(layout: Layout) -> list[Role]:
    """Return the roles that were looked for in vain."""
    return [role for role in Role if role not in layout]


def _part(part: Part) -> dict[str, Any]:
    return {
        "name": part.name,
        "view": part.view,
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
