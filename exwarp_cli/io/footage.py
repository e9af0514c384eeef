"""Pictures without AOVs, a video's or a sequence of stills, in the place of rendered EXR frames."""

from __future__ import annotations

import os
import threading
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from exwarp_cli.domain.colour import SRGB
from exwarp_cli.domain.frame import Image, Window
from exwarp_cli.domain.settings import SourceSettings
from exwarp_cli.errors import InputError, LayoutError
from exwarp_cli.io.channels import ChannelRef, Layout, Role
from exwarp_cli.io.chromaticities import primaries_of
from exwarp_cli.io.clip import CLIPS, Clip, ClipReader, is_clip, open_clip
from exwarp_cli.io.exr.reader import display_window
from exwarp_cli.io.exr.template import PartTemplate, PlaneTemplate, Template
from exwarp_cli.io.exr.writer import COMPRESSIONS
from exwarp_cli.io.frame_names import file_type, split_names
from exwarp_cli.io.output import FrameTemplate, file_digest, read_picture
from exwarp_cli.io.sequence import EXR, Sequence, find_sequence
from exwarp_cli.io.shot import Shot
from exwarp_cli.io.soundness import count_broken, first_of
from exwarp_cli.io.stills import (
    STILLS,
    StillTemplate,
    has_room_for_alpha,
    read_still_template,
    still_size,
)
from exwarp_cli.io.video import VideoLook, pixel_aspect

CLIP_PADDING = 4
"""Digits of the numbers that a clip's frames get as files; they count from 1."""

SOUNDS = (".wav", ".mp3", ".m4a", ".aac", ".flac", ".ogg", ".opus", ".wma", ".aif", ".aiff", ".ac3")
"""Suffixes of files of sound, in lower case."""


class ClipFrames:
    """Frames of a video by number, from 1; each thread that asks decodes for itself."""

    def __init__(self, clip: Clip) -> None:
        self.clip = clip
        self._readers: dict[int, ClipReader] = {}

    @property
    def display(self) -> Window:
        """The window of every frame."""
        return Window(0, 0, self.clip.width, self.clip.height)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the video's file, hexadecimal."""
        return file_digest(self.clip.path)

    def image(self, number: int) -> Image:
        """Decode a frame, cheaply as long as numbers grow; raises DamagedFileError."""
        thread = threading.get_ident()
        if thread not in self._readers:
            self._readers[thread] = ClipReader(self.clip).__enter__()
        return Image(self._readers[thread].read(number - 1), self.display, self.display)

    def close(self) -> None:
        """Stop decoding; a later call begins again."""
        for thread in list(self._readers):
            self._readers.pop(thread).__exit__(None, None, None)


@dataclass(frozen=True)
class ClipSequence(Sequence):
    """A video as the sequence that its frames would be as files, numbered from 1.

    Every number's path is the video's own, and so is the folder, where no other file can lie.

    Attributes
    ----------
    frames
        What reads them.
    """

    frames: ClipFrames = field(compare=False, repr=False)

    @classmethod
    def of(cls, clip: Clip) -> ClipSequence:
        """Number the frames of a video."""
        files = dict.fromkeys(range(1, clip.count + 1), clip.path)
        return cls(clip.path, f"{clip.path.stem}.", CLIP_PADDING, ".png", files, ClipFrames(clip))

    @property
    def pattern(self) -> str:
        """Path of the video."""
        return str(self.directory)


def find_frames(spec: str, gaps: bool = False, scan: str = SourceSettings.scan) -> Sequence:
    """Find a video, a sequence of stills, or one of EXR; in a folder that holds both, the EXR.

    With `gaps` frames that are missing in between are listed, too.

    Raises
    ------
    InputError
        When there is none, or several.
    """
    return find_plain(spec, gaps, scan) or find_sequence(spec, gaps=gaps)


def find_plain(spec: str, gaps: bool = False, scan: str = SourceSettings.scan) -> Sequence | None:
    """Find a video or a sequence of stills; None where EXR is meant.

    With `gaps` frames that are missing in between are listed, too. `scan` is as in `open_clip`.

    Raises
    ------
    InputError
        When there are several, or a video cannot be read.
    """
    if is_clip(spec):
        return ClipSequence.of(open_clip(Path(spec), scan))
    path = Path(spec)
    _require_picture(path)
    if spec and path.is_dir():
        plain = not _holds(path, EXR) and _holds(path, STILLS)
    else:
        plain = path.suffix.lower() in STILLS
    return find_sequence(spec, STILLS, gaps) if plain else None


