"""Frames and decisions are the same however a run is cut, interrupted or threaded."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exwarp_cli.io.channels import Role
from exwarp_cli.pipeline import key_frames, motion_convention
from tests.cli import shots
from tests.cli.decisions.conftest import KEYS, SETTINGS, STREET, Done, take, write_shots
from tests.cli.decisions.windows import parted
from tests.cli.shots import changed_by, generated, read, reads_of
from tests.matrix import combinations, spread
from tests.reference.decisions import PATHS

HEADS = (
    *("exwarp:method", "exwarp:requestedMethod", "exwarp:recipe", "exwarp:xxh128"),
    "exwarp:decision",
)
"""What a policy's frames have in their headers otherwise than those of a fixed path."""


@pytest.fixture
def make(upsample, uneven, network, policies, tmp_path) -> Callable[..., Path]:
    """Run a policy by its name into a folder of the test; return the folder."""

    def run(folder: str, *options: object, setting: str = "key", **more: Any) -> Path:
        keys, *rest = more.get("shot", uneven[setting])
        policy = more.get("policy", "watching")
        policy = policy if isinstance(policy, Path) else policies(policy)
        model = ("--causal", "--no-gate", "--extrapolator", network, "--policy", policy)
        upsample(keys, tmp_path / folder, *rest, *model, *options)
        return tmp_path / folder

    return run


def same_frames(one: Path, other: Path) -> None:
    """Judge pixels bit for bit, and headers but for what names method and decision."""
    assert len(shots.names(one)) == 8
    for name in shots.names(one):
        (head, planes), (head2, planes2) = read(one / name), read(other / name)
        assert planes.keys() == planes2.keys()
        assert all(planes[k].tobytes() == planes2[k].tobytes() for k in planes), name
        assert {k: str(v) for k, v in head.items() if k not in HEADS} == {
            k: str(v) for k, v in head2.items() if k not in HEADS
        }


class TestPaths:
    @pytest.mark.parametrize("path", PATHS)
    def test_a_policy_that_always_takes_a_path_makes_its_frames(self, make, judged, path):
        out = make("out", "--frames", "2-3", policy=path)
        assert {read(file)[0].get("exwarp:path", path) for file in out.iterdir()} == {path}
        same_frames(out, judged(path.lower()).out)

    @pytest.mark.parametrize(("choice", "path"), [("warp", "s6"), ("extrapolate", "s1")])
    def test_in_the_slot_setting_too(self, make, judged, choice, path):
        out = make("out", "--frames", "2-3", setting="slot", policy=choice)
        same_frames(out, judged(path, "slot").out)

    def test_a_path_may_change_from_interval_to_interval(self, judged):
        done = judged("watching")
        for k, path in enumerate(done.paths):
            alone = judged(path.lower()).out
            for i in range(4 * k + 1, 4 * k + 5):
                name = f"shot.{i:04d}.exr"
                expected = shots.colour_of(alone / name)
                np.testing.assert_array_equal(shots.colour_of(done.out / name), expected)


class TestChunks:
    @pytest.mark.parametrize("setting", SETTINGS)
    def test_any_split_and_any_threads_give_the_whole(self, make, judged, setting):
        for chunk, threads in (("4", 1), ("1-5x2", 3), ("6,2", 2)):
            parts = make("parts", "--frames", chunk, "--threads", threads, setting=setting)
        assert shots.contents(parts) == judged("watching", setting).frames

    @pytest.mark.parametrize("setting", SETTINGS)
    def test_windows_that_change_too(self, make, moving, setting):
        """The slots' windows are others than the key frames'."""
        given, done = moving(setting)
        part = make("part", "--frames", "5", shot=given)
        shots.require_part(part, done.out, 4)
        assert len({str(read(path)[0]["dataWindow"]) for path in done.out.iterdir()}) > 3
        assert len(set(done.paths)) > 1

    def test_colour_on_a_smaller_window_than_geometry(self, make, tmp_path):
        """As compositors write parts: what is outside of colour must never count, or always."""
        given = write_shots(tmp_path, parted, shots.colour_only, shots.slot_gbuffer)["key"]
        whole, part = make("whole", shot=given), make("part", "--frames", "5-6", shot=given)
        shots.require_part(part, whole, 8)

    @pytest.mark.parametrize(("setting", "files"), [("key", KEYS), ("slot", 5 * KEYS - 3)])
    def test_every_file_is_read_once(self, make, monkeypatch, setting, files):
        """By a run that only warps, beside the frames that vectors are measured by."""
        by_run, by_measuring = (
            reads_of(monkeypatch, key_frames),
            reads_of(monkeypatch, motion_convention),
        )
        make("out", setting=setting, policy="warp")
        assert set(by_run.values()) == {1}
        assert len({*by_run, *by_measuring}) == files

    @pytest.mark.parametrize("policy", spread(["watching", "warp", "S3"], 1))
    def test_what_only_extrapolation_wants_is_read_where_it_is_made(
        self, make, judged, monkeypatch, policy
    ):
        """The surface of its key frame, and the key frames before that no interval has read so."""
        paths = judged(policy).paths
        assert policy != "watching" or {"S1", "S6"} <= set(paths)
        read: list[tuple[int, bool]] = []
        true = key_frames.read_raw

        def read_raw(given: Any, number: int, roles: tuple[Role, ...], **more: Any) -> Any:
            if Role.ALBEDO in roles:
                read.append((number, Role.DEPTH in roles))
            return true(given, number, roles, **more)

        monkeypatch.setattr(key_frames, "read_raw", read_raw)
        make("out", policy=policy)
        expected: list[tuple[int, bool]] = []
        for key, path in enumerate(paths, 1):
            if path != "S6":
                known = {number for number, _ in expected}
                older = [n for n in (key - 1, key - 2) if n > 0 and n not in known]
                expected += [(key, False), *((number, True) for number in older)]
        assert read == expected


