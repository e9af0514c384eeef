"""What is found of the machine: CPUs and memory, as control groups of both versions limit them."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from exwarp_cli.runtime import machine

GIB = 1 << 30
MEMINFO = f"MemTotal: {32 * GIB // 1024} kB\nMemAvailable: {20 * GIB // 1024} kB\nHugePages: none\n"


@pytest.fixture
def system(tmp_path, monkeypatch):
    """Write the files that Linux tells with; return how to."""
    for name in ("GROUPS", "MEMBERSHIP", "MEMORY"):
        monkeypatch.setattr(machine, name, tmp_path / name)

    def write(membership: str, **files: str) -> None:
        (tmp_path / "MEMBERSHIP").write_text(membership)
        (tmp_path / "MEMORY").write_text(MEMINFO)
        for name, text in files.items():
            path = tmp_path / "GROUPS" / name.replace("__", "/").replace("_at_", ".")
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)

    return write


def test_without_limits(system):
    system("0::/user.slice\n", cpu_at_max="max 100000", memory_at_max="max")
    cpus, memory = machine.processors(), machine.memory()
    assert cpus.quota is None and cpus.there == os.cpu_count()
    assert cpus.usable == cpus.allowed <= cpus.there
    assert memory == machine.Memory(32 * GIB, 20 * GIB, None)


def test_second_version(system):
    # The nearest group grants more than the one around it.
    files = {
        "job__step__cpu_at_max": "400000 100000",
        "job__cpu_at_max": "50000 100000",
        "job__memory_at_max": str(4 * GIB),
        "job__memory_at_current": str(3 * GIB),
        "job__memory_at_stat": f"anon {GIB}\ninactive_file {GIB}\n",
    }
    system("0::/job/step\n", **files)
    assert machine.processors().quota == 0.5
    assert machine.processors().usable == 1
    assert machine.memory() == machine.Memory(32 * GIB, 2 * GIB, 4 * GIB)


def test_a_container_that_does_not_see_its_own_path(system):
    system("0::/docker/abc\n", cpu_at_max="150000 100000")
    assert machine.processors().quota == 1.5


def test_first_version(system):
    files = {
        "cpu,cpuacct__job__cpu_at_cfs_quota_us": "200000",
        "cpu,cpuacct__job__cpu_at_cfs_period_us": "100000",
        "memory__job__memory_at_limit_in_bytes": str(8 * GIB),
        "memory__job__memory_at_usage_in_bytes": str(7 * GIB),
        "memory__job__memory_at_stat": f"total_inactive_file {2 * GIB}\n",
        "memory__memory_at_limit_in_bytes": str(2**63 - 4096),
        "memory__memory_at_usage_in_bytes": "1",
    }
    system("3:cpu,cpuacct:/job\n2:memory:/job\n0::/\n", **files)
    assert machine.processors().quota == 2
    assert machine.memory() == machine.Memory(32 * GIB, 3 * GIB, 8 * GIB)


def test_first_version_without_a_quota(system):
    files = {"cpu__cpu_at_cfs_quota_us": "-1", "cpu__cpu_at_cfs_period_us": "100000"}
    system("3:cpu:/\n", **files)
    assert machine.processors().quota is None


def test_a_system_that_tells_nothing(monkeypatch, tmp_path):
    for name in ("GROUPS", "MEMBERSHIP", "MEMORY"):
        monkeypatch.setattr(machine, name, tmp_path / "nowhere")
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    cpus, memory = machine.processors(), machine.memory()
    assert cpus.allowed == cpus.there and cpus.quota is None
    assert memory.available is None and memory.limit is None


def test_folders(tmp_path):
    good = machine.look_at(tmp_path)
    assert good.problem is None and good.free is not None and list(tmp_path.iterdir()) == []
    assert machine.look_at(tmp_path / "none").problem == "No such file or directory"
    (tmp_path / "file").touch()
    assert machine.look_at(tmp_path / "file").problem == "Not a directory"


def test_cached_files(tmp_path):
    (tmp_path / "a.nbi").write_bytes(b"12")
    (tmp_path / "b.nbi").write_bytes(b"345")
    (tmp_path / "c.txt").write_bytes(b"6")
    assert machine.cached_files(tmp_path, ".nbi") == (2, 5)
    assert machine.cached_files(Path(tmp_path / "none"), ".nbi") == (0, 0)
