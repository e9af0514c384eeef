"""Which ids of a Cryptomatte are read, and which of them ``--dynamic`` names."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

from exwarp_cli.errors import DamagedFileError, InputError, LayoutError
from exwarp_cli.io.channels import Role
from exwarp_cli.io.cryptomatte import Cryptomatte, find_cryptomattes
from exwarp_cli.io.cryptomatte_manifest import Manifest, dynamic_objects, read_manifest
from exwarp_cli.io.frames import read_raw
from exwarp_cli.io.id_reading import IdReading
from exwarp_cli.io.shot import Shot, renamed


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
        return _undirected(keys), None if slots is None else _undirected(slots)
    shots = [shot for shot in (keys, slots) if shot is not None and shot.cryptomattes]
    needed = slots or keys
    if needed not in shots:
        raise LayoutError(
            f"--dynamic names objects of a Cryptomatte, and {needed.sequence.pattern} has none; "
            "render that pass, or leave --dynamic out"
        )
    manifests, rounded = _told(shots)
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


def _undirected(shot: Shot) -> Shot:
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


def _told(shots: Iterable[Shot]) -> tuple[list[Manifest], bool]:
    """Return what the manifests of all frames tell, and whether any frame's ids are rounded.

    What is told again is left out: manifests are large, and mostly the same in all frames.
    """
    found: list[Manifest] = []
    rounded = False
    texts: set[bytes] = set()
    names: set[tuple[str, int]] = set()
    for matte, path in (told for shot in shots for told in _of_all_frames(shot)):
        rounded = rounded or matte.rounded
        told = repr((matte.manifest, matte.sidecar, str(path.parent)))
        digest = hashlib.sha256(told.encode()).digest()
        if digest in texts:
            continue
        texts.add(digest)
        manifest = read_manifest(matte, path)
        new = {name: bits for name, bits in manifest.ids.items() if (name, bits) not in names}
        names.update(new.items())
        found.append(replace(manifest, ids=new))
    return found, rounded
