"""Which sequences a benchmark measures, how one is opened, and the frames that systems show."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from exwarp_cli.accelerator.mlp_kernel import MlpKernel
from exwarp_cli.domain.decision import HOLD, LOOKAHEAD
from exwarp_cli.domain.frame import Bool, Float32, place_on_canvas
from exwarp_cli.domain.settings import SourceSettings, UpsampleSettings
from exwarp_cli.domain.timeline import FACTOR, Slot
from exwarp_cli.errors import InputError, LayoutError, MissingFrameError, UsageError
from exwarp_cli.io.dataset import BENCHMARK, find_scenes
from exwarp_cli.io.ffmpeg import minterpolate, require_vmaf_size
from exwarp_cli.io.footage import read_sequence_picture
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
from exwarp_cli.research.bench import systems
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.methods import METHODS, DecisionSource, Method, predict_path

# Folder of what was measured, a file a key interval.
PARTS = "parts"

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


def find_subjects(
    settings: systems.BenchSettings, say: Callable[[str], None]
) -> tuple[Subject, ...]:
    """Return what is measured, in the order of the inputs.

    `say` receives a line on each scene that is left out, as hardly anything of it is rendered.

    InputError: an input is no data set, or a scene is missing or not rendered. UsageError: options
    of a sequence and of a data set are mixed.
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
    data: str, settings: systems.BenchSettings, say: Callable[[str], None]
) -> list[Subject]:
    try:
        scenes = find_scenes(data, None if settings.scenes else BENCHMARK, settings.scenes)
    except InputError as error:
        raise type(error)(f"{error}; a sequence of your own needs --ground-truth") from error
    subjects: list[Subject] = []
    for listed in scenes:
        try:
            scene = listed.as_far_as_rendered()
        except MissingFrameError as error:
            if settings.scenes:
                raise
            say(f"left out: {error}")
            continue
        manifest, patterns = scene.manifest, []
        for frames in (manifest.instants, manifest.keys):
            patterns.append(str(scene.folder / frames.pattern))
            if list(find_sequence(patterns[-1]).numbers) != list(frames.numbers):
                raise LayoutError(
                    f"{scene.folder} is rendered in pieces, and of {frames.pattern} only frames "
                    f"{frames.first}-{frames.first + frames.count - 1} hold together; render what "
                    "is between, or leave the scene out with --scenes"
                )
        instants, keys = patterns  # instants are ground truth and G-buffers of slots at once
        policy, unseen = settings.policy, None
        without_scene = shipped_folder() / policy_name_without(scene.name)
        if policy is None and without_scene.is_file():
            policy, unseen = without_scene, True
        for setting in settings.settings:
            gbuffers = instants if setting == "slot" else None
            source = SourceSettings(keys, gbuffers, manifest.motion)
            subjects.append(Subject(scene.name, source, instants, setting, policy, unseen))
    if not subjects:
        raise MissingFrameError(f"{data} has no scene with two key frames; render one first")
    return subjects


@dataclass(frozen=True)
class Networks:
    """What runs in this process."""

    own: OnnxExtrapolator | None  # our E; None where no system extrapolates
    imported: OnnxExtrapolator | None  # ExtraNet; None without --extranet
    look_ahead: OnnxLookAhead | None  # ours; None where it is not compared
    interpolators: Mapping[str, OnnxInterpolator]  # by the system's name

    @property
    def checksums(self) -> dict[str, str]:
        """SHA-256 of each network by what it is; what interpolates depends on its card as well."""
        ours = {"extrapolator": self.own, "extranet": self.imported, LOOKAHEAD: self.look_ahead}
        checksums = {name: n.checksum for name, n in ours.items() if n is not None}
        for name, network in self.interpolators.items():
            checksums |= {name: network.checksum, f"{name}, card": network.card.checksum}
        return checksums


def load_networks(settings: systems.BenchSettings, threads: int | None) -> Networks:
    """Load what the systems run on.

    InputError or MissingExtraError: a network cannot be used. UsageError: two interpolators have
    one name.
    """
    own = imported = look_ahead = None
    if any(name in systems.CHOOSERS or name in systems.FIXED[:-1] for name in settings.systems):
        own = load_extrapolator(settings.extrapolator, threads, settings.device)
    if settings.extranet is not None:
        imported = load_extrapolator(settings.extranet, threads, settings.device)
    if LOOKAHEAD in settings.systems:
        look_ahead = load_lookahead(None, threads, settings.device)
    interpolators: dict[str, OnnxInterpolator] = {}
    for path in settings.interpolators:
        network = load_interpolator(path, threads, settings.device)
        name = f"{systems.ONNX}{network.name}"
        if name in interpolators:
            raise UsageError(
                f"two networks of --interpolator are called {network.name}; name one of them "
                "otherwise in its card"
            )
        interpolators[name] = network
    return Networks(own, imported, look_ahead, interpolators)


