"""Cryptomattes: which layers of a file hold the ids of surfaces, and what their header tells.

A Cryptomatte (Psyop's open specification, version 1.2) is a set of layers ``NAME00``, ``NAME01`` …
of four channels each: the id that covers most of a pixel, its share, the id that comes second, its
share; then ranks 2 and 3, and so on. An id is the hash of an object's name, kept as the bits of a
32-bit float. The header's attributes ``cryptomatte/KEY/…`` tell the name of the layers, the kind of
hash, and the manifest: which name has which id, here or in a file beside the image.

Nothing here reads pixels: see :mod:`exwarp_cli.io.cryptomatte_ids` for those, and
:mod:`exwarp_cli.io.cryptomatte_manifest` for names.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum

from exwarp_cli.errors import LayoutError
from exwarp_cli.io.channels import ChannelRef
from exwarp_cli.io.exr.header import Channel

HASH, CONVERSION = "MurmurHash3_32", "uint32_to_float32"
"""The only hash and the only way of keeping it in a float that the specification knows."""

Headers = Mapping[str, Sequence[Mapping[str, object]]]
"""Attributes of the parts of files, in their order, by AOV."""

# "exr/" is in front where a compositor wrote on what it had read.
_ATTRIBUTE = re.compile(r"(?:.*/)?cryptomatte/([^/]+)/(name|hash|conversion|manifest|manif_file)$")
_RANKED = re.compile(r"(.*?)(\d{2})$", re.DOTALL)
_COMPONENTS = {"r": 0, "red": 0, "g": 1, "green": 1, "b": 2, "blue": 2, "a": 3, "alpha": 3}
# Without a header nothing but the name tells; the second is Unreal's.
_USUAL = ("crypto", "hitproxymask")


class Kind(IntEnum):
    """What the ids tell apart; a lower one is the better stencil."""

    OBJECT = 0
    OTHER = 1
    ASSET = 2
    MATERIAL = 3


@dataclass(frozen=True)
class Cryptomatte:
    """One Cryptomatte of a file, or of the files of a frame.

    Attributes
    ----------
    aov
        Name of the AOV's own sequence where each AOV has a file of its own, else "".
    name
        Name of its layers without the rank, as the channels have it.
    kind
        What its ids tell apart, as far as the name tells.
    ranks
        The four channels of each layer, in order: id, share, id, share.
    exact
        Whether all ids are stored as 32-bit floats.
    rounded
        Whether the file's compression (PXR24) has rounded them to 24 bits.
    hashed
        Whether ids are the hash that :func:`exwarp_cli.io.cryptomatte_manifest.id_of` computes;
        else only a manifest links them to names.
    manifest
        Text of the manifest in the header, as it stands there; None without.
    sidecar
        Path of a manifest's own file, relative to the image; None without.
    """

    aov: str
    name: str
    kind: Kind
    ranks: tuple[tuple[ChannelRef, ...], ...]
    exact: bool = True
    rounded: bool = False
    hashed: bool = True
    manifest: str | None = field(default=None, repr=False)
    sidecar: str | None = None

    @property
    def stencil(self) -> tuple[ChannelRef, ...]:
        """The channels of ranks 0 and 1: id, share, id, share."""
        return self.ranks[0]

    @property
    def refs(self) -> frozenset[ChannelRef]:
        """All its channels. They go together: ids and shares of two pixels cannot be mixed."""
        return frozenset(ref for rank in self.ranks for ref in rank)

    def moved(self, names: Mapping[str, str]) -> Cryptomatte:
        """Return it with other names of AOVs."""
        aov = names.get(self.aov, self.aov)
        ranks = tuple(tuple(replace(ref, aov=aov) for ref in rank) for rank in self.ranks)
        return replace(self, aov=aov, ranks=ranks)

    def require_exact(self, where: str) -> None:
        """Refuse ids that are no 32-bit floats.

        Raises
        ------
        LayoutError
            When they are halves, with few bits left to tell objects apart, or whole numbers.
        """
        if not self.exact:
            raise LayoutError(
                f"{where} does not hold the ids of its Cryptomatte {self.name!r} as 32-bit floats, "
                "so they cannot be distinguished; write that pass as 32-bit float, not half"
            )


def find_cryptomattes(
    channels: Mapping[str, Iterable[Channel]], headers: Headers, beside: str = ""
) -> tuple[Cryptomatte, ...]:
    """Find the Cryptomattes of a frame.

    Parameters
    ----------
    channels
        Its channels by AOV, as :func:`exwarp_cli.io.channels.detect` takes them.
    headers
        The attributes of the parts that the channels are in; what is absent tells nothing.
    beside
        Name of a channel of the beauty layer: of several view layers, its own comes first.

    Returns
    -------
    tuple of Cryptomatte
        The best stencil first: objects, then what has a name of its own, assets, materials.
    """
    found = []
    for aov, members in channels.items():
        entries = _entries(headers.get(aov, ()))
        for family in _families(aov, members):
            entry = _entry(family.name, entries)
            if entry is not None or any(word in _last(family.name) for word in _USUAL):
                found.append(family.cryptomatte(entry or {}, headers.get(aov, ())))
    parent = _parents(beside)

    def order(one: Cryptomatte) -> tuple[bool, Kind]:
        return one.name.rpartition(".")[0] != parent, one.kind

    return tuple(sorted(found, key=order))


def _parents(channel: str) -> str:
    """Return what stands before a channel's layer: "A" for "A.Combined.R"."""
    return channel.rpartition(".")[0].rpartition(".")[0]


