"""Naive twins of decisions: the paper's tree and tables as plain lists, rewards by plain loops."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

W, E = "warp", "extrapolate"

PATHS = {
    "S1": {"d1": E, "d3": E},
    "S2": {"d1": E, "d3": W},
    "S3": {"d1": W, "d2": E, "d4": E},
    "S4": {"d1": W, "d2": E, "d4": W},
    "S5": {"d1": W, "d2": W, "d5": E},
    "S6": {"d1": W, "d2": W, "d5": W},
}
"""The choices along each path, from the figure of the decision tree."""

SHOWN = {
    "S1": [("d1", E), ("d2", E), ("d3", E)],
    "S2": [("d1", E), ("d2", E), ("d3", W)],
    "S3": [("d1", W), ("d2", E), ("d4", E)],
    "S4": [("d1", W), ("d2", E), ("d4", W)],
    "S5": [("d1", W), ("d2", W), ("d5", E)],
    "S6": [("d1", W), ("d2", W), ("d5", W)],
}
"""Which node's frame stands at slots 1 to 3, from the table of scenarios: P1, P2 and P3."""

NODES_OF = {
    "S1": ["d1", "", "d3"],
    "S2": ["d1", "", "d3"],
    "S3": ["d1", "d2", "d4"],
    "S4": ["d1", "d2", "d4"],
    "S5": ["d1", "d2", "d5"],
    "S6": ["d1", "d2", "d5"],
}
"""The node that decides slots 1 to 3; none decides slot 2 after d1 = E."""

NEW = {"S1": 1, "S2": 2, "S3": 3, "S4": 3, "S5": 3, "S6": 3}
"""New frames of each path, from the table of scenarios."""

DROPS = {("d1", E), ("d3", E)}
"""Choices after which a frame is shown again."""

SCALES = {
    "N_d": (1, 63), "EMD_Wn": (0.001, 0.5), "EMD_Wp": (0.001, 1),
    "Var_x": (1e-7, 0.01), "Var_y": (1e-7, 0.01), "R": (0.05, 33.2),
}  # fmt: skip
"""Unit and top of each feature in version 1 of the state: policies are trained for these."""

Quality = Mapping[tuple[str, str], tuple[float, float]]
"""PSNR and SSIM of the frame that a choice at a node shows."""


def reward(quality: Quality, node: str, choice: str) -> float:
    """Gain in PSNR and SSIM over the other choice, and -0.1 for a dropped frame."""
    chosen, other = quality[node, choice], quality[node, W if choice == E else E]
    gain = (chosen[0] - other[0]) + (chosen[1] - other[1])
    return gain - 0.1 if (node, choice) in DROPS else gain


def total(quality: Quality, path: str) -> float:
    """The return of a path: its rewards added up."""
    return sum(reward(quality, node, choice) for node, choice in PATHS[path].items())


def mean_psnr(quality: Quality, path: str) -> float:
    """Mean over slots 1 to 3."""
    return sum(quality[step][0] for step in SHOWN[path]) / 3


def scaled(seen: Mapping[str, float]) -> list[float]:
    """Six features from 0 to 1.

    Parameters
    ----------
    seen
        The features by name, and ``width`` (pixels) and ``distance`` (scene units).
    """

    far, wide = seen["distance"], seen["width"] * seen["width"]
    values = {
        "N_d": seen["N_d"],
        "EMD_Wn": seen["EMD_Wn"],
        "EMD_Wp": seen["EMD_Wp"] / far if far > 0 else 0,
        "Var_x": seen["Var_x"] / wide,
        "Var_y": seen["Var_y"] / wide,
        "R": seen["R"] / 1e6,
    }
    out = []
    for name, (unit, top) in SCALES.items():
        out.append(min(1.0, math.log(1 + values[name] / unit) / math.log(1 + top / unit)))
    return out


def inputs(history: Sequence[tuple[Mapping[str, float], str]]) -> list[float]:
    """44 numbers from what was seen at which node, the newest first; the oldest is repeated."""
    states = list(history[:4])
    while len(states) < 4:
        states.append(states[-1])
    out: list[float] = []
    for seen, node in states:
        out += scaled(seen)
        out += [float(node == name) for name in ("d1", "d2", "d3", "d4", "d5")]
    return out
