"""ExtraNet as it was released, and its checkpoint as a model behind ExWarp's interface.

Guo, Fu, Lin, Ma, Guo, Liu, Yan: ExtraNet: Real-time Extrapolated Rendering for Low-latency Temporal
Supersampling, ACM Transactions on Graphics 40 (6), 2021; https://github.com/fuxihao66/ExtraNet.

What is known, and from where:

- Layers, kernels and channels follow from the names and shapes of the checkpoint's 195 tensors,
  among them the gates, which have a single channel that is shared by all features.
- What shapes cannot tell comes from the release's scripts: each history block halves the size in
  its first convolution, and so does the gated convolution that opens each step down; on the way
  up the skip stands before the upsampled features, at the bottom the picture's features before
  those of the history; upsampling is bilinear with aligned corners; ReLU follows every batch
  normalisation, and a sigmoid every gate.
- Inferred: nothing that changes a value. The release pads where sizes do not match on the way up;
  multiples of `STRIDE`, which are asked for here, always match.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional

from exwarp_cli.domain.network_api import EXTRAPOLATOR_INTERFACE, HISTORY_FRAMES
from exwarp_cli.errors import DamagedFileError, LayoutError, OutputExistsError, UsageError
from exwarp_cli.io.files import make_folder
from exwarp_cli.research.training.onnx_export import export_network
from exwarp_cli.research.training.resumable_training import read_tensors

# Height and width must be multiples of this: the network halves them three times.
STRIDE = 8

# Channels of the two pictures, of the features, and of one frame of the history.
PICTURES = 6
FEATURES = 6
PAST = 4

# Before every name where the network was trained on several devices.
DATA_PARALLEL = "module."


class ReleasedGate(nn.Module):
    """A 3x3 convolution whose features are weighted by a single learned mask."""

    def __init__(self, inputs: int, outputs: int, step: int = 1) -> None:
        super().__init__()
        self.conv_feature = nn.Conv2d(inputs, outputs, 3, step, padding=1)
        self.conv_mask = nn.Sequential(nn.Conv2d(inputs, 1, 3, step, padding=1), nn.Sigmoid())

    def forward(self, x: Tensor) -> Tensor:
        """Map [N, inputs, H, W] to [N, outputs, H / step, W / step]."""
        gated: Tensor = self.conv_feature(x) * self.conv_mask(x)
        return gated


class StepDown(nn.Module):
    """Half the size, then two gated convolutions."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.downsample = ReleasedGate(inputs, inputs, step=2)
        self.conv1 = ReleasedGate(inputs, outputs)
        self.bn1 = nn.BatchNorm2d(outputs)
        self.conv2 = ReleasedGate(outputs, outputs)
        self.bn2 = nn.BatchNorm2d(outputs)

    def forward(self, x: Tensor) -> Tensor:
        """Map [N, inputs, H, W] to [N, outputs, H / 2, W / 2]."""
        x = torch.relu(self.bn1(self.conv1(self.downsample(x))))
        return torch.relu(self.bn2(self.conv2(x)))


