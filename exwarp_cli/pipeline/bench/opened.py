"""A subject that is opened for measuring: its files, the networks, and who decides."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from exwarp_cli.domain.bench import EXTRANET, EXTRANET_FAST, ONNX, BenchSettings, needs_network
from exwarp_cli.domain.frame import Bool, Float32, place_on_canvas
from exwarp_cli.domain.settings import UpsampleSettings
from exwarp_cli.domain.timeline import FACTOR, Slot
from exwarp_cli.errors import MissingFrameError, UsageError
from exwarp_cli.io.footage import digest_of, picture
from exwarp_cli.io.interpolator import OnnxInterpolator, load_interpolator
from exwarp_cli.io.models import OnnxExtrapolator, load_extrapolator
from exwarp_cli.io.output import quantised
from exwarp_cli.io.policy_files import load_policy
from exwarp_cli.io.vmaf import require_size
from exwarp_cli.pipeline.bench.pictures import Pictures
from exwarp_cli.pipeline.bench.plan import Subject
from exwarp_cli.pipeline.finding import find_truth, require_state
from exwarp_cli.pipeline.interval_builder import IntervalBuilder
from exwarp_cli.pipeline.interval_inputs import IntervalInputs, IntervalReader
from exwarp_cli.pipeline.observing import Observer
from exwarp_cli.pipeline.scoring import SLOTS
from exwarp_cli.pipeline.source import open_source
from exwarp_cli.policy.state import LearnedPolicy, StateHistory
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.methods import Judge, Method

EVERYTHING = Method("bench", None, lookahead=True, needs_motion=True, judge=Judge.POLICY)
"""What is read for it serves every system."""


@dataclass(frozen=True)
class Networks:
    """What runs in this process.

    Attributes
    ----------
    own
        Our E; None where no system extrapolates.
    imported
        ExtraNet; None without --extranet.
    interpolators
        By the system's name.
    """

    own: OnnxExtrapolator | None
    imported: OnnxExtrapolator | None
    interpolators: Mapping[str, OnnxInterpolator]

    @property
    def systems(self) -> tuple[str, ...]:
        """Names of the systems that options added."""
        extra = () if self.imported is None else (EXTRANET, EXTRANET_FAST)
        return (*extra, *self.interpolators)

    @property
    def checksums(self) -> dict[str, str]:
        """SHA-256 of each network by what it is; what interpolates depends on its card as well."""
        ours = {"extrapolator": self.own, "extranet": self.imported}
        found = {name: one.checksum for name, one in ours.items() if one is not None}
        for name, network in self.interpolators.items():
            found |= {name: network.checksum, f"{name}, card": network.card.checksum}
        return found


def load_networks(settings: BenchSettings, threads: int | None) -> Networks:
    """Load what the systems run on.

    Raises
    ------
    InputError, MissingExtraError
        When a network cannot be used.
    UsageError
        When two interpolators have one name.
    """
    own = imported = None
    if needs_network(settings.systems):
        own = load_extrapolator(settings.extrapolator, threads, settings.device)
    if settings.extranet is not None:
        imported = load_extrapolator(settings.extranet, threads, settings.device)
    interpolators: dict[str, OnnxInterpolator] = {}
    for path in settings.interpolators:
        network = load_interpolator(path, threads, settings.device)
        name = f"{ONNX}{network.name}"
        if name in interpolators:
            raise UsageError(
                f"two networks of --interpolator are called {network.name}; name one of them "
                "otherwise in its card"
            )
        interpolators[name] = network
    return Networks(own, imported, interpolators)


class Opened:
    """A subject, ready to be read interval by interval.

    Parameters
    ----------
    subject
        What to open.
    settings
        What is asked.
    networks
        What runs.

    Raises
    ------
    ExwarpError
        When the sequence cannot be used.
    """

    def __init__(self, subject: Subject, settings: BenchSettings, networks: Networks) -> None:
        self.subject, self.settings, self.networks = subject, settings, networks
        self.source = open_source(subject.source)
        keys = self.source.keys
        if "vmaf" in settings.metrics:
            require_size(keys.display.height, keys.display.width, keys.sequence.pattern)
        self._truth = find_truth(subject.truth, self.source)
        self.policy = require_state(load_policy(subject.policy))
        self.restart()

    def restart(self) -> None:
        """Forget what was read: the next interval need not follow the last one."""
        asked = UpsampleSettings(self.subject.source, "", EVERYTHING.name)
        display = self.source.keys.display
        self._reader = IntervalReader(self.source, EVERYTHING, asked)
        self._builder = IntervalBuilder(display, self.networks.own or self.networks.imported)
        self._observer = Observer(display, self.source.setting)
        self._policy = LearnedPolicy(self.policy.network)

    @property
    def keys(self) -> tuple[int, ...]:
        """Indices of the key frames that are measured: those with another one and truth after."""
        chosen = self.source.timeline.select(self.settings.frames)
        last = len(self.source.timeline.numbers) - 1
        known = [key for key in chosen if key < last and self._has_truth(key)]
        if not known:
            raise MissingFrameError(
                f"no key frame of {self.source.keys.sequence.pattern} that was asked for has "
                "ground truth at its three slots and a key frame after it; give longer sequences"
            )
        return tuple(known[:: self.settings.every])

    def load(self, key: int, needed: Callable[[dict[int, str]], bool]) -> IntervalInputs:
        """Read a key interval, unless its recipes show that it is not needed."""
        return self._reader.read(key, lambda _key, recipes: needed(recipes))

    def interval(self, inputs: IntervalInputs) -> Interval:
        """Bring what was read onto one window."""
        return self._builder.build(inputs)

    def look(self, inputs: IntervalInputs, interval: Interval) -> StateHistory:
        """Return what the policy sees."""
        return self._observer.of(inputs, interval)

    def decide(self, surroundings: StateHistory) -> str:
        """Ask the policy for the interval's path."""
        return self._policy.plan(surroundings).path

    def pictures(self, inputs: IntervalInputs, interval: Interval) -> Pictures:
        """Return what systems show, as files would hold it."""
        canvas, display = interval.key.image.data_window, self.source.keys.display

        def finish(pixels: Float32) -> Float32:
            return place_on_canvas(quantised(pixels, inputs.metadata.template), canvas, display)

        return Pictures(
            interval,
            finish,
            self.networks.imported,
            self.networks.interpolators,
        )

    def truth(self, key: int) -> dict[int, Float32]:
        """Read the ground truth of slots 0 to 4 where there is one, on the display window."""
        found = {}
        for index in range(FACTOR + 1):
            number = self._truth_number(key, index)
            if number is not None:
                image = picture(self._truth[0], number, self.source.keys.view)
                found[index] = image.on(image.display_window).pixels
        return found

    def truth_digests(self, key: int) -> list[str]:
        """What the ground truth's frames depend on."""
        numbers = [self._truth_number(key, index) for index in range(FACTOR + 1)]
        return [digest_of(self._truth[0], n) for n in numbers if n is not None]

    def masks(self, interval: Interval) -> dict[int, Bool]:
        """Holes of W at slots 1 to 3, on the display window."""
        canvas, display = interval.key.image.data_window, self.source.keys.display
        found = {slot: interval.hole_mask(slot) for slot in SLOTS}
        return {
            slot: np.asarray(place_on_canvas(mask, canvas, display))
            for slot, mask in found.items()
            if mask is not None
        }

    def number(self, key: int) -> int:
        """Input number of a key frame."""
        return self.source.timeline.numbers[key]

    def _has_truth(self, key: int) -> bool:
        return all(self._truth_number(key, slot) is not None for slot in SLOTS)

    def _truth_number(self, key: int, index: int) -> int | None:
        """Number of the ground truth of a slot; index 4 is the next key frame's."""
        return self._truth[1](Slot(key + index // FACTOR, index % FACTOR))
