"""Files of the project that must agree with each other."""

from __future__ import annotations

import re
from pathlib import Path

import exwarp_cli

ROOT = Path(exwarp_cli.__file__).parent.parent


def test_the_newest_entry_of_the_changelog_is_this_version():
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    entries = re.findall(r"^## \[(\d[^]]*)\] - (\d{4}-\d{2}-\d{2})$", text, flags=re.MULTILINE)
    assert entries[0][0] == exwarp_cli.__version__
    assert [date for _, date in entries] == sorted((d for _, d in entries), reverse=True)


def test_the_license_is_whole():
    text = (ROOT / "LICENSE").read_text(encoding="utf-8")
    assert text.split("\n")[1].strip() == "Apache License" or "Apache License" in text[:200]
    assert "Copyright 2026 ExWarp contributors" in text and "[yyyy]" not in text
    assert len(text) > 11_000
