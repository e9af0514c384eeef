"""``exwarp farm openjd``: templates that the engine's own checker accepts, whatever is in them."""

from __future__ import annotations

import inspect
import json
from dataclasses import fields
from pathlib import Path

import click
import pytest
import yaml

from exwarp_cli.commands import farm, upsample
from exwarp_cli.domain.settings import SourceSettings, UpsampleSettings
from exwarp_cli.farm.farm_job import PATH_ROLES
from exwarp_cli.option_values import names_paths
from tests.cli import shots
from tests.cli.farm_engine import HOSTILE, call, checked, parameters
from tests.cli.shots import FORWARD, SMALL


@pytest.fixture
def shot(tmp_path, monkeypatch) -> Path:
    """Four key frames in the current folder."""
    monkeypatch.chdir(tmp_path)
    return shots.sequence(tmp_path / "keys", shots.plain, range(1, 5), SMALL)


@pytest.fixture
def template(exwarp):
    """Run the command in the current folder, and check what it prints."""

    def make(*options: object, said: str = "") -> dict:
        result = exwarp("farm", "openjd", *options, *FORWARD)
        assert result.code == 0, result.err
        assert said in result.err if said else result.err == ""
        return checked(result.out)

    return make


class TestChunks:
    def test_the_engine_cuts(self, shot, template):
        made = template("keys", "-o", "out", "--chunk-size", 3)
        assert made["extensions"] == ["TASK_CHUNKING"]
        (step,) = made["steps"]
        (frames,) = step["parameterSpace"]["taskParameterDefinitions"]
        assert frames["type"] == "CHUNK[INT]" and frames["range"] == "{{Param.Frames}}"
        assert frames["chunks"]["rangeConstraint"] == "CONTIGUOUS"
        definitions = parameters(made)
        assert definitions["Frames"]["default"] == "1-4"
        assert definitions["ChunkSize"]["default"] == 3
        assert definitions["ChunkSeconds"]["default"] == 0

    def test_frames_in_steps_are_no_contiguous_ranges(self, tmp_path, monkeypatch, template):
        monkeypatch.chdir(tmp_path)
        shots.sequence(tmp_path / "keys", shots.plain, (-4, 0, 4), SMALL)
        made = template("keys", "-o", "out")
        (frames,) = made["steps"][0]["parameterSpace"]["taskParameterDefinitions"]
        assert frames["chunks"]["rangeConstraint"] == "NONCONTIGUOUS"
        assert parameters(made)["Frames"]["default"] == "-4-4:4"

    def test_a_plain_template_lists_them(self, shot, template):
        made = template("keys", "-o", "out", "--chunk-size", 3, "--plain")
        assert "extensions" not in made
        (frames,) = made["steps"][0]["parameterSpace"]["taskParameterDefinitions"]
        assert frames == {"name": "Frames", "type": "STRING", "range": ["1-3", "4"]}
        assert not {"Frames", "ChunkSize"} & set(parameters(made))

    def test_a_list_that_would_be_too_long_has_larger_chunks(self, shot, template, monkeypatch):
        monkeypatch.setattr("exwarp_cli.farm.openjd.MOST_TASKS", 2)
        made = template(
            "keys", "-o", "out", "--chunk-size", 1, "--plain", said="2 key frames, not 1"
        )
        (frames,) = made["steps"][0]["parameterSpace"]["taskParameterDefinitions"]
        assert frames["range"] == ["1-2", "3-4"]

    def test_frames_are_those_selected(self, shot, template):
        made = template("keys", "-o", "out", "--frames", "2,4", "--video", "a.mp4")
        assert parameters(made)["Frames"]["default"] == "2,4"
        words = call(made, "Video")
        assert words[words.index("--frames") + 1] == "2,4"

    def test_key_frames_that_take_too_many_characters(self, shot, exwarp, monkeypatch):
        monkeypatch.setattr("exwarp_cli.farm.openjd.frames_text", lambda _: ",".join(["1-4"] * 300))
        result = exwarp("farm", "openjd", "keys", "-o", "out", *FORWARD)
        result.refused(2, "1-4", "--frames", "farm commands")


