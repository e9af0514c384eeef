"""Statistics and a contact sheet of rendered scenes; runs where ExWarp is installed.

    python examples/scenes/survey.py                    # every benchmark scene, as far as rendered
    python examples/scenes/survey.py lab town --data DIR
    python examples/scenes/survey.py --training         # all training shots together
    python examples/scenes/survey.py --floor            # the noise floor alone, even of a part

Prints a table and writes `statistics.json` and `STATISTICS.md` beside this script, and for each
scene `NAME.jpg`, instants at equal distances. Scenes that are not named keep what was measured of
them before. The noise floor also goes into the scene's manifest.
"""

from __future__ import annotations

import argparse
import json
import re
import tempfile
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import survey_shots
from stage import manifest as stage_manifest
from stage.manifest import default_data
from survey_sheets import write_scene
from survey_table import EDGES, lines

from exwarp_cli.domain.results import FrameRecord
from exwarp_cli.domain.settings import SourceSettings, UpsampleSettings
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.errors import ExwarpError, InputError
from exwarp_cli.io.dataset import BENCHMARK, TRAINING, FrameSet, RenderedScene, find_scenes
from exwarp_cli.io.exr.reader import read_headers
from exwarp_cli.io.frames import read_image
from exwarp_cli.metrics.registry import score_frame
from exwarp_cli.pipeline.progress import Silence
from exwarp_cli.pipeline.run import upsample
from exwarp_cli.report.schema import mean_scores
from exwarp_cli.research.training.scene_clip import SceneClip

HERE = Path(__file__).parent
METHODS = ("s6", "softsplat")
SETTINGS = ("key", "slot")
SLOTS = range(1, FACTOR)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, print and write."""
    options = _options(arguments)
    table = _read(options.out / "statistics.json")
    try:
        if options.training:
            table["training"] = measure_training(_complete(options.data), options.out)
            _save(table, options.out)
        elif options.floor:
            for scene in find_scenes(options.data, BENCHMARK, options.scenes):
                print(f"{scene.name}: noise floor {_write_floor(scene)} dB")
            return
        else:
            for scene in find_scenes(options.data, BENCHMARK, options.scenes):
                rendered = scene.as_far_as_rendered()
                table["scenes"][scene.name] = measure(rendered)
                _save(table, options.out)
                write_scene(rendered, options.out / f"{scene.name}.jpg")
    except ExwarpError as error:
        raise SystemExit(f"{error}.") from error
    print("\n".join(lines(table)))


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("scenes", nargs="*", metavar="SCENE", help="names of scenes (all that are rendered)")
    add("--data", type=Path, default=default_data(), help="folder of all scenes (%(default)s)")
    add("--out", type=Path, default=HERE, help="folder for what is written (%(default)s)")
    add("--training", action="store_true", help="count the training shots instead")
    add("--floor", action="store_true", help="measure the noise floor alone, of what is rendered")
    return parser.parse_args(arguments)


def _complete(data: Path) -> list[RenderedScene]:
    """List the training shots that are rendered in full, and say how many are not."""
    shots = find_scenes(data, TRAINING)
    whole = [
        shot
        for shot in shots
        if not shot.missing(shot.manifest.instants) and not shot.missing(shot.manifest.keys)
    ]
    if not whole:
        raise InputError(f"{data} has no training shot that is rendered in full")
    if len(whole) < len(shots):
        print(f"{len(shots) - len(whole)} shots are not rendered in full and left out")
    return whole


def measure(scene: RenderedScene) -> dict[str, Any]:
    """Measure one scene: motion, holes, cost, and what plain methods reach."""
    runs = {
        setting: {method: run(scene, method, setting) for method in METHODS} for setting in SETTINGS
    }
    manifest = scene.manifest
    return {
        "renderer": manifest.renderer,
        "width": manifest.width,
        "height": manifest.height,
        "samples": manifest.samples,
        "seeds": _seeds(scene),
        "denoiser": manifest.denoiser,
        "seed": manifest.seed,
        "instants": manifest.instants.count,
        "seconds_per_instant": _seconds(scene, manifest.instants),
        "megabytes": _megabytes(scene),
        "dynamic_objects": len(manifest.dynamic),
        "noise_floor_psnr_db": _write_floor(scene),
        **_motion(SceneClip(scene)),
        "holes": {setting: _holes(runs[setting]["s6"]) for setting in SETTINGS},
        "quality": {
            setting: {
                method: mean_scores(r.score for r in runs[setting][method]) for method in METHODS
            }
            for setting in SETTINGS
        },
    }


def run(scene: RenderedScene, method: str, setting: str) -> list[FrameRecord]:
    """Upsample a scene through files, as a user does, and return the generated frames' records."""
    if (step := scene.manifest.keys.step) != FACTOR:
        raise InputError(
            f"{scene.folder} has key frames at every {step} instants, which make no sequence of "
            f"the key frame rate; render it again with --key-step {FACTOR}"
        )
    keys, instants = (
        str(scene.folder / frames.pattern)
        for frames in (scene.manifest.keys, scene.manifest.instants)
    )
    with tempfile.TemporaryDirectory(prefix="exwarp-survey-") as folder:
        gbuffers = instants if setting == "slot" else None
        source = SourceSettings(keys, gbuffers, scene.manifest.motion, tail=False)
        settings = UpsampleSettings(source, folder, method, ground_truth=instants)
        return [record for record in upsample(settings, Silence()).frames if record.slot]


