"""Where users read of settings that hold: messages of commands, help pages and doctor."""

from __future__ import annotations

import json

import click

from exwarp_cli import cli, config
from exwarp_cli.config import variable_name
from tests.cli.config.commands import every_command
from tests.cli.config.files import users, write


class TestWhatIsSaid:
    def test_options_of_files_and_variables_are_named(
        self, exwarp, project, plain_shot, monkeypatch
    ):
        file = write(project, '[inspect]\nmotion = "forward"\njson = true')
        monkeypatch.setenv("EXWARP_INSPECT_VIEW", "")
        monkeypatch.setenv("EXWARP_INSPECT_NO_JSON", "1")
        result = exwarp("inspect", plain_shot)
        assert result.code == 0
        assert (
            f"exwarp: options from the environment: --no-json; from {file}: --motion forward\n"
            in (result.err)
        )

    def test_nothing_is_said_where_nothing_is_set(self, exwarp, project, plain_shot):
        write(project, '[upsample]\nmethod = "s6"')
        assert "options from" not in exwarp("inspect", plain_shot).err

    def test_events_stay_events(self, exwarp, project, plain_shot):
        write(project, '[upsample]\nmethod = "hold"\nprogress = "json"')
        result = exwarp("upsample", plain_shot, "-o", "out")
        assert result.code == 0
        events = [json.loads(line) for line in result.err.splitlines()]
        assert "--method hold" in events[0]["text"]

    def test_unknown_variables_are_warned_of(self, exwarp, project, plain_shot, monkeypatch):
        monkeypatch.setenv("EXWARP_INSPECT_MOTOIN", "forward")
        result = exwarp("inspect", plain_shot)
        assert result.code == 0
        assert "EXWARP_INSPECT_MOTOIN in the environment is no option" in result.err
        assert "did you mean EXWARP_INSPECT_MOTION?" in result.err

    def test_each_help_page_tells_of_them(self, exwarp):
        for _, path in every_command():
            out = " ".join(exwarp(*path, "--help").out.split())
            if path != ("completion",):
                assert f"[{'.'.join(path)}]" in out and variable_name(path) in out
                assert "--no-no" not in out and "take_back" not in out
        assert "EXWARP_UPSAMPLE_METHOD" in exwarp("--help").out


class TestFindings:
    """The configuration that `exwarp doctor` reads."""

    def look(self) -> config.Configuration:
        root = click.Context(cli.exwarp, info_name="exwarp")
        root.params["config"] = None
        return config.configuration(click.Context(click.Command("doctor"), parent=root))

    def test_files_and_settings(self, project, monkeypatch):
        near = write(project, '[upsample]\nmethod = "s6"\n[train.policy]\nsteps = 7')
        own = users(project, '[upsample]\nmethod = "s5"\nthreads = 2')
        monkeypatch.setenv("EXWARP_BENCH_EVERY", "3")
        found = self.look()
        assert [(f.path, f.how) for f in found.files] == [
            (near, "nearest folder"),
            (own, "user's own"),
        ]
        settings = {(*one.command, one.option): (one.text, one.origin) for one in found.settings}
        assert settings["upsample", "method"] == ("s6", f"method in [upsample] of {near}")
        assert settings["upsample", "threads"] == ("2", f"threads in [upsample] of {own}")
        assert settings["train", "policy", "steps"][0] == "7"
        assert settings["bench", "every"] == ("3", "EXWARP_BENCH_EVERY")
        assert found.problems == () and found.warnings == ()

    def test_the_users_file_counts_once_where_it_is_the_nearest(self, project, monkeypatch):
        own = users(project, "[upsample]\nthreads = 2")
        monkeypatch.chdir(own.parent)
        found = self.look()
        assert [(f.path, f.how) for f in found.files] == [(own, "nearest folder")]

    def test_a_folder_of_that_name_is_no_file(self, project, monkeypatch):
        near = write(project, "[upsample]\nthreads = 2")
        (project / "shots" / near.name).mkdir(parents=True)
        monkeypatch.chdir(project / "shots")
        assert [f.path for f in self.look().files] == [near] and self.look().problems == ()

    def test_problems(self, project, monkeypatch):
        write(project, '[upsample]\nmethdo = "s6"\n[bench]\nevery = "x"')
        monkeypatch.setenv("EXWARP_UPSMAPLE_METHOD", "s6")
        monkeypatch.setenv("EXWARP_TRAIN_POLICY_STEPZ", "6")
        found = self.look()
        for words, sentence in zip(("methdo in", "every in"), found.problems, strict=True):
            assert words in sentence
        strange = ("EXWARP_TRAIN_POLICY_STEPZ", "EXWARP_UPSMAPLE_METHOD")
        for name, sentence in zip(strange, found.warnings, strict=True):
            assert sentence.startswith(f"{name} in the environment is no option of")

    def test_options_of_upsample_count_once(self, project):
        """Though commands that write runs of it into jobs take them over."""
        write(project, '[upsample]\nmethod = "s6"\nlayers = "all"\n[farm.openjd]\nlayers = "a"')
        settings = [(*one.command, one.option, one.text) for one in self.look().settings]
        assert settings == [
            ("upsample", "method", "s6"),
            ("upsample", "layers", "all"),
            ("farm", "openjd", "layers", "a"),
        ]

    def test_values_that_their_options_refuse(self, project, monkeypatch):
        """Which stop commands only when they run."""
        file = write(project, "[upsample]\nfactor = 99\nmetrics = ['x']\nthreads = 2")
        monkeypatch.setenv("EXWARP_INSPECT_JSON", "1")
        monkeypatch.setenv("EXWARP_BENCH_EVERY", "often")
        found = self.look()
        options = ("--factor", "--metrics", "--every")
        for name, sentence in zip(options, found.problems, strict=True):
            assert f"{name} is set by " in sentence
        assert "99 is not in the range" in found.problems[0] and str(file) in found.problems[0]
        assert "no metric" in found.problems[1]
        assert len(found.settings) == 5

    def test_a_broken_file_is_one_problem(self, project):
        write(project, "[upsample")
        (problem,) = self.look().problems
        assert "is not TOML" in problem

    def test_doctor_is_not_stopped_by_it(self, parse, project):
        write(project, "[upsample")
        assert not parse("doctor")["verbose"]

    def test_others_are(self, exwarp, project):
        write(project, "[upsample")
        exwarp("inspect", "x").refused(2, "is not TOML")
