"""What ``--json`` prints, read as strictly as the strictest of parsers."""

from __future__ import annotations

import json
from typing import Any

from tests.cli.conftest import Result


def document_of(result: Result, schema: str | None = None) -> dict[str, Any]:
    """Return the document that stdout holds, after judging that it holds nothing else."""
    assert result.code == 0, result.err
    found = strict(result.out)
    if schema is not None:
        assert found["schema"] == schema
    return found


def strict(text: str) -> dict[str, Any]:
    """Read one document of RFC 8259, which has no NaN, no infinities, and no name twice."""
    found = json.loads(text, parse_constant=_refuse, object_pairs_hook=_once)
    assert isinstance(found, dict) and text.endswith("}\n")
    return found


def _refuse(name: str) -> None:
    raise AssertionError(f"{name} is not JSON")


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    names = [name for name, _ in pairs]
    assert len(set(names)) == len(names), names
    return dict(pairs)
