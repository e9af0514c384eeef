"""``exwarp train``: learning from rendered scenes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from exwarp_cli.commands import options
from exwarp_cli.commands.options import FILE
from exwarp_cli.domain.wording import one_line
from exwarp_cli.research.training.training_settings import (
    ExtrapolatorSettings,
    LookAheadSettings,
    PolicySettings,
    TilePolicySettings,
    require_sane_policy,
    require_train,
)

DEFAULTS = ExtrapolatorSettings()
AHEAD = LookAheadSettings()


@click.group("train", subcommand_metavar="[COMMAND] [ARGS]...")
def command() -> None:
    """Train ExWarp's networks on rendered scenes."""


# What is learnt from, and where the outcome goes.
_scene_options = options.combined(
    click.option("--data", type=FILE, required=True, help="Folder of rendered scenes."),
    click.option("-o", "--output", type=FILE, required=True, help="For checkpoints and the model."),
    click.option(
        "--scenes", multiple=True, metavar="GLOB", help="Names to learn from; else all made for it."
    ),
    click.option("--exclude", multiple=True, metavar="GLOB", help="Names to leave out."),
)


def _policy_options(
    usual: PolicySettings | TilePolicySettings,
    outcome: str,
    unit: str,
    network: str = "--extrapolator",
) -> options.Decorator[Any]:
    """Return the options of all trainings of a policy, but for the data."""
    return options.combined(
        click.option(
            "--tables", type=FILE, help="Use these; default: those that come with ExWarp."
        ),
        click.option("-o", "--output", type=FILE, required=True, help=f"For the {outcome}."),
        click.option(network, type=FILE, metavar="FILE", help="ONNX network for --data."),
        click.option("--steps", type=click.IntRange(1), default=usual.steps),
        click.option("--batch", type=click.IntRange(1), default=usual.batch, help=f"In {unit}."),
        click.option("--rate", type=float, default=usual.rate, help="Of learning."),
        click.option("--seed", type=click.IntRange(0), default=usual.seed),
    )


@command.command("extrapolator", context_settings={"show_default": True})
@_scene_options
@click.option("--architecture", default=DEFAULTS.architecture, metavar="NAME")
@click.option("--width", type=click.IntRange(4), help="Channels at half resolution.")
@click.option("--steps", type=click.IntRange(1), default=DEFAULTS.steps)
@click.option("--batch", type=click.IntRange(1), default=DEFAULTS.batch, help="In crops.")
@click.option("--patch", type=click.IntRange(16), default=DEFAULTS.patch, help="Of a crop.")
@click.option("--rate", type=float, default=DEFAULTS.rate, help="Of learning.")
@click.option("--frames", type=click.IntRange(1), default=DEFAULTS.frames, help="Of a scene.")
@click.option("--side", type=click.IntRange(16), default=DEFAULTS.side, help="Of a crop.")
@click.option("--seed", type=click.IntRange(0), default=DEFAULTS.seed)
@click.option(
    "--start",
    type=FILE,
    metavar="FILE",
    help="Checkpoint to begin with, whose network may be smaller, or model.",
)
@click.option("--every", type=click.IntRange(1), default=500, help="Checkpoint.")
@click.option("--cache", type=FILE, help="For crops; default: in the data folder's parent.")
@options.threads_option
@options.json_option
def extrapolator(**values: Any) -> None:
    """Train the network that extrapolates, on a GPU where there is one.

    Stopped at any time, the same command goes on from the last checkpoint. The output folder gets
    checkpoint.pt, curve.csv (validation on scenes held out), settings.json and extrapolator.onnx.
    """
    require_train()
    from exwarp_cli.research.training.extrapolator_training import ExtrapolatorTraining

    use = "--extrapolator"
    _train_network("extrapolator", ExtrapolatorTraining.train, ExtrapolatorSettings, use, **values)


@command.command("lookahead", context_settings={"show_default": True})
@_scene_options
@click.option("--width", type=click.IntRange(4), default=AHEAD.width, help="Channels.")
@click.option("--steps", type=click.IntRange(1), default=AHEAD.steps)
@click.option("--batch", type=click.IntRange(2), default=AHEAD.batch, help="In patches.")
@click.option("--rate", type=float, default=AHEAD.rate, help="Of learning.")
@click.option("--seed", type=click.IntRange(0), default=AHEAD.seed)
@click.option("--start", type=FILE, metavar="FILE", help="Checkpoint to begin with.")
@click.option("--every", type=click.IntRange(1), default=1000, help="Checkpoint.")
@click.option("--cache", type=FILE, help="For samples; default: in the data folder's parent.")
@options.threads_option
@options.json_option
def lookahead(**values: Any) -> None:
    """Train the network that weighs both key frames.

    Stopped at any time, the same command goes on from the last checkpoint. The output folder gets
    checkpoint.pt, curve.csv (validation on scenes held out), settings.json and lookahead.onnx.
    """
    require_train()
    from exwarp_cli.research.training.lookahead_training import LookAheadTraining

    use = "--method lookahead --interpolator"
    _train_network("lookahead", LookAheadTraining.train, LookAheadSettings, use, **values)


