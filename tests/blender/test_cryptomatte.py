"""A real render whose only ids are Cryptomatte: what Blender writes is what is read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from exwarp_cli.io.cryptomatte import (
    IdKind,
    find_dynamic_objects,
    hash_name,
    read_manifest,
    require_lossless_ids,
    surface_ids,
)
from exwarp_cli.io.frames import read_plane
from tests.reference.ranked import identity
from tests.unit.cryptomatte_files import found_in, ranks_in

SCRIPT = Path(__file__).with_name("cryptomatte_shot")
MOVERS = {"ball", "car", "car wheel.001", "car wheel.002", 'Würfel "B"\\2'}
STANDING = {"ground", "house left", "house right", "fence", "pane"}


@pytest.fixture(scope="module")
def keys(script, tmp_path_factory) -> list[Path]:
    folder = tmp_path_factory.mktemp("crypto")
    done = script(SCRIPT, folder, "--resolution", "96x54", "--keys", 2)
    assert done.returncode == 0, done.stderr
    return sorted((folder / "keys").iterdir())


def test_three_kinds_objects_first(keys):
    found = found_in(keys[0], "ViewLayer.Combined.R")
    assert [one.kind for one in found] == [IdKind.OBJECT, IdKind.ASSET, IdKind.MATERIAL]
    assert found[0].name == "ViewLayer.CryptoObject"
    for one in found:
        one.require_exact("it")
        require_lossless_ids(ranks_in(keys[0], one), "it")
        assert len(one.ranks) == 3 and one.hashed and not one.rounded


def test_names_are_hashed_as_here_even_where_the_manifest_is_no_json(keys):
    found = found_in(keys[0])[0]
    manifest = read_manifest(found, keys[0])
    assert set(manifest.ids) > MOVERS | STANDING
    assert all(hash_name(name) == bits for name, bits in manifest.ids.items())


def test_every_pixel_shows_what_is_in_the_scene(keys):
    for path in keys:
        found = found_in(path)[0]
        shown = surface_ids(ranks_in(path, found))
        ids = {identity(hash_name(name)) for name in MOVERS | STANDING}
        assert set(np.unique(shown)) - {-1, 0} == ids
        assert (shown < 0).mean() < 0.03
        sky = read_plane(path, "ViewLayer.Depth.Z")[0] > 1e9
        assert (sky == (shown == 0))[shown >= 0].mean() > 0.995


def test_the_stencil_has_what_is_named_and_nothing_else(keys):
    found = found_in(keys[0])[0]
    manifests = [read_manifest(found, path) for path in keys]
    chosen = find_dynamic_objects("ball,car*,W*", manifests, "it")
    assert set(chosen.names) == MOVERS
    ranks = ranks_in(keys[0], found)
    stencil = surface_ids(ranks, dynamic=chosen.ids)
    assert set(np.unique(stencil)) - {-1, 0} == set(chosen.ids)
    known = (stencil >= 0) & (surface_ids(ranks) >= 0)
    moving = np.isin(surface_ids(ranks), chosen.ids)
    np.testing.assert_array_equal((stencil > 0)[known], moving[known])
