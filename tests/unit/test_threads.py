"""What --threads says reaches every library, and every thread that starts kernels."""

from __future__ import annotations

from types import SimpleNamespace

import OpenImageIO as oiio
import pytest

from exwarp_cli.io import ffmpeg
from exwarp_cli.kernels import _row_bands
from exwarp_cli.models import picture_network
from exwarp_cli.pipeline import scheduling
from exwarp_cli.pipeline.scheduling import AsyncWriter, prefetch, use_threads
from exwarp_cli.runtime import cores
from exwarp_cli.runtime.machine import Processors


@pytest.fixture(autouse=True)
def four_cores(monkeypatch):
    """A machine of eight cores, of which this process may use four."""
    monkeypatch.setattr(scheduling, "processors", lambda: Processors(8, 4, None))
    yield
    monkeypatch.undo()
    use_threads(None)


def _oiio(name: str) -> int:
    return int(oiio.get_int_attribute(name))


@pytest.mark.parametrize(("asked", "count"), [(1, 1), (3, 3), (None, 4)])
def test_decoders_and_ffmpeg(asked, count):
    use_threads(asked)
    assert cores.count() == count
    assert _oiio("threads") == _oiio("exr_threads") == count
    command = ffmpeg._command(["-i", "a.mp4"])
    for option in ("-filter_threads", "-filter_complex_threads", "-threads"):
        assert command[command.index(option) + 1] == str(count)
    assert command[-2:] == ["-i", "a.mp4"]


@pytest.mark.parametrize(("given", "count"), [(None, 3), (1, 1)])
def test_networks_have_as_many_by_default(monkeypatch, given, count):
    use_threads(3)
    opened = SimpleNamespace()
    counts: list[int] = []

    def network(_path: object, _data: bytes, most: int, _device: str) -> SimpleNamespace:
        counts.append(most)
        return opened

    monkeypatch.setattr(picture_network, "OnnxExtrapolator", network)
    assert picture_network.load_extrapolator(None, given, "cpu") is opened
    assert counts == [count]


def test_kernels_of_readers_and_writers_have_no_more_than_those_of_the_caller():
    use_threads(1)
    found = list(prefetch([_row_bands.threads, _row_bands.threads], 1))
    with AsyncWriter(2, 4) as behind:
        for _ in range(4):
            behind.submit(lambda: found.append(_row_bands.threads()))
    assert found == [1] * 6
