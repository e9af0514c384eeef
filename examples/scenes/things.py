"""Take real things for training shots out of Debian's packages, into the user's cache folder.

    python3 examples/scenes/things.py                # about 330 MB to download, 850 MB on disk
    python3 examples/scenes/things.py --folder DIR

Needs Debian's `apt-get` and `dpkg`, and numpy; nothing is installed, and root is not needed.
Packages that are there are not downloaded again. Writes `things.json`, which the generator reads,
and `CREDITS.md`: what was taken, by whom, under which licence.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import things_md3
import things_players
from things_list import FIGURE, SHAPE, TEXTURE, Thing, ThingList, default_folder, licences, write

LARGEST = 1_200_000
"""Bytes of an OBJ file: a larger one takes seconds to load in every shot that shows it."""

SMALLEST = 3_000
FLATTEST = 0.06
"""Least share of the largest dimension that the smallest one has: no rugs, no newspapers."""

LEFT_OUT = ("Doors and windows", "Staircases")
LIBRARIES = ("BlendSwap-CC-0", "BlendSwap-CC-BY", "KatorLegaz", "Reallusion", "Scopia")
PICTURES = (".jpg", ".jpeg", ".png", ".tga")

ROLES = {
    "floor": (
        "base_floor", "cosmo_floor", "gothic_floor", "evil1_floors", "evil3_floors",
        "evil6_floors", "evil8_floor", "stone", "clown",
    ),
    "wall": (
        "base_wall", "base_wall2", "cosmo_block", "cosmo_wall", "gothic_block", "gothic_wall",
        "evil1_walls", "evil4_walls", "evil8_wall", "pulchr_simple", "acc_dm3", "acc_dm5",
    ),
    "trim": ("base_trim", "base_support", "gothic_trim", "evil8_trim", "evil1_metals", "oquartz"),
}  # fmt: skip
"""Folders of textures that tile, by what they suit."""

MODELS = (
    "models/mapobjects/kit89-models/liz-statue/liz-statue", "models/mapobjects/palmier/palmier1",
    "models/mapobjects/czest2ctf/gargoyle", "models/mapobjects/fan/fan",
    "models/mapobjects/torch/torch", "models/mapobjects/czest2ctf/lamphang",
    "models/weapons2/rocketl/rocketl", "models/weapons2/grenadel/grenadel",
    "models/weapons2/shotgun/shotgun", "models/weapons2/machinegun/machinegun",
    "models/powerups/armor/armor_red", "models/powerups/ammo/rocketam",
)  # fmt: skip


def main() -> None:
    """Download, unpack, convert, list."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--folder", type=Path, default=default_folder(), help="(%(default)s)")
    folder: Path = parser.parse_args().folder.expanduser().resolve()
    for program in ("apt-get", "apt-cache", "dpkg-deb"):
        if shutil.which(program) is None:
            sys.exit(f"{program} is missing; real things can be taken on Debian alone.")
    versions: dict[str, str] = {}
    things: list[Thing] = []
    for package, take in TAKERS.items():
        versions[package], root = unpack(package, folder)
        taken = list(take(folder, package, root))
        print(f"{package} {versions[package]}: {len(taken)} things")
        things += taken
    write(ThingList(folder, versions, tuple(sorted(things, key=lambda thing: thing.name))))
    print(f"{len(things)} things in {folder}")


def unpack(package: str, folder: Path) -> tuple[str, Path]:
    """Download and unpack a package, if it is not there; return its version and its root."""
    listed = _output("apt-cache", "show", "--no-all-versions", package)
    version = next(
        (line.split()[1] for line in listed.splitlines() if line.startswith("Version:")), ""
    )
    if not version:
        sys.exit(f"Debian's package {package} is not known here; run apt-get update, or leave it.")
    root = folder / "packages" / f"{package}_{version.replace(':', '%3a')}"
    if not root.is_dir():
        print(f"{package} {version}: downloading")
        apart = folder / ".part"
        shutil.rmtree(apart, ignore_errors=True)
        apart.mkdir(parents=True)
        _output("apt-get", "download", f"{package}={version}", cwd=apart)
        (archive,) = apart.glob("*.deb")
        _output("dpkg-deb", "--extract", str(archive), str(apart / "root"))
        root.parent.mkdir(exist_ok=True)
        (apart / "root").replace(root)
        shutil.rmtree(apart)
    return version, root


def _output(*command: str, cwd: Path | None = None) -> str:
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)
    if done.returncode:
        lines = done.stderr.strip().splitlines() or ["no reason"]
        sys.exit(f"{' '.join(command)} failed: {lines[-1]}")
    return done.stdout


def _licences(package: str, root: Path) -> dict[str, tuple[str, str]]:
    path = root / "usr" / "share" / "doc" / package / "copyright"
    return licences(path.read_text(encoding="utf-8"))