def _require_picture(path: Path) -> None:
    """Refuse a file that is neither EXR, a still nor a video, by its suffix."""
    suffix = path.suffix.lower()
    # A number behind the last point is a frame's, which has messages of its own.
    if suffix in (*EXR, *STILLS) or suffix[1:].isdigit() or not path.is_file():
        return
    if suffix in SOUNDS:
        raise InputError(f"{path} is sound, which has no frames; name a video or frames")
    known = ", ".join((*EXR, *STILLS, *CLIPS))
    raise InputError(f"{path} is of a kind that is not read; convert it to one of these: {known}")


def is_plain(sequence: Sequence) -> bool:
    """Whether a sequence is a video or one of stills."""
    return sequence.type not in EXR


def shot_of(sequence: Sequence, keep_going: bool = False) -> Shot:
    """Return a video or a sequence of stills as a shot that has colour alone.

    Parameters
    ----------
    sequence
        The pictures.
    keep_going
        Whether to take the first still that is sound.

    Raises
    ------
    InputError
        When the first still cannot be read.
    """

    def by(number: int) -> Shot:
        if isinstance(sequence, ClipSequence):
            clip = sequence.frames.clip
            display, alpha, producer = sequence.frames.display, clip.has_alpha, "video"
        else:
            path = sequence.files[number]
            if keep_going:
                read_picture(path)
            display, alpha = Window(0, 0, *still_size(path)), read_still_template(path).has_alpha
            producer = f"{sequence.type.lstrip('.').upper()} images"
        colour = tuple(ChannelRef("", name) for name in ("RGBA" if alpha else "RGB"))
        layout = Layout({Role.COLOUR: colour}, producer=producer)
        return Shot(sequence, {}, layout, display, first=number, keep_going=keep_going)

    return first_of(sequence.numbers if keep_going else sequence.numbers[:1], by)


def picture(sequence: Sequence, number: int, view: str = "") -> Image:
    """Read the colour of a frame of any kind of sequence.

    Parameters
    ----------
    sequence
        A video, stills or EXR.
    number
        Of the frame.
    view
        Which view of an EXR file; "" for the hero.

    Raises
    ------
    InputError
        When it is missing or damaged.
    LayoutError
        When no colour is recognised.
    """
    if isinstance(sequence, ClipSequence):
        return sequence.frames.image(number)
    return read_picture(sequence.files[number], view)


def key_picture(shot: Shot, number: int) -> Image:
    """Read a key frame of a video or of stills.

    Raises
    ------
    LayoutError
        When it has another size than the first, or has alpha where the first has none.
    """
    image = picture(shot.sequence, number)
    found, channels = image.display_window, len(shot.layout.roles[Role.COLOUR])
    if found != shot.display or image.pixels.shape[-1] != channels:
        raise LayoutError(
            f"{shot.sequence.files[number]} is {found.width}x{found.height} with "
            f"{image.pixels.shape[-1]} channels, and the first frame is {shot.display.width}x"
            f"{shot.display.height} with {channels}; write all frames alike"
        )
    shot.nonfinite.note(number, {Role.COLOUR.value: count_broken((image.pixels,))})
    return image


def picture_size(sequence: Sequence, number: int) -> Window:
    """Return the display window of any kind of sequence, by one of its frames."""
    if isinstance(sequence, ClipSequence):
        return sequence.frames.display
    path = sequence.files[number]
    if is_plain(sequence):
        return Window(0, 0, *still_size(path))
    return display_window(path)


def digest_of(sequence: Sequence, number: int) -> str:
    """Digest what a frame of a video or of stills depends on."""
    if isinstance(sequence, ClipSequence):
        read = sequence.frames.clip.reading
        return " ".join((sequence.frames.digest, str(number), *read))
    return file_digest(sequence.files[number])


def plain_template(shot: Shot, number: int, suffix: str) -> FrameTemplate:
    """Return what frames that are made of a video or of stills are written by.

    Parameters
    ----------
    shot
        The input.
    number
        Of the key frame.
    suffix
        Of the files to write. EXR is half and scene-linear, stills are as their key frame, and
        frames of a video have sRGB codes of 8 bits, or of 16 if it has more than 8.
    """
    if file_type(suffix) in EXR:
        planes = tuple(
            PlaneTemplate(("", ref), ref.name, np.dtype(np.float16), bounded=True)
            for ref in shot.layout.roles[Role.COLOUR]
        )
        header = {"compression": COMPRESSIONS["zip"]}
        return Template((PartTemplate(header, planes, shot.display),), planes)
    if isinstance(shot.sequence, ClipSequence):
        clip = shot.sequence.frames.clip
        dtype, channels = np.dtype(np.uint16 if clip.deep else np.uint8), 3 + clip.has_alpha
        return StillTemplate((), dtype, 8 * dtype.itemsize, channels, SRGB, premultiplied=False)
    return read_still_template(shot.sequence.files[number])


