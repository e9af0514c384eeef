"""Footage without AOVs, a video or a sequence of stills, in the place of rendered EXR frames."""

from __future__ import annotations

import os
import threading
from contextlib import suppress
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from exwarp_cli.domain.colour import SRGB
from exwarp_cli.domain.frame import Image, Window
from exwarp_cli.domain.settings import SourceSettings
from exwarp_cli.errors import InputError, LayoutError
from exwarp_cli.io.channels import ChannelRef, Layout, Role
from exwarp_cli.io.display_colour import primaries_of
from exwarp_cli.io.exr.reader import ExrFile
from exwarp_cli.io.exr.writer import COMPRESSIONS, PartTemplate, PlaneTemplate, Template
from exwarp_cli.io.files import with_retries
from exwarp_cli.io.frame_names import file_type, split_names
from exwarp_cli.io.generated_frames import FrameTemplate, read_picture
from exwarp_cli.io.key_file import file_digest
from exwarp_cli.io.sequences import EXR, Sequence, find_sequence
from exwarp_cli.io.shot import Shot, count_nonfinite, first_usable
from exwarp_cli.io.stills import STILLS, StillTemplate, read_still_header, require_writer
from exwarp_cli.io.video_reader import CLIPS, Clip, ClipReader, is_clip, open_clip
from exwarp_cli.io.video_writer import VideoLook

# Digits of the numbers that a clip's frames get as files; they count from 1.
CLIP_PADDING = 4

# The widest pixel that a video is labelled with; its inverse is the narrowest.
MAX_PIXEL_ASPECT = 255

# Suffixes of sound files, in lower case.
SOUNDS = (".wav", ".mp3", ".m4a", ".aac", ".flac", ".ogg", ".opus", ".wma", ".aif", ".aiff", ".ac3")


@dataclass(frozen=True)
class ClipSequence(Sequence):
    """A video as the sequence that its frames would be as files, numbered from 1.

    Every number's path is the video's own, and so is the folder, where no other file can lie.
    """

    clip: Clip = field(compare=False, repr=False)
    # By thread, as each decodes for itself; sequences of other numbers share them
    readers: dict[int, ClipReader] = field(default_factory=dict, compare=False, repr=False)

    @property
    def pattern(self) -> str:
        """Path of the video."""
        return str(self.folder)

    def image(self, number: int) -> Image:
        """Decode a frame, cheaply as long as numbers grow.

        Raises DamagedFileError when damage affects it, or the video ends early. Raises
        UnreadableError when the system does not let it through.
        """
        reader = self.readers.setdefault(threading.get_ident(), ClipReader(self.clip))
        window = read_display_window(self, number)
        read = partial(reader.read, number - 1)
        return Image(with_retries(self.clip.path, read), window, window)


def find_frames(spec: str, gaps: bool = False, scan: str = SourceSettings.scan) -> Sequence:
    """Find a video, a sequence of stills, or one of EXR; in a folder that holds both, the EXR.

    Arguments as in `find_footage`. Raises InputError when there is none, or several.
    """
    return find_footage(spec, gaps, scan) or find_sequence(spec, gaps=gaps)


def find_footage(spec: str, gaps: bool = False, scan: str = SourceSettings.scan) -> Sequence | None:
    """Find a video or a sequence of stills; None where EXR is meant.

    With `gaps` missing frames in between are listed, too. `scan` is as in `open_clip`.

    Raises InputError when there are several, or a video cannot be read.
    """
    path = Path(spec)
    if is_clip(spec):
        clip = open_clip(path, scan)
        files = dict.fromkeys(range(1, clip.count + 1), path)
        return ClipSequence(f"{path.stem}.", CLIP_PADDING, ".png", path, files, clip)
    suffix = path.suffix.lower()
    is_plain_path = suffix in STILLS
    if spec and path.is_dir():
        names: list[str] = []
        with suppress(OSError), os.scandir(path) as entries:  # the search for the sequence fails
            names = [entry.name for entry in entries if not entry.name.startswith(".")]
        is_plain_path = not split_names(names, EXR) and bool(split_names(names, STILLS))
    elif suffix not in (*EXR, *STILLS) and not suffix[1:].isdigit() and path.is_file():
        # A number behind the last point is a frame's, which has messages of its own.
        if suffix in SOUNDS:
            raise InputError(f"{path} is sound, which has no frames; name a video or frames")
        types = ", ".join((*EXR, *STILLS, *CLIPS))
        raise InputError(
            f"{path} is of a kind that is not read; convert it to one of these: {types}"
        )
    return find_sequence(spec, STILLS, gaps) if is_plain_path else None


