"""Names of the surfaces in a Cryptomatte, and which of them a user calls dynamic.

A manifest is a JSON object {name: id in hexadecimal}. What is found in files is not always JSON:
Blender 5.0 leaves quotes and backslashes in names as they are, some writers cut a long one off, and
names come in encodings of their own. So it is read entry by entry; what cannot be read is left out.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path

from exwarp_cli.errors import UsageError
from exwarp_cli.io.cryptomatte import Cryptomatte
from exwarp_cli.io.cryptomatte_ids import identity

MAX_SIZE = 64 << 20
"""Characters beyond which a manifest is not read: some million names."""

SHOWN = 8
"""How many names a message lists."""

_ID = re.compile(r'"\s*:\s*"([0-9a-fA-F]{1,8})"\s*(?:,|\}|$)')


@dataclass(frozen=True)
class Manifest:
    """The names that one frame's Cryptomatte knows.

    Attributes
    ----------
    ids
        The bits of each name's id.
    problem
        Why there are none, as half a sentence; "" where there are some.
    hashed
        Whether a name's id is its hash, so that a name alone gives its id.
    """

    ids: Mapping[str, int] = field(default_factory=dict)
    problem: str = ""
    hashed: bool = True

    def names(self, rounded: bool = False) -> dict[int, str]:
        """Return the names by id as of :func:`~exwarp_cli.io.cryptomatte_ids.surfaces`."""
        return {identity(bits, rounded): name for name, bits in self.ids.items()}


def read_manifest(cryptomatte: Cryptomatte, path: Path) -> Manifest:
    """Read a Cryptomatte's manifest, from its header or from the file that the header names.

    Parameters
    ----------
    cryptomatte
        As found in a file.
    path
        That file; the manifest's own path is relative to its folder.

    Returns
    -------
    Manifest
        Without names where none can be had: the ids are as good without.
    """
    text, origin, problem = cryptomatte.manifest or "", "its header's manifest", ""
    if not text.strip():
        text, origin, problem = _beside(cryptomatte.sidecar or "", path)
    if not problem and len(text) > MAX_SIZE:
        problem = f"{origin} is larger than {MAX_SIZE >> 20} MiB"
    ids = {} if problem else parse_manifest(text)
    if not ids:
        problem = problem or f"{origin} holds no names that can be read"
    return Manifest(ids, problem, cryptomatte.hashed)


def _beside(sidecar: str, path: Path) -> tuple[str, str, str]:
    """Read a manifest's own file: its text, where that is, and why there is none."""
    if not sidecar:
        return "", "", "its header has no manifest"
    found = _sidecar(path, sidecar)
    if found is None:
        return "", sidecar, f"its manifest {shown(sidecar)} is not there"
    try:
        if found.stat().st_size > MAX_SIZE:
            return "", str(found), f"{found} is larger than {MAX_SIZE >> 20} MiB"
        return found.read_text("utf-8-sig", "surrogateescape"), str(found), ""
    except OSError as error:
        return "", str(found), f"{found} cannot be read ({error.strerror})"


def _sidecar(path: Path, sidecar: str) -> Path | None:
    """Find a manifest's own file: where the header says, else beside the image.

    Paths are written on other systems, and frames are moved with their manifests.
    """
    plain = sidecar.replace("\\", "/")
    for candidate in (
        path.parent / sidecar,
        path.parent / plain,
        path.parent / plain.split("/")[-1],
    ):
        try:
            if candidate.is_file():
                return candidate
        except (OSError, ValueError):  # too long, or with a zero byte
            continue
    return None


def parse_manifest(text: str) -> dict[str, int]:
    """Read a manifest's entries: the bits of each name's id.

    Of a manifest that is cut off the whole entries count. A name with a backslash is taken as JSON
    writes it or as it stands, whichever has the id for its hash.
    """
    ids: dict[str, int] = {}
    begin = 0
    for match in _ID.finditer(text):
        raw = text[begin : match.start()].lstrip().removeprefix("{").lstrip()
        begin = match.end()
        if raw.startswith('"'):
            bits = int(match[1], 16)
            ids[_unescaped(raw[1:], bits)] = bits
    return ids


def _unescaped(raw: str, bits: int) -> str:
    """Return a name as it is, from how a manifest writes it."""
    if "\\" not in raw or id_of(raw) == bits:
        return raw
    try:
        return str(json.loads(f'"{raw}"', strict=False))
    except ValueError:
        return raw


