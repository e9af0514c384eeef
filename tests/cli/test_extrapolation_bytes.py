"""Extrapolated frames are the same bytes however they are made; what is made anew, and when."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path
from unittest.mock import Mock

import pytest

from exwarp_cli.pipeline import job
from tests.blender_layers import Planes
from tests.cli import shots
from tests.cli.conftest import run_quietly
from tests.cli.shots import FORWARD, KEYS, SMALL, VECTORS, changed_by, generated
from tests.cli.street import Street
from tests.matrix import combinations
from tests.unit.tiny_models import convolution, save

SETTINGS = ("key", "slot")


def cut(planes_of: Callable[[Street, float], Planes]) -> shots.FrameWriter:
    """A writer of frames whose data windows change from one to the next."""

    def frame(path: Path, street: Street, time: float) -> None:
        x, y = int(2 * time) % 5, int(time) % 3
        planes = {name: v[y:25, x:44].copy() for name, v in planes_of(street, time).items()}
        place = shots.window(x - 4, y - 2, 44 - x, 25 - y)
        head = shots.header(dataWindow=place, displayWindow=shots.window(0, 0, 36, 20))
        shots.write(path, {"": planes}, head)

    return frame


@pytest.fixture(scope="module")
def wholes(tmp_path_factory, shot, network) -> Callable[[str, str], Path]:
    """Return the frames of a method on the shot, by setting, beside masks; each made once."""
    root = tmp_path_factory.mktemp("wholes")

    def find(method: str, setting: str) -> Path:
        out = root / f"{method}-{setting}" / "frames"
        if not out.exists():
            keys, *rest = shot[setting]
            options = (
                "-m",
                method,
                "--extrapolator",
                network,
                "--write-holes",
                out.parent / "masks",
            )
            run_quietly("upsample", keys, "-o", out, *rest, *options)
        return out

    return find


@pytest.fixture
def copied(wholes, tmp_path) -> Callable[[str, str], Path]:
    """Copy such frames to where `make("out", …)` writes."""
    return lambda *names: Path(shutil.copytree(wholes(*names), tmp_path / "out"))


class TestSameBytes:
    @pytest.mark.parametrize("setting", SETTINGS)
    def test_any_split_gives_the_whole(self, make, wholes, tmp_path, setting):
        whole = wholes("s3", setting)
        for chunk in ("4-5", "1", "2-3"):
            options = ("--write-holes", tmp_path / "masks", "--frames", chunk)
            parts = make("parts", "s3", *options, setting=setting)
        assert len(shots.names(whole)) == 4 * KEYS
        assert shots.contents(parts) == shots.contents(whole)
        assert shots.contents(tmp_path / "masks") == shots.contents(whole.parent / "masks")

    @pytest.mark.parametrize("setting", SETTINGS)
    def test_windows_that_change_too(self, make, tmp_path, setting):
        numbers = range(1, KEYS + 1)
        if setting == "key":
            keys = shots.sequence(tmp_path / "keys", cut(shots.plain_planes), numbers, SMALL)
            given = (keys, *FORWARD)
        else:
            keys = shots.sequence(tmp_path / "keys", cut(shots.colour_planes), numbers, SMALL)
            slots = shots.sequence(
                tmp_path / "slots", cut(shots.slot_planes), range(1, 4 * KEYS - 2), SMALL, 0.25
            )
            given = (keys, "--gbuffers", slots, *VECTORS)
        whole = make("whole", "s3", shot=given)
        part = make("part", "s3", "--frames", "4,2", shot=given)
        shots.require_part(part, whole, 8)
        places = {str(shots.read(path)[0]["dataWindow"]) for path in whole.iterdir()}
        assert len(places) > 3

    @pytest.mark.parametrize("channels", [18, 24])
    def test_threads_change_nothing(self, make, tmp_path, channels):
        network = save(tmp_path / "n.onnx", convolution(channels, scale=2, exwarp__stride="2"))
        how = ("s3", "--frames", "2-3", "--threads")
        made = [make(str(n), *how, n, network=network) for n in (1, 2, 5)]
        assert shots.contents(made[0]) == shots.contents(made[1]) == shots.contents(made[2])

    @pytest.mark.parametrize(("method", "setting"), combinations(("s3", "causal"), SETTINGS))
    def test_where_frames_lie_changes_nothing(self, make, wholes, monkeypatch, method, setting):
        """Large ones lie in scratch files; here these small ones do."""
        usual = wholes(method, setting)
        monkeypatch.setattr(job, "LARGE_PIXELS", 0)
        filed = Mock(wraps=os.posix_fallocate)
        monkeypatch.setattr(os, "posix_fallocate", filed)
        assert shots.contents(make("stored", method, setting=setting)) == shots.contents(usual)
        assert filed.called

    @pytest.mark.parametrize(("method", "setting"), combinations(("s1", "s2", "s3"), SETTINGS))
    def test_an_interrupted_run_goes_on(self, make, wholes, copied, method, setting):
        whole = shots.contents(wholes(method, setting))
        out = copied(method, setting)
        for number in (3, 8, 9, 12, 14, 15, 16):
            (out / f"shot.{number:04d}.exr").unlink()
        (out / "shot.0010.exr").write_bytes(whole["shot.0010.exr"][:900])

        def resume() -> None:
            make("out", method, "--skip-existing", setting=setting)

        assert changed_by(resume, out) == {3, 8, 9, 10, 12, 14, 15, 16}
        assert shots.contents(out) == whole
        assert changed_by(resume, out) == set()

    def test_another_network_counts(self, make, copied, tmp_path):
        out = copied("s3", "key")
        other = save(tmp_path / "other.onnx", convolution(seed=1))
        again = changed_by(lambda: make("out", "s3", "--skip-existing", network=other), out)
        assert again == generated(1, 2, 3, 4, 5)
        fresh = make("fresh", "s3", "--frames", "2", network=other)
        shots.require_part(fresh, out, 4)

    def test_the_same_network_under_another_name_does_not(self, make, network, copied, tmp_path):
        out = copied("s3", "key")
        copy = Path(shutil.copy(network, tmp_path / "copy.onnx"))
        assert changed_by(lambda: make("out", "s3", "--skip-existing", network=copy), out) == set()

    def test_a_changed_key_frame_counts_where_it_is_history(self, make, copied, shot, tmp_path):
        keys, *rest = shot["key"]
        keys = Path(shutil.copytree(keys, tmp_path / "keys"))
        out = copied("s3", "key")
        shots.plain(keys / "shot.0002.exr", SMALL, 1.1)
        again = changed_by(lambda: make("out", "s3", "--skip-existing", shot=(keys, *rest)), out)
        assert again == {5} | generated(2, 3, 4)

    def test_so_does_a_g_buffer_on_the_way_to_it(self, make, copied, shot, tmp_path):
        colour, option, slots, *rest = shot["slot"]
        slots = Path(shutil.copytree(slots, tmp_path / "slots"))
        given = (colour, option, slots, *rest)
        out = copied("s3", "slot")
        shots.slot_gbuffer(slots / "shot.0006.exr", SMALL, 1.3)  # slot 1 of key frame 2
        again = changed_by(lambda: make("out", "s3", "--skip-existing", shot=given), out)
        assert again == generated(2, 3, 4)
