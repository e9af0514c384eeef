"""Job templates of Open Job Description, ``jobtemplate-2023-09``.

A template is plain data, written as text or as the bundle that AWS Deadline Cloud submits. Its
steps::

    Upsample    a task a chunk
    Report      joins the chunks' reports, when all are done
    Video       makes the video of the finished frames, when all are done
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from exwarp_cli import __version__
from exwarp_cli.domain.wording import has_control_chars, pluralise
from exwarp_cli.errors import OutputExistsError, UsageError
from exwarp_cli.farm.calls import Blank, FarmJob, Word, frames_text, is_dense, split
from exwarp_cli.farm.job_parameters import BRACES, LONGEST, JobParameters
from exwarp_cli.farm.places import Place
from exwarp_cli.io.atomic import atomic_write_text, is_there, make_folder

SPECIFICATION = "jobtemplate-2023-09"
CHUNKING = "TASK_CHUNKING"
MOST_TASKS = 1024
"""Values that a task parameter's list may have."""

LONGEST_NAME = 128

Data = dict[str, Any]

_TASK_FRAMES = "{{Task.Param.Frames}}"


@dataclass(frozen=True)
class Workers:
    """What a job asks of workers and engine.

    Attributes
    ----------
    program
        Name or path of `exwarp` there.
    vcpus, memory_gib, gpus
        What a worker must have at least; None and 0 ask for nothing.
    plain
        Whether chunks are listed, for engines without the extension for chunks.
    seconds
        How long a chunk should take, which engines may follow by changing its size; 0 for the size
        alone.
    """

    program: str = "exwarp"
    vcpus: int | None = None
    memory_gib: float | None = None
    gpus: int = 0
    plain: bool = False
    seconds: int = 0


@dataclass(frozen=True)
class JobTemplate:
    """A template, and what has to be given with it.

    Attributes
    ----------
    document
        The template.
    values
        Values of the parameters without default, by name.
    size
        Key frames of a chunk: more than asked for where a list of them would be too long.
    """

    document: Data
    values: dict[str, str]
    size: int


def job_template(job: FarmJob, workers: Workers, folder: Path | None) -> JobTemplate:
    """Describe a job.

    Parameters
    ----------
    job
        What is done.
    workers
        What it asks for.
    folder
        Where the template is going to lie; None leaves all paths to be given at submission.

    Raises
    ------
    UsageError
        When something is too long for a template.
    """
    size = job.size
    if workers.plain:
        size = max(size, math.ceil(len(job.numbers) / MOST_TASKS))
    parameters = JobParameters(folder)
    steps = _Steps(job, workers, parameters, size).steps
    document = {
        "specificationVersion": SPECIFICATION,
        **({} if workers.plain else {"extensions": [CHUNKING]}),
        "name": _title(job.title),
        "description": _description(job, size),
        "parameterDefinitions": parameters.definitions,
        "steps": steps,
    }
    return JobTemplate(document, parameters.values, size)


class _Steps:
    """The steps of a job, whose parameters are defined as they are met."""

    def __init__(
        self, job: FarmJob, workers: Workers, parameters: JobParameters, size: int
    ) -> None:
        self._parameters, self._workers, self._job = parameters, workers, job
        for given in job.given:  # first of all, as people look for their files first
            if isinstance(given.value, Place):
                parameters.of_place(given.value)
        self._everything = frames_text(job.numbers)
        self._space = self._listed(size) if workers.plain else self._chunked(size)
        self._program = parameters.add(
            "ExwarpCommand",
            "STRING",
            workers.program,
            "Command",
            description="Name or path of exwarp on the workers.",
            group="ExWarp",
        )

    @property
    def steps(self) -> list[Data]:
        """All steps, in order."""
        after = [{"dependsOn": "Upsample"}]
        steps = [
            self._step("Upsample", self._job.chunk, {"parameterSpace": self._space}, needs=True)
        ]
        if self._job.merging is not None:
            steps.append(self._step("Report", self._job.merging, {"dependencies": after}))
        if self._job.filming is not None:
            steps.append(
                self._step("Video", self._job.filming, {"dependencies": after}, needs=True)
            )
        return steps

    def _step(self, name: str, call: Sequence[Word], more: Data, needs: bool = False) -> Data:
        requirements = self._requirements if needs else {}
        action = {
            "command": self._program,
            "args": [*(self._argument(word) for word in call), "--progress", "openjd"],
            # SIGTERM first, on which upsample stops with whole frames and clears up.
            "cancelation": {"mode": "NOTIFY_THEN_TERMINATE"},
        }
        return {"name": name, **more, **requirements, "script": {"actions": {"onRun": action}}}

    def _argument(self, word: Word) -> str:
        if isinstance(word, Place):
            return self._parameters.of_place(word)
        if isinstance(word, Blank):
            return _TASK_FRAMES if word is Blank.FRAMES else self._everything
        return self._parameters.of_text(word)

    def _chunked(self, size: int) -> Data:
        """Leave the cutting to the engine, by parameters of the job."""
        add = self._parameters.add
        self._everything = add(
            "Frames",
            "STRING",
            _short(self._everything, "--frames"),
            "Frames",
            description="By their numbers, such as 1001-1100, 10-90:4 or 1,5,9-12.",
            group="Chunks",
        )
        count = add("ChunkSize", "INT", size, "Key frames a chunk", minValue=1, group="Chunks")
        seconds = add(
            "ChunkSeconds",
            "INT",
            self._workers.seconds,
            "Seconds a chunk",
            description="Let the engine change the size until chunks take about as long; 0: keep "
            "the size.",
            minValue=0,
            group="Chunks",
        )
        chunks = {
            "defaultTaskCount": count,
            "targetRuntimeSeconds": seconds,
            # Of frames numbered 10, 14, 18 … each would be a contiguous range of its own.
            "rangeConstraint": "CONTIGUOUS" if is_dense(self._job.numbers) else "NONCONTIGUOUS",
        }
        frames = {"name": "Frames", "type": "CHUNK[INT]", "range": self._everything}
        return {"taskParameterDefinitions": [{**frames, "chunks": chunks}]}

    def _listed(self, size: int) -> Data:
        """Cut here, and list the chunks."""
        texts = [
            _short(frames_text(chunk), "--chunk-size") for chunk in split(self._job.numbers, size)
        ]
        return {"taskParameterDefinitions": [{"name": "Frames", "type": "STRING", "range": texts}]}

    @property
    def _requirements(self) -> Data:
        workers = self._workers
        memory = None if workers.memory_gib is None else math.ceil(workers.memory_gib * 1024)
        amounts = [
            {"name": f"amount.worker.{name}", "min": least}
            for name, least in (("vcpu", workers.vcpus), ("memory", memory), ("gpu", workers.gpus))
            if least
        ]
        return {"hostRequirements": {"amounts": amounts}} if amounts else {}


