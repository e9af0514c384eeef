"""Changing what was recognised in a sequence's files: by hand, and where AOVs come together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from exwarp_cli.io.aov_files import named
from exwarp_cli.io.channel_map import ChannelMap
from exwarp_cli.io.channels import ChannelRef, Layout, Role
from exwarp_cli.io.exr.parts import Channel


def corrected(
    layout: Layout, channels: Mapping[str, Mapping[str, Channel]], told: ChannelMap
) -> Layout:
    """Put a channel map's roles in place of those that were recognised."""
    known = {
        spelled(ChannelRef(aov, name)): ChannelRef(aov, name)
        for aov, members in channels.items()
        for name in members
    }
    roles = dict(layout.roles)
    for role, names in told.channels.items():
        roles.pop(role, None)
        option = told.option(f"channels.{role.value}")
        refs = tuple(known[named(name, known, option, "the shot")] for name in names)
        if refs:
            roles[role] = refs
    same = roles.get(Role.MOTION) == layout.roles.get(Role.MOTION)
    producer = told.producer or layout.producer
    guess = layout.guess if same else None
    alphas = () if Role.COLOUR in told.channels else layout.alphas
    return replace(layout, roles=_ordered(roles), guess=guess, producer=producer, alphas=alphas)


def moved(layout: Layout, names: Mapping[str, str]) -> Layout:
    """Return a layout with other names of AOVs."""
    roles = {
        role: tuple(replace(ref, aov=names.get(ref.aov, ref.aov)) for ref in refs)
        for role, refs in layout.roles.items()
    }
    alphas = tuple(replace(ref, aov=names.get(ref.aov, ref.aov)) for ref in layout.alphas)
    return replace(layout, roles=roles, alphas=alphas)


def merged(layout: Layout, more: Layout) -> Layout:
    """Add the roles of another layout, and what it says of motion if that is among them."""
    roles = _ordered({**layout.roles, **more.roles})
    guess = more.guess if Role.MOTION in more else layout.guess
    ours = Role.MOTION in more and more.guess is not None
    producer = (more if ours else layout).producer
    alphas = more.alphas if Role.COLOUR in more else layout.alphas
    return replace(layout, roles=roles, guess=guess, producer=producer, alphas=alphas)


def alpha_left_out(layout: Layout) -> str | None:
    """Say that a colour has no alpha as several channels may be it; None where that is not so."""
    if not layout.alphas:
        return None
    names = ", ".join(spelled(ref) for ref in layout.alphas)
    return (
        f"alpha is left out, as {names} may each be it; name one as the fourth of channels.colour "
        "in a channel map"
    )


def spelled(ref: ChannelRef) -> str:
    """Return a channel's name as users see it, and channel maps have it: with its AOV."""
    return f"{ref.aov}:{ref.name}" if ref.aov else ref.name


def _ordered(roles: Mapping[Role, tuple[ChannelRef, ...]]) -> dict[Role, tuple[ChannelRef, ...]]:
    return {role: roles[role] for role in Role if role in roles}
