"""Options out of config files and the environment: which holds, what they take, what is refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import pytest

from exwarp_cli import cli
from exwarp_cli.commands import configured
from exwarp_cli.commands.layers import configurable, variable_name
from exwarp_cli.commands.option_values import long_name

Parse = Callable[..., dict[str, Any]]


def every_command() -> list[tuple[click.Command, tuple[str, ...]]]:
    root = click.Context(cli.exwarp, info_name="exwarp")
    return [(command, path) for _, command, path in configured._every_command(root)]


EVERY_OPTION = [
    pytest.param(command, path, option, id=f"{'.'.join(path)}:{long_name(option)}")
    for command, path in every_command()
    for option in configurable(command)
]
SAMPLES = (
    "s6", "psnr", "psnr=30", "flip=0.1", "2", "17", "0.5", "motion=a/b.exr", "10MHz", "tcp://a:1"
)  # fmt: skip


@pytest.fixture
def project(tmp_path, monkeypatch) -> Path:
    """A folder to work in, with no config file in or above it, and an empty home."""
    folder = tmp_path / "project"
    folder.mkdir()
    monkeypatch.chdir(folder)
    monkeypatch.delenv("EXWARP_CONFIG")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "home"))
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    return folder


@pytest.fixture
def parse(project, monkeypatch, capsys) -> Parse:
    """Run a command line up to where the command would begin; return what it would be given."""
    taken: list[dict[str, Any]] = []

    def instead(callback: object) -> Callable[..., None]:
        return lambda **parameters: taken.append(parameters)

    monkeypatch.setattr(configured, "_announcing", instead)

    def run(*arguments: object) -> dict[str, Any]:
        taken.clear()
        code = cli.run([str(argument) for argument in arguments])
        assert code == 0, capsys.readouterr().err
        return taken[0]

    return run


def write(folder: Path, text: str, name: str = "exwarp.toml") -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_text(text)
    return folder / name


def users(project: Path, text: str) -> Path:
    return write(project.parent / "home" / "exwarp", text)


def needed(command: click.Command, but: click.Option) -> list[str]:
    """Arguments that a command cannot do without."""
    words: list[str] = []
    for parameter in command.params:
        if isinstance(parameter, click.Argument):
            choices = getattr(parameter.type, "choices", ("frames",))
            words += [choices[0]] if parameter.required else []
        elif parameter.required and long_name(parameter) != long_name(but):
            choices = getattr(parameter.type, "choices", ("out",))
            words += [f"--{long_name(parameter)}", choices[0]]
    return words


def sampled(option: click.Option, parse: Parse, begin: list[str]) -> tuple[str, dict[str, Any]]:
    """Find a value that the command line takes and that changes something."""
    usual = parse(*begin) if not option.required else {}
    for text in (*getattr(option.type, "choices", ()), *SAMPLES):
        try:
            taken = parse(*begin, f"--{long_name(option)}", text)
        except AssertionError:
            continue
        if taken != usual:
            return text, taken
    raise AssertionError("no sample suits")


class TestEveryOption:
    @pytest.mark.parametrize(("command", "path", "option"), EVERY_OPTION)
    def test_it_can_stand_in_a_file_and_in_the_environment(
        self, command, path, option, parse, project, monkeypatch
    ):
        begin, name = [*path, *needed(command, option)], long_name(option)
        if option.is_flag:
            value, text = ("false", "0") if option.default is True else ("true", "1")
            word = option.secondary_opts[0] if value == "false" else f"--{name}"
            wanted = parse(*begin, word)
            assert wanted != parse(*begin)
        else:
            text, wanted = sampled(option, parse, begin)
            value = text if text.isdigit() else json.dumps(text)
        file = write(project, f"[{'.'.join(path)}]\n{name} = {value}\n")
        assert parse(*begin) == wanted
        file.unlink()
        monkeypatch.setenv(variable_name(path, name), text)
        assert parse(*begin) == wanted

    def test_groups_have_none_of_their_own(self):
        for name in cli.COMMANDS:
            command = cli.exwarp.get_command(click.Context(cli.exwarp), name)
            if isinstance(command, click.Group):
                assert configurable(command) == []

    def test_no_command_is_called_as_another_variable(self):
        begins = tuple(variable_name(path) for _, path in every_command())
        assert not [name for name in configured.OTHER_VARIABLES if f"{name}_".startswith(begins)]

    def test_rivals_are_options(self):
        from exwarp_cli.commands.layers import RIVALS

        known = [
            {long_name(one) for one in configurable(command)} for command, _ in every_command()
        ]
        for rivals in RIVALS:
            assert any(rivals <= names for names in known), rivals

    def test_the_commands_of_the_modules_stay_as_they_are(self):
        from exwarp_cli.commands.upsample import command

        before = list(command.params)
        cli.exwarp.get_command(click.Context(cli.exwarp), "upsample")
        assert command.params == before and command.epilog is None


BEGIN = ("upsample", "shot", "-o", "out")


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


class TestValues:
    def test_lists_may_be_arrays(self, parse, project):
        write(project, '[upsample]\nmetrics = ["psnr", "vmaf"]\ncuts = [1045, 1101]\nframes = 7')
        taken = parse(*BEGIN)
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
            ("[upsample]\nthreads = true", ("a whole number, and is true or false",)),
            ("[upsample]\nexposure = 'a'", ("a number, and is text",)),
            ("[upsample]\ntail = 1", ("true or false, and is a whole number",)),
            ("[upsample]\nno-report = 1", ("no-report in", "must be true or false")),
            ("[upsample]\nmethod = ['s6']", ("must be text, and is an array",)),
            ("[upsample]\nreport = 4", ("text, a path, and is a whole number",)),
            ("[upsample]\nmethod = 2026-01-01", ("must be text, and is a date",)),
            ("[upsample.method]\na = 1", ("must be text, and is a table",)),
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

    @pytest.mark.parametrize(("name", "found"), [("nope.toml", "does not exist"), (".", "folder")])
    def test_files_that_are_none(self, name, found, exwarp, project, monkeypatch):
        exwarp("--config", name, *BEGIN).refused(2, "--config names", found)
        exwarp(*BEGIN, "--config", name).refused(2, "--config names", found)
        monkeypatch.setenv("EXWARP_CONFIG", name)
        exwarp(*BEGIN).refused(2, "EXWARP_CONFIG names", found)

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
    """What `exwarp doctor` is told."""

    def look(self) -> configured.Configuration:
        root = click.Context(cli.exwarp, info_name="exwarp")
        root.params["config"] = None
        return configured.configuration(click.Context(click.Command("doctor"), parent=root))

    def test_files_and_settings(self, project, monkeypatch):
        near = write(project, '[upsample]\nmethod = "s6"\n[train.policy]\nsteps = 7')
        own = users(project, '[upsample]\nmethod = "s5"\nthreads = 2')
        monkeypatch.setenv("EXWARP_BENCH_EVERY", "3")
        found = self.look()
        assert [(f.path, f.how) for f in found.files] == [
            (near, "nearest folder"),
            (own, "user's own"),
        ]
        told = {(*one.command, one.option): (one.text, one.origin) for one in found.settings}
        assert told["upsample", "method"] == ("s6", f"method in [upsample] of {near}")
        assert told["upsample", "threads"] == ("2", f"threads in [upsample] of {own}")
        assert told["train", "policy", "steps"][0] == "7"
        assert told["bench", "every"] == ("3", "EXWARP_BENCH_EVERY")
        assert found.problems == ()

    def test_problems(self, project, monkeypatch):
        write(project, '[upsample]\nmethdo = "s6"\n[bench]\nevery = "x"')
        monkeypatch.setenv("EXWARP_UPSMAPLE_METHOD", "s6")
        monkeypatch.setenv("EXWARP_TRAIN_POLICY_STEPZ", "6")
        told = "\n".join(self.look().problems)
        for words in ("methdo in", "every in", "EXWARP_UPSMAPLE_METHOD", "POLICY_STEPZ"):
            assert words in told

    def test_a_broken_file_is_one_problem(self, project):
        write(project, "[upsample")
        (problem,) = self.look().problems
        assert "is not TOML" in problem

    def test_doctor_is_not_stopped_by_it(self, exwarp, project, monkeypatch):
        write(project, "[upsample")
        monkeypatch.setattr(configured, "_announcing", lambda callback: lambda **_: None)
        assert exwarp("doctor").code == 0
        exwarp("inspect", "x").refused(2, "is not TOML")
