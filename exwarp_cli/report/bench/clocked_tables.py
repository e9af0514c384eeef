"""Tables of the real-time clock: Figures 8 and 9 under it, and what every slot shows."""

from __future__ import annotations

from exwarp_cli.domain.bench import CHOOSERS
from exwarp_cli.domain.decision import EXTRAPOLATE, WARP
from exwarp_cli.domain.real_time import BUSY, BY_PATH, LATE, MEASURED, TABLE, TABLE_AS
from exwarp_cli.pipeline.scoring import SLOTS
from exwarp_cli.report.bench.choice_tables import CHOICE_COLUMNS, choice_cells
from exwarp_cli.report.bench.clocked import SYSTEMS
from exwarp_cli.report.bench.columns import SYSTEM, WHAT, Column, Row, Table, what
from exwarp_cli.report.bench.naming import Document

CLOCK = (
    "A display of 120 Hz shows 30 key frames a second, and a slot every 8.33 ms. A frame is "
    "requested when its node decides, one slot ahead; E(F) after d1 = E is requested with the key "
    "frame, two slots ahead. One engine runs E and is busy until that frame is ready. W needs no "
    "engine. A frame that is not ready at its slot is dropped, and the slot repeats the frame "
    "before. "
)

FROM_TABLE = (
    "Latencies are means over the applications of the paper's Table III: W is G-buffer generation "
    "and warping, E all four steps. "
)

LATENCIES = {
    TABLE: FROM_TABLE + "Between 480p, 720p and 1080p they are interpolated by pixels. Smaller "
    "frames count as 480p, larger ones in proportion to 1080p.",
    **{clock: f"{FROM_TABLE}All frames count as {size}." for clock, size in TABLE_AS.items()},
    MEASURED: "Latencies are this machine's, from the table of run times: W is geometry, warping "
    "and hole marking; E is these, the network's inputs and the network. Reading, features and "
    "the decision do not count.",
}

SHOWN = {
    WARP: "W",
    EXTRAPOLATE: "E",
    BY_PATH: "repeat, by path",
    LATE: "repeat, late",
    BUSY: "repeat, engine busy",
}
"""What a slot shows, for people."""


def fps(document: Document) -> Table:
    """Figure 8 under the clock."""
    found = document["real_time"]
    rows = [
        what(row)
        | {"warp_ms": row["latency_ms"][WARP], "extrapolate_ms": row["latency_ms"][EXTRAPOLATE]}
        | {"extrapolate_slots": row["extrapolate_slots"], "base": found["base"]}
        | {name: system["effective"] for name, system in row["systems"].items()}
        for row in found["rows"]
    ]
    return Table(
        "real_time_fps",
        f"Effective frames per second in real time (Figure 8, clock {found['clock']})",
        CLOCK + LATENCIES[found["clock"]],
        (
            *WHAT,
            Column("warp_ms", "W ms", ".2f"),
            Column("extrapolate_ms", "E ms", ".2f"),
            Column("extrapolate_slots", "E slots", "d"),
            Column("base", "base", "g"),
            *(Column(name, name, ".1f") for name in SYSTEMS),
        ),
        tuple(rows),
    )


def paths(document: Document) -> Table:
    """What the clock makes of every decision path."""
    found = document["real_time"]
    rows: dict[str, Row] = {}
    for row in found["rows"]:
        for path, each in row["paths"].items():
            kinds = [
                reason or maker
                for maker, reason in zip(each["made_by"], each["dropped"], strict=True)
            ]
            shown = {f"slot_{slot}": SHOWN[kinds[slot - 1]] for slot in SLOTS}
            rate = found["base"] * (1 + each["new"])
            cells = {"size": row["size"], "path": path, **shown, "new": each["new"], "fps": rate}
            rows.setdefault(str(cells), cells)
    return Table(
        "real_time_paths",
        "What every decision path shows in real time",
        "In a key interval that begins with a free engine, by the size of the frames. By path: the "
        "path itself repeats the frame before. Late: the frame is not ready at its slot. Engine "
        "busy: an earlier E still runs when this one is requested. A W after a late E warps the "
        "key frame.",
        (
            Column("size", "size"),
            Column("path", "path"),
            *(Column(f"slot_{slot}", f"slot {slot}") for slot in SLOTS),
            Column("new", "new frames", "d"),
            Column("fps", "effective fps", "g"),
        ),
        tuple(rows.values()),
    )


def choices(document: Document) -> Table:
    """Figure 9 under the clock."""
    found = document["real_time"]
    rows = [
        what(row) | {"system": name} | choice_cells(row["systems"][name]["decisions"])
        for row in found["rows"]
        for name in CHOOSERS
        if name in row["systems"]
    ]
    return Table(
        "real_time_decisions",
        f"Breakdown of the decisions in real time (Figure 9, clock {found['clock']})",
        "As in the table of all decisions. The policy does not know the clock: it decides as it "
        "does offline. The oracles take the path that is best in PSNR or return of what the clock "
        "lets them show.",
        (*WHAT, SYSTEM, *CHOICE_COLUMNS),
        tuple(rows),
    )


def slots(document: Document) -> Table:
    """What comes of every system's decisions."""
    found = document["real_time"]
    rows: list[Row] = []
    for row, offline, quality in zip(
        found["rows"], document["fps"], document["quality"], strict=True
    ):
        for name, system in row["systems"].items():
            total = sum(system["slots"].values())
            shares = {kind: count / total for kind, count in system["slots"].items()}
            values = {key: system[key] for key in ("effective", "psnr_db", "ssim", "return")}
            before = {
                "offline_fps": offline["effective"][name],
                "offline_psnr_db": quality["systems"][name]["all"]["psnr_db"],
            }
            rows.append(what(row) | {"system": name} | shares | values | before)
    return Table(
        "real_time_slots",
        "Slots and quality of every system in real time",
        "Shares of slots 1 to 3 by what they show, and why they repeat the frame before: by path, "
        "late, or engine busy. PSNR and SSIM are means over these slots, repeats included. Return "
        "is the mean sum of the paper's rewards in a key interval; alpha counts for every repeat, "
        "late ones too. Offline every frame comes in time, and the oracles know of no clock.",
        (
            *WHAT,
            SYSTEM,
            *(Column(kind, title, ".1%") for kind, title in SHOWN.items()),
            Column("effective", "fps", ".1f"),
            Column("offline_fps", "offline fps", ".1f"),
            Column("psnr_db", "PSNR dB", ".2f"),
            Column("offline_psnr_db", "offline PSNR dB", ".2f"),
            Column("ssim", "SSIM", ".3f"),
            Column("return", "return", "+.2f"),
        ),
        tuple(rows),
    )