class TestCalls:
    def test_a_task_goes_on_and_tells(self, shot, template):
        words = call(template("keys", "-o", "out", "-m", "s6", "--no-tail"), "Upsample")
        assert words[:3] == ["exwarp", "upsample", "--isolated"]
        assert words[3:7] == ["keys", "--output", "out/", "--method"] and "--no-tail" in words
        assert words[-5:] == [
            "--skip-existing", "--frames", "{{Task.Param.Frames}}", "--progress", "openjd",
        ]  # fmt: skip

    def test_overwriting_is_asked_for(self, shot, template):
        words = call(template("keys", "-o", "out", "--overwrite"), "Upsample")
        assert "--overwrite" in words and "--skip-existing" not in words

    @pytest.fixture
    @staticmethod
    def truth(shot) -> Path:
        """The truth of `shot`, beside it."""
        return shots.truth(Path("truth"), 4, street=SMALL)

    def test_what_comes_last(self, truth, template):
        more = ("--report", "report", "--video", "a.mp4", "--exposure", "-1.5")
        judged = ("--ground-truth", truth, "--metrics", "flicker,psnr", "--write-holes", "holes")
        made = template("keys", "-o", "out", *more, *judged)
        chunk, report, video = (call(made, s) for s in ("Upsample", "Report", "Video"))
        assert chunk[chunk.index("--report") + 1 :][:2] == ["report", "--as-chunk"]
        assert "--video" not in chunk and chunk[chunk.index("--metrics") + 1] == "psnr,flicker"
        joining = ["exwarp", "merge-reports", "--isolated", "report", "--overwrite"]
        assert report == [*joining, "--progress", "openjd"]
        assert {"--skip-existing", "--exposure", "-1.5", "a.mp4"} < set(video)
        # what is there already needs neither judging nor its masks
        assert not {"--report", "--ground-truth", "--metrics", "--write-holes"} & set(video)
        assert [step.get("dependencies") for step in made["steps"][1:]] == [
            [{"dependsOn": "Upsample"}]
        ] * 2

    def test_an_oracle_needs_its_truth_for_the_video(self, truth, network, template):
        model = ("--ground-truth", truth, "-m", "oracle", "--extrapolator", network)
        made = template("keys", "-o", "out", *model, "--video", "a.mp4", said="Extrapolator")
        assert "--ground-truth" in call(made, "Video")

    def test_a_task_that_is_cancelled_may_clear_up(self, shot, template):
        for step in template("keys", "-o", "out", "--video", "a.mp4")["steps"]:
            action = step["script"]["actions"]["onRun"]
            assert action["cancelation"] == {"mode": "NOTIFY_THEN_TERMINATE"}

    def test_what_a_worker_needs(self, shot, network, template):
        (step,) = template("keys", "-o", "out")["steps"]
        assert "hostRequirements" not in step
        model = ("-m", "s3", "--extrapolator", network, "--device", "cuda")
        needs = ("--vcpus", 8, "--memory", 1.5)
        made = template("keys", "-o", "out", *needs, *model, said="Extrapolator")
        (step,) = made["steps"]
        assert "cuda" in call(made, "Upsample")
        assert step["hostRequirements"]["amounts"] == [
            {"name": "amount.worker.vcpu", "min": 8},
            {"name": "amount.worker.memory", "min": 1536},
            {"name": "amount.worker.gpu", "min": 1},
        ]

    def test_what_the_environment_sets_goes_along(self, shot, template, monkeypatch):
        """Workers have another one."""
        monkeypatch.setenv("EXWARP_UPSAMPLE_METHOD", "s6")
        words = call(template("keys", "-o", "out", said="environment"), "Upsample")
        assert words[words.index("--method") + 1] == "s6"

    def test_another_name_and_command(self, shot, template, tmp_path):
        made = template("keys", "-o", "out", "--name", "SQ {{10}}\n", "--command", "bin/exwarp")
        assert made["name"] == "SQ { {10} }"
        assert parameters(made)["ExwarpCommand"]["default"] == str(tmp_path / "bin" / "exwarp")