def _noise_floor(scene: RenderedScene) -> float | None:
    """PSNR between instants rendered twice, with other noise; None where they were not."""
    found = []
    for path in sorted((scene.folder / "floor").glob(f"{scene.name}.*.exr")):
        number = int(path.suffixes[0][1:])
        instant = scene.path(scene.manifest.instants, number)
        if not instant.is_file():
            continue
        rendered = read_image(instant).pixels
        found.append(score_frame(rendered, read_image(path).pixels, None)[0].psnr_db)
    return round(float(np.mean(found)), 2) if found else None


def _write_floor(scene: RenderedScene) -> float | None:
    """Measure the noise floor and add it to the scene's manifest."""
    floor = _noise_floor(scene)
    stage_manifest.write_floor(scene.folder, floor)
    return floor


def _seeds(scene: RenderedScene) -> int:
    """Renders whose mean each frame is."""
    content = json.loads((scene.folder / stage_manifest.NAME).read_text(encoding="utf-8"))
    return int(content.get("seeds", 1))


def _motion(footage: SceneClip) -> dict[str, float]:
    """Length of the motion to the next key frame, and how much moves or is sky."""
    median, high, moving, sky = [], [], [], []
    for k in footage.intervals:
        gbuffer = footage.key(k).gbuffer
        assert gbuffer is not None and gbuffer.to_next is not None
        assert gbuffer.stencil is not None and gbuffer.depth is not None
        length = np.linalg.norm(gbuffer.to_next, axis=-1)
        median.append(float(np.nanmedian(length)))
        high.append(float(np.nanpercentile(length, 95)))
        moving.append(float((gbuffer.stencil != 0).mean()))
        sky.append(float(np.isinf(gbuffer.depth).mean()))
    return {
        "motion_median_px": round(float(np.median(median)), 2),
        "motion_median_px_calmest": round(min(median), 2),
        "motion_median_px_fastest": round(max(median), 2),
        "motion_p95_px": round(float(np.median(high)), 2),
        "motion_p95_px_fastest": round(max(high), 2),
        "moving_share": round(float(np.mean(moving)), 4),
        "sky_share": round(float(np.mean(sky)), 4),
    }


def _holes(records: Iterable[FrameRecord]) -> dict[str, Any]:
    """Hole shares of the warp from the last key frame."""
    shares = {slot: [] for slot in SLOTS}
    for record in records:
        shares[record.slot].append(record.hole_fraction or 0.0)
    everything = [share for slot in SLOTS for share in shares[slot]]
    counts, _ = np.histogram(everything, EDGES)
    return {
        **{f"slot{slot}": round(float(np.mean(shares[slot])), 4) for slot in SLOTS},
        "mean": round(float(np.mean(everything)), 4),
        "least": round(min(everything), 4),
        "most": round(max(everything), 4),
        "histogram": {
            f"{100 * low:g}-{100 * high:g} %": int(count)
            for low, high, count in zip(EDGES[:-1], EDGES[1:], counts, strict=True)
        },
    }


def measure_training(shots: Sequence[RenderedScene], out: Path) -> dict[str, Any]:
    """Measure what is hard in each training shot, and how much they differ."""
    rows = []
    for shot in shots:
        rows.append(survey_shots.measure(shot))
        print(f"{shot.name}: {len(rows)} of {len(shots)}", flush=True)
    survey_shots.write_rows(rows, out / "SHOTS.md")
    first = shots[0].manifest
    sizes = Counter(f"{shot.manifest.width}x{shot.manifest.height}" for shot in shots)
    times = [_seconds(shot, shot.manifest.instants) for shot in shots]
    return {
        "shots": len(shots),
        "instants": first.instants.count,
        "sizes": dict(sizes.most_common()),
        "samples": first.samples,
        "renders": round(float(np.mean([_seeds(shot) for shot in shots])), 2),
        "seconds_per_instant": round(float(np.mean(times)), 2),
        "megabytes": sum(_megabytes(shot) for shot in shots),
        **survey_shots.summary(rows),
    }


def _seconds(scene: RenderedScene, frames: FrameSet) -> float:
    """Mean of the render times that the renderer wrote into the headers."""
    times = [_render_time(scene.path(frames, number)) for number in frames.numbers]
    return round(float(np.mean(times)), 2)


def _render_time(path: Path) -> float:
    text = str(read_headers(path)[0].get("RenderTime", ""))
    match = re.fullmatch(r"(?:(\d+):)?(\d+):(\d+\.\d+)", text)
    if match is None:
        raise InputError(f"{path} has no render time in its header; render it again")
    hours, minutes, seconds = match.groups()
    return 3600 * int(hours or 0) + 60 * int(minutes) + float(seconds)


def _megabytes(scene: RenderedScene) -> int:
    kinds = (scene.manifest.instants, scene.manifest.keys)
    paths = [scene.path(frames, number) for frames in kinds for number in frames.numbers]
    return round(sum(path.stat().st_size for path in paths) / 1e6)


def _read(path: Path) -> dict[str, Any]:
    if path.is_file():
        found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        return found
    return {"scenes": {}}


def _save(table: dict[str, Any], folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    text = json.dumps(table, indent=2) + "\n"
    (folder / "statistics.json").write_text(text, encoding="utf-8")
    words = "\n".join(lines(table)) + "\n"
    (folder / "STATISTICS.md").write_text(words, encoding="utf-8")


if __name__ == "__main__":
    main()
