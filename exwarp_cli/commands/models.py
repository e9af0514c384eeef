"""``exwarp models``: networks for ``exwarp upsample``, which others made."""

from __future__ import annotations

from pathlib import Path

import click

from exwarp_cli.commands.options import FILE, json_option, print_json, show

# Of what --json prints; `kind` is the option of exwarp upsample that takes the model.
SCHEMA = "exwarp.model/1"


@click.group("models", subcommand_metavar="[COMMAND] [ARGS]...")
def command() -> None:
    """Make networks of others fit for exwarp upsample."""


@command.command("import-extranet", short_help="Take over ExtraNet's released network.")
@click.argument("checkpoint", type=FILE)
@click.argument("model", metavar="OUT.onnx", type=FILE)
@click.option("--overwrite", is_flag=True, help="Replace OUT.onnx if it exists.")
@json_option
def import_extranet(checkpoint: Path, model: Path, overwrite: bool, as_json: bool) -> None:
    """Turn the CHECKPOINT of ExtraNet's public release (medieval.pth.tar) into a model.

    Inputs are translated as far as they can be. ExtraNet divides by the base colour where ExWarp
    divides by diffuse and glossy colour together, knows frames of one engine only, and wants
    G-buffers with normals; slot 3 lies further ahead than what it was trained on.
    """
    from exwarp_cli.research.training.training_settings import require_train

    require_train()
    from exwarp_cli.research.training import extranet_import

    extranet_import.import_extranet(checkpoint, model, overwrite=overwrite)
    if as_json:
        print_json({"schema": SCHEMA, "kind": "extrapolator", "model": str(model)})
    else:
        show(f"{model}: give it to exwarp upsample --extrapolator")


@command.command("interpolator-card", short_help="Write the card of an interpolation network.")
@click.argument("model", metavar="FILE.onnx", type=FILE)
@click.option(
    "--shape",
    type=click.Choice(["rife", "ema-vfi", "film"]),
    required=True,
    help="Whose export it resembles.",
)
@click.option("--overwrite", is_flag=True, help="Replace the card if it exists.")
@json_option
def interpolator_card(model: Path, shape: str, overwrite: bool, as_json: bool) -> None:
    """Write FILE.json, which tells exwarp upsample --interpolator what FILE.onnx takes.

    Names of inputs and output come from the network; layout and padding from the shape. Look it
    over: value range, order of the channels and padding cannot be seen in a network.
    """
    from exwarp_cli.models.interpolator import begin_card

    card = begin_card(model, shape, overwrite=overwrite)
    if as_json:
        print_json(
            {"schema": SCHEMA, "kind": "interpolator", "model": str(model), "card": str(card)}
        )
    else:
        show(f"{card}: look it over, then give {model} to exwarp upsample --interpolator")