class SystemFrames(dict[str, Float32]):
    """Frames of one key interval by the names of `systems`, each made when it is asked for.

    They are float32 [H, W, 3 or 4], scene-linear, as the files of a run would hold them, on the
    display window. The interval comes with the next key frame, its past, and our network.
    """

    def __init__(self, opened: OpenedSubject, inputs: IntervalInputs, interval: Interval) -> None:
        self._interval, self._networks = interval, opened.networks
        self._foreign = replace(interval, extrapolator=opened.networks.imported)
        self._template, self._display = inputs.template, opened.display
        self._by_ffmpeg: Sequence[Float32] = ()

    def __missing__(self, name: str) -> Float32:
        pixels = quantise_picture(self._make(name), self._template)
        canvas = self._interval.key.image.data_window
        self[name] = place_on_canvas(pixels, canvas, self._display)
        return self[name]

    def _make(self, name: str) -> Float32:
        interval = self._interval
        if name.startswith(systems.IMPORTED):
            interval, name = self._foreign, name.removeprefix(systems.IMPORTED)
        if name == "W(E2)":
            return predict_path("S4", interval, FACTOR - 1).pixels
        if name == systems.REPEATED:
            system, slot = HOLD, 1
        elif " " in name:
            system, number = name.rsplit(" ", 1)
            slot = int(number)
        else:
            slot = int(name[1])
            if name[0] == "E":
                return interval.extrapolated(slot)
            return predict_path("S6", interval, slot).pixels
        if system == systems.MINTERPOLATE:
            if interval.following is not None:
                before, after = interval.key.image.pixels, interval.following.image.pixels
                if not self._by_ffmpeg:  # ffmpeg makes all slots at once
                    older = interval.past[0].frame.image.pixels if interval.past else None
                    self._by_ffmpeg = minterpolate(older, before, after)
                # ffmpeg makes no alpha, and no score depends on it.
                return np.concatenate([self._by_ffmpeg[slot - 1], before[..., 3:]], axis=-1)
            system = HOLD  # before a cut, where ffmpeg repeats the frame as well
        if system in self._networks.interpolators:
            interval = replace(interval, interpolator=self._networks.interpolators[system])
            system = "onnx"
        predict = METHODS[system].predict
        assert predict is not None
        return predict(interval, slot).pixels


class OpenedSubject:
    """A subject, ready to be read interval by interval.

    `keys` are the indices of the key frames that are measured: those with another one and truth
    after. `numbers` are the numbers of all key frames. `parts` is where the parts of it lie.
    ExwarpError: the sequence cannot be used.
    """

    def __init__(
        self, subject: Subject, settings: systems.BenchSettings, networks: Networks
    ) -> None:
        self.subject, self.settings, self.networks = subject, settings, networks
        extranet = () if networks.imported is None else (systems.EXTRANET, systems.EXTRANET_FAST)
        # Names of all systems that are compared: those that options add come last.
        self.systems = (*settings.systems, *extranet, *networks.interpolators)
        self.source = open_source(subject.source)
        keys, timeline = self.source.keys, self.source.timeline
        self.display, self.numbers = keys.display, timeline.numbers
        if "vmaf" in settings.metrics:
            require_vmaf_size(keys.display.height, keys.display.width, keys.sequence.pattern)
        self.truth_sequence, self._truth_number = find_truth(subject.truth, self.source)
        self.policy = require_state(load_policy(subject.policy))
        self.restart()
        last = len(self.numbers) - 1
        usable = [
            key
            for key in timeline.select(settings.frames)
            if key < last and self.truth_numbers(key).keys() >= set(systems.SLOTS)
        ]
        if not usable:
            raise MissingFrameError(
                f"no key frame of {keys.sequence.pattern} that was asked for has "
                "ground truth at its three slots and a key frame after it; give longer sequences"
            )
        self.keys = tuple(usable[:: settings.every])
        name = "".join(c if c.isalnum() or c in "-_." else "_" for c in subject.name)
        size = f"{self.display.width}x{self.display.height}"
        self.parts = settings.output / PARTS / f"{name}-{size}-{subject.setting}"

    def restart(self) -> None:
        """Forget what was read: the next interval need not follow the last one."""
        asked = UpsampleSettings(self.subject.source, "", EVERYTHING.name)
        self.reader = IntervalReader(self.source, EVERYTHING, asked)
        extrapolator = self.networks.own or self.networks.imported
        self.builder = IntervalBuilder(self.display, extrapolator, self.networks.look_ahead)
        self.observer = Observer(self.display, self.source.setting)
        self.chooser = MlpKernel(self.policy.network)

    def truth_numbers(self, key: int) -> dict[int, int]:
        """Return the numbers of the ground truth of slots 0 to 4; 4 is the next key frame's."""
        slots = (Slot(key + index // FACTOR, index % FACTOR) for index in range(FACTOR + 1))
        numbers = enumerate(map(self._truth_number, slots))
        return {index: number for index, number in numbers if number is not None}

    def truth(self, key: int) -> dict[int, Float32]:
        """Read the ground truth of slots 0 to 4 where there is one, on the display window."""
        frames = {}
        for index, number in self.truth_numbers(key).items():
            image = read_sequence_picture(self.truth_sequence, number, self.source.keys.view)
            frames[index] = image.on(image.display_window).pixels
        return frames

    def masks(self, interval: Interval) -> dict[int, Bool]:
        """Return the holes of W at slots 1 to 3, on the display window."""
        canvas = interval.key.image.data_window
        return {
            slot: np.asarray(place_on_canvas(mask, canvas, self.display))
            for slot in systems.SLOTS
            if (mask := interval.hole_mask(slot)) is not None
        }
