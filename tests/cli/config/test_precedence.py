"""Which of several settings of an option holds."""

from __future__ import annotations

import pytest

from tests.cli.config.commands import BEGIN
from tests.cli.config.files import users, write


class TestPrecedence:
    """Each source wins over all that stand behind it."""

    SOURCES = ("command line", "environment", "nearest", "user's", "default")

    @pytest.mark.parametrize("strongest", SOURCES)
    def test_the_order(self, strongest, parse, project, monkeypatch):
        sources = self.SOURCES[self.SOURCES.index(strongest) :]
        values = {"command line": "s1", "environment": "s2", "nearest": "s3", "user's": "s4"}
        if "environment" in sources:
            monkeypatch.setenv("EXWARP_UPSAMPLE_METHOD", "s2")
        if "nearest" in sources:
            write(project, '[upsample]\nmethod = "s3"')
        if "user's" in sources:
            users(project, '[upsample]\nmethod = "s4"')
        arguments = ("-m", "s1") if "command line" in sources else ()
        assert parse(*BEGIN, *arguments)["method"] == values.get(strongest)

    def test_the_users_file_fills_what_the_nearest_leaves_out(self, parse, project):
        write(project, '[upsample]\nmethod = "s3"')
        users(project, '[upsample]\nmethod = "s4"\nthreads = 3')
        taken = parse(*BEGIN)
        assert (taken["method"], taken["threads"]) == ("s3", 3)

    def test_the_nearest_file_above_counts_alone(self, parse, project, monkeypatch):
        write(project, '[upsample]\nmethod = "s3"\nthreads = 3')
        write(project / "a", '[upsample]\nmethod = "s2"')
        (project / "a" / "b").mkdir()
        monkeypatch.chdir(project / "a" / "b")
        taken = parse(*BEGIN)
        assert (taken["method"], taken["threads"]) == ("s2", None)

    def test_a_file_that_is_named_stands_for_the_nearest(self, parse, project, monkeypatch):
        write(project, '[upsample]\nmethod = "s3"')
        users(project, "[upsample]\nthreads = 3")
        first = write(project, '[upsample]\nmethod = "s1"', "first.toml")
        second = write(project, '[upsample]\nmethod = "s2"', "second.toml")
        third = write(project, '[upsample]\nmethod = "s4"', "third.toml")
        monkeypatch.setenv("EXWARP_CONFIG", str(third))
        assert parse(*BEGIN)["method"] == "s4"
        assert parse("--config", second, *BEGIN)["method"] == "s2"
        taken = parse("--config", second, *BEGIN, "--config", first)
        assert (taken["method"], taken["threads"]) == ("s1", 3)

    @pytest.mark.parametrize("nothing", ["none", "None", ""])
    def test_files_can_be_switched_off(self, nothing, parse, project, monkeypatch):
        write(project, '[upsample]\nmethod = "s3"')
        users(project, "[upsample]\nthreads = 3")
        for arguments in (("--config", nothing, *BEGIN), (*BEGIN, "--config", nothing)):
            taken = parse(*arguments)
            assert (taken["method"], taken["threads"]) == (None, None)

    def test_several_values_are_replaced_and_not_joined(self, parse, project, monkeypatch):
        write(project, '[upsample]\naov = ["motion=a.#.exr", "depth=/b.#.exr:Z"]')
        assert parse(*BEGIN)["aovs"] == ("motion=a.#.exr", "depth=/b.#.exr:Z")
        monkeypatch.setenv("EXWARP_UPSAMPLE_AOV", "motion=c.#.exr:R,G; normal=d.#.exr")
        assert parse(*BEGIN)["aovs"] == ("motion=c.#.exr:R,G", "normal=d.#.exr")
        assert parse(*BEGIN, "--aov", "depth=e.exr")["aovs"] == ("depth=e.exr",)


class TestIsolated:
    """Calls in farm jobs do on any machine what they say."""

    def test_neither_files_nor_the_environment_count(self, parse, project, monkeypatch, capsys):
        usual = parse(*BEGIN)
        write(project, '[upsample]\nmethod = "s3"\n[merge-reports]\noverwrite = true')
        users(project, '[upsample]\nlayers = "all"')
        monkeypatch.setenv("EXWARP_CONFIG", str(project / "none.toml"))
        for name, text in (("LAYERS", "all"), ("NO_TAIL", "1"), ("MOTION", "x"), ("TAIL", "what")):
            monkeypatch.setenv(f"EXWARP_UPSAMPLE_{name}", text)
        capsys.readouterr()
        assert parse(*BEGIN, "--isolated") == usual
        assert parse("merge-reports", "--isolated", "report")["overwrite"] is False
        assert capsys.readouterr().err == "", "and no message is about them"

    def test_a_machine_has_its_own_threads_and_progress(self, parse, monkeypatch):
        monkeypatch.setenv("EXWARP_UPSAMPLE_THREADS", "3")
        monkeypatch.setenv("EXWARP_UPSAMPLE_PROGRESS", "json")
        taken = parse(*BEGIN, "--isolated")
        assert (taken["threads"], taken["progress"]) == (3, "json")
        assert parse(*BEGIN, "--isolated", "--threads", 2)["threads"] == 2

    def test_a_file_that_is_named_counts(self, parse, project):
        named = write(project, '[upsample]\nmethod = "s3"', "named.toml")
        assert parse(*BEGIN, "--isolated", "--config", named)["method"] == "s3"
        assert parse("--config", named, *BEGIN, "--isolated")["method"] == "s3"


