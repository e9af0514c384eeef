"""``exwarp doctor`` in a known environment, and single checks of it."""

from __future__ import annotations

import json
import os
from typing import Any

import pytest

from exwarp_cli.pipeline.doctor import checkup


@pytest.fixture(autouse=True)
def plain_environment(monkeypatch, tmp_path) -> None:
    """Hide the files and variables of the user who runs the tests."""
    for name in list(os.environ):
        if name.startswith(("EXWARP_", "NUMBA_CACHE_DIR", "IMAGEIO_")):
            monkeypatch.delenv(name)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def examined(exwarp, monkeypatch):
    """Run some of the checks; return the exit code and the document."""

    def run(*names: str) -> tuple[int, dict[str, Any]]:
        chosen = {name: checkup.CHECKS[name] for name in names}
        with monkeypatch.context() as patch:
            patch.setattr(checkup, "CHECKS", chosen)
            result = exwarp("doctor", "--json")
        document = json.loads(result.out)
        assert list(document["checks"]) == ["configuration", *names]
        if result.code:
            errors = result.err.splitlines()
            assert len(errors) == 1 and errors[0].startswith("exwarp: error: "), result.err
        return result.code, document

    return run
