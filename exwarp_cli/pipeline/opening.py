"""Opening the sequences that a user names, with what options and channel maps say of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from exwarp_cli.domain.settings import SourceSettings
from exwarp_cli.errors import LayoutError, UsageError
from exwarp_cli.io.aov_files import AovFile, parse_aovs
from exwarp_cli.io.channel_map import ChannelMap, read_channel_map
from exwarp_cli.io.channels import Role
from exwarp_cli.io.shot import Shot, open_shot, open_views
from exwarp_cli.io.views import ALL
from exwarp_cli.pipeline.depth_kind import with_depth_measured
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
    shot = with_depth_measured(open_shot(settings.sequence, settings.view, *_said(settings)))
    told = shot.channel_map
    if told is None or told.motion is None or settings.motion or settings.gbuffers:
        return shot, settings
    if Role.MOTION not in shot.layout:
        raise LayoutError(
            f"{told.option('motion')} is of no use, as no motion channels are recognised in "
            f"{shot.sequence.pattern}; name them in channels.motion"
        )
    try:
        size = (shot.display.width, shot.display.height)
        parse_motion(told.motion, motion_names(shot), size)
    except UsageError as error:
        raise UsageError(f"{told.option('motion')} is wrong: {error}") from error
    return shot, replace(settings, motion=told.motion)


def each_view(settings: SourceSettings) -> tuple[SourceSettings, ...]:
    """Return the settings of every view of a shot for ``--view all``, the hero's first.

    Other settings are returned as they are.
    """
    if settings.view != ALL:
        return (settings,)
    shots = open_views(settings.sequence, ALL, *_said(settings))
    return tuple(replace(settings, view=shot.view) for shot in shots)


def open_slots(settings: SourceSettings, keys: Shot) -> Shot | None:
    """Open the G-buffers at the output rate, in the view of the key frames; None without.

    Options and maps that name channels are of the key frames; here they are recognised.
    """
    if settings.gbuffers is None:
        return None
    told = keys.channel_map
    asked = settings.view or (None if told is None else told.view)
    slots = open_shot(settings.gbuffers, asked)
    if slots.view != keys.view and keys.view in slots.views:
        slots = open_shot(settings.gbuffers, keys.view)  # another view is first there
    return with_depth_measured(slots)


def _said(settings: SourceSettings) -> tuple[tuple[AovFile, ...], ChannelMap | None]:
    path = settings.channel_map
    return parse_aovs(settings.aovs), None if path is None else read_channel_map(Path(path))