def is_plain(sequence: Sequence) -> bool:
    """Return whether a sequence is a video or one of stills."""
    return sequence.type not in EXR


def make_shot(sequence: Sequence, keep_going: bool = False) -> Shot:
    """Return a video or a sequence of stills as a shot that has colour alone.

    With `keep_going` the first still that is sound is taken. Raises InputError when the first still
    cannot be read.
    """

    def make_from(number: int) -> Shot:
        if isinstance(sequence, ClipSequence):
            has_alpha, producer = sequence.clip.has_alpha, "video"
        else:
            path = sequence.files[number]
            if keep_going:
                read_picture(path)
            has_alpha = read_still_header(path)[0].has_alpha
            producer = f"{sequence.type.lstrip('.').upper()} images"
        colour = tuple(ChannelRef("", name) for name in ("RGBA" if has_alpha else "RGB"))
        layout = Layout({Role.COLOUR: colour}, producer=producer)
        display = read_display_window(sequence, number)
        return Shot(sequence, {}, layout, display, first=number, keep_going=keep_going)

    return first_usable(sequence.numbers if keep_going else sequence.numbers[:1], make_from)


def read_sequence_picture(sequence: Sequence, number: int, view: str = "") -> Image:
    """Read the colour of a frame of any kind of sequence; of EXR, of one view, "" for the hero.

    Raises InputError when it is missing or damaged, LayoutError when no colour is recognised.
    """
    if isinstance(sequence, ClipSequence):
        return sequence.image(number)
    return read_picture(sequence.files[number], view)


def read_key_picture(shot: Shot, number: int) -> Image:
    """Read a key frame of a video or of stills.

    Raises LayoutError when it has another size than the first, or has alpha where the first has
    none.
    """
    image = read_sequence_picture(shot.sequence, number)
    window, channels = image.display_window, len(shot.layout.roles[Role.COLOUR])
    if window != shot.display or image.pixels.shape[-1] != channels:
        raise LayoutError(
            f"{shot.sequence.files[number]} is {window.width}x{window.height} with "
            f"{image.pixels.shape[-1]} channels, and the first frame is {shot.display.width}x"
            f"{shot.display.height} with {channels}; write all frames alike"
        )
    shot.nonfinite.note(number, {Role.COLOUR.value: count_nonfinite((image.pixels,))})
    return image


def read_display_window(sequence: Sequence, number: int) -> Window:
    """Return the display window of any kind of sequence, by one of its frames."""
    if isinstance(sequence, ClipSequence):
        return Window(0, 0, sequence.clip.width, sequence.clip.height)
    path = sequence.files[number]
    if is_plain(sequence):
        return read_still_header(path)[1]
    with ExrFile(path) as file:
        return file.parts[0].display_window


def digest_frame(sequence: Sequence, number: int) -> str:
    """Digest what a frame of a video or of stills depends on."""
    if isinstance(sequence, ClipSequence):
        clip = sequence.clip
        names = {"alpha": clip.has_alpha, "deinterlaced": clip.is_deinterlaced}
        reading = (name for name, applies in names.items() if applies)
        return " ".join((clip.digest, str(number), *reading))
    return file_digest(sequence.files[number])


def make_frame_template(shot: Shot, number: int, suffix: str) -> FrameTemplate:
    """Return the template for frames that are made of footage, by the suffix of the files to write.

    EXR is half and scene-linear, stills are as their key frame, and frames of a video have sRGB
    codes of 8 bits, or of 16 if it has more than 8.
    """
    if file_type(suffix) in EXR:
        planes = tuple(
            PlaneTemplate(("", ref), ref.name, np.dtype(np.float16), bounded=True)
            for ref in shot.layout.roles[Role.COLOUR]
        )
        header = {"compression": COMPRESSIONS["zip"]}
        return Template((PartTemplate(header, planes, shot.display),), planes)
    if isinstance(shot.sequence, ClipSequence):
        clip = shot.sequence.clip
        dtype, channels = np.dtype(np.uint16 if clip.deep else np.uint8), 3 + clip.has_alpha
        return StillTemplate((), dtype, 8 * dtype.itemsize, channels, SRGB, premultiplied=False)
    return read_still_header(shot.sequence.files[number])[0]


