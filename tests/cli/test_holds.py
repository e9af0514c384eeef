"""Key frames that show the same picture twice: the frames between show it, too."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.blender_layers import layer
from tests.cli import shots
from tests.cli.pictures import clip, codes_of, ffmpeg, frame, psnr, shown, stills
from tests.cli.shots import SMALL, VECTORS, colour_of, contents
from tests.cli.spoiling import truncate
from tests.cli.street import Street
from tests.matrix import combinations

POSES = 3
"""Different pictures; each is shown twice, at key frames 1 and 2, 3 and 4, 5 and 6."""

FIRSTS = (1, 3, 5)
"""Key frames that the next one repeats."""

FAST = Street(64, 36, speed=3.0)
"""Moves so far between two poses that a cross-fade has 22 dB."""

EXTRAPOLATING = ("s3", "causal")
METHODS = ("softsplat", "s6", "s1", "s3", "causal", "blend", "hold")


def on_twos(folder: Path, pose: Callable[[Path, float, bool], None]) -> Path:
    """Write each pose twice; `pose` is called with the file, the time, and whether it is again."""
    for key in range(2 * POSES):
        pose(folder / f"shot.{key + 1:04d}.exr", key // 2, bool(key % 2))
    return folder


def copied(path: Path, time: float, again: bool) -> None:
    """A file that is copied over a missing one: its vectors are those of the picture's first."""
    shots.blender4(path, SMALL, time)


def stepped(ways: str) -> Callable[[Path, float, bool], None]:
    """Write what a renderer does of a scene on twos: vectors are 0 towards the repeated picture.

    `ways` are the directions that are written: "backward", "forward" or both.
    """

    def write(path: Path, time: float, again: bool) -> None:
        passes = shots.blender_passes(FAST, time)
        g = FAST.geometry(time)
        previous = g["previous"] * (not again)
        following = g["following"] * again
        planes = {k: v for group in passes for k, v in group.items() if "Vector" not in k}
        for name, field in (("backward", previous), ("forward", following)):
            if name in ways:
                planes |= layer(name, "uv", field * [1, -1])
        shots.write(path, {"": planes})

    return write


WAYS = ("backward", "forward", "backward forward")


@pytest.fixture(scope="module")
def copies(tmp_path_factory) -> Path:
    """Copied frames; read only."""
    return on_twos(tmp_path_factory.mktemp("copies") / "keys", copied)


@pytest.fixture
def made(upsample, network, tmp_path) -> Callable[..., Path]:
    """Upsample by a method; return the folder."""

    def run(keys: object, method: str, *options: object, name: str = "out") -> Path:
        extra = ("--extrapolator", network) if method in EXTRAPOLATING or method == "s1" else ()
        upsample(keys, tmp_path / name, "-m", method, *extra, *options)
        return tmp_path / name

    return run


def slots(folder: Path, key: int) -> list[np.ndarray]:
    """The key frame's picture, and those of the slots after it."""
    return [colour_of(folder / f"shot.{4 * (key - 1) + 1 + i:04d}.exr") for i in range(4)]


def quality(folder: Path, key: int) -> float:
    """Worst PSNR, dB, of the slots after the second showing of a pose."""
    found = slots(folder, key)
    time = key / 2 - 1
    return min(shots.psnr(FAST.colour(time + i / 4), found[i]) for i in (1, 2, 3))


@pytest.mark.parametrize("method", METHODS)
def test_between_two_showings_of_a_picture_every_method_shows_it(made, copies, method):
    folder = made(copies, method)
    for key in FIRSTS:
        rendered, *between = slots(folder, key)
        assert all(np.array_equal(rendered, new) for new in between)
    if method in ("softsplat", "s6", "causal"):
        rendered, *after = slots(folder, 6)
        assert all(np.array_equal(rendered, new) for new in after), "so does the end of a hold"


