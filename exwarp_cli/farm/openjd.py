"""Job templates of Open Job Description, ``jobtemplate-2023-09``.

A template is plain data, written as text or as the bundle that AWS Deadline Cloud submits. Steps::

    Upsample    a task for each chunk
    Report      joins the chunks' reports, when all are done
    Video       makes the video of the finished frames, when all are done
"""

from __future__ import annotations

import math
import os.path
import re
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import yaml

from exwarp_cli import __version__
from exwarp_cli.domain.wording import pluralise, printable
from exwarp_cli.errors import OutputExistsError, UsageError
from exwarp_cli.farm.farm_job import FarmJob, PathOption, Placeholder, frames_text, split
from exwarp_cli.io.files import atomic_write_text, make_folder, path_exists

MOST_TASKS = 1024  # values that a task parameter's list may have
LONGEST = 1024  # characters that a parameter's value may have
LONGEST_NAME = 128
TEMPLATE_FILE = "template.yaml"
VALUES_FILE = "parameter_values.yaml"

# What stands around the name of a value in a format string. Nothing escapes them, so texts that
# have them become parameters, whose values are taken literally.
BRACES = ("{{", "}}")

_BARE_WORD = re.compile(r"(--)?[A-Za-z][A-Za-z0-9_-]*")

Data = dict[str, Any]


@dataclass(frozen=True)
class Workers:
    """What a job asks of workers and engine."""

    program: str = "exwarp"  # name or path of `exwarp` there
    # vcpus, memory_gib, gpus: what a worker must have at least; None and 0 ask for nothing
    vcpus: int | None = None
    memory_gib: float | None = None
    gpus: int = 0
    plain: bool = False  # whether chunks are listed, for engines without the extension for chunks
    # How long a chunk should take, which engines may reach by changing its size; 0 fixes the size
    seconds: int = 0


@dataclass(frozen=True)
class JobTemplate:
    """A template, and what has to be submitted with it."""

    document: Data
    values: dict[str, str]  # values of the parameters without default, by name
    size: int  # key frames of a chunk: more than asked for where a list of chunks would be too long


def job_template(job: FarmJob, workers: Workers, folder: Path | None) -> JobTemplate:
    """Describe a job for a template in `folder`; None leaves all paths to be given at submission.

    UsageError: something is too long for a template.
    """
    parameters = _Parameters(folder)
    for option in job.options:  # first, as people look for their files first
        if isinstance(option.value, PathOption):
            parameters.add_argument(option.value)
    size = job.size
    all_frames = frames_text(job.numbers)
    ranges, culprit = [all_frames], "--frames"
    if workers.plain:
        size = max(size, math.ceil(len(job.numbers) / MOST_TASKS))
        ranges = [frames_text(chunk) for chunk in split(job.numbers, size)]
        culprit = "--chunk-size"
    for frames in ranges:
        if len(frames) > LONGEST:
            raise UsageError(
                f"the key frames {frames[:40]}… take {len(frames)} characters, and Open Job "
                f"Description allows {LONGEST}; choose fewer with {culprit}, or take 'exwarp farm "
                "commands'"
            )
    space: Data = {"name": "Frames", "type": "STRING", "range": ranges}
    if not workers.plain:
        all_frames, space = _chunked_frames(job, workers, parameters)
    # Without control characters, and without what would be filled in.
    name = "".join(c if c.isprintable() else " " for c in job.title)
    name = re.sub(r"([{}])(?=\1)", r"\1 ", name)
    chunks = pluralise(len(split(job.numbers, size)), "chunk")
    frame_count = pluralise(len(job.numbers), "key frame")
    document = {
        "specificationVersion": "jobtemplate-2023-09",
        **({} if workers.plain else {"extensions": ["TASK_CHUNKING"]}),
        "name": name[:LONGEST_NAME].strip() or "exwarp",
        "description": f"{frame_count} upsampled in {chunks}, as ExWarp {__version__} wrote it.",
        "parameterDefinitions": parameters.definitions,
        "steps": _steps(job, workers, parameters, all_frames, space),
    }
    return JobTemplate(document, parameters.values, size)


