"""Files and variables that are wrong: refused in one sentence that says where."""

from __future__ import annotations

import pytest

from tests.cli.config.commands import BEGIN
from tests.cli.config.files import write


class TestMistakes:
    @pytest.mark.parametrize(
        ("text", "words"),
        [
            ('[upsample]\nmethdo = "s6"', ("methdo in [upsample] of", "did you mean method?")),
            ('[upsample]\nxyzzy = "s6"', ("xyzzy in", "exwarp upsample --help lists them")),
            ('[upsmaple]\nmethod = "s6"', ("[upsmaple] in", "did you mean upsample?")),
            ('method = "s6"', ("method of", "stands in no command's table", "[upsample]")),
            ("upsample = 3", ("upsample of", "stands in no command's table")),
            ('[upsample]\nsequence = "s"', ("no option, but stands on the command line",)),
            ("[upsample]\nmethod\n", ("is not TOML", "line 2", "--config none")),
            ('[upsample]\nthreads = "4"', ("threads in", "a whole number, and is text")),
            pytest.param(
                f"[upsample]\nthreads = {'[' * 3000}{']' * 3000}",
                ("is not TOML: arrays or tables stand too deep",),
                id="deep",
            ),
            pytest.param(
                f"[upsample]\nthreads = {'9' * 5000}", ("is not TOML: Exceeds",), id="digits"
            ),
            ("[upsample]\nthreads = true", ("a whole number, and is true or false",)),
            ("[upsample]\nexposure = 'a'", ("a number, and is text",)),
            ("[upsample]\ntail = 1", ("true or false, and is a whole number",)),
            ("[upsample]\nno-report = 1", ("no-report in", "must be true or false")),
            ("[upsample]\nmethod = ['s6']", ("must be text, and is an array",)),
            ("[upsample]\nreport = 4", ("text, a path, and is a whole number",)),
            ("[upsample]\nmethod = 2026-01-01", ("must be text, and is a date",)),
            ("[upsample.method]\na = 1", ("must be text, and is a table",)),
            ('[upsample]\npolicy = "a\\u0000b"', ("policy in", "a NUL character", "remove it")),
            ('[upsample]\naov = ["depth=a\\u0000b"]', ("aov in", "a NUL character")),
            ("[upsample]\naov = [1]", ("must be text, a path, or an array of such",)),
            ("[upsample]\ntail = true\nno-tail = true", ("no-tail in", "says again what tail in")),
            ("[upsample]\ndevice = 'abacus'", ("'--device': 'abacus'", "device in [upsample] of")),
            ("[upsample]\nthreads = 0", ("'--threads': 0", "is set by threads in [upsample] of")),
            ("[upsample]\nmetrics = ['x']", ("no metric", "is set by metrics in [upsample] of")),
        ],
    )
    def test_one_sentence_says_where(self, text, words, exwarp, project):
        file = write(project, text)
        exwarp(*BEGIN).refused(2, *words, str(file))

    def test_in_tables_of_groups(self, exwarp, project):
        write(project, "[train.polcy]\nsteps = 3")
        exwarp("train", "policy", "-o", "x").refused(2, "[train.polcy]", "did you mean policy?")
        write(project, "[train]\nsteps = 3")
        exwarp("train", "policy", "-o", "x").refused(
            2, "steps in [train] of", "[train.extrapolator]"
        )

    def test_another_commands_table_is_its_own_matter(self, parse, project):
        write(project, "[bench]\nxyzzy = 1")
        assert parse(*BEGIN)["method"] is None

    @pytest.mark.parametrize(
        ("name", "found"),
        [
            ("nope.toml", "does not exist"),
            (".", "folder"),
            ("a" * 300, "cannot be reached: File name too long"),
            ("~no-user-of-that-name/x.toml", "has that home"),
        ],
    )
    def test_files_that_are_none(self, name, found, exwarp, project, monkeypatch):
        exwarp("--config", name, *BEGIN).refused(2, "--config names", found)
        exwarp(*BEGIN, "--config", name).refused(2, "--config names", found)
        monkeypatch.setenv("EXWARP_CONFIG", name)
        exwarp(*BEGIN).refused(2, "EXWARP_CONFIG names", found)

    def test_a_file_of_a_folder_that_is_gone(self, exwarp, project):
        project.rmdir()
        exwarp("--config", "x.toml", *BEGIN).refused(2, "x.toml", "cannot be reached")

    def test_bytes_that_are_no_text(self, exwarp, project):
        (project / "exwarp.toml").write_bytes(b'[upsample]\nmethod = "\xff"')
        exwarp(*BEGIN).refused(2, "is not TOML", "UTF-8")

    @pytest.mark.parametrize(
        ("name", "text", "words"),
        [
            ("TAIL", "perhaps", ("EXWARP_UPSAMPLE_TAIL is 'perhaps'", "1 or 0")),
            ("NO_REPORT", "perhaps", ("EXWARP_UPSAMPLE_NO_REPORT is 'perhaps'",)),
            ("THREADS", "many", ("--threads is set by EXWARP_UPSAMPLE_THREADS",)),
            ("METRICS", "many", ("no metric", "--metrics is set by EXWARP_UPSAMPLE_METRICS")),
        ],
    )
    def test_variables_are_named(self, name, text, words, exwarp, project, monkeypatch):
        monkeypatch.setenv(f"EXWARP_UPSAMPLE_{name}", text)
        exwarp(*BEGIN).refused(2, *words)

    def test_what_the_pipeline_refuses_is_traced_too(
        self, exwarp, project, plain_shot, monkeypatch
    ):
        monkeypatch.setenv("EXWARP_UPSAMPLE_MOTION", "sideways")
        result = exwarp("upsample", plain_shot, "-o", "out")
        result.refused(2, "--motion 'sideways'", "--motion is set by EXWARP_UPSAMPLE_MOTION")

    def test_no_mistake_keeps_the_help_away(self, exwarp, project):
        write(project, "[upsample")
        assert exwarp("upsample", "--help").code == 0
        assert exwarp("--help").code == 0

    def test_control_characters_are_spelled_out(self, exwarp, project):
        exwarp("--config", "a\x1b[2Jb\nc", *BEGIN).refused(2, r"a\x1b[2Jb c, which does not exist")