def take_furniture(folder: Path, package: str, root: Path) -> Iterator[Thing]:
    """Take the furniture of Sweet Home 3D: OBJ files with pictures in zip files."""
    terms = _licences(package, root)
    for library in LIBRARIES:
        licence, holders = terms[f"{library}/*"]
        target = folder / "furniture" / library
        source = root / "usr" / "share" / "sweethome3d" / "furniture" / f"{library}.sh3f"
        with zipfile.ZipFile(source) as archive:
            catalogue = archive.read("PluginFurnitureCatalog.properties").decode("latin-1")
            for number, row in _rows(catalogue).items():
                model = row.get("model", "").lstrip("/")
                if not _is_wanted(archive, model, row):
                    continue
                _extract_beside(archive, model, target)
                yield Thing(
                    f"{library}/{number:03d}",
                    row["name"],
                    SHAPE,
                    str((target / model).relative_to(folder)),
                    row.get("creator", holders),
                    licence,
                    package,
                )


def _rows(catalogue: str) -> dict[int, dict[str, str]]:
    """Read the entries of a catalogue by their numbers."""
    rows: dict[int, dict[str, str]] = {}
    for line in catalogue.splitlines():
        key, equals, value = line.partition("=")
        name, hash_sign, number = key.partition("#")
        if equals and hash_sign and not line.startswith("#"):
            text = value.encode("latin-1").decode("unicode_escape")
            rows.setdefault(int(number), {})[name] = text
    return rows


def _is_wanted(archive: zipfile.ZipFile, model: str, row: dict[str, str]) -> bool:
    if model not in archive.namelist() or not model.endswith(".obj"):
        return False
    sides = [float(row[side]) for side in ("width", "depth", "height")]
    size = archive.getinfo(model).file_size
    fits = SMALLEST < size < LARGEST and min(sides) > FLATTEST * max(sides)
    return fits and row.get("category") not in LEFT_OUT


def _extract_beside(archive: zipfile.ZipFile, model: str, target: Path) -> None:
    """Extract a model with the materials and pictures of its folder."""
    beside = model.rpartition("/")[0] + "/"
    for name in archive.namelist():
        wanted = name == model or name.lower().endswith((".mtl", *PICTURES))
        if name.rpartition("/")[0] + "/" == beside and wanted:
            archive.extract(name, target)


def take_textures(folder: Path, package: str, root: Path) -> Iterator[Thing]:
    """Take the textures of OpenArena that tile."""
    licence, holders = _game_terms(package, root)
    archive_path = root / "usr/share/games/openarena/baseoa/pak4-textures.pk3"
    with zipfile.ZipFile(archive_path) as archive:
        for role, folders in ROLES.items():
            for name in sorted(archive.namelist()):
                parent, _, file = name.rpartition("/")
                if parent.removeprefix("textures/") in folders and name.endswith(".jpg"):
                    archive.extract(name, folder / "openarena")
                    title, path = f"{role}: {file}", f"openarena/{name}"
                    yield Thing(name, title, TEXTURE, path, holders, licence, package)


def _game_terms(package: str, root: Path) -> tuple[str, str]:
    licence, _ = _licences(package, root)["*"]
    return licence, "the OpenArena team; id Software, Inc."


def take_models(folder: Path, package: str, root: Path) -> Iterator[Thing]:
    """Take shapes of OpenArena, converted from MD3, and its one character in this package."""
    licence, holders = _game_terms(package, root)
    with zipfile.ZipFile(root / "usr/share/games/openarena/baseoa/pak0.pk3") as archive:
        names = [n for n in archive.namelist() if n.startswith("models/") and n.endswith(PICTURES)]
        archive.extractall(folder / "openarena", names)
        for name in MODELS:
            path = folder / "openarena" / f"{name}.obj"
            model = things_md3.read(archive.read(f"{name}.md3"))
            _write_obj(archive, model, name, path)
            relative = str(path.relative_to(folder))
            yield Thing(name, path.stem, SHAPE, relative, holders, licence, package)
    yield from take_players(folder, package, root)


def take_players(folder: Path, package: str, root: Path) -> Iterator[Thing]:
    """Take the running characters of OpenArena, converted from MD3."""
    licence, holders = _game_terms(package, root)
    (archive_path,) = (root / "usr/share/games/openarena/baseoa").glob("*.pk3")
    with zipfile.ZipFile(archive_path) as archive:
        for name in things_players.names(archive):
            path = folder / "openarena" / "players" / f"{name}.npz"
            for picture in things_players.convert(archive, name, path):
                archive.extract(picture, folder / "openarena")
            relative = str(path.relative_to(folder))
            yield Thing(f"players/{name}", name, FIGURE, relative, holders, licence, package)


def _write_obj(archive: zipfile.ZipFile, model: things_md3.Model, name: str, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    looks = [f"look{number}" for number in range(len(model.surfaces))]
    text = things_md3.to_obj(model.surfaces, 0, looks, f"{path.stem}.mtl")
    path.write_text(text, encoding="utf-8")
    lines = []
    for look, surface in zip(looks, model.surfaces, strict=True):
        lines += [f"newmtl {look}", "Kd 0.6 0.6 0.6"]
        if picture := things_players.picture(archive, name, surface.shader):
            lines.append(f"map_Kd {(path.parents[name.count('/')] / picture).as_posix()}")
    path.with_suffix(".mtl").write_text("\n".join(lines) + "\n", encoding="utf-8")


Taker = Callable[[Path, str, Path], Iterator[Thing]]
TAKERS: dict[str, Taker] = {
    "sweethome3d-furniture": take_furniture,
    "openarena-081-textures": take_textures,
    "openarena-data": take_models,
    "openarena-081-players": take_players,
}
"""By package, what is taken of it."""


if __name__ == "__main__":
    main()
