"""Decisions as text in the header of the frame that they led to, so that a later run finds them."""

from __future__ import annotations

import json
from dataclasses import astuple
from typing import Any

from exwarp_cli.domain.decision import Decision
from exwarp_cli.domain.features import Features


def decision_text(decision: Decision) -> str:
    """Write a decision as JSON on one line."""
    found: dict[str, Any] = {"node": decision.node, "choice": decision.choice}
    if decision.outputs is not None:
        found["outputs"] = decision.outputs
    if decision.features is not None:
        found["features"] = astuple(decision.features)
    if decision.inputs:
        found["inputs"] = decision.inputs
    return json.dumps(found, separators=(",", ":"))


def parse_decision(text: str | None) -> Decision | None:
    """Read what `decision_text` wrote; None for nothing."""
    if text is None:
        return None
    found = json.loads(text)
    warp, extrapolate = found.get("outputs", (None, None))
    features = found.get("features")
    return Decision(
        found["node"],
        found["choice"],
        None if features is None else Features(*features),
        tuple(found.get("inputs", ())),
        None if warp is None else (warp, extrapolate),
    )
