"""The policy's network in a file, format ``exwarp.policy/1``, and tables of its states.

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
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import count, takewhile
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from exwarp_cli.accelerator.mlp import QuantisedLayer, QuantisedMlp, Requantisation
from exwarp_cli.domain.tiles import TILE_STATE
from exwarp_cli.errors import DamagedFileError, InputError, LayoutError
from exwarp_cli.io.files import atomic_write_bytes
from exwarp_cli.models.model_file import read_model

FORMAT = "exwarp.policy/1"

# Policies that come with ExWarp: the paper's, of whole frames, and that of tiles for --causal.
SHIPPED_POLICY = "policy.npz"
SHIPPED_TILE_POLICY = "tile-policy.npz"
SHIPPED_LOOK_AHEAD_POLICY = "look-ahead-policy.npz"  # of tiles between two key frames

# The option by which commands take another policy, and its value for SHIPPED_POLICY.
OPTION = "--policy"
PAPER = "paper"

# Bytes of one array, and of all arrays of an archive: each may claim much in little.
MOST_BYTES = 1 << 26
MOST_OF_ALL = 1 << 28

STATE_COLUMN = "inputs"  # column of the states: Q16.16 integers with spaces between
# Columns that identify the decision of a row, where a table has them.
IDENTITY_COLUMNS = ("frame", "key", "slot", "node")

_INT32 = np.iinfo(np.int32)

Array = npt.NDArray[Any]
F32 = npt.NDArray[np.float32]
# Weights [out, in] and biases [out] of each layer, before quantisation.
Floats = tuple[tuple[F32, F32], ...]


@dataclass(frozen=True, eq=False)
class PolicyFile:
    """A policy as its file holds it; `floats` is empty where the file has none."""

    path: Path
    checksum: str  # SHA-256 of the file, hexadecimal
    network: QuantisedMlp
    metadata: dict[str, Any]
    floats: Floats

    @property
    def of_tiles(self) -> bool:
        """True if it decides tile by tile."""
        return self.metadata.get("state") == TILE_STATE

    @property
    def trained_for(self) -> tuple[str, ...]:
        """SHA-256 of the networks whose frames it learned to judge; () if not stated."""
        stated = self.metadata.get("extrapolator")
        stated = [stated] if isinstance(stated, str) else stated
        return tuple(map(str, stated)) if isinstance(stated, list) else ()

    def price(self, effort: float) -> int:
        """Return the price at which a share of the area is extrapolated on the training scenes.

        The metadata state it for some shares; beyond the first and the last, theirs counts. 0 if
        they state none.
        """
        stated = self.metadata.get("efforts")
        if not stated:
            return 0
        shares, prices = zip(*stated, strict=True)
        return round(float(np.interp(effort, shares, prices)))


def policy_name_without(scene: str) -> str:
    """Return the name of the policy that was trained without a scene, to be judged on it."""
    return f"policy-without-{scene}.npz"


def save_network(
    path: Path,
    network: QuantisedMlp,
    metadata: Mapping[str, Any],
    floats: Sequence[tuple[F32, F32]] = (),
) -> None:
    """Write a policy's file atomically; ``format`` is added to the metadata.

    Raises ValueError if the metadata have NaN or no JSON form, OutputError if the file cannot be
    written.
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
    atomic_write_bytes(path, pack_arrays(arrays))


