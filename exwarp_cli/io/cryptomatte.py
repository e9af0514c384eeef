"""Cryptomattes: layers with the ids of surfaces, their pixels, and their manifests of names.

A Cryptomatte (Psyop's open specification, version 1.2) is a set of layers ``NAME00``, ``NAME01`` …
of four channels each: the id that covers most of a pixel, its share, the id that comes second, its
share; then ranks 2 and 3, and so on. An id is the hash of an object's name, kept as the bits of a
32-bit float. The header's attributes ``cryptomatte/KEY/…`` tell the name of the layers, the kind of
hash, and the manifest: which name has which id, here or in a file beside the image.

An id is a pattern of bits that happens to lie in a float. Arithmetic on it, a comparison included,
could change it or take two for one (zeros of two signs). So ids are handled as unsigned integers
only, and never pass :func:`exwarp_cli.io.frames.clean_stencil`.

A manifest is a JSON object {name: id in hexadecimal}. What is found in files is not always JSON:
Blender 5.0 leaves quotes and backslashes in names as they are, some writers cut a long one off, and
names come in encodings of their own. So it is read entry by entry; what cannot be read is left out.
"""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from enum import IntEnum
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np

from exwarp_cli.domain.frame import Float32, Int32
from exwarp_cli.errors import DamagedFileError, LayoutError, UsageError
from exwarp_cli.io.channels import ChannelRef
from exwarp_cli.io.exr.header import Channel
from exwarp_cli.kernels import raw_channels

# The only hash and the only conversion that the specification knows.
HASH, CONVERSION = "MurmurHash3_32", "uint32_to_float32"

# By how much the share of the prevailing surface must exceed every other one's. Depth and position
# are those at a pixel's centre, shares are filtered. Against ids at the centre of 43,200 pixels
# rendered by Cycles with 64 samples, the greatest share was the centre's in 78 % of those where it
# led by less than 0.05, in 89 % up to 0.15, 97 % up to 0.25, and always above 0.5; with 8 samples
# in 87, 80, 96 and 100 %.
LEAD = np.float32(0.1)

SAMPLES = 4096  # number of pixels that are looked at for damage

# The bits of a float's exponent, and those that are zero if it has ever been a half.
EXPONENT, HALF_TAIL = np.uint32(0x7F800000), np.uint32(0x1FFF)

MAX_MANIFEST_SIZE = 64 << 20  # characters beyond which a manifest is not read: some million names

# Names that a message lists.
MAX_NAMES = 8

# Attributes of the parts of files, in their order, by AOV.
Headers = Mapping[str, Sequence[Mapping[str, object]]]

# "exr/" is in front where a compositor wrote on what it had read.
_ATTRIBUTE = re.compile(r"(?:.*/)?cryptomatte/([^/]+)/(name|hash|conversion|manifest|manif_file)$")
_RANKED = re.compile(r"(.*?)(\d{2})$", re.DOTALL)
_COMPONENTS = {"r": 0, "red": 0, "g": 1, "green": 1, "b": 2, "blue": 2, "a": 3, "alpha": 3}
# Without a header nothing but the name tells; the second is Unreal's.
_USUAL_NAMES = ("crypto", "hitproxymask")
_MANIFEST_ID = re.compile(r'"\s*:\s*"([0-9a-fA-F]{1,8})"\s*(?:,|\}|$)')


class IdKind(IntEnum):
    """What the ids tell apart; a lower one is the better stencil."""

    OBJECT = 0
    OTHER = 1
    ASSET = 2
    MATERIAL = 3


_KIND_NAMES = (
    (IdKind.OBJECT, ("object", "hitproxy", "instance", "node")),
    (IdKind.ASSET, ("asset", "namespace", "layer")),
    (IdKind.MATERIAL, ("material", "shader", "mtl")),
)


