"""Whose work a file in the output folder is: ExWarp's, as it was written or damaged, or another's.

A checksum that holds proves that a file is ExWarp's, byte for byte. Where it does not hold, the
pixels decide: a file that decodes was edited, a file that does not was damaged. Formats without
room for a checksum have the program's name at most, which edits in other programs replace.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any

from exwarp_cli.errors import DamagedFileError, InputError
from exwarp_cli.io.exr.header import MAGIC
from exwarp_cli.io.output import CHECKSUM, PREFIX, is_intact, read_text
from exwarp_cli.io.reading_retry import with_retries
from exwarp_cli.io.sequence import EXR
from exwarp_cli.io.soundness import require_sound
from exwarp_cli.io.still_seal import facts_in_bytes, has_seal
from exwarp_cli.io.stills import SEALED, read_still

KEY_FRAMES = "keyFrames"
"""Attribute of generated frames: number and digest of the key frames on both sides."""

REQUESTED_METHOD = "requestedMethod"
"""Attribute of generated frames: the run's method, which a single frame's may differ from."""

FACTS = ("kind", "method", REQUESTED_METHOD, KEY_FRAMES)

_NAME = re.compile(rb"ExWarp \d")
_NAMED_WITHIN = 4096
"""Bytes from both ends in which a format keeps the program's name."""


class State(Enum):
    """What a file's bytes say of who wrote them."""

    INTACT = "intact"
    """ExWarp wrote it, byte for byte; or so says its name in a format without checksums."""

    DAMAGED = "damaged"
    """ExWarp wrote it, and its pixels do not decode; or it is empty."""

    EDITED = "edited"
    """ExWarp wrote it, and another program changed it since."""

    FOREIGN = "foreign"
    """Nothing in it is ExWarp's."""


@dataclass(frozen=True)
class Authorship:
    """Whose work a file is.

    Attributes
    ----------
    state
        What its bytes say.
    facts
        Those of `FACTS` that it says of itself, without the prefix.
    """

    state: State
    facts: Mapping[str, Any] = field(default_factory=dict)


def authorship_of(path: Path) -> Authorship | None:
    """Return whose work a file is; None if there is no file.

    Raises
    ------
    UnreadableError
        When the system does not let the file through.
    """
    try:
        data = with_retries(path, path.read_bytes)
    except IsADirectoryError:
        return Authorship(State.FOREIGN)
    except OSError:  # there is none, or the path is wrong, which is reported when it is written
        return None
    if not data.strip(b"\0"):
        # After a power cut files are empty, or have their length and no content.
        return Authorship(State.DAMAGED)
    if path.suffix.lower() in EXR:
        return _of_exr(path, data)
    return _of_still(path, data)


def _of_exr(path: Path, data: bytes) -> Authorship:
    if not data.startswith(MAGIC):
        return Authorship(State.FOREIGN)
    texts = {name: read_text(data, f"{PREFIX}{name}") for name in FACTS}
    facts = {name: text for name, text in texts.items() if text is not None}
    if is_intact(data):
        return Authorship(State.INTACT, facts)
    if not facts and read_text(data, CHECKSUM) is None:
        return Authorship(State.FOREIGN)
    try:
        require_sound((path,))
    except DamagedFileError:
        return Authorship(State.DAMAGED, facts)
    except InputError:  # deep or subsampled: never ExWarp's
        return Authorship(State.EDITED, facts)
    return Authorship(State.EDITED, facts)


def _of_still(path: Path, data: bytes) -> Authorship:
    if path.suffix.lower() not in SEALED:
        ends = data[:_NAMED_WITHIN] + data[-_NAMED_WITHIN:]
        return Authorship(State.INTACT if _NAME.search(ends) else State.FOREIGN)
    facts = facts_in_bytes(data)
    if facts is not None:
        return Authorship(State.INTACT, facts)
    if not has_seal(data):
        return Authorship(State.FOREIGN)
    try:
        read_still(path)
    except DamagedFileError:
        return Authorship(State.DAMAGED)
    except InputError:  # other channels, or EXR under that name
        return Authorship(State.EDITED)
    return Authorship(State.EDITED)