def id_of(name: str) -> int:
    """Return the bits of a name's id: its MurmurHash3, with the exponent of a finite float.

    Source: Cryptomatte specification 1.2, "Floating point conversion": the exponent is clamped to 1
    to 254, so that no id is zero, denormal, infinite or NaN.
    """
    hashed = murmur3(_encoded(name))
    exponent = min(max(hashed >> 23 & 0xFF, 1), 254)
    return (hashed & 0x807FFFFF) | exponent << 23


def murmur3(data: bytes) -> int:
    """Return the MurmurHash3_x86_32 of bytes, seed 0 (Austin Appleby, public domain algorithm)."""
    word = 0xFFFFFFFF

    def mixed(block: int) -> int:
        block = block * 0xCC9E2D51 & word
        return ((block << 15 | block >> 17) & word) * 0x1B873593 & word

    whole = len(data) // 4 * 4
    state = 0
    for i in range(0, whole, 4):
        state ^= mixed(int.from_bytes(data[i : i + 4], "little"))
        state = ((state << 13 | state >> 19) & word) * 5 + 0xE6546B64 & word
    state ^= mixed(int.from_bytes(data[whole:], "little"))
    state ^= len(data)
    state = (state ^ state >> 16) * 0x85EBCA6B & word
    state = (state ^ state >> 13) * 0xC2B2AE35 & word
    return state ^ state >> 16


def _encoded(name: str) -> bytes:
    """Return a name's bytes; those that were no UTF-8 come back as they were read."""
    try:
        return name.encode("utf-8", "surrogateescape")
    except UnicodeEncodeError:
        return name.encode("utf-8", "surrogatepass")


def shown(name: str) -> str:
    """Return a name for a message: on one line, printable, not too long."""
    plain = "".join(c if c.isprintable() else "?" for c in name)
    return repr(plain if len(plain) <= 60 else f"{plain[:59]}…")


@dataclass(frozen=True)
class Dynamic:
    """What a user calls dynamic.

    Attributes
    ----------
    ids
        As of :func:`~exwarp_cli.io.cryptomatte_ids.surfaces`, ascending.
    names
        What matched, in alphabetical order.
    """

    ids: tuple[int, ...]
    names: tuple[str, ...]


def dynamic_objects(
    option: str, manifests: Iterable[Manifest], where: str, rounded: bool = False
) -> Dynamic:
    """Find the ids of what ``--dynamic`` names.

    Parameters
    ----------
    option
        GLOB[,GLOB…]: ``*``, ``?`` and ``[…]`` as in file names, case-sensitive; or a whole name.
    manifests
        Of all frames of a sequence, so that every part of it gives the same ids.
    where
        The sequence and layer, for messages.
    rounded
        As in :func:`~exwarp_cli.io.cryptomatte_ids.surfaces`.

    Raises
    ------
    UsageError
        When a glob matches no name of the whole sequence. Without any manifest, names without
        wildcards are hashed as renderers do; globs cannot be looked up then.
    """
    globs = [glob.strip() for glob in option.split(",") if glob.strip()]
    if not globs:
        raise UsageError("--dynamic names nothing; give names or patterns such as 'car*,ball'")
    ids: dict[str, set[int]] = {}
    problem, hashed = "", True
    for manifest in manifests:
        problem, hashed = problem or manifest.problem, hashed and manifest.hashed
        for name, bits in manifest.ids.items():
            ids.setdefault(name, set()).add(bits)
    chosen: dict[str, set[int]] = {}
    for glob in globs:
        chosen |= _matching(glob, ids) if ids else _hashed(glob, where, problem, hashed)
    found = {identity(bits, rounded) for some in chosen.values() for bits in some}
    return Dynamic(tuple(sorted(found)), tuple(sorted(chosen)))


def _matching(glob: str, ids: Mapping[str, set[int]]) -> dict[str, set[int]]:
    """Return the names that a glob matches, with their ids."""
    found = {name: some for name, some in ids.items() if name == glob or fnmatchcase(name, glob)}
    if not found:
        listed = ", ".join(shown(name) for name in sorted(ids)[:SHOWN])
        more = f" and {len(ids) - SHOWN} more" if len(ids) > SHOWN else ""
        raise UsageError(
            f"--dynamic {shown(glob)} matches no name in the Cryptomatte manifests, which have "
            f"{listed}{more}; name objects of these"
        )
    return found


def _hashed(glob: str, where: str, problem: str, hashed: bool) -> dict[str, set[int]]:
    """Return the id that a name has without a manifest."""
    if not hashed or any(sign in glob for sign in "*?["):
        what = "give whole names, or render with a manifest" if hashed else "render with a manifest"
        raise UsageError(
            f"--dynamic {shown(glob)} cannot be looked up: {where} has no names, as "
            f"{problem or 'there are no frames'}; {what}"
        )
    return {glob: {id_of(glob)}}
