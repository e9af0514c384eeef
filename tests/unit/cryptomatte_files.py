"""Files with a Cryptomatte, as renderers write them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import OpenImageIO as oiio

from exwarp_cli.io.cryptomatte import Cryptomatte, find_cryptomattes, hash_name
from exwarp_cli.io.exr.header import Channel
from exwarp_cli.io.exr.reader import ExrFile
from tests.unit.exr_files import Planes, write_parts, write_single

SPELLINGS = {"lower": "rgba", "upper": "RGBA", "words": ("red", "green", "blue", "alpha")}


@dataclass(frozen=True)
class Style:
    """How a renderer writes it.

    `key` is that of the header, "" for a file whose header was lost; `manifest` is "header",
    "none", a text to put into the header, or a path of a file.
    """

    name: str = "crypto_object"
    header_name: str | None = None
    key: str = "d593dd7"
    spelling: str = "lower"
    dtype: type = np.float32
    manifest: str | Path = "header"


def ranked(shares: Mapping[str, np.ndarray], ranks: int = 6) -> tuple[np.ndarray, np.ndarray]:
    """Return ids uint32 and shares float32 [ranks, H, W], the greatest share first.

    What shares leave of 1 is background, which has no id.
    """
    names = list(shares)
    stack = np.stack([np.asarray(shares[name], np.float32) for name in names])
    order = np.argsort(-stack, axis=0, kind="stable")[:ranks]
    sorted_shares = np.take_along_axis(stack, order, axis=0)
    bits = np.array([hash_name(name) for name in names], np.uint32)[order]
    ids = np.where(sorted_shares > 0, bits, np.uint32(0))
    missing = ranks - len(ids)
    padding = ((0, max(missing, 0)), (0, 0), (0, 0))
    return np.pad(ids, padding), np.pad(sorted_shares, padding)


def planes_of(shares: Mapping[str, np.ndarray], style: Style, ranks: int = 6) -> dict[str, Planes]:
    """Return the channels of each layer, by layer."""
    ids, covered = ranked(shares, ranks)
    layers: dict[str, Planes] = {}
    for rank in range(0, ranks, 2):
        layer = f"{style.name}{rank // 2:02d}"
        values = []
        for r in (rank, rank + 1):
            values += [ids[r].view(np.float32), covered[r]]
        layers[layer] = {
            f"{layer}.{letter}": np.ascontiguousarray(plane.astype(style.dtype))
            for letter, plane in zip(SPELLINGS[style.spelling], values, strict=True)
        }
    return layers


def attributes_of(names: Sequence[str], style: Style) -> dict[str, str]:
    """Return the header's attributes."""
    if not style.key:
        return {}
    base = f"cryptomatte/{style.key}"
    out = {
        f"{base}/name": style.name if style.header_name is None else style.header_name,
        f"{base}/hash": "MurmurHash3_32",
        f"{base}/conversion": "uint32_to_float32",
    }
    if isinstance(style.manifest, Path):
        out[f"{base}/manif_file"] = str(style.manifest)
    elif style.manifest != "none":
        whole = manifest_of(names) if style.manifest == "header" else style.manifest
        out[f"{base}/manifest"] = whole
    return out


def manifest_of(names: Sequence[str]) -> str:
    return json.dumps({name: f"{hash_name(name):08x}" for name in names}, separators=(",", ":"))


def write_cryptomatte(
    path: Path,
    shares: Mapping[str, np.ndarray],
    style: Style | None = None,
    others: Planes | None = None,
    multipart: bool = False,
    **attributes: Any,
) -> Path:
    """Write a frame with a Cryptomatte and other channels; in parts, as Blender does it."""
    style = style or Style()
    layers = planes_of(shares, style)
    cryptomatte = attributes_of(list(shares), style)
    if not multipart:
        together: dict[str, np.ndarray] = dict(others or {})
        for planes in layers.values():
            together |= planes
        return write_single(path, together, **cryptomatte, **attributes)
    parts: dict[str, tuple[Planes, Mapping[str, Any]]] = {}
    if others:
        parts["beauty"] = (others, cryptomatte | attributes)
    for layer, planes in layers.items():
        parts[layer] = (planes, attributes if parts else cryptomatte | attributes)
    return write_parts(path, parts)


def headers_of(path: Path) -> list[dict[str, object]]:
    """Return the attributes of all parts."""
    file = oiio.ImageInput.open(str(path))
    out: list[dict[str, object]] = []
    while (spec := file.spec(len(out), 0)).width:
        out.append({a.name: a.value for a in spec.extra_attribs})
    return out


def found_in(path: Path, beside: str = "") -> tuple[Cryptomatte, ...]:
    with ExrFile(path) as file:
        channels: list[Channel] = [c for part in file.parts for c in part.channels]
    return find_cryptomattes({"": channels}, {"": headers_of(path)}, beside)


def ranks_in(path: Path, cryptomatte: Cryptomatte) -> np.ndarray:
    """Return the pixels of ranks 0 and 1, float32 [H, W, 4]."""
    with ExrFile(path) as file:
        channels = {c.name: c for part in file.parts for c in part.channels}
        wanted = [channels[ref.name] for ref in cryptomatte.ranks[0]]
        planes = file.read(wanted)
    return np.stack([planes[c] for c in wanted], axis=-1)


COMPRESSIONS = {
    "zip": OpenEXR.ZIP_COMPRESSION,
    "pxr24": OpenEXR.PXR24_COMPRESSION,
    "dwaa": OpenEXR.DWAA_COMPRESSION,
}
