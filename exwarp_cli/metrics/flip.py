"""FLIP: the difference that a viewer sees when flipping between two images.

Andersson, Nilsson, Akenine-Möller, Oskarsson, Åström, Fairchild, "FLIP: A Difference Evaluator for
Alternating Images", Proceedings of the ACM on Computer Graphics and Interactive Techniques 3(2),
2020; computed by its authors' own package.
"""

from __future__ import annotations

import numpy as np

from exwarp_cli.domain.frame import Float32
from exwarp_cli.metrics.display import PEAK
from exwarp_cli.metrics.measured import Measured


def measure(reference: Float32, test: Float32) -> Measured:
    """Compare two display-encoded images, float32 [H, W, 3], 0 to 255.

    LDR-FLIP at the package's default of 67 pixels per degree: a 4K display, 0.7 m wide, seen from
    0.7 m. The value is the mean of the error map, 0 (equal) to 1.
    """
    from flip_evaluator import evaluate

    scale = np.float32(1 / PEAK)
    # An empty dictionary of our own: the package's default argument is one object for all calls.
    result = evaluate(
        np.clip(reference * scale, 0, 1),
        np.clip(test * scale, 0, 1),
        "LDR",
        applyMagma=False,
        computeMeanError=False,
        parameters={},
    )
    return Measured(np.asarray(result[0])[..., 0])
