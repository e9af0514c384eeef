"""Key frames of a sequence, read on demand and remembered from interval to interval."""

from __future__ import annotations

import functools
from collections import Counter
from dataclasses import fields, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from exwarp_cli.domain.frame import GBuffer, KeyFrame, Window
from exwarp_cli.domain.settings import SourceSettings, UpsampleSettings
from exwarp_cli.io.channels import Role
from exwarp_cli.io.frames import SURFACE
from exwarp_cli.pipeline import key_frames, shots
from exwarp_cli.pipeline.interval_builder import IntervalBuilder
from exwarp_cli.pipeline.interval_inputs import IntervalInputs, IntervalReader
from exwarp_cli.pipeline.key_frames import reads_late
from exwarp_cli.pipeline.source import Source, open_source
from exwarp_cli.research.bench.subjects import EVERYTHING
from exwarp_cli.synthesis.methods import METHODS
from tests.matrix import spread
from tests.unit.exr_files import write_single
from tests.unit.filled import Filled
from tests.unit.scenes import town

SIZE = (96, 60)
COUNT = 4
Read = list[tuple[int, tuple[Role, ...]]]


pytestmark = pytest.mark.usefixtures("loose_objects")


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Key frames with vectors both ways, positions, ids, normals and a surface."""
    where = tmp_path_factory.mktemp("town")
    for number in range(1, COUNT + 1):
        frame = town(SIZE).view(number / 4).key(number)
        buffer = town(SIZE).view(number / 4).gbuffer(step=0.25)
        planes = {c: frame.image.pixels[..., i] for i, c in enumerate("RGBA")}
        planes |= {"Z": np.where(np.isinf(buffer.depth), 1e10, buffer.depth)}
        planes |= {"IndexOB.X": buffer.stencil}
        for name, layer in (("Position", buffer.position), ("Normal", buffer.normal)):
            planes |= {f"{name}.{c}": layer[..., i] for i, c in enumerate("XYZ")}
        vectors = np.concatenate([buffer.to_previous * (1, -1), buffer.to_next * (-1, 1)], -1)
        planes |= {f"Vector.{c}": vectors[..., i] for i, c in enumerate("XYZW")}
        planes |= {f"Albedo.{c}": np.full(SIZE[::-1], number / 8) for c in "RGB"}
        contiguous = {k: np.ascontiguousarray(v, np.float32) for k, v in planes.items()}
        write_single(where / f"a.{number:04d}.exr", contiguous)
    return where


@pytest.fixture
def read(monkeypatch) -> Read:
    """What is read of which frame, by its number."""
    read: Read = []
    true = key_frames.read_raw

    def read_raw(shot: Any, number: int, roles: tuple[Role, ...], **more: Any) -> Any:
        read.append((number, roles))
        return true(shot, number, roles, **more)

    monkeypatch.setattr(key_frames, "read_raw", read_raw)
    return read


@functools.cache
def source(settings: SourceSettings) -> Source:
    return open_source(settings)


def reader(folder: Path, method: str) -> IntervalReader:
    settings = SourceSettings(str(folder), motion="previous=X,-Y next=-Z,W")
    asked = UpsampleSettings(settings, str(folder / "out"), method, gate=False)
    return IntervalReader(source(settings), METHODS[method], asked)


def assert_same(a: KeyFrame | None, b: KeyFrame | None) -> None:
    assert a is not None and b is not None
    np.testing.assert_array_equal(a.image.pixels, b.image.pixels)
    for field in fields(GBuffer):
        x, y = (getattr(frame.gbuffer, field.name) for frame in (a, b))
        np.testing.assert_array_equal(x, y, err_msg=field.name)


@pytest.mark.parametrize("method", ["s6", "softsplat", "s3"])
def test_an_interval_is_the_same_after_others_as_alone(folder, method):
    in_a_row = reader(folder, method)
    for key in range(COUNT):
        alone, after = reader(folder, method).read(key), in_a_row.read(key)
        assert_same(after.frame, alone.frame)
        if alone.following is not None:
            assert_same(after.following, alone.following)
        for a, b in zip(after.history, alone.history, strict=True):
            assert_same(a.frame, b.frame)


@pytest.mark.parametrize("method", ["hold", "s6", "softsplat", "s3", "causal"])
def test_each_key_frame_is_read_once(folder, read, method):
    in_a_row = reader(folder, method)
    for key in range(COUNT):
        in_a_row.read(key)
    assert Counter(number for number, _ in read) == Counter(range(1, COUNT + 1))


@pytest.mark.parametrize(
    ("method", "normals", "surface"),
    [("s6", False, False), ("causal", True, False), ("s1", True, True), ("oracle", True, True)],
)
def test_a_method_reads_the_passes_that_it_uses(folder, read, method, normals, surface):
    reader(folder, method).read(0)
    assert {(Role.NORMAL in roles, Role.ALBEDO in roles) for _, roles in read} == {
        (normals, surface)
    }


class TestHistory:
    """What only extrapolation needs is read once the path calls for it, where a policy decides."""

    def read_eagerly(self, folder: Path, key: int) -> IntervalInputs:
        return reader(folder, "s3").read(key)

    @pytest.mark.parametrize("keys", spread([(2,), (0, 1, 2), (1, 2, 3)], 2))
    def test_it_is_what_is_read_with_the_interval_otherwise(self, folder, keys):
        late = reader(folder, "causal")
        for key in keys:
            inputs = late.read(key)
            assert inputs.lacks_history and len(inputs.history) == min(key, 1)
            complete, expected = late.add_history(inputs), self.read_eagerly(folder, key)
            assert not complete.lacks_history
            assert_same(complete.frame, expected.frame)
            assert len(complete.history) == len(expected.history) == min(key, 2)
            for a, b in zip(complete.history, expected.history, strict=True):
                assert_same(a.frame, b.frame)

    def test_the_surface_alone_is_read_of_the_key_frame(self, folder, read):
        late = reader(folder, "causal")
        for key in range(3):
            inputs = late.read(key)
        read.clear()
        late.add_history(inputs)
        assert [roles for number, roles in read if number == 3] == [SURFACE]
        assert [number for number, _ in read] == [3, 2, 1]

    def test_what_an_interval_had_read_is_not_read_again(self, folder, read):
        late = reader(folder, "causal")
        for key in range(COUNT):
            inputs = late.read(key)
            read.clear()
            late.add_history(inputs)
            assert read == [(key + 1, SURFACE)]

    def test_the_next_interval_may_be_read_before(self, folder):
        late = reader(folder, "causal")
        inputs = [late.read(key) for key in range(COUNT)]
        for key in (1, 2):
            expected = self.read_eagerly(folder, key)
            assert_same(late.add_history(inputs[key]).frame, expected.frame)


@pytest.mark.parametrize("wider", spread([None, 1, 2], 2))
def test_intervals_in_a_row_are_built_as_alone(folder, wider):
    """Also where a frame has data beyond the display window, on which nothing was settled yet."""
    display = Window(0, 0, *SIZE)

    def placed(inputs: IntervalInputs) -> IntervalInputs:
        def on(frame: KeyFrame | None, key: int) -> KeyFrame | None:
            window = Window(-4, -2, SIZE[0] + 8, SIZE[1] + 4) if key == wider else display
            return None if frame is None else frame.on(window)

        frame, following = on(inputs.frame, inputs.key), on(inputs.following, inputs.key + 1)
        return replace(inputs, frame=frame, following=following)

    in_a_row, builder = reader(folder, "softsplat"), IntervalBuilder(display)
    for key in range(COUNT):
        built = builder.build(placed(in_a_row.read(key)))
        expected = IntervalBuilder(display).build(placed(reader(folder, "softsplat").read(key)))
        assert_same(built.key, expected.key)
        if expected.following is not None:
            assert_same(built.following, expected.following)


def test_what_was_read_to_find_a_cut_waits_for_its_turn_on_disk(folder, read, monkeypatch):
    """Where the camera reverses, the vectors of a key frame are compared with a third frame."""
    expected = [reader(folder, "softsplat").read(key).following for key in range(COUNT - 1)]
    monkeypatch.setattr(shots, "measure_leap", lambda _: (9.0, 1.0, 1.0))
    in_a_row = reader(folder, "softsplat")
    for key, following in enumerate(expected):
        read.clear()
        assert_same(in_a_row.read(key).following, following)
        assert max(number for number, _ in read) == min(key + 3, COUNT)


@pytest.mark.parametrize(
    ("ids", "late"), [(None, True), (frozenset({3}), True), ("whatever is shown", False)]
)
def test_a_policy_s_history_is_read_late_where_ids_tell_what_moves(ids, late):
    dynamic = None if ids == "whatever is shown" else ids
    shot = SimpleNamespace(ids=None if ids is None else SimpleNamespace(dynamic=dynamic))
    methods = [*METHODS.values(), EVERYTHING]
    assert {method.name for method in methods if reads_late(shot, method)} == (
        {"causal"} if late else set()
    )


def test_geometry_goes_once_an_interval_is_built(folder):
    inputs = reader(folder, "s3").read(2)
    IntervalBuilder(Window(0, 0, *SIZE), Filled()).build(inputs)
    lean = inputs.without_geometry()
    assert lean.frame is not None and lean.frame.gbuffer is None
    assert [past.frame.gbuffer for past in lean.history] == [None, None]
    np.testing.assert_array_equal(lean.frame.image.pixels, inputs.frame.image.pixels)
