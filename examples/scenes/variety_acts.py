"""Motion that is hard to warp: cast shadows, people, fans, lattices, glass, what enters and leaves.

Each act takes the troupe of a shot and adds its movers; `variety_plan` says how often each comes.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import variety_figures as figures
import variety_props as props
import variety_thin as thin
from stage.blender import bpy, mathutils
from stage.meshes import MeshBuilder
from variety_figures import Walk
from variety_looks import Material
from variety_moves import Troupe
from variety_set import ALL, SOLID
from variety_view import FAR, KEY, SPAN, Footing, cast, footing

Matrix, Vector = mathutils.Matrix, mathutils.Vector
Act = Callable[[Troupe], None]
UP = Vector((0, 0, 1))

CASTERS = (
    thin.lattice, thin.tree, props.rotor, props.rings, thin.fence, thin.bush, props.wheel,
    props.chair, props.arch, props.vehicle, thin.fern, props.sign,
)  # fmt: skip
WHIRLING = (props.rotor, props.rotor, props.wheel, props.crate, thin.fence, thin.lattice)
TRIES = 40
NEAREST = 0.5
"""Of what casts shadows: its size over its distance from the camera."""


def cast_shadows(troupe: Troupe) -> None:
    """Move things between the light and still ground that is in view."""
    has_lamp = False
    for _ in range(troupe.chance.randint(3, 6)):
        if not _shade_somewhere(troupe) and not has_lamp:
            _hang_lamp(troupe)
            has_lamp = True


def _shade_somewhere(troupe: Troupe) -> bool:
    for _ in range(TRIES):
        ground = footing(troupe.path, troupe.chance, 0.3)
        if ground is not None and _shade(troupe, ground):
            return True
    return False


def _hang_lamp(troupe: Troupe) -> None:
    """Hang a lamp above ground in view, as bright there as the sun is elsewhere."""
    for _ in range(TRIES):
        ground = footing(troupe.path, troupe.chance, 0.3)
        if ground is None:
            continue
        towards = (ground.normal + 0.6 * troupe.way()).normalized()
        room = min(cast(ground.at + 0.02 * ground.away * towards, towards)[0], 1.2 * ground.away)
        if room < 0.25 * ground.away or towards.dot(ground.normal) < 0.4:
            continue
        lamp = bpy.data.lights.new("lamp", "POINT")
        lamp.energy = 16 * math.pi * (0.8 * room) ** 2 * troupe.chance.uniform(1.0, 2.5)
        lamp.shadow_soft_size = 0.02 * room
        thing = bpy.data.objects.new("lamp", lamp)
        bpy.context.scene.collection.objects.link(thing)
        thing.location = ground.at + 0.8 * room * towards
        troupe.scene.bulbs.insert(0, thing)
        bpy.context.view_layer.update()
        return


def _shade(troupe: Troupe, ground: Footing) -> bool:
    """Hang something before the light that falls on a place; False if none falls there."""
    found = _light_at(troupe, ground)
    if found is None:
        return False
    towards, room = found
    chance, away = troupe.chance, ground.away
    gap = min(0.7 * room, chance.uniform(0.2, 1.0) * away, 2.5 * troupe.scene.reach)
    size = min(chance.uniform(0.2, 0.55) * away, 1.1 * gap)
    if size < 0.04 * away:
        return False
    across = troupe.way().cross(towards).normalized()
    pixels = math.exp(chance.uniform(math.log(3), math.log(30)))
    pace = across * pixels / KEY * away / troupe.path.focal()
    where, start = ground.at + towards * gap, troupe.way()
    if size > NEAREST * (where - troupe.path.eye).length:
        return False
    spin = troupe.way() * chance.choice((0.0, 2.0, 6.0))
    prop = chance.choice((*CASTERS, chance.choice(ALL)))
    troupe.add(
        troupe.thing(size, prop),
        "shading",
        lambda t: (where + pace * (t - SPAN / 2), start + spin * t),
    )
    return True


def _light_at(troupe: Troupe, ground: Footing) -> tuple[mathutils.Vector, float] | None:
    """Return the way to a light that reaches a place, and how far it is free; None in shade."""
    scene, start = troupe.scene, ground.at + 0.01 * ground.away * ground.normal
    lights = [] if scene.indoor or scene.is_dark else [(-scene.sun, FAR)]
    for bulb in scene.bulbs:
        gap = bulb.location - start
        is_beside = bulb.data.type in ("SPOT", "AREA") and gap.z < 0.5 * gap.length
        if not is_beside:
            lights.append((gap.normalized(), gap.length))
    if scene.indoor:
        lights.append((-scene.sun, FAR))
    for towards, length in lights:
        lit = ground.normal.dot(towards) > 0.2
        if lit and cast(start, towards)[0] >= min(0.95 * length, FAR):
            return towards, min(length, 4 * ground.away)
    return None


def people(troupe: Troupe) -> None:
    """Let one to four people, or characters of games, walk or run."""
    for _ in range(troupe.chance.randint(1, 4)):
        ground = _standing_room(troupe)
        if ground is not None:
            _figure(troupe, ground.at, troupe.chance.uniform(0, 6.3), ground.away)


def crowd(troupe: Troupe) -> None:
    """Let many people go much the same way."""
    ground = _standing_room(troupe)
    if ground is None:
        return
    chance, heading = troupe.chance, troupe.chance.uniform(0, 6.3)
    tall = _height(troupe, ground.away)
    for _ in range(chance.randint(7, 14)):
        spread = Vector((chance.gauss(0, 2.2), chance.gauss(0, 2.2), 0)) * tall / 1.75
        above = ground.at + spread + UP * 0.5 * tall
        down = cast(above, -UP)[0]
        if 0.2 * tall < down < 0.9 * tall:
            turn = heading + chance.choice((0, 0, 0, math.pi)) + chance.gauss(0, 0.2)
            _figure(troupe, above - UP * down, turn, ground.away)


def _standing_room(troupe: Troupe) -> Footing | None:
    """Find level ground in view with room above it for a figure."""
    for _ in range(TRIES):
        ground = footing(troupe.path, troupe.chance, 0.85)
        if ground is None or not 1.4 < ground.away / _height(troupe, ground.away) < 9:
            continue
        if cast(ground.at + 0.05 * ground.away * UP, UP)[0] > _height(troupe, ground.away):
            return ground
    return None


def _height(troupe: Troupe, away: float) -> float:
    """Return how tall people are: as they are, or toys where everything is small."""
    return 1.75 if troupe.scene.reach > 2 else 0.25 * away


def _figure(troupe: Troupe, at: mathutils.Vector, heading: float, away: float) -> None:
    chance, scene = troupe.chance, troupe.scene
    tall = _height(troupe, away) * chance.uniform(0.9, 1.1)
    speed = chance.choice((chance.uniform(1.0, 1.8), chance.uniform(3.0, 6.5))) * tall / 1.75
    steps = Walk(at, heading, tall, speed, chance.uniform(0, 6.3))
    index = troupe.next_id()
    body = scene.stock.figure(0.6) if steps.runs else None
    if body is not None:
        figures.run(body, index, steps, troupe.last)
    else:
        skin = scene.wear.plain((0.45 * chance.uniform(0.4, 1.5), 0.24, 0.15), 0.6, 0.0)
        suit = [scene.wear.look("any", 0.4), scene.wear.look("any", 0.4), troupe.plain(), skin]
        figures.walk(scene, suit, index, steps, troupe.last)
    troupe.named[index] = "running character" if body is not None else "figure"


def whirl(troupe: Troupe) -> None:
    """Turn fans, wheels and boxes quickly: up to a turn in a tenth of a second."""
    chance = troupe.chance
    for _ in range(chance.randint(1, 3)):
        spot = troupe.spot()
        if spot is None:
            continue
        at, _, size = spot
        prop = chance.choice(WHIRLING)
        rate = chance.choice((-1, 1)) * math.exp(chance.uniform(math.log(8), math.log(65)))
        axis, start = 1 if prop in (props.rotor, props.wheel) else chance.randrange(3), troupe.way()

        def pose(
            t: float, at: object = at, start: object = start, rate: float = rate, axis: int = axis
        ) -> tuple:
            turn = list(start)
            turn[axis] += rate * t
            return at, turn

        troupe.add(troupe.thing(size, prop), "whirling", pose)


def cross(troupe: Troupe) -> None:
    """Let large things enter and leave the picture at its edges."""
    chance, path = troupe.chance, troupe.path
    for _ in range(chance.randint(1, 3)):
        side, y = chance.choice((-1, 1)), chance.uniform(-0.7, 0.5)
        origin, along = path.ray(side * chance.uniform(0.8, 1.15), y, SPAN / 2)
        free = min(cast(origin, along)[0], 3 * troupe.scene.reach)
        away = chance.uniform(0.45, 0.85) * free
        size = chance.uniform(0.12, 0.35) * away
        if away < 0.25 * troupe.scene.reach:
            continue
        right = path.frame @ Vector((chance.choice((-1, 1)), chance.gauss(0, 0.3), 0))
        pace = right * chance.uniform(8, 45) / KEY * away / path.focal()
        where, spin, start = (
            origin + along * away,
            troupe.way() * chance.uniform(0, 6),
            troupe.way(),
        )
        troupe.add(
            troupe.thing(size),
            "crossing",
            lambda t, w=where, p=pace, r=spin, s=start: (w + p * (t - SPAN / 2), s + r * t),
        )


def lattices(troupe: Troupe) -> None:
    """Put thin nets, fences and strips before what moves; some of them move, too."""
    chance, path = troupe.chance, troupe.path
    for _ in range(chance.randint(1, 3)):
        x, y = chance.uniform(-0.6, 0.6), chance.uniform(-0.4, 0.4)
        origin, along = path.ray(x, y, SPAN / 2)
        away = min(cast(origin, along)[0], 2.5 * troupe.scene.reach) * chance.uniform(0.35, 0.6)
        size = chance.uniform(0.3, 0.7) * away
        if away < 0.25 * troupe.scene.reach:
            continue
        at, facing = origin + along * away, path.frame.to_euler().z + chance.gauss(0, 0.5)
        prop = chance.choice((thin.lattice, thin.fence, thin.fence, thin.curtain, thin.grass))
        thing = troupe.thing(size, prop, troupe.scene.wear.suit(0.5))
        if chance.random() < 0.4:
            thing.location, thing.rotation_euler, thing.pass_index = at, (0, 0, facing), 0
            continue
        pace = path.frame @ Vector((chance.gauss(0, 1), chance.gauss(0, 0.4), 0)).normalized()
        pace *= troupe.speed(away)
        troupe.add(
            thing,
            "sliding",
            lambda t, w=at, p=pace, f=facing: (w + p * (t - SPAN / 2), (0, 0, f)),
        )


def panes(troupe: Troupe) -> None:
    """Stand a pane of glass in view, and let glass things fly."""
    _stand(troupe, troupe.scene.wear.glass(), (0.3, 0.6))
    for _ in range(troupe.chance.randint(1, 2)):
        _fly(troupe, "glass", [troupe.scene.wear.glass() for _ in range(4)])


def mirrors(troupe: Troupe) -> None:
    """Stand a mirror in view, and let a mirroring ball or box fly."""
    _stand(troupe, troupe.scene.wear.mirror(), (0.6, 0.9))
    if troupe.chance.random() < 0.5:
        _fly(troupe, "mirroring", [troupe.scene.wear.mirror() for _ in range(4)])


def glows(troupe: Troupe) -> None:
    """Let things fly that shine."""
    for _ in range(troupe.chance.randint(1, 3)):
        _fly(troupe, "shining", [troupe.scene.wear.glow(troupe.chance.uniform(0.7, 4))] * 4)


def _fly(troupe: Troupe, what: str, suit: list[Material]) -> None:
    spot = troupe.spot()
    if spot is None:
        return
    at, away, size = spot
    pace, spin = troupe.way() * troupe.speed(away), troupe.way() * troupe.chance.uniform(0, 8)
    start, prop = troupe.way(), troupe.chance.choice((*SOLID[:8], thin.lattice))
    troupe.add(
        troupe.thing(size, prop, suit),
        what,
        lambda t: (at + pace * (t - SPAN / 2), start + spin * t),
    )


def _stand(troupe: Troupe, look: Material, share: tuple[float, float]) -> None:
    """Stand an upright panel in view, at a share of the way to what is behind it."""
    chance, path = troupe.chance, troupe.path
    origin, along = path.ray(chance.uniform(-0.6, 0.6), chance.uniform(-0.3, 0.3), SPAN / 2)
    away = min(cast(origin, along)[0], 3 * troupe.scene.reach) * chance.uniform(*share)
    if away < 0.3 * troupe.scene.reach:
        return
    wide, high = (chance.uniform(0.25, 0.6) * away for _ in range(2))
    mesh = MeshBuilder()
    mesh.box((0, 0, 0), (wide, 0.02 * away, high), look)
    for side in (-1, 1):
        at = (side * 0.5 * wide, 0, 0)
        mesh.box(at, (0.05 * wide, 0.03 * away, 1.05 * high), troupe.plain())
    panel = mesh.object("panel")
    panel.location = origin + along * away
    panel.rotation_euler = (0, 0, path.frame.to_euler().z + chance.gauss(0, 0.5))


ACTS: dict[str, Act] = {
    "figures": people,
    "crowd": crowd,
    "whirling": whirl,
    "crossing": cross,
    "glass": panes,
    "mirror": mirrors,
    "emissive": glows,
    "cast shadows": cast_shadows,
    "lattice": lattices,
}
"""By feature of the plan."""


def play(troupe: Troupe) -> None:
    """Add all that the shot's plan asks for."""
    for feature, act in ACTS.items():
        if troupe.scene.plan.has(feature):
            bpy.context.view_layer.update()
            act(troupe)
