"""The Python API does what the commands do, and raises what they exit with."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from exwarp_cli import api
from exwarp_cli.domain.settings import SourceSettings
from tests.cli import shots
from tests.cli.shots import FORWARD

MOTION = FORWARD[1]


def settings(keys: Path, out: Path, **options: object) -> api.UpsampleSettings:
    return api.UpsampleSettings(
        SourceSettings(str(keys), motion=MOTION), str(out), method="s6", threads=1, **options
    )


def test_it_writes_the_bytes_of_the_command_in_silence(upsample, plain_shot, tmp_path, capfd):
    upsample(plain_shot, tmp_path / "a", "-m", "s6", *FORWARD)
    result = api.upsample(settings(plain_shot, tmp_path / "b"), report=tmp_path / "report")
    assert capfd.readouterr() == ("", "")
    assert shots.contents(tmp_path / "b") == shots.contents(tmp_path / "a")
    assert result.is_complete
    assert result.document["frames"]["generated"] == 9
    assert result.document == json.loads((tmp_path / "report" / "report.json").read_text())
    assert result.report_folder == tmp_path / "report"


def test_a_chunk_has_a_report_of_its_own(plain_shot, tmp_path):
    chunk = settings(plain_shot, tmp_path / "out", frames="2")
    result = api.upsample(chunk, report=tmp_path / "report", is_chunk=True)
    assert result.report_folder is not None
    assert result.report_folder == tmp_path / "report" / "chunks" / "2"
    assert (result.report_folder / "run.json").is_file()


def test_it_inspects_as_the_command_does(exwarp, plain_shot):
    inspection = api.inspect(SourceSettings(str(plain_shot), motion=MOTION))
    printed = json.loads(exwarp("inspect", plain_shot, *FORWARD, "--json").out)
    assert json.loads(json.dumps(inspection.as_dict())) == printed


def test_it_compares_as_the_command_does(exwarp, upsample, plain_shot, plain_truth, tmp_path):
    out = tmp_path / "out"
    upsample(plain_shot, out, "-m", "s6", *FORWARD, "--no-tail")
    document = api.compare(plain_truth, out).document
    printed = json.loads(exwarp("compare", plain_truth, out, "--json").out)
    assert document["quality"] == printed["quality"]
    assert document["quality"]["generated"]["psnr_db"] > 20


def test_what_a_user_can_cause_is_one_error(plain_shot, tmp_path):
    with pytest.raises(api.ExwarpError, match="no frame"):
        api.inspect(SourceSettings(str(tmp_path / "missing.####.exr")))
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "shot.0001.exr").touch()
    with pytest.raises(api.ExwarpError) as caught:
        api.upsample(settings(plain_shot, tmp_path / "out"))
    assert caught.value.exit_code == 6