class TestTakingBack:
    def test_a_switch(self, parse, project):
        write(project, "[upsample]\noverwrite = true")
        assert parse(*BEGIN)["overwrite"] is True
        assert parse(*BEGIN, "--no-overwrite")["overwrite"] is False

    def test_any_other_option(self, parse, project):
        write(project, '[upsample]\nreport = "r"\naov = ["motion=a.exr"]')
        taken = parse(*BEGIN, "--no-report", "--no-aov")
        assert taken["report_folder"] is None and taken["aovs"] == ()

    def test_by_a_stronger_file_and_by_the_environment(self, parse, project, monkeypatch):
        users(project, '[upsample]\nmethod = "s6"\nreport = "r"\nthreads = 2')
        write(project, "[upsample]\nno-report = true\nno-threads = false")
        monkeypatch.setenv("EXWARP_UPSAMPLE_NO_METHOD", "1")
        taken = parse(*BEGIN)
        assert (taken["method"], taken["report_folder"], taken["threads"]) == (None, None, 2)

    @pytest.mark.parametrize("line", ["tail = false", "no-tail = true"])
    def test_a_switch_that_has_two_names(self, line, parse, project):
        write(project, f"[upsample]\n{line}")
        assert parse(*BEGIN)["tail"] is False
        assert parse(*BEGIN, "--tail")["tail"] is True

    def test_beside_the_option_itself_it_is_a_mistake(self, exwarp, project):
        result = exwarp(*BEGIN, "--overwrite", "--no-overwrite")
        result.refused(2, "--overwrite and --no-overwrite", "see exwarp upsample --help")

    @pytest.mark.parametrize(
        ("line", "arguments", "silenced"),
        [
            ("skip-existing = true", ("--overwrite",), "skip_existing"),
            ("overwrite = true", ("--skip-existing",), "overwrite"),
            ("factor = 3", ("--to-fps", "60"), "factor"),
            ("to-fps = 60", ("--factor", "3"), "to_fps"),
        ],
    )
    def test_what_excludes_an_option_of_the_command_line(
        self, line, arguments, silenced, parse, project
    ):
        write(project, f"[upsample]\n{line}")
        assert parse(*BEGIN)[silenced]
        assert not parse(*BEGIN, *arguments)[silenced]

    def test_a_rival_that_is_off_silences_nothing(self, parse, project):
        users(project, "[upsample]\nskip-existing = true")
        write(project, "[upsample]\noverwrite = false")
        assert parse(*BEGIN)["skip_existing"] is True

    def test_rivals_in_one_file_are_for_the_command_to_refuse(self, parse, project):
        write(project, "[upsample]\nskip-existing = true\noverwrite = true")
        taken = parse(*BEGIN)
        assert taken["skip_existing"] and taken["overwrite"]


class TestJobs:
    """What writes upsample's runs into jobs takes what is set for upsample."""

    BEGIN = ("farm", "openjd", "shot", "-o", "out")

    def test_upsamples_settings_hold_for_them(self, parse, project, monkeypatch):
        write(project, '[upsample]\nmethod = "s3"\ncuts = "none"\nchunk-size = 3\njson = true')
        monkeypatch.setenv("EXWARP_UPSAMPLE_METRICS", "psnr")
        taken = parse(*self.BEGIN)
        assert (taken["method"], taken["cuts"], taken["metrics"]) == ("s3", "none", ("psnr_db",))
        assert taken["chunk_size"] != 3

    def test_their_own_are_stronger_within_one_source(self, parse, project, monkeypatch):
        write(project, '[upsample]\nmethod = "s3"\n[farm.openjd]\nmethod = "s4"')
        assert parse(*self.BEGIN)["method"] == "s4"
        monkeypatch.setenv("EXWARP_UPSAMPLE_METHOD", "s5")
        assert parse(*self.BEGIN)["method"] == "s5"
        monkeypatch.setenv("EXWARP_FARM_OPENJD_METHOD", "s6")
        assert parse(*self.BEGIN)["method"] == "s6"

    def test_mistakes_in_upsamples_table_are_theirs(self, exwarp, project):
        write(project, '[upsample]\nmethdo = "s3"')
        exwarp(*self.BEGIN).refused(2, "methdo in [upsample] of")