def _train_network(
    kind: str,
    train: Callable[..., Path],
    settings: type[ExtrapolatorSettings] | type[LookAheadSettings],
    use: str,
    *,
    data: Path,
    output: Path,
    scenes: tuple[str, ...],
    exclude: tuple[str, ...],
    every: int,
    cache: Path | None,
    threads: int | None,
    start: Path | None,
    as_json: bool,
    **values: Any,
) -> None:
    """Train a network of a kind, and say by which options of upsample it is used."""
    from exwarp_cli.io.dataset import select_scenes
    from exwarp_cli.research.training.resumable_training import CURVE, last_row

    chosen = select_scenes(data, scenes, exclude, _say)
    crops = cache or data.resolve().parent / "crops"
    model = train(chosen, output, crops, settings(**values), every, threads, _say, start)
    scores, advice = last_row(output / CURVE), f"{model}: give it to exwarp upsample {use}"
    _print_outcome(kind, output, model, scores, advice, as_json)


@command.command("policy", context_settings={"show_default": True})
@click.option(
    "--data",
    type=FILE,
    multiple=True,
    help="Folder of rendered scenes to measure; several for several sizes.",
)
@_policy_options(PolicySettings(), "models and scores", "states")
@click.option("--cache", type=FILE, help="For --data; default: in the data folder's parent.")
@click.option("--jobs", type=click.IntRange(1), help="Scenes at a time; default: all cores.")
@options.json_option
def policy(
    data: tuple[Path, ...],
    tables: Path | None,
    output: Path,
    extrapolator: Path | None,
    cache: Path | None,
    jobs: int | None,
    as_json: bool,
    **values: Any,
) -> None:
    """Train the policy that chooses between warping and extrapolation.

    With --data, both choices of every decision are tried on the benchmark scenes first, and kept
    as tables in the output folder. Each scene is left out of one training and judged by it.
    """
    from exwarp_cli.models.policy_files import SHIPPED_POLICY

    require_train()
    from exwarp_cli.research.training.outcome_tables import find_tables
    from exwarp_cli.research.training.policy_training import policy_card, train_policy

    settings = PolicySettings(**values)
    require_sane_policy(settings)
    scenes = find_tables(data, tables, output, _say, extrapolator, cache, jobs)
    scores = train_policy(scenes, output, settings, _say)
    _print_outcome("policy", output, output / SHIPPED_POLICY, scores, policy_card(scores), as_json)


@command.command("tile-policy", context_settings={"show_default": True})
@click.option("--data", type=FILE, help="Folder of rendered scenes to measure.")
@_policy_options(TilePolicySettings(), "model and scores", "tiles")
@options.json_option
def tile_policy(extrapolator: Path | None, **values: Any) -> None:
    """Train the policy that chooses tile by tile between warping and extrapolation.

    With --data, every maker's frames of the benchmark scenes are measured first, and kept as tables
    in the output folder. Each scene is left out of one training and judged by it.
    """
    require_train()
    from exwarp_cli.research.training.tile_policy_training import TileTable, train_tile_policy

    _train_tile_policy("tile-policy", TileTable, train_tile_policy, extrapolator, **values)


@command.command("look-ahead-policy", context_settings={"show_default": True})
@click.option("--data", type=FILE, help="Folder of rendered scenes to measure.")
@_policy_options(TilePolicySettings(), "model and scores", "tiles", "--interpolator")
@options.json_option
def look_ahead_policy(interpolator: Path | None, **values: Any) -> None:
    """Find where the look-ahead network pays, tile by tile between key frames.

    A rule is compared with a learned policy, left out on each scene in turn. With --data, frames of
    the benchmark scenes are measured first, and kept as tables in the output folder.
    """
    require_train()
    from exwarp_cli.research.training.look_ahead_policy import (
        LookAheadTable,
        train_look_ahead_policy,
    )

    kind, train = "look-ahead-policy", train_look_ahead_policy
    _train_tile_policy(kind, LookAheadTable, train, interpolator, **values)


def _train_tile_policy(
    kind: str,
    table: Any,
    train: Callable[..., dict[str, Any]],
    network: Path | None,
    *,
    data: Path | None,
    tables: Path | None,
    output: Path,
    as_json: bool,
    **values: Any,
) -> None:
    """Train a policy of tiles, of which `table` has the measurements."""
    from exwarp_cli.research.training.tile_policy_training import find_tile_tables, gain_card

    settings = TilePolicySettings(**values)
    require_sane_policy(settings)
    found = find_tile_tables(table, data, network, tables, output, _say)
    scores = train(found, output, settings, _say)
    _print_outcome(kind, output, output / table.policy, scores, gain_card(scores), as_json)


def _print_outcome(
    kind: str, folder: Path, model: Path, scores: dict[str, Any], text: str, as_json: bool
) -> None:
    """Print what a training came to: `text` for people, or as JSON where things are."""
    if as_json:
        options.print_json(
            {
                "schema": "exwarp.training/1",
                "kind": kind,
                "folder": str(folder),
                "model": str(model),
                "scores": scores,
            }
        )
        return
    with options.summary_of_files():
        for line in text.split("\n"):
            options.show(line)


def _say(line: str) -> None:
    click.echo(one_line(line), err=True)