@dataclass
class _Parameters:
    """The job parameters of a template, defined as its commands need them."""

    # The folder of the template. Engines read a default path relative to it, and refuse one that
    # leads out of it; None gives no path a default.
    folder: Path | None
    definitions: list[Data] = field(default_factory=list)  # as the template lists them
    # Values of those without default, which must be given when the job is submitted, by name
    values: dict[str, str] = field(default_factory=dict)
    _formats: dict[object, str] = field(default_factory=dict)

    def add(
        self,
        name: str,
        default: str | int,
        label: str,
        group: str,
        hidden: bool = False,
        **more: Any,
    ) -> str:
        """Define a parameter with a default; return how a format string refers to it.

        UsageError: the default is too long.
        """
        _require_length(str(default), label)
        kind = "INT" if isinstance(default, int) else "STRING"
        shown = {"label": label, "groupLabel": group} | ({"control": "HIDDEN"} if hidden else {})
        self.definitions.append(
            {"name": name, "type": kind, "default": default, **more, "userInterface": shown}
        )
        return f"{{{{Param.{name}}}}}"

    def add_argument(self, word: str | PathOption) -> str:
        """Return the format string of an argument; define the parameters that it needs, once."""
        if word in self._formats:
            return self._formats[word]
        if isinstance(word, PathOption):
            role = word.role
            group, flow = ("Output", "OUT") if role.is_written else ("Input", "IN")
            name = f"{role.name}{'File' if word.is_file else 'Folder'}"
            paths = {name: (word.path, role.label)}
            for kind, path in word.companions.items():
                paths[f"{role.name}{kind}"] = path, f"{role.label}: {kind.lower()}"
            for parameter, (path, label) in paths.items():
                definition: Data = {
                    "name": parameter,
                    "type": "PATH",
                    "objectType": "FILE" if word.is_file else "DIRECTORY",
                    "dataFlow": flow,
                    "userInterface": {"label": label, "groupLabel": group},
                }
                normal = Path(os.path.normpath(path))
                if self.folder is not None and normal.is_relative_to(self.folder):
                    definition["default"] = normal.relative_to(self.folder).as_posix()
                else:
                    self.values[parameter] = str(path)
                _require_length(str(path), label)
                self.definitions.append(definition)
            if word.pattern:
                pattern, label = f"{word.pattern}{word.after}", f"{role.label}: names"
                remainder = "/" + self.add(f"{role.name}Pattern", pattern, label, group)
            else:
                remainder = self.add_argument(word.remainder)
            text = f"{word.before}{{{{Param.{name}}}}}{remainder}"
        elif any(pair in word for pair in BRACES):
            name = f"Text{len(self.definitions)}"
            text = self.add(name, word, name, "ExWarp", hidden=True)
        else:
            text = word
        self._formats[word] = text
        return text


def _chunked_frames(job: FarmJob, workers: Workers, parameters: _Parameters) -> tuple[str, Data]:
    """Return all frames, and a task parameter that the engine divides, by parameters of the job."""
    all_frames = parameters.add(
        "Frames",
        frames_text(job.numbers),
        "Frames",
        "Chunks",
        description="By their numbers, such as 1001-1100, 10-90:4 or 1,5,9-12.",
    )
    count = parameters.add("ChunkSize", job.size, "Key frames a chunk", "Chunks", minValue=1)
    seconds = parameters.add(
        "ChunkSeconds",
        workers.seconds,
        "Seconds a chunk",
        "Chunks",
        description="Let the engine change the size until chunks take about as long; 0: keep "
        "the size.",
        minValue=0,
    )
    # Frames numbered 10, 14, 18 … would each be a contiguous range.
    is_dense = len(job.numbers) < 2 or any(b - a == 1 for a, b in pairwise(job.numbers))
    chunks = {
        "defaultTaskCount": count,
        "targetRuntimeSeconds": seconds,
        "rangeConstraint": "CONTIGUOUS" if is_dense else "NONCONTIGUOUS",
    }
    frames = {"name": "Frames", "type": "CHUNK[INT]", "range": all_frames, "chunks": chunks}
    return all_frames, frames


