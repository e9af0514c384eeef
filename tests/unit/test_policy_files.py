"""Policy files: what is written comes back, the same bytes every time, and damage is reported."""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from pathlib import Path

import numpy as np
import pytest

from exwarp_cli.accelerator.mlp import QuantisedMlp
from exwarp_cli.errors import DamagedFileError, InputError, LayoutError, OutputError
from exwarp_cli.models import model_file, policy_files
from exwarp_cli.models.model_file import CHECKSUMS
from exwarp_cli.models.policy_files import FORMAT, SHIPPED_POLICY, load_policy, save_network
from tests.unit.mlp_cases import network, parts

SIZES = (6, 5, 4, 2)


@pytest.fixture
def saved(tmp_path) -> Path:
    path = tmp_path / "policy.npz"
    save_network(path, network(4, SIZES), {"seed": 7, "scenes": ["lab"]})
    return path


def same(one: QuantisedMlp, other: QuantisedMlp) -> None:
    assert one.sizes == other.sizes
    mine, theirs = parts(one), parts(other)
    assert (mine.inputs, mine.scales) == (theirs.inputs, theirs.scales)
    for name in ("weights", "biases"):
        for a, b in zip(getattr(mine, name), getattr(theirs, name), strict=True):
            np.testing.assert_array_equal(a, b)


class TestWritten:
    def test_it_comes_back(self, saved):
        policy = load_policy(saved)
        same(policy.network, network(4, SIZES))
        assert policy.metadata == {"seed": 7, "scenes": ["lab"], "format": FORMAT}
        policy = load_policy(saved)
        assert policy.checksum == hashlib.sha256(saved.read_bytes()).hexdigest()
        assert (policy.path, policy.floats) == (saved, ())

    def test_the_network_before_quantisation_comes_back(self, tmp_path):
        floats = [
            (np.full((5, 6), 0.1, np.float32), np.zeros(5, np.float32)),
            (np.ones((2, 5), np.float32), np.ones(2, np.float32)),
        ]
        save_network(tmp_path / "p.npz", network(4, SIZES), {}, floats)
        found = load_policy(tmp_path / "p.npz").floats
        for (w, b), (weights, biases) in zip(found, floats, strict=True):
            np.testing.assert_array_equal(w, weights)
            np.testing.assert_array_equal(b, biases)

    def test_the_same_bytes_every_time(self, saved, tmp_path, monkeypatch):
        monkeypatch.setattr(policy_files.zipfile.time, "localtime", lambda *_: (2031,) * 9)
        again = tmp_path / "again.npz"
        save_network(again, network(4, SIZES), {"scenes": ["lab"], "seed": 7})
        assert again.read_bytes() == saved.read_bytes()
        for entry in zipfile.ZipFile(saved).infolist():
            assert entry.date_time == (1980, 1, 1, 0, 0, 0)
            assert (entry.compress_type, entry.create_system) == (zipfile.ZIP_STORED, 3)

    def test_numpy_alone_reads_it(self, saved):
        with np.load(saved, allow_pickle=False) as arrays:
            assert json.loads(arrays["metadata"].tobytes())["format"] == FORMAT
            np.testing.assert_array_equal(arrays["weights1"], network(4, SIZES).layers[1].weights)
            assert "multipliers2" not in arrays and "shifts1" in arrays

    def test_nan_in_metadata(self, tmp_path):
        with pytest.raises(ValueError, match="JSON"):
            save_network(tmp_path / "p.npz", network(4, SIZES), {"loss": float("nan")})
        assert list(tmp_path.iterdir()) == []

    def test_no_folder(self, tmp_path):
        with pytest.raises(OutputError, match="folder does not exist"):
            save_network(tmp_path / "none" / "p.npz", network(4, SIZES), {})


def changed(path: Path, **arrays: object) -> Path:
    """The policy with some arrays replaced, or left out for None."""
    with np.load(path) as archive:
        held = dict(archive) | arrays
    np.savez(path, **{name: array for name, array in held.items() if array is not None})
    return path


def text(**metadata: object) -> np.ndarray:
    return np.frombuffer(json.dumps(metadata).encode(), np.uint8)


