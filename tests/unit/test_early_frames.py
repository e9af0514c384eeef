"""Frames that opening an input keeps for the run."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from exwarp_cli.domain.frame import GBuffer, Image, Window
from exwarp_cli.domain.settings import SourceSettings
from exwarp_cli.io.channels import Role
from exwarp_cli.io.frames import RawFrame, read_raw
from exwarp_cli.pipeline import motion_finding as opening
from exwarp_cli.pipeline.early_frames import (
    Beginning,
    EarlyFrames,
    reads_late,
    run_roles,
    serves,
)
from exwarp_cli.pipeline.source import Source, open_source
from exwarp_cli.synthesis.methods import METHODS
from tests.unit.exr_files import write_single
from tests.unit.scenes import town

GEOMETRY_TOLD = (Role.MOTION, Role.DEPTH, Role.STENCIL, Role.POSITION)
COLOUR_TOLD = (Role.MOTION, Role.DEPTH, Role.STENCIL, Role.COLOUR)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Nine frames with positions, at a nearly even speed: 1-2, 5-6 and 8-9 are measured."""
    return write_town(tmp_path_factory.mktemp("town"), 9, 0.25)


@pytest.fixture(scope="module")
def uneven(tmp_path_factory) -> Path:
    """Six frames at an uneven speed: frames 1-2 tell all that there is to measure."""
    return write_town(tmp_path_factory.mktemp("uneven"), 6, 1.5)


def write_town(where: Path, count: int, step: float) -> Path:
    scene = town((96, 60))
    for number in range(1, count + 1):
        view = scene.view(number * step)
        buffer = view.gbuffer(motion=False)
        vectors = view.motion_to(view.time + step, sky=False)
        layers = {
            "forward": vectors * (1, -1),
            "Position": buffer.position,
            "Normal": buffer.normal,
        }
        planes = {c: view.colour[..., i] for i, c in enumerate("RGBA")}
        planes |= {"Z": np.where(np.isinf(view.depth), 1e10, view.depth)}
        for name, layer in layers.items():
            letters = "uv" if name == "forward" else "XYZ"
            planes |= {f"{name}.{c}": layer[..., i] for i, c in enumerate(letters)}
        contiguous = {k: np.ascontiguousarray(v, np.float32) for k, v in planes.items()}
        write_single(where / f"a.{number:04d}.exr", contiguous)
    return where


def opened(folder: Path, frames: str | None = None, method: str = "s6") -> Source:
    return open_source(SourceSettings(str(folder)), run=Beginning(frames, METHODS[method]))


def roles_of(source: Source, method: str = "s6") -> tuple[Role, ...]:
    asked = METHODS[method]
    return run_roles(source.keys, asked, True, reads_late(source.keys, asked))


def assert_same(one: RawFrame, other: RawFrame) -> None:
    assert one.image is not None and other.image is not None
    np.testing.assert_array_equal(one.image.pixels, other.image.pixels)
    np.testing.assert_array_equal(one.motion, other.motion)
    for field in fields(GBuffer):
        a, b = (getattr(raw.gbuffer, field.name) for raw in (one, other))
        assert (a is None) == (b is None), field.name
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize(
    ("method", "normals", "surface"),
    [("s6", False, False), ("exwarp", True, False), ("s1", True, True), ("oracle", True, True)],
)
def test_frames_are_those_that_a_run_would_read(folder, method, normals, surface):
    source = opened(folder, None, method)
    roles = roles_of(source, method)
    for number in (1, 2):
        kept = source.early.take(number, roles)
        assert kept is not None
        assert_same(kept, read_raw(source.keys, number, roles, objects=True))
        assert source.early.take(number, roles) is None
    assert (Role.NORMAL in roles) == normals and (Role.ALBEDO in roles) == surface


def test_what_is_found_does_not_depend_on_what_is_kept(folder):
    assert open_source(SourceSettings(str(folder))).keys.layout.roles.keys() >= {Role.POSITION}
    findings = [opened(folder, frames, m).finding for frames in (None, "6-9") for m in ("s1", "s6")]
    assert {open_source(SourceSettings(str(folder))).finding, *findings} == {findings[0]}


