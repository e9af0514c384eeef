"""Tables of how good frames are: Tables VI and VII, and ExtraNet's procedure."""

from __future__ import annotations

from exwarp_cli.domain.bench import FIXED
from exwarp_cli.domain.metric import METRICS
from exwarp_cli.report.bench.columns import (
    OURS,
    SOURCE,
    SYSTEM,
    WHAT,
    Column,
    Row,
    Table,
    paper_row,
    what,
)
from exwarp_cli.report.bench.naming import Document


def psnr(document: Document) -> Table:
    """Table VI, its upper half."""
    title = "Quality of every decision path, PSNR dB (Table VI)"
    return _paths(document, "psnr_db", "paths_psnr", title, ".2f")


def ssim(document: Document) -> Table:
    """Table VI, its lower half."""
    return _paths(document, "ssim", "paths_ssim", "The same, SSIM (Table VI)", ".3f")


def _paths(document: Document, metric: str, name: str, title: str, style: str) -> Table:
    """Table VI, for one metric."""
    systems = (*FIXED, "exwarp", "oracle", "oracle-return")
    rows: list[Row] = []
    for row in document["quality"]:
        found = row["systems"]
        values = {s: found[s]["all"][metric] for s in systems if s in found}
        rows.append(what(row) | {"source": OURS, "best": row["best_path"]} | values)
        if row["paper"] is not None:
            printed = {system: values[metric] for system, values in row["paper"].items()}
            best = max(FIXED, key=lambda path: printed[path])
            rows.append(paper_row(row) | {"best": best} | printed)
    titles = (*(path.upper() for path in FIXED), "ExWarp", "oracle", "oracle (return)")
    return Table(
        name,
        title,
        "Means over all frames shown at slots 1 to 3, repeats included. S1 is ExtraNet's way, S6 "
        "warping alone; the oracles choose by ground truth. Paper: other scenes of the same "
        "themes; 240p stands beside its 480p.",
        (
            *WHAT,
            SOURCE,
            *(Column(s, t, style) for s, t in zip(systems, titles, strict=True)),
            Column("best", "best path"),
        ),
        tuple(rows),
    )


def comparison(document: Document) -> Table:
    """Table VII, with every metric."""
    rows: list[Row] = []
    for row, quality in zip(document["comparison"], document["quality"], strict=True):
        for name, values in row["systems"].items():
            inside = quality["systems"][name]["holes"]
            masked = {f"{m.field}_holes": inside[m.field] for m in METRICS if m.in_holes}
            kind = "look-ahead" if values["lookahead"] else "causal"
            rows.append(
                what(row) | {"source": OURS, "system": name, "kind": kind} | values | masked
            )
        for name, values in (row["paper"] or {}).items():
            rows.append(paper_row(row) | {"system": name, "kind": "look-ahead"} | values)
        for name in ("s1", "exwarp") if quality["paper"] else ():
            label = "ExtraNet (S1)" if name == "s1" else "ExWarp"
            rows.append(
                paper_row(row) | {"system": label, "kind": "causal"} | quality["paper"][name]
            )
    return Table(
        "comparison",
        "Comparison with interpolation (Table VII)",
        "Look-ahead systems wait for the next key frame, so that a live viewer sees "
        "everything a key interval late. Time is that of one generated frame, files apart. s1 to "
        "s5 and exwarp run our E; s1 is what ExtraNet does. PSNR, SSIM and VMAF: more is better; "
        "FLIP, HDR-FLIP and flicker: less; pulse: 0. (holes): the pixels that W cannot see.",
        (
            *WHAT,
            SOURCE,
            SYSTEM,
            Column("kind", "kind"),
            Column("waits_ms", "waits ms", ".1f"),
            Column("frame_ms", "time ms", ".1f"),
            *(Column(m.field, m.title, m.style) for m in METRICS),
            *(
                Column(f"{m.field}_holes", f"{m.title} (holes)", m.style)
                for m in METRICS
                if m.in_holes
            ),
        ),
        tuple(rows),
    )


def by_extranet(document: Document) -> Table:
    """What ExtraNet's own procedure gives."""
    rows: list[Row] = []
    for row in document["extranet_procedure"]:
        for name, values in row["systems"].items():
            rows.append(what(row) | {"system": name} | values | {"frames": row["frames"]})
    return Table(
        "extranet",
        "By ExtraNet's procedure: one frame midway between two rendered ones",
        "8-bit sRGB, rounded; SSIM with a uniform 7x7 window. What a system shows at slot 2.",
        (
            *WHAT,
            SYSTEM,
            Column("psnr_db", "PSNR dB", ".2f"),
            Column("ssim", "SSIM", ".4f"),
            Column("frames", "frames", "d"),
        ),
        tuple(rows),
    )
