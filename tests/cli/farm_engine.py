"""Open Job Description's own command line: the judge of templates, and an engine that runs them."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from openjd.model import decode_job_template

EXWARP = Path(sys.executable).parent / "exwarp"
"""The command as workers have it."""

HOSTILE = "a 'b\" {{Param.Frames}} x: # [é] 日本 $HOME `id` 1e3 %"
"""A name of which shells, YAML and format strings would each make something else."""


@dataclass(frozen=True)
class Ended:
    """What a command of the engine left."""

    code: int
    log: str

    @property
    def chunks(self) -> list[str]:
        """What the tasks that ran were given as frames, in order."""
        marks = (line.partition("Frames(")[2] for line in self.log.splitlines())
        return [mark.partition("= ")[2].strip() for mark in marks if mark]


def environment(folder: Path) -> dict[str, str]:
    """Return this process's, with the sessions' folders out of the way."""
    return os.environ | {"TMPDIR": str(folder), "EXWARP_CONFIG": ""}


def openjd(*arguments: object, cwd: Path) -> Ended:
    """Run a command of openjd-cli in a folder, which holds its sessions too."""
    words = [sys.executable, "-m", "openjd", *map(str, arguments)]
    ended = subprocess.run(
        words,
        cwd=cwd,
        env=environment(cwd),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        encoding="utf-8",
        timeout=600,
    )
    return Ended(ended.returncode, ended.stdout)


def checked(text: str) -> dict[str, Any]:
    """Return a template that the engine's model accepts, as ``openjd check`` asks it."""
    found = yaml.safe_load(text)
    assert isinstance(found, dict)
    decode_job_template(template=found, supported_extensions=["TASK_CHUNKING"])
    return found


def parameters(template: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the job parameters by name."""
    return {definition["name"]: definition for definition in template["parameterDefinitions"]}


def call(template: dict[str, Any], step: str) -> list[str]:
    """Return the words of a step's command, with the values of the job's parameters filled in."""
    (found,) = (entry for entry in template["steps"] if entry["name"] == step)
    action = found["script"]["actions"]["onRun"]
    words = [action["command"], *action["args"]]
    for name, definition in parameters(template).items():
        if "default" in definition:
            words = [w.replace(f"{{{{Param.{name}}}}}", str(definition["default"])) for w in words]
    return words
