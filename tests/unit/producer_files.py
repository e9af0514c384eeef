"""The same frame as each renderer would write it: names, conventions and units, spelt by hand.

Written from what the renderers document, not with the package's own conversions, so that a mistake
in those shows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tests.blender_layers import blender_depth, blender_vector, layer

Planes = dict[str, np.ndarray]
Files = dict[str, Planes]
"""Planes by the AOV of their file, "" for the main one."""

MOST = 13.0
"""What vectors are normalised by where an artist sets a maximum, pixels: no usual scale is near."""


@dataclass(frozen=True)
class Passes:
    """One frame: R G B A, geometry with inf as far depth, motion in pixels with y down."""

    colour: np.ndarray
    depth: np.ndarray
    normal: np.ndarray
    position: np.ndarray
    ident: np.ndarray
    previous: np.ndarray
    following: np.ndarray

    @property
    def size(self) -> np.ndarray:
        """Width and height."""
        return np.array(self.depth.shape[::-1], np.float64)


@dataclass(frozen=True)
class Producer:
    """How a producer writes, and what is to be found.

    Attributes
    ----------
    write
        Makes a frame's planes.
    name
        What the names tell.
    previous, following
        Whether vectors lead there.
    """

    write: Callable[[Passes], Files]
    name: str
    previous: bool = False
    following: bool = False


UP = np.array([1.0, -1.0])
"""Turns y over."""


def _vectors(name: str, letters: str, *columns: np.ndarray) -> Planes:
    return layer(name, letters, np.concatenate([c.reshape(*c.shape[:2], -1) for c in columns], -1))


def _beauty(p: Passes) -> Planes:
    return layer("", "RGBA", p.colour, np.float16)


def blender(prefix: str, ident: str) -> Callable[[Passes], Files]:
    def write(p: Passes) -> Files:
        return {
            "": {
                **layer(f"{prefix}Combined", "RGBA", p.colour, np.float16),
                **layer(f"{prefix}Depth", "Z", blender_depth(p.depth)),
                **layer(f"{prefix}Vector", "XYZW", blender_vector(p.previous, p.following)),
                **layer(f"{prefix}Normal", "XYZ", p.normal),
                **layer(f"{prefix}Position", "XYZ", p.position),
                **layer(f"{prefix}{ident}", "X", p.ident),
                **layer(f"{prefix}CryptoObject00", "rgba", p.colour),
            }
        }

    return write


def unreal(p: Passes) -> Files:
    sky = np.isinf(p.depth)
    return {
        "": _beauty(p),
        "MotionVector": _vectors("", "RG", -p.previous[..., 0], p.previous[..., 1]),
        "SceneDepth": layer("", "R", np.where(sky, 0, p.depth)),
        "WorldNormal": layer("", "RGB", np.where(sky[..., None], -1, p.normal)),
        "WorldPosition": layer("", "RGB", p.position),
        "MyStencil": layer("", "R", p.ident),
    }


def movie_render_queue(screens: float) -> Callable[[Passes], Files]:
    """Current minus previous, y up, in so many screens, 0.5 is still."""

    def write(p: Passes) -> Files:
        moved = 0.5 + p.previous * -UP / (screens * p.size)
        queue = "FinalImageMovieRenderQueue_"
        return {
            "": {
                **_beauty(p),
                **layer(f"{queue}MotionVectors", "RG", moved),
                **layer(f"{queue}WorldDepth", "R", 100 * blender_depth(p.depth)),
                **layer(f"{queue}WorldNormal", "RGB", p.normal),
                **layer("ActorHitProxyMask00", "RGBA", p.colour),
            }
        }

    return write


def arnold(motion: Callable[[np.ndarray], np.ndarray]) -> Callable[[Passes], Files]:
    def write(p: Passes) -> Files:
        encoded = motion(p.following * UP)
        return {
            "": {
                **_beauty(p),
                **layer("", "Z", blender_depth(p.depth)),
                **layer("motionvector", "RGB"[: encoded.shape[-1]], encoded),
                **layer("N", "XYZ", p.normal),
                **layer("P", "XYZ", p.position),
                "ID": p.ident.astype(np.float32),
                **layer("crypto_object00", "RGBA", p.colour),
            }
        }

    return write


def direction(vectors: np.ndarray, middle: float = 0.0) -> np.ndarray:
    """Unit direction and length; a direction about 0.5 reaches from 0 to 1."""
    size = np.linalg.norm(vectors, axis=-1, keepdims=True)
    unit = vectors / np.where(size > 0, size, 1)
    return np.concatenate([unit * (0.5 if middle else 1.0) + middle, size], -1)


def share(vectors: np.ndarray) -> np.ndarray:
    """Normalised by a maximum, with a third channel that means nothing."""
    return np.concatenate([vectors / MOST, np.zeros((*vectors.shape[:2], 1))], -1)


def vray(clamped: bool) -> Callable[[Passes], Files]:
    def write(p: Passes) -> Files:
        vectors = np.concatenate([p.following * UP, np.zeros((*p.depth.shape, 1))], -1)
        if clamped:
            vectors = np.clip(0.5 + 0.5 * vectors / MOST, 0, 1)
        return {
            "": {
                **_beauty(p),
                **layer("velocity", "XYZ", vectors),
                **layer("zdepth", "R", blender_depth(p.depth)),
                **layer("normals", "XYZ", p.normal),
                **layer("renderId", "R", p.ident),
                **layer("materialId", "R", p.ident),
            }
        }

    return write


def redshift(p: Passes) -> Files:
    return {
        "": {
            **_beauty(p),
            **layer("MotionVectors", "RG", p.following * UP),
            **layer("Depth", "R", blender_depth(p.depth)),
            **layer("N", "RGB", p.normal),
            **layer("WorldPosition", "RGB", p.position),
            **layer("ObjectID", "R", p.ident),
            **layer("Cryptomatte00", "RGBA", p.colour),
        }
    }


def renderman(p: Passes) -> Files:
    return {
        "": {
            **_beauty(p),
            **layer("motionFore", "XY", p.following),
            **layer("motionBack", "XY", p.previous),
            **layer("__Nworld", "RGB", p.normal),
            **layer("__Pworld", "RGB", p.position),
            "z": blender_depth(p.depth).astype(np.float32),
            "id": p.ident.astype(np.float32),
        }
    }


def karma(p: Passes) -> Files:
    return {
        "": {
            **layer("C", "RGBA", p.colour, np.float16),
            **layer("ray:motionvector", "XY", p.following * UP),
            **layer("ray:hitN", "XYZ", p.normal),
            **layer("ray:hitP", "XYZ", p.position),
            "ray:hitPz": blender_depth(p.depth).astype(np.float32),
            "ray:objectid": p.ident.astype(np.float32),
        }
    }


def moonray(p: Passes) -> Files:
    alpha = p.colour[..., 3:]
    return {
        "": {
            **_beauty(p),
            **layer("motion_vectors", "RG", p.following * UP / (0.5 * p.size) * alpha),
            **layer("", "Z", blender_depth(p.depth)),
            **layer("WP", "XYZ", p.position),
        }
    }


def nuke(prefix: str = "") -> Callable[[Passes], Files]:
    def write(p: Passes) -> Files:
        return {
            "": {
                **_beauty(p),
                **layer(f"{prefix}forward", "uv", p.following * UP),
                **layer(f"{prefix}backward", "uv", p.previous * UP),
                **layer(f"{prefix}depth", "Z", blender_depth(p.depth)),
            }
        }

    return write


def reelsmart(p: Passes) -> Files:
    return {"": _beauty(p), "rsmb": layer("", "RG", p.previous * UP)}


PRODUCERS = {
    "blender 5": Producer(blender("ViewLayer.", "Object Index"), "Blender", True, True),
    "blender 4": Producer(blender("Hero shot.v2.", "IndexOB"), "Blender", True, True),
    "blender, no prefix": Producer(blender("", "IndexOB"), "Blender", True, True),
    "unreal dump": Producer(unreal, "Unreal (one file per AOV)", True),
    "movie render queue": Producer(movie_render_queue(1.0), "Unreal Movie Render Queue", True),
    "movie render queue, two screens": Producer(
        movie_render_queue(2.0), "Unreal Movie Render Queue", True
    ),
    "arnold, direction": Producer(arnold(direction), "Arnold", False, True),
    "arnold, mapped direction": Producer(
        arnold(lambda v: direction(v, 0.5)), "Arnold", False, True
    ),
    "arnold, max displace": Producer(arnold(share), "Arnold", False, True),
    "arnold, max displace about the middle": Producer(
        arnold(lambda v: np.clip(0.5 + 0.5 * v / MOST, 0, 1)), "Arnold", False, True
    ),
    "arnold, raw": Producer(arnold(lambda v: v), "Arnold", False, True),
    "v-ray": Producer(vray(clamped=False), "V-Ray", False, True),
    "v-ray, clamped": Producer(vray(clamped=True), "V-Ray", False, True),
    "redshift": Producer(redshift, "Redshift", False, True),
    "renderman": Producer(renderman, "RenderMan", True, True),
    "karma": Producer(karma, "Karma", False, True),
    "moonray": Producer(moonray, "MoonRay", False, True),
    "nuke": Producer(nuke(), "Nuke convention", True, True),
    "nuke, prefix": Producer(nuke("hero_"), "Nuke convention", True, True),
    "reelsmart": Producer(reelsmart, "ReelSmart or Twixtor", True),
}


def rounded(files: Files) -> Files:
    """Everything cast to half, as far as it goes: a far depth becomes infinity."""
    with np.errstate(over="ignore"):
        return {
            aov: {name: plane.astype(np.float16).astype(np.float32) for name, plane in made.items()}
            for aov, made in files.items()
        }
