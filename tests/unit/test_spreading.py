"""How a job is cut for a cluster, and how its files are named for other processes."""

from __future__ import annotations

from pathlib import Path

import pytest

from exwarp_cli.domain.settings import ClusterSettings, SourceSettings, UpsampleSettings
from exwarp_cli.errors import OutputError, UsageError
from exwarp_cli.farm.dask_cluster import chunks_of, threads_per_worker
from exwarp_cli.farm.farm_job import absolute
from exwarp_cli.io.files import TEMPORARY_SUFFIX, marker_file
from exwarp_cli.pipeline.dry_run import require_writable


class TestChunks:
    @pytest.mark.parametrize(
        ("count", "workers", "size"), [(1, 8, 1), (9, 2, 2), (60, 2, 10), (60, 4, 5), (999, 2, 10)]
    )
    def test_each_worker_gets_some_in_turn(self, count, workers, size):
        keys = tuple(range(1001, 1001 + count))
        chunks = chunks_of(keys, ClusterSettings(workers=workers), workers)
        assert {len(chunk) for chunk in chunks[:-1]} <= {size}
        assert [key for chunk in chunks for key in chunk] == list(keys)

    def test_a_size_that_is_asked_for(self):
        chunks = chunks_of((1, 2, 3, 4, 5), ClusterSettings(workers=9, chunk_size=3), 9)
        assert chunks == ((1, 2, 3), (4, 5))

    @pytest.mark.parametrize(
        ("workers", "threads", "each"), [(2, 8, 4), (3, 8, 2), (4, 2, 1), (1, 5, 5)]
    )
    def test_threads_are_shared(self, workers, threads, each):
        assert threads_per_worker(workers, threads) == each

    def test_two_clusters_are_one_too_many(self):
        with pytest.raises(UsageError, match="--cluster"):
            ClusterSettings(workers=2, address="tcp://a:1")


def test_paths_do_not_depend_on_the_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    aovs = ("motion=vec/a.####.exr:R,G", f"depth={tmp_path}/z")
    source = SourceSettings("shot.####.exr", "../slots/", aovs=aovs, channel_map="map.toml")
    found = absolute(UpsampleSettings(source, "out/", write_holes="holes", policy="p.npz"))
    assert found.source.sequence == f"{tmp_path}/shot.####.exr"
    assert found.source.gbuffers == f"{tmp_path}/../slots/"
    assert found.source.aovs == (f"motion={tmp_path}/vec/a.####.exr:R,G", f"depth={tmp_path}/z")
    assert found.source.channel_map == f"{tmp_path}/map.toml"
    assert (found.output, found.write_holes) == (f"{tmp_path}/out/", f"{tmp_path}/holes")
    assert (found.policy, found.ground_truth, found.video) == (f"{tmp_path}/p.npz", None, None)


def test_a_mark_is_there_as_long_as_the_block(tmp_path):
    with marker_file(tmp_path) as mark:
        assert list(tmp_path.iterdir()) == [mark] and mark.name.endswith(TEMPORARY_SUFFIX)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(OutputError, match="does not exist"), marker_file(tmp_path / "none"):
        pass


def test_a_folder_that_could_be_made(tmp_path):
    require_writable([tmp_path, tmp_path / "a" / "b", Path("relative")])
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="is a file"):
        require_writable([tmp_path / "file" / "a"])
