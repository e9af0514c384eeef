"""A sequence a pass: which sequences of a folder are one shot, by their names."""

from __future__ import annotations

from pathlib import Path

import pytest

from exwarp_cli.errors import InputError, LayoutError
from exwarp_cli.io.channel_map import parse_aovs
from exwarp_cli.io.sequences import find_aov_set, find_sequence
from exwarp_cli.io.shot import open_shot
from tests.unit.exr_files import rgba, write_single


@pytest.fixture
def folder(tmp_path):
    """Return a function that puts empty files there, two frames of each sequence."""

    def fill(*bases: str):
        for base in bases:
            for number in (1, 2):
                (tmp_path / f"{base}{number:04d}.exr").touch()
        return tmp_path

    return fill


@pytest.mark.parametrize(
    ("beauty", "passes"),
    [
        ("shot.", {"shot.MotionVectors.": "MotionVectors", "shot.Z.": "Z"}),
        ("shot_Beauty.", {"shot_velocity.": "velocity", "shot_zDepth.": "zDepth"}),
        ("comp", {"compVRayVelocity": "VRayVelocity", "compVRayZDepth": "VRayZDepth"}),
        ("a.RGB_color.", {"a.VRayVelocity.": "VRayVelocity", "a.crypto_id.": "crypto_id"}),
        (
            "Seq.FinalImage.",
            {
                "Seq.FinalImageMovieRenderQueue_MotionVectors.": "MovieRenderQueue_MotionVectors",
                "Seq.FinalImageMovieRenderQueue_WorldDepth.": "MovieRenderQueue_WorldDepth",
            },
        ),
        ("shot.", {"shot.N.": "N", "shot.P.": "P", "shot.GI.": "GI"}),
    ],
)
def test_a_beauty_and_its_passes_are_one_input(folder, beauty, passes):
    spec = str(folder(beauty, *passes))
    found = find_aov_set(spec)
    assert found.colour.base == find_sequence(spec).base == beauty
    assert {member.base: name for name, member in found.aovs.items()} == passes


def test_any_pass_leads_to_its_shot(folder):
    spec = folder("a.", "a.Z.", "b.", "b.Z.")
    assert find_aov_set(f"{spec}/b.Z.0001.exr").colour.base == "b."
    with pytest.raises(InputError, match=r"2 sequences, a\.####\.exr.*, b\.####\.exr"):
        find_sequence(str(spec))


def test_two_beauties_are_named(folder):
    spec = folder("shot.", "shot.beauty.", "shot.Z.")
    with pytest.raises(InputError, match=r"2 sequences, shot\.####\.exr.*shot\.beauty\.####\.exr"):
        find_sequence(str(spec))
    assert find_aov_set(f"{spec}/shot.beauty.####.exr").colour.base == "shot.beauty."
    with pytest.raises(InputError, match=r"shot\.Z\.####\.exr is a pass of 2 sequences"):
        find_aov_set(f"{spec}/shot.Z.####.exr")


def test_versions_and_views_are_no_passes(folder):
    spec = folder("shot_v1.", "shot_v2.", "shot_left.")
    assert find_aov_set(f"{spec}/shot_v1.####.exr").aovs == {}
    with pytest.raises(InputError, match="3 sequences"):
        find_sequence(str(spec))


def test_two_passes_of_vectors_are_named(folder):
    spec = str(folder("shot.", "shot.MotionVectors.", "shot.velocity."))
    with pytest.raises(LayoutError, match=r"MotionVectors.*velocity.*--aov motion="):
        open_shot(spec)
    for path in Path(spec).iterdir():
        write_single(path, rgba(2, 2))
    aovs = parse_aovs([f"motion={spec}/shot.velocity.####.exr:R,G"])
    assert set(open_shot(spec, aovs=aovs).aovs) == {"MotionVectors", "velocity"}


def test_forward_and_backward_belong_together(folder):
    spec = str(folder("shot.", "shot.motionFore.", "shot.motionBack."))
    for path in Path(spec).iterdir():
        write_single(path, rgba(2, 2))
    assert set(open_shot(spec).aovs) == {"motionFore", "motionBack"}
