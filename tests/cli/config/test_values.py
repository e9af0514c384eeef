"""What values in files and variables become."""

from __future__ import annotations

import pwd

import pytest

from tests.cli.config.commands import BEGIN
from tests.cli.config.files import write


class TestValues:
    def test_lists_may_be_arrays(self, parse, project):
        write(
            project,
            '[upsample]\nmetrics = ["psnr", "vmaf"]\ncuts = [1045, 1101]\nframes = 7\n'
            'layers = ["*Diffuse*", "Depth"]',
        )
        taken = parse(*BEGIN)
        assert taken["layers"] == "*Diffuse*,Depth"
        assert taken["metrics"] == ("psnr_db", "vmaf")
        assert (taken["cuts"], taken["frames"]) == ("1045,1101", "7")

    def test_numbers(self, parse, project):
        write(project, '[upsample]\nfps = 23.976\nto-fps = "60000/1001"\nexposure = 1')
        taken = parse(*BEGIN)
        assert str(taken["fps"]) == "24000/1001" and str(taken["to_fps"]) == "60000/1001"
        assert taken["exposure"] == 1.0

    def test_paths_begin_at_the_folder_of_the_file(self, parse, project, monkeypatch):
        write(
            project,
            '[upsample]\nground-truth = "truth/"\ngbuffers = "/abs/g.####.exr"\noutput = "../out"\n'
            'aov = ["motion=vec/a.####.exr:R,G"]\npolicy = "~/p.onnx"\nmotion = "a/b"\n'
            'report = "r"\n',
        )
        (project / "below").mkdir()
        monkeypatch.chdir(project / "below")
        taken = parse("upsample", "shot")
        assert taken["ground_truth"] == f"{project}/truth/"
        assert taken["gbuffers"] == "/abs/g.####.exr"
        assert taken["output"] == f"{project}/../out"
        assert taken["aovs"] == (f"motion={project}/vec/a.####.exr:R,G",)
        assert taken["policy"] == f"{project.parent}/home/p.onnx"
        assert taken["motion"] == "a/b"
        assert taken["report_folder"] == project / "r"

    def test_where_the_file_lies_they_stay_as_written(self, parse, project):
        write(project, '[upsample]\nground-truth = "truth/"')
        assert parse(*BEGIN)["ground_truth"] == "truth/"

    def test_those_of_the_environment_begin_at_the_current_folder(self, parse, monkeypatch):
        monkeypatch.setenv("EXWARP_UPSAMPLE_GROUND_TRUTH", "truth/")
        assert parse(*BEGIN)["ground_truth"] == "truth/"

    def test_empty_variables_say_nothing(self, parse, project, monkeypatch):
        write(project, '[upsample]\nmethod = "s3"')
        monkeypatch.setenv("EXWARP_UPSAMPLE_METHOD", "")
        assert parse(*BEGIN)["method"] == "s3"

    @pytest.mark.parametrize(
        ("text", "on"),
        [("1", True), ("0", False), ("true", True), ("FALSE", False), ("yes", True), ("no", False)],
    )
    def test_switches_in_the_environment(self, text, on, parse, monkeypatch):
        monkeypatch.setenv("EXWARP_UPSAMPLE_TAIL", text)
        assert parse(*BEGIN)["tail"] is on

    def test_a_file_may_begin_with_a_mark(self, parse, project):
        (project / "exwarp.toml").write_bytes(b'\xef\xbb\xbf[upsample]\nmethod = "s3"')
        assert parse(*BEGIN)["method"] == "s3"

    def test_a_required_option_may_come_from_a_file(self, parse, project):
        write(project, '[upsample]\noutput = "frames"')
        assert parse("upsample", "shot")["output"] == "frames"


def test_a_path_below_home_needs_a_home_folder(exwarp, project, monkeypatch):
    """Else a folder named ~ would be made beside the file."""
    write(project, '[upsample]\nvideo = "~/a.mp4"\n')
    monkeypatch.delenv("HOME", raising=False)

    def unknown(number: int) -> None:
        raise KeyError(number)

    monkeypatch.setattr(pwd, "getpwuid", unknown)
    result = exwarp("upsample", "keys", "-o", "out")
    assert result.code == 2
    assert "--video names ~/a.mp4, and there is no home folder; set HOME, or write" in result.err