@dataclass(frozen=True)
class Cryptomatte:
    """One Cryptomatte of a file, or of the files of a frame."""

    aov: str  # name of the AOV's own sequence if each AOV has a file of its own, else ""
    name: str  # of its layers, without the rank
    kind: IdKind
    # The four channels of each layer, in order: id, share, id, share. The first are the stencil.
    ranks: tuple[tuple[ChannelRef, ...], ...]
    exact: bool = True  # True if all ids are stored as 32-bit floats
    rounded: bool = False  # True if the file's compression (PXR24) has rounded them to 24 bits
    # True if ids are the hash that `hash_name` computes; else only a manifest links them to names.
    hashed: bool = True
    manifest: str | None = field(default=None, repr=False)  # text of it in the header
    sidecar: str | None = None  # path of a manifest's own file, relative to the image

    def require_exact(self, where: str) -> None:
        """Refuse ids that are no 32-bit floats, so that too few bits tell objects apart."""
        if not self.exact:
            raise LayoutError(
                f"{where} does not hold the ids of its Cryptomatte {self.name!r} as 32-bit floats, "
                "so they cannot be distinguished; write that pass as 32-bit float, not half"
            )


def find_cryptomattes(
    channels: Mapping[str, Iterable[Channel]], headers: Headers, beauty: str = ""
) -> tuple[Cryptomatte, ...]:
    """Find the Cryptomattes among the channels of a frame by AOV, the best stencil first.

    Objects come first, then what has a name of its own, assets, materials; but before all those of
    the view layer of `beauty`, a channel's name. `headers` are the attributes of the parts; what is
    absent tells nothing.
    """
    mattes = []
    for aov, members in channels.items():
        entries: dict[str, dict[str, str]] = {}
        parts = headers.get(aov, ())
        for part in parts:
            for attribute, value in part.items():
                match = _ATTRIBUTE.match(attribute)
                if match is not None and isinstance(value, str):
                    # What the first part says of a key counts.
                    entries.setdefault(match[1], {}).setdefault(match[2], value)
        named = [entry for entry in entries.values() if entry.get("name")]
        for name, layers in _group_ranks(members).items():
            entry = _header_entry(name, named)
            last = "".join(_words(name.rsplit(".", 1)[-1]))
            if entry is None and not any(word in last for word in _USUAL_NAMES):
                continue
            entry = entry or {}
            kinds = (kind for kind, words in _KIND_NAMES if any(word in last for word in words))
            hashing = entry.get("hash", HASH), entry.get("conversion", CONVERSION)
            indices = {channel.part for layer in layers for channel in layer}
            compressions = {str(parts[i].get("compression")) for i in indices if i < len(parts)}
            matte = Cryptomatte(
                aov,
                name,
                next(kinds, IdKind.OTHER),
                tuple(tuple(ChannelRef(aov, c.name) for c in layer) for layer in layers),
                exact=all(id_.pixel_type == "float" for layer in layers for id_ in layer[::2]),
                rounded="pxr24" in compressions,
                hashed=hashing == (HASH, CONVERSION),
                manifest=entry.get("manifest"),
                sidecar=entry.get("manif_file"),
            )
            mattes.append(matte)
    view_layer = beauty.rpartition(".")[0].rpartition(".")[0]
    return tuple(sorted(mattes, key=lambda m: (m.name.rpartition(".")[0] != view_layer, m.kind)))


def _group_ranks(channels: Iterable[Channel]) -> dict[str, list[list[Channel]]]:
    """Return the four channels of each layer by name, as far as the ranks from 00 on are whole."""
    families: dict[str, dict[int, dict[int, Channel]]] = {}
    for channel in channels:
        layer, _, component = channel.name.rpartition(".")
        match = _RANKED.match(layer)
        index = _COMPONENTS.get(component.lower())
        if match is not None and index is not None:
            family = families.setdefault(match[1], {})
            family.setdefault(int(match[2]), {}).setdefault(index, channel)
    ranks: dict[str, list[list[Channel]]] = {}
    for name, family in families.items():
        count = 0
        while len(family.get(count, ())) == len(set(_COMPONENTS.values())):
            ranks.setdefault(name, []).append([c for _, c in sorted(family[count].items())])
            count += 1
    return ranks


