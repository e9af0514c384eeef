"""The list of planted defects goes with the code."""

from __future__ import annotations

import pytest

from tests.faults.planted import DEFECTS, ROOT, Defect, plant
from tests.matrix import MARKED


def marked_places() -> set[str]:
    return {place for places in MARKED.values() for place in places}


def test_there_are_twenty_defects_of_different_names() -> None:
    assert len({defect.name for defect in DEFECTS}) == len(DEFECTS) == 20


@pytest.mark.parametrize("defect", DEFECTS, ids=lambda defect: defect.name)
def test_each_fits_the_code_and_names_tests_that_exist(defect: Defect) -> None:
    source = (ROOT / "exwarp_cli" / defect.file).read_text(encoding="utf-8")
    assert plant(source, defect) != source
    assert all((ROOT / "tests" / name).is_file() for name in defect.tests.split())
    assert not marked_places().intersection(defect.tests.split())


def test_what_the_default_suite_leaves_out_exists() -> None:
    assert [place for place in marked_places() if not (ROOT / "tests" / place).exists()] == []


def test_a_defect_that_does_not_fit_is_named() -> None:
    for source in ("a = 1\n", 2 * f"{DEFECTS[0].old}\n"):
        with pytest.raises(ValueError, match=r"occurs \d times in domain/timeline.py"):
            plant(source, DEFECTS[0])
