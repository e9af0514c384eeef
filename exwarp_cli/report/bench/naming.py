"""How rows of all tables name sequences and systems."""

from __future__ import annotations

from typing import Any

from exwarp_cli.domain.bench import CHOOSERS, EXTRANET, EXTRANET_FAST, ONNX, is_lookahead
from exwarp_cli.domain.decision import PATHS
from exwarp_cli.pipeline.bench.work import Measured
from exwarp_cli.report.bench import paper

Document = dict[str, Any]


def identify(one: Measured) -> Document:
    """Return how rows of all tables name a sequence."""
    about, subject = one.about, one.subject
    return {
        "name": subject.name,
        "setting": subject.setting,
        "size": f"{about['width']}x{about['height']}",
        "app": paper.app_of(subject.name, about["height"]),
    }


def about_system(name: str) -> Document:
    """Say what a system is, and what it waits for."""
    if name in CHOOSERS:
        label = {
            "exwarp": "ExWarp: the learned policy, in 8-bit integers",
            "oracle": "best path of every interval by PSNR, by ground truth",
            "oracle-return": "best path by the paper's reward, by ground truth",
        }[name]
    elif name.upper() in PATHS:
        label = (
            "path "
            + name.upper()
            + {"s1": ", ExtraNet's way with our E", "s6": ", warping alone"}.get(name, "")
        )
    elif name in (EXTRANET, EXTRANET_FAST):
        label = "imported ExtraNet, path " + ("S1" if name == EXTRANET else "S3")
    elif name.startswith(ONNX):
        label = f"network {name.removeprefix(ONNX)}"
    else:
        label = {
            "softsplat": "both key frames splatted by the renderer's motion, blended by depth",
            "blend": "cross-fade",
            "minterpolate": "ffmpeg's minterpolate, from colour alone",
            "hold": "the key frame again",
        }[name]
    return {"about": label, "lookahead": is_lookahead(name)}
