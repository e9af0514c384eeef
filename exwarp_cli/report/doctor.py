"""What ``exwarp doctor`` found, as rows of a page that fits a terminal."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from exwarp_cli.domain.wording import enumerated, printable
from exwarp_cli.pipeline.doctor.examine import Checkup, Outcome

_TITLES = {"exr": "EXR"}


@dataclass(frozen=True)
class Row:
    """A check on the page.

    Attributes
    ----------
    outcome
        How it ended.
    name
        Of the check.
    found
        What is there.
    remarks
        What is wrong with it.
    more
        What only --verbose shows.
    """

    outcome: Outcome
    name: str
    found: str
    remarks: tuple[str, ...]
    more: tuple[str, ...]


def heading(checkup: Checkup) -> str:
    """Return the first line: what runs on what."""
    facts = checkup.checks["machine"].facts if "machine" in checkup.checks else {}
    machine = [facts[name] for name in ("system", "architecture") if facts.get(name)]
    python = f", {facts['implementation']} {facts['python']}" if "python" in facts else ""
    return f"exwarp {checkup.version}{' on ' if machine else ''}{' '.join(machine)}{python}"


def rows(checkup: Checkup, verbose: bool) -> list[Row]:
    """Return the page's rows."""
    return [
        Row(
            check.outcome,
            title(name),
            printable(check.found),
            tuple(printable(remark.text) for remark in check.remarks),
            tuple(map(printable, check.lines)) if verbose else (),
        )
        for name, check in checkup.checks.items()
    ]


def title(name: str) -> str:
    """Return the name of a check as people read it."""
    return _TITLES.get(name, name.replace("_", " "))


def plain(page: list[Row]) -> Iterator[str]:
    """Yield the page's lines for files and pipes."""
    width = max(len(row.name) for row in page)
    for row in page:
        yield f"{row.outcome:<8} {row.name:<{width}}  {row.found}"
        rest = (*(f"- {text}" for text in row.remarks), *(f"  {text}" for text in row.more))
        yield from (f"{'':<8} {'':<{width}}  {line}" for line in rest)


def verdict(checkup: Checkup) -> str | None:
    """Sum up an examination without a failure; None for one with any."""
    if checkup.outcome is Outcome.FAILED:
        return None
    warnings = [title(name) for name in checkup.names(Outcome.WARNING)]
    if not warnings:
        left_out = checkup.names(Outcome.SKIPPED)
        return "everything that was tried works" if left_out else "everything works"
    return f"everything that is needed works; see the warnings on {enumerated(warnings)}"


def failures(checkup: Checkup) -> str:
    """Sum up an examination with failures."""
    failed = [title(name) for name in checkup.names(Outcome.FAILED)]
    many = "" if len(failed) == 1 else "s"
    return (
        f"{len(failed)} of {len(checkup.checks)} checks failed ({enumerated(failed)}); do what the "
        f"line{many} under {'it' if len(failed) == 1 else 'them'} say{'' if many else 's'}"
    )
