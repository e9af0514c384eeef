"""``exwarp models``: networks for ``exwarp upsample --extrapolator``."""

from __future__ import annotations

from pathlib import Path

import click

from exwarp_cli.commands.group import HelpfulGroup

FILE = click.Path(path_type=Path)


@click.group("models", cls=HelpfulGroup)
def command() -> None:
    """Make models for exwarp upsample --extrapolator."""


@command.command("import-extranet", short_help="Take over ExtraNet's released network.")
@click.argument("checkpoint", type=FILE)
@click.argument("model", metavar="OUT.onnx", type=FILE)
@click.option("--overwrite", is_flag=True, help="Replace OUT.onnx if it exists.")
def import_extranet(checkpoint: Path, model: Path, overwrite: bool) -> None:
    """Turn the CHECKPOINT of ExtraNet's public release (medieval.pth.tar) into a model.

    Inputs are translated as far as they can be. ExtraNet divides by the base colour where ExWarp
    divides by diffuse and glossy colour together, knows frames of one engine only, and wants
    G-buffers with normals; slot 3 lies further ahead than what it was trained on.
    """
    from exwarp_cli.training.extra import require_train

    require_train()
    from exwarp_cli.training import checkpoint as release

    release.import_extranet(checkpoint, model, overwrite=overwrite)
    click.echo(f"{model}: give it to exwarp upsample --extrapolator")
