"""Leaving out what the plots of pages cost."""

from __future__ import annotations

from typing import TextIO
from unittest.mock import MagicMock

import pytest


def leave_plots_out(patch: pytest.MonkeyPatch) -> None:
    """Paint the plots of pages without writing them, which takes most of a second a page."""

    def savefig(self: object, file: TextIO, **_: object) -> None:
        file.write('<svg viewBox="0 0 1 1"></svg>')

    patch.setattr("matplotlib.figure.Figure.savefig", savefig)


def leave_lines_out(patch: pytest.MonkeyPatch) -> None:
    """Leave out the lines and axes of plots, too, which take a third of a second a report."""
    axes = MagicMock()
    axes.get_legend_handles_labels.return_value = ([], [])
    patch.setattr("matplotlib.figure.Figure.add_subplot", lambda *_, **__: axes)