def _header_entry(name: str, entries: list[dict[str, str]]) -> dict[str, str] | None:
    """Return the header's entry for layers of a name.

    An entry of the same name, else one whose name ends in the layers', or theirs in its: writers
    put view layers, parts and views before it, or leave them out.
    """
    words = _words(name)
    near = []
    for entry in entries:
        own = _words(entry["name"])
        if "".join(own) == "".join(words):
            return entry
        count = min(len(own), len(words))
        if own[-count:] == words[-count:]:
            near.append(entry)
    # The longest says most: "Crypto Object Material" is not the entry "Material".
    return max(near, key=lambda entry: len(entry["name"]), default=None)


def _words(name: str) -> list[str]:
    """Return the words of a name without what writers change: case and separators."""
    return re.findall(r"[^\W_]+", name.lower())


def cryptomatte_refs(cryptomattes: Iterable[Cryptomatte]) -> frozenset[ChannelRef]:
    """Return the channels of all these Cryptomattes."""
    return frozenset(ref for matte in cryptomattes for rank in matte.ranks for ref in rank)


def surface_ids(
    ranks: Float32, rounded: bool = False, dynamic: Collection[int] | None = None
) -> Int32:
    """Return the id of the surface that each pixel shows, int32 [H, W].

    `ranks` is float32 [H, W, 4]: id, share, id, share of ranks 0 and 1. The id is of the surface
    whose share leads by `LEAD`, 0 where the background does, -1 where nothing leads. Ids are the
    bits of the hash without its sign: positive, equal in every frame. With `rounded` they are
    rounded to 24 bits, as PXR24 compression does, to be compared with such.

    With `dynamic`, ids as this function returns them, only what moves has an id: 0 where a pixel
    shows what stands still, -1 where nothing leads and something that moves has a share.

    Of 10,000 objects some two share an id with a probability of 2.3 % (1.2 % with all 32 bits);
    rounded, some six pairs do.
    """
    if ranks.dtype != np.float32 or ranks.ndim != 3 or ranks.shape[2] != 4:
        raise ValueError(f"ranks are float32 [H, W, 4], not {ranks.dtype} {ranks.shape}")
    ranks = np.ascontiguousarray(ranks)
    ids = np.empty(ranks.shape[:2], np.int32)
    moving = np.array(sorted(dynamic or ()), np.int32)
    raw_channels.write_dominant_ids(
        ranks.view(np.uint32), ranks, LEAD, rounded, moving, dynamic is None, ids
    )
    return ids


def refine_ids_by_depth(ids: Int32, depth: Float32) -> Int32:
    """Give pixels at silhouettes the id of the surface that their depth is of.

    `ids` is int32 [H, W], `depth` float32 [H, W], +inf background. Where no neighbour has both the
    same id and about the same depth, the id is that of the neighbour that is nearest in depth; what
    is alone in depth, too, stays.
    """
    # Shares are filtered, depth is not: so filtered ids become those at the pixels' centres. On 12
    # slots of a shot with 5 moving objects, two key frames splatted, warped from one: ids at the
    # centres 38.27 dB, 35.00; shares alone 38.18, 34.92; so 38.25, 34.98. A `LEAD` of 0.3 or 0.6
    # instead gave 37.78, 34.85 and 37.05, 34.55: edges got wider, and found no inside.
    refined = np.empty_like(ids)
    raw_channels.write_ids_by_depth(ids, depth, refined)
    return refined