def load_policy(path: Path | None, shipped: str = SHIPPED_POLICY) -> PolicyFile:
    """Read a policy, the one named `shipped` that comes with ExWarp if `path` is None.

    Raises InputError if there is no such file, DamagedFileError if it is no .npz archive,
    LayoutError if it holds something else than a policy, or numbers out of range.
    """
    path, data = read_model(path, shipped, OPTION)
    try:
        arrays = unpack_arrays(data)
    except ArchiveError as error:
        raise DamagedFileError(
            f"{path} is truncated, damaged or no policy file; check the path, or train the policy "
            "again"
        ) from error
    try:
        metadata = json.loads(_array(path, arrays, "metadata", np.uint8).tobytes().decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise _misfit(path, "its metadata are no JSON") from error
    if not isinstance(metadata, dict):
        raise _misfit(path, "its metadata are no JSON object")
    if metadata.get("format") != FORMAT:
        raise _misfit(path, f"its format is {metadata.get('format')!r}, not {FORMAT}")
    layers = []
    try:
        for k in takewhile(lambda k: f"weights{k}" in arrays, count()):
            weights = _array(path, arrays, f"weights{k}", np.int8)
            biases = _array(path, arrays, f"biases{k}", np.int32)
            scale = None
            if f"multipliers{k}" in arrays:
                multipliers = _array(path, arrays, f"multipliers{k}", np.int32)
                scale = Requantisation(multipliers, _array(path, arrays, f"shifts{k}", np.uint8))
            layers.append(QuantisedLayer(weights, biases, scale))
        multipliers = _array(path, arrays, "input_multipliers", np.int32)
        inputs = Requantisation(multipliers, _array(path, arrays, "input_shifts", np.uint8))
        network = QuantisedMlp(inputs, tuple(layers))
    except ValueError as error:  # of its own checks of ranges
        raise _misfit(path, str(error)) from error
    floats = []
    for k in takewhile(lambda k: f"w{k}" in arrays, count()):
        weights, biases = (_array(path, arrays, f"{name}{k}", np.float32) for name in "wb")
        if weights.ndim != 2 or biases.shape != weights.shape[:1]:
            raise _misfit(path, f"w{k} and b{k} do not fit together")
        floats.append((weights, biases))
    checksum = hashlib.sha256(data).hexdigest()
    return PolicyFile(path, checksum, network, metadata, tuple(floats))


def _array(path: Path, arrays: dict[str, Array], name: str, dtype: type) -> Array:
    if name not in arrays:
        raise _misfit(path, f"it lacks {name}")
    if arrays[name].dtype != dtype:
        raise _misfit(path, f"its {name} are {arrays[name].dtype}, not {np.dtype(dtype)}")
    return arrays[name]


def _misfit(path: Path, reason: str) -> LayoutError:
    return LayoutError(
        f"{path} is no policy that ExWarp can run: {reason}; check the path, or train the policy "
        "again"
    )


class ArchiveError(ValueError):
    """Bytes that are no archive of arrays; its reader names the file."""


def pack_arrays(arrays: Mapping[str, Array], compressed: bool = False) -> bytes:
    """Pack arrays as .npz; the bytes depend on no clock or machine, uncompressed not on zlib."""
    archive_file = io.BytesIO()
    method = zipfile.ZIP_DEFLATED if compressed else zipfile.ZIP_STORED
    with zipfile.ZipFile(archive_file, "w") as archive:
        for name, array in arrays.items():
            entry = zipfile.ZipInfo(f"{name}.npy", (1980, 1, 1, 0, 0, 0))
            entry.create_system, entry.external_attr = 3, 0o644 << 16
            data = io.BytesIO()
            plain = np.ascontiguousarray(array, array.dtype.newbyteorder("<"))
            np.lib.format.write_array(data, plain, (1, 0), allow_pickle=False)
            archive.writestr(entry, data.getvalue(), method)
    return archive_file.getvalue()


def unpack_arrays(data: bytes) -> dict[str, Array]:
    """Unpack the arrays of an archive by name.

    Raises ArchiveError if it is damaged, or holds anything but arrays of a sane size.
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
    except Exception as error:  # zipfile and numpy raise a dozen kinds for such bytes
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise ArchiveError(reason) from error


@dataclass(frozen=True)
class StateRow:
    """A row of a table with a state; `row` counts from 1 without the header."""

    row: int
    identity: dict[str, str]  # by IDENTITY_COLUMNS
    state: npt.NDArray[np.int32]  # [n], Q16.16


def read_states(path: Path, size: int) -> tuple[StateRow, ...]:
    """Read the rows of a CSV file that hold a state of `size` numbers; empty cells are skipped.

    ``exwarp upsample --report`` and ``exwarp features`` write such tables: UTF-8, with a header.

    Raises InputError if the file cannot be read, LayoutError if there is no column `STATE_COLUMN`,
    no state, or a cell holds something else.
    """
    rows = []
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            table = csv.DictReader(file)
            columns = table.fieldnames or []
            if STATE_COLUMN not in columns:
                raise LayoutError(
                    f"{path} has no column '{STATE_COLUMN}'; give a table of exwarp features, or "
                    "frames.csv of a run with a learned policy"
                )
            known = [name for name in IDENTITY_COLUMNS if name in columns]
            for number, cells in enumerate(table, 1):
                text: Any = cells[STATE_COLUMN]
                if text and text.strip():
                    state = _parse_state(f"{path}, line {table.line_num}", text, size)
                    identity = {name: cells[name] or "" for name in known}
                    rows.append(StateRow(number, identity, state))
    except OSError as error:
        raise InputError(
            f"cannot read {path}: {error.strerror}; check the path and its rights"
        ) from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise DamagedFileError(
            f"{path} is no CSV file in UTF-8 ({error}); give a table with a column '{STATE_COLUMN}'"
        ) from error
    if not rows:
        raise LayoutError(
            f"{path} has no row with '{STATE_COLUMN}'; give one of a run with a learned policy"
        )
    return tuple(rows)


def _parse_state(cell: str, text: str, size: int) -> npt.NDArray[np.int32]:
    words = text.split()
    if len(words) != size:
        raise LayoutError(
            f"{cell}: '{STATE_COLUMN}' holds {len(words)} numbers, and the policy takes {size}; "
            "give the row as it was written"
        )
    for word in words:
        # Not int() alone, which also takes 1_000 and digits of other scripts, and any length.
        is_plain = len(word) <= 11 and word.isascii() and word.lstrip("-").isdigit()
        if not is_plain or word.count("-") > 1 or not _INT32.min <= int(word) <= _INT32.max:
            raise LayoutError(
                f"{cell}: {word[:20]!r} in '{STATE_COLUMN}' is no 32-bit integer; give Q16.16 "
                "numbers, 65536 for 1"
            )
    return np.array([int(word) for word in words], np.int32)
