"""What the predictor is told about an instant (paper, table "List of features")."""

from __future__ import annotations

from dataclasses import dataclass

FEATURES = ("N_d", "EMD_Wn", "EMD_Wp", "Var_x", "Var_y", "R")
"""Names of the features, in the order of `Features.values`."""


@dataclass(frozen=True)
class Features:
    """The features of one instant, per slot: a quarter of a key interval. All finite, 0 or more.

    Attributes
    ----------
    objects
        N_d, number of connected dynamic objects.
    emd_normal
        EMD_Wn, earth mover's distance of the world normals from those of the instant before; mean
        of x, y and z. 0 to 2.
    emd_position
        EMD_Wp, the same of the world positions, scene units.
    var_x, var_y
        Variance of the motion vectors' components, square pixels.
    width, height
        Of what was rendered, pixels.
    distance
        Median distance from the camera of what is seen, scene units; 0 when unknown.
    """

    objects: int
    emd_normal: float
    emd_position: float
    var_x: float
    var_y: float
    width: int
    height: int
    distance: float

    @property
    def resolution(self) -> int:
        """R, rendered pixels."""
        return self.width * self.height

    @property
    def values(self) -> tuple[float, float, float, float, float, float]:
        """The six features in the order of FEATURES."""
        return (
            self.objects,
            self.emd_normal,
            self.emd_position,
            self.var_x,
            self.var_y,
            self.resolution,
        )
