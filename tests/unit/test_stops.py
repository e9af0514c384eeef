"""Where a stop strikes, and where it waits."""

from __future__ import annotations

import functools
import importlib
import os
import signal
import sys
import threading
import time
import weakref
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from types import ModuleType, SimpleNamespace

import pytest

from exwarp_cli.io.stops import Stoppable, Terminated

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")


LONG_S = 60
"""Seconds after which nobody came."""


def stop(number: int = signal.SIGTERM) -> None:
    os.kill(os.getpid(), number)


def later() -> None:
    """Be somewhere that may be broken off."""
    end = time.monotonic() + LONG_S
    while time.monotonic() < end:
        pass


class TestStoppable:
    @pytest.mark.parametrize(
        ("number", "raised"),
        [(signal.SIGTERM, Terminated), (signal.SIGINT, KeyboardInterrupt)],
    )
    def test_it_raises(self, number, raised):
        with pytest.raises(raised), Stoppable():
            stop(number)
            later()

    def test_signals_are_as_before_afterwards(self):
        numbers = (signal.SIGTERM, signal.SIGINT, signal.SIGALRM)
        before = [signal.getsignal(number) for number in numbers]
        hook = sys.unraisablehook
        with pytest.raises(Terminated), Stoppable():
            stop()
            later()
        assert [signal.getsignal(number) for number in numbers] == before
        assert sys.unraisablehook is hook
        assert signal.getitimer(signal.ITIMER_REAL)[0] == 0

    def test_a_second_one_does_not_break_off_the_first(self):
        cleaned = False
        with pytest.raises(Terminated), Stoppable():
            try:
                stop()
                later()
            finally:
                stop()
                cleaned = True
        assert cleaned

    @pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
    def test_nothing_strikes_behind_the_last_one(self, number):
        before = {each: signal.getsignal(each) for each in (signal.SIGTERM, signal.SIGINT)}
        try:
            with pytest.raises((Terminated, KeyboardInterrupt)), Stoppable(is_last=True):
                stop(number)
                later()
            stop(signal.SIGINT)
            stop(signal.SIGTERM)
        finally:
            for each, handler in before.items():
                signal.signal(each, handler)

    def test_interruptions_at_once_are_one(self):
        cleaned = False
        with pytest.raises(KeyboardInterrupt), Stoppable():
            try:
                stop(signal.SIGINT)
                later()
            finally:
                stop(signal.SIGINT)
                cleaned = True
        assert cleaned

    def test_who_ignores_interruptions_keeps_to_that(self):
        before = signal.signal(signal.SIGINT, signal.SIG_IGN)
        try:
            with Stoppable():
                stop(signal.SIGINT)
        finally:
            signal.signal(signal.SIGINT, before)

    def test_in_another_thread_it_does_nothing(self):
        before = signal.getsignal(signal.SIGTERM)
        seen = []

        def work() -> None:
            with Stoppable():
                seen.append(signal.getsignal(signal.SIGTERM))

        with ThreadPoolExecutor(1) as pool:
            pool.submit(work).result()
        assert seen == [before]


class TestWhatWaitsLong:
    @pytest.mark.parametrize("waiting", ["condition", "future", "thread", "shutdown"])
    def test_it_is_broken_off(self, waiting):
        go_on = threading.Event()
        with ThreadPoolExecutor(1) as pool:
            future = pool.submit(go_on.wait, LONG_S)
            threading.Timer(0.1, stop).start()
            with pytest.raises(Terminated), Stoppable():
                if waiting == "condition":
                    go_on.wait(LONG_S)
                elif waiting == "future":
                    future.result()
                elif waiting == "thread":
                    next(iter(pool._threads)).join()
                else:
                    pool.shutdown()
            assert not future.done()
            go_on.set()


class TestWhatMustBeWhole:
    def test_a_lock_is_not_left_taken(self):
        condition = threading.Condition()
        entered: list[int] = []
        left: list[int] = []
        taking = functools.partial(signal.raise_signal, signal.SIGTERM)  # C, as a lock's
        lock = SimpleNamespace(__enter__=taking, __exit__=lambda *_: left.append(1))
        condition._lock = lock  # type: ignore[attr-defined]
        with pytest.raises(Terminated), Stoppable():
            with condition:
                entered.append(1)
            later()
        assert entered == left == [1]

    def test_a_block_that_is_being_entered_is_entered(self):
        @contextmanager
        def block() -> Iterator[None]:
            yield

        entered = []
        manager = block()
        manager.gen = map(signal.raise_signal, [signal.SIGTERM])  # type: ignore[attr-defined]
        with pytest.raises(Terminated), Stoppable():
            manager.__enter__()
            entered.append(1)
            later()
        assert entered == [1]

    def test_an_import_is_done(self, monkeypatch):
        class Finder:
            """Makes a module in whose making the stop arrives."""

            def find_spec(self, name: str, *_: object) -> object:
                from importlib.machinery import ModuleSpec

                return ModuleSpec(name, self) if name == "half_imported" else None  # type: ignore[arg-type]

            def create_module(self, _spec: object) -> None:
                return None

            def exec_module(self, module: ModuleType) -> None:
                stop()
                time.sleep(0.05)
                module.whole = True  # type: ignore[attr-defined]

        monkeypatch.setattr(sys, "meta_path", [Finder(), *sys.meta_path])
        with pytest.raises(Terminated), Stoppable():
            importlib.import_module("half_imported")
            later()
        assert sys.modules.pop("half_imported").whole

    def test_a_finalizer_is_done(self):
        class Thing:
            pass

        done = []

        def finalizer() -> None:
            stop()
            time.sleep(0.05)
            done.append(1)

        thing = Thing()
        weakref.finalize(thing, finalizer)
        with pytest.raises(Terminated), Stoppable():
            del thing
            later()
        assert done == [1]

    def test_what_was_raised_where_it_is_dropped_is_raised_again(self):
        class Thing:
            def __del__(self) -> None:
                stop()
                later()

        thing = Thing()
        with pytest.raises(Terminated), Stoppable():
            del thing
            later()
