"""``exwarp farm``: upsample on machines that something else gives work to."""

from __future__ import annotations

import os
import shlex
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from exwarp_cli.commands import upsample
from exwarp_cli.commands.options import FILE, combined, json_option, print_json, show
from exwarp_cli.domain.metric import METRICS
from exwarp_cli.domain.settings import DEFAULT_CHUNK_SIZE

if TYPE_CHECKING:
    from exwarp_cli.farm.farm_job import FarmJob

# Options of `upsample` that are for a run on this machine, or are set by the farm.
NOT_SHARED = frozenset(
    {"progress", "cluster", "workers", "chunk_size", "dry_run", "as_chunk", "as_json"}
)

# The argument and the options of `upsample` that a farm's job has, too.
SHARED_PARAMETERS = [p for p in upsample.command.params if p.name not in NOT_SHARED]

# Options of `upsample` that each call gets of its own.
ADDED = frozenset({"frames", "skip_existing", "overwrite"})

# Of what `commands` prints with ``--json``.
SCHEMA = "exwarp.chunks/1"


@click.group("farm", subcommand_metavar="[COMMAND] [ARGS]...")
def command() -> None:
    """Write jobs for render farms, and lists of chunks.

    A chunk is a part of the key frames, done by one call of 'exwarp upsample' on any machine; all
    together write the bytes of a single run. What upsample would refuse is refused here.
    """


def _absolute(_context: click.Context, _parameter: click.Parameter, program: str) -> str:
    # Workers have another current folder; a name without one is looked up there.
    return str(Path(program).absolute()) if Path(program).name != program else program


# Both commands take `chunk_size`, `program` and `as_json`.
_chunk_options = combined(
    click.option(
        "--chunk-size",
        type=click.IntRange(1),
        default=DEFAULT_CHUNK_SIZE,
        show_default=True,
        help="Key frames a chunk.",
    ),
    click.option(
        "--command",
        "program",
        default="exwarp",
        show_default=True,
        metavar="NAME|PATH",
        callback=_absolute,
        help="What exwarp is called on the workers.",
    ),
    json_option,
)


@command.command("openjd", params=[*SHARED_PARAMETERS])
@_chunk_options
@click.option("--plain", is_flag=True, help="List the chunks, for engines without TASK_CHUNKING.")
@click.option(
    "--chunk-seconds",
    type=click.IntRange(0),
    default=0,
    show_default=True,
    help="Let the engine change the size until chunks take so long; 0 keeps it.",
)
@click.option("--name", "title", metavar="TEXT", help="Of the job; else the sequence's.")
@click.option("--vcpus", type=click.IntRange(1), help="Cores that a worker needs at least.")
@click.option(
    "--memory",
    type=click.FloatRange(0, min_open=True),
    metavar="GIB",
    help="Memory that a worker needs at least.",
)
@click.option(
    "--bundle",
    type=FILE,
    metavar="DIR",
    help="Write a job bundle there, for 'deadline bundle submit DIR'.",
)
def openjd(
    plain: bool,
    chunk_seconds: int,
    title: str | None,
    vcpus: int | None,
    memory: float | None,
    bundle: Path | None,
    chunk_size: int,
    program: str,
    as_json: bool,
    **options: Any,
) -> None:
    """Print a job template of Open Job Description.

    Further options are those of 'exwarp upsample'. Files, key frames and the size of chunks become
    parameters of the job, which can be changed when it is submitted.

    Save the template in the current folder, 'exwarp farm openjd … > template.yaml': files below it
    are named relative to the template. Others have to be named at submission; what to add is said.
    """
    from exwarp_cli.farm.openjd import Workers, job_template, write_bundle, yaml_text

    job = _open_job(options, chunk_size, title)
    gpus = int(options["device"] == "cuda")
    workers = Workers(program, vcpus, memory, gpus, plain, chunk_seconds)
    template = job_template(job, workers, Path.cwd() if bundle is None else None)
    if bundle is not None:
        write_bundle(bundle, template)
    if template.size > job.size:
        show(
            f"exwarp: chunks have {template.size} key frames, not {job.size}, as the list of "
            "chunks would be too long for Open Job Description; without --plain any size does",
            err=True,
        )
    if template.values and bundle is None:
        values = (f"-p {shlex.quote(f'{name}={value}')}" for name, value in template.values.items())
        show(
            "exwarp: add at submission, as these are not below the current folder: "
            f"{' '.join(values)}",
            err=True,
        )
    if as_json:
        print_json(template.document)
    elif bundle is None:
        click.echo(yaml_text(template.document).encode(), nl=False)  # UTF-8 wherever it goes
    else:
        show(f"job bundle in {bundle}: deadline bundle submit {shlex.quote(str(bundle))}")


@command.command("commands", params=[*SHARED_PARAMETERS])
@_chunk_options
def commands(chunk_size: int, program: str, as_json: bool, **options: Any) -> None:
    """Print a command line for each chunk.

    Further options are those of 'exwarp upsample'. The commands may run in any order, side by side,
    and again; paths in them are absolute. With --report or --video, what to run when all are done
    is said on stderr.
    """
    from exwarp_cli.farm.farm_job import command_lines, shell_line

    chunks, afterwards = command_lines(_open_job(options, chunk_size, None), program)
    if as_json:
        documents = [{"frames": frames, "command": words} for frames, words in chunks]
        print_json({"schema": SCHEMA, "chunks": documents, "afterwards": afterwards})
        return
    for _, words in chunks:
        click.echo(os.fsencode(shell_line(words)))  # names as the disk has them, for any terminal
    for words in afterwards:
        show(f"exwarp: when all are done: {shell_line(words)}", err=True)


def _open_job(options: Mapping[str, Any], chunk_size: int, title: str | None) -> FarmJob:
    """Look at everything now that the chunks will need."""
    from exwarp_cli.errors import OutputExistsError
    from exwarp_cli.farm.farm_job import open_farm_job
    from exwarp_cli.io.files import path_exists
    from exwarp_cli.report.folder import REPORT_FILE, chunk_reports

    settings, folder = upsample.settings_of(options), options["report_folder"]
    keeps_report = folder is None or settings.overwrite or settings.skip_existing
    # The job would mix a report that is there, or those of chunks, with its own.
    if not keeps_report and (path_exists(folder / REPORT_FILE) or chunk_reports(folder)):
        raise OutputExistsError(
            f"{folder} holds a report already, or those of chunks; give --skip-existing to go on "
            "with it, --overwrite to replace it, or another --report"
        )
    return open_farm_job(settings, list(option_values(options)), chunk_size, title)


def option_values(options: Mapping[str, Any]) -> Iterator[tuple[str, str, str | None]]:
    """Yield what differs from the defaults, wherever it was set: name, flag and value.

    Defaults are left out: calls are isolated, so that a worker sets nothing but its own threads.
    """
    for parameter in SHARED_PARAMETERS:
        name, value = str(parameter.name), options[str(parameter.name)]
        if name in ADDED or value in (None, (), parameter.default):
            continue
        if isinstance(parameter, click.Argument):
            yield name, "", str(value)
            continue
        assert isinstance(parameter, click.Option)
        if parameter.is_flag:
            flags = parameter.opts if value else parameter.secondary_opts
            if flags:  # else it is off, and there is no way to say so
                yield name, flags[-1], None
        elif parameter.multiple:
            yield from ((name, parameter.opts[-1], str(item)) for item in value)
        elif isinstance(value, tuple):  # what --metrics made of its list
            yield name, parameter.opts[-1], ",".join(m.option for m in METRICS if m.field in value)
        else:
            yield name, parameter.opts[-1], str(value)