class TestPlaces:
    def test_what_a_job_reads_and_writes(self, shot, template):
        shots.sequence(Path("vectors"), shots.plain, range(1, 5), SMALL)
        Path("map.toml").write_text('schema = "exwarp.channel-map/1"\n')
        aov = ("--aov", "depth=vectors/shot.####.exr:Z", "--channel-map", "map.toml")
        made = template(
            "keys/shot.####.exr",
            "-o",
            "out/new.####.exr",
            *aov,
            "--report",
            "r",
            "--video",
            "a.mp4",
        )
        definitions = parameters(made)
        places = {
            name: (p["objectType"], p["dataFlow"], p["default"])
            for name, p in definitions.items()
            if p["type"] == "PATH"
        }
        assert places == {
            "SequenceFolder": ("DIRECTORY", "IN", "keys"),
            "OutputFolder": ("DIRECTORY", "OUT", "out"),
            "AovDepthFolder": ("DIRECTORY", "IN", "vectors"),
            "ChannelMapFile": ("FILE", "IN", "map.toml"),
            "ReportFolder": ("DIRECTORY", "OUT", "r"),
            "VideoFile": ("FILE", "OUT", "a.mp4"),
        }
        assert definitions["SequencePattern"]["default"] == "shot.####.exr"
        words = call(made, "Upsample")
        assert {"keys/shot.####.exr", "out/new.####.exr", "depth=vectors/shot.####.exr:Z"} < set(
            words
        )

    def test_the_aovs_of_a_channel_map_are_found_elsewhere_too(self, shot, template):
        shots.sequence(Path("vectors"), shots.plain, range(1, 5), SMALL)
        Path("map.toml").write_text(
            'schema = "exwarp.channel-map/1"\n[aovs]\ndepth = "vectors/shot.####.exr:Z"\n'
        )
        words = call(template("keys", "-o", "out", "--channel-map", "map.toml"), "Upsample")
        assert words[words.index("--aov") + 1] == "depth=vectors/shot.####.exr:Z"

    def test_paths_elsewhere_are_given_at_submission(self, shot, template, tmp_path_factory):
        elsewhere = tmp_path_factory.mktemp("else where")
        made = template("keys", "-o", elsewhere, said=f"-p 'OutputFolder={elsewhere}'")
        definitions = parameters(made)
        assert "default" not in definitions["OutputFolder"]
        assert definitions["SequenceFolder"]["default"] == "keys"

    def test_a_view_for_a_folder(self, tmp_path, monkeypatch, template):
        monkeypatch.chdir(tmp_path)
        for view in ("left", "right"):
            shots.sequence(tmp_path / "eyes" / view, shots.plain, (1, 2), SMALL)
        made = template("eyes/%V/shot.####.exr", "-o", "out", "--view", "right")
        definitions = parameters(made)
        assert definitions["SequenceFolder"]["default"] == "eyes"
        assert definitions["SequencePattern"]["default"] == "%V/shot.####.exr"

    def test_hostile_names_are_taken_as_they_are(self, tmp_path, monkeypatch, template):
        monkeypatch.chdir(tmp_path)
        folder = tmp_path / HOSTILE
        for number in (1, 2):
            shots.plain(folder / f"{HOSTILE}.{number:04d}.exr", SMALL, number)
        made = template(
            f"{HOSTILE}/{HOSTILE}.####.exr",
            "-o",
            f"out {HOSTILE}/",
            "--name",
            HOSTILE,
        )
        definitions = parameters(made)
        assert definitions["SequenceFolder"]["default"] == HOSTILE
        assert definitions["SequencePattern"]["default"] == f"{HOSTILE}.####.exr"
        assert definitions["OutputFolder"]["default"] == f"out {HOSTILE}"
        literal = json.dumps(made["steps"]).replace("{{Param.", "").replace("{{Task.Param.", "")
        assert "{{" not in literal and "{{" not in made["name"]

    @pytest.mark.parametrize("name", ["a\nb", "a\x1b[1mb", "a\u202eb", "a\u2028b", "!!x", "~", "-"])
    def test_what_no_editor_shows_is_escaped(self, tmp_path, monkeypatch, exwarp, name):
        monkeypatch.chdir(tmp_path)
        shots.sequence(tmp_path / name, shots.plain, (1, 2), SMALL)
        for more in ((), ("--plain",), ("--json",)):
            result = exwarp("farm", "openjd", f"./{name}", "-o", f"out{name}/", *FORWARD, *more)
            assert result.code == 0 and result.out.replace("\n", "").isprintable()
            definitions = parameters(checked(result.out))
            assert definitions["SequenceFolder"]["default"] == name
            assert definitions["OutputFolder"]["default"] == f"out{name}"
        bundle = exwarp("farm", "openjd", f"./{name}", "-o", "o/", *FORWARD, "--bundle", f"b{name}")
        assert bundle.out.rstrip("\n").isprintable()
        made = checked((tmp_path / f"b{name}" / "template.yaml").read_text("utf-8"))
        assert "default" not in parameters(made)["SequenceFolder"]
        values = yaml.safe_load(
            (tmp_path / f"b{name}" / "parameter_values.yaml").read_text("utf-8")
        )
        assert str(tmp_path / name) in [value["value"] for value in values["parameterValues"]]

    def test_texts_that_readers_take_for_numbers_are_quoted(self, tmp_path, monkeypatch, exwarp):
        monkeypatch.chdir(tmp_path)
        shots.sequence(tmp_path / "1e3", shots.plain, (1, 2), SMALL)
        text = exwarp("farm", "openjd", "1e3", "-o", "0o17", *FORWARD).out
        assert 'default: "1e3"' in text and 'default: "0o17"' in text

    def test_a_bundle_for_deadline_cloud(self, shot, exwarp, tmp_path):
        options = ("farm", "openjd", "keys", "-o", "out", *FORWARD, "--bundle", "job")
        result = exwarp(*options)
        assert result.code == 0 and "deadline bundle submit job" in result.out
        made = checked((tmp_path / "job" / "template.yaml").read_text())
        assert all("default" not in p for p in parameters(made).values() if p["type"] == "PATH")
        values = yaml.safe_load((tmp_path / "job" / "parameter_values.yaml").read_text())
        assert values == {
            "parameterValues": [
                {"name": "SequenceFolder", "value": str(tmp_path / "keys")},
                {"name": "OutputFolder", "value": str(tmp_path / "out")},
            ]
        }
        exwarp(*options).refused(6, "job", "template.yaml", "--bundle")

    def test_json_is_a_template_too(self, shot, exwarp):
        result = exwarp("farm", "openjd", "keys", "-o", "out", *FORWARD, "--json")
        assert checked(result.out) == json.loads(result.out)


