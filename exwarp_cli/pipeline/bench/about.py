"""What a subject is, as far as its files tell."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from exwarp_cli.domain.timeline import Slot
from exwarp_cli.io.channels import Role
from exwarp_cli.io.exr.reader import read_headers
from exwarp_cli.io.exr.template import render_seconds
from exwarp_cli.pipeline.announcing import other_extrapolator
from exwarp_cli.pipeline.bench.opened import Opened
from exwarp_cli.pipeline.scoring import SLOTS


def about_subject(opened: Opened) -> dict[str, Any]:
    """Say what the subject is."""
    source = opened.source
    display = source.keys.display
    return {
        "width": display.width,
        "height": display.height,
        "fps": float(source.fps),
        "producer": (source.slots or source.keys).layout.producer,
        "policy": {
            "file": opened.policy.path.name,
            "sha256": opened.policy.checksum,
            "trained_without_it": opened.subject.unseen,
            "note": _policy_note(opened),
        },
        "render_s": _render_times(opened),
    }


def _policy_note(opened: Opened) -> str | None:
    """Say that the policy was trained for another network than the one that extrapolates."""
    network = opened.networks.own
    return None if network is None else other_extrapolator(opened.policy, network)


def _render_times(opened: Opened) -> dict[str, float | None]:
    """Mean render times that the headers tell, in seconds: of key frames, and of slot G-buffers.

    The latter only where those files hold nothing else: with colour in them, their time is that of
    the whole frame.
    """
    source = opened.source
    numbers = [opened.number(key) for key in opened.keys]
    found: dict[str, float | None] = {
        "key": _mean_time([source.keys.sequence.files[number] for number in numbers]),
        "gbuffer": None,
    }
    if source.slots is not None and Role.COLOUR not in source.slots.layout:
        files = source.slots.sequence.files
        wanted = [source.slot_number(Slot(key, i)) for key in opened.keys for i in SLOTS]
        found["gbuffer"] = _mean_time([files[n] for n in wanted if n is not None])
    return found


def _mean_time(paths: Sequence[Path]) -> float | None:
    known = [found[0] for path in paths if (found := render_seconds(read_headers(path)))]
    return sum(known) / len(known) if known else None