def _words(name: str) -> list[str]:
    """Return the words of a name without what writers change: case and separators."""
    return re.findall(r"[^\W_]+", name.lower())


def _last(name: str) -> str:
    """Return the words of a name's last element, as one."""
    return "".join(_words(name.rsplit(".", 1)[-1]))


def _kind(name: str) -> Kind:
    """Read the kind from the last element of a name."""
    plain = _last(name)
    kinds = (
        (Kind.OBJECT, ("object", "hitproxy", "instance", "node")),
        (Kind.ASSET, ("asset", "namespace", "layer")),
        (Kind.MATERIAL, ("material", "shader", "mtl")),
    )
    return next((kind for kind, words in kinds if any(word in plain for word in words)), Kind.OTHER)


@dataclass
class _Family:
    """Layers that differ in their number alone."""

    aov: str
    name: str
    layers: dict[int, dict[int, Channel]] = field(default_factory=dict)

    def whole(self) -> list[list[Channel]]:
        """Return the four channels of each layer from the first one on, while all are there."""
        out: list[list[Channel]] = []
        while len(self.layers.get(len(out), ())) == len(set(_COMPONENTS.values())):
            out.append([channel for _, channel in sorted(self.layers[len(out)].items())])
        return out

    def cryptomatte(
        self, entry: Mapping[str, str], headers: Sequence[Mapping[str, object]]
    ) -> Cryptomatte:
        """Join channels and what the header tells."""
        whole = self.whole()
        channels = [channel for layer in whole for channel in layer]
        compressions = {
            str(headers[channel.part].get("compression", ""))
            for channel in channels
            if channel.part < len(headers)
        }
        return Cryptomatte(
            self.aov,
            self.name,
            _kind(self.name),
            tuple(tuple(ChannelRef(self.aov, one.name) for one in layer) for layer in whole),
            exact=all(c.pixel_type == "float" for layer in whole for c in layer[::2]),
            rounded="pxr24" in compressions,
            hashed=(entry.get("hash", HASH), entry.get("conversion", CONVERSION))
            == (HASH, CONVERSION),
            manifest=entry.get("manifest"),
            sidecar=entry.get("manif_file"),
        )


def _families(aov: str, channels: Iterable[Channel]) -> Iterator[_Family]:
    """Group channels into families of which at least the layer 00 is whole, in file order."""
    families: dict[str, _Family] = {}
    for channel in channels:
        layer, _, component = channel.name.rpartition(".")
        match = _RANKED.match(layer)
        place = _COMPONENTS.get(component.lower())
        if match is None or place is None:
            continue
        family = families.setdefault(match[1], _Family(aov, match[1]))
        family.layers.setdefault(int(match[2]), {}).setdefault(place, channel)
    return (family for family in families.values() if family.whole())


def _entries(headers: Iterable[Mapping[str, object]]) -> list[dict[str, str]]:
    """Return what headers tell of Cryptomattes; what the first part says of a key counts."""
    entries: dict[str, dict[str, str]] = {}
    for header in headers:
        for name, value in header.items():
            match = _ATTRIBUTE.match(name)
            if match is not None and isinstance(value, str):
                entries.setdefault(match[1], {}).setdefault(match[2], value)
    return [entry for entry in entries.values() if entry.get("name")]


def _entry(name: str, entries: list[dict[str, str]]) -> dict[str, str] | None:
    """Return the header's entry for layers of a name.

    An entry of the same name, else one whose name ends in the layers', or theirs in its: writers
    put view layers, parts and views before it, or leave them out.
    """
    words = _words(name)
    for entry in entries:
        if "".join(_words(entry["name"])) == "".join(words):
            return entry
    near = [entry for entry in entries if _ends_alike(_words(entry["name"]), words)]
    # The longest says most: "Crypto Object Material" is not the entry "Material".
    return max(near, key=lambda entry: len(entry["name"]), default=None)


def _ends_alike(one: list[str], other: list[str]) -> bool:
    """Whether the shorter of two lists is the end of the other."""
    count = min(len(one), len(other))
    return one[-count:] == other[-count:]
