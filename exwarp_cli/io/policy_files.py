"""The predictor in a file: format ``exwarp.policy/1``.

A .npz archive (zip of .npy files, nothing compressed, no pickles) with

- ``metadata``: UTF-8 bytes of a JSON object, whose ``format`` is ``exwarp.policy/1``,
- ``input_multipliers`` int32 [n] and ``input_shifts`` uint8 [n],
- for layer k from 0: ``weights{k}`` int8 [out, in] and ``biases{k}`` int32 [out], and for all but
  the last ``multipliers{k}`` int32 [out] and ``shifts{k}`` uint8 [out],
- where it was kept, the network before quantisation: ``w{k}`` float32 [out, in] and ``b{k}``
  float32 [out].

Ranges and arithmetic are those of `exwarp_cli.accelerator.mlp`. The same network and metadata
give the same bytes on every machine.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import struct
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from exwarp_cli.accelerator.mlp import QuantisedLayer, QuantisedMlp, Requantisation
from exwarp_cli.domain.tiles import TILE_STATE
from exwarp_cli.errors import DamagedFileError, InputError, LayoutError
from exwarp_cli.io.atomic import atomic_write_bytes
from exwarp_cli.io.models import read_model

FORMAT = "exwarp.policy/1"

SHIPPED_POLICY = "policy.npz"
"""Name of the policy that comes with ExWarp."""

SHIPPED_TILE_POLICY = "tile-policy.npz"
"""Name of the policy of tiles that comes with ExWarp, which `--causal` asks."""

PAPER = "paper"
"""What `--policy` takes for the paper's policy of whole frames, `SHIPPED_POLICY`."""

OPTION = "--policy"
"""By which commands take another."""

F32 = npt.NDArray[np.float32]
Floats = tuple[tuple[F32, F32], ...]
"""Weights [out, in] and biases [out] of each layer, before quantisation."""


def left_out(scene: str) -> str:
    """Name of the policy that was trained without a scene, to be judged on it."""
    return f"policy-without-{scene}.npz"


@dataclass(frozen=True, eq=False)
class PolicyFile:
    """A policy as its file holds it.

    Attributes
    ----------
    path
        Where it was read.
    checksum
        SHA-256 of the file, hexadecimal.
    network
        In integers.
    metadata
        Whatever was saved with it, and ``format``.
    floats
        Before quantisation; empty where the file has none.
    """

    path: Path
    checksum: str
    network: QuantisedMlp
    metadata: dict[str, Any]
    floats: Floats

    @property
    def of_tiles(self) -> bool:
        """Whether it decides tile by tile."""
        return self.metadata.get("state") == TILE_STATE

    @property
    def efforts(self) -> tuple[tuple[float, float], ...]:
        """Shares of the area, ascending, and the price of each; () where it does not say."""
        stated = self.metadata.get("efforts")
        return tuple((share, price) for share, price in stated) if stated else ()

    @property
    def trained_for(self) -> tuple[str, ...]:
        """SHA-256 of the networks whose frames it learned to judge; () where it does not say."""
        stated = self.metadata.get("extrapolator")
        stated = [stated] if isinstance(stated, str) else stated
        return tuple(map(str, stated)) if isinstance(stated, list) else ()


def save_network(
    path: Path,
    network: QuantisedMlp,
    metadata: Mapping[str, Any],
    floats: Sequence[tuple[F32, F32]] = (),
) -> None:
    """Write a network, whole or not at all.

    Parameters
    ----------
    path
        The file; its folder exists.
    network
        In integers.
    metadata
        What JSON can hold; ``format`` is added.
    floats
        Weights and biases of each layer before quantisation, or nothing.

    Raises
    ------
    ValueError
        When the metadata hold NaN, or what JSON has not.
    OutputError
        When the file cannot be written.
    """
    text = json.dumps({**metadata, "format": FORMAT}, allow_nan=False, sort_keys=True)
    arrays: dict[str, Array] = {
        "metadata": np.frombuffer(text.encode("utf-8"), np.uint8),
        "input_multipliers": network.inputs.multipliers,
        "input_shifts": network.inputs.shifts,
    }
    for k, layer in enumerate(network.layers):
        arrays |= {f"weights{k}": layer.weights, f"biases{k}": layer.biases}
        if layer.requantisation is not None:
            arrays[f"multipliers{k}"] = layer.requantisation.multipliers
            arrays[f"shifts{k}"] = layer.requantisation.shifts
    for k, (weights, biases) in enumerate(floats):
        arrays[f"w{k}"] = np.asarray(weights, np.float32)
        arrays[f"b{k}"] = np.asarray(biases, np.float32)
    atomic_write_bytes(path, pack(arrays))


