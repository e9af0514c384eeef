"""Finding sequences on disk, AOV sets, and where output goes."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from exwarp_cli.errors import InputError, MissingFrameError, OutputError, UsageError
from exwarp_cli.io.frame_names import NamePattern, group_names, split_names
from exwarp_cli.io.sequences import Sequence, find_aov_set, find_sequence, output_pattern


def fill(folder: Path, *names: str) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        (folder / name).touch()
    return folder


def sequence(folder: Path = Path("in"), base: str = "shot.", padding: int = 4) -> Sequence:
    return Sequence(base, padding, ".exr", folder, {1: folder / "shot.0001.exr"})


class TestSpellings:
    NAMES = ("shot.0001.exr", "shot.0002.exr", "shot.0003.exr")

    @pytest.mark.parametrize(
        "spec",
        [
            "",
            "shot.####.exr",
            "shot.@@@@.exr",
            "shot.%04d.exr",
            "shot.$F4.exr",
            "shot.#.exr",
            "shot.%d.exr",
            "shot.$F.exr",
            "shot.0002.exr",
        ],
    )
    def test_folder_pattern_and_frame_name_the_same_sequence(self, tmp_path, spec):
        fill(tmp_path, *self.NAMES)
        found = find_sequence(f"{tmp_path}/{spec}")
        assert (found.base, found.suffix, found.numbers) == ("shot.", ".exr", [1, 2, 3])
        assert found.files[2] == tmp_path / "shot.0002.exr"
        assert found.pattern == str(tmp_path / "shot.####.exr")

    def test_relative_pattern_in_the_working_folder(self, tmp_path, monkeypatch):
        monkeypatch.chdir(fill(tmp_path, *self.NAMES))
        assert find_sequence("shot.####.exr").numbers == [1, 2, 3]
        assert find_sequence(".").numbers == [1, 2, 3]

    @pytest.mark.parametrize(
        "folder", ["a b", "100%", "v#1", "[x]{y}", "été", "%04d", "$F4", "####"]
    )
    def test_folders_may_have_any_name(self, tmp_path, folder):
        fill(tmp_path / folder, *self.NAMES)
        for spec in ("", "shot.####.exr", "shot.%04d.exr", "shot.0001.exr"):
            assert find_sequence(str(tmp_path / folder / spec)).numbers == [1, 2, 3]

    @pytest.mark.parametrize(
        "base", ["take#2.", "50% ", "[a].", "é ", "shot010_v2.", "$F4.", "a.b."]
    )
    def test_titles_may_have_any_characters(self, tmp_path, base):
        fill(tmp_path, f"{base}0009.exr", f"{base}0010.exr")
        found = find_sequence(str(tmp_path))
        assert (found.base, found.numbers) == (base, [9, 10])
        assert find_sequence(found.pattern) == found
        assert find_sequence(str(found.files[9])) == found


class TestTextAfterTheNumber:
    @pytest.mark.parametrize(
        ("names", "pattern", "numbers"),
        [
            (["b_0101_denoised.exr", "b_0102_denoised.exr"], "b_####_denoised.exr", [101, 102]),
            (["a.0009_left.exr", "a.0010_left.exr"], "a.####_left.exr", [9, 10]),
            (["a.9.final.exr", "a.10.final.exr"], "a.#.final.exr", [9, 10]),
            (["a.-1_x.exr", "a.0_x.exr", "a.1_x.exr"], "a.#_x.exr", [-1, 0, 1]),
            (["a-0001-x.EXR", "a-0002-x.EXR"], "a-####-x.EXR", [1, 2]),
            (["0001_left.exr", "0002_left.exr"], "####_left.exr", [1, 2]),
            (["b_1001_denoised.exr"], "b_####_denoised.exr", [1001]),
            # Of several numbers the one that varies.
            (
                ["sh010_v002_0101_denoised.exr", "sh010_v002_0102_denoised.exr"],
                "sh010_v002_####_denoised.exr",
                [101, 102],
            ),
            (["a_0101_2_x.exr", "a_0102_2_x.exr"], "a_####_2_x.exr", [101, 102]),
            (["a_2_0101_x.exr", "a_2_0102_x.exr"], "a_2_####_x.exr", [101, 102]),
            (["a_0101_v2.exr", "a_0102_v2.exr", "a_0103_v2.exr"], "a_####_v2.exr", [101, 102, 103]),
            (["a_4k_0101_2048x858_x.exr"], "a_4k_####_2048x858_x.exr", [101]),
        ],
    )
    def test_folder_pattern_and_frame_name_the_same_sequence(
        self, tmp_path, names, pattern, numbers
    ):
        fill(tmp_path, *names)
        found = find_sequence(str(tmp_path))
        assert (Path(found.pattern).name, found.numbers) == (pattern, numbers)
        assert find_sequence(found.pattern) == found
        assert find_sequence(f"{tmp_path}/{names[0]}") == found
        assert sorted(found.files.values()) == sorted(tmp_path / name for name in names)

    def test_two_texts_are_two_sequences(self, tmp_path):
        fill(tmp_path, "a.0001_left.exr", "a.0002_left.exr", "a.0001_right.exr")
        assert find_sequence(f"{tmp_path}/a.####_left.exr").numbers == [1, 2]
        assert find_sequence(f"{tmp_path}/a.0001_right.exr").numbers == [1]
        with pytest.raises(InputError, match=r"2 sequences, a\.####_left\.exr \(1-2\), a\.####_r"):
            find_sequence(str(tmp_path))

    def test_numbers_at_the_end_come_first(self, tmp_path):
        fill(tmp_path, "a.0001.exr", "a.0002.exr", "a.0001_old.exr", "still_07_x.exr")
        assert find_sequence(str(tmp_path)).numbers == [1, 2]
        assert find_sequence(f"{tmp_path}/a.0001_old.exr").suffix == "_old.exr"

    @pytest.mark.parametrize(
        "names",
        [
            ["v1.exr", "v2.exr"],
            ["a_v001.exr", "a_v002.exr"],
            ["a_0101_v1.exr", "a_0101_v2.exr"],
            ["a_0101_v1.exr"],
            ["shot010_v2.0001.exr"],
        ],
    )
    def test_what_varies_at_the_end_is_the_number(self, tmp_path, names):
        fill(tmp_path, *names)
        assert find_sequence(str(tmp_path)).suffix == ".exr"

    @pytest.mark.parametrize("names", [["4k_a.exr"], ["cam1_a.exr", "cam2_a.exr"], ["sh010_a.exr"]])
    def test_digits_of_words_are_no_number(self, tmp_path, names):
        fill(tmp_path, *names)
        with pytest.raises(InputError, match=f"{names[0]} has no frame number before its suffix"):
            find_sequence(str(tmp_path))


class TestCapitalSuffixes:
    @pytest.mark.parametrize(
        "spec", ["", "a.####.EXR", "a.####.exr", "a.0001.EXR", "a.0001.exr", "a.%04d.Exr"]
    )
    def test_they_are_taken_in_any_case(self, tmp_path, spec):
        fill(tmp_path, "a.0001.EXR", "a.0002.EXR", "notes.exr")
        found = find_sequence(f"{tmp_path}/{spec}")
        assert (found.suffix, found.numbers) == (".EXR", [1, 2])

    def test_files_in_both_cases_are_two_sequences(self, tmp_path):
        fill(tmp_path, "a.0001.EXR", "a.0002.exr")
        with pytest.raises(InputError, match="2 sequences"):
            find_sequence(str(tmp_path))
        assert find_sequence(f"{tmp_path}/a.####.exr").numbers == [2]


class TestNumbers:
    @pytest.mark.parametrize(
        ("names", "padding", "numbers"),
        [
            (["f.9.exr", "f.10.exr", "f.100.exr"], 1, [9, 10, 100]),
            (["f.0999.exr", "f.1000.exr"], 4, [999, 1000]),
            (["f.9999.exr", "f.10000.exr"], 4, [9999, 10000]),
            (["f.1001.exr", "f.1002.exr"], 4, [1001, 1002]),
            (["f.-2.exr", "f.-1.exr", "f.0.exr", "f.1.exr"], 1, [-2, -1, 0, 1]),
            (["f.-001.exr", "f.0000.exr", "f.0001.exr"], 4, [-1, 0, 1]),
            (["f.-0001.exr", "f.0000.exr"], 4, [-1, 0]),
            (["f.-012.exr", "f.-001.exr"], 4, [-12, -1]),
            (["shot-0001.exr", "shot-0002.exr"], 4, [1, 2]),
            (["0001.exr", "0002.exr"], 4, [1, 2]),
            (["v10007.EXR", "v10008.EXR"], 5, [10007, 10008]),
        ],
    )
    def test_padding_and_sign(self, tmp_path, names, padding, numbers):
        found = find_sequence(str(fill(tmp_path, *names)))
        assert (found.padding, found.numbers) == (padding, numbers)
        assert find_sequence(found.pattern).files == found.files

    def test_two_paddings_are_two_sequences(self, tmp_path):
        fill(tmp_path, "f.9.exr", "f.0001.exr", "f.0002.exr")
        with pytest.raises(InputError, match=r"2 sequences, f\.#\.exr \(9\), f\.####\.exr \(1-2\)"):
            find_sequence(str(tmp_path))
        assert find_sequence(f"{tmp_path}/f.####.exr").numbers == [1, 2]
        assert find_sequence(f"{tmp_path}/f.9.exr").numbers == [9]

    def test_a_pattern_never_takes_part_of_a_sequence(self, tmp_path):
        fill(tmp_path, "f.999.exr", "f.1000.exr")
        with pytest.raises(InputError, match=r"no frame .* matches f\.####\.exr; there is f\.###"):
            find_sequence(f"{tmp_path}/f.####.exr")

    def test_frames_past_the_padding_belong_to_the_widest_one(self):
        names = ["f.001.exr", "f.0001.exr", "f.1000.exr"]
        assert group_names(NamePattern("f.", 1, ".exr"), names) == [
            (3, {1: "f.001.exr"}),
            (4, {1: "f.0001.exr", 1000: "f.1000.exr"}),
        ]

    def test_a_fitting_pattern_settles_the_padding(self, tmp_path):
        fill(tmp_path, "f.1001.exr", "f.1002.exr")
        assert find_sequence(f"{tmp_path}/f.%02d.exr").padding == 2

    def test_a_base_that_ends_in_digits_is_taken_at_its_word(self, tmp_path):
        fill(tmp_path, "v20001.exr", "v20002.exr", "v30001.exr")
        assert find_sequence(f"{tmp_path}/v2####.exr").numbers == [1, 2]


class TestRefusals:
    def test_several_sequences_are_listed(self, tmp_path):
        fill(tmp_path, *(f"{c}.{n}.exr" for c in "abcdefgh" for n in (1, 2)))
        with pytest.raises(InputError) as caught:
            find_sequence(str(tmp_path))
        text = str(caught.value)
        assert "8 sequences" in text and "a.#.exr (1-2)" in text and "and 2 more" in text
        assert f"for example {tmp_path}/a.#.exr" in text

    @pytest.mark.parametrize(
        ("spec", "why"),
        [
            ("", "there is no file or folder"),
            ("nowhere", "there is no file or folder"),
            ("nowhere/a.####.exr", "the folder .*nowhere does not exist"),
            ("empty", "holds no sequence"),
            ("single", r"still\.exr has no frame number"),
            ("single/still.exr", "no frame number before its suffix"),
            ("single/note.txt", r"is not an \.exr file"),
            ("single/a.####.png", r"is not an \.exr file"),
            ("single/a.####.exr", "no frame in .* matches"),
            ("a\0b", "there is no file or folder"),
            ("n" * 300, "cannot look into|there is no file"),
        ],
    )
    def test_what_cannot_be_found(self, tmp_path, monkeypatch, spec, why):
        fill(tmp_path / "empty")
        fill(tmp_path / "single", "still.exr", "note.txt")
        fill(tmp_path, "beside.exr")
        monkeypatch.chdir(tmp_path)
        with pytest.raises(InputError, match=why):
            find_sequence(spec)

    def test_strangers_in_the_folder_do_not_matter(self, tmp_path):
        fill(tmp_path, "a.1.exr", "a.2.exr", "._a.1.exr", "thumb.exr", "a.1.png", "a.mp4")
        fill(tmp_path / "a.3.exr")  # a folder with the name of a frame
        fill(tmp_path, ".a.3.exr.host-1-0.exwarp-tmp")
        assert find_sequence(str(tmp_path)).numbers == [1, 2]

    def test_other_suffixes_on_demand(self, tmp_path):
        fill(tmp_path, "a.1.png", "a.2.png")
        assert find_sequence(str(tmp_path), (".png",)).numbers == [1, 2]


class TestAovSets:
    NAMES = ("PreTonemapHDRColor", "MotionVector", "SceneDepth", "WorldNormal", "MyStencil")

    def dump(self, folder, *aovs, prefix="Medieval", numbers=(339, 340)):
        return fill(folder, *(f"{prefix}{aov}.{n:04d}.exr" for aov in aovs for n in numbers))

    def test_a_folder_is_one_set_led_by_its_colour(self, tmp_path):
        spec = str(self.dump(tmp_path, *self.NAMES))
        assert find_sequence(spec).base == "MedievalPreTonemapHDRColor."
        found = find_aov_set(spec)
        assert found.colour == find_sequence(spec)
        assert set(found.aovs) == set(self.NAMES[1:])
        assert found.aovs["SceneDepth"].files[340].name == "MedievalSceneDepth.0340.exr"

    @pytest.mark.parametrize(
        "name", ["MedievalWorldNormal.0339.exr", "MedievalSceneDepth.####.exr"]
    )
    def test_any_member_leads_to_its_set(self, tmp_path, name):
        self.dump(tmp_path, *self.NAMES)
        assert find_aov_set(f"{tmp_path}/{name}").colour.base == "MedievalPreTonemapHDRColor."
        assert find_sequence(f"{tmp_path}/{name}").base.startswith(name[:14])

    def test_a_folder_of_geometry_is_led_by_its_motion(self, tmp_path):
        spec = str(self.dump(tmp_path, *self.NAMES[1:], prefix=""))
        assert find_sequence(spec).base == "MotionVector."
        assert find_aov_set(spec).colour is None
        assert find_aov_set(spec).leader.numbers == [339, 340]

    def test_the_most_linear_colour_leads(self, tmp_path):
        self.dump(tmp_path, "FinalImage", "SceneColor", "MotionVector")
        assert find_aov_set(str(tmp_path)).colour.base == "MedievalSceneColor."

    def test_a_frame_that_an_aov_lacks_is_named(self, tmp_path):
        self.dump(tmp_path, *self.NAMES)
        (tmp_path / "MedievalSceneDepth.0340.exr").unlink()
        with pytest.raises(MissingFrameError, match=r"frame 340 of the AOV SceneDepth is missing"):
            find_aov_set(str(tmp_path))

    def test_aovs_at_more_frames_are_cut_to_the_colour(self, tmp_path):
        self.dump(tmp_path, "MotionVector", "SceneDepth", numbers=range(340, 349))
        self.dump(tmp_path, "PreTonemapHDRColor", numbers=(340, 344, 348))
        found = find_aov_set(str(tmp_path))
        assert found.aovs["MotionVector"].numbers == found.colour.numbers == [340, 344, 348]

    def test_two_shots_in_a_folder_are_several_sequences(self, tmp_path):
        self.dump(tmp_path, *self.NAMES, prefix="A")
        self.dump(tmp_path, *self.NAMES, prefix="B")
        with pytest.raises(InputError, match="2 sequences"):
            find_sequence(str(tmp_path))
        assert find_aov_set(f"{tmp_path}/BMyStencil.0339.exr").colour.base.startswith("B")

    def test_an_ordinary_sequence_is_no_set(self, tmp_path):
        spec = str(fill(tmp_path, "a.1.exr", "a.2.exr"))
        found = find_aov_set(spec)
        assert (found.colour, found.aovs) == (find_sequence(spec), {})
        assert find_aov_set(str(self.dump(tmp_path / "x", "FinalImage"))).aovs == {}

    def test_the_set_of_a_pattern_leaves_other_sequences_alone(self, tmp_path):
        self.dump(tmp_path, *self.NAMES)
        fill(tmp_path, "other.1.exr")
        assert find_aov_set(f"{tmp_path}/other.1.exr").aovs == {}
        assert find_aov_set(f"{tmp_path}/MedievalMyStencil.%04d.exr").aovs


class TestOutputPattern:
    @pytest.mark.parametrize("spec", ["out", "out/", "a/b.c/v1.5", "./new folder"])
    def test_a_name_without_token_is_a_folder(self, spec):
        target = output_pattern(spec, sequence())
        assert target.folder == Path(spec)
        assert target.path(1005) == Path(spec) / "shot.1005.exr"
        assert str(target) == "shot.####.exr"

    @pytest.mark.parametrize(
        ("spec", "number", "path"),
        [
            ("out/x_####.exr", 7, "out/x_0007.exr"),
            ("out/x.%05d.exr", 7, "out/x.00007.exr"),
            ("x.@.exr", 7, "x.7.exr"),
            ("$F4.exr", 12345, "12345.exr"),
            ("x.####.EXR", -7, "x.-007.EXR"),
        ],
    )
    def test_patterns(self, spec, number, path):
        assert output_pattern(spec, sequence()).path(number) == Path(path)

    def test_an_existing_folder_may_look_like_a_pattern(self, tmp_path):
        folder = fill(tmp_path / "out.####.exr")
        assert output_pattern(str(folder), sequence()).folder == folder

    @pytest.mark.parametrize("spec", ["out.exr", "a/out.0001.exr"])
    def test_one_file_is_refused_with_the_pattern_to_write(self, spec):
        with pytest.raises(UsageError, match=rf"such as {Path(spec).stem}\.####\.exr"):
            output_pattern(spec, sequence())

    @pytest.mark.parametrize(
        "spec", ["o.png", "o.####.png", "o.JPG", "o.mp4", "o.####", "o.%04d.zip"]
    )
    def test_other_formats_are_refused(self, spec):
        with pytest.raises(UsageError, match="EXR only"):
            output_pattern(spec, sequence())

    def test_an_empty_path_is_refused(self):
        with pytest.raises(UsageError, match="empty"):
            output_pattern("", sequence())

    @pytest.mark.parametrize(
        "spec", ["in", "in/", "in/../in", "in/shot.####.exr", "in/shot.%06d.exr"]
    )
    def test_frames_never_fall_among_those_of_the_input(self, tmp_path, monkeypatch, spec):
        monkeypatch.chdir(tmp_path)
        fill(tmp_path / "in", "shot.0001.exr")
        with pytest.raises(OutputError, match="another folder or another base name"):
            output_pattern(spec, find_sequence("in"))

    def test_a_link_to_the_input_folder_is_the_input_folder(self, tmp_path):
        fill(tmp_path / "in", "shot.0001.exr")
        (tmp_path / "link").symlink_to(tmp_path / "in")
        with pytest.raises(OutputError):
            output_pattern(str(tmp_path / "link"), find_sequence(str(tmp_path / "in")))

    def test_another_base_name_beside_the_input_is_fine(self):
        assert output_pattern("in/up.####.exr", sequence()).folder == Path("in")


BASES = st.text(st.characters(exclude_characters="/\0", exclude_categories=["Cs"]), max_size=12)


class TestNames:
    @given(BASES, st.integers(1, 8), st.integers(-99_999, 9_999_999))
    def test_a_written_name_is_read_back_by_its_pattern(self, base, padding, number):
        pattern = NamePattern(base, padding, ".exr")
        groups = group_names(pattern, [pattern.name(number)])
        if number >= 0 or not base[-1:].isalnum():
            assert [list(names) for _, names in groups] == [[number]]
        else:
            assert groups == []  # a minus after a letter is a hyphen

    @given(BASES, st.integers(1, 8))
    def test_a_pattern_is_read_back_from_its_text(self, base, padding):
        if not base.endswith(("#", "@")):
            pattern = NamePattern(base, padding, ".exr")
            assert NamePattern.parse(str(pattern)) == pattern

    @given(BASES, st.integers(0, 9_999_999))
    def test_splitting_finds_the_last_digits(self, base, number):
        name = f"{base}x{number}.exr"
        split = split_names([name], (".exr",))
        assert split == {name: NamePattern(f"{base}x", len(str(number)), ".exr")}

    @given(st.integers(1, 6), st.sets(st.integers(0, 99_999), min_size=1, max_size=20))
    def test_frames_of_one_padding_stay_together(self, padding, numbers):
        pattern = NamePattern("f.", padding, ".exr")
        ((found, names),) = group_names(pattern, [pattern.name(n) for n in numbers])
        assert list(names) == sorted(numbers)
        again = NamePattern("f.", found, ".exr")
        assert [again.name(n) for n in names] == list(names.values())

    @pytest.mark.parametrize("name", ["a.exr", "a.0001.png", ".exr", "0001"])
    def test_names_without_a_frame_number(self, name):
        assert split_names([name], (".exr",)) == {}
