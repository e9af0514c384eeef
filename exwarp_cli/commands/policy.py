"""``exwarp policy``: the learned policy and the accelerator that runs it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from exwarp_cli import __version__
from exwarp_cli.commands.options import FILE, json_option, print_json, show

# Cores, or MAC units of a core: a mistyped number must not fill the memory.
MOST = 4096

POLICY = click.option(
    "--policy", type=FILE, metavar="FILE", help="Policy; default: the one that comes with ExWarp."
)
CORES = click.option("--cores", type=click.IntRange(1, MOST), default=4, show_default=True)
MACS = click.option(
    "--macs", type=click.IntRange(1, MOST), default=10, show_default=True, help="Of each core."
)
PORT = click.option(
    "--port",
    type=click.IntRange(0, MOST),
    default=0,
    show_default=True,
    metavar="BYTES",
    help="Bytes a cycle of the port that brings what caches do not hold; 0: it costs no cycles.",
)


@click.group("policy", subcommand_metavar="[COMMAND] [ARGS]...")
def command() -> None:
    """Look into the learned policy and its accelerator."""


@command.command("cycles", short_help="Cycles, utilisation and cache traffic of an inference.")
@click.option("--clock", default="1GHz", show_default=True, metavar="RATE", help="As 500MHz, 1e9.")
@CORES
@MACS
@click.option("--cache", default="16KB", show_default=True, metavar="SIZE", help="Of each core.")
@PORT
@click.option("--policy", type=FILE, metavar="FILE", help="Default: the paper's network.")
@json_option
def cycles(
    clock: str, cores: int, macs: int, cache: str, port: int, policy: Path | None, as_json: bool
) -> None:
    """Show how long one inference takes on the paper's accelerator, or on one of other sizes."""
    from rich.console import Console

    from exwarp_cli.pipeline import predictor
    from exwarp_cli.report.command_text import cycles_document, cycles_lines, cycles_table

    rate = predictor.clock_of(clock)
    inference = predictor.cycles(policy, cores, macs, cache, port)
    if as_json:
        print_json(cycles_document(inference, rate))
        return
    Console(highlight=False, soft_wrap=True).print(cycles_table(inference))
    for line in cycles_lines(inference, rate):
        click.echo(line)


@command.command("run", short_help="Decide the states of a table.")
@click.argument("table", metavar="FEATURES.csv", type=FILE)
@POLICY
@click.option("--trace", is_flag=True, help="Show one inference layer by layer.")
@click.option("--row", type=click.IntRange(1), help="Only this row; the header does not count.")
@json_option
def run(table: Path, policy: Path | None, trace: bool, row: int | None, as_json: bool) -> None:
    """Run the policy on every state of FEATURES.csv and print its outputs and decisions as CSV.

    The states stand in the column 'inputs', as frames.csv of a report and exwarp features write
    them: Q16.16 integers with spaces between. With --trace, the first of them, or that of --row.
    """
    from exwarp_cli.pipeline import predictor
    from exwarp_cli.report import command_text
    from exwarp_cli.report.schema import format_csv

    if trace:
        traced = predictor.trace_row(table, policy, row)
        if as_json:
            print_json(command_text.trace_document(traced))
        else:
            click.echo("\n".join(command_text.trace_lines(traced)))
        return
    rows = predictor.decide_rows(table, policy, row)
    if as_json:
        schema = predictor.DECISIONS_SCHEMA
        print_json({"schema": schema, "version": __version__, "rows": rows})
    else:
        click.echo(format_csv(list(rows[0]), (list(cells.values()) for cells in rows)), nl=False)


@command.command("export", short_help="Write hex files for a Verilog test bench.")
@click.argument("folder", metavar="DIR", type=FILE)
@POLICY
@click.option(
    "--vectors",
    type=click.IntRange(1, 100_000),
    default=32,
    show_default=True,
    help="To test with.",
)
@click.option(
    "--seed", type=click.IntRange(0), default=0, show_default=True, help="Of the vectors."
)
@click.option("--verilog", is_flag=True, help="Write the design, a test bench and a Makefile, too.")
@CORES
@MACS
# 20 KB hold the shipped network; 16 KB do not.
@click.option("--cache", default="20KB", show_default=True, metavar="SIZE", help="Of each core.")
@PORT
@click.option("--overwrite", is_flag=True, help="Replace files of the same names.")
@json_option
def export(
    folder: Path,
    policy: Path | None,
    vectors: int,
    seed: int,
    verilog: bool,
    overwrite: bool,
    as_json: bool,
    **sizes: Any,
) -> None:
    """Write weights, biases, multipliers, shifts and test vectors into DIR for $readmemh.

    README.txt and manifest.json there say which core reads what, and where it lies. With --verilog,
    'make' in DIR simulates the predictor with Icarus Verilog and fails on any difference.
    """
    from exwarp_cli.pipeline.predictor import MANIFEST, machine
    from exwarp_cli.pipeline.predictor import export as write

    array = machine(**sizes)
    files = write(
        folder,
        policy,
        vectors=vectors,
        seed=seed,
        overwrite=overwrite,
        array=array,
        verilog=verilog,
    )
    if as_json:
        print_json(
            {
                "schema": "exwarp.policy-export/1",
                "folder": str(folder),
                "manifest": MANIFEST,
                "files": [path.name for path in files],
                "vectors": vectors,
                "seed": seed,
            }
        )
    else:
        show(f"{folder}: {len(files)} files, {vectors} test vectors; see README.txt")
