"""What a rendered scene tells a policy, on the miniature data set."""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import astuple, replace
from pathlib import Path

import numpy as np
import pytest

from exwarp_cli.accelerator.mlp import to_fixed
from exwarp_cli.domain.colour import encode_display
from exwarp_cli.domain.decision import PATHS
from exwarp_cli.domain.settings import SourceSettings
from exwarp_cli.io.dataset import RenderedScene, open_scene
from exwarp_cli.kernels import _row_bands
from exwarp_cli.metrics.registry import METRICS
from exwarp_cli.models.model_file import CHECKSUMS, shipped_folder
from exwarp_cli.models.picture_network import (
    SHIPPED_EXTRAPOLATOR,
    OnnxExtrapolator,
    load_extrapolator,
)
from exwarp_cli.pipeline.decide import features
from exwarp_cli.policy.outcomes import METRICS as JUDGED
from exwarp_cli.policy.outcomes import slot_quality
from exwarp_cli.policy.state import observe
from exwarp_cli.research.training import outcome_tables, scene_clip
from exwarp_cli.research.training.augmentation import Variant
from exwarp_cli.research.training.outcome_tables import (
    VIEWS,
    Measured,
    View,
    find_tables,
    join_views,
    measure_view,
)
from exwarp_cli.research.training.scene_clip import SceneClip
from exwarp_cli.synthesis.methods import METHODS
from tests.matrix import FULL, spread
from tests.reference.quality import psnr_db, srgb_255
from tests.unit.tiny_models import convolution, filled_warp, save

FOLDER = Path(__file__).parents[2] / "data" / "miniature" / "variety-0074"
PLAIN = [view for view in VIEWS if view.variant == Variant() and not view.begins]
FAST = [view for view in VIEWS if view.variant == Variant(4, speed=2)]
BEGINNING = [view for view in VIEWS if view.variant == Variant() and view.begins]
SHIFTED = [view for view in VIEWS if view.variant == Variant(2)]
ENDING = f"-v{outcome_tables.OUTCOMES_VERSION}.npy"
"""Of the name of a file of outcomes."""


@pytest.fixture(scope="module", autouse=True)
def threads(loose_objects):
    """Measuring is done on one thread; what follows gets all of them back."""
    yield
    outcome_tables.extrapolator.cache_clear()
    _row_bands.set_threads(None)


@pytest.fixture(scope="module")
def scene() -> RenderedScene:
    return open_scene(FOLDER)


@pytest.fixture(scope="module")
def model(tmp_path_factory) -> Path:
    return save(tmp_path_factory.mktemp("model") / "tiny.onnx", convolution(seed=3))


@pytest.fixture(scope="module")
def extrapolator(model) -> OnnxExtrapolator:
    return load_extrapolator(model, 1, "cpu")


