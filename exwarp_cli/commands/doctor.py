"""``exwarp doctor``: whether this machine can do the work, and what is in force."""

from __future__ import annotations

import json
import sys
from importlib.util import find_spec
from typing import TYPE_CHECKING

import click

from exwarp_cli import __version__
from exwarp_cli.commands.options import json_option
from exwarp_cli.domain.wording import printable

if TYPE_CHECKING:
    from exwarp_cli.pipeline.doctor.checkup import CheckResult, DoctorReport

_STYLES = {"ok": "green", "warning": "yellow", "failed": "bold red", "skipped": "dim"}


@click.command("doctor")
@click.option("-v", "--verbose", is_flag=True, help="List everything that was found.")
@click.option(
    "--skip-self-test",
    is_flag=True,
    help="Upsample nothing; where no kernel is compiled yet, that takes a minute.",
)
@json_option
@click.pass_context
def command(ctx: click.Context, verbose: bool, skip_self_test: bool, as_json: bool) -> None:
    """Check the installation, and tell what is in force.

    Looks at the machine, the packages, the networks, the codecs and the caches, and upsamples a
    tiny shot whose every pixel is known. All checks are made, whatever the first ones find; the
    exit code is 10 if one failed. Warnings tell of what ExWarp can do its work without.
    """
    from exwarp_cli.errors import InstallationError
    from exwarp_cli.pipeline.doctor.checkup import run_checks

    report = run_checks(not skip_self_test, {"configuration": lambda: _check_configuration(ctx)})
    if as_json:
        # Not by `print_json`, which needs numpy, and that may be what is broken.
        click.echo(json.dumps(report.as_dict(), indent=2))
    else:
        _print_report(report, verbose)
    if report.outcome == "failed":
        raise InstallationError(report.verdict())


def _check_configuration(ctx: click.Context) -> CheckResult:
    """Tell which options files and the environment set."""
    from exwarp_cli.config import configuration
    from exwarp_cli.pipeline.doctor.checkup import CheckResult, failure, variables, warning

    config, environment = configuration(ctx), variables()
    files = [f"{file.path} ({file.how})" for file in config.files]
    lines = [
        f"exwarp {' '.join(setting.command)}: {setting.option} {setting.text} ({setting.origin})"
        for setting in config.settings
    ]
    lines += [f"{name}={value}" for name, value in environment.items()]
    facts = {
        "files": [{"path": str(file.path), "how": file.how} for file in config.files],
        "settings": [
            {"command": list(s.command), "option": s.option, "text": s.text, "origin": s.origin}
            for s in config.settings
        ],
        "environment": environment,
    }
    count = len(config.settings)
    summary = ", ".join(files) or "no exwarp.toml"
    summary += f"; {count or 'no'} option{'' if count == 1 else 's'} set"
    remarks = (*map(failure, config.problems), *map(warning, config.warnings))
    return CheckResult(summary, remarks, facts, tuple(lines))


def _print_report(report: DoctorReport, verbose: bool) -> None:
    """Print a page: a row for each check, in colour and wrapped on a terminal."""
    facts = report.checks["machine"].facts if "machine" in report.checks else {}
    machine = " ".join(facts[name] for name in ("system", "architecture") if facts.get(name))
    python = f", {facts['implementation']} {facts['python']}" if "python" in facts else ""
    heading = f"exwarp {__version__}{' on ' if machine else ''}{machine}{python}"
    page = [(name.replace("_", " "), check) for name, check in report.checks.items()]
    # Where checks failed, it is the error.
    verdict = "" if report.outcome == "failed" else report.verdict()
    if not sys.stdout.isatty() or find_spec("rich") is None:
        width = max(len(name) for name, _ in page)
        lines = [heading]
        for name, check in page:
            lines.append(f"{check.outcome:<8} {name:<{width}}  {printable(check.found)}")
            below = [f"- {printable(remark.text)}" for remark in check.remarks]
            below += [f"  {printable(text)}" for text in check.lines if verbose]
            lines += [f"{'':<8} {'':<{width}}  {line}" for line in below]
        # At once, so that a reader who goes after the first lines does not break it off.
        click.echo("\n".join([*lines, *([verdict] if verdict else [])]))
        return
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table.grid(padding=(0, 2))
    for name, check in page:
        style, found = _STYLES[check.outcome], Text(printable(check.found))
        table.add_row(Text(check.outcome, style, no_wrap=True), name, found)
        details = Table.grid(padding=(0, 1))
        for remark in check.remarks:
            details.add_row("-", Text(printable(remark.text), style))
        for text in check.lines if verbose else ():
            details.add_row("", Text(printable(text), "dim", overflow="fold"))
        if details.row_count:
            table.add_row("", "", details)
    console = Console(highlight=False)
    console.print(Text(heading))
    console.print(table)
    if verdict:
        console.print(Text(verdict))
