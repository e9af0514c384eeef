"""How good the frames of every system are: Tables VI and VII, and ExtraNet's procedure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from exwarp_cli.domain.bench import CHOOSERS, FIXED, is_lookahead
from exwarp_cli.domain.decision import EXTRAPOLATE, HOLD, PATHS, WARP
from exwarp_cli.domain.results import Score
from exwarp_cli.pipeline.bench.work import Measured
from exwarp_cli.report.bench import paper
from exwarp_cli.report.bench.naming import Document, identify
from exwarp_cli.report.quality import mean, quality

MAKERS = (WARP, EXTRAPOLATE, HOLD)


def shown(one: Measured, system: str) -> list[Document]:
    """Return the frames that a system shows at slots 1 to 3 of all key intervals."""
    return [frame for part in one.parts for frame in part["systems"][system]]


def scores(frames: Iterable[Document], where: str = "all") -> Document:
    """Average scores of frames; `where` is "all" or "holes"."""
    return quality(None if f[where] is None else Score(**f[where]) for f in frames)


def quality_row(one: Measured) -> Document:
    """Return a row of Table VI, with every system: means over slots 1 to 3."""
    row, printed = identify(one), paper.QUALITY.get(identify(one)["app"] or "")
    systems = {}
    for name in one.parts[0]["systems"]:
        frames = shown(one, name)
        made = {maker: [f for f in frames if f["made_by"] == maker] for maker in MAKERS}
        systems[name] = {
            "all": scores(frames),
            "holes": scores(frames, "holes"),
            "by_decision": {choice: scores(made[choice]) for choice in (WARP, EXTRAPOLATE)},
            "dropped": scores(made[HOLD]),
        }
    return row | {
        "systems": systems,
        "returns": _returns(one),
        "best_path": _best(systems),
        "paper": printed,
    }


def comparison_row(one: Measured) -> Document:
    """Return a row of Table VII: look-ahead systems beside causal ones, with their latency."""
    row, spent = identify(one), one.timing["systems_ms"]
    wait = 1e3 / one.about["fps"]
    printed = paper.INTERPOLATION.get(row["app"] or "")
    return row | {
        "systems": {
            name: {
                "lookahead": is_lookahead(name),
                "waits_ms": wait if is_lookahead(name) else 0.0,
                "frame_ms": spent.get(name),
                **scores(shown(one, name)),
            }
            for name in one.parts[0]["systems"]
        },
        "paper": printed,
    }


def extranet_row(one: Measured) -> Document:
    """Average what ExtraNet's procedure gives for the frame midway between key frames."""
    found = {
        name: {
            metric: mean(part["extranet"][name][metric] for part in one.parts)
            for metric in ("psnr_db", "ssim")
        }
        for name in one.parts[0]["extranet"]
    }
    return identify(one) | {"systems": found, "frames": len(one.parts)}


def _returns(one: Measured) -> Document | None:
    """Return the mean return (sum of the paper's rewards) of every path and of who chooses."""
    if one.parts[0]["returns"] is None:
        return None
    names = tuple(PATHS)
    found: Document = {
        name.lower(): mean(part["returns"][i] for part in one.parts) for i, name in enumerate(names)
    }
    for chooser in CHOOSERS:
        found[chooser] = mean(
            part["returns"][names.index(part["paths"][chooser])]
            for part in one.parts
            if chooser in part["paths"]
        )
    return found


def _best(systems: Mapping[str, Document]) -> str | None:
    """Return the fixed path with the best PSNR."""
    known = {n: systems[n]["all"]["psnr_db"] for n in FIXED if n in systems}
    return max(known, key=lambda name: known[name]) if known else None
