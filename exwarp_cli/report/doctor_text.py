"""What ``exwarp doctor`` found, as rows of a page that fits a terminal.

Nothing here needs a package that may be broken, which is what doctor is there to report.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from exwarp_cli.domain.wording import enumerated, printable
from exwarp_cli.pipeline.doctor.checkup import DoctorReport, Outcome

_TITLES = {"exr": "EXR"}


@dataclass(frozen=True)
class CheckRow:
    """A check of `exwarp doctor`, as a row of its page."""

    outcome: Outcome
    name: str
    found: str
    remarks: tuple[str, ...]  # what is wrong with it
    more: tuple[str, ...]  # what only --verbose shows


def doctor_heading(checkup: DoctorReport) -> str:
    """Return the first line: ExWarp's version, the system and Python's."""
    facts = checkup.checks["machine"].facts if "machine" in checkup.checks else {}
    machine = [facts[name] for name in ("system", "architecture") if facts.get(name)]
    python = f", {facts['implementation']} {facts['python']}" if "python" in facts else ""
    return f"exwarp {checkup.version}{' on ' if machine else ''}{' '.join(machine)}{python}"


def doctor_rows(checkup: DoctorReport, verbose: bool) -> list[CheckRow]:
    """Return the page's rows."""
    return [
        CheckRow(
            check.outcome,
            _check_title(name),
            printable(check.found),
            tuple(printable(remark.text) for remark in check.remarks),
            tuple(map(printable, check.lines)) if verbose else (),
        )
        for name, check in checkup.checks.items()
    ]


def _check_title(name: str) -> str:
    return _TITLES.get(name, name.replace("_", " "))


def doctor_lines(page: list[CheckRow]) -> Iterator[str]:
    """Yield the page's lines for files and pipes."""
    width = max(len(row.name) for row in page)
    for row in page:
        yield f"{row.outcome:<8} {row.name:<{width}}  {row.found}"
        details = (*(f"- {text}" for text in row.remarks), *(f"  {text}" for text in row.more))
        yield from (f"{'':<8} {'':<{width}}  {line}" for line in details)


def doctor_verdict(checkup: DoctorReport) -> str | None:
    """Sum up an examination without a failure; None for one with any."""
    if checkup.outcome is Outcome.FAILED:
        return None
    warnings = [_check_title(name) for name in checkup.names(Outcome.WARNING)]
    if warnings:
        return f"everything that is needed works; see the warnings on {enumerated(warnings)}"
    skipped = checkup.names(Outcome.SKIPPED)
    return "everything that was tried works" if skipped else "everything works"


def doctor_failures(checkup: DoctorReport) -> str:
    """Sum up an examination with failures."""
    failed = [_check_title(name) for name in checkup.names(Outcome.FAILED)]
    what = "line under it says" if len(failed) == 1 else "lines under them say"
    return (
        f"{len(failed)} of {len(checkup.checks)} checks failed ({enumerated(failed)}); do what the "
        f"{what}"
    )