class TestRefused:
    def test_no_file(self, tmp_path):
        with pytest.raises(InputError, match=r"there is no model .*none\.npz; check the path"):
            load_policy(tmp_path / "none.npz")

    def test_a_folder(self, tmp_path):
        with pytest.raises(InputError, match="cannot read"):
            load_policy(tmp_path)

    def test_truncated_anywhere(self, saved):
        data = saved.read_bytes()
        for size in (0, 1, 30, 100, 500, len(data) // 2, len(data) - 30, len(data) - 1):
            saved.write_bytes(data[:size])
            with pytest.raises(DamagedFileError, match=r"policy\.npz is truncated, damaged or no"):
                load_policy(saved)

    def test_a_flipped_bit_anywhere(self, saved):
        """Either it is reported, or it was one that means nothing, as in a timestamp."""
        data = saved.read_bytes()
        refused = 0
        for at in range(0, len(data), 13):
            saved.write_bytes(data[:at] + bytes([data[at] ^ 4]) + data[at + 1 :])
            try:
                found = load_policy(saved).network
            except InputError:
                refused += 1
            else:
                same(found, network(4, SIZES))
        assert refused > 0.8 * len(data) / 13

    def test_other_files(self, tmp_path):
        (tmp_path / "text").write_text("policy\n")
        np.save(tmp_path / "one.npy", np.zeros(3))
        with zipfile.ZipFile(tmp_path / "zip", "w") as archive:
            archive.writestr("readme.txt", "hello")
        for name in ("text", "one.npy", "zip"):
            with pytest.raises(DamagedFileError, match="no policy file; check the path"):
                load_policy(tmp_path / name)

    def test_pickles_are_not_read(self, tmp_path, saved):
        changed(saved, weights0=np.array([{"a": 1}], object))
        with pytest.raises(DamagedFileError, match="damaged or no policy file"):
            load_policy(saved)

    def test_much_in_little(self, saved):
        """Zeros that deflate to a thousandth; they are not inflated to be judged."""
        bomb = {"weights0": np.zeros(policy_files.MOST_BYTES, np.int8)}
        saved.write_bytes(policy_files.pack_arrays(bomb, compressed=True))
        assert saved.stat().st_size < 1e6
        with pytest.raises(DamagedFileError, match="damaged or no policy file"):
            load_policy(saved)
        with pytest.raises(policy_files.ArchiveError, match=r"weights0\.npy is too large"):
            policy_files.unpack_arrays(saved.read_bytes())

    def test_a_little_more_and_more(self, saved, monkeypatch):
        """Arrays of which each alone is small enough."""
        monkeypatch.setattr(policy_files, "MOST_OF_ALL", 1 << 20)
        bomb = {f"x{k}": np.zeros((1 << 18) - 1000, np.int8) for k in range(4)}
        assert len(policy_files.unpack_arrays(policy_files.pack_arrays(bomb, compressed=True))) == 4
        saved.write_bytes(policy_files.pack_arrays(bomb | {"y": np.zeros(500)}, compressed=True))
        with pytest.raises(policy_files.ArchiveError, match="it is too large"):
            policy_files.unpack_arrays(saved.read_bytes())

    def test_a_header_that_claims_the_world(self, saved):
        huge = io.BytesIO()
        np.lib.format.write_array_header_1_0(
            huge, {"descr": "|i1", "fortran_order": False, "shape": (1 << 40, 1 << 20)}
        )
        with zipfile.ZipFile(saved, "w") as archive:
            archive.writestr("weights0.npy", huge.getvalue())
        with pytest.raises(DamagedFileError, match="damaged or no policy file"):
            load_policy(saved)

    @pytest.mark.parametrize(
        ("arrays", "words"),
        [
            ({"metadata": text(format="exwarp.policy/9")}, "format is 'exwarp.policy/9', not"),
            ({"metadata": text()}, "format is None"),
            ({"metadata": np.frombuffer(b"[1]", np.uint8)}, "no JSON object"),
            ({"metadata": np.frombuffer(b"\xff{", np.uint8)}, "no JSON"),
            ({"metadata": None}, "lacks metadata"),
            ({"weights1": None}, "all layers but the last must have multipliers"),
            ({"biases1": None}, "lacks biases1"),
            ({"input_shifts": None}, "lacks input_shifts"),
            ({"multipliers0": None}, "must have multipliers"),
            ({"weights0": np.zeros((5, 6), np.int16)}, "weights0 are int16, not int8"),
            ({"biases0": np.zeros(5, ">i4")}, "biases0 are >i4, not int32"),
            ({"weights0": np.zeros((5, 7), np.int8)}, "takes 7 numbers, and gets 6"),
            ({"weights0": np.full((5, 6), -128, np.int8)}, "-127 is the least"),
            ({"biases0": np.full(5, 2**31 - 1, np.int32)}, "does not fit 32 bits"),
            ({"biases0": np.zeros((5, 1), np.int32)}, "biases are int32 with 1 axes"),
            ({"shifts1": np.full(4, 63, np.uint8)}, "62 is the most"),
            ({"input_multipliers": np.zeros(6, np.int32)}, "1 is the least"),
            ({"w0": np.zeros((2, 3), np.float32)}, "lacks b0"),
            (
                {"w0": np.zeros((2, 3), np.float32), "b0": np.zeros(3, np.float32)},
                "do not fit together",
            ),
        ],
    )
    def test_what_is_no_policy(self, saved, arrays, words):
        with pytest.raises(LayoutError) as caught:
            load_policy(changed(saved, **arrays))
        assert words in str(caught.value)
        assert "is no policy that ExWarp can run: " in str(caught.value)
        assert "\n" not in str(caught.value)


class TestShipped:
    @pytest.fixture
    def folder(self, tmp_path, monkeypatch) -> Path:
        monkeypatch.setattr(model_file, "shipped_folder", lambda: tmp_path)
        save_network(tmp_path / SHIPPED_POLICY, network(4, SIZES), {})
        digest = hashlib.sha256((tmp_path / SHIPPED_POLICY).read_bytes()).hexdigest()
        (tmp_path / CHECKSUMS).write_text(json.dumps({SHIPPED_POLICY: digest}))
        return tmp_path

    def test_it_is_found(self, folder):
        same(load_policy(None).network, network(4, SIZES))
        assert load_policy(None).path == folder / SHIPPED_POLICY

    def test_another_file_in_its_place(self, folder):
        save_network(folder / SHIPPED_POLICY, network(5, SIZES), {})
        with pytest.raises(DamagedFileError, match=r"checksum differs; .*with --policy"):
            load_policy(None)

    @pytest.mark.parametrize("name", [SHIPPED_POLICY, CHECKSUMS])
    def test_it_is_missing(self, folder, name):
        (folder / name).unlink()
        with pytest.raises(InputError, match=r"comes with ExWarp, is missing .* with --policy"):
            load_policy(None)
