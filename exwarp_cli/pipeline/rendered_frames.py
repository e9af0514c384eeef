"""Frames that were rendered after all, which take the place of generated ones as they are."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from exwarp_cli import __version__
from exwarp_cli.domain.frame import KeyFrame
from exwarp_cli.domain.results import FrameKind
from exwarp_cli.domain.settings import SourceSettings
from exwarp_cli.domain.timeline import Slot, ranges
from exwarp_cli.errors import InputError, LayoutError, OutputError
from exwarp_cli.io.channels import Role
from exwarp_cli.io.footage import digest_frame, find_frames, is_plain, read_key_picture
from exwarp_cli.io.frames import read_raw
from exwarp_cli.io.generated_frames import FileState, find_authorship
from exwarp_cli.io.sequences import EXR, FramePattern, Sequence, find_sequence
from exwarp_cli.io.shot import count_nonfinite, require_sound
from exwarp_cli.io.video_reader import is_clip
from exwarp_cli.io.views import expand_view
from exwarp_cli.pipeline.extra_layers import Content, LayerStore
from exwarp_cli.pipeline.key_frames import GEOMETRY_WITHOUT_NORMAL
from exwarp_cli.pipeline.source import Source, find_other_windows
from exwarp_cli.synthesis.methods import Method

# Kinds of frames that no renderer made.
NEW = (FrameKind.GENERATED.value, FrameKind.DROPPED.value)


@dataclass(frozen=True)
class RenderedFrames:
    """Frames of the output, between key frames, that were rendered after all."""

    sequence: Sequence  # their files by output number; no others
    note: str  # says which frames are used, and which are not

    def require_usable(
        self, frames: FramePattern | None, source: Source, keys: tuple[int, ...]
    ) -> None:
        """Refuse to write over the rendered frames, or to take some of another size.

        `frames` are those that are written, `keys` indices of key frames. Raises OutputError;
        LayoutError, unless frames of another size are skipped.
        """
        sequence = self.sequence
        for number, path in sequence.files.items():
            if frames is not None and frames.path(number).resolve() == path.resolve():
                raise OutputError(
                    f"--rendered {path} is where this run would write; name another folder in -o, "
                    "or move the rendered frames"
                )
        if source.keys.keep_going:
            return
        timeline, display = source.timeline, source.keys.display
        numbers = [timeline.number(slot) for key in keys for slot in timeline.made_of(key)]
        members = {number: (sequence, number) for number in numbers if number in sequence.files}
        for number, window in find_other_windows(members, display).items():
            raise LayoutError(
                f"frame {number} of --rendered is {window} and the input is {display}; render it "
                "at the resolution and with the windows of the key frames"
            )


def find_rendered(spec: str, source: Source, scan: str = SourceSettings.scan) -> RenderedFrames:
    """Find rendered frames by their output numbers; any of them may exist.

    Key frames that are EXR are joined by EXR alone, as others lack channels. Raises InputError when
    there is no such sequence, or none of its frames is a new one of the output.
    """
    pattern = expand_view(spec, source.keys.view or None)[0]
    plain = is_plain(source.keys.sequence)
    sequence = find_frames(pattern, scan=scan) if plain else find_sequence(pattern)
    timeline = source.timeline
    slots = [slot for key in range(len(timeline.numbers)) for slot in timeline.slots_of(key)]
    output = f"{timeline.number(slots[0])}-{timeline.number(slots[-1])}"
    new = {timeline.number(slot) for slot in slots if slot.index}
    used = [number for number in sequence.numbers if number in new]
    unused = [number for number in sequence.numbers if number not in new]
    if not used:
        raise InputError(
            f"--rendered {sequence.pattern} has frames {ranges(sequence.numbers)}, and none of "
            f"them is a new frame of the output, {output}; number them as review.txt does"
        )
    note = f"rendered frames of {sequence.pattern}: {ranges(used)}"
    if unused:
        note += (
            f"; not used are {ranges(unused)}, which are numbers of key frames or not in the "
            f"output, {output}"
        )
    return RenderedFrames(sequence.over(used), note)


@dataclass(frozen=True)
class RenderedFrame:
    """A rendered frame that takes the place of a generated one."""

    path: Path
    frame: KeyFrame  # its colour; and its geometry as read, where that leads to slots around it
    recipe: str  # fingerprint of its written file
    broken: int  # how many pixels of its colour are NaN or infinite

    @property
    def leads(self) -> bool:
        """True if its vectors may lead to the slots around it."""
        return self.frame.gbuffer is not None and self.frame.gbuffer.has_motion


@dataclass(frozen=True)
class IntervalRendered:
    """Rendered frames of one interval, by slot."""

    frames: Mapping[int, RenderedFrame] = field(default_factory=dict)
    # Why further ones cannot be used; these slots are generated.
    unusable: Mapping[int, str] = field(default_factory=dict)


class RenderedReader:
    """Reads rendered frames, interval by interval."""

    def __init__(
        self,
        rendered: RenderedFrames,
        contents: tuple[Content, ...],  # of every view: a rendered frame must have all of it
        method: Method,  # says whether slots around are made from them, too
    ) -> None:
        self._source = source = contents[0].source
        # Slots around are made from them, too: of the beauty alone, from both sides, and along key
        # frames' vectors.
        is_alone = len(contents) == 1 and not contents[0].extra
        has_vectors = source.finding is not None and source.slots is None and not source.keys.aovs
        self.leads = is_alone and has_vectors and method.lookahead and method.needs_motion
        self._sequence = rendered.sequence
        keys = (content.source.keys for content in contents)
        self._shots = [replace(shot, sequence=rendered.sequence, aovs={}) for shot in keys]
        pairs = zip(self._shots, contents, strict=True)
        self._layers = [LayerStore(shot, content.extra) for shot, content in pairs]
        # What was found in the frames by output number, of each view.
        self.nonfinite = {shot.view: shot.nonfinite for shot in self._shots}
        self._last_key: int | None = None
        self._last = IntervalRendered()

    def read(self, key: int) -> IntervalRendered:
        """Read those of an interval, by the index of its key frame; the last one is kept.

        Raises InputError when a frame cannot be used, unless such frames are to be generated.
        """
        if self._last_key == key:
            return self._last
        frames: dict[int, RenderedFrame] = {}
        unusable: dict[int, str] = {}
        for slot in self._source.timeline.made_of(key):
            number = self._source.timeline.number(slot)
            if number not in self._sequence.files:
                continue
            try:
                frames[slot.index] = self._read_frame(slot, number)
            except InputError as error:
                problem = f"frame {number} of --rendered cannot be used: {error}"
                if not self._source.keys.keep_going:
                    raise type(error)(problem) from error
                unusable[slot.index] = problem
        self._last_key, self._last = key, IntervalRendered(frames, unusable)
        return self._last

    def _read_frame(self, slot: Slot, number: int) -> RenderedFrame:
        path = self._sequence.files[number]
        if path.suffix.lower() in EXR:
            require_sound((path,))
        authorship = None if is_clip(str(path)) else find_authorship(path)
        if (
            authorship is not None
            and authorship.state is FileState.INTACT
            and authorship.facts.get("kind") in NEW
        ):
            raise LayoutError(
                f"{path} was not rendered but made by ExWarp; name a folder of rendered frames "
                "alone"
            )
        frames = []
        for shot in self._shots:
            frame: KeyFrame | None = None
            if is_plain(self._source.keys.sequence):
                frame = KeyFrame(number, read_key_picture(shot, number), None)
            elif self.leads:
                roles = (Role.COLOUR, *GEOMETRY_WITHOUT_NORMAL)
                with suppress(LayoutError):  # a frame without geometry takes its place all the same
                    frame = read_raw(shot, number, roles, objects=True).key(self._source.convention)
            if frame is None:
                frame = replace(read_raw(shot, number, (Role.COLOUR,)).key(None), gbuffer=None)
            frames.append(frame)
        for layers in self._layers:
            layers.frame(number)
            layers.keep(())
        digest = digest_frame(self._sequence, number)
        facts = [__version__, FrameKind.RENDERED.value, digest, str(self._source.written_fps)]
        text = json.dumps([*facts, slot.key, slot.index])
        recipe = hashlib.sha256(text.encode()).hexdigest()
        broken = count_nonfinite((frames[0].image.pixels,))
        return RenderedFrame(path, frames[0], recipe, broken)
