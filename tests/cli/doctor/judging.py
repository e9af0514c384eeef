"""What is expected of the document that ``exwarp doctor --json`` prints."""

from __future__ import annotations

from typing import Any, NoReturn

from exwarp_cli.pipeline.doctor import checkup

NAMES = ["configuration", *checkup.CHECKS]
ESCAPE = "\x1b"


def remarks(document: dict[str, Any], name: str) -> str:
    """What is said of a check."""
    return "\n".join(remark["text"] for remark in document["checks"][name]["remarks"])


def failed(found: tuple[int, dict[str, Any]], name: str, *words: str) -> None:
    """Judge that a check failed, and what was said of it."""
    code, document = found
    assert code == 10 and document["outcome"] == "failed" and name in document["failed"]
    assert document["checks"][name]["outcome"] == "failed"
    for word in words:
        assert word in remarks(document, name)


def warned(found: tuple[int, dict[str, Any]], name: str, *words: str) -> None:
    """Judge that a check ended with a warning, which does not count as a failure."""
    code, document = found
    assert code == 0 and document["outcome"] == "warning" and document["warnings"] == [name]
    for word in words:
        assert word in remarks(document, name)


def healthy(found: tuple[int, dict[str, Any]], *names: str) -> None:
    """Judge that checks found nothing."""
    code, document = found
    assert code == 0 and document["outcome"] == "ok", document
    for name in names:
        assert document["checks"][name]["outcome"] == "ok"
        assert document["checks"][name]["remarks"] == []


def no_folder(*_: Any, **__: Any) -> NoReturn:
    """Stands in for a function of `tempfile` where nothing can be written."""
    raise FileNotFoundError(2, "No such file or directory")
