"""The CSV of ``exwarp features``: a row for every node of every key interval."""

from __future__ import annotations

from exwarp_cli.domain.features import FEATURES
from exwarp_cli.pipeline.featuring import NodeFeatures
from exwarp_cli.report.frames_csv import cell

HEADER = ("frame", "key", "node", *FEATURES, "distance", "inputs")


def row(found: NodeFeatures) -> list[str]:
    """Return one row's cells; `inputs` are integers with spaces between."""
    features = found.features
    cells = (found.frame, found.key, found.node, *features.values, features.distance)
    return [*map(cell, cells), " ".join(map(str, found.inputs))]