def _short(text: str, option: str) -> str:
    """Refuse key frames that take too many characters, as they do where no range joins them."""
    if len(text) > LONGEST:
        raise UsageError(
            f"the key frames {text[:40]}… take {len(text)} characters, and Open Job Description "
            f"allows {LONGEST}; choose fewer with {option}, or take 'exwarp farm commands'"
        )
    return text


def _title(text: str) -> str:
    """Make a job's name: no control characters, and nothing that would be filled in."""
    printable = "".join(c if c.isprintable() else " " for c in text)
    for pair in BRACES:
        while pair in printable:
            printable = printable.replace(pair, " ".join(pair))
    return printable[:LONGEST_NAME].strip() or "exwarp"


def _description(job: FarmJob, size: int) -> str:
    frames = pluralise(len(job.numbers), "key frame")
    chunks = pluralise(len(split(job.numbers, size)), "chunk")
    return f"{frames} upsampled in {chunks}, as ExWarp {__version__} wrote it."


TEMPLATE_FILE = "template.yaml"
VALUES_FILE = "parameter_values.yaml"

_PLAIN = re.compile(r"(--)?[A-Za-z][A-Za-z0-9_-]*")


class _Dumper(yaml.SafeDumper):
    """Quotes all strings but bare words: readers of YAML 1.2 see numbers in ``1e3`` and ``0o7``."""

    def ignore_aliases(self, data: object) -> bool:
        """Write out what occurs twice."""
        return True


def _represent_text(dumper: yaml.SafeDumper, text: str) -> yaml.ScalarNode:
    style = None if _PLAIN.fullmatch(text) else '"'
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style=style)


_Dumper.add_representer(str, _represent_text)


def yaml_text(document: dict[str, Any]) -> str:
    """Write a document as YAML that every version reads alike."""
    text = _yaml(document, as_it_is=True)
    # Of what no editor shows, such as marks that turn the direction of a line, escapes do.
    return _yaml(document, as_it_is=False) if has_control_chars(text.replace("\n", "")) else text


def _yaml(document: dict[str, Any], as_it_is: bool) -> str:
    return yaml.dump(document, Dumper=_Dumper, sort_keys=False, allow_unicode=as_it_is, width=100)


def write_bundle(folder: Path, template: JobTemplate) -> None:
    """Write a job bundle: a folder with the template and the values of its parameters.

    Raises
    ------
    OutputExistsError
        When there is a bundle already.
    OutputError
        When it cannot be written.
    """
    for name in (TEMPLATE_FILE, VALUES_FILE):
        if is_there(folder / name):
            raise OutputExistsError(
                f"{folder} has a {name} already; remove it, or name another folder with --bundle"
            )
    make_folder(folder)
    values = [{"name": name, "value": value} for name, value in template.values.items()]
    atomic_write_text(folder / VALUES_FILE, yaml_text({"parameterValues": values}))
    atomic_write_text(folder / TEMPLATE_FILE, yaml_text(template.document))
