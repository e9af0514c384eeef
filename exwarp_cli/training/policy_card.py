"""The scores of a policy as Markdown."""

from __future__ import annotations

from typing import Any

from exwarp_cli.domain.decision import PATHS
from exwarp_cli.domain.settings import DEFAULT_FPS

COLUMNS = ("exwarp", *PATHS, "oracle", "oracle-return", "regressor", "random")
NAMED = {
    "exwarp": "policy",
    "oracle": "best PSNR",
    "oracle-return": "best return",
    "regressor": "regression",
}


def card(report: dict[str, Any]) -> str:
    """Return the tables of what ``policy.json`` holds: every scene when it was left out.

    One table for PSNR and SSIM, one for return, one for what was chosen.
    """
    rows = [
        (scene, part, scores)
        for scene, parts in report["left_out"].items()
        for part, scores in parts.items()
        if part != "all"
    ]
    return "\n\n".join((_quality(rows), _returns(rows), _choices(rows)))


def _quality(rows: list[Any]) -> str:
    lines = [_head("scene", "frames", *_names()), _rule(2 + len(COLUMNS))]
    for scene, part, found in rows:
        scores = [found["scores"][name] for name in COLUMNS]
        best = max(score["psnr_db"] for score in scores[1 : 1 + len(PATHS)])
        cells = [f"{s['psnr_db']:.2f} / {s['ssim']:.3f}" for s in scores]
        marked = [
            f"**{cell}**" if s["psnr_db"] == best and name in PATHS else cell
            for name, s, cell in zip(COLUMNS, scores, cells, strict=True)
        ]
        lines.append(_head(scene, part, *marked))
    return "\n".join(lines)


def _returns(rows: list[Any]) -> str:
    lines = [_head("return", "frames", *_names()), _rule(2 + len(COLUMNS))]
    for scene, part, found in rows:
        cells = [f"{found['scores'][name]['reward']:.2f}" for name in COLUMNS]
        lines.append(_head(scene, part, *cells))
    means = [sum(f["scores"][name]["reward"] for _, _, f in rows) / len(rows) for name in COLUMNS]
    return "\n".join([*lines, _head("**mean**", "", *(f"{value:.3f}" for value in means))])


def _choices(rows: list[Any]) -> str:
    names = ("scene", "frames", "intervals", *PATHS, "warps", "effective fps", "int8 = float")
    lines = [_head(*names), _rule(len(names))]
    for scene, part, found in rows:
        own = found["scores"]["exwarp"]
        fps = float(DEFAULT_FPS) * (1 + own["new_frames"])
        cells = [str(own["intervals"]), *(str(count) for count in own["paths"])]
        shares = [f"{own['warp_share']:.1%}", f"{fps:.1f}", f"{found['agreement']:.2%}"]
        lines.append(_head(scene, part, *cells, *shares))
    return "\n".join(lines)


def _names() -> list[str]:
    return [NAMED.get(name, name) for name in COLUMNS]


def _head(*cells: str) -> str:
    return "| " + " | ".join(cells) + " |"


def _rule(count: int) -> str:
    return "|" + "---|" * count


def tile_card(report: dict[str, Any]) -> str:
    """Return what ``tile-policy.json`` holds: what choices gain at some shares of the area.

    In per cent of what E gains everywhere, in dB over all scenes.
    """
    curves = report["gain_percent"]
    shares = list(next(iter(curves.values())))
    lines = [_head("choice", *(f"{float(share):.0%} of the area" for share in shares))]
    lines.append(_rule(1 + len(shares)))
    lines += [
        _head(name, *(f"{found[share]:.0f} %" for share in shares))
        for name, found in curves.items()
    ]
    whole = ", ".join(
        f"{scene} {gain:+.2f}" for scene, gain in report["extrapolator_gain_db"].items()
    )
    s4 = f"Always S4, at half of the area, gains {report['always_s4_percent']:.0f} %."
    return "\n".join([*lines, "", f"E everywhere gains, in dB: {whole}. {s4}"])
