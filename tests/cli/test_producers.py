"""What each renderer writes is recognised, read rightly and warped well, without a flag."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from tests.cli import shots
from tests.cli.conftest import run_quietly
from tests.cli.street import Street
from tests.matrix import combinations
from tests.unit.producer_files import PRODUCERS as PRODUCERS_AS_WRITTEN
from tests.unit.producer_files import Passes

STREET = Street()


@dataclass(frozen=True)
class Producer:
    """How a shot of three frames is written, and what must be found in it."""

    write: Callable[[Path], None]
    name: str
    convention: str
    first: int = 1
    base: str = "shot."


def written(frame: shots.FrameWriter) -> Callable[[Path], None]:
    return lambda folder: shots.sequence(folder, frame) and None


def write_unreal(folder: Path) -> None:
    for i in range(3):
        shots.unreal(folder, STREET, i, 339 + i)


def write_anonymous(folder: Path) -> None:
    """Vectors of which the name says nothing: normalised to the frame, to the next one, y down."""

    def frame(path: Path, street: Street, time: float) -> None:
        g = street.geometry(time)
        planes = shots.plain_planes(street, time)
        planes = {k: v for k, v in planes.items() if not k.startswith("forward")}
        vectors = g["following"] / [street.width, street.height]
        shots.write(path, {"": planes | shots.layer("motionvector", "RG", vectors)})

    shots.sequence(folder, frame)


def write_half(folder: Path) -> None:
    """Blender's passes, the data rounded to half as well."""

    def frame(path: Path, street: Street, time: float) -> None:
        passes = shots.blender_passes(street, time)
        with np.errstate(over="ignore"):  # the far depth becomes infinity
            planes = {k: v.astype(np.float16) for group in passes for k, v in group.items()}
        shots.write(path, {"": planes})

    shots.sequence(folder, frame)


PRODUCERS = {
    "blender5": Producer(written(shots.blender5), "Blender", "previous=X,-Y next=-Z,W"),
    "blender4": Producer(written(shots.blender4), "Blender", "previous=X,-Y next=-Z,W"),
    "half": Producer(write_half, "Blender", "previous=X,-Y next=-Z,W"),
    "plain": Producer(written(shots.plain), "Nuke convention", "next=u,-v"),
    "unreal": Producer(
        write_unreal, "Unreal (one file per AOV)", "previous=-R,G", 339, "P_PreTonemapHDRColor."
    ),
    "anonymous": Producer(write_anonymous, "unknown", "next=64*R,36*G"),
}


@pytest.fixture(scope="module", params=PRODUCERS)
def producer(request, tmp_path_factory) -> tuple[Producer, Path]:
    found = PRODUCERS[request.param]
    folder = tmp_path_factory.mktemp(request.param) / "keys"
    found.write(folder)
    return found, folder


def mean_psnr(folder: Path, base: str, first: int, intervals: int = 2) -> float:
    """Of the slots between key frames, against the scene's truth, on [0, 1] scene-linear."""
    found = []
    for order in range(4 * intervals):
        if order % 4:
            got = shots.colour_of(folder / f"{base}{first + order:04d}.exr")
            found.append(shots.psnr(STREET.colour(order / 4), got))
    return float(np.mean(found))


@pytest.fixture(scope="module")
def held(plain_shot, tmp_path_factory) -> float:
    """The score of repeating key frames, which is the same for all."""
    out = tmp_path_factory.mktemp("held") / "out"
    run_quietly("upsample", plain_shot, "-o", out, "-m", "hold")
    return mean_psnr(out, "shot.", 1)


