"""The frames that a benchmark's page shows: of each sequence a usual and a bad key interval."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from exwarp_cli.domain.bench import CHOOSERS
from exwarp_cli.pipeline.bench.showing import samples
from exwarp_cli.pipeline.bench.work import Benchmark, Measured
from exwarp_cli.report.gallery import BUDGET, ROOM, TRUTH, Album

SYSTEMS = ("exwarp", "s6", "softsplat", "minterpolate", "hold")
"""What is shown of the systems that are always there; all that options add are shown too."""

LONGEST = 640


def albums(found: Benchmark) -> list[Album]:
    """Return an album for each subject, in their order."""
    extra = [name for name in found.systems if name not in found.settings.systems]
    systems = [name for name in SYSTEMS if name in found.systems] + extra
    chosen = [_intervals(one, systems) for one in found.measured]
    # A picture and an error for each system, half as large, and the truth, at three slots.
    pictures = sum(map(len, chosen)) * 3 * (1.5 * len(systems) + 1)
    room = min(ROOM, int(BUDGET / max(pictures, 1)))
    return [
        _album(found, one, keys, systems, room)
        for one, keys in zip(found.measured, chosen, strict=True)
    ]


def _intervals(one: Measured, systems: Sequence[str]) -> list[int]:
    """Return the numbers of the key frames with the median and the worst PSNR of a system."""
    judge = next((name for name in systems if name in one.parts[0]["systems"]), None)
    if judge is None:
        return []
    ranked = sorted(one.parts, key=lambda p: sum(f["all"]["psnr_db"] for f in p["systems"][judge]))
    return sorted({ranked[0]["key"], ranked[len(ranked) // 2]["key"]})


def _album(
    found: Benchmark, one: Measured, keys: Sequence[int], systems: Sequence[str], room: int
) -> Album:
    before = next(iter(systems), TRUTH)
    album = Album((*systems, TRUTH), before, TRUTH, room, LONGEST)
    parts = {part["key"]: part for part in one.parts}
    for sample in samples(found.settings, one, keys, systems):
        sources = sample.pixels | {TRUTH: sample.truth}
        part = parts[sample.key]
        album.add(sample.number, "blend", sources, TRUTH, sample.mask)
        album.tell(sample.number, _kind(part, sample.slot), _facts(part, sample.slot, systems))
    return album


def _kind(part: dict[str, Any], slot: int) -> str:
    """Name what made the frame of the learned policy, where that was measured."""
    shown = part["systems"].get(CHOOSERS[0])
    return "blend" if shown is None else str(shown[slot - 1]["made_by"])


def _facts(part: dict[str, Any], slot: int, systems: Sequence[str]) -> dict[str, str]:
    facts = {"slot": f"{slot} after key frame {part['key']}"}
    if path := part["paths"].get(CHOOSERS[0]):
        facts["path"] = path
    for name in systems:
        score = part["systems"][name][slot - 1]["all"]
        facts[f"PSNR {name}"] = f"{score['psnr_db']:.2f} dB"
    hole = part["holes"][slot - 1]
    if hole is not None:
        facts["holes"] = f"{hole:.1%}"
    return facts
