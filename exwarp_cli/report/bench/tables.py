"""All tables of a benchmark, in the order in which they are shown."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from exwarp_cli.report.bench import choice_tables, clocked_tables, cost_tables, quality_tables
from exwarp_cli.report.bench.columns import Column, Table, known_columns
from exwarp_cli.report.bench.naming import Document

__all__ = ["MAKERS", "Column", "Table", "known_columns", "tables_of"]

MAKERS: Sequence[Callable[[Document], Table]] = (
    cost_tables.render_time,
    cost_tables.runtime,
    choice_tables.holes,
    choice_tables.features,
    quality_tables.psnr,
    quality_tables.ssim,
    quality_tables.comparison,
    choice_tables.fps,
    choice_tables.choices,
    cost_tables.predictor,
    quality_tables.by_extranet,
)


CLOCKED_MAKERS: Sequence[Callable[[Document], Table]] = (
    clocked_tables.fps,
    clocked_tables.paths,
    clocked_tables.choices,
    clocked_tables.slots,
)


def tables_of(document: Document) -> tuple[Table, ...]:
    """Return every table of a benchmark, in the paper's order; then those of a clock."""
    makers = (*MAKERS, *CLOCKED_MAKERS) if "real_time" in document else MAKERS
    return tuple(make(document) for make in makers)
