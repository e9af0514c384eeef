"""Files of single frames, EXR or another still format by their suffix: written, read, recognised.

A generated frame says what it was made of where its format keeps that: in EXR's header, and in PNG,
JPEG and TIFF as text. For other formats see `io.authorship`.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeAlias

from exwarp_cli.domain.frame import Float32, Image
from exwarp_cli.io.exr.template import Plane, PlaneKey, Template, quantise
from exwarp_cli.io.exr.writer import Buffer
from exwarp_cli.io.frames import read_image
from exwarp_cli.io.output import PREFIX, recipe_of, write_frame, written_attributes
from exwarp_cli.io.sequence import EXR
from exwarp_cli.io.still_seal import still_facts
from exwarp_cli.io.stills import StillTemplate, quantise_still, read_still, write_still

FrameTemplate: TypeAlias = Template | StillTemplate
"""What a generated frame takes over from its key frame's file."""


def write_picture(
    path: Path,
    image: Image,
    template: FrameTemplate,
    attributes: Mapping[str, Any],
    beside: Mapping[PlaneKey, Plane] | None = None,
) -> list[Buffer]:
    """Write a generated frame, whole or not at all; return its bytes, piece by piece.

    Parameters
    ----------
    path
        Target; its folder exists.
    image
        Scene-linear colour.
    template
        Of the format that the suffix tells.
    attributes
        As for :func:`exwarp_cli.io.output.write_frame`; stills keep those of ExWarp's own.
    beside
        Further channels; only for EXR.

    Raises
    ------
    OutputError
        When it cannot be written.
    """
    if isinstance(template, StillTemplate):
        own = {k[len(PREFIX) :]: v for k, v in attributes.items() if k.startswith(PREFIX)}
        return write_still(path, image, template, own)
    return write_frame(path, image, template, attributes, beside)


def read_picture(path: Path, view: str = "") -> Image:
    """Read the colour of one file; see `read_image` and `read_still`."""
    return read_image(path, view) if _is_exr(path) else read_still(path)[0]


def recipe_in(path: Path) -> str | None:
    """Return the recipe of an undamaged generated frame; None for anything else."""
    if _is_exr(path):
        return recipe_of(path)
    recipe = facts_in(path).get("recipe")
    return recipe if isinstance(recipe, str) else None


def facts_in(path: Path) -> dict[str, Any]:
    """Return what a generated frame says of itself; nothing for what says nothing."""
    return written_attributes(path) if _is_exr(path) else still_facts(path) or {}


def quantised(pixels: Float32, template: FrameTemplate) -> Float32:
    """Round pixels to what the file will have, so that what is scored is what is kept."""
    if isinstance(template, StillTemplate):
        return quantise_still(pixels, template)
    return quantise(pixels, template)


def _is_exr(path: Path) -> bool:
    return path.suffix.lower() in EXR
