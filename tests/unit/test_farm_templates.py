"""Job templates as data: what comes from users is never taken for more than text."""

from __future__ import annotations

from pathlib import Path

import onnx
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from openjd.model import create_job, decode_job_template, preprocess_job_parameters

from exwarp_cli.errors import InputError, OutputExistsError, UsageError
from exwarp_cli.farm.farm_job import FarmJob, OptionValue, PathOption, locate
from exwarp_cli.farm.openjd import JobTemplate, Workers, job_template, write_bundle, yaml_text
from tests.unit.tiny_models import convolution

ROOT = Path("/shots")
TEXTS = st.text(st.characters(exclude_categories=["Cs", "Cc"]), min_size=1, max_size=60)


def job(
    *more: OptionValue, numbers: tuple[int, ...] = tuple(range(1, 31)), title: str = "a"
) -> FarmJob:
    return FarmJob((OptionValue("sequence", "", place("keys")), *more), numbers, 10, title)


def place(name: str) -> PathOption:
    return locate("report_folder", str(ROOT / name))


def words_of(template: JobTemplate) -> list[str]:
    """Return the first step's arguments, as the engine's own model fills them in."""
    model = decode_job_template(
        template=yaml.safe_load(yaml_text(template.document)),
        supported_extensions=["TASK_CHUNKING"],
    )
    values = preprocess_job_parameters(
        job_template=model,
        job_parameter_values=dict(template.values),
        job_template_dir=ROOT,
        current_working_dir=ROOT,
    )
    made = create_job(job_template=model, job_parameter_values=values)
    words = [str(word) for word in made.steps[0].script.actions.onRun.args or []]
    for name, value in values.items():
        words = [str(value.value) if w == f"{{{{Param.{name}}}}}" else w for w in words]
    return words


@given(TEXTS)
def test_any_text_comes_through(text):
    made = job_template(job(OptionValue("dynamic", "--dynamic", text)), Workers(), ROOT)
    words = words_of(made)
    assert words[words.index("--dynamic") + 1] == text


@pytest.mark.parametrize("text", ["{{Param.Frames}}", "}}", "a{{{b", "{{ }}", "{{" * 9])
def test_braces_come_through(text):
    for plain in (False, True):
        made = job_template(
            job(OptionValue("x", "--x", text), title=text), Workers(plain=plain), ROOT
        )
        words = words_of(made)
        assert words[words.index("--x") + 1] == text


@given(TEXTS)
def test_any_title_is_a_name(title):
    words_of(job_template(job(title=title), Workers(), ROOT))


def test_a_text_that_occurs_twice_is_one_parameter():
    twice = (
        OptionValue("x", "--x", "{{"),
        OptionValue("y", "--y", "{{"),
        OptionValue("z", "--z", "}}"),
    )
    made = job_template(job(*twice), Workers(), ROOT).document
    texts = [p for p in made["parameterDefinitions"] if p["name"].startswith("Text")]
    assert [p["default"] for p in texts] == ["{{", "}}"]


def test_values_that_no_template_holds():
    long = OptionValue("x", "--x", "{{" + "a" * 1023)
    with pytest.raises(UsageError, match="1025 characters"):
        job_template(job(long), Workers(), ROOT)
    spread = tuple(n * n for n in range(400))
    for plain, option in ((False, "--frames"), (True, "--chunk-size")):
        workers = Workers(plain=plain)
        large = FarmJob((), spread, 400, "a")
        with pytest.raises(UsageError, match=option):
            job_template(large, workers, ROOT)


def test_a_list_of_chunks_has_a_limit_and_ranges_have_none():
    numbers = tuple(range(30_000))
    listed = job_template(job(numbers=numbers), Workers(plain=True), ROOT)
    (frames,) = listed.document["steps"][0]["parameterSpace"]["taskParameterDefinitions"]
    assert listed.size == 30 and len(frames["range"]) == 1000
    assert job_template(job(numbers=numbers), Workers(), ROOT).size == 10
    words_of(listed)


def test_defaults_lie_below_the_template():
    above = locate("video", str(ROOT / ".." / "a.mp4"))
    made = job_template(job(OptionValue("video", "--video", above)), Workers(), ROOT)
    assert made.values == {"VideoFile": "/shots/../a.mp4"}
    here = locate("video", str(ROOT / "x" / ".." / "a.mp4"))
    assert not job_template(job(OptionValue("video", "--video", here)), Workers(), ROOT).values


def test_a_card_goes_with_its_network(tmp_path):
    (tmp_path / "net.json").write_text("{}")
    found = locate("interpolator", str(tmp_path / "net.onnx"))
    made = job_template(
        job(OptionValue("interpolator", "--interpolator", found)), Workers(), tmp_path
    )
    defaults = {p["name"]: p.get("default") for p in made.document["parameterDefinitions"]}
    assert defaults["InterpolatorFile"] == "net.onnx" and defaults["InterpolatorCard"] == "net.json"


def test_weights_go_with_their_network(tmp_path):
    options = {"save_as_external_data": True, "location": "w {{x}}.data", "size_threshold": 0}
    onnx.save(convolution(), str(tmp_path / "net.onnx"), **options)
    found = locate("extrapolator", str(tmp_path / "net.onnx"))
    made = job_template(
        job(OptionValue("extrapolator", "--extrapolator", found)), Workers(), tmp_path
    )
    defaults = {p["name"]: p.get("default") for p in made.document["parameterDefinitions"]}
    assert defaults["ExtrapolatorFile"] == "net.onnx"
    assert defaults["ExtrapolatorWeights1"] == "w {{x}}.data"
    words_of(made)


def test_paths_that_are_no_text():
    with pytest.raises(InputError, match="UTF-8"):
        locate("output", "a\udce9")


def test_a_bundle_replaces_none(tmp_path):
    made = job_template(job(), Workers(), None)
    write_bundle(tmp_path / "job", made)
    before = (tmp_path / "job" / "template.yaml").read_bytes()
    assert yaml.safe_load(before) == made.document
    with pytest.raises(OutputExistsError, match=r"template\.yaml"):
        write_bundle(tmp_path / "job", job_template(job(title="b"), Workers(), None))
    assert (tmp_path / "job" / "template.yaml").read_bytes() == before
