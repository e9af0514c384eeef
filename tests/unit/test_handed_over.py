"""Key frames of which the interval after them gets colour alone."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from exwarp_cli.domain.frame import GBuffer, KeyFrame, Window
from exwarp_cli.domain.settings import SourceSettings, UpsampleSettings
from exwarp_cli.pipeline.bench.opened import EVERYTHING
from exwarp_cli.pipeline.early_frames import Beginning
from exwarp_cli.pipeline.geometry import Staging
from exwarp_cli.pipeline.handed_over import looks_ahead_alone
from exwarp_cli.pipeline.loaded import Loaded
from exwarp_cli.pipeline.loading import IntervalLoader
from exwarp_cli.pipeline.shots import _Leap
from exwarp_cli.pipeline.source import open_source
from exwarp_cli.synthesis.methods import METHODS
from tests.unit.exr_files import write_single
from tests.unit.scenes import town

SIZE = (96, 60)
COUNT = 4


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Key frames with vectors both ways, positions, ids and normals."""
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
        contiguous = {k: np.ascontiguousarray(v, np.float32) for k, v in planes.items()}
        write_single(where / f"a.{number:04d}.exr", contiguous)
    return where


def loader(folder: Path, method: str) -> IntervalLoader:
    settings = SourceSettings(str(folder))
    source = open_source(settings, run=Beginning(None, METHODS[method]))
    asked = UpsampleSettings(settings, str(folder / "out"), method)
    return IntervalLoader(source, METHODS[method], asked, None)


def load(loading: IntervalLoader, key: int) -> Loaded:
    return loading.load(key, lambda *_: True)


def assert_same(one: KeyFrame | None, other: KeyFrame | None) -> None:
    assert one is not None and other is not None
    np.testing.assert_array_equal(one.image.pixels, other.image.pixels)
    for field in fields(GBuffer):
        a, b = (getattr(frame.gbuffer, field.name) for frame in (one, other))
        np.testing.assert_array_equal(a, b, err_msg=field.name)


def test_geometry_that_an_interval_had_is_let_go_and_can_be_read_again(folder):
    in_a_row = loader(folder, "softsplat")
    for key in range(COUNT):
        alone, given = load(loader(folder, "softsplat"), key), load(in_a_row, key)
        assert alone.again is None and alone.frame is not None and given.frame is not None
        assert alone.frame.gbuffer is not None
        if key == 0:
            assert given.again is None
            assert_same(given.frame, alone.frame)
            continue
        assert given.frame.gbuffer is None and given.again is not None
        assert_same(given.again(), alone.frame)
        assert given.lean().again is None


def test_without_looking_ahead_nothing_is_let_go(folder):
    loading = loader(folder, "s6")
    for key in range(COUNT):
        given = load(loading, key)
        assert given.again is None and given.frame is not None
        assert given.frame.gbuffer is not None


@pytest.mark.parametrize("wider", [None, 1, 2])
def test_intervals_are_those_of_whole_frames(folder, wider):
    """Also where a frame has data beyond the display window, on which nothing was settled yet."""
    display = Window(0, 0, *SIZE)

    def placed(loaded: Loaded) -> Loaded:
        def on(frame: KeyFrame | None, key: int) -> KeyFrame | None:
            window = Window(-4, -2, SIZE[0] + 8, SIZE[1] + 4) if key == wider else display
            return None if frame is None else frame.on(window)

        again, key = loaded.again, loaded.key
        if again is not None:
            given = again
            again = lambda: on(given(), key)  # noqa: E731
        frames = on(loaded.frame, key), on(loaded.following, key + 1)
        return replace(loaded, frame=frames[0], following=frames[1], again=again)

    in_a_row, staging = loader(folder, "softsplat"), Staging(display)
    for key in range(COUNT):
        found = staging.interval(placed(load(in_a_row, key)))
        expected = Staging(display).interval(placed(load(loader(folder, "softsplat"), key)))
        assert_same(found.key, expected.key)
        if expected.following is not None:
            assert_same(found.following, expected.following)


def test_nothing_is_read_twice_where_windows_are_alike(folder):
    def fail() -> KeyFrame:
        raise AssertionError("read again")

    in_a_row, staging = loader(folder, "softsplat"), Staging(Window(0, 0, *SIZE))
    for key in range(COUNT):
        given = load(in_a_row, key)
        staging.interval(replace(given, again=fail if given.again else None))


def test_what_was_read_to_find_a_cut_waits_for_its_turn_on_disk(folder, monkeypatch):
    """Where the camera reverses, the vectors of a key frame are compared with a third one."""
    expected = [load(loader(folder, "softsplat"), key).following for key in range(COUNT - 1)]
    monkeypatch.setattr(_Leap, "of", lambda _: _Leap(9.0, 1.0, 1.0))
    in_a_row = loader(folder, "softsplat")
    for key, following in enumerate(expected):
        assert_same(load(in_a_row, key).following, following)
        assert in_a_row.shots._starts[min(key + 2, COUNT - 1)] is False
        assert set(in_a_row._frames) == {key + 1}


def test_only_where_nothing_but_the_next_key_frame_is_wanted():
    """A method of the benchmark looks ahead, extrapolates and asks a policy."""
    assert looks_ahead_alone(METHODS["softsplat"])
    for name in ("s6", "s1", "exwarp", "oracle"):
        assert not looks_ahead_alone(METHODS[name])
    assert not looks_ahead_alone(EVERYTHING)