def test_copied_frames_move_on_as_their_vectors_say(made, copies):
    """The vectors of a copy are right between it and the next picture: as in the shot on ones."""
    ones = shots.sequence(copies.parent / "ones", shots.blender4, range(1, 4), SMALL)
    for method in ("softsplat", "s6"):
        twos, one = made(copies, method, name=f"{method}2"), made(ones, method, name=f"{method}1")
        for key in (2, 4):
            expected = slots(one, key // 2)
            found = slots(twos, key)
            assert all(np.array_equal(a, b) for a, b in zip(expected, found, strict=True))


@pytest.mark.parametrize("ways", WAYS)
def test_a_scene_on_twos_moves_between_its_poses(made, ways, tmp_path):
    """Both key frames lead to the same place, though one of them stood until then."""
    keys = on_twos(tmp_path / "keys", stepped(ways))
    folder = made(keys, "softsplat")
    assert min(quality(folder, key) for key in (2, 4)) > (26 if " " not in ways else 31)


def test_a_causal_method_leaves_a_hold_along_the_vectors_to_the_next_picture(made, tmp_path):
    keys = on_twos(tmp_path / "keys", stepped("backward forward"))
    folder = made(keys, "s6")
    assert min(quality(folder, key) for key in (2, 4)) > 24.5


def test_the_convention_is_measured_where_the_picture_changes(exwarp, upsample, tmp_path):
    """Copies are no evidence, though the first, the middle and the last pair are some."""
    keys = on_twos(tmp_path / "keys", lambda path, time, again: shots.plain(path, SMALL, time))
    result = upsample(keys, tmp_path / "out", "-m", "s6", "--report", tmp_path / "report")
    motion = json.loads((tmp_path / "report" / "report.json").read_text())["input"]["motion"]
    assert motion["source"] == "calibrated", result.err
    assert "measured on frames 2-3, 4-5" in motion["evidence"]


def test_held_frames_are_said_and_no_new_frames(exwarp, copies, tmp_path):
    report = tmp_path / "report"
    options = ("--progress", "none", "--threads", 1, "-m", "s6", "--report", report)
    result = exwarp("upsample", copies, "-o", tmp_path / "out", *options)
    assert "held after key frames 1-5x2,6, which the next key frame repeats" in result.out
    document = json.loads((report / "report.json").read_text())
    assert document["held"] == [1, 3, 5, 6]
    counts = document["frames"]
    assert (counts["key"], counts["generated"], counts["dropped"]) == (6, 6, 12)
    assert document["fps"]["effective"] == 30 * (1 + 6 / 6)
    assert document["decisions"]["paths"]["S6"] == 2
    assert "held after key frames 1-5x2,6" in (report / "report.html").read_text()


@pytest.mark.parametrize(
    ("method", "cuts"), combinations(["softsplat", "s3", "causal"], ["auto", "none"])
)
def test_any_split_gives_the_same_bytes(made, copies, method, cuts):
    whole = made(copies, method, "--cuts", cuts)
    for chunk in ("5-6", 2, "3-4", 1):
        split = made(copies, method, "--cuts", cuts, "--frames", chunk, name="split")
    assert contents(split) == contents(whole)


def test_any_number_of_threads_gives_the_same_bytes(made, copies):
    one, two = (made(copies, "s6", "--threads", n, name=f"threads{n}") for n in (1, 2))
    assert contents(one) == contents(two)


def test_resuming_makes_again_what_is_no_hold_any_more(made, copies, tmp_path):
    keys = Path(shutil.copytree(copies, tmp_path / "keys"))
    out = made(keys, "s6", *VECTORS)
    _, planes = shots.read(keys / "shot.0004.exr")
    darker = {k: v * np.float16(0.9) if "Combined" in k else v for k, v in planes.items()}
    shots.write(keys / "shot.0004.exr", {"": darker})
    renewed = shots.changed_by(lambda: made(keys, "s6", *VECTORS, "--skip-existing"), out)
    assert shots.generated(3) <= renewed
    assert shots.generated(5) <= renewed, "how light moved before it has changed"
    assert not renewed & shots.generated(1, 6)
    assert contents(out) == contents(made(keys, "s6", *VECTORS, name="anew"))


def test_a_damaged_repeat_is_left_out_and_the_rest_goes_on(exwarp, copies, tmp_path):
    keys = Path(shutil.copytree(copies, tmp_path / "keys"))
    truncate(keys / "shot.0004.exr")
    quiet = ("--progress", "none", "--threads", 1, "-m", "softsplat", "--keep-going")
    result = exwarp("upsample", keys, "-o", tmp_path / "out", *quiet)
    assert result.code == 12
    for key in (1, 5):
        rendered, *between = slots(tmp_path / "out", key)
        assert all(np.array_equal(rendered, new) for new in between)


def test_layers_are_held_with_the_beauty(made, copies):
    folder = made(copies, "softsplat", "--layers", "all")
    key, new = (shots.read(folder / f"shot.{number:04d}.exr")[1] for number in (1, 3))
    assert key.keys() == new.keys()
    for name, plane in key.items():
        if not any(word in name for word in ("Vector", "Normal", "Position")):
            assert np.array_equal(plane, new[name]), name


def test_noise_that_changes_over_a_still_picture_is_no_hold(upsample, tmp_path):
    """Rendered noise is seeded anew: the frames between are a blend, which is less noisy."""
    rng = np.random.default_rng(5)
    still = Street(48, 27, speed=0.0)
    for number in (1, 2):
        planes = {k: v for g in shots.blender_passes(still, 0.0) for k, v in g.items()}
        noisy = planes["Combined.R"] + rng.normal(0, 0.02, planes["Combined.R"].shape)
        planes["Combined.R"] = noisy.astype(np.float16)
        shots.write(tmp_path / "keys" / f"shot.{number:04d}.exr", {"": planes})
    upsample(tmp_path / "keys", tmp_path / "out", "-m", "softsplat", "--no-tail")
    rendered, *between = slots(tmp_path / "out", 1)
    assert not np.array_equal(rendered, between[1])
    assert shots.psnr(still.colour(0.0), between[1]) > shots.psnr(still.colour(0.0), rendered)


@pytest.fixture(params=["lossless", "lossy"])
def codec(request) -> str:
    return str(request.param)


def video(path: Path, drawn: list[np.ndarray], codec: str) -> Path:
    """Write a video; a lossy codec changes what it repeats."""
    made = clip(path, drawn, sound=False)
    if codec == "lossless":
        return made
    coded = ("-c:v", "libx264", "-crf", "23", "-pix_fmt", "yuv420p")
    ffmpeg("-i", made, *coded, path.with_name(f"lossy-{path.name}"))
    return path.with_name(f"lossy-{path.name}")


def slow(time: float) -> np.ndarray:
    """A bright disc that moves by a quarter of a pixel a key frame before a still texture."""
    codes = frame(0.0).astype(float)
    y, x = np.mgrid[: codes.shape[0], : codes.shape[1]]
    disc = np.clip(8.5 - np.hypot(x - 24 - 0.25 * time, y - 24), 0, 1)[..., None]
    return np.round(codes * (1 - disc) + 250 * disc).astype(np.uint8)


def stills_in(folder: Path) -> list[np.ndarray]:
    return [codes_of(path).astype(int) for path in sorted(folder.iterdir())]


class TestClips:
    """Without vectors motion is estimated, and a codec may change what it repeats."""

    DRAWN = tuple(frame(float(pose)) for pose in range(3) for _ in range(3))
    REPEATED = (0, 1, 3, 4, 6, 7)
    """Frames, by index, that the next one repeats."""

    @pytest.mark.parametrize("method", ["softsplat", "s6"])
    def test_between_repeated_pictures_is_the_picture(self, upsample, tmp_path, codec, method):
        source = video(tmp_path / "threes.mp4", list(self.DRAWN), codec)
        upsample(source, tmp_path / "out", "-m", method)
        read, made = shown(source).astype(int), stills_in(tmp_path / "out")
        for key in self.REPEATED:
            noise = np.abs(read[key + 1] - read[key]).max()
            off = max(np.abs(made[4 * key + i] - made[4 * key]).max() for i in (1, 2, 3))
            assert off <= (0 if codec == "lossless" else noise + 2)

    def test_between_pictures_both_key_frames_lead_to_one_place(self, upsample, tmp_path, codec):
        """By what stands on the far side, one would start slowly, and the other end slowly."""
        source = video(tmp_path / "threes.mp4", list(self.DRAWN), codec)
        upsample(source, tmp_path / "out", "-m", "softsplat")
        made = stills_in(tmp_path / "out")
        for key, start in ((2, 0.0), (5, 1.0)):
            found = [psnr(frame(start + i / 4), made[4 * key + i]) for i in (1, 2, 3)]
            assert min(found) > 33

    def test_a_slow_mover_before_a_still_background_is_no_hold(self, upsample, tmp_path, codec):
        source = video(tmp_path / "slow.mp4", [slow(float(i)) for i in range(5)], codec)
        upsample(source, tmp_path / "out", "-m", "softsplat", "--report", tmp_path / "report")
        document = json.loads((tmp_path / "report" / "report.json").read_text())
        assert document["held"] == []

    def test_stills_on_twos(self, upsample, tmp_path):
        drawn = [frame(float(pose)) for pose in range(2) for _ in range(2)]
        upsample(stills(tmp_path / "keys", drawn), tmp_path / "out", "-m", "softsplat")
        made = stills_in(tmp_path / "out")
        assert all(np.array_equal(made[0], new) for new in made[1:5])
        assert min(psnr(frame(i / 4), made[4 + i]) for i in (1, 2, 3)) > 33
