"""The bench that judges methods on rendered scenes, on the smallest one."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.bench import paths
from tests.unit.tiny_models import filled_warp, save

DATA = Path(__file__).parents[1] / "data" / "miniature"
NAME = "variety-0074"


def judge(folder: Path) -> list[dict]:
    model = save(folder / "tiny.onnx", filled_warp())
    options = ["--data", DATA, "--scenes", NAME, "--model", model, "--jobs", "1"]
    options += ["--methods", "s1", "s3", "s6", "--out", folder / "out", "--surface", "none"]
    assert paths.main([str(option) for option in options]) == 0
    return json.loads((folder / "out" / "paths.json").read_text())


def test_a_network_that_answers_with_the_warp_is_as_good(tmp_path, capsys, monkeypatch):
    rows, printed = judge(tmp_path), capsys.readouterr().out
    assert [row["setting"] for row in rows] == ["key", "slot"]
    for row in rows:
        found = row["methods"]
        assert found["s3"]["frames"] == found["s6"]["frames"] == 3
        for key in ("psnr_db", "ssim", "flip", "holes_psnr_db"):
            assert found["s3@2"][key] == pytest.approx(found["s6@2"][key], abs=1e-4)
        assert found["s1"]["new"] == pytest.approx(1 / 3)
        assert found["s1"]["psnr_db"] < found["s6"]["psnr_db"]
    assert f"| {NAME} | key |" in printed
    assert "+0.00" in printed

    def forbidden(*_args: object) -> None:
        raise AssertionError("judged again")

    monkeypatch.setattr(paths, "_interval", forbidden)
    assert judge(tmp_path) == rows, "what was judged is kept"