def own_rate(sequence: Sequence) -> Fraction | None:
    """Return the frame rate that a video has; None for any other sequence."""
    return sequence.frames.clip.rate if isinstance(sequence, ClipSequence) else None


def look_of(
    shot: Shot, begin: Fraction, end: Fraction | None, note: str, apart: str | None = None
) -> VideoLook:
    """Return what a video made of a sequence is like.

    Parameters
    ----------
    shot
        The input. What an EXR header says of colour and pixels is read in its first frame.
    begin, end
        The part of its sound that goes along, in frames of the input from the first; to the end of
        all for None.
    note
        See `VideoLook`.
    apart
        Why neither sound, subtitles nor timecode go along; None if they do.
    """
    sequence = shot.sequence
    if is_plain(sequence) and not isinstance(sequence, ClipSequence):
        return VideoLook(note=note)
    if not isinstance(sequence, ClipSequence):
        header = shot.headers.read(sequence.files[shot.first]).attributes[0]
        aspect = pixel_aspect(header.get("pixelAspectRatio"))
        return VideoLook(pixel_aspect=aspect, note=note, primaries=primaries_of(header))
    clip = sequence.frames.clip
    remarks = []
    if clip.has_alpha:
        remarks.append(
            f"the alpha of {clip.path} is left out of the video, as H.264 has none: it is shown "
            "over black; frames as PNG or EXR keep it"
        )
    if apart is None:
        code = clip.look.timecode
        code = None if code is None else replace(code, later=begin)
        sound = clip.sound(begin, end)
        return replace(clip.look, sound=sound, note=note, timecode=code, remarks=tuple(remarks))
    if lost := _beside_the_picture(clip):
        remarks.append(f"the video goes without {lost} of {clip.path}, as {apart}")
    return replace(clip.look, sound=None, note=note, timecode=None, remarks=tuple(remarks))


def _beside_the_picture(clip: Clip) -> str:
    """Name what a video has beside its picture; "" for nothing."""
    sound = clip.look.sound
    there = {
        "the sound": sound is not None and sound.codecs,
        "the text of subtitles": sound is not None and sound.subtitles,
        "the timecode": clip.look.timecode,
    }
    return " and ".join(name for name, has in there.items() if has)


def facts_of(sequence: Sequence) -> dict[str, Any]:
    """Return what is known of the pictures of a video or of stills, as plain data."""
    if isinstance(sequence, ClipSequence):
        clip = sequence.frames.clip
        sound = () if clip.look.sound is None else clip.look.sound.codecs
        colour = clip.look.colour
        return {
            "kind": "video",
            "bits": 16 if clip.deep else 8,
            "colour": f"{colour.matrix}, {'full' if colour.full_range else 'limited'} range",
            "alpha": "kept" if clip.has_alpha else None,
            "pixel_aspect": float(clip.look.pixel_aspect),
            "sound": list(sound),
        }
    template = read_still_template(next(iter(sequence.files.values())))
    return {
        "kind": "stills",
        "bits": template.bits,
        "colour": f"{template.curve.name} curve",
        "alpha": "kept" if template.has_alpha else None,
        "pixel_aspect": 1.0,
        "sound": [],
    }


def lost_alpha(shot: Shot, suffix: str) -> str | None:
    """Say that frames lose the alpha of a video or of stills; None if they do not."""
    has_alpha = is_plain(shot.sequence) and len(shot.layout.roles[Role.COLOUR]) > 3
    if not has_alpha or file_type(suffix) in EXR or has_room_for_alpha(file_type(suffix)):
        return None
    return (
        f"the alpha of {shot.sequence.pattern} is left out, as {file_type(suffix)} files have "
        "none; name frames as .png or .exr to keep it"
    )


def unevenness_of(sequence: Sequence) -> str | None:
    """Say how a video whose own rate varies is taken; None where it is even."""
    if not isinstance(sequence, ClipSequence) or not sequence.frames.clip.pacing.varies:
        return None
    clip = sequence.frames.clip
    return (
        f"the frame rate of {clip.path} varies; it is taken at {float(clip.rate):g} fps, with "
        f"{clip.pacing.repeated} frames shown again and {clip.pacing.skipped} left out"
    )


def close(*sequences: Sequence) -> None:
    """Close what reading frames of some sequences left open."""
    for sequence in sequences:
        if isinstance(sequence, ClipSequence):
            sequence.frames.close()


def _holds(folder: Path, suffixes: tuple[str, ...]) -> bool:
    """Whether a folder has frames with one of some suffixes."""
    try:
        with os.scandir(folder) as entries:
            names = [entry.name for entry in entries if not entry.name.startswith(".")]
    except OSError:
        return False  # who looks for the sequence says why
    return bool(split_names(names, suffixes))