class TestRefusals:
    """What upsample would refuse on the farm is refused here."""

    @pytest.mark.parametrize(
        ("options", "code", "words"),
        [
            (("-m", "magic"), 2, ["magic"]),
            (("--frames", "1-9"), 3, ["5-9"]),
            (("-m", "oracle"), 2, ["--ground-truth"]),
            (("--extrapolator", "none.onnx", "-m", "s3"), 3, ["none.onnx"]),
            (("-m", "s6", "--device", "cuda"), 2, ["--device cuda", "s6"]),
            (("--metrics", "psnr,beauty"), 2, ["beauty"]),
            (("--overwrite", "--skip-existing"), 2, ["--overwrite", "--skip-existing"]),
            (("--chunk-size", "0"), 2, ["--chunk-size"]),
            (("--progress", "plain"), 2, ["--progress"]),
        ],
    )
    @pytest.mark.parametrize("command", ["openjd", "commands"])
    def test_refused(self, shot, exwarp, command, options, code, words):
        exwarp("farm", command, "keys", "-o", "out", *FORWARD, *options).refused(code, *words)
        assert not Path("out").exists()

    def test_a_video_is_no_output_of_chunks(self, shot, exwarp):
        exwarp("farm", "openjd", "keys", "-o", "a.mp4", *FORWARD).refused(2, "a.mp4", "--video")

    def test_frames_in_the_way(self, shot, exwarp, template):
        shots.plain(Path("out") / "shot.0002.exr", SMALL, 0)
        exwarp("farm", "openjd", "keys", "-o", "out", *FORWARD).refused(6, "2", "--skip-existing")
        template("keys", "-o", "out", "--skip-existing")

    @pytest.mark.parametrize("place", ["report", "report/chunks/1-2"])
    def test_a_report_in_the_way(self, shot, exwarp, template, place):
        Path(place).mkdir(parents=True)
        (Path(place) / "report.json").write_text("{}")
        options = ("keys", "-o", "out", "--report", "report")
        exwarp("farm", "openjd", *options, *FORWARD).refused(6, "report", "--overwrite")
        template(*options, "--overwrite")

    def test_names_that_are_no_text(self, exwarp, tmp_path):
        folder = tmp_path / "a\udce9"
        try:
            shots.sequence(tmp_path / "keys", shots.plain, (1, 2), SMALL).rename(folder)
        except (OSError, UnicodeError):
            pytest.skip("the file system takes text alone")
        exwarp("farm", "openjd", folder, "-o", tmp_path / "out", *FORWARD).refused(3, "UTF-8")


