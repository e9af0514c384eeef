"""The survey of rendered scenes as Markdown."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

from survey_shots import MUCH, SPREADS

EDGES = (0.0, 0.001, 0.01, 0.05, 0.1, 0.2, 1.0)
"""Bounds of the histogram of hole shares."""


def lines(table: dict[str, Any]) -> list[str]:
    """Write the table down as Markdown."""
    scenes: dict[str, Any] = table["scenes"]
    lines = ["# The rendered scenes in figures", "", "Written by `survey.py`.", ""]
    lines += [
        "| scene | motion per key interval, px: median (calmest-fastest) | p95 (fastest) "
        "| moving | objects | sky | instants | samples | s a frame | MB | noise floor, dB |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for name, row in scenes.items():
        floor = row["noise_floor_psnr_db"]
        lines.append(
            f"| {name} | {row['motion_median_px']:.1f} ({row['motion_median_px_calmest']:.1f}-"
            f"{row['motion_median_px_fastest']:.1f}) | {row['motion_p95_px']:.1f} "
            f"({row['motion_p95_px_fastest']:.1f}) | {row['moving_share']:.0%} "
            f"| {row['dynamic_objects']} | {row['sky_share']:.0%} "
            f"| {row['instants']} | {row['samples']} x {row.get('seeds', 1)} "
            f"| {row['seconds_per_instant']:.2f} | {row['megabytes']} "
            f"| {'' if floor is None else f'{floor:.1f}'} |"
        )
    lines += [
        "",
        "Samples are those of a pixel in each render, times the renders with other noise, each "
        "denoised, whose mean a frame is. Seconds are the renderer's own, of all renders together.",
    ]
    lines += ["", "Share of the frame that the warp from the last key frame cannot see:", ""]
    bins = [f"{100 * low:g}-{100 * high:g} %" for low, high in pairwise(EDGES)]
    lines.append(f"| scene | G-buffers | slot 1 | 2 | 3 | least | most | {' | '.join(bins)} |")
    lines.append("|---" * (7 + len(bins)) + "|")
    for name, row in scenes.items():
        for setting, holes in row["holes"].items():
            shares = [holes[key] for key in ("slot1", "slot2", "slot3", "least", "most")]
            cells = [f"{share:.1%}" for share in shares]
            cells += [str(count) for count in holes["histogram"].values()]
            lines.append(f"| {name} | {setting} | {' | '.join(cells)} |")
    lines += ["", "The columns to the right count frames. Quality of the new frames:", ""]
    lines += ["| scene | G-buffers | method | PSNR dB | SSIM | FLIP | pulse % |", "|---" * 7 + "|"]
    for name, row in scenes.items():
        for setting, methods in row["quality"].items():
            for method, score in methods.items():
                lines.append(
                    f"| {name} | {setting} | {method} | {score['psnr_db']:.2f} "
                    f"| {score['ssim']:.3f} | {score['flip']:.3f} | {_pulse(score)} |"
                )
    return lines + (_training_lines(table["training"]) if "training" in table else [])


def _pulse(score: dict[str, Any]) -> str:
    """Write the pulse; surveys of earlier versions have none."""
    value = score.get("pulse")
    return "" if value is None else f"{value:+.1f}"


def _training_lines(row: dict[str, Any]) -> list[str]:
    sizes = ", ".join(f"{count} at {size}" for size, count in row["sizes"].items())
    lines = [
        "",
        f"Training shots: {row['shots']} of {row['instants']} instants ({sizes}), "
        f"{row['samples']} samples x {row.get('renders', 1):g} renders in the mean, "
        f"{row['seconds_per_instant']:.2f} s a frame, "
        f"{row['megabytes'] / 1000:.1f} GB. How they differ:",
        "",
        "| per shot | least | 10 % | median | 90 % | most |",
        "|---|---|---|---|---|---|",
    ]
    for name, key in SPREADS:
        cells = " | ".join(f"{value:g}" for value in row[key].values())
        lines.append(f"| {name} | {cells} |")
    lines += [
        "",
        f"{row['shots_with_shadows']} of {row['shots']} shots have moving shadows on at least "
        f"{MUCH:.1%} of the picture. SHOTS.md has each shot.",
        f"By engine: {_counts(row['engines'])}.",
        f"By place: {_counts(row['places'])}.",
        f"By what they are to show: {_counts(row['features'])}.",
    ]
    return lines


def _counts(counted: dict[str, int]) -> str:
    return ", ".join(f"{name} {count}" for name, count in counted.items())
