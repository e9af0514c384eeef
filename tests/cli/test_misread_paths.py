"""Paths that a shell, another system or a loop of links makes into something else."""

from __future__ import annotations

import pytest

from tests.cli import shots

OUTPUTS = [("-o",), ("-o", "out", "--report"), ("-o", "out", "--write-holes")]


@pytest.fixture
def here(tmp_path, monkeypatch):
    """Run in an empty folder; return it."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("options", OUTPUTS)
@pytest.mark.parametrize(
    ("path", "said"),
    [
        ("-", "names -, and frames do not go through standard input or output; name a folder"),
        ("Z:\\shots\\out", "names Z:\\shots\\out, which is a path of Windows"),
        ("\\\\server\\out", "names \\\\server\\out, which is a path of Windows"),
        ("~/out", "names ~/out, and the shell did not replace ~ by the home folder; write $HOME/o"),
    ],
)
def test_an_output_that_is_no_path_here_makes_no_folder(
    exwarp, plain_shot, here, options, path, said
):
    result = exwarp("upsample", plain_shot, *options, path, "-m", "s6", "--motion", "forward")
    assert result.code == 2
    assert f"error: {options[-1]} {said}" in result.err and result.err.count("\n") == 1
    assert shots.names(here) == []


@pytest.mark.parametrize("path", ["Z:\\shots\\sh010", "c:/shots/sh010"])
def test_a_path_of_windows_is_known_as_input(exwarp, here, path):
    result = exwarp("inspect", path)
    assert result.code == 2
    assert f"error: SEQUENCE names {path}, which is a path of Windows" in result.err


def test_such_names_can_be_meant(upsample, plain_shot, here):
    upsample(plain_shot, here / "-", "-m", "s6", "--motion", "forward")
    assert len(shots.names(here / "-")) == 12


@pytest.mark.parametrize("command", [("inspect",), ("upsample", "-o", "out"), ("features",)])
def test_an_unquoted_star_is_explained(exwarp, plain_shot, here, command):
    names = sorted(plain_shot.iterdir())
    result = exwarp(*command, *names)
    pattern = f"{plain_shot}/{names[0].name.replace('0001', '####')}"
    assert result.code == 2
    assert result.err == (
        f"exwarp: error: nothing takes {names[1]} and 1 more, as the shell replaces an unquoted * "
        f"by all names; name the folder {plain_shot}/ or the pattern {pattern}\n"
    )
    assert shots.names(here) == []


def test_other_words_too_many_are_no_matter_of_the_shell(exwarp, plain_shot, here):
    result = exwarp("inspect", plain_shot, "word")
    assert result.code == 2 and "unexpected extra argument (word)" in result.err


class TestLoops:
    """Links that lead back to themselves."""

    @pytest.fixture
    def loop(self, here):
        (here / "a").symlink_to("b")
        (here / "b").symlink_to("a")
        return here / "a"

    @pytest.mark.parametrize("below", ["", "sh010", "sh010/shot.####.exr"])
    def test_an_input_is_named(self, exwarp, loop, below):
        result = exwarp("inspect", loop / below)
        assert result.code == 3
        assert f"error: the link {loop} leads back to itself; remove it" in result.err

    @pytest.mark.parametrize("options", [*OUTPUTS, ("-o", "out", "--video")])
    def test_an_output_is_named(self, exwarp, plain_shot, loop, options):
        result = exwarp("upsample", plain_shot, *options, loop / "x.mp4", "-m", "s6")
        assert result.code == 5
        assert f"error: the link {loop} leads back to itself; remove it" in result.err

    def test_a_frame_among_others_is_named(self, exwarp, here):
        keys = shots.sequence(here / "keys")
        link = keys / "shot.0004.exr"
        link.symlink_to(link.name)
        result = exwarp("inspect", keys)
        assert result.code == 3
        assert f"error: the link {link} leads back to itself; remove it, or" in result.err
