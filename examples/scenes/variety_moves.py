"""What moves in a shot: things of all kinds, each with its own motion, speed and id."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Sequence

import variety_props as props
import variety_thin as thin
from stage import motion
from stage.blender import bpy, mathutils
from variety_looks import Material
from variety_props import Prop, Suit
from variety_set import ALL, Set
from variety_view import AROUND, FAR, KEY, SPAN, Path, cast, in_picture

Vector = mathutils.Vector
Pose = Callable[[float], tuple]
Act = Callable[["Troupe"], None]
MOST = 20


class Troupe:
    """Gathers the moving things of a shot and gives out their ids."""

    def __init__(self, scene: Set, path: Path, last: int) -> None:
        self.scene, self.path, self.last = scene, path, last
        self.chance: random.Random = scene.chance
        self.named: dict[int, str] = {}
        self._suits = [scene.wear.suit(0.5) for _ in range(3)]

    def cast_parts(self, acts: Sequence[Act], after: Sequence[Act]) -> dict[int, str]:
        """Add 0 to 20 moving things, and what the plan asks for; return what each id is."""
        most = self.chance.choice((0, 2, 3, 5, 7, 10, 14, 20))
        kinds = (
            self._thrown, self._thrown, self._spinning, self._orbiting, self._bouncing,
            self._swinging, self._rolling, self._chain, self._swarm, self._behind, self._door,
        )  # fmt: skip
        tries = 0
        while len(self.named) < most and tries < 3 * MOST:
            tries += 1
            self.chance.choice(kinds)(most - len(self.named))
        for act in acts:
            act(self)
        self._clear()
        for act in after:
            act(self)
        return {index: self.named[index] for index in sorted(self.named)}

    def speed(self, away: float) -> float:
        """Draw a speed in metres a second that makes 0.5 to 40 pixels per key interval."""
        pixels = math.exp(self.chance.uniform(math.log(0.5), math.log(40)))
        return pixels / KEY * away / self.path.focal()

    def way(self) -> mathutils.Vector:
        """Draw a direction."""
        return Vector([self.chance.gauss(0, 1) for _ in range(3)]).normalized()

    def spot(self) -> tuple[mathutils.Vector, float, float] | None:
        """Find a free place in view: the place, its distance, and a size that fits there."""
        for _ in range(8):
            at, away = in_picture(self.path, self.chance)
            free = min(cast(at, along)[0] for along in AROUND[::2])
            size = min(1.6 * free, away * self.chance.uniform(0.1, 0.45))
            if away > 0.06 * self.scene.reach and size > 0.03 * away:
                return at, away, size
        return None

    def next_id(self) -> int:
        """Return an id that nothing has."""
        return max(self.named, default=0) + 1

    def plain(self) -> Material:
        """Return the plain paint of one of the suits."""
        suit: Suit = self.chance.choice(self._suits)
        return suit[3]

    def thing(
        self, size: float, prop: Prop | None = None, suit: Suit | None = None
    ) -> bpy.types.Object:
        """Make a thing around its own middle, with an id."""
        index = self.next_id()
        prop, is_own = prop or self.chance.choice(ALL), suit is None
        suit = suit or self.chance.choice(self._suits)
        if is_own and self.chance.random() < 0.3:
            suit = [self.scene.wear.look("any", 0.5)] * 3 + [self.scene.wear.glow()]
        thing = self.scene.make(prop, suit, (0, 0, 0), 1.0)
        thing.data.transform(mathutils.Matrix.Translation((0, 0, -0.5)))
        thing.data.transform(mathutils.Matrix.Scale(size, 4))
        thing.pass_index = index
        return thing

    def add(self, thing: bpy.types.Object, what: str, pose: Pose) -> None:
        """Let a thing move, and name it."""
        self.named[thing.pass_index] = f"{what} {thing.name.split('.')[0]}"
        motion.keyed(thing, pose, self.last)

    def eased(self) -> Callable[[float], float]:
        """Draw how time passes for a thing: steadily, faster, slower or in a wave."""
        gain = self.chance.uniform(-4, 4)
        wave, phase = self.chance.choice((0.0, 0.0, 0.01)), self.chance.uniform(0, 6)

        def eased(seconds: float) -> float:
            middle = seconds - SPAN / 2
            return middle + gain * middle**2 + wave * math.sin(45 * middle + phase)

        return eased

    def _thrown(self, _: int) -> None:
        spot = self.spot()
        if spot is None:
            return
        at, away, size = spot
        pace, spin = self.way() * self.speed(away), self.way() * self.chance.uniform(0, 8)
        start, eased = self.way() * 3, self.eased()
        self.add(
            self.thing(size),
            "flying",
            lambda t: (at + pace * eased(t), start + spin * eased(t)),
        )

    def _spinning(self, _: int) -> None:
        spot = self.spot()
        if spot is None:
            return
        at, away, size = spot
        rate = self.speed(away) / (0.4 * size) * self.chance.choice((-1, 1))
        rate = max(-25.0, min(25.0, rate))
        axis, eased = self.chance.randrange(3), self.eased()
        start = self.way() * self.chance.choice((0, 1))
        prop = self.chance.choice((props.rotor, props.wheel, props.sign, None))

        def pose(seconds: float) -> tuple:
            turn = list(start)
            turn[axis if prop is None else 1] += rate * eased(seconds)
            return at, turn

        self.add(self.thing(size, prop), "spinning", pose)

    def _orbiting(self, _: int) -> None:
        spot = self.spot()
        if spot is None:
            return
        at, away, size = spot
        radius, phase = self.chance.uniform(0.3, 0.8) * size, self.chance.uniform(0, 6.3)
        rate = max(-20.0, min(20.0, self.speed(away) / radius))
        tilt, eased = self.chance.uniform(-1, 1), self.eased()

        def pose(seconds: float) -> tuple:
            angle = phase + rate * eased(seconds)
            across = Vector((math.cos(angle), math.sin(angle), tilt * math.sin(angle)))
            return at + radius * across, (0, 0, angle)

        self.add(self.thing(0.6 * size), "orbiting", pose)

    def floor(self, at: mathutils.Vector) -> float | None:
        """Return the height of what is below a place, or None."""
        down = cast(at, Vector((0, 0, -1)))[0]
        return at.z - down if down < FAR else None

    def _bouncing(self, _: int) -> None:
        spot = self.spot()
        floor = self.floor(spot[0]) if spot else None
        if floor is None:
            return
        at, away, size = spot
        size = min(size, 0.2 * away)
        pace = self.way() * self.speed(away)
        high, rate = max(0.1, at.z - floor), self.chance.uniform(3, 14)
        phase = self.chance.uniform(0.2, 0.6)

        def pose(seconds: float) -> tuple:
            # The arc is a wave without corners, so that speeds stay finite.
            hop = math.sin(phase * math.pi + rate * (seconds - SPAN / 2)) ** 2
            where = at + pace * (seconds - SPAN / 2)
            return (where.x, where.y, floor + 0.5 * size + high * hop), (rate * seconds, seconds, 0)

        self.add(self.thing(size, self.chance.choice((props.balls, None))), "bouncing", pose)

    def _swinging(self, _: int) -> None:
        spot = self.spot()
        if spot is None:
            return
        at, away, size = spot
        long = self.chance.uniform(0.6, 2.5) * size
        rate = max(2.0, min(30.0, self.speed(away) / (0.5 * long)))
        phase, sideways = self.chance.uniform(0, 6.3), self.chance.uniform(-1, 1)

        def pose(seconds: float) -> tuple:
            angle = 0.5 * math.sin(phase + rate * (seconds - SPAN / 2))
            drop = Vector((math.sin(angle), sideways * math.sin(angle), -math.cos(angle)))
            return at + Vector((0, 0, long)) + long * drop, (sideways * angle, -angle, 0)

        prop = self.chance.choice((thin.chain, props.sign, thin.curtain, None))
        self.add(self.thing(size, prop), "swinging", pose)

    def _rolling(self, _: int) -> None:
        spot = self.spot()
        floor = self.floor(spot[0]) if spot else None
        if floor is None:
            return
        at, away, size = spot
        heading = self.chance.uniform(0, 6.3)
        pace, eased = self.speed(away), self.eased()
        along = Vector((math.cos(heading), math.sin(heading), 0))
        prop = self.chance.choice((props.wheel, props.vehicle, props.vehicle, props.crate))
        turns = 2 / size if prop is props.wheel else 0.0

        def pose(seconds: float) -> tuple:
            gone = pace * eased(seconds)
            where = at + along * gone
            return (where.x, where.y, floor + 0.52 * size), (0, turns * gone, heading)

        self.add(self.thing(size, prop), "rolling", pose)

    def _chain(self, left: int) -> None:
        """An arm or tail of parts, each turning against the one before."""
        spot = self.spot()
        if spot is None:
            return
        at, away, size = spot
        count = min(left, self.chance.randint(2, 5))
        rate, bend = self.chance.uniform(3, 25), min(0.8, 0.05 * self.speed(away) / size + 0.1)
        part_size, parent = size / count, None
        prop = self.chance.choice((props.crate, props.drum, props.vase, props.rings, thin.fern))
        for number in range(count):
            part = self.thing(part_size, prop)
            part.parent = parent
            start = at if parent is None else Vector((0, 0, part_size))

            def pose(t: float, start: object = start, shift: float = 0.9 * number) -> tuple:
                swing = bend * math.sin(rate * t + shift)
                return start, (swing, 0.6 * swing + 0.2, 0.3 * swing)

            self.add(part, "jointed", pose)
            parent = part

    def _swarm(self, left: int) -> None:
        """Many small things that fly about one another."""
        spot = self.spot()
        if spot is None:
            return
        at, away, size = spot
        shared, speed = self.way(), self.speed(away)
        prop = self.chance.choice((props.balls, props.rotor, thin.fern, props.cones, props.word))
        for _ in range(min(left, self.chance.randint(3, 7))):
            shift = self.way() * self.chance.uniform(0.2, 1.0) * size
            pace = (shared + 0.6 * self.way()) * speed
            spin = self.way() * self.chance.uniform(0, 12)
            self.add(
                self.thing(0.25 * size, prop),
                "swarming",
                lambda t, s=at + shift, p=pace, r=spin: (s + p * (t - SPAN / 2), r * t),
            )

    def _behind(self, _: int) -> None:
        """Something behind the camera, seen in mirrors if at all."""
        origin, along = self.path.ray(self.chance.uniform(-0.5, 0.5), 0.0, SPAN / 2)
        away = self.chance.uniform(0.3, 0.6) * self.scene.reach
        where = origin - along * away
        pace = self.way() * self.speed(2 * away)
        self.add(
            self.thing(0.25 * away),
            "hidden",
            lambda t: (where + pace * (t - SPAN / 2), pace * t),
        )

    def _door(self, _: int) -> None:
        """A leaf that turns about its edge."""
        spot = self.spot()
        if spot is None:
            return
        at, away, size = spot
        thing = self.thing(size, self.chance.choice((props.crate, thin.curtain, props.sign)))
        thing.data.transform(mathutils.Matrix.Translation((0.5 * size, 0, 0)))
        rate = max(-12.0, min(12.0, self.speed(away) / size))
        start, eased = self.chance.uniform(0, 6.3), self.eased()
        self.add(thing, "hinged", lambda t: (at, (0, 0, start + rate * eased(t))))

    def _clear(self) -> None:
        """Take away what comes too near to the camera at any time of the shot."""
        room = 0.12 * self.scene.reach
        close: set[int] = set()
        moving = [thing for thing in bpy.context.scene.objects if thing.pass_index]
        for instant in range(-4, self.last + 5, 2):
            bpy.context.scene.frame_set(instant)
            eye = self.path.matrix(instant / motion.FPS)[0]
            for thing in moving:
                reach = max(thing.dimensions) * 0.75
                if (thing.matrix_world.translation - eye).length < reach + room:
                    close |= {part.pass_index for part in (thing, *thing.children_recursive)}
        for thing in moving:
            if thing.pass_index in close:
                self.named.pop(thing.pass_index, None)
                bpy.data.objects.remove(thing)