class TestOptions:
    """The options are those of upsample, and come through whatever they are."""

    def test_all_of_them_are_known(self):
        for command in (farm.openjd, farm.commands):
            own = {p.name for p in command.params}
            assert {p.name for p in upsample.command.params} - own <= farm.NOT_SHARED

    def test_those_that_name_files_have_a_purpose(self):
        for parameter in farm.SHARED_PARAMETERS:
            named = parameter.name == "sequence" or names_paths(parameter)
            assert named == (parameter.name in PATH_ROLES), parameter.name

    def test_each_is_part_of_the_settings_or_the_commands_own(self):
        settled = {f.name for kind in (SourceSettings, UpsampleSettings) for f in fields(kind)}
        parameters = inspect.signature(upsample.command.callback).parameters.values()
        own = {p.name for p in parameters if p.kind is not p.VAR_KEYWORD}
        assert not settled & own
        # `replaces_foreign` is for a process that goes on after one with --overwrite.
        inner = {"source", "replaces_foreign"}
        assert settled - inner | own == {p.name for p in upsample.command.params}

    def test_they_are_written_as_they_were_given(self):
        words = ["keys"]
        for parameter in farm.SHARED_PARAMETERS:
            if isinstance(parameter, click.Option) and parameter.name not in farm.ADDED:
                words += sample(parameter)
        context = upsample.command.make_context("upsample", list(words))
        given = list(farm.option_values(context.params))
        again = [word for _, flag, value in given for word in (flag, value) if word]
        found = upsample.command.make_context("upsample", again).params
        assert found == context.params
        assert {name for name, _, _ in given} | farm.ADDED == {
            p.name for p in farm.SHARED_PARAMETERS
        }

    def test_defaults_are_left_out(self):
        context = upsample.command.make_context("upsample", ["keys", "-o", "out"])
        assert list(farm.option_values(context.params)) == [
            ("sequence", "", "keys"),
            ("output", "--output", "out"),
        ]


def sample(option: click.Option) -> list[str]:
    """Return an option with a value that is not its default."""
    if option.is_flag:
        return [(option.secondary_opts or option.opts)[-1]]
    if option.name == "metrics":
        return [option.opts[-1], "flicker,psnr"]
    if isinstance(option.type, click.Choice):
        other = next(choice for choice in option.type.choices if choice != option.default)
        return [option.opts[-1], other]
    values = {"fps": "23.976", "float": "-1.5", "float range": "0.5", "path": "a b"}
    value = values.get(option.type.name, "3" if "integer" in option.type.name else "x {{y}}")
    many = ["--aov", "depth=b"] if option.multiple else []
    return [option.opts[-1], value, *many]
