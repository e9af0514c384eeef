"""Signals set a flag that loops read; a second one, or no progress, ends the process."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from exwarp_cli.runtime.stop import StopRequested, check_stop, clean_up_after, graceful_stop

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")

LONG_S = 60
"""Seconds after which a test gives up waiting."""

IN_A_LIBRARY = """
import sys, time
from pathlib import Path
from exwarp_cli.runtime import stop

stop.STALLED_S = float(sys.argv[2])
words = "exwarp: error: {}".format
with stop.graceful_stop(words):
    file = Path(sys.argv[1])
    with stop.clean_up_after(file.unlink), stop.scratch_folder() as folder:
        file.touch()
        (folder / "part").touch()
        print(folder, flush=True)
        time.sleep(60)  # C, which a handler of Python does not end
"""


def stop(number: int = signal.SIGTERM) -> None:
    os.kill(os.getpid(), number)


def words(number: int) -> str:
    return f"ended by {number}"


def loop() -> None:
    """Work until a stop is requested."""
    end = time.monotonic() + LONG_S
    while time.monotonic() < end:
        check_stop()


class TestFlag:
    @pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
    def test_a_loop_ends_after_a_signal(self, number):
        with pytest.raises(StopRequested) as raised, graceful_stop(words):
            stop(number)
            loop()
        assert raised.value.number == number

    def test_without_a_signal_it_goes_on(self):
        with graceful_stop(words):
            check_stop()

    def test_the_next_command_goes_on(self):
        with pytest.raises(StopRequested), graceful_stop(words):
            stop()
            loop()
        with graceful_stop(words):
            check_stop()

    def test_cleaning_up_is_not_broken_off(self):
        cleaned = False
        with pytest.raises(StopRequested), graceful_stop(words):
            try:
                stop()
                loop()
            finally:
                stop()
                time.sleep(0.05)
                cleaned = True
        assert cleaned

    def test_what_fails_after_a_signal_was_stopped(self):
        """A terminal interrupts other programs of the command, too, and they end at once."""
        with pytest.raises(StopRequested), graceful_stop(words):
            stop()
            raise OSError("ffmpeg has ended")

    def test_what_fails_without_a_signal_is_a_failure(self):
        with pytest.raises(OSError, match="full"), graceful_stop(words):
            raise OSError("full")

    def test_signals_are_as_before_afterwards(self):
        numbers = (signal.SIGTERM, signal.SIGINT)
        before = [signal.getsignal(number) for number in numbers]
        with pytest.raises(StopRequested), graceful_stop(words):
            stop()
            loop()
        assert [signal.getsignal(number) for number in numbers] == before
        wakeup = signal.set_wakeup_fd(-1)
        assert wakeup == -1

    @pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
    def test_nothing_strikes_behind_the_last_one(self, number):
        before = {each: signal.getsignal(each) for each in (signal.SIGTERM, signal.SIGINT)}
        try:
            with pytest.raises(StopRequested), graceful_stop(words, is_last=True):
                stop(number)
                loop()
            stop(signal.SIGINT)
            stop(signal.SIGTERM)
        finally:
            for each, handler in before.items():
                signal.signal(each, handler)

    def test_who_ignores_interruptions_keeps_to_that(self):
        before = signal.signal(signal.SIGINT, signal.SIG_IGN)
        try:
            with graceful_stop(words):
                stop(signal.SIGINT)
                check_stop()
        finally:
            signal.signal(signal.SIGINT, before)

    def test_in_another_thread_it_does_nothing(self):
        before = signal.getsignal(signal.SIGTERM)
        seen = []

        def work() -> None:
            with graceful_stop(words):
                seen.append(signal.getsignal(signal.SIGTERM))

        with ThreadPoolExecutor(1) as pool:
            pool.submit(work).result()
        assert seen == [before]


def test_a_block_is_cleaned_up(tmp_path):
    path = tmp_path / "part"
    with pytest.raises(KeyError), clean_up_after(path.unlink):
        path.touch()
        raise KeyError
    assert not path.exists()


class TestInALibrary:
    """The main thread is in C, and reads no flag."""

    def test_a_second_signal_ends_it_at_once(self, tmp_path):
        with started(tmp_path / "part") as process:
            folder = Path(process.stdout.readline().strip())
            assert folder.is_dir()
            for _ in range(2):  # both at once count as one
                process.send_signal(signal.SIGTERM)
            time.sleep(1.2)
            assert process.poll() is None
            begin = time.monotonic()
            process.send_signal(signal.SIGTERM)
            _, err = process.communicate(timeout=LONG_S)
        assert time.monotonic() - begin < 5
        assert (process.returncode, err) == (143, f"exwarp: error: {signal.SIGTERM.value}\n")
        assert not folder.exists() and not (tmp_path / "part").exists()

    def test_without_progress_one_signal_does(self, tmp_path):
        with started(tmp_path / "part", stalled_s=0.3) as process:
            folder = Path(process.stdout.readline().strip())
            process.send_signal(signal.SIGINT)
            _, err = process.communicate(timeout=LONG_S)
        assert (process.returncode, err) == (130, f"exwarp: error: {signal.SIGINT.value}\n")
        assert not folder.exists() and not (tmp_path / "part").exists()


def started(path: Path, stalled_s: float = LONG_S) -> subprocess.Popen[str]:
    line = [sys.executable, "-c", IN_A_LIBRARY, str(path), str(stalled_s)]
    return subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