class StepUp(nn.Module):
    """Twice the size, then two convolutions beside what had that size on the way down."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        middle = inputs // 2
        layers = (*_convolution(inputs, middle), *_convolution(middle, outputs))
        self.conv = nn.ModuleDict({"double_conv": nn.Sequential(*layers)})

    def forward(self, x: Tensor, skip: Tensor) -> Tensor:
        """Map [N, C, H / 2, W / 2] and a skip [N, inputs - C, H, W] to [N, outputs, H, W]."""
        x = functional.interpolate(x, scale_factor=2, mode="bilinear", align_corners=True)
        out: Tensor = self.conv["double_conv"](torch.cat([skip, x], dim=1))
        return out


class ExtraNet(nn.Module):
    """The released network; a state dict of its checkpoint fits strictly.

    A gated U-Net over three scales sees the pictures and the features of the slot; an encoder with
    shared weights looks at each frame of the history, and joins at the bottom. The answer is added
    to the first picture.
    """

    def __init__(self) -> None:
        super().__init__()
        self.convHis1 = _history_block(PAST, 24)
        self.convHis2 = _history_block(24, 32)
        self.convHis3 = _history_block(32, 32)
        self.lowlevelGated = ReleasedGate(32 * HISTORY_FRAMES, 32)
        self.conv1 = ReleasedGate(2 * PICTURES + FEATURES, 24)
        self.bn1 = nn.BatchNorm2d(24)
        self.conv2 = ReleasedGate(24, 24)
        self.bn2 = nn.BatchNorm2d(24)
        self.down1 = StepDown(24, 24)
        self.down2 = StepDown(24, 32)
        self.down3 = StepDown(32, 32)
        self.up1 = StepUp(32 + 32 + 32, 32)
        self.up2 = StepUp(32 + 24, 24)
        self.up3 = StepUp(24 + 24, 24)
        self.outc = nn.Conv2d(24, 3, kernel_size=1)

    def forward(
        self,
        # [N, 6, H, W]: the warped frame with whatever lies at the end of its motion, then the same
        # with other motion in holes; H and W are multiples of `STRIDE`
        pictures: Tensor,
        mask: Tensor,  # [N, 1, H, W], 0 in holes; the release repeats it over six channels
        features: Tensor,  # [N, 6, H, W]: normal, depth, roughness, metallic
        history: Sequence[Tensor],  # three warped frames with masks, [N, 4, H, W], oldest first
    ) -> Tensor:
        """Return the slot's colour, [N, 3, H, W], as log(1 + x) like the pictures."""
        x = torch.cat([pictures, pictures * mask, features], dim=1)
        x = torch.relu(self.bn1(self.conv1(x)))
        full = torch.relu(self.bn2(self.conv2(x)))
        half = self.down1(full)
        quarter = self.down2(half)
        encoded = self.convHis3(self.convHis2(self.convHis1(torch.cat(list(history)))))
        motion = self.lowlevelGated(torch.cat(encoded.chunk(HISTORY_FRAMES), dim=1))
        eighth = torch.cat([self.down3(quarter), motion], dim=1)
        x = self.up3(self.up2(self.up1(eighth, quarter), half), full)
        answer: Tensor = self.outc(x) + pictures[:, :3]
        return answer


class ExtraNetAdapter(nn.Module):
    """ExtraNet behind ExWarp's interface (`domain.network_api`).

    Translated exactly:

    - The first picture is the newest frame of the history, as the release wants whatever lies at
      the end of the motion also in holes, which it finds by the mask. The second is the warp with
      filled holes.
    - The history is turned oldest first. At slot 2 its frames are 1/2, 3/2 and 5/2 key intervals
      old, in the proportions 1 : 3 : 5 of the training.
    - Depth d / (d + median) is turned back into distance and scaled to 0 to 1 over the frame,
      background at 0. (So does the script that the checkpoint comes with; its training code scales
      before it removes the background.)
    - Background normals are (-1, -1, -1), where ours are 0.
    - Colour is log(1 + x) of what is 0 or more, going in and coming out.

    Not translated, as nothing is there to translate:

    - Lighting was trained as colour / base colour, 0 where that is black; ours is divided by
      diffuse and glossy colour together, and by `modulation.DARKEST` at least.
    - Depths above 100 of the engine's units were background as well.
    - The release paints the sky itself after the network, which saw black there.
    - Slot 3 is further from the key frames than anything that it was trained on.
    - It was trained on frames of one engine; a frame without normals looks like sky to it.
    """

    def __init__(self, network: ExtraNet) -> None:
        super().__init__()
        self.network = network

    def forward(self, warped: Tensor, mask: Tensor, features: Tensor, history: Tensor) -> Tensor:
        """Return the slot's colour, [N, 3, H, W]; inputs [N, C, H, W] as in `domain.network_api`.

        H and W are multiples of `STRIDE`.
        """
        newest_first = torch.relu(history).chunk(HISTORY_FRAMES, dim=1)
        pictures = torch.cat([newest_first[0][:, :3], torch.relu(warped[:, 3:])], dim=1)
        normal, depth, material = features[:, :3], features[:, 3:4], features[:, 4:]
        is_background = (normal == 0).all(dim=1, keepdim=True)
        normal = torch.where(is_background, torch.full_like(normal, -1), normal)
        is_finite = depth < 1
        distance = torch.where(is_finite, depth, 0) / torch.where(is_finite, 1 - depth, 1)
        nearest = distance.amin(dim=(2, 3), keepdim=True)
        furthest = distance.amax(dim=(2, 3), keepdim=True)
        distance = (distance - nearest) / (furthest - nearest + 1e-6)
        translated = torch.cat([normal, distance, material], dim=1)
        return torch.relu(self.network(pictures, mask, translated, newest_first[::-1]))