class TestEveryProducer:
    def test_inspect_names_it(self, producer, exwarp):
        expected, keys = producer
        result = exwarp("inspect", keys, "--json")
        assert result.code == 0 and result.err == ""
        found = json.loads(result.out)
        assert found["producer"] == expected.name
        assert found["motion"]["convention"] == expected.convention
        assert found["motion"]["source"] == "calibrated"
        assert found["motion"]["error"] < 0.6 * found["motion"]["still_error"]
        assert expected.convention in found["motion"]["evidence"]
        assert (found["width"], found["height"], found["count"]) == (64, 36, 3)
        table = exwarp("inspect", keys).out
        assert expected.name in table and found["motion"]["evidence"] in table

    def test_what_comes_out_is_near_the_truth(self, producer, held, upsample, tmp_path):
        """36 and 39 dB measured; a wrong sign or unit gives under 29, as repeating does.

        What a single sample loses are the silhouettes, whose mixed pixels it cannot take apart.
        """
        expected, keys = producer
        score = {"hold": held}
        for method in ("s6", "softsplat"):
            upsample(keys, tmp_path / method, "-m", method)
            score[method] = mean_psnr(tmp_path / method, expected.base, expected.first)
        assert score["s6"] > 33 and score["s6"] > score["hold"] + 5
        assert score["softsplat"] > score["s6"] + 1


OTHERS = ("movie render queue", "arnold, mapped direction", "v-ray, clamped", "moonray")


class TestOtherForms:
    """Vectors that are no displacements yet: read rightly, as the frames between show."""

    @pytest.mark.parametrize("producer", OTHERS)
    def test_what_comes_out_is_near_the_truth(self, producer, upsample, exwarp, tmp_path):
        def frame(path: Path, street: Street, time: float) -> None:
            g = street.geometry(time)
            passes = Passes(
                street.colour(time), g["depth"], g["normal"], g["position"], g["id"],
                g["previous"], g["following"],
            )  # fmt: skip
            shots.write(path, PRODUCERS_AS_WRITTEN[producer].write(passes))

        keys = shots.sequence(tmp_path / "keys", frame)
        found = json.loads(exwarp("inspect", keys, "--json").out)
        assert found["producer"] == PRODUCERS_AS_WRITTEN[producer].name
        upsample(keys, tmp_path / "out", "-m", "softsplat")
        assert mean_psnr(tmp_path / "out", "shot.", 1) > 33
        # What is measured can be given by hand, in the same words.
        given = ("--motion", found["motion"]["convention"])
        upsample(keys, tmp_path / "given", "-m", "softsplat", *given)
        assert_same_pixels(tmp_path / "out", tmp_path / "given")


def backwards(path: Path, street: Street, time: float) -> None:
    shots.blender5(path, street, time, sign=-1.0)


class TestSignFlip:
    def test_it_is_said_and_changes_nothing(self, exwarp, upsample, tmp_path):
        shots.sequence(tmp_path / "right", shots.blender5, (1, 2))
        shots.sequence(tmp_path / "wrong", backwards, (1, 2))
        found = json.loads(exwarp("inspect", tmp_path / "wrong", "--json").out)["motion"]
        assert found["source"] == "corrected" and found["named"] == "previous=X,-Y next=-Z,W"
        assert found["convention"] == "previous=-X,Y next=Z,-W"
        assert "the names say previous=X,-Y next=-Z,W" in found["evidence"]
        assert "motion corrected: " in exwarp("inspect", tmp_path / "wrong").out
        for side in ("right", "wrong"):
            upsample(tmp_path / side, tmp_path / f"out-{side}", "-m", "softsplat")
        assert_same_pixels(tmp_path / "out-right", tmp_path / "out-wrong")

    def test_a_single_direction_too(self, exwarp, upsample, tmp_path):
        def flipped(path: Path, street: Street, time: float) -> None:
            planes = shots.plain_planes(street, time)
            for name in ("forward.u", "forward.v"):
                planes[name] = -planes[name]
            shots.write(path, {"": planes})

        shots.sequence(tmp_path / "right")
        shots.sequence(tmp_path / "wrong", flipped)
        found = json.loads(exwarp("inspect", tmp_path / "wrong", "--json").out)["motion"]
        assert (found["source"], found["convention"]) == ("corrected", "next=-u,v")
        for side in ("right", "wrong"):
            upsample(tmp_path / side, tmp_path / f"out-{side}", "-m", "s6")
        assert_same_pixels(tmp_path / "out-right", tmp_path / "out-wrong")

    def test_the_convention_by_hand(self, exwarp, upsample, tmp_path, plain_shot):
        upsample(plain_shot, tmp_path / "measured", "-m", "s6")
        for i, given in enumerate(("next=u,-v", "forward", "next=1.0*u,-v")):
            upsample(plain_shot, tmp_path / f"given{i}", "-m", "s6", "--motion", given)
            assert_same_pixels(tmp_path / "measured", tmp_path / f"given{i}")
        upsample(plain_shot, tmp_path / "wrong", "-m", "s6", "--motion", "next=-u,v")
        right, wrong = (
            shots.colour_of(tmp_path / side / "shot.0003.exr") for side in ("measured", "wrong")
        )
        assert np.abs(right - wrong).max() > 0.1
        found = json.loads(exwarp("inspect", plain_shot, "--json", "--motion", "backward").out)
        assert found["motion"]["source"] == "given"


