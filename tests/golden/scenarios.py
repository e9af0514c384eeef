"""What the golden run does: the input shots, and the table of commands."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import OpenEXR

from tests.cli import pictures, shots
from tests.cli.shots import SMALL
from tests.cli.spoiling import remove, scribble, truncate
from tests.cli.street import Street
from tests.stereo_shots import write_stereo
from tests.unit.tiny_interpolators import PAIR, put, rife
from tests.unit.tiny_models import convolution, save

EXAMPLE = Path(__file__).parents[2] / "examples" / "market"
ENLARGED = 10
"""Side of the square that a pixel of the large shot becomes: 240x176 is 4.2 megapixels then."""

COMPRESSIONS = {
    "zip": OpenEXR.ZIP_COMPRESSION,
    "zips": OpenEXR.ZIPS_COMPRESSION,
    "piz": OpenEXR.PIZ_COMPRESSION,
    "pxr24": OpenEXR.PXR24_COMPRESSION,
    "rle": OpenEXR.RLE_COMPRESSION,
    "dwaa": OpenEXR.DWAA_COMPRESSION,
    "none": OpenEXR.NO_COMPRESSION,
}


def write_inputs(folder: Path) -> None:
    """Write every shot and network that the scenarios name."""
    five, sixteen = range(1, 6), range(1, 18)
    shots.sequence(folder / "keys", shots.plain, five, SMALL)
    shots.sequence(folder / "colour", shots.colour_only, five, SMALL)
    shots.sequence(folder / "slots", shots.slot_gbuffer, sixteen, SMALL, step=0.25)
    shots.truth(folder / "truth", 5, street=SMALL)
    shots.sequence(folder / "tiny", shots.plain, (1, 2), Street(12, 8))
    shots.sequence(folder / "nan", _with_nan, (1, 2, 3), SMALL)
    shots.sequence(folder / "blender4", shots.blender4, (1, 2, 3), SMALL)
    shots.sequence(folder / "blender5", shots.blender5, (1, 2, 3), SMALL)
    shots.sequence(folder / "large", _enlarged, (1, 2), Street(240, 176))
    shots.sequence(folder / "cut", _two_places, range(1, 9), SMALL)
    for name, damage in {"gap": remove, "cut-off": truncate, "scribbled": scribble}.items():
        damage(Path(shutil.copytree(folder / "keys", folder / name)) / "shot.0003.exr")
    for name, number in COMPRESSIONS.items():
        _compressed(folder / f"in-{name}", number)
    for number in (1, 2, 3):
        shots.unreal(folder / "unreal", SMALL, number - 1, number)
    for layout in ("single", "parts"):
        write_stereo(folder / f"stereo-{layout}", layout)
    frames = [pictures.frame(time) for time in range(4)]
    for suffix in ("png", "tif", "jpg"):
        for number, codes in enumerate(frames, 1):
            # OpenImageIO would put the present time into TIFF.
            path = folder / suffix / f"pan.{number:04d}.{suffix}"
            pictures.write_still(path, codes, DateTime="2026:01:01 00:00:00")
    pictures.clip(folder / "pan.mp4", frames)
    save(folder / "e.onnx", convolution())
    card = {"inputs": PAIR | {"timestep": "time"}, "padding": {"multiple": 32}}
    put(folder / "i.onnx", rife(), card)
    shutil.copytree(EXAMPLE, folder / "market")


def _with_nan(path: Path, street: Street, time: float) -> None:
    planes = shots.plain_planes(street, time)
    if time == 1:
        planes["G"][8:14, 15:25] = np.nan
        planes["forward.u"][3:6, 20:30] = np.inf
    shots.write(path, {"": planes})


def _enlarged(path: Path, street: Street, time: float) -> None:
    """Write a frame of large pixels; casting as many rays would take minutes."""
    square = np.ones((ENLARGED, ENLARGED), np.float32)
    planes = {
        name: np.kron(plane, square * (ENLARGED if name.startswith("forward") else 1))
        for name, plane in shots.plain_planes(street, time).items()
    }
    halves = {name: planes[name].astype(np.float16) for name in "RGBA"}
    shots.write(path, {"": planes | halves})


def _two_places(path: Path, street: Street, time: float) -> None:
    """Write a shot whose camera is elsewhere from the fifth key frame on."""
    shots.blender4(path, street, time - 20 if time < 4 else time + 2)


def _compressed(folder: Path, compression: object) -> None:
    for number in (1, 2):
        parts = shots.multipart(shots.blender_passes(SMALL, number - 1))
        path = folder / f"shot.{number:04d}.exr"
        shots.write(path, parts, shots.header(compression=compression))


E = "--extrapolator ../inputs/e.onnx"
TRUTH = "--ground-truth ../inputs/truth"
REPORT = "--report report"
SETTINGS = {
    "key": "upsample ../inputs/keys --motion next=u,-v",
    "slot": "upsample ../inputs/colour --gbuffers ../inputs/slots "
    "--motion 'previous=X,-Y next=-Z,W'",
}
KEY = SETTINGS["key"]
MARKET = "upsample ../inputs/market/keys"
MARKET_TRUTH = "--ground-truth ../inputs/market/truth"
METHODS = {
    **{f"s{n}": f"-m s{n} {E}" for n in range(1, 6)},
    "s6": "-m s6",
    "exwarp": "",
    "causal": f"--causal {E}",
    "oracle": f"-m oracle {E} {TRUTH}",
    "softsplat": "-m softsplat",
}
SPREAD = (("causal", "key"), ("exwarp", "key"), ("s3", "slot"))
"""What is also done with other threads and in chunks."""

COMMANDS = (
    "", "upsample", "inspect", "features", "compare", "merge-reports", "farm", "farm commands",
    "farm openjd", "bench", "train", "train extrapolator", "train policy", "models",
    "models import-extranet", "models interpolator-card", "policy", "policy cycles",
    "policy export", "policy run", "doctor", "completion",
)  # fmt: skip
INTERPRETED = "interpreted"
"""First word of scenarios that run with NUMBA_DISABLE_JIT=1."""

SCENARIOS: Mapping[str, tuple[str, ...]] = {
    # The slowest come first, so that both cores have work until the end.
    "large E": (f"upsample ../inputs/large --motion next=u,-v -m s1 {E} --no-tail",),
    "bench": (
        f"bench ../inputs/keys {TRUTH} --frames 1-2 -o out --motion next=u,-v {E} --metrics psnr",
    ),
    **{
        f"{INTERPRETED} {method}": (
            f"upsample ../inputs/tiny --motion next=u,-v --no-tail {METHODS[method]}",
        )
        for method in ("s1", "s6", "causal", "softsplat")
    },
    "market exwarp": (
        f"{MARKET} --frames 1-3 {MARKET_TRUTH} {REPORT} --metrics all --video out.mp4",
        "compare ../inputs/market/truth out --frames 1-9 --json --metrics psnr,ssim,flip",
    ),
    "market causal": (f"{MARKET} --causal --frames 1-3 {MARKET_TRUTH} {REPORT}",),
    "market softsplat": (f"{MARKET} -m softsplat {MARKET_TRUTH} {REPORT} --write-holes holes",),
    "market s6": (f"{MARKET} -m s6 --layers all --verify {REPORT}",),
    "workers": (f"{KEY} -m softsplat --workers 2 --threads 2",),
    **{
        f"{method} {setting}": (f"{command} {options} {REPORT}",)
        for method, options in METHODS.items()
        for setting, command in SETTINGS.items()
    },
    "oracle-return": (f"{KEY} -m oracle-return {E} {TRUTH} {REPORT}",),
    "onnx": (f"{KEY} -m onnx --interpolator ../inputs/i.onnx {REPORT}",),
    "blend": (f"{KEY} -m blend {REPORT}",),
    "hold": (f"{KEY} -m hold {REPORT}",),
    **{
        f"{method} {setting} threads {threads}": (
            f"{SETTINGS[setting]} {METHODS[method]} --threads {threads}",
        )
        for method, setting in SPREAD
        for threads in (2, 5)
    },
    **{
        f"{method} {setting} chunks {len(chunks)}": (
            *(
                f"{SETTINGS[setting]} {METHODS[method]} --frames {chunk} {REPORT} --as-chunk"
                for chunk in chunks
            ),
            "merge-reports report",
        )
        for method, setting in SPREAD
        for chunks in (("1-2", "3-4", "5"), "12345")
    },
    **{
        f"reads {name}": (f"upsample ../inputs/in-{name} -m softsplat --layers all",)
        for name in COMPRESSIONS
    },
    **{
        f"writes {name}": (f"{KEY} -m s6 --frames 1-2 --compression {name}",)
        for name in (*COMPRESSIONS, "zip:4")
        if name != "zip"
    },
    "layers": (
        f"upsample ../inputs/blender5 -m s6 --layers all {REPORT}",
        "upsample ../inputs/blender4 -m s6 --layers *Normal*,*IndexOB* -o named",
    ),
    "files for each AOV": (f"upsample ../inputs/unreal -m softsplat {REPORT}",),
    "views": (
        f"upsample ../inputs/stereo-single -m softsplat --view all {REPORT}",
        "upsample ../inputs/stereo-single -m s6 --view right -o right",
    ),
    "views of many windows": ("upsample ../inputs/stereo-parts -m s6 --view all --layers all",),
    "stills": (
        f"upsample ../inputs/png {REPORT}",
        "upsample ../inputs/tif -o tif --factor 2",
        "upsample ../inputs/jpg -o jpg/a.##.exr --fps 25",
    ),
    "clip": (f"upsample ../inputs/pan.mp4 -o out.mp4 {REPORT}",),
    "cuts": (
        f"upsample ../inputs/cut -m softsplat {REPORT}",
        "upsample ../inputs/cut -m s6 --cuts 3 -o named",
        f"upsample ../inputs/cut -m s3 {E} --cuts none -o none",
    ),
    **{
        f"{name} frame": (
            f"upsample ../inputs/{name} --motion next=u,-v -m softsplat --keep-going {REPORT}",
            f"upsample ../inputs/{name} --motion next=u,-v -m s3 {E} --keep-going -o s3",
            f"upsample ../inputs/{name} --motion next=u,-v -m softsplat -o refused",
        )
        for name in ("gap", "cut-off", "scribbled")
    },
    "nan": (
        f"upsample ../inputs/nan --motion next=u,-v -m softsplat {REPORT}",
        f"upsample ../inputs/nan --motion next=u,-v -m s1 {E} -o s1",
    ),
    "resume": (
        f"{KEY} -m softsplat",
        "rm out/shot.0003.exr out/shot.0010.exr",
        f"{KEY} -m softsplat --skip-existing {REPORT}",
        f"{KEY} -m softsplat",
    ),
    "rates": (
        f"{KEY} -m softsplat --factor 3 --keep-bytes --start-frame 100",
        f"{KEY} -m softsplat --fps 24 --to-fps 60 -o 60",
        f"{KEY} -m s6 --frames 1-5x2 --no-tail -o steps",
    ),
    "video": (f"{KEY} -m s6 --video out.mp4 --exposure 1",),
    "progress": (
        f"{KEY} -m s6 --progress json",
        f"{KEY} -m s6 --progress openjd --dry-run --overwrite",
    ),
    "compare": (
        "compare ../inputs/truth ../inputs/colour --metrics all --report report",
        "compare ../inputs/market/truth ../inputs/market/keys --metrics psnr,flicker --json",
        "compare ../inputs/truth ../inputs/colour --fail-below psnr=60",
    ),
    "features": (
        "features ../inputs/keys --motion next=u,-v",
        "features ../inputs/market/keys --frames 1-3 --json",
        "features ../inputs/colour --gbuffers ../inputs/slots --motion 'previous=X,-Y next=-Z,W'",
    ),
    "farm": (
        "farm openjd ../inputs/keys -o out -m softsplat --report report --motion next=u,-v",
        "farm commands ../inputs/keys -o out --chunk-size 2 --video a.mp4 --motion next=u,-v",
    ),
    "inspect": (
        "inspect ../inputs/keys --json",
        "inspect ../inputs/blender5",
        "inspect ../inputs/stereo-parts --json",
        "inspect ../inputs/market/keys --write-channel-map map.toml",
        "inspect ../inputs/pan.mp4 --json",
    ),
    "policy": (
        "policy cycles --json",
        "policy export out",
        "models interpolator-card ../inputs/i.onnx --shape rife",
    ),
    "dry run": (f"{KEY} --causal {E} --dry-run --json", f"{KEY} -m s6 --dry-run"),
    "doctor": ("doctor --json",),
    "refusals": (
        f"{KEY} -m s7",
        f"{KEY} -m s6 {E}",
        "upsample ../inputs/nowhere",
        "upsample ../inputs/colour -m s6",
        f"{KEY} -m oracle {E}",
        f"{KEY} -m s6 --max-pixels 100",
        "compare ../inputs/truth ../inputs/png",
    ),
    "help": tuple(f"{command} --help".strip() for command in COMMANDS),
}
