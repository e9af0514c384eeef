"""Write the moving picture of the README: key frames held, ExWarp and rendered frames side by side.

Usage: ``python examples/moving_comparison.py``, where ExWarp is installed, upsamples the market
example and writes docs/images/comparison.webp. The frames pass four times as slowly as they are.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

from exwarp_cli import api
from exwarp_cli.io.display_colour import to_display
from exwarp_cli.io.frames import read_image

ROOT = Path(__file__).parents[1]
MARKET = ROOT / "examples" / "market"
TARGET = ROOT / "docs" / "images" / "comparison.webp"
LABELS = ("key frames only", "ExWarp", "rendered")
CROP = (150, 60, 230, 105)
"""Left, top, right and bottom of the enlarged part, in pixels."""

ENLARGED = 4
MILLISECONDS = 33
"""How long a frame is shown: 120 frames a second would be 8.3."""


def read_frame(path: Path) -> Image.Image:
    """Return a frame as a display shows it."""
    return Image.fromarray(to_display(read_image(path).pixels))


def compose(panels: list[Image.Image]) -> Image.Image:
    """Return panels side by side, each above an enlarged part of it."""
    width, height = panels[0].size
    left, top, right, bottom = CROP
    part_size = ((right - left) * ENLARGED, (bottom - top) * ENLARGED)
    canvas = Image.new("RGB", (len(panels) * (width + 4) - 4, height + 4 + part_size[1]), "white")
    draw = ImageDraw.Draw(canvas)
    font = ImageFont.load_default(14)
    for i, (panel, label) in enumerate(zip(panels, LABELS, strict=True)):
        x = i * (width + 4)
        part = panel.crop(CROP).resize(part_size, Image.Resampling.NEAREST)
        framed = panel.copy()
        ImageDraw.Draw(framed).rectangle((left, top, right, bottom), outline="white")
        canvas.paste(framed, (x, 0))
        canvas.paste(part, (x, height + 4))
        draw.text((x + 7, 5), label, fill="black", font=font)
        draw.text((x + 6, 4), label, fill="white", font=font)
    return canvas


def main() -> None:
    """Upsample the example and write the picture."""
    with tempfile.TemporaryDirectory() as folder:
        source = api.SourceSettings(str(MARKET / "keys"), tail=False)
        api.upsample(api.UpsampleSettings(source, folder))
        generated = sorted(Path(folder).glob("*.exr"))
        truth = sorted((MARKET / "truth").glob("*.exr"))
        frames = [
            compose([read_frame(truth[i - i % 4]), read_frame(generated[i]), read_frame(truth[i])])
            for i in range(len(generated))
        ]
    TARGET.parent.mkdir(exist_ok=True)
    first, *others = frames
    first.save(
        TARGET,
        save_all=True,
        append_images=others,
        duration=MILLISECONDS,
        loop=0,
        quality=70,
        method=6,
    )


if __name__ == "__main__":
    main()
