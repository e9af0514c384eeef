"""The work behind ``exwarp policy``: the accelerator's schedule, inferences, and test vectors."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from exwarp_cli.accel.fixed_point import I32, ONE
from exwarp_cli.accel.kernel import MlpKernel
from exwarp_cli.accel.mac_array import MacArray, Schedule, schedule
from exwarp_cli.accel.quantised_mlp import (
    PAPER_SIZES,
    Inference,
    QuantisedMlp,
    infer_reference,
)
from exwarp_cli.errors import UsageError
from exwarp_cli.io.policy_files import load_policy
from exwarp_cli.io.states import StateRow, read_states

_CLOCK = re.compile(r"([0-9.]+(?:e[+-]?[0-9]+)?)\s*([kmg]?)(?:hz)?", re.IGNORECASE)
_BYTES = re.compile(r"([0-9]+)\s*([kmg]?)i?b?", re.IGNORECASE)
_HERTZ = {"": 1.0, "k": 1e3, "m": 1e6, "g": 1e9}
_UNITS = {"": 1, "k": 1 << 10, "m": 1 << 20, "g": 1 << 30}


@dataclass(frozen=True)
class Decided:
    """A row of a table, and what the policy says to it.

    Attributes
    ----------
    row
        With the state.
    outputs
        Of warping and of extrapolating, int32.
    choice
        0 to warp, 1 to extrapolate.
    """

    row: StateRow
    outputs: tuple[int, int]
    choice: int


@dataclass(frozen=True)
class Trace:
    """One inference with everything on the way.

    Attributes
    ----------
    row
        Whose state it is.
    network, inference, schedule
        What ran, what it computed, and how long the paper's machine takes.
    """

    row: StateRow
    network: QuantisedMlp
    inference: Inference
    schedule: Schedule


def clock_of(text: str) -> float:
    """Read a clock rate, as ``500MHz``, ``1.5GHz`` or ``1e9``, in hertz.

    Raises
    ------
    UsageError
        When it is none, or not above 0.
    """
    match = _CLOCK.fullmatch(text.strip())
    try:
        hertz = float(match[1]) * _HERTZ[match[2].lower()] if match else math.nan
    except ValueError:
        hertz = math.nan
    if not (math.isfinite(hertz) and hertz > 0):
        raise UsageError(f"--clock {text} is no clock rate; give one as 500MHz, 1.5GHz or 1e9")
    return hertz


def bytes_of(text: str) -> int:
    """Read a size, as ``16KB`` or ``16384``; K is 1024.

    Raises
    ------
    UsageError
        When it is none.
    """
    match = _BYTES.fullmatch(text.strip())
    if match is None or len(match[1]) > 15:
        raise UsageError(f"--cache {text} is no size; give one as 16KB or 16384")
    return int(match[1]) * _UNITS[match[2].lower()]


def cycles(policy: Path | None, cores: int, macs: int, cache: str) -> Schedule:
    """Lay out an inference on a machine.

    Parameters
    ----------
    policy
        File whose network is taken; None for the paper's sizes.
    cores, macs
        Of the machine, at least 1.
    cache
        Of each core; see :func:`bytes_of`.

    Raises
    ------
    UsageError
        When the cache is no size, or too small.
    InputError
        When the policy cannot be read.
    """
    sizes = PAPER_SIZES if policy is None else load_policy(policy).network.sizes
    try:
        return schedule(MacArray(cores, macs, cache_bytes=bytes_of(cache)), sizes)
    except ValueError as error:
        raise UsageError(f"--cache {cache} does not do: {error}; give a larger one") from error


def decide_rows(table: Path, policy: Path | None, number: int | None) -> list[Decided]:
    """Run the policy on the states of a table.

    Parameters
    ----------
    table
        CSV file; see `exwarp_cli.io.states.read_states`.
    policy
        File of the policy; None for the one that comes with ExWarp.
    number
        Row to take; None for all.

    Raises
    ------
    InputError
        When a file cannot be used.
    UsageError
        When there is no such row.
    """
    network = load_policy(policy).network
    rows = _chosen(table, read_states(table, network.sizes[0]), number)
    outputs, choices = MlpKernel(network).decide_many(np.stack([row.state for row in rows]))
    return [
        Decided(row, (int(both[0]), int(both[1])), int(choice))
        for row, both, choice in zip(rows, outputs, choices, strict=True)
    ]


def trace_row(table: Path, policy: Path | None, number: int | None) -> Trace:
    """Run the policy on one state, the first where no row is named, and keep every number.

    Parameters and errors are those of :func:`decide_rows`.
    """
    network = load_policy(policy).network
    row = _chosen(table, read_states(table, network.sizes[0]), number)[0]
    inference = infer_reference(network, row.state)
    return Trace(row, network, inference, schedule(MacArray(), network.sizes))


def sample_states(size: int, count: int, seed: int) -> I32:
    """Return states to test an implementation with, int32 [count, size] in Q16.16.

    By turns: within 0 … 1, as they are meant; of any size, small ones as often as large ones; and
    values at which bits carry and saturate.
    """
    rng = np.random.default_rng(seed)
    shape = (count, size)
    meant = rng.integers(0, ONE, shape, np.int64, endpoint=True)
    powers = np.int64(1) << rng.integers(0, 32, shape, np.int64)
    signs = rng.choice(np.array([-1, 1]), shape)
    anything = (rng.random(shape) * powers).astype(np.int64) * signs
    edges = powers * signs + rng.integers(-2, 3, shape)
    turn = np.arange(count)[:, None] % 3
    states = np.where(turn == 0, meant, np.where(turn == 1, anything, edges))
    return np.clip(states, -(2**31), 2**31 - 1).astype(np.int32)


def _chosen(table: Path, rows: tuple[StateRow, ...], number: int | None) -> tuple[StateRow, ...]:
    """Return the row of a number, or all."""
    if number is None:
        return rows
    found = tuple(row for row in rows if row.row == number)
    if not found:
        raise UsageError(
            f"--row {number}: {table} has no state in that row; its states are in rows "
            f"{rows[0].row} to {rows[-1].row}"
        )
    return found
