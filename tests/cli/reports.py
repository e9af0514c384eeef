"""Reports on disk, without what depends on how long the work took."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any


def unmeasured(folder: Path) -> dict[str, Any]:
    """Return report.json without measured times, and what is reckoned from them."""
    document: dict[str, Any] = json.loads((folder / "report.json").read_text())
    del document["timing_ms"], document["wall_s"], document["fps"]["throughput"]
    saved = document["render_time"] or {}
    for name in ("generated_frame_s", "saved_s", "saved_share"):
        saved.pop(name, None)
    return document


def rows(folder: Path) -> list[dict[str, str]]:
    """Return frames.csv without the times of steps."""
    with (folder / "frames.csv").open(newline="") as file:
        found = list(csv.DictReader(file))
    return [{k: v for k, v in row.items() if not k.endswith("_ms")} for row in found]


def album(folder: Path) -> dict[str, Any]:
    """Return what the viewer of a page reads."""
    begin, text = '<script type="application/json">', (folder / "report.html").read_text()
    document: dict[str, Any] = json.loads(text.split(begin)[1].split("</script>")[0])
    return document
