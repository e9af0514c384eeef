"""FLIP: the difference that a viewer sees when flipping between two images.

Andersson, Nilsson, Akenine-Möller, Oskarsson, Åström, Fairchild, "FLIP: A Difference Evaluator for
Alternating Images", Proceedings of the ACM on Computer Graphics and Interactive Techniques 3(2),
2020. The numbers are those of its authors' own package.
"""

from __future__ import annotations

import numpy as np

from exwarp_cli.domain.frame import Float32
from exwarp_cli.kernels.flip import SEEN, differ, perceive
from exwarp_cli.kernels.flip_colour import PLANES, decode
from exwarp_cli.metrics.display import Measured


def seen(planes: Float32) -> Float32:
    """Return what a viewer sees of an image, float32 [SEEN, H, W], from its opponent colours."""
    out = np.empty((SEEN, *planes.shape[1:]), np.float32)
    perceive(planes, out)
    return out


def measure(reference: Float32, test: Float32) -> Measured:
    """Compare two display-encoded images, float32 [H, W, 3], 0 to 255.

    LDR-FLIP at the package's default of 67 pixels per degree: a 4K display, 0.7 m wide, seen from
    0.7 m. The value is the mean of the error map, 0 (equal) to 1.
    """
    shape = reference.shape[:2]
    planes, error = np.empty((PLANES, *shape), np.float32), np.zeros(shape, np.float32)
    views = []
    for image in (reference, test):
        decode(np.ascontiguousarray(image, np.float32), planes)
        views.append(seen(planes))
    differ(*views, error)
    return Measured(error)
