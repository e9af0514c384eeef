"""Contact sheets of what is rendered; runs where ExWarp is installed.

    python examples/scenes/survey_sheets.py --out sheets          # PNG: each scene, 60 shots
    python examples/scenes/survey_sheets.py town --shots 0        # one scene alone
    python examples/scenes/survey_sheets.py --any-licence         # shots with GPL things, too

Writes NAME.png for each judged scene, and training.png. A sheet of training shots shows those alone
whose real things are CC0 or CC-BY, so that it may be committed.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
from stage import manifest as stage_manifest
from stage.manifest import default_data
from things_list import may_be_committed

from exwarp_cli.errors import ExwarpError
from exwarp_cli.io.dataset import BENCHMARK, TRAINING, RenderedScene, find_scenes
from exwarp_cli.io.display_colour import to_display
from exwarp_cli.io.frames import read_image

TILES, TILE_WIDTH = (4, 2), 240
ACROSS = 10
"""Training shots in a row."""

JPEG_QUALITY = 60


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the sheets."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("scenes", nargs="*", metavar="SCENE", help="names of scenes (all that are rendered)")
    add("--data", type=Path, default=default_data(), help="folder of all scenes (%(default)s)")
    add("--out", type=Path, default=Path(), help="folder for the sheets (%(default)s)")
    add("--shots", type=int, default=60, metavar="N", help="training shots (%(default)s)")
    add("--any-licence", action="store_true", help="take shots with things under any licence")
    chosen = parser.parse_args(arguments)
    chosen.out.mkdir(parents=True, exist_ok=True)
    try:
        if chosen.shots:
            shots = find_scenes(chosen.data, TRAINING)
            write_shots(shots, chosen.shots, chosen.out / "training.png", chosen.any_licence)
        if chosen.scenes or not chosen.shots or _has_scenes(chosen.data):
            for scene in find_scenes(chosen.data, BENCHMARK, chosen.scenes):
                write_scene(scene, chosen.out / f"{scene.name}.png")
    except ExwarpError as error:
        raise SystemExit(f"{error}.") from error


def _has_scenes(data: Path) -> bool:
    try:
        return bool(find_scenes(data, BENCHMARK))
    except ExwarpError:
        return False


def write_scene(scene: RenderedScene, path: Path) -> None:
    """Write a judged scene's sheet: rendered instants at equal distances, rows first."""
    rendered = _rendered(scene)
    across, down = TILES
    chosen = np.linspace(0, len(rendered) - 1, across * down).round().astype(int)
    write_tiles([rendered[int(index)] for index in chosen], across, path)


def write_shots(
    shots: Sequence[RenderedScene], count: int, path: Path, any_licence: bool = False
) -> None:
    """Write a sheet of training shots at equal distances in the list: the middle of each."""
    fit = [shot for shot in shots if _rendered(shot) and (any_licence or _is_free(shot))]
    chosen = np.unique(np.linspace(0, len(fit) - 1, min(count, len(fit))).round().astype(int))
    files = [_rendered(fit[int(index)]) for index in chosen]
    write_tiles([rendered[len(rendered) // 2] for rendered in files], ACROSS, path)
    print(f"{path}: {len(files)} of {len(shots)} shots")


def _is_free(shot: RenderedScene) -> bool:
    content = json.loads((shot.folder / stage_manifest.NAME).read_text(encoding="utf-8"))
    return may_be_committed(content.get("things", []))


def _rendered(scene: RenderedScene) -> list[Path]:
    instants = scene.manifest.instants
    paths = [scene.path(instants, number) for number in instants.numbers]
    return [path for path in paths if path.is_file()]


def write_tiles(files: Sequence[Path], across: int, path: Path) -> None:
    """Write pictures side by side, rows first; PNG or JPEG, by the path's suffix."""
    if not files:
        raise SystemExit(f"{path} cannot be written: nothing for it is rendered.")
    tiles = [_tile(file) for file in files]
    height = max(tile.shape[0] for tile in tiles)
    down = -(-len(tiles) // across)
    sheet = np.zeros((down * height, across * TILE_WIDTH, 3), np.uint8)
    for number, tile in enumerate(tiles):
        y, x = divmod(number, across)
        rows = slice(y * height, y * height + tile.shape[0])
        sheet[rows, x * TILE_WIDTH : (x + 1) * TILE_WIDTH] = tile
    buffer = oiio.ImageBuf(sheet)
    if path.suffix == ".jpg":
        buffer.specmod().attribute("Compression", f"jpeg:{JPEG_QUALITY}")
    if not buffer.write(str(path)):
        raise SystemExit(f"{path} cannot be written: {buffer.geterror()}.")


def _tile(file: Path) -> np.ndarray:
    shown = oiio.ImageBuf(to_display(read_image(file).pixels))
    height = round(TILE_WIDTH * shown.spec().height / shown.spec().width)
    roi = oiio.ROI(0, TILE_WIDTH, 0, height, 0, 1, 0, 3)
    small: np.ndarray = oiio.ImageBufAlgo.resize(shown, roi=roi).get_pixels(oiio.UINT8)
    return small


if __name__ == "__main__":
    main()
