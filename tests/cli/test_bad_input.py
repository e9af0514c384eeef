"""Input that cannot be used: one sentence with the file in it, a documented code, whole frames."""

from __future__ import annotations

import shutil
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from exwarp_cli.io.files import TEMPORARY_SUFFIX
from exwarp_cli.io.generated_frames import is_intact
from tests.cli import shots
from tests.cli.street import Street

TINY = Street(16, 9)


@pytest.fixture
def keys(plain_shot, tmp_path) -> Path:
    """A copy of the plain shot to spoil."""
    return Path(shutil.copytree(plain_shot, tmp_path / "keys"))


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def cut_header(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:100])


def flip_a_bit(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0x10
    path.write_bytes(data)


def not_an_image(path: Path) -> None:
    path.write_bytes(b"This is text, whatever the name says.\n" * 50)


def another_format(path: Path) -> None:
    path.write_bytes(b"P6\n16 9\n255\n" + bytes(16 * 9 * 3))


def empty(path: Path) -> None:
    path.write_bytes(b"")


def garbage_after_magic(path: Path) -> None:
    data = path.read_bytes()
    noise = np.random.default_rng(7).integers(0, 256, len(data) - 8, np.uint8).tobytes()
    path.write_bytes(data[:8] + noise)


DAMAGES = (
    truncate,
    cut_header,
    flip_a_bit,
    not_an_image,
    another_format,
    empty,
    garbage_after_magic,
)


def assert_only_whole_frames(folder: Path, keys: Path) -> None:
    """Nothing in the folder is a temporary or half a frame."""
    rendered = set()
    for name in shots.names(keys):
        with suppress(RuntimeError):  # of those that are no EXR
            rendered.add(shots.passed_through(keys / name, 120))
    for name, data in shots.contents(folder).items():
        assert TEMPORARY_SUFFIX not in name
        assert data in rendered or is_intact(data)


class TestDamage:
    @pytest.mark.parametrize("damage", DAMAGES)
    @pytest.mark.parametrize("number", [1, 2])
    def test_upsample(self, keys, exwarp, tmp_path, damage, number):
        before = shots.contents(keys)[f"shot.000{3 - number}.exr"]
        damage(keys / f"shot.000{number}.exr")
        options = ("-m", "softsplat", "--progress", "none")
        result = exwarp("upsample", keys, "-o", tmp_path / "out", *options)
        result.refused(3, f"shot.000{number}.exr", "again")
        assert_only_whole_frames(tmp_path / "out", keys)
        assert shots.contents(keys)[f"shot.000{3 - number}.exr"] == before

    def test_found_when_its_turn_comes_leaves_the_frames_before(self, exwarp, tmp_path):
        """Nine frames, so that the damaged one is not among those that are measured."""
        keys = shots.sequence(tmp_path / "keys", shots.plain, range(1, 10), shots.SMALL)
        truncate(keys / "shot.0007.exr")
        out = tmp_path / "out"
        result = exwarp("upsample", keys, "-o", out, "-m", "s6", "--progress", "none")
        result.refused(3, "shot.0007.exr")
        assert_only_whole_frames(out, keys)
        written = shots.names(out)
        assert {f"shot.{n:04d}.exr" for n in range(1, 21)} <= set(written)
        assert "shot.0025.exr" not in written

    @pytest.mark.parametrize("damage", DAMAGES)
    def test_inspect(self, keys, exwarp, damage):
        damage(keys / "shot.0001.exr")
        exwarp("inspect", keys).refused(3, "shot.0001.exr")

    @pytest.mark.parametrize("damage", DAMAGES)
    def test_compare(self, keys, plain_shot, exwarp, damage):
        damage(keys / "shot.0002.exr")
        exwarp("compare", plain_shot, keys).refused(3, "shot.0002.exr")

    def test_ground_truth(self, keys, exwarp, tmp_path):
        truth = shots.truth(tmp_path / "truth")
        truncate(truth / "shot.0003.exr")
        out = tmp_path / "out"
        options = ("-m", "softsplat", "--ground-truth", truth, "--progress", "none")
        result = exwarp("upsample", keys, "-o", out, *options)
        result.refused(3, "truth/shot.0003.exr")
        assert_only_whole_frames(out, keys)


class TestSequences:
    def refused(self, exwarp, tmp_path, spec, *words, code=3, options=()):
        out = tmp_path / "out"
        exwarp("upsample", spec, "-o", out, "-m", "softsplat", *options).refused(code, *words)
        assert not out.exists()

    def test_a_missing_frame(self, keys, exwarp, tmp_path):
        (keys / "shot.0002.exr").unlink()
        shutil.copy(keys / "shot.0003.exr", keys / "shot.0004.exr")
        self.refused(exwarp, tmp_path, keys, "frame 2 ")

    def test_a_missing_frame_of_one_aov(self, exwarp, tmp_path):
        for i in range(3):
            shots.unreal(tmp_path / "ue", TINY, i, 339 + i)
        (tmp_path / "ue" / "P_WorldNormal.0340.exr").unlink()
        self.refused(exwarp, tmp_path, tmp_path / "ue", "frame 340", "WorldNormal")

    def test_nothing_there(self, exwarp, tmp_path):
        self.refused(exwarp, tmp_path, tmp_path / "gone" / "shot.####.exr", "gone")
        self.refused(exwarp, tmp_path, tmp_path / "gone", "gone")
        (tmp_path / "void").mkdir()
        self.refused(exwarp, tmp_path, tmp_path / "void", "void", "no sequence")

    def test_two_sequences_in_a_folder(self, keys, exwarp, tmp_path):
        shots.colour_only(keys / "other.0001.exr", TINY, 0)
        self.refused(exwarp, tmp_path, keys, "2 sequences", "other.####.exr")

    def test_frames_outside_the_sequence(self, keys, exwarp, tmp_path):
        self.refused(exwarp, tmp_path, keys, "frame 4-9 ", "1-3", options=("--frames", "2-9"))

    def test_a_changing_size(self, keys, exwarp, tmp_path):
        shots.plain(keys / "shot.0003.exr", TINY, 2)
        result = exwarp("upsample", keys, "-o", tmp_path / "out", "-m", "hold")
        result.refused(3, "shot.0003.exr", "16x9", "64x36")
        assert_only_whole_frames(tmp_path / "out", keys)

    @pytest.mark.parametrize("channel", ["G", "Z", "forward.u"])
    def test_a_channel_that_a_later_frame_lacks(self, keys, exwarp, tmp_path, channel):
        planes = shots.plain_planes(Street(), 1)
        del planes[channel]
        shots.write(keys / "shot.0002.exr", {"": planes})
        result = exwarp("upsample", keys, "-o", tmp_path / "out", "-m", "s6")
        result.refused(3, "shot.0002.exr", channel)
        assert_only_whole_frames(tmp_path / "out", keys)

    def test_no_colour_at_all(self, exwarp, tmp_path):
        shots.sequence(tmp_path / "keys", shots.slot_gbuffer)
        self.refused(exwarp, tmp_path, tmp_path / "keys", "no colour", "Vector.X", "channel map")

    def test_ground_truth_of_another_size(self, keys, exwarp, tmp_path):
        truth = shots.truth(tmp_path / "truth", street=TINY)
        options = ("-m", "softsplat", "--ground-truth", truth)
        result = exwarp("upsample", keys, "-o", tmp_path / "out", *options)
        result.refused(3, "--ground-truth", "16x9", "64x36")
        assert not (tmp_path / "out").exists()

    def test_ground_truth_at_the_base_rate(self, keys, exwarp, tmp_path):
        options = ("--ground-truth", keys)
        self.refused(exwarp, tmp_path, keys, "--ground-truth", "4 times", options=options)

    def test_compare_needs_frames_that_belong_together(self, keys, plain_truth, exwarp, tmp_path):
        shots.sequence(tmp_path / "few", shots.colour_only, (20, 21), TINY)
        exwarp("compare", keys, tmp_path / "few").refused(3, "neither by number nor by order")
        exwarp("compare", keys, plain_truth, "--frames", "7").refused(3, "frame 7")


@pytest.fixture(scope="module")
def garbage(tmp_path_factory) -> Path:
    """Vectors that have nothing to do with the picture."""
    chance = np.random.default_rng(3)

    def frame(path: Path, street: Street, time: float) -> None:
        planes = shots.plain_planes(street, time)
        for name in ("forward.u", "forward.v"):
            planes[name] = chance.normal(0, 5, planes[name].shape).astype(np.float32)
        shots.write(path, {"": planes})

    return shots.sequence(tmp_path_factory.mktemp("chance") / "keys", frame, street=shots.SMALL)


class TestMotion:
    def test_vectors_that_explain_nothing(self, exwarp, garbage, tmp_path):
        result = exwarp("upsample", garbage, "-o", tmp_path / "out", "-m", "s6")
        result.refused(4, "motion", "--motion")
        assert not (tmp_path / "out").exists()
        shown = exwarp("inspect", garbage)
        assert shown.code == 0 and "motion unsettled: " in shown.out and shown.err == ""

    def test_methods_without_motion_do_not_mind(self, exwarp, garbage, tmp_path):
        assert exwarp("upsample", garbage, "-o", tmp_path / "out", "-m", "blend").code == 0

    @pytest.mark.parametrize(
        ("given", "word"),
        [
            ("sideways", "sideways"),
            ("next=u", "next=u"),
            ("next=a,b", "u, v"),
            ("forward+backward", "4 motion channels"),
            ("", "empty"),
        ],
    )
    def test_a_convention_that_does_not_parse(self, keys, exwarp, tmp_path, given, word):
        options = ("-m", "softsplat", "--motion", given)
        result = exwarp("upsample", keys, "-o", tmp_path / "out", *options)
        result.refused(2, "--motion", word)
        assert not (tmp_path / "out").exists()


def test_a_rate_that_is_no_number(keys, exwarp, tmp_path):
    """OpenEXR's bindings make a fraction of it."""
    path = keys / "shot.0001.exr"
    data = bytearray(path.read_bytes())
    at = data.index(b"framesPerSecond\0rational\0") + len(b"framesPerSecond\0rational\0") + 4
    data[at : at + 8] = bytes(8)
    path.write_bytes(data)
    exwarp("upsample", keys, "-o", tmp_path / "out", "-m", "hold").refused(3, "shot.0001.exr")