def _steps(
    job: FarmJob, workers: Workers, parameters: _Parameters, all_frames: str, space: Data
) -> list[Data]:
    program = parameters.add(
        "ExwarpCommand",
        workers.program,
        "Command",
        "ExWarp",
        description="Name or path of exwarp on the workers.",
    )
    references = {Placeholder.FRAMES: "{{Task.Param.Frames}}", Placeholder.ALL_FRAMES: all_frames}

    memory = None if workers.memory_gib is None else math.ceil(workers.memory_gib * 1024)
    least = {"vcpu": workers.vcpus, "memory": memory, "gpu": workers.gpus}
    amounts = [
        {"name": f"amount.worker.{name}", "min": value} for name, value in least.items() if value
    ]
    requires: Data = {"hostRequirements": {"amounts": amounts}} if amounts else {}
    after: Data = {"dependencies": [{"dependsOn": "Upsample"}]}
    tasks = {"parameterSpace": {"taskParameterDefinitions": [space]}}
    steps = []
    for name, command in {"Upsample": job.chunk, **job.afterwards}.items():
        more = tasks if name == "Upsample" else after
        if name != "Report":
            more = more | requires
        args = [
            references[word] if isinstance(word, Placeholder) else parameters.add_argument(word)
            for word in command
        ]
        action = {
            "command": program,
            "args": [*args, "--progress", "openjd"],
            # SIGTERM first: upsample then ends with complete frames and removes its temporaries.
            "cancelation": {"mode": "NOTIFY_THEN_TERMINATE"},
        }
        steps.append({"name": name, **more, "script": {"actions": {"onRun": action}}})
    return steps


def _require_length(value: str, label: str) -> None:
    if len(value) > LONGEST:
        raise UsageError(
            f"the value of {label!r} has {len(value)} characters, and Open Job Description takes "
            f"{LONGEST} at most; shorten it, or take 'exwarp farm commands'"
        )


class _Dumper(yaml.SafeDumper):
    """Quotes all strings but bare words: YAML 1.2 reads numbers in ``1e3`` and ``0o7``."""

    def ignore_aliases(self, data: object) -> bool:
        """Write in full what occurs twice."""
        return True


_Dumper.add_representer(
    str,
    lambda dumper, text: dumper.represent_scalar(
        "tag:yaml.org,2002:str", text, style=None if _BARE_WORD.fullmatch(text) else '"'
    ),
)


def yaml_text(document: Data) -> str:
    """Write a document as YAML that every version reads alike."""
    style: dict[str, Any] = {"Dumper": _Dumper, "sort_keys": False, "width": 100}
    text: str = yaml.dump(document, allow_unicode=True, **style)
    lines = text.replace("\n", "")
    if printable(lines) != lines:
        # Invisible characters, such as marks that turn the direction of a line, are escaped.
        text = yaml.dump(document, allow_unicode=False, **style)
    return text


def write_bundle(folder: Path, template: JobTemplate) -> None:
    """Write a job bundle: a folder with the template and the values of its parameters.

    OutputExistsError: there is a bundle already. OutputError: it cannot be written.
    """
    for name in (TEMPLATE_FILE, VALUES_FILE):
        if path_exists(folder / name):
            raise OutputExistsError(
                f"{folder} has a {name} already; remove it, or name another folder with --bundle"
            )
    make_folder(folder)
    values = [{"name": name, "value": value} for name, value in template.values.items()]
    atomic_write_text(folder / VALUES_FILE, yaml_text({"parameterValues": values}))
    atomic_write_text(folder / TEMPLATE_FILE, yaml_text(template.document))
