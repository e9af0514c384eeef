"""Threads of the kernels sleep between kernels, as others read and write files meanwhile."""

from __future__ import annotations

import os

import numba
import pytest

from exwarp_cli.kernels import jit


@pytest.fixture
def told(monkeypatch) -> list[dict[str, str]]:
    """What OpenMP would read when its threads are started."""
    found: list[dict[str, str]] = []

    def start(_count: int) -> None:
        found.append({name: os.environ[name] for name in jit.WAITING if name in os.environ})

    monkeypatch.setattr(numba, "set_num_threads", start)
    for name in jit.WAITING:
        monkeypatch.delenv(name, raising=False)
    return found


def test_they_sleep_and_the_environment_is_left_as_it_was(told):
    jit.set_threads(2)
    assert told == [{"OMP_WAIT_POLICY": "PASSIVE"}]
    assert not set(jit.WAITING) & set(os.environ)


@pytest.mark.parametrize("name", jit.WAITING)
def test_what_the_user_wants_holds(told, monkeypatch, name):
    monkeypatch.setenv(name, "7")
    jit.set_threads(2)
    assert told == [{name: "7"}] and os.environ[name] == "7"


def test_a_failure_leaves_nothing_behind(told, monkeypatch):
    def fail(_count: int) -> None:
        raise ValueError

    monkeypatch.setattr(numba, "set_num_threads", fail)
    with pytest.raises(ValueError):
        jit.set_threads(2)
    assert not set(jit.WAITING) & set(os.environ)
