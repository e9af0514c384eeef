"""What ``exwarp features`` prints: a row for every node of every key interval."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from exwarp_cli import __version__
from exwarp_cli.domain.decision import FEATURES
from exwarp_cli.pipeline.decide import NodeFeatures
from exwarp_cli.report.frames_csv import cell

SCHEMA = "exwarp.features/1"

HEADER = ("frame", "key", "node", *FEATURES, "distance", "inputs")


def row(found: NodeFeatures) -> list[str]:
    """Return one row's cells; `inputs` are integers with spaces between."""
    *cells, inputs = _values(found)
    return [*map(cell, cells), " ".join(map(str, inputs))]


def document(rows: Iterable[NodeFeatures]) -> dict[str, Any]:
    """Return all rows under ``rows``, keys as the columns of the CSV; `inputs` is a list."""
    return {
        "schema": SCHEMA,
        "version": __version__,
        "rows": [dict(zip(HEADER, _values(found), strict=True)) for found in rows],
    }


def _values(found: NodeFeatures) -> tuple[Any, ...]:
    features = found.features
    identity = (found.frame, found.key, found.node)
    return (*identity, *features.values, features.distance, found.inputs)
