"""Changing what is read of EXR files, as if they had been written so."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from exwarp_cli.io import frames
from exwarp_cli.io.channels import Role
from exwarp_cli.io.shot import Shot

Change = Callable[[Shot, int, Role, np.ndarray], np.ndarray]
"""Called with the shot, the frame's number, the role and its planes [H, W, C]; returns others."""


def changed_planes(monkeypatch, change: Change) -> None:
    """Let every frame be read through `change`, before anything cleans what was read."""
    true = frames.read_planes

    def read_planes(shot, number, *groups):
        planes = true(shot, number, *groups)
        for role, group in shot.layout.roles.items():
            if all(ref in planes for ref in group):
                given = np.stack([planes[ref].values for ref in group], axis=-1)
                made = change(shot, number, role, given)
                for index, ref in enumerate(group):
                    values = np.ascontiguousarray(made[..., index])
                    planes[ref] = replace(planes[ref], values=values)
        return planes

    monkeypatch.setattr(frames, "read_planes", read_planes)
