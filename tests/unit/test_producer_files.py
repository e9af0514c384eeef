"""Every producer's frames: roles and producer by name, the convention by measuring."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest

from exwarp_cli.domain.frame import GBuffer
from exwarp_cli.domain.motion import MotionFinding
from exwarp_cli.io.channels import Layout, Role, detect_layout
from exwarp_cli.io.exr.header import Channel
from exwarp_cli.io.frames import clean_depth, clean_stencil
from exwarp_cli.synthesis.calibration import calibrate
from exwarp_cli.synthesis.calibration_samples import MotionFrame
from tests.matrix import combinations, spread
from tests.unit.motion_pairs import pairs_of
from tests.unit.producer_files import PRODUCERS, Files, Passes, rounded
from tests.unit.scenes import View, town

SIZE = (96, 60)
FLIPPED = np.array([1.0, -1.0])

# What the names say is only roughly so: the unit or the direction is the artist's choice.
CHOSEN_BY_ARTISTS = {
    "movie render queue, two screens",
    "arnold, mapped direction",
    "arnold, max displace",
    "arnold, max displace about the middle",
    "v-ray, clamped",
    "reelsmart",
}


@functools.cache
def views() -> tuple[View, View]:
    scene = town(SIZE)
    return scene.view(0.0), scene.view(1.0)


def passes(view: View) -> Passes:
    g = view.gbuffer()
    return Passes(
        view.colour.astype(np.float64), g.depth, g.normal, g.position, g.stencil,
        g.to_previous.astype(np.float64), g.to_next.astype(np.float64),
    )  # fmt: skip


def layout_of(files: Files) -> Layout:
    return detect_layout(
        {
            aov: [Channel(0, i, name, name, "float") for i, name in enumerate(planes)]
            for aov, planes in files.items()
        }
    )


def instant(files: Files, layout: Layout, number: int) -> MotionFrame:
    """The frame as reading it gives it."""

    def stack(role: Role) -> np.ndarray | None:
        if role not in layout:
            return None
        return np.stack([files[r.aov][r.name] for r in layout.roles[role]], -1).astype(np.float32)

    depth, normal, stencil = stack(Role.DEPTH), stack(Role.NORMAL), stack(Role.STENCIL)
    gbuffer = GBuffer(
        views()[0].scene.window,
        None if depth is None else clean_depth(depth[..., 0], normal),
        normal,
        stack(Role.POSITION),
        None if stencil is None else clean_stencil(stencil[..., 0]),
    )
    motion = stack(Role.MOTION)
    assert motion is not None
    return MotionFrame(number, gbuffer, motion, stack(Role.COLOUR))


def found_in(
    producer: str, half: bool = False, mirror: np.ndarray | float = 1.0
) -> tuple[MotionFinding, list[MotionFrame]]:
    """Write two frames, their vectors mirrored, read and measure them."""
    frames, layout = [], None
    for number, view in enumerate(views()):
        true = passes(view)
        seen = replace(true, previous=true.previous * mirror, following=true.following * mirror)
        files = PRODUCERS[producer].write(seen)
        files = rounded(files) if half else files
        layout = layout_of(files)
        frames.append(instant(files, layout, number))
    assert layout is not None
    names = tuple(ref.name for ref in layout.roles[Role.MOTION])
    guess = None if layout.guess is None else layout.guess.sized(*SIZE)
    return calibrate(pairs_of(frames[:2]), guess, names), frames


def worst(finding: MotionFinding, frames: list[MotionFrame]) -> float:
    """Pixels by which vectors miss the truth on surfaces, at the 99th percentile."""
    errors = []
    for view, frame in zip(views(), frames, strict=True):
        true, solid = passes(view), view.surface >= 0
        for axes, truth in (
            (finding.convention.to_previous, true.previous),
            (finding.convention.to_next, true.following),
        ):
            if axes is not None:
                errors.append(np.linalg.norm(axes.apply(frame.motion) - truth, axis=-1)[solid])
    return float(np.percentile(np.concatenate(errors), 99))


@pytest.mark.parametrize("producer", PRODUCERS)
def test_names_tell_it_and_its_passes(producer):
    layout = layout_of(PRODUCERS[producer].write(passes(views()[0])))
    assert layout.producer == PRODUCERS[producer].name
    assert layout.guess is not None
    taken = [ref.name.lower() for refs in layout.roles.values() for ref in refs]
    assert not any("crypto" in name or "hitproxy" in name for name in taken)
    assert {Role.COLOUR, Role.MOTION} <= set(layout.roles)
    assert len(layout.roles[Role.COLOUR]) == 4
    assert layout.incomplete == {}


@pytest.mark.parametrize(("producer", "half"), combinations(list(PRODUCERS), [False, True]))
def test_its_vectors_are_read_rightly(producer, half):
    finding, frames = found_in(producer, half)
    expected = PRODUCERS[producer]
    assert (finding.convention.to_previous is not None) == expected.previous
    assert (finding.convention.to_next is not None) == expected.following
    # A half about 0.5 has steps of 1 / 2048: a tenth of a pixel over two screens.
    assert worst(finding, frames) < 0.1
    measured = "corrected" if producer in CHOSEN_BY_ARTISTS else "calibrated"
    assert finding.source == measured


@pytest.mark.parametrize("producer", spread(PRODUCERS, 7))
def test_a_wrong_sign_is_corrected(producer):
    finding, frames = found_in(producer, mirror=FLIPPED)
    assert finding.source == "corrected"
    assert worst(finding, frames) < 0.1


PASSES = {
    "arnold, raw": (["Z"], ["N.X", "N.Y", "N.Z"], ["P.X", "P.Y", "P.Z"], ["ID"]),
    "v-ray": (["zdepth.R"], ["normals.X", "normals.Y", "normals.Z"], [], ["renderId.R"]),
    "redshift": (
        ["Depth.R"], ["N.R", "N.G", "N.B"],
        ["WorldPosition.R", "WorldPosition.G", "WorldPosition.B"], ["ObjectID.R"],
    ),
    "renderman": (
        ["z"], ["__Nworld.R", "__Nworld.G", "__Nworld.B"],
        ["__Pworld.R", "__Pworld.G", "__Pworld.B"], ["id"],
    ),
    "karma": (
        ["ray:hitPz"], ["ray:hitN.X", "ray:hitN.Y", "ray:hitN.Z"],
        ["ray:hitP.X", "ray:hitP.Y", "ray:hitP.Z"], ["ray:objectid"],
    ),
    "moonray": (["Z"], [], ["WP.X", "WP.Y", "WP.Z"], []),
    "movie render queue": (
        ["FinalImageMovieRenderQueue_WorldDepth.R"],
        [f"FinalImageMovieRenderQueue_WorldNormal.{c}" for c in "RGB"], [], [],
    ),
    "nuke, prefix": (["hero_depth.Z"], [], [], []),
}  # fmt: skip


@pytest.mark.parametrize("producer", PASSES)
def test_geometry_is_found_by_the_producer_s_names(producer):
    layout = layout_of(PRODUCERS[producer].write(passes(views()[0])))
    roles = (Role.DEPTH, Role.NORMAL, Role.POSITION, Role.STENCIL)
    found = tuple([ref.name for ref in layout.roles.get(role, ())] for role in roles)
    assert found == PASSES[producer]