@pytest.fixture(scope="module")
def colour_keys(tmp_path_factory) -> Path:
    return shots.sequence(tmp_path_factory.mktemp("colour") / "keys", shots.colour_only)


class TestSlotGBuffers:
    @pytest.mark.parametrize(("first", "method"), combinations([1, 501], ["s6", "softsplat"]))
    def test_keys_may_hold_colour_alone(self, colour_keys, upsample, tmp_path, first, method):
        slots = shots.sequence(
            tmp_path / "slots", shots.slot_gbuffer, range(first, first + 9), step=0.25
        )
        out = ("-m", method, "--gbuffers", slots, "--json")
        document = json.loads(upsample(colour_keys, tmp_path / "out", *out).out)
        assert document["setting"] == "slot"
        # 31.4 (s6) and 34.5 measured: rows of mixed pixels at the rim of the wall are holes here.
        assert mean_psnr(tmp_path / "out", "shot.", 1) > 30
        assert len(shots.names(tmp_path / "out")) == 12

    # Vectors to the previous slot alone, so the next key frame is moved back by its own: 35.7 dB,
    # and 33.2, less than without it, when those were taken to span a whole key interval.
    @pytest.mark.parametrize(("method", "least"), [("s6", 30), ("softsplat", 34.5)])
    def test_unreal_at_every_slot(self, colour_keys, upsample, tmp_path, method, least):
        for i in range(9):
            shots.unreal(tmp_path / "slots", STREET, i / 4, 100 + i, rate=4)
        upsample(colour_keys, tmp_path / "out", "-m", method, "--gbuffers", tmp_path / "slots")
        assert mean_psnr(tmp_path / "out", "shot.", 1) > least

    @pytest.mark.parametrize("method", ["hold", "blend"])
    def test_those_that_lead_only_forward_are_left_out_where_nothing_is_moved(
        self, colour_keys, exwarp, upsample, tmp_path, method
    ):
        slots = shots.sequence(tmp_path / "slots", shots.slot_gbuffer, range(1, 10), step=0.25)
        given = ("--gbuffers", slots, "--motion", "next=-Z,W", "--report", tmp_path / "report")
        options = ("-m", method, "--progress", "none", "--threads", 1, *given)
        result = exwarp("upsample", colour_keys, "-o", tmp_path / "out", *options)
        assert result.code == 0, result.err
        assert "exwarp: --gbuffers is left out: it has no readable vectors" in result.err
        assert json.loads((tmp_path / "report" / "report.json").read_text())["setting"] == "key"
        upsample(colour_keys, tmp_path / "without", "-m", method)
        assert_same_pixels(tmp_path / "out", tmp_path / "without")

    def test_too_few_are_refused(self, colour_keys, exwarp, tmp_path):
        slots = shots.sequence(tmp_path / "slots", shots.slot_gbuffer, range(1, 7), step=0.25)
        options = ("-m", "softsplat", "--gbuffers", slots)
        result = exwarp("upsample", colour_keys, "-o", tmp_path / "out", *options)
        result.refused(3, "--gbuffers", "9 slots")
        assert not (tmp_path / "out").exists()


def assert_same_pixels(one: Path, other: Path) -> None:
    assert shots.names(one) == shots.names(other)
    for name in shots.names(one):
        assert np.array_equal(shots.colour_of(one / name), shots.colour_of(other / name)), name
