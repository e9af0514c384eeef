"""Record what the command writes, and check that a change keeps it.

Usage, from the repository root::

    python -m tests.golden.golden record [--out FILE] [NAME ...]
    python -m tests.golden.golden check [--against FILE] [--pixels] [NAME ...]

`record` runs all scenarios of `tests.golden.scenarios`, or the named ones, and stores their hashes.
`check` runs them again, prints a line for each difference, and exits with 1 if there is any.

Bytes differ between processors and between versions of libraries. The default file therefore
carries the processor's name. On another processor, record from the base commit first:
``record --python BASE/.venv/bin/python`` judges the package of that environment.

``--threads N`` adds --threads to all commands that take it and do not set it. The hashes of 1, 2
and 5 threads are equal. ``--work DIR`` keeps all files, and each masked text beside its source as
NAME.masked, so that ``diff -r`` shows what has changed. pytest does not collect this module.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import io
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import OpenEXR

from tests.golden.scenarios import INTERPRETED, SCENARIOS, write_inputs

FOLDER = Path(__file__).parent
DIGITS = 16
"""Of a hash that are kept."""

SHORT = 600
"""Characters of a masked text up to which it is kept itself."""

PIXELS = " pixels"
"""Ends the name of a hash of decoded pixels."""

THREADED = ("upsample", "features")
SILENCED = ("upsample", "features", "compare", "bench", "merge-reports")
"""Commands that get --threads and --progress none."""

MEASURED = re.compile(
    r"_ms$|^timing|^wall_s|^seconds|^throughput$|^generated_frame_s$|^saved_s|^render_s$"
    r"|^elapsed|^eta|^remaining|^machine$|^host|^runtime$|^memory|^report_sha256$"
)
"""Keys of documents and columns of tables whose values are times, depend on them, or tell of the
machine."""

UNSTABLE = re.compile(r"report\.html$|^out/(bench\.\w+|\w*(fps|time)\.csv|parts/.*)$")
"""Files of which only the name is recorded, as they are full of measured times."""

MASKS = (
    (r"(?m)^exwarp: (compiling|compiled|kernels are being compiled).*\n?", ""),
    (r"(?m)^render time saved.*$", "render time saved ~"),
    (r"(?<![\w:/.>~])/(?:[^\s\"'`,:;<>|/]+/)*(?=[^\s\"'`,:;<>|/]+)", "/~/"),  # absolute folders
    (r"\b\d+:\d\d left", "~ left"),
    (r"\b\d+(\.\d+)? (ms|s|min|h)\b", "~ s"),
)

PROBE = """
import json, sys, importlib.metadata as m
import llvmlite.binding, exwarp_cli
names = "numba llvmlite numpy onnxruntime OpenEXR OpenImageIO isal deflate imageio-ffmpeg".split()
print(json.dumps({
    "processor": llvmlite.binding.get_host_cpu_name(),
    "package": exwarp_cli.__path__[0],
    "versions": {"python": sys.version.split()[0]} | {n: m.version(n) for n in names},
}))
"""

Record = dict[str, str]
"""What a scenario leaves: hash, exit code or short text, by file or stream."""


@dataclass(frozen=True)
class Runner:
    """Where and how scenarios run."""

    python: str
    work: Path
    threads: int

    def run(self, name: str) -> Record:
        """Run a scenario in a folder of its own."""
        folder = self.work / name.replace(" ", "-").replace(":", "-")
        folder.mkdir()
        record: Record = {}
        for number, step in enumerate(SCENARIOS[name], 1):
            words = shlex.split(step)
            if words[0] == "rm":
                for file in words[1:]:
                    (folder / file).unlink()
                continue
            result = self.call(words, folder, name.startswith(INTERPRETED))
            record[f"{number} exit"] = str(result.returncode)
            for stream in ("stdout", "stderr"):
                text = self._masked_stream(getattr(result, stream), name)
                kept = folder.with_name(f"{folder.name}.{number}.{stream}.masked")
                kept.write_text(text, encoding="utf-8")
                record[f"{number} {stream}"] = text if len(text) <= SHORT else hashed(text)
        files = sorted(path for path in folder.rglob("*") if path.is_file())
        for path in files:
            record |= self._recorded(path, path.relative_to(folder).as_posix())
        return record

    def call(
        self, words: list[str], folder: Path, interpreted: bool = False
    ) -> subprocess.CompletedProcess[str]:
        command, more = words[0], []
        if command == "upsample" and "-o" not in words:
            more += ["-o", "out"]
        if command in THREADED and not {"--threads", "--help"} & {*words}:
            more += ["--threads", str(self.threads)]
        if command in SILENCED and not {"--progress", "--help"} & {*words}:
            more += ["--progress", "none"]
        return subprocess.run(
            [self.python, "-m", "exwarp_cli", *words, *more],
            cwd=folder, env=environment(interpreted), text=True, encoding="utf-8",
            capture_output=True, stdin=subprocess.DEVNULL,
        )  # fmt: skip

    def _masked_stream(self, text: str, name: str) -> str:
        try:
            document = json.loads(text)
        except ValueError:
            lines = [self._masked_line(line) for line in re.split(r"[\r\n]", text)]
            return self._masked_text("\n".join(lines))
        if name == "doctor":
            return "\n".join(sorted(set(key_paths(document))))
        return self._masked_json(document)

    def _masked_line(self, line: str) -> str:
        """Mask a line of --progress json."""
        if not line.startswith("{"):
            return line
        try:
            return self._masked_json(json.loads(line))
        except ValueError:
            return line

    def _masked_text(self, text: str) -> str:
        text = text.replace(str(self.work), "<work>")
        for pattern, mask in MASKS:
            text = re.sub(pattern, mask, text)
        return text

    def _masked_json(self, document: Any) -> str:
        return self._masked_text(json.dumps(unmeasured(document), indent=1))

    def _recorded(self, path: Path, name: str) -> Record:
        if UNSTABLE.search(name):
            return {name: "written"}
        data = path.read_bytes()
        if path.suffix == ".json":
            text = self._masked_json(json.loads(data))
        elif path.suffix == ".csv":
            text = self._masked_text(unmeasured_table(data.decode()))
        else:
            record = {name: hashed(data)}
            if path.suffix == ".exr":
                record[name + PIXELS] = hashed_pixels(path)
            return record
        path.with_name(f"{path.name}.masked").write_text(text, encoding="utf-8")
        return {name: hashed(text)}


def environment(interpreted: bool = False) -> dict[str, str]:
    """Return this process's variables without what changes ExWarp's behaviour."""
    mine = {k: v for k, v in os.environ.items() if not k.startswith(("EXWARP_", "PYTHON"))}
    mine |= {"EXWARP_CONFIG": "none", "COLUMNS": "80", "LC_ALL": "C.UTF-8"}
    return mine | ({"NUMBA_DISABLE_JIT": "1"} if interpreted else {})


def hashed(data: bytes | str) -> str:
    """Return the first digits of the SHA-256."""
    return hashlib.sha256(data if isinstance(data, bytes) else data.encode()).hexdigest()[:DIGITS]


def hashed_pixels(path: Path) -> str:
    """Return the hash of all channels of all parts of an EXR file, whatever its compression."""
    total = hashlib.sha256()
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            for part in file.parts:
                for name, channel in sorted(part.channels.items()):
                    pixels = channel.pixels
                    total.update(f"{part.name()} {name} {pixels.dtype} {pixels.shape}".encode())
                    total.update(pixels.tobytes())
    except RuntimeError:
        return "cannot be decoded"
    return total.hexdigest()[:DIGITS]


def unmeasured(value: Any, key: str = "") -> Any:
    """Return a document with "~" for all that is measured, and for hashes of frames."""
    if MEASURED.search(key):
        return "~"
    if isinstance(value, dict):
        # The files themselves are hashed: --pixels has to pass where only their bytes change.
        hidden = {"sha256": "~"} if "kind" in value and "sha256" in value else {}
        return {k: unmeasured(v, k) for k, v in (value | hidden).items()}
    return [unmeasured(item) for item in value] if isinstance(value, list) else value


def unmeasured_table(text: str) -> str:
    """Return a CSV table with "~" in the columns that hold measured times."""
    rows = list(csv.reader(io.StringIO(text)))
    masked = {i for i, name in enumerate(rows[0]) if MEASURED.search(name)} if rows else set()
    table = [rows[0]] if rows else []
    table += [["~" if i in masked else cell for i, cell in enumerate(row)] for row in rows[1:]]
    return "\n".join(",".join(row) for row in table)


def key_paths(value: Any, path: str = "") -> Iterator[str]:
    """Yield the keys of a document, without its values."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from key_paths(inner, f"{path}.{key}")
    elif isinstance(value, list):
        for inner in value:
            yield from key_paths(inner, f"{path}[]")
    else:
        yield path


