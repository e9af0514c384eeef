"""Frames as small pictures inside a page: WebP with room above white, and masks as PNG."""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from exwarp_cli.domain.colour import PEAK, SRGB, encode_display
from exwarp_cli.domain.frame import Bool, Float32

# Media types of colour and errors, and of masks.
WEBP, PNG = "image/webp", "image/png"

LONGEST = 640  # longest side of a picture, pixels

# Qualities of WebP that are tried in turn until a picture is small enough.
QUALITIES = (82, 60, 40, 20)

HIGHEST = 16  # brightest scene-linear value that a picture keeps: four stops above white

# Of the sRGB curve at 1, with which the logarithm above goes on.
SLOPE = 1.055 / 2.4

# Share of a picture's pixel that has to be holes; half of it would lose thin ones.
HOLE_SHARE = 0.25


@dataclass(frozen=True)
class Picture:
    """An encoded image."""

    media: str  # WEBP or PNG
    data: bytes  # the file
    width: int
    height: int
    # Scene-linear value of code 255, see `tone_curve`; 0 for errors and masks.
    peak: int = 0

    def to_plain(self) -> dict[str, str | int]:
        """Return what the page's script reads."""
        url = f"data:{self.media};base64,{base64.b64encode(self.data).decode('ascii')}"
        return {"url": url, "width": self.width, "height": self.height, "peak": self.peak}

    @classmethod
    def from_plain(cls, plain: Mapping[str, Any]) -> Picture:
        """Return the picture that `to_plain` described.

        KeyError, TypeError or ValueError: it describes none.
        """
        media, _, text = plain["url"].removeprefix("data:").partition(";base64,")
        if media not in (WEBP, PNG):
            raise ValueError(f"{media} is no kind of picture")
        data = base64.b64decode(text, validate=True)
        return cls(media, data, int(plain["width"]), int(plain["height"]), int(plain["peak"]))

    def within(self, room: int, longest: int = LONGEST) -> Picture:
        """Return the same in at most about `room` bytes and `longest` pixels on its longest side.

        What is larger is encoded once more; masks are left as they are.
        """
        is_small = len(self.data) <= room and max(self.width, self.height) <= longest
        if self.media != WEBP or is_small:
            return self
        from PIL import Image

        with Image.open(io.BytesIO(self.data)) as image:
            small = image.convert("RGB")
            small.thumbnail((longest, longest), Image.Resampling.BOX)
            return _encode_webp(np.asarray(small, np.float32) / np.float32(255), room, self.peak)


def shrink(pixels: Float32, longest: int = LONGEST) -> Float32:
    """Shrink an image so that its longest side is at most `longest` pixels.

    From float32 [H, W, 3] or more, scene-linear, to float32 [H', W', 3], 0 to HIGHEST: the mean
    over the area of each pixel. NaN and negative values become 0, infinities HIGHEST.
    """
    colour = np.nan_to_num(pixels[..., :3].astype(np.float32), nan=0.0, posinf=HIGHEST, neginf=0.0)
    return np.stack([_shrink_plane(colour[..., c].clip(0, HIGHEST), longest) for c in range(3)], -1)


def find_peak(*images: Float32) -> int:
    """Return the power of two, 1 to HIGHEST, that 99.9 % of the pixels stay below in all images."""
    bright = max(float(np.percentile(image, 99.9)) for image in images)
    return int(min(2 ** math.ceil(math.log2(max(bright, 1.0))), HIGHEST))


def tone_curve(linear: Float32, peak: int) -> Float32:
    """Encode scene-linear values 0 to `peak` as 0 to 1.

    The sRGB curve up to 1, above it the logarithm with the same slope; divided by its value at
    `peak`.
    """
    # With the sRGB curve alone over 0 to 16, shadows would be left in steps of 16 levels.
    above = 1 + np.float32(SLOPE) * np.log(np.maximum(linear, 1))
    coded = np.where(linear <= 1, SRGB.to_code(linear), above)
    return np.asarray(coded.clip(0, None) / (1 + SLOPE * math.log(peak)), np.float32)


def encode_colour(pixels: Float32, peak: int, room: int) -> Picture:
    """Encode what `shrink` returned, in at most about `room` bytes."""
    return _encode_webp(tone_curve(pixels, peak), room, peak)


def encode_error(reference: Float32, test: Float32, room: int, longest: int = LONGEST) -> Picture:
    """Encode how far two frames are apart on a display, in at most about `room` bytes.

    The mean over the channels of the absolute difference of sRGB values, taken before shrinking;
    code 255 is the whole range, by a square root that keeps small errors visible. Frames are
    float32 [H, W, 3] or more, scene-linear, of one size.
    """
    apart = np.abs(encode_display(reference) - encode_display(test)).mean(axis=-1) / np.float32(
        PEAK
    )
    grey = np.sqrt(_shrink_plane(apart, longest))
    return _encode_webp(np.repeat(grey[..., None], 3, axis=-1), room, 0)


def encode_mask(mask: Bool, longest: int = LONGEST) -> Picture:
    """Encode holes, bool [H, W], as a PNG of one bit a pixel."""
    from PIL import Image

    holes = _shrink_plane(mask.astype(np.float32), longest) > HOLE_SHARE
    file = io.BytesIO()
    Image.fromarray(np.where(holes, 255, 0).astype(np.uint8)).convert("1").save(
        file, "PNG", optimize=True
    )
    return Picture(PNG, file.getvalue(), holes.shape[1], holes.shape[0])


def _shrink_plane(plane: Float32, longest: int) -> Float32:
    """Average a plane [H, W] over areas, or return it where it is small enough."""
    height, width = plane.shape
    if max(height, width) <= longest:
        return plane
    from PIL import Image

    scale = longest / max(height, width)
    size = max(round(width * scale), 1), max(round(height * scale), 1)
    small = Image.fromarray(np.ascontiguousarray(plane)).resize(size, Image.Resampling.BOX)
    return np.asarray(small, np.float32)


def _encode_webp(pixels: Float32, room: int, peak: int) -> Picture:
    """Encode pixels [H, W, 3], 0 to 1; below the lowest quality only fewer pixels help."""
    from PIL import Image

    codes = np.floor(pixels.clip(0, 1) * np.float32(255) + np.float32(0.5))
    image = Image.fromarray(codes.astype(np.uint8))
    while True:
        for quality in QUALITIES:
            file = io.BytesIO()
            image.save(file, "WEBP", quality=quality, method=2)
            if file.tell() <= room:
                return Picture(WEBP, file.getvalue(), *image.size, peak)
        if max(image.size) <= 32:
            return Picture(WEBP, file.getvalue(), *image.size, peak)
        image = image.resize((max(image.width // 2, 1), max(image.height // 2, 1)))
