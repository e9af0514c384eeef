"""Which sequences a benchmark measures, and which of their key intervals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from exwarp_cli.domain.bench import SYSTEMS, BenchSettings
from exwarp_cli.domain.settings import SourceSettings
from exwarp_cli.errors import InputError, LayoutError, MissingFrameError, UsageError
from exwarp_cli.io.dataset import BENCHMARK, RenderedScene, find_scenes
from exwarp_cli.io.sequences import find_sequence
from exwarp_cli.models.model_file import shipped_folder
from exwarp_cli.models.policy_files import policy_name_without

Say = Callable[[str], None]


@dataclass(frozen=True)
class Subject:
    """A sequence in one setting.

    Attributes
    ----------
    name
        The scene's, or that of the sequence's folder.
    source
        Key frames, and G-buffers of slots in the slot setting.
    truth
        Sequence at the output rate.
    setting
        "key" or "slot".
    policy
        File of the policy that decides; None for the one that comes with ExWarp.
    unseen
        Whether that policy was trained without this scene; None where nothing tells.
    """

    name: str
    source: SourceSettings
    truth: str
    setting: str
    policy: Path | None = None
    unseen: bool | None = None


def subjects_of(settings: BenchSettings, say: Say) -> tuple[Subject, ...]:
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
        return (_sequence(settings),)
    _refuse_vain(settings)
    found = [subject for data in settings.inputs for subject in _data_set(data, settings, say)]
    _require_different(found)
    return tuple(found)


def _sequence(settings: BenchSettings) -> Subject:
    """Return the one sequence that was given with its ground truth."""
    assert settings.ground_truth is not None
    if len(settings.inputs) != 1 or settings.scenes:
        raise UsageError(
            "--ground-truth belongs to one sequence; give one, without --scenes, or a data set "
            "without --ground-truth"
        )
    spec = settings.inputs[0]
    source = SourceSettings(spec, settings.gbuffers, settings.motion, settings.fps)
    setting = "key" if settings.gbuffers is None else "slot"
    name = _name_of(spec)
    return Subject(name, source, settings.ground_truth, setting, settings.policy)


def _name_of(spec: str) -> str:
    """Return what the frames of a sequence are called, without the number."""
    stem = Path(find_sequence(spec).pattern).name.split("#")[0].strip("._- ")
    return stem or Path(spec).name or "sequence"


def _refuse_vain(settings: BenchSettings) -> None:
    given = {"--gbuffers": settings.gbuffers, "--motion": settings.motion, "--fps": settings.fps}
    if vain := [option for option, value in given.items() if value is not None]:
        raise UsageError(
            f"{vain[0]} belongs to one sequence; give it with --ground-truth, or leave it out for "
            "a data set, which tells by itself"
        )


def _data_set(data: str, settings: BenchSettings, say: Say) -> list[Subject]:
    try:
        scenes = find_scenes(data, None if settings.scenes else BENCHMARK, settings.scenes)
    except InputError as error:
        raise type(error)(f"{error}; a sequence of your own needs --ground-truth") from error
    found: list[Subject] = []
    for scene in scenes:
        try:
            found += _scene(scene.as_far_as_rendered(), settings)
        except MissingFrameError as error:
            if settings.scenes:
                raise
            say(f"left out: {error}")
    if not found:
        raise MissingFrameError(f"{data} has no scene with two key frames; render one first")
    return found


def _scene(scene: RenderedScene, settings: BenchSettings) -> list[Subject]:
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
    keys, instants = (
        str(scene.folder / frames.pattern) for frames in (manifest.keys, manifest.instants)
    )
    policy, unseen = settings.policy, None
    if policy is None:
        alone = shipped_folder() / policy_name_without(scene.name)
        policy, unseen = (alone, True) if alone.is_file() else (None, None)
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


def _require_different(subjects: list[Subject]) -> None:
    """Refuse the same input twice, whose parts would overwrite each other."""
    seen = set()
    for subject in subjects:
        token = (subject.source.sequence, subject.setting)
        if token in seen:
            raise UsageError(f"{subject.source.sequence} is given twice; give it once")
        seen.add(token)


def listed(text: str | None) -> tuple[str, ...]:
    """Read names with commas between; nothing for None."""
    named = (name.strip() for name in (text or "").split(","))
    return tuple(dict.fromkeys(name for name in named if name))


def systems_of(text: str | None) -> tuple[str, ...]:
    """Read ``--systems``; all for None.

    Raises
    ------
    UsageError
        For a name that is none.
    """
    if text is None:
        return SYSTEMS
    chosen = listed(text)
    if unknown := [name for name in chosen if name not in SYSTEMS]:
        raise UsageError(f"--systems names {unknown[0]!r}; choose out of {', '.join(SYSTEMS)}")
    if not chosen:
        raise UsageError(f"--systems is empty; choose out of {', '.join(SYSTEMS)}")
    return chosen