def run_all(names: Sequence[str], options: argparse.Namespace, work: Path) -> dict[str, Record]:
    """Write the inputs, have the kernels compiled, and run scenarios, two at a time."""
    write_inputs(work / "inputs")
    runner = Runner(options.python, work, options.threads)
    runner.call(["doctor", "--json"], work)  # compiles
    with ThreadPoolExecutor(options.jobs) as pool:
        records = pool.map(runner.run, names)
        return dict(zip(names, records, strict=True))


def differences(name: str, old: Record, new: Record, pixels: bool) -> Iterator[str]:
    """Yield a line for each file or stream of a scenario that differs."""
    for item in sorted(old.keys() | new.keys()):
        if pixels and item + PIXELS in old.keys() | new.keys():
            continue
        was, now = old.get(item, "nothing"), new.get(item, "nothing")
        if was != now:
            yield f"{name}: {item}: was {was[:SHORT]!r}, is {now[:SHORT]!r}"


def parsed(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser("tests.golden.golden", description=__doc__.split("\n")[0])
    parser.add_argument("action", choices=("record", "check"))
    parser.add_argument("names", nargs="*", metavar="NAME", help="scenarios; default: all")
    parser.add_argument("--out", type=Path, help="file to record into")
    parser.add_argument("--against", type=Path, help="file to check against")
    parser.add_argument("--pixels", action="store_true", help="compare pixels of EXR, not bytes")
    parser.add_argument("--threads", type=int, default=1, help="for commands that set none")
    parser.add_argument("--jobs", type=int, default=2, help="scenarios at a time")
    parser.add_argument("--python", default=sys.executable, help="interpreter to judge")
    parser.add_argument("--work", type=Path, help="new folder that keeps all files")
    options = parser.parse_intermixed_args(arguments)
    options.python = str(Path(options.python).absolute())  # a resolved link would leave its venv
    if unknown := set(options.names) - SCENARIOS.keys():
        parser.error(f"no scenario {', '.join(sorted(unknown))}; there are {', '.join(SCENARIOS)}")
    if options.work is not None and options.work.exists():
        parser.error(f"{options.work} exists; name a new folder")
    return options


def main(arguments: Sequence[str] | None = None) -> int:
    options, begin = parsed(arguments), time.monotonic()
    probe = [options.python, "-c", PROBE]
    probed = subprocess.run(probe, cwd="/", env=environment(), capture_output=True, check=True)
    facts = json.loads(probed.stdout)
    print(f"judging {facts.pop('package')} on {facts['processor']}")
    file = options.against or options.out or FOLDER / f"{facts['processor']}.json"
    recording: dict[str, Any] = {"scenarios": {}}
    if file.exists():
        recording = json.loads(file.read_text(encoding="utf-8"))
    elif options.action == "check":
        print(f"there is no {file}; record from the base commit first")
        return 2
    names = [name for name in SCENARIOS if name in options.names or not options.names]
    work = options.work or Path(tempfile.mkdtemp(prefix="exwarp-golden-"))
    work.mkdir(parents=True, exist_ok=options.work is None)
    try:
        records = run_all(names, options, work.resolve())
    finally:
        if options.work is None:
            shutil.rmtree(work)
    print(f"{len(names)} scenarios in {time.monotonic() - begin:.0f} s")
    if options.action == "record":
        recorded = recording["scenarios"] if options.names else {}
        text = json.dumps(facts | {"scenarios": recorded | records}, indent=1, sort_keys=True)
        file.write_text(text + "\n", encoding="utf-8")
        return 0
    lines = [
        line
        for name in names
        for line in differences(name, recording["scenarios"].get(name, {}), records[name],
                                options.pixels)
    ]  # fmt: skip
    if lines and facts["versions"] != recording["versions"]:
        print("note: recorded with other versions of libraries")
    print("\n".join(lines) or "no difference")
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main())