@pytest.fixture(scope="module")
def cache(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("cache") / "policy"


def test_views_are_all_phases_in_both_settings():
    assert [view.name for view in PLAIN] == ["key-phase0-speed1", "slot-phase0-speed1"]
    assert [view.name for view in BEGINNING] == [f"{view.name}-begins" for view in PLAIN]
    assert len({view.name for view in VIEWS}) == len(VIEWS) == 16
    normal = {(v.setting, v.variant.phase) for v in VIEWS if v.variant.speed == 1}
    assert normal == {(s, phase) for s in ("key", "slot") for phase in range(4)}
    begins = [(v.setting, v.variant) for v in VIEWS if v.begins]
    assert begins == [(s, Variant(speed=k)) for k in (1, 2) for s in ("key", "slot")]
    assert not any(view.variant.backwards for view in VIEWS)


def test_which_views_a_scene_is_long_enough_for(scene, model, tmp_path, monkeypatch):
    """Those with a whole key interval: only these are measured."""

    def measured(_measure, work, _jobs):
        yield from ((task, Measured(np.zeros((1, 3, 8)), np.ones((1, 5, 2, 2)))) for task in work)

    monkeypatch.setattr(outcome_tables, "run_tasks", measured)
    monkeypatch.setattr(RenderedScene, "as_far_as_rendered", lambda self: self)
    for count in range(1, 14):
        instants = replace(scene.manifest.instants, count=count)
        short = replace(scene, manifest=replace(scene.manifest, instants=instants))
        monkeypatch.setattr(outcome_tables, "find_scenes", lambda _, role, short=short: [short])
        tables = find_tables([FOLDER], None, tmp_path, str, model)
        views = [v for v in VIEWS if count > v.variant.phase + 4 * v.variant.speed]
        groups = [name for table in tables for name in table.groups]
        assert groups == [f"{view.name} 64x36" for view in views]
        assert all(SceneClip(short, view.variant).intervals for view in views)


@pytest.mark.parametrize(
    "view",
    PLAIN + SHIFTED + FAST if FULL else [PLAIN[0], SHIFTED[1], FAST[0]],
    ids=lambda view: view.name,
)
def test_outcomes_are_the_scores_of_every_path_s_frames(scene, view, model, cache, extrapolator):
    found = measure_view(scene, view, model, cache)
    footage = SceneClip(scene, view.variant)
    assert len(footage.intervals) == {0: 3, 2: 2, 4: 1}[view.variant.phase]
    assert found.outcomes.shape == (len(footage.intervals), 5, 2, 2)
    quality = slot_quality(found.outcomes)
    for k in spread(footage.intervals, 2):
        interval = replace(footage.causal(k, view.setting), extrapolator=extrapolator)
        assert bool(interval.slots) == (view.setting == "slot") and interval.following is None
        for p, path in enumerate(PATHS):
            for slot in (1, 2, 3):
                made = METHODS[path.lower()].predict(interval, slot).pixels
                truth = footage.truth(k, slot).pixels
                wanted = [
                    METRICS[name](encode_display(truth), encode_display(made)).value()
                    for name in JUDGED
                ]
                assert quality[k, p, slot - 1].tolist() == wanted
    assert quality[..., 0].std() > 0.1


@pytest.mark.parametrize("setting", ["key", "slot"])
def test_a_beginning_is_an_interval_whose_past_is_unknown(
    scene, model, cache, extrapolator, setting, monkeypatch
):
    """The same as in a render that begins there, for every interval that is looked at."""
    monkeypatch.setattr(outcome_tables, "BEGINNING_EVERY", 2)
    view = View(setting, Variant(), begins=True)
    found = measure_view(scene, view, model, cache.parent / f"begins-{setting}")
    usual = measure_view(scene, View(setting, Variant()), model, cache)
    assert len(found.outcomes) == len(found.features) == 2
    np.testing.assert_array_equal(found.outcomes[0], usual.outcomes[0])
    np.testing.assert_array_equal(found.features[0], usual.features[0])
    assert (found.features[1, 0, 1:3] == 0).all() and (usual.features[2, 0, 1:3] > 0).all()
    assert (found.outcomes[1, :, 1] != usual.outcomes[2, :, 1]).any()
    later = replace(scene.manifest.instants, first=9, count=5)
    keys = replace(scene.manifest.keys, first=3, count=2)
    cut = replace(scene, manifest=replace(scene.manifest, instants=later, keys=keys))
    alone = measure_view(cut, View(setting, Variant()), model, cache.parent / f"cut-{setting}")
    np.testing.assert_allclose(found.outcomes[1], alone.outcomes[0], atol=1e-9)
    np.testing.assert_allclose(found.features[1], alone.features[0], atol=1e-12)


def test_psnr_is_what_the_definition_says(scene, model, cache, extrapolator):
    found = measure_view(scene, PLAIN[0], model, cache)
    footage = SceneClip(scene)
    interval = replace(footage.causal(1, "key"), extrapolator=extrapolator)
    for slot, node, choice, path in ((1, 0, 0, "s6"), (1, 0, 1, "s1"), (3, 3, 1, "s3")):
        made = METHODS[path].predict(interval, slot).pixels[..., :3]
        encoded = np.vectorize(srgb_255)([footage.truth(1, slot).pixels[..., :3], made])
        wanted = psnr_db(encoded[0], encoded[1])
        assert found.outcomes[1, node, choice, 0] == pytest.approx(wanted, abs=1e-3)


@pytest.mark.parametrize("view", PLAIN + FAST if FULL else PLAIN, ids=lambda view: view.name)
def test_features_are_those_of_the_footage_s_gbuffers(scene, view, model, cache):
    found = measure_view(scene, view, model, cache).features
    footage = SceneClip(scene, view.variant)
    for k in footage.intervals:
        if view.setting == "key":
            before = footage.key(k - 1).gbuffer if k else None
            rows = [observe(footage.key(k).gbuffer, before, 4)] * 3
        else:
            instants = [footage.slot(k, i).gbuffer for i in range(3)]
            before = footage.slot(k - 1, 3).gbuffer if k else None
            pairs = zip([before, *instants], instants, strict=False)
            rows = [observe(now, earlier, 1) for earlier, now in pairs]
        np.testing.assert_array_equal(found[k], [astuple(row) for row in rows])
    # Nothing is known of the instant before the first one, and of all others it is.
    assert (found[0, 0, 1:3] == 0).all()
    rest = found[1:] if view.setting == "key" else found.reshape(-1, 8)[1:]
    assert (rest[..., 1:5] > 0).all() and (found[..., 5:7] == [64, 36]).all()


@pytest.mark.parametrize("view", PLAIN, ids=lambda view: view.name)
def test_states_are_those_of_a_run(scene, view, model, cache):
    """What the policy learns from is, bit for bit, what it is given in a run."""
    table = join_views("m", [("64x36", view, measure_view(scene, view, model, cache))], "")
    slots = str(FOLDER / "instants") if view.setting == "slot" else None
    settings = SourceSettings(str(FOLDER / "keys"), slots, scene.manifest.motion)
    run = [found.inputs for found in features(settings, "1-3")]
    np.testing.assert_array_equal(to_fixed(table.states).reshape(-1, 44), run)


def test_motion_is_per_slot_whatever_the_speed(scene, model, cache):
    """At double speed things move about twice as far in a slot: four times the variance."""
    slow, fast = (
        measure_view(scene, View("slot", Variant(0, speed=speed)), model, cache).features[0, 0]
        for speed in (1, 2)
    )
    assert (fast[3:5] / slow[3:5] > 2).all() and (fast[3:5] / slow[3:5] < 8).all()
    key = measure_view(scene, View("key", Variant()), model, cache).features[0, 0]
    assert (key[3:5] / slow[3:5] > 0.4).all() and (key[3:5] / slow[3:5] < 2.5).all()


class TestCache:
    def test_the_second_time_no_frame_is_read(self, scene, model, cache, monkeypatch, tmp_path):
        first = measure_view(scene, PLAIN[0], model, cache)
        assert first.outcomes.dtype == first.features.dtype == np.float64

        def refuse(*_):
            raise AssertionError("a frame is read")

        monkeypatch.setattr(scene_clip, "read_raw", refuse)
        same(measure_view(scene, PLAIN[0], model, cache), first)
        with pytest.raises(AssertionError, match="a frame is read"):
            measure_view(scene, PLAIN[0], model, tmp_path)

    def test_another_network_is_measured_by_itself(self, scene, model, cache, tmp_path):
        first = measure_view(scene, FAST[0], model, cache)
        kept = {path.name: path.read_bytes() for path in cache.iterdir()}
        other = save(tmp_path / "other.onnx", filled_warp(0.5))
        second = measure_view(scene, FAST[0], other, cache)
        assert (first.outcomes[:, :3, 0] == second.outcomes[:, :3, 0])[:, :2].all()
        assert (first.outcomes[:, 1, 1] != second.outcomes[:, 1, 1]).all()
        np.testing.assert_array_equal(first.features, second.features)
        names = {path.name for path in cache.iterdir()}
        checksum = outcome_tables.extrapolator(other).checksum[:12]
        added = f"variety-0074-64x36-key-phase4-speed2-{checksum}{ENDING}"
        assert names - set(kept) == {added}
        assert all((cache / name).read_bytes() == data for name, data in kept.items())

    def test_beginnings_are_kept_too(self, scene, model, cache, monkeypatch):
        first = measure_view(scene, BEGINNING[1], model, cache)
        assert len(first.outcomes) == 1
        monkeypatch.setattr(scene_clip, "read_raw", None)
        same(measure_view(scene, BEGINNING[1], model, cache), first)

    def test_what_is_missing_or_unreadable_is_found_anew(self, scene, model, cache, tmp_path):
        whole = measure_view(scene, FAST[1], model, cache)
        none, cut = b"", b"\x93NUMPY and no more"
        for k, damages in enumerate(((none, cut), (cut, none), (None, none))):
            folder = tmp_path / str(k)
            shutil.copytree(cache, folder)
            for kind, damage in zip(("*features*", f"*[!s]{ENDING}"), damages, strict=True):
                for path in folder.glob(f"*slot-phase4{kind}"):
                    path.unlink() if damage is None else path.write_bytes(damage)
            same(measure_view(scene, FAST[1], model, folder), whole)

    def test_what_was_rendered_since_counts(self, model, tmp_path):
        """A scene that grew has more rows, and one that was rendered again other numbers."""
        shutil.copytree(FOLDER, tmp_path / "scene")
        keys, instants = (
            [tmp_path / "scene" / kind / f"variety-0074.{n:04d}.exr" for n in range(1, 14)]
            for kind in ("keys", "instants")
        )
        manifest = tmp_path / "scene" / "manifest.json"
        facts = json.loads(manifest.read_text())
        facts["instants"]["count"], facts["keys"]["count"] = 9, 3
        manifest.write_text(json.dumps(facts))
        late = [keys[2], instants[5], instants[7]]
        for path in late:
            path.rename(path.with_suffix(".later"))
        whole = open_scene(tmp_path / "scene")
        short = measure_view(whole.as_far_as_rendered(), PLAIN[0], model, tmp_path / "cache")
        assert len(short.outcomes) == len(short.features) == 1
        for path in late:  # as old as they were: it is the number of intervals that tells
            path.with_suffix(".later").rename(path)
        grown = measure_view(whole.as_far_as_rendered(), PLAIN[0], model, tmp_path / "cache")
        assert len(grown.outcomes) == len(grown.features) == 2
        np.testing.assert_array_equal(grown.outcomes[:1], short.outcomes)
        shutil.copyfile(instants[8], instants[1])
        age = (tmp_path / "cache").stat().st_mtime + 10
        os.utime(instants[1], (age, age))
        changed = measure_view(whole, PLAIN[0], model, tmp_path / "cache")
        assert (changed.outcomes[0, 0] != grown.outcomes[0, 0]).all()
        np.testing.assert_array_equal(changed.outcomes[1:], grown.outcomes[1:])


def same(found: Measured, wanted: Measured) -> None:
    np.testing.assert_array_equal(found.features, wanted.features)
    np.testing.assert_array_equal(found.outcomes, wanted.outcomes)


def test_with_the_network_that_comes_with_exwarp(scene, tmp_path):
    """Even this small, it is better than warping."""
    found = measure_view(scene, PLAIN[1], None, tmp_path).outcomes
    names = {path.name for path in tmp_path.iterdir()}
    known = json.loads((shipped_folder() / CHECKSUMS).read_bytes())[SHIPPED_EXTRAPOLATOR]
    assert f"variety-0074-64x36-slot-phase0-speed1-{known[:12]}{ENDING}" in names
    gain = found[:, 1, 1, 0] - found[:, 1, 0, 0]
    assert (gain > 0).all()
