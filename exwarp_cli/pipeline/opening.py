"""Opening the sequences that a user names, with what options and channel maps say of them."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

from exwarp_cli.domain.frame import set_max_pixels
from exwarp_cli.domain.settings import DEFAULT_FPS, SourceSettings
from exwarp_cli.domain.timeline import number_step, standard_rate
from exwarp_cli.errors import DamagedFileError, InputError, LayoutError, UsageError
from exwarp_cli.io.aov_files import AovFile, parse_aovs
from exwarp_cli.io.channel_map import ChannelMap, read_channel_map
from exwarp_cli.io.channels import Role
from exwarp_cli.io.clip import is_clip
from exwarp_cli.io.cryptomatte import Cryptomatte, find_cryptomattes
from exwarp_cli.io.cryptomatte_ids import IdReading
from exwarp_cli.io.cryptomatte_manifest import Manifest, dynamic_objects, read_manifest
from exwarp_cli.io.footage import find_plain, is_plain, own_rate, shot_of
from exwarp_cli.io.frames import read_raw, require_seen
from exwarp_cli.io.output import frame_rate
from exwarp_cli.io.shot import Shot, open_shot, open_views, renamed
from exwarp_cli.io.views import ALL
from exwarp_cli.pipeline.depth_kind import with_depth_measured, with_world_positions
from exwarp_cli.pipeline.motion_option import motion_names, parse_motion


def open_keys(settings: SourceSettings) -> tuple[Shot, SourceSettings]:
    """Open the key frames, and settle what their channel map says.

    Returns
    -------
    shot : Shot
        The key frames.
    settings : SourceSettings
        With the map's motion where `motion` is not given, and vectors are those of the key frames.

    Raises
    ------
    InputError
        As :func:`exwarp_cli.io.shot.open_shot` does.
    UsageError
        When the map's motion is not understood.
    """
    set_max_pixels(settings.max_pixels)
    said = (*_said(settings), settings.keep_going)
    shot = open_shot(settings.sequence, settings.view, *said)
    require_seen(shot)
    shot = _measured(shot)
    channel_map = shot.channel_map
    if channel_map is None or channel_map.motion is None or settings.motion or settings.gbuffers:
        return shot, settings
    if Role.MOTION not in shot.layout:
        raise LayoutError(
            f"{channel_map.option('motion')} is of no use, as no motion channels are recognised in "
            f"{shot.sequence.pattern}; name them in channels.motion"
        )
    try:
        size = (shot.display.width, shot.display.height)
        parse_motion(channel_map.motion, motion_names(shot), size)
    except UsageError as error:
        raise UsageError(f"{channel_map.option('motion')} is wrong: {error}") from error
    return shot, replace(settings, motion=channel_map.motion)


def open_plain(settings: SourceSettings) -> Shot | None:
    """Open a video or a sequence of stills, which have colour alone; None where EXR is meant.

    Raises
    ------
    InputError
        When it cannot be read.
    UsageError
        When options are given that say how EXR is read.
    """
    set_max_pixels(settings.max_pixels)
    sequence = find_plain(settings.sequence, settings.keep_going, settings.scan)
    if sequence is None:
        return None
    options = {
        "--gbuffers": settings.gbuffers,
        "--motion": settings.motion,
        "--view": settings.view,
        "--aov": settings.aovs,
        "--channel-map": settings.channel_map,
        "--dynamic": settings.dynamic,
    }
    for option, value in options.items():
        if value:
            raise UsageError(
                f"{option} is for rendered EXR frames, and {sequence.pattern} has nothing but "
                "colour; leave it out"
            )
    return shot_of(sequence, settings.keep_going)


def each_view(settings: SourceSettings) -> tuple[SourceSettings, ...]:
    """Return the settings of every view of a shot for ``--view all``, the hero's first.

    Other settings are returned as they are.
    """
    if settings.view != ALL or is_clip(settings.sequence):
        return (settings,)
    shots = open_views(settings.sequence, ALL, *_said(settings), settings.keep_going)
    return tuple(replace(settings, view=shot.view) for shot in shots)


def open_slots(settings: SourceSettings, keys: Shot) -> Shot | None:
    """Open the G-buffers at the output rate, in the view of the key frames; None without.

    Options and maps that name channels are of the key frames; here they are recognised.
    """
    if settings.gbuffers is None:
        return None
    channel_map = keys.channel_map
    asked = settings.view or (None if channel_map is None else channel_map.view)
    slots = open_shot(settings.gbuffers, asked, keep_going=settings.keep_going)
    if slots.view != keys.view and keys.view in slots.views:
        # Another view is first there.
        slots = open_shot(settings.gbuffers, keys.view, keep_going=settings.keep_going)
    return _measured(slots)


def _measured(shot: Shot) -> Shot:
    """Return a shot with what its pixels tell of its depth and positions."""
    return with_world_positions(with_depth_measured(shot))


def _said(settings: SourceSettings) -> tuple[tuple[AovFile, ...], ChannelMap | None]:
    path = settings.channel_map
    return parse_aovs(settings.aovs), None if path is None else read_channel_map(Path(path))


def rate_of(keys: Shot, given: Fraction | None) -> tuple[Fraction, str]:
    """Return the base rate, and whether it is from the option, the header, a video or assumed.

    A header has the scene's rate, and so has what is assumed. Of a scene at 24 fps that is rendered
    in steps of 4 (1, 5, 9 …) the key frames come at 6.
    """
    if given is not None:
        return standard_rate(given), "option"
    own = own_rate(keys.sequence)
    if own is not None:
        return own, "file"
    rate = None if is_plain(keys.sequence) else _rate_in(keys)
    step = number_step(keys.sequence.numbers)
    return (DEFAULT_FPS / step, "assumed") if rate is None else (rate / step, "header")


def step_note(numbers: Sequence[int], fps: Fraction, fps_source: str) -> str | None:
    """Say how the rate of frames that are numbered in steps is read, and how else it could be."""
    step = number_step(numbers)
    if step == 1 or fps_source not in ("header", "assumed"):
        return None
    scene = f"{float(fps * step):g}"
    what = f"the header's {scene} fps are" if fps_source == "header" else f"{scene} fps are assumed"
    return (
        f"frames are numbered in steps of {step}: {what} taken for the rate of the scene, of which "
        f"one frame in {step} is rendered, so the key frames come at {float(fps):g} fps; if the "
        f"key frames themselves come at {scene} fps, give --fps {scene}"
    )


def _rate_in(keys: Shot) -> Fraction | None:
    """Return the rate that the headers of the first frame have; None without."""
    header = keys.headers.read(keys.sequence.files[keys.first])
    return next(filter(None, map(frame_rate, header.attributes)), None)


def read_ids(option: str | None, keys: Shot, slots: Shot | None) -> tuple[Shot, Shot | None]:
    """Settle which ids are read of a shot.

    Parameters
    ----------
    option
        What moves, as ``--dynamic`` takes it; None where nothing is said.
    keys, slots
        The key frames, and G-buffers of slots if there are some: those tell of ids then.

    Returns
    -------
    tuple
        The same, with `Shot.ids` where ids are read from a Cryptomatte. With `option` they are the
        stencil, and the shots have no other one; without they are only read where there is none,
        and where they are sound.

    Raises
    ------
    LayoutError
        When something is named as moving, and there is no Cryptomatte, or one of half floats.
    DamagedFileError
        When something is named, and ids were destroyed.
    UsageError
        When a name or pattern matches nothing.
    """
    if option is None:
        return _with_best_ids(keys), None if slots is None else _with_best_ids(slots)
    shots = [shot for shot in (keys, slots) if shot is not None and shot.cryptomattes]
    needed = slots or keys
    if needed not in shots:
        raise LayoutError(
            f"--dynamic names objects of a Cryptomatte, and {needed.sequence.pattern} has none; "
            "render that pass, or leave --dynamic out"
        )
    manifests, rounded = _read_manifests(shots)
    where = f"{needed.sequence.pattern}, layer {needed.cryptomattes[0].name!r},"
    dynamic = dynamic_objects(option, manifests, where, rounded)

    def directed(shot: Shot) -> Shot:
        if shot not in shots:
            return shot
        roles = dict(shot.layout.roles)
        roles.pop(Role.STENCIL, None)
        ids = IdReading(shot.cryptomattes[0], rounded, dynamic)
        found = replace(shot, layout=replace(shot.layout, roles=roles), ids=ids)
        _try(found)
        return found

    return directed(keys), None if slots is None else directed(slots)


def looked_into(shot: Shot) -> Iterator[tuple[Cryptomatte, Manifest]]:
    """Yield each Cryptomatte of a shot with its first frame's manifest.

    Of one whose ids cannot be used, the manifest has no names, and says why.
    """
    for one in shot.cryptomattes:
        try:
            one.require_exact("the file")
            _try(replace(shot, ids=IdReading(one)))
        except (LayoutError, DamagedFileError) as error:
            yield one, Manifest(problem=str(error))
        else:
            yield one, read_manifest(one, shot.files(shot.first)[one.aov])


def _with_best_ids(shot: Shot) -> Shot:
    """Have the best Cryptomatte's ids read where nothing else tells objects apart."""
    if Role.STENCIL in shot.layout or not shot.cryptomattes or not shot.cryptomattes[0].exact:
        return shot
    found = replace(shot, ids=IdReading(shot.cryptomattes[0]))
    try:
        _try(found)
    except DamagedFileError:
        return shot
    return found