class TestResume:
    @pytest.fixture
    def resume(self, uneven, network, policies, tmp_path) -> Callable[..., Done]:
        """Go on from a copy of a run that lacks some frames, with a report."""

        def run(whole: Path, missing: tuple[int, ...], setting: str, *options: object) -> Done:
            out = Path(shutil.copytree(whole, tmp_path / "out"))
            for number in missing:
                (out / f"shot.{number:04d}.exr").unlink()
            model = (
                "--causal",
                "--no-gate",
                "--extrapolator",
                network,
                "--policy",
                policies("watching"),
            )
            return take(uneven[setting], out, *model, "--skip-existing", *options)

        return run

    @pytest.mark.parametrize(
        ("setting", "missing", "scored"),
        combinations(SETTINGS, ((3, 8, 12, 18, 19, 20, 24), (7, 22, 23, 24)), (False, True)),
    )
    def test_frames_and_report_are_those_of_an_undisturbed_run(
        self, judged, resume, truth, setting, missing, scored
    ):
        """Decisions come back from headers; later ones are made after intervals that are there."""
        whole = judged("watching", setting)
        options = ("--ground-truth", truth) if scored else ()
        done = resume(whole.out, missing, setting, *options)
        assert done.frames == whole.frames
        resumed = {int(row["frame"]) for row in done.rows if row["resumed"] == "true"}
        assert resumed == set(range(1, 4 * KEYS + 1)) - set(missing)
        for key in ("decisions", "policy", "holes", "method", *(["quality"] if scored else [])):
            assert done.report[key] == whole.report[key]
        assert done.report["fps"]["effective"] == whole.report["fps"]["effective"]
        for row, expected in zip(done.rows, whole.rows, strict=True):
            for name, cell in row.items():
                if name.split("_")[0] in ("psnr", "ssim", "flip", "pulse", "scored") and not scored:
                    continue
                if not name.endswith("_ms") and name not in ("resumed", "nonfinite_pixels"):
                    assert cell == expected[name], (row["frame"], name)


class TestRecipe:
    @pytest.fixture
    def out(self, judged, tmp_path) -> Path:
        """The frames of an earlier run, in the folder of `make("out")`."""
        return Path(shutil.copytree(judged("watching").out, tmp_path / "out"))

    def test_another_policy_counts(self, make, judged, out):
        again = changed_by(lambda: make("out", "--skip-existing", policy="S4"), out)
        assert again == generated(*range(1, KEYS + 1))
        assert shots.contents(out) == judged("S4").frames

    def test_the_same_policy_under_another_name_does_not(self, make, policies, tmp_path, out):
        copy = Path(shutil.copy(policies("watching"), tmp_path / "copy.npz"))
        assert changed_by(lambda: make("out", "--skip-existing", policy=copy), out) == set()

    def test_key_frames_count_as_far_back_as_features_reach(self, make, uneven, tmp_path, out):
        """Key frame 5 has the features of 2 in its state, which are compared with those of 1."""
        keys, *rest = uneven["key"]
        keys = Path(shutil.copytree(keys, tmp_path / "keys"))
        shots.blender4(keys / "shot.0001.exr", STREET, 0.3)
        again = changed_by(lambda: make("out", "--skip-existing", shot=(keys, *rest)), out)
        assert again == {1} | generated(1, 2, 3, 4, 5)
        fresh = make("fresh", "--frames", "1,5", shot=(keys, *rest))
        shots.require_part(fresh, out, 8)

    def test_so_do_g_buffers_of_slots(self, make, judged, uneven, tmp_path):
        """The slot before key frame 2, which its features are compared with."""
        colour, option, slots, *rest = uneven["slot"]
        out = Path(shutil.copytree(judged("watching", "slot").out, tmp_path / "out"))
        slots = Path(shutil.copytree(slots, tmp_path / "slots"))
        given = (colour, option, slots, *rest)
        shots.slot_gbuffer(slots / "shot.0004.exr", STREET, 0.6)
        again = changed_by(lambda: make("out", "--skip-existing", shot=given), out)
        assert again == generated(1, 2, 3, 4, 5)
        fresh = make("fresh", "--frames", "1,5", shot=given)
        shots.require_part(fresh, out, 8)