def _convolution(inputs: int, outputs: int, step: int = 1) -> list[nn.Module]:
    return [nn.Conv2d(inputs, outputs, 3, step, padding=1), nn.BatchNorm2d(outputs), nn.ReLU()]


def _history_block(inputs: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(
        *_convolution(inputs, outputs, step=2),
        *_convolution(outputs, outputs),
        *_convolution(outputs, outputs),
    )


def import_extranet(checkpoint: Path, model: Path, *, overwrite: bool) -> None:
    """Turn a checkpoint of the release into a model for ``exwarp upsample --extrapolator``.

    Raises InputError when the checkpoint cannot be used, and OutputExistsError or OutputError when
    the model is there, or cannot be written.
    """
    if model.exists():
        if not overwrite:
            raise OutputExistsError(f"{model} exists; choose another name, or add --overwrite")
        if checkpoint.exists() and model.samefile(checkpoint):
            raise UsageError(f"{model} is the checkpoint itself; choose another name for the model")
    network = read_extranet(checkpoint)
    make_folder(model.parent)
    about = f"ExtraNet (Guo et al. 2021), imported from {checkpoint.name}"
    export_network(
        ExtraNetAdapter(network), model, EXTRAPOLATOR_INTERFACE, stride=STRIDE, about=about
    )


def read_extranet(path: Path) -> ExtraNet:
    """Read a network from a checkpoint: a dict with ``state_dict``, or that alone.

    Only tensors are read, nothing that could run code. Raises InputError when there is no such
    file, DamagedFileError when it is no checkpoint, and LayoutError when its tensors are not
    ExtraNet's.
    """
    damaged = DamagedFileError(
        f"{path} is damaged, is no PyTorch checkpoint, or holds more than tensors, which is "
        "not read because it could run code; give the file of ExtraNet's release"
    )
    content = read_tensors(path, "cpu", damaged)
    state = content.get("state_dict", content) if isinstance(content, dict) else None
    if not isinstance(state, dict):
        raise LayoutError(f"{path} holds no state dict; give the file of ExtraNet's release")
    tensors = {
        str(name).removeprefix(DATA_PARALLEL): tensor
        for name, tensor in state.items()
        if isinstance(tensor, Tensor)
    }
    network = ExtraNet()
    wanted = network.state_dict()
    shared = [name for name in wanted if name in tensors]
    faults = (
        ("lacks", [name for name in wanted if name not in tensors]),
        ("has a tensor that ExtraNet has not:", [name for name in tensors if name not in wanted]),
        ("has another shape of", [n for n in shared if tensors[n].shape != wanted[n].shape]),
        (
            "has values that are not finite in",
            [name for name in shared if not torch.isfinite(tensors[name]).all()],
        ),
    )
    for fault, names in faults:
        if names:
            more = f" and {len(names) - 1} more" if names[1:] else ""
            raise LayoutError(
                f"{path} {fault} {names[0]}{more}; give the file of ExtraNet's release"
            )
    network.load_state_dict(tensors)
    return network.eval()
