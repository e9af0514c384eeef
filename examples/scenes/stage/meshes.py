"""Meshes: boxes, tubes and balls gathered into one Blender object."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from stage.blender import bpy, mathutils

Matrix, Vector = mathutils.Matrix, mathutils.Vector
Point = Sequence[float]


class MeshBuilder:
    """Gathers primitives into one object with one material slot per material used.

    Attributes
    ----------
    place : mathutils.Matrix
        Transform applied to every primitive added from now on (object space).
    """

    def __init__(self) -> None:
        self.place = Matrix.Identity(4)
        self._points: list[Vector] = []
        self._faces: list[tuple[int, ...]] = []
        self._slots: list[int] = []
        self._smooth: list[bool] = []
        self._materials: list[bpy.types.Material] = []

    def faces(
        self,
        points: Iterable[Point],
        faces: Iterable[Sequence[int]],
        materials: bpy.types.Material | Sequence[bpy.types.Material],
        smooth: bool = False,
    ) -> None:
        """Add faces over their own points; several materials are dealt out face by face."""
        first = len(self._points)
        self._points.extend(self.place @ Vector(point) for point in points)
        dealt = materials if isinstance(materials, Sequence) else [materials]
        for number, face in enumerate(faces):
            self._faces.append(tuple(first + index for index in face))
            self._slots.append(self._slot(dealt[number % len(dealt)]))
            self._smooth.append(smooth)

    def box(self, centre: Point, size: Point, material: bpy.types.Material) -> None:
        """Add a box with its sides along the axes."""
        corners = [
            [c + s * d / 2 for c, s, d in zip(centre, size, (dx, dy, dz), strict=True)]
            for dx in (-1, 1)
            for dy in (-1, 1)
            for dz in (-1, 1)
        ]
        sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
        self.faces(corners, sides, material)

    def tube(
        self,
        path: Sequence[Point],
        radii: float | Sequence[float],
        materials: bpy.types.Material | Sequence[bpy.types.Material],
        sides: int = 12,
        smooth: bool = True,
    ) -> None:
        """Add a tube along a path, one radius for all its points or one for each, with caps."""
        spine = [Vector(point) for point in path]
        widths = [radii] * len(spine) if isinstance(radii, float | int) else radii
        points: list[Vector] = []
        for number, (centre, radius) in enumerate(zip(spine, widths, strict=True)):
            along = spine[min(number + 1, len(spine) - 1)] - spine[max(number - 1, 0)]
            turn = along.to_track_quat("Z", "Y").to_matrix()
            for side in range(sides):
                angle = 2 * math.pi * side / sides
                points.append(
                    centre + turn @ Vector((math.cos(angle), math.sin(angle), 0)) * radius
                )
        rings = [
            (
                r * sides + s,
                r * sides + (s + 1) % sides,
                (r + 1) * sides + (s + 1) % sides,
                (r + 1) * sides + s,
            )
            for r in range(len(spine) - 1)
            for s in range(sides)
        ]
        self.faces(points, rings, materials, smooth)
        last = len(points) - sides
        caps = [tuple(reversed(range(sides))), tuple(range(last, last + sides))]
        self.faces(points, caps, materials)

    def ball(
        self,
        centre: Point,
        radius: float,
        materials: bpy.types.Material | Sequence[bpy.types.Material],
        detail: tuple[int, int] = (16, 10),
    ) -> None:
        """Add a smooth ball; with several materials every meridian strip takes the next one."""
        around, rows = detail
        points = []
        for row in range(rows + 1):
            polar = math.pi * row / rows
            for side in range(around):
                angle = 2 * math.pi * side / around
                ring = radius * math.sin(polar)
                points.append(
                    (
                        centre[0] + ring * math.cos(angle),
                        centre[1] + ring * math.sin(angle),
                        centre[2] + radius * math.cos(polar),
                    )
                )
        dealt = materials if isinstance(materials, Sequence) else [materials]
        quads = [
            (
                r * around + s,
                (r + 1) * around + s,
                (r + 1) * around + (s + 1) % around,
                r * around + (s + 1) % around,
            )
            for s in range(around)
            for r in range(rows)
        ]
        strips = [dealt[s * len(dealt) // around] for s in range(around) for _ in range(rows)]
        self.faces(points, quads, strips, smooth=True)

    def object(self, name: str, pass_index: int = 0) -> bpy.types.Object:
        """Make the object, link it to the scene and return it.

        Parameters
        ----------
        name : str
            Name of the object and of its mesh.
        pass_index : int
            Value of the Object Index pass: 0 for static things.
        """
        mesh = bpy.data.meshes.new(name)
        mesh.from_pydata(self._points, [], self._faces)
        for material in self._materials:
            mesh.materials.append(material)
        mesh.polygons.foreach_set("material_index", self._slots)
        mesh.polygons.foreach_set("use_smooth", self._smooth)
        mesh.update()
        made = bpy.data.objects.new(name, mesh)
        made.pass_index = pass_index
        bpy.context.scene.collection.objects.link(made)
        return made

    def _slot(self, material: bpy.types.Material) -> int:
        if material not in self._materials:
            self._materials.append(material)
        return self._materials.index(material)


def lettering(
    text: str, place: Matrix, size: float, material: bpy.types.Material
) -> bpy.types.Object:
    """Add raised letters, centred on the place, reading along its x axis and facing its z axis."""
    curve = bpy.data.curves.new(f"text {text}", "FONT")
    curve.body = text
    curve.size = size
    curve.extrude = 0.02
    curve.offset = 0.006
    curve.align_x = "CENTER"
    curve.align_y = "CENTER"
    curve.materials.append(material)
    made = bpy.data.objects.new(f"text {text}", curve)
    made.matrix_world = place
    bpy.context.scene.collection.objects.link(made)
    return made
