"""Tables of models/README.md from what ``tests.bench.paths`` measured.

``python -m tests.bench.card FULL [DIFFUSE NONE] --quality models/quality.json`` takes the folders
that were given to it as ``--out``, with and without surface AOVs.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from exwarp_cli.domain.timeline import FACTOR

Row = dict[str, Any]
"""One scene in one setting, as ``tests.bench.paths`` keeps it."""

MADE = (2, 3)
"""Slots that E makes frames of."""

COLUMNS = ("psnr_db", "holes_psnr_db", "ssim", "flip")
LEFT = {"full": "all", "diffuse": "Diffuse Color", "none": "nothing"}


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser("python -m tests.bench.card", description=__doc__)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--quality", type=Path, help="also write all numbers to this file")
    options = parser.parse_args(arguments)
    found = {}
    for folder in options.folders:
        rows = json.loads((folder / "paths.json").read_text(encoding="utf-8"))
        found[rows[0]["surface"]] = rows
    print("\n\n".join(table(rows) for rows in found.values()))
    if len(found) > 1:
        print("\n" + by_surface(found))
    if options.quality:
        text = json.dumps(found, separators=(",", ":"))
        options.quality.write_text(text + "\n", encoding="utf-8")
    return 0


def table(rows: Sequence[Row]) -> str:
    """Return E against W, where both were judged, then every method, as Markdown."""
    parts = []
    if all({"s3", "s6"} <= set(row["methods"]) for row in rows):
        parts.append(against_w(rows))
    return "\n\n".join([*parts, by_method(rows)])


def against_w(rows: Sequence[Row]) -> str:
    """Return E's frames against W's, by setting and scene."""
    lines = _heading(
        "scene", "setting", "W dB", "E dB", "gain", "in holes: W", "E", "gain", "SSIM W", "E",
        "FLIP W", "E",
    )  # fmt: skip
    for row in sorted(rows, key=lambda row: (row["setting"], row["scene"])):
        w, e = _of(row, "s6"), _of(row, "s3")
        cells = [row["scene"], row["setting"]]
        for key in COLUMNS[:2]:
            cells += [f"{w[key]:.2f}", f"{e[key]:.2f}", f"{e[key] - w[key]:+.2f}"]
        cells += [f"{side[key]:.3f}" for key in COLUMNS[2:] for side in (w, e)]
        lines.append(_line(cells))
    for setting in _settings(rows):
        psnr, holes, ssim, flip = np.mean(
            [_gains(row) for row in rows if row["setting"] == setting], axis=0
        )
        cells = ["**mean**", f"**{setting}**", "", "", f"**{psnr:+.2f}**", "", ""]
        lines.append(_line([*cells, f"**{holes:+.2f}**", "", f"{ssim:+.3f}", "", f"{flip:+.3f}"]))
    return "\n".join(lines)


def by_surface(found: dict[str, Sequence[Row]]) -> str:
    """Return E's gains by what of the surface the frames have."""
    scenes = [row["scene"] for row in next(iter(found.values())) if row["setting"] == "key"]
    lines = _heading("left", "setting", *scenes, "mean", "in holes")
    for surface, rows in found.items():
        for setting in _settings(rows):
            gains = np.array([_gains(row) for row in rows if row["setting"] == setting])
            values = [*gains[:, 0], *gains[:, :2].mean(axis=0)]
            lines.append(_line([LEFT[surface], setting, *(f"{v:+.2f}" for v in values)]))
    return "\n".join(lines)


def by_method(rows: Sequence[Row]) -> str:
    """Return every method's quality and frame rate, a table for each setting."""
    parts = []
    for setting in _settings(rows):
        chosen = [row for row in rows if row["setting"] == setting]
        lines = [f"**{setting}**: PSNR dB / SSIM / FLIP, and PSNR dB in holes", ""]
        lines += _heading("method", "effective fps", *(row["scene"] for row in chosen))
        for name in chosen[0]["methods"]:
            if "@" in name:
                continue
            found = [row["methods"][name] for row in chosen]
            cells = [name, f"{1 + (FACTOR - 1) * found[0]['new']:.0f}x"]
            for m in found:
                holes = m.get("holes_psnr_db", np.nan)
                cells.append(f"{m['psnr_db']:.2f} / {m['ssim']:.3f} / {m['flip']:.3f}, {holes:.2f}")
            lines.append(_line(cells))
        parts.append("\n".join(lines))
    return "\n\n".join(parts)


def _of(row: Row, name: str) -> dict[str, float]:
    found = [row["methods"][f"{name}@{slot}"] for slot in MADE]
    return {key: float(np.mean([m.get(key, np.nan) for m in found])) for key in COLUMNS}


def _gains(row: Row) -> list[float]:
    w, e = _of(row, "s6"), _of(row, "s3")
    return [e[key] - w[key] for key in COLUMNS]


def _settings(rows: Sequence[Row]) -> list[str]:
    return sorted({row["setting"] for row in rows})


def _heading(*names: str) -> list[str]:
    return [_line(names), "|" + "---|" * len(names)]


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


if __name__ == "__main__":
    sys.exit(main())