def require_lossless_ids(ranks: Float32, where: str) -> None:
    """Refuse ids that a lossy step has destroyed: half floats or DWA compression."""
    bits = np.ascontiguousarray(ranks).view(np.uint32)[..., 0].ravel()
    bits = bits[(bits & raw_channels.MAGNITUDE) != 0]
    distinct = np.unique(bits[:: max(1, bits.size // SAMPLES)])
    exponent = distinct & EXPONENT
    # No bits beyond those of a half, or an exponent that no id has. One id in 8,192 is like that by
    # chance, so it takes two.
    lossy = ((distinct & HALF_TAIL) == 0) | (exponent == 0) | (exponent == EXPONENT)
    if np.count_nonzero(lossy) > max(1, distinct.size // 2):
        raise DamagedFileError(
            f"{where} has Cryptomatte ids that came through half floats or lossy compression "
            "(DWAA, DWAB); write that pass as 32-bit float with ZIP compression"
        )


@dataclass(frozen=True)
class DynamicObjects:
    """What ``--dynamic`` names: ids as of `surface_ids`, ascending, and names, sorted."""

    ids: tuple[int, ...]
    names: tuple[str, ...]


@dataclass(frozen=True)
class IdReading:
    """How a shot's ids are read from a Cryptomatte."""

    cryptomatte: Cryptomatte
    # True if some of the ids that they are compared with were rounded; see `surface_ids`.
    rounded: bool = False
    dynamic: DynamicObjects | None = None  # None if nothing says what moves

    def read(
        self, ranks: Float32, depth: Float32 | None, where: object
    ) -> tuple[Int32 | None, Int32 | None]:
        """Return a frame's `GBuffer.stencil` and `GBuffer.objects`: one of them, None the other.

        `ranks` is float32 [H, W, 4]: id, share, id, share; `depth` float32 [H, W], +inf background.

        Raises DamagedFileError, which names the file `where`, if the ids were destroyed.
        """
        require_lossless_ids(ranks, f"{where}, layer {self.cryptomatte.name!r},")
        moving = None if self.dynamic is None else self.dynamic.ids
        ids = surface_ids(ranks, self.rounded, moving)
        if depth is not None:
            ids = refine_ids_by_depth(ids, depth)
        return (None, ids) if self.dynamic is None else (ids, None)


@dataclass(frozen=True)
class Manifest:
    """The names that one frame's Cryptomatte knows."""

    ids: Mapping[str, int] = field(default_factory=dict)  # the bits of each name's id
    problem: str = ""  # why there are none, as half a sentence; "" if there are some
    hashed: bool = True  # True if a name's id is its hash, so that a name alone gives its id


def read_manifest(cryptomatte: Cryptomatte, path: Path) -> Manifest:
    """Read the manifest of a Cryptomatte in the file `path`, from its header or from a sidecar.

    Without names if none can be read: the ids are as good without.
    """
    text, source, problem = cryptomatte.manifest or "", "its header's manifest", ""
    sidecar = cryptomatte.sidecar or ""
    if not text.strip() and not sidecar:
        problem = "its header has no manifest"
    elif not text.strip():
        source, problem = sidecar, f"its manifest {quote_name(sidecar)} is not there"
        # Where the header says, else beside the image: paths are written on other systems, and
        # frames are moved with their manifests.
        plain = sidecar.replace("\\", "/")
        for name in (sidecar, plain, plain.split("/")[-1]):
            file = path.parent / name
            with suppress(OSError, ValueError):  # too long, or with a zero byte
                if file.is_file():
                    source, problem = str(file), ""
                    break
        try:
            if not problem and file.stat().st_size > MAX_MANIFEST_SIZE:
                problem = f"{file} is larger than {MAX_MANIFEST_SIZE >> 20} MiB"
            text = "" if problem else file.read_text("utf-8-sig", "surrogateescape")
        except OSError as error:
            problem = f"{file} cannot be read ({error.strerror})"
    if not problem and len(text) > MAX_MANIFEST_SIZE:
        problem = f"{source} is larger than {MAX_MANIFEST_SIZE >> 20} MiB"
    ids = {} if problem else parse_manifest(text)
    if not ids:
        problem = problem or f"{source} holds no names that can be read"
    return Manifest(ids, problem, cryptomatte.hashed)


def parse_manifest(text: str) -> dict[str, int]:
    """Return the bits of each name's id; of a truncated manifest the complete entries count."""
    ids: dict[str, int] = {}
    begin = 0
    for match in _MANIFEST_ID.finditer(text):
        raw = text[begin : match.start()].lstrip().removeprefix("{").lstrip()
        begin = match.end()
        if not raw.startswith('"'):
            continue
        name, bits = raw[1:], int(match[1], 16)
        # A name with a backslash is taken as JSON writes it or as it stands, whichever has the id
        # for its hash.
        if "\\" in name and hash_name(name) != bits:
            with suppress(ValueError):
                name = str(json.loads(f'"{name}"', strict=False))
        ids[name] = bits
    return ids


def hash_name(name: str) -> int:
    """Return the bits of a name's id: its MurmurHash3, with the exponent of a finite float.

    Source: Cryptomatte specification 1.2, "Floating point conversion": the exponent is clamped to 1
    to 254, so that no id is zero, denormal, infinite or NaN.
    """
    try:
        data = name.encode("utf-8", "surrogateescape")  # bytes that were no UTF-8 come back
    except UnicodeEncodeError:
        data = name.encode("utf-8", "surrogatepass")
    hashed = murmur3(data)
    exponent = min(max(hashed >> 23 & 0xFF, 1), 254)
    return (hashed & 0x807FFFFF) | exponent << 23


def murmur3(data: bytes) -> int:
    """Return the MurmurHash3_x86_32 of bytes, seed 0 (Austin Appleby, public domain algorithm)."""
    mask, state = 0xFFFFFFFF, 0
    for i in range(0, len(data), 4):
        block = int.from_bytes(data[i : i + 4], "little") * 0xCC9E2D51 & mask
        state ^= ((block << 15 | block >> 17) & mask) * 0x1B873593 & mask
        if i + 4 <= len(data):  # else it is the tail
            state = ((state << 13 | state >> 19) & mask) * 5 + 0xE6546B64 & mask
    state ^= len(data)
    state = (state ^ state >> 16) * 0x85EBCA6B & mask
    state = (state ^ state >> 13) * 0xC2B2AE35 & mask
    return state ^ state >> 16


def quote_name(name: str) -> str:
    """Quote a name for a message: on one line, printable, not too long."""
    plain = "".join(c if c.isprintable() else "?" for c in name)
    return repr(plain if len(plain) <= 60 else f"{plain[:59]}…")


def find_dynamic_objects(
    option: str, manifests: Iterable[Manifest], where: str, rounded: bool = False
) -> DynamicObjects:
    """Find the ids of what ``--dynamic`` names.

    `option` is GLOB[,GLOB…]: ``*``, ``?`` and ``[…]`` as in file names, case-sensitive; or a whole
    name. `manifests` are those of all frames of a sequence, so that every chunk of it gives the
    same ids; `where` names the sequence and layer in messages; `rounded` as in `surface_ids`.

    Raises UsageError if a glob matches no name of the sequence. Without any manifest, names without
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
    matching: dict[str, set[int]] = {}
    for glob in globs:
        if ids:
            names = [name for name in ids if name == glob or fnmatchcase(name, glob)]
            if not names:
                listed = ", ".join(quote_name(name) for name in sorted(ids)[:MAX_NAMES])
                more = f" and {len(ids) - MAX_NAMES} more" if len(ids) > MAX_NAMES else ""
                raise UsageError(
                    f"--dynamic {quote_name(glob)} matches no name in the Cryptomatte manifests, "
                    f"which have {listed}{more}; name objects of these"
                )
            matching |= {name: ids[name] for name in names}
        elif hashed and not any(sign in glob for sign in "*?["):
            matching[glob] = {hash_name(glob)}
        else:
            remedy = "render with a manifest"
            if hashed:
                remedy = f"give whole names, or {remedy}"
            raise UsageError(
                f"--dynamic {quote_name(glob)} cannot be looked up: {where} has no names, as "
                f"{problem or 'there are no frames'}; {remedy}"
            )
    all_bits = {np.uint32(bits) for hashes in matching.values() for bits in hashes}
    dynamic = {int(raw_channels.decode_id(bits, rounded)) for bits in all_bits}
    return DynamicObjects(tuple(sorted(dynamic)), tuple(sorted(matching)))
