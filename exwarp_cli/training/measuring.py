"""What rendered scenes tell a policy: the features of every instant, and what each choice comes to.

Measuring takes about a second for each key interval of 427x240 pixels on one core, nearly all of
it for E; it is kept on disk by scene, view and network, so that it is done once. What was found
before a frame of the scene was rendered is found anew.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace
from functools import lru_cache, partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.io.dataset import RenderedScene
from exwarp_cli.io.files import atomic_write_bytes, make_folder
from exwarp_cli.io.models import OnnxExtrapolator, load_extrapolator
from exwarp_cli.io.threads import use_threads
from exwarp_cli.pipeline.choosing import outcomes_of
from exwarp_cli.pipeline.observing import with_ids
from exwarp_cli.policy.features import observe
from exwarp_cli.runtime.stop import check_stop
from exwarp_cli.training.footage import Footage
from exwarp_cli.training.variant import Variant

OUTCOMES_VERSION, FEATURES_VERSION = 1, 1
"""Raised whenever the same scene would give other numbers."""

F64 = npt.NDArray[np.float64]


@dataclass(frozen=True)
class View:
    """One way of turning a render into a sequence with key frames.

    Attributes
    ----------
    setting
        "key" or "slot".
    variant
        Which instants are key frames.
    begins
        Whether every interval is looked at as if the sequence began with it: no key frame before,
        and no features of one. Every `BEGINNING_EVERY`-th is; a sequence has one such interval, and
        from five views of a scene hardly anything was learned of it.
    """

    setting: str
    variant: Variant
    begins: bool = False

    @property
    def name(self) -> str:
        """Short and fit for a file's name."""
        name = f"{self.setting}-phase{self.variant.phase}-speed{self.variant.speed}"
        return f"{name}-begins" if self.begins else name

    def intervals(self, footage: Footage) -> Sequence[int]:
        """Return the indices of the key intervals that are looked at."""
        return footage.intervals[:: BEGINNING_EVERY if self.begins else 1]


BEGINNING_EVERY = 6

_SEEN = ((0, 1), (2, 1), (0, 2), (4, 2), (1, 1), (3, 1))
_SETTINGS = ("key", "slot")

VIEWS = (
    *(View(s, Variant(phase, speed=speed)) for phase, speed in _SEEN for s in _SETTINGS),
    *(View(s, Variant(speed=speed), begins=True) for speed in (1, 2) for s in _SETTINGS),
)
"""Every phase at normal speed, two at double speed, and beginnings, in both settings."""


def fits(scene: RenderedScene, view: View) -> bool:
    """Whether a scene is long enough for a view to have a whole key interval."""
    return len(view.variant.order(scene.manifest.instants.count)) > FACTOR


@dataclass(frozen=True)
class Measured:
    """All key intervals of one view of a scene, in their order.

    Attributes
    ----------
    features
        float64 [K, 3, 8]: the fields of `Features` at t, t + 1/4 and t + 1/2.
    outcomes
        float64 [K, 5, 2, 2], see `exwarp_cli.policy.outcomes`.
    """

    features: F64
    outcomes: F64


@lru_cache(1)
def network(path: Path | None) -> OnnxExtrapolator:
    """Return E on one thread; scenes are measured side by side."""
    use_threads(1)
    return load_extrapolator(path, 1, "cpu")


def measure(scene: RenderedScene, view: View, model: Path | None, cache: Path) -> Measured:
    """Measure one view of a scene, or take what an earlier run found.

    Parameters
    ----------
    scene
        Rendered to the end.
    view
        How it is looked at.
    model
        E's ONNX file; None for the one that comes with ExWarp.
    cache
        Folder for what was measured.
    """
    footage = Footage(scene, view.variant)
    name = f"{scene.name}-{scene.manifest.size}-{view.name}"
    by = network(model).checksum[:12]
    kept = {
        f"{name}-features-v{FEATURES_VERSION}.npy": partial(_features, footage, view),
        f"{name}-{by}-v{OUTCOMES_VERSION}.npy": partial(_outcomes, footage, view, network(model)),
    }
    make_folder(cache)
    known = {file: _known(cache / file, footage, view) for file in kept}
    missing = [file for file in kept if known[file] is None]
    rows: dict[str, list[F64]] = {file: [] for file in missing}
    # Interval by interval, so that both find the same frames in memory.
    for k in view.intervals(footage) if missing else ():
        for file in missing:
            rows[file].append(kept[file](k))
        check_stop()
    for file in missing:
        text, known[file] = io.BytesIO(), np.array(rows[file])
        np.save(text, np.array(rows[file]))
        atomic_write_bytes(cache / file, text.getvalue())
    features, outcomes = known.values()
    assert features is not None and outcomes is not None
    return Measured(features, outcomes)


def _known(path: Path, footage: Footage, view: View) -> F64 | None:
    """Return what an earlier run found; None where a frame is younger, or there are more now."""
    scene = footage.scene
    frames = scene.manifest.instants, scene.manifest.keys
    files = [scene.path(part, number) for part in frames for number in part.numbers]
    try:
        if path.stat().st_mtime_ns < max(file.stat().st_mtime_ns for file in files):
            return None
        found: F64 = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError):
        return None
    return found if len(found) == len(view.intervals(footage)) else None


def _features(footage: Footage, view: View, k: int) -> F64:
    """Return the features at the three instants of an interval at which something is decided."""
    first = k == 0 or view.begins
    if view.setting == "key":
        before = None if first else footage.key(k - 1).gbuffer
        gbuffer = footage.key(k).gbuffer
        assert gbuffer is not None
        return np.array([astuple(observe(with_ids(gbuffer), before, FACTOR))] * 3, np.float64)
    orders = range(FACTOR * k - 1, FACTOR * k + 3)
    instants = [
        None if first and order < FACTOR * k else footage.slot(*divmod(order, FACTOR)).gbuffer
        for order in orders
    ]
    rows = []
    for before, gbuffer in pairwise(instants):
        assert gbuffer is not None
        rows.append(astuple(observe(with_ids(gbuffer), before, 1)))
    return np.array(rows, np.float64)


def _outcomes(footage: Footage, view: View, extrapolator: OnnxExtrapolator, k: int) -> F64:
    interval = replace(footage.causal(k, view.setting), extrapolator=extrapolator)
    if view.begins:
        interval = replace(interval, past=())
    truth = {slot: footage.truth(k, slot).pixels for slot in range(1, FACTOR)}
    return outcomes_of(interval, truth)
