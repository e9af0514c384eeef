"""What an examination of the installation found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

SCHEMA = "exwarp.doctor/1"
"""Version of `Checkup.as_dict`: keys may join, none is renamed."""


class Outcome(StrEnum):
    """How a check ended."""

    OK = "ok"
    WARNING = "warning"
    FAILED = "failed"
    SKIPPED = "skipped"


_BY_WEIGHT = (Outcome.OK, Outcome.WARNING, Outcome.FAILED)


@dataclass(frozen=True)
class Remark:
    """Something that is not as it should be.

    Attributes
    ----------
    outcome
        `Outcome.WARNING` where the work can be done all the same, else `Outcome.FAILED`.
    text
        One sentence: what, where, and what to do.
    """

    outcome: Outcome
    text: str


def warning(text: str) -> Remark:
    """Remark on what does not keep ExWarp from its work."""
    return Remark(Outcome.WARNING, text)


def failure(text: str) -> Remark:
    """Remark on what does."""
    return Remark(Outcome.FAILED, text)


@dataclass(frozen=True)
class Check:
    """One thing that was looked at.

    Attributes
    ----------
    found
        What is there, in one line.
    remarks
        What is wrong with it; empty where nothing is.
    facts
        What was found for machines; JSON can hold it.
    lines
        The same for people who want to know more.
    skipped
        Whether it was left out.
    """

    found: str
    remarks: tuple[Remark, ...] = ()
    facts: Mapping[str, Any] = field(default_factory=dict)
    lines: tuple[str, ...] = ()
    skipped: bool = False

    @property
    def outcome(self) -> Outcome:
        """The worst of its remarks."""
        if self.skipped:
            return Outcome.SKIPPED
        worst = max((_BY_WEIGHT.index(remark.outcome) for remark in self.remarks), default=0)
        return _BY_WEIGHT[worst]


@dataclass(frozen=True)
class Checkup:
    """Every check of an examination.

    Attributes
    ----------
    version
        Of ExWarp.
    checks
        By name, in the order in which they were made.
    seconds
        How long each took, by name.
    """

    version: str
    checks: Mapping[str, Check]
    seconds: Mapping[str, float]

    def names(self, outcome: Outcome) -> list[str]:
        """Names of the checks that ended so."""
        return [name for name, check in self.checks.items() if check.outcome is outcome]

    @property
    def outcome(self) -> Outcome:
        """The worst of all."""
        return next(o for o in reversed(_BY_WEIGHT) if o is Outcome.OK or self.names(o))

    def as_dict(self) -> dict[str, Any]:
        """Return what `exwarp doctor --json` prints."""
        return {
            "schema": SCHEMA,
            "version": self.version,
            "outcome": self.outcome,
            "failed": self.names(Outcome.FAILED),
            "warnings": self.names(Outcome.WARNING),
            "seconds": round(sum(self.seconds.values()), 3),
            "checks": {
                name: {
                    "outcome": check.outcome,
                    "found": check.found,
                    "remarks": [{"outcome": r.outcome, "text": r.text} for r in check.remarks],
                    "seconds": round(self.seconds[name], 3),
                    "facts": dict(check.facts),
                }
                for name, check in self.checks.items()
            },
        }
