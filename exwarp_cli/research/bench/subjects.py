"""Which sequences a benchmark measures, and how one is opened: files, networks, policy."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from exwarp_cli.domain.decision import LOOKAHEAD
from exwarp_cli.domain.frame import Bool, Float32, place_on_canvas
from exwarp_cli.domain.settings import SourceSettings, UpsampleSettings
from exwarp_cli.domain.timeline import FACTOR, Slot
from exwarp_cli.errors import InputError, LayoutError, MissingFrameError, UsageError
from exwarp_cli.io.dataset import BENCHMARK, RenderedScene, find_scenes
from exwarp_cli.io.ffmpeg import require_vmaf_size
from exwarp_cli.io.footage import digest_frame, read_sequence_picture
from exwarp_cli.io.generated_frames import quantise_picture
from exwarp_cli.io.sequences import find_sequence
from exwarp_cli.models.interpolator import OnnxInterpolator, load_interpolator
from exwarp_cli.models.model_file import shipped_folder
from exwarp_cli.models.picture_network import (
    OnnxExtrapolator,
    OnnxLookAhead,
    load_extrapolator,
    load_lookahead,
)
from exwarp_cli.models.policy_files import load_policy, policy_name_without
from exwarp_cli.pipeline.decide import Observer
from exwarp_cli.pipeline.ground_truth import find_truth
from exwarp_cli.pipeline.interval_builder import IntervalBuilder
from exwarp_cli.pipeline.interval_inputs import IntervalInputs, IntervalReader
from exwarp_cli.pipeline.job import require_state
from exwarp_cli.pipeline.source import open_source
from exwarp_cli.policy.state import LearnedPolicy
from exwarp_cli.research.bench.system_frames import SystemFrames
from exwarp_cli.research.bench.systems import (
    EXTRANET,
    EXTRANET_FAST,
    ONNX,
    SLOTS,
    BenchSettings,
    needs_network,
)
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.methods import DecisionSource, Method

# What is read for it serves every system.
EVERYTHING = Method("bench", None, lookahead=True, needs_motion=True, judge=DecisionSource.POLICY)


@dataclass(frozen=True)
class Subject:
    """A sequence in one setting."""

    name: str  # the scene's, or that of the sequence
    source: SourceSettings  # key frames, and G-buffers of slots in the slot setting
    truth: str  # sequence at the output rate
    setting: str  # "key" or "slot"
    policy: Path | None = None  # None for the one that comes with ExWarp
    unseen: bool | None = None  # True if that policy was trained without this scene


def find_subjects(settings: BenchSettings, say: Callable[[str], None]) -> tuple[Subject, ...]:
    """Return what is measured, in the order of the inputs.

    Parameters
    ----------
    settings
        What was asked.
    say
        Receives a line on each scene that is left out, as hardly anything of it is rendered.

    Raises
    ------
    InputError
        When an input is no data set, or a scene is missing or not rendered.
    UsageError
        When options of a sequence and of a data set are mixed.
    """
    if settings.ground_truth is not None:
        if len(settings.inputs) != 1 or settings.scenes:
            raise UsageError(
                "--ground-truth belongs to one sequence; give one, without --scenes, or a data set "
                "without --ground-truth"
            )
        (spec,) = settings.inputs
        source = SourceSettings(spec, settings.gbuffers, settings.motion, settings.fps)
        setting = "key" if settings.gbuffers is None else "slot"
        # What its frames are called, without the number.
        stem = Path(find_sequence(spec).pattern).name.split("#")[0].strip("._- ")
        name = stem or Path(spec).name or "sequence"
        return (Subject(name, source, settings.ground_truth, setting, settings.policy),)

    options = {"--gbuffers": settings.gbuffers, "--motion": settings.motion, "--fps": settings.fps}
    if vain := [option for option, value in options.items() if value is not None]:
        raise UsageError(
            f"{vain[0]} belongs to one sequence; give it with --ground-truth, or leave it out for "
            "a data set, which tells by itself"
        )
    subjects: dict[tuple[str, str], Subject] = {}
    for data in settings.inputs:
        for subject in _subjects_of_data_set(data, settings, say):
            key = (subject.source.sequence, subject.setting)
            if key in subjects:  # their parts would overwrite each other
                raise UsageError(f"{subject.source.sequence} is given twice; give it once")
            subjects[key] = subject
    return tuple(subjects.values())


def _subjects_of_data_set(
    data: str, settings: BenchSettings, say: Callable[[str], None]
) -> list[Subject]:
    try:
        scenes = find_scenes(data, None if settings.scenes else BENCHMARK, settings.scenes)
    except InputError as error:
        raise type(error)(f"{error}; a sequence of your own needs --ground-truth") from error
    subjects: list[Subject] = []
    for scene in scenes:
        try:
            subjects += _subjects_of_scene(scene.as_far_as_rendered(), settings)
        except MissingFrameError as error:
            if settings.scenes:
                raise
            say(f"left out: {error}")
    if not subjects:
        raise MissingFrameError(f"{data} has no scene with two key frames; render one first")
    return subjects


def _subjects_of_scene(scene: RenderedScene, settings: BenchSettings) -> list[Subject]:
    """Return a scene in each setting; its instants are ground truth and slot G-buffers at once."""
    manifest = scene.manifest
    for frames in (manifest.instants, manifest.keys):
        numbers = find_sequence(str(scene.folder / frames.pattern)).numbers
        if list(numbers) != list(frames.numbers):
            raise LayoutError(
                f"{scene.folder} is rendered in pieces, and of {frames.pattern} only frames "
                f"{frames.first}-{frames.first + frames.count - 1} hold together; render what is "
                "between, or leave the scene out with --scenes"
            )
    keys = str(scene.folder / manifest.keys.pattern)
    instants = str(scene.folder / manifest.instants.pattern)
    policy, unseen = settings.policy, None
    without_scene = shipped_folder() / policy_name_without(scene.name)
    if policy is None and without_scene.is_file():
        policy, unseen = without_scene, True
    return [
        Subject(
            scene.name,
            SourceSettings(keys, instants if setting == "slot" else None, manifest.motion),
            instants,
            setting,
            policy,
            unseen,
        )
        for setting in settings.settings
    ]


@dataclass(frozen=True)
class Networks:
    """What runs in this process."""

    own: OnnxExtrapolator | None  # our E; None where no system extrapolates
    imported: OnnxExtrapolator | None  # ExtraNet; None without --extranet
    look_ahead: OnnxLookAhead | None  # ours; None where it is not compared
    interpolators: Mapping[str, OnnxInterpolator]  # by the system's name

    @property
    def systems(self) -> tuple[str, ...]:
        """Names of the systems that options added."""
        extra = () if self.imported is None else (EXTRANET, EXTRANET_FAST)
        return (*extra, *self.interpolators)

    @property
    def checksums(self) -> dict[str, str]:
        """SHA-256 of each network by what it is; what interpolates depends on its card as well."""
        ours = {"extrapolator": self.own, "extranet": self.imported, LOOKAHEAD: self.look_ahead}
        checksums = {name: n.checksum for name, n in ours.items() if n is not None}
        for name, network in self.interpolators.items():
            checksums |= {name: network.checksum, f"{name}, card": network.card.checksum}
        return checksums


def load_networks(settings: BenchSettings, threads: int | None) -> Networks:
    """Load what the systems run on.

    Raises
    ------
    InputError, MissingExtraError
        When a network cannot be used.
    UsageError
        When two interpolators have one name.
    """
    own = imported = look_ahead = None
    if needs_network(settings.systems):
        own = load_extrapolator(settings.extrapolator, threads, settings.device)
    if settings.extranet is not None:
        imported = load_extrapolator(settings.extranet, threads, settings.device)
    if LOOKAHEAD in settings.systems:
        look_ahead = load_lookahead(None, threads, settings.device)
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
    return Networks(own, imported, look_ahead, interpolators)


class OpenedSubject:
    """A subject, ready to be read interval by interval.

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
            require_vmaf_size(keys.display.height, keys.display.width, keys.sequence.pattern)
        self._truth = find_truth(subject.truth, self.source)
        self.policy = require_state(load_policy(subject.policy))
        self.restart()

    def restart(self) -> None:
        """Forget what was read: the next interval need not follow the last one."""
        asked = UpsampleSettings(self.subject.source, "", EVERYTHING.name)
        display = self.source.keys.display
        self._reader = IntervalReader(self.source, EVERYTHING, asked)
        extrapolator = self.networks.own or self.networks.imported
        self.builder = IntervalBuilder(display, extrapolator, self.networks.look_ahead)
        self.observer = Observer(display, self.source.setting)
        self.chooser = LearnedPolicy(self.policy.network)

    @property
    def systems(self) -> tuple[str, ...]:
        """Names of all systems that are compared."""
        return (*self.settings.systems, *self.networks.systems)

    @property
    def keys(self) -> tuple[int, ...]:
        """Indices of the key frames that are measured: those with another one and truth after."""
        selected = self.source.timeline.select(self.settings.frames)
        last = len(self.source.timeline.numbers) - 1
        usable = [
            key
            for key in selected
            if key < last and all(self._truth_number(key, slot) is not None for slot in SLOTS)
        ]
        if not usable:
            raise MissingFrameError(
                f"no key frame of {self.source.keys.sequence.pattern} that was asked for has "
                "ground truth at its three slots and a key frame after it; give longer sequences"
            )
        return tuple(usable[:: self.settings.every])

    def load(self, key: int, needed: Callable[[dict[int, str]], bool]) -> IntervalInputs:
        """Read a key interval, unless its recipes show that it is not needed."""
        return self._reader.read(key, lambda _key, recipes: needed(recipes))

    def frames(self, inputs: IntervalInputs, interval: Interval) -> SystemFrames:
        """Return what systems show, as files would hold it."""
        canvas, display = interval.key.image.data_window, self.source.keys.display

        def finish(pixels: Float32) -> Float32:
            return place_on_canvas(
                quantise_picture(pixels, inputs.metadata.template), canvas, display
            )

        return SystemFrames(interval, finish, self.networks.imported, self.networks.interpolators)

    def truth(self, key: int) -> dict[int, Float32]:
        """Read the ground truth of slots 0 to 4 where there is one, on the display window."""
        frames = {}
        for index in range(FACTOR + 1):
            number = self._truth_number(key, index)
            if number is not None:
                image = read_sequence_picture(self._truth[0], number, self.source.keys.view)
                frames[index] = image.on(image.display_window).pixels
        return frames

    def truth_digests(self, key: int) -> list[str]:
        """Return digests of what the ground truth's frames depend on."""
        numbers = [self._truth_number(key, index) for index in range(FACTOR + 1)]
        return [digest_frame(self._truth[0], n) for n in numbers if n is not None]

    def masks(self, interval: Interval) -> dict[int, Bool]:
        """Return the holes of W at slots 1 to 3, on the display window."""
        canvas, display = interval.key.image.data_window, self.source.keys.display
        return {
            slot: np.asarray(place_on_canvas(mask, canvas, display))
            for slot in SLOTS
            if (mask := interval.hole_mask(slot)) is not None
        }

    def number(self, key: int) -> int:
        """Return the input number of a key frame."""
        return self.source.timeline.numbers[key]

    def _truth_number(self, key: int, index: int) -> int | None:
        """Return the number of the ground truth of a slot; index 4 is the next key frame's."""
        return self._truth[1](Slot(key + index // FACTOR, index % FACTOR))