def clip_rate(sequence: Sequence) -> Fraction | None:
    """Return the frame rate of a video; None for any other sequence."""
    return sequence.clip.rate if isinstance(sequence, ClipSequence) else None


def make_video_look(
    shot: Shot, begin: Fraction, end: Fraction | None, note: str, apart: str | None = None
) -> VideoLook:
    """Return the properties of a video made of a sequence, with a note as in `VideoLook`.

    Of EXR, the header of the first frame has colour and pixel aspect. The sound goes along from
    `begin` to `end`, in frames of the input from the first; None is the end of all. `apart` is why
    neither sound, subtitles nor timecode go along; None if they do.
    """
    sequence = shot.sequence
    if not is_plain(sequence):
        header = shot.headers.read(sequence.files[shot.first]).attributes[0]
        ratio, aspect = header.get("pixelAspectRatio"), Fraction(1)
        if isinstance(ratio, (int, float)) and 1 / MAX_PIXEL_ASPECT <= ratio <= MAX_PIXEL_ASPECT:
            # A float32 of 16/15 is no exact fraction; videos hold one of small numbers.
            aspect = Fraction(ratio).limit_denominator(MAX_PIXEL_ASPECT)
        return VideoLook(pixel_aspect=aspect, note=note, primaries=primaries_of(header))
    if not isinstance(sequence, ClipSequence):
        return VideoLook(note=note)
    clip = sequence.clip
    remarks = []
    if clip.has_alpha:
        remarks.append(
            f"the alpha of {clip.path} is left out of the video, which has none: it is shown "
            "over black; frames as PNG or EXR keep it"
        )
    sound, timecode = None, None
    if apart is None:
        sound, timecode = clip.sound(begin, end), clip.look.timecode
        timecode = timecode and replace(timecode, later=begin)
    else:
        tracks = clip.look.sound
        extras = {
            "the sound": tracks and tracks.codecs,
            "the text of subtitles": tracks and tracks.subtitles,
            "the timecode": clip.look.timecode,
        }
        if lost := " and ".join(name for name, exists in extras.items() if exists):
            remarks.append(f"the video goes without {lost} of {clip.path}, as {apart}")
    return replace(clip.look, sound=sound, note=note, timecode=timecode, remarks=tuple(remarks))


def describe_footage(sequence: Sequence) -> dict[str, Any]:
    """Return the properties of a video or of stills, as plain data."""
    if isinstance(sequence, ClipSequence):
        clip = sequence.clip
        colour = clip.look.colour
        return {
            "kind": "video",
            "bits": 16 if clip.deep else 8,
            "colour": f"{colour.matrix}, {'full' if colour.full_range else 'limited'} range",
            "alpha": "kept" if clip.has_alpha else None,
            "pixel_aspect": float(clip.look.pixel_aspect),
            "sound": list(clip.look.sound.codecs if clip.look.sound else ()),
        }
    template, _ = read_still_header(next(iter(sequence.files.values())))
    return {
        "kind": "stills",
        "bits": template.bits,
        "colour": f"{template.curve.name} curve",
        "alpha": "kept" if template.has_alpha else None,
        "pixel_aspect": 1.0,
        "sound": [],
    }


def lost_alpha_message(shot: Shot, suffix: str) -> str | None:
    """Return the message that frames lose the alpha of footage; None if they do not."""
    has_alpha = is_plain(shot.sequence) and len(shot.layout.roles[Role.COLOUR]) > 3
    kind = file_type(suffix)
    if not has_alpha or kind in EXR or require_writer(Path(f"frame{kind}")).supports("alpha"):
        return None
    return (
        f"the alpha of {shot.sequence.pattern} is left out, as {kind} files have none; name frames "
        "as .png or .exr to keep it"
    )


def uneven_rate_message(sequence: Sequence) -> str | None:
    """Return the message on a video whose own rate varies; None where it is even."""
    if not isinstance(sequence, ClipSequence) or not sequence.clip.pacing.varies:
        return None
    clip = sequence.clip
    return (
        f"the frame rate of {clip.path} varies; it is taken at {float(clip.rate):g} fps, with "
        f"{clip.pacing.repeated} frames shown again and {clip.pacing.skipped} left out"
    )


def close_sequences(*sequences: Sequence) -> None:
    """Stop decoding the videos among some sequences; a later read starts them again."""
    for sequence in sequences:
        if isinstance(sequence, ClipSequence):
            for thread in list(sequence.readers):
                sequence.readers.pop(thread).close()