def _try(shot: Shot) -> None:
    """Read the ids of the first frame."""
    read_raw(shot, shot.first, (Role.STENCIL,), objects=True)


def _of_all_frames(shot: Shot) -> Iterator[tuple[Cryptomatte, Path]]:
    """Yield a shot's Cryptomatte as each frame has it, with the frame's file.

    Frames have manifests of their own: an object that comes later is in those of later frames.
    """
    wanted = shot.cryptomattes[0]
    for number in shot.sequence.numbers:
        path = shot.files(number)[wanted.aov]
        try:
            found = _in_file(shot, path)
        except InputError:
            if not shot.keep_going:
                raise
            continue
        for one in found:
            yield one, path


def _in_file(shot: Shot, path: Path) -> list[Cryptomatte]:
    """Return a shot's Cryptomatte as a file has it."""
    wanted = shot.cryptomattes[0]
    header = shot.headers.read(path)
    channels = {wanted.aov: renamed(shot.channels(header.parts, wanted.aov))}
    found = find_cryptomattes(channels, {wanted.aov: header.texts})
    mine = [one for one in found if one.name == wanted.name]
    for one in mine:
        one.require_exact(str(path))
    return mine


def _read_manifests(shots: Iterable[Shot]) -> tuple[list[Manifest], bool]:
    """Return the manifests of all frames, and whether any frame's ids are rounded.

    What a manifest repeats is left out: they are large, and mostly the same in all frames.
    """
    manifests: list[Manifest] = []
    rounded = False
    texts: set[bytes] = set()
    names: set[tuple[str, int]] = set()
    for matte, path in (pair for shot in shots for pair in _of_all_frames(shot)):
        rounded = rounded or matte.rounded
        text = repr((matte.manifest, matte.sidecar, str(path.parent)))
        digest = hashlib.sha256(text.encode()).digest()
        if digest in texts:
            continue
        texts.add(digest)
        manifest = read_manifest(matte, path)
        new = {name: bits for name, bits in manifest.ids.items() if (name, bits) not in names}
        names.update(new.items())
        manifests.append(replace(manifest, ids=new))
    return manifests, rounded
