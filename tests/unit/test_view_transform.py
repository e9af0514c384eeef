"""View transforms show what OpenColorIO shows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from exwarp_cli.errors import InstallationError, UsageError
from exwarp_cli.io import view_transform
from exwarp_cli.io.display_colour import to_display, to_display_16
from exwarp_cli.io.view_transform import BUILT_IN, SOURCE_SPACE, find_view_transform

COLOURS = np.array(
    [[[0.18, 0.18, 0.18], [0.02, 0.3, 0.9], [2, 1, 0.5], [-0.1, 0.2, 60], [0, 0, 0]]], np.float32
)

CONFIG = """ocio_profile_version: 1
roles: {scene_linear: lin_rec709, default: lin_rec709}
displays:
  screen:
    - !<View> {name: half, colorspace: halved}
colorspaces:
  - !<ColorSpace> {name: lin_rec709, isdata: false}
  - !<ColorSpace>
    name: halved
    from_reference: !<MatrixTransform> {matrix: [.5,0,0,0, 0,.5,0,0, 0,0,.5,0, 0,0,0,1]}
"""


def shown(name: str, linear: np.ndarray) -> np.ndarray:
    view = find_view_transform(name)
    assert view is not None
    return view.apply(linear)


def codes_by_ocio(config: str, display: str, view: str) -> np.ndarray:
    source = oiio.ImageBuf(COLOURS)
    out = oiio.ImageBufAlgo.ociodisplay(source, display, view, SOURCE_SPACE, colorconfig=config)
    assert not out.has_error, out.geterror()
    return out.get_pixels(oiio.FLOAT).clip(0, 1)


def own_config(folder: Path) -> Path:
    path = folder / "a:b.ocio"
    path.write_text(CONFIG)
    return path


def test_srgb_is_none():
    assert find_view_transform("srgb") is None


@pytest.mark.parametrize("name", BUILT_IN)
def test_codes_are_those_of_opencolorio(name):
    expected = codes_by_ocio(*BUILT_IN[name])
    light = shown(name, COLOURS)
    assert light.dtype == np.float32 and light.min() >= 0 and light.max() <= 1
    assert np.abs(to_display(light) - 255 * expected).max() <= 0.501
    assert np.abs(to_display_16(light) - 65535 * expected).max() <= 0.6


@pytest.mark.parametrize("name", BUILT_IN)
def test_a_tone_scale_keeps_highlights_apart_and_is_neutral(name):
    grey = np.geomspace(0.01, 8, 20, dtype=np.float32)[None, :, None].repeat(3, axis=2)
    light = shown(name, grey)
    assert (np.diff(light[0, :, 1]) > 0).all()
    assert np.abs(light - light[..., :1]).max() < 2e-3


def test_the_un_tone_mapped_view_is_the_srgb_curve():
    name = "ocio://cg-config-v1.0.0_aces-v1.3_ocio-v2.1:sRGB - Display:Un-tone-mapped"
    inside = COLOURS.clip(0, 1)
    assert np.abs(to_display(shown(name, inside)).astype(int) - to_display(inside)).max() <= 1


@pytest.mark.parametrize("name", BUILT_IN)
def test_values_that_are_not_finite_count_as_dark_or_bright(name):
    broken = np.array([[[np.nan] * 3, [np.inf] * 3, [-np.inf] * 3, [3e38] * 3]], np.float32)
    light = shown(name, broken)[0, :, 0]
    assert light[0] == light[2] < 0.01 and light[1] == light[3] > 0.9


def test_alpha_is_dropped_and_the_input_kept():
    pixels = np.full((2, 3, 4), np.nan, np.float32)
    assert shown("aces1", pixels).shape == (2, 3, 3)
    assert np.isnan(pixels).all()


def test_a_configuration_of_ones_own(tmp_path):
    light = shown(f"{own_config(tmp_path)}:screen:half", np.full((1, 1, 3), 0.5, np.float32))
    assert to_display_16(light)[0, 0, 0] == pytest.approx(0.25 * 65535, abs=1)


@pytest.mark.parametrize("name", ["filmic", "", "aces", "a:b", "config.ocio:screen:half"])
def test_bad_names(name):
    with pytest.raises(UsageError, match="is not one of srgb, aces1, aces2, and not CONFIG:"):
        find_view_transform(name)


@pytest.mark.parametrize("rest", ["screen:third", "wall:half"])
def test_displays_and_views_that_a_configuration_lacks(tmp_path, rest):
    with pytest.raises(UsageError, match=r"as OpenImageIO says .*; correct the configuration"):
        find_view_transform(f"{own_config(tmp_path)}:{rest}")


@pytest.mark.parametrize("config", ["/no/such.ocio", "ocio://no-such-config"])
def test_configurations_that_are_not_there(config):
    with pytest.raises(UsageError, match="such"):
        find_view_transform(f"{config}:screen:half")


def test_an_installation_without_the_configuration(monkeypatch):
    monkeypatch.setitem(view_transform.BUILT_IN, "aces2", ("ocio://aces-v9", "a", "b"))
    with pytest.raises(InstallationError, match="install a newer OpenImageIO, or use srgb"):
        find_view_transform("aces2")