class TestWhichAreRead:
    """Those of the first pair, where it settles the convention; else of all three. Each once."""

    @pytest.fixture
    def read(self, monkeypatch) -> list[tuple[int, tuple[Role, ...]]]:
        read: list[tuple[int, tuple[Role, ...]]] = []

        def reading(shot, number, roles, **more):
            read.append((number, roles))
            return read_raw(shot, number, roles, **more)

        monkeypatch.setattr(opening, "read_raw", reading)
        return read

    def test_a_pair_that_tells_all(self, uneven, read):
        source = opened(uneven, "2,6")
        roles = roles_of(source)
        assert sorted(read) == [(1, roles), (2, roles)]
        assert source.early.take(2, roles) is not None and source.early.take(3, roles) is None
        assert source.finding is not None and "on frames 1-2:" in source.finding.evidence

    def test_a_run_that_begins_elsewhere(self, uneven, read):
        source = opened(uneven, "4,6")
        assert sorted(number for number, _ in read) == [1, 2]
        assert source.early.take(4, roles_of(source)) is None

    def test_a_pair_that_does_not(self, folder, read):
        source = opened(folder, "7,9")
        roles = roles_of(source)
        assert {number for number, asked in read if asked == roles} == {6, 8}
        assert sorted(number for number, _ in read) == [1, 2, 5, 6, 8, 9]
        assert source.early.take(6, roles) is not None and source.early.take(9, roles) is None


def test_other_roles_are_not_handed_out_and_dropped_ones_are_gone(folder):
    source = opened(folder)
    roles = roles_of(source)
    assert source.early.take(1, (*roles, Role.NORMAL)) is None
    source.early.drop()
    assert source.early.take(1, roles) is None


def test_a_range_that_is_wrong_is_said_by_others(folder):
    assert opened(folder, "20-30").early == EarlyFrames()


def test_a_frame_without_good_colour_is_still_measured(folder, tmp_path):
    for path in folder.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    source = opened(tmp_path)
    shot, roles = source.keys, roles_of(source)
    wanting = replace(shot, layout=replace(shot.layout, roles=dict(shot.layout.roles)))
    wanting.layout.roles[Role.COLOUR] = (replace(shot.layout.roles[Role.COLOUR][0], name="gone"),)
    early = EarlyFrames((1, 2), roles)
    assert opening.find_motion(wanting, None, early=early) == source.finding
    assert early.take(1, roles) is None


class TestServes:
    SHOT = SimpleNamespace(ids=None, display=Window(0, 0, 6, 4))

    def frame(self, window: Window = SHOT.display, normal: float | None = None) -> RawFrame:
        shape = window.shape
        normals = None if normal is None else np.full((*shape, 3), normal, np.float32)
        buffer = GBuffer(window, np.ones(shape, np.float32), normals)
        image = Image(np.zeros((*shape, 3), np.float32), window, self.SHOT.display)
        return RawFrame(1, Path("a.exr"), image, buffer, None)

    def test_what_covers_the_display_window(self):
        assert serves(self.frame(), self.SHOT, GEOMETRY_TOLD)

    def test_a_smaller_window_only_where_colour_is_wanted_too(self):
        small = self.frame(Window(1, 1, 3, 2))
        assert not serves(small, self.SHOT, GEOMETRY_TOLD)
        assert serves(small, self.SHOT, COLOUR_TOLD)

    def test_normals_that_mark_background_change_depth(self):
        assert serves(self.frame(normal=0.5), self.SHOT, GEOMETRY_TOLD)
        assert not serves(self.frame(normal=-1), self.SHOT, GEOMETRY_TOLD)
        assert serves(self.frame(normal=-1), self.SHOT, (*GEOMETRY_TOLD, Role.NORMAL))

    @pytest.mark.parametrize("dynamic", [None, object()])
    def test_ids_of_whatever_is_shown_are_not_what_is_measured_by(self, dynamic):
        shot = SimpleNamespace(ids=SimpleNamespace(dynamic=dynamic), display=self.SHOT.display)
        assert serves(self.frame(), shot, GEOMETRY_TOLD) == (dynamic is not None)


@pytest.mark.parametrize(
    ("ids", "late"), [(None, True), (frozenset({3}), True), ("whatever is shown", False)]
)
def test_what_decides_by_a_policy_reads_surfaces_late_where_ids_tell_what_moves(ids, late):
    dynamic = None if ids == "whatever is shown" else ids
    shot = SimpleNamespace(ids=None if ids is None else SimpleNamespace(dynamic=dynamic))
    assert {name for name, method in METHODS.items() if reads_late(shot, method)} == (
        {"exwarp"} if late else set()
    )