def load_policy(path: Path | None, shipped: str = SHIPPED_POLICY) -> PolicyFile:
    """Read a policy.

    Parameters
    ----------
    path
        The file; None for one that comes with ExWarp, whose checksum is verified.
    shipped
        Name of that one.

    Raises
    ------
    InputError
        When there is no such file, or it cannot be read.
    DamagedFileError
        When it is truncated, or no .npz archive.
    LayoutError
        When it holds something else than a policy, or numbers out of range.
    """
    path, data = read_model(path, shipped, OPTION)
    try:
        arrays = unpack(data)
    except ArchiveError as error:
        raise DamagedFileError(
            f"{path} is truncated, damaged or no policy file; check the path, or train the policy "
            "again"
        ) from error
    metadata = _metadata(path, arrays)
    checksum = hashlib.sha256(data).hexdigest()
    return PolicyFile(path, checksum, _network(path, arrays), metadata, _floats(path, arrays))


def _metadata(place: Path, arrays: dict[str, Array]) -> dict[str, Any]:
    try:
        metadata = json.loads(_array(place, arrays, "metadata", np.uint8).tobytes().decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise _unfit(place, "its metadata are no JSON") from error
    if not isinstance(metadata, dict):
        raise _unfit(place, "its metadata are no JSON object")
    if metadata.get("format") != FORMAT:
        raise _unfit(place, f"its format is {metadata.get('format')!r}, not {FORMAT}")
    return metadata


def _floats(place: Path, arrays: dict[str, Array]) -> Floats:
    """Return the network before quantisation, where it was kept."""
    pairs = []
    for k in range(_count(arrays, "w")):
        weights, biases = (_array(place, arrays, f"{name}{k}", np.float32) for name in "wb")
        if weights.ndim != 2 or biases.shape != weights.shape[:1]:
            raise _unfit(place, f"w{k} and b{k} do not fit together")
        pairs.append((weights, biases))
    return tuple(pairs)


def _network(place: Path, arrays: dict[str, Array]) -> QuantisedMlp:
    """Build the network; its own checks find what is out of range."""

    def scale(multipliers: str, shifts: str) -> Requantisation:
        return Requantisation(
            _array(place, arrays, multipliers, np.int32), _array(place, arrays, shifts, np.uint8)
        )

    def layer(k: int) -> QuantisedLayer:
        weights = _array(place, arrays, f"weights{k}", np.int8)
        biases = _array(place, arrays, f"biases{k}", np.int32)
        hidden = f"multipliers{k}" in arrays
        factors = scale(f"multipliers{k}", f"shifts{k}") if hidden else None
        return QuantisedLayer(weights, biases, factors)

    try:
        layers = tuple(layer(k) for k in range(_count(arrays, "weights")))
        return QuantisedMlp(scale("input_multipliers", "input_shifts"), layers)
    except ValueError as error:
        raise _unfit(place, str(error)) from error


def _count(arrays: dict[str, Array], name: str) -> int:
    """Return how many arrays of a name there are, numbered from 0 without a gap."""
    count = 0
    while f"{name}{count}" in arrays:
        count += 1
    return count


def _array(place: Path, arrays: dict[str, Array], name: str, dtype: type) -> Array:
    """Return an array by its name, in the type that the format has."""
    if name not in arrays:
        raise _unfit(place, f"it lacks {name}")
    if arrays[name].dtype != dtype:
        raise _unfit(place, f"its {name} are {arrays[name].dtype}, not {np.dtype(dtype)}")
    return arrays[name]


def _unfit(place: Path, reason: str) -> LayoutError:
    return LayoutError(
        f"{place} is no policy that ExWarp can run: {reason}; check the path, or train the policy "
        "again"
    )


Array = npt.NDArray[Any]

MOST_BYTES = 1 << 26
"""Of one array."""

MOST_OF_ALL = 1 << 28
"""Bytes of all arrays of an archive: each may claim much in little."""

_UNREADABLE = (
    *(zipfile.BadZipFile, zlib.error, ValueError, OSError, EOFError, MemoryError, struct.error),
    *(NotImplementedError, RuntimeError, KeyError, SyntaxError, OverflowError, TypeError),
)
"""What zipfile and numpy raise on bytes that are no such archive."""


class ArchiveError(ValueError):
    """Bytes that are no archive of arrays; its reader names the file."""


def pack(arrays: Mapping[str, Array], compressed: bool = False) -> bytes:
    """Pack arrays; nothing of the clock or the machine gets in, uncompressed nothing of zlib."""
    whole = io.BytesIO()
    method = zipfile.ZIP_DEFLATED if compressed else zipfile.ZIP_STORED
    with zipfile.ZipFile(whole, "w") as archive:
        for name, array in arrays.items():
            entry = zipfile.ZipInfo(f"{name}.npy", (1980, 1, 1, 0, 0, 0))
            entry.create_system, entry.external_attr = 3, 0o644 << 16
            data = io.BytesIO()
            plain = np.ascontiguousarray(array, array.dtype.newbyteorder("<"))
            np.lib.format.write_array(data, plain, (1, 0), allow_pickle=False)
            archive.writestr(entry, data.getvalue(), method)
    return whole.getvalue()


def unpack(data: bytes) -> dict[str, Array]:
    """Unpack an archive by its arrays' names.

    Raises
    ------
    ArchiveError
        When it is damaged, none at all, or holds anything but arrays of a sane size.
    """
    try:
        arrays = {}
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            entries = archive.infolist()
            for entry in entries:
                if entry.file_size > MOST_BYTES:
                    raise ValueError(f"{entry.filename} is too large")
            if sum(entry.file_size for entry in entries) > MOST_OF_ALL:
                raise ValueError("it is too large")
            for entry in entries:
                member = io.BytesIO(archive.read(entry))
                array = np.lib.format.read_array(member, allow_pickle=False)
                arrays[entry.filename.removesuffix(".npy")] = array
        return arrays
    except _UNREADABLE as error:
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise ArchiveError(reason) from error


COLUMN = "inputs"
"""Column of the states: Q16.16 integers with spaces between."""

IDENTITY = ("frame", "key", "slot", "node")
"""Columns that tell which decision a row is of, where they are there."""

_INT32 = np.iinfo(np.int32)


@dataclass(frozen=True)
class StateRow:
    """A row with a state.

    Attributes
    ----------
    row
        Number of the row, from 1; the header does not count.
    line
        Of the file, from 1.
    identity
        What the columns of `IDENTITY` hold, by their names.
    state
        int32 [n] in Q16.16.
    """

    row: int
    line: int
    identity: dict[str, str]
    state: npt.NDArray[np.int32]


def read_states(path: Path, size: int) -> tuple[StateRow, ...]:
    """Read the rows of a CSV file that hold a state; rows whose cell is empty are left out.

    Parameters
    ----------
    path
        As ``exwarp upsample --report`` and ``exwarp features`` write it: UTF-8, with a header.
    size
        Numbers in a state.

    Raises
    ------
    InputError
        When the file cannot be read.
    LayoutError
        When there is no column `COLUMN`, no state, or a cell holds something else.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = tuple(_rows(path, csv.DictReader(file), size))
    except OSError as error:
        raise InputError(
            f"cannot read {path}: {error.strerror}; check the path and its rights"
        ) from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise DamagedFileError(
            f"{path} is no CSV file in UTF-8 ({error}); give a table with a column '{COLUMN}'"
        ) from error
    if not rows:
        raise LayoutError(
            f"{path} has no row with '{COLUMN}'; give one of a run with a learned policy"
        )
    return rows


def _rows(path: Path, table: csv.DictReader[str], size: int) -> Iterator[StateRow]:
    columns = table.fieldnames or []
    if COLUMN not in columns:
        raise LayoutError(
            f"{path} has no column '{COLUMN}'; give a table of exwarp features, or frames.csv of a "
            "run with a learned policy"
        )
    for number, cells in enumerate(table, 1):
        text: Any = cells[COLUMN]
        if text and text.strip():
            state = _state(f"{path}, line {table.line_num}", text, size)
            identity = {name: cells[name] or "" for name in IDENTITY if name in columns}
            yield StateRow(number, table.line_num, identity, state)


def _state(where: str, text: str, size: int) -> npt.NDArray[np.int32]:
    """Read one cell."""
    words = text.split()
    if len(words) != size:
        raise LayoutError(
            f"{where}: '{COLUMN}' holds {len(words)} numbers, and the policy takes {size}; give "
            "the row as it was written"
        )
    for word in words:
        # Not int() alone, which also takes 1_000 and digits of other scripts, and any length.
        plain = len(word) <= 11 and word.isascii() and word.lstrip("-").isdigit()
        if not plain or word.count("-") > 1 or not _INT32.min <= int(word) <= _INT32.max:
            raise LayoutError(
                f"{where}: {word[:20]!r} in '{COLUMN}' is no 32-bit integer; give Q16.16 numbers, "
                "65536 for 1"
            )
    return np.array([int(word) for word in words], np.int32)
