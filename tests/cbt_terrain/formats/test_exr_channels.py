# SPDX-License-Identifier: GPL-3.0-or-later
"""Choice of the channel of an OpenEXR file that holds the height."""

import numpy as np
import OpenEXR
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.formats.exr_channels import ExrChannel, likeliest
from rasters import hills, imported, write_exr

SIZE = {"extent": (3900.0, 2900.0)}


def choice(*names):
    """Name of the likeliest of channels in one part; PART:CHANNEL for several parts."""
    parts = list(dict.fromkeys(name.partition(":")[0] if ":" in name else "" for name in names))
    channels = [ExrChannel(parts.index(p), p, c) for p, c in (n.split(":") if ":" in n else ("", n) for n in names)]
    return likeliest(channels, channels).full_name


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["A", "height.Z"], "height.Z"),
        (["mask", "terrain"], "terrain"),
        (["A", "B", "G", "R"], "R"),
        (["A", "B", "G", "R", "Z"], "Z"),
        (["B", "G", "R", "Y"], "Y"),
        (["height", "Y", "Z"], "height"),
        (["DEM", "Z"], "DEM"),
        (["demo.R", "elevation"], "elevation"),
        (["displacement.x", "displacement.y", "displacement.z"], "displacement.z"),
        (["N.X", "N.Y", "N.Z", "depth.V"], "depth.V"),
        (["height_mask", "slope", "Y"], "Y"),
        (
            [f"ViewLayer.{n}" for n in ("Combined.A", "Combined.R", "Depth.Z", "Normal.X", "Normal.Y", "Normal.Z")],
            "ViewLayer.Depth.Z",
        ),
        (["Layer.Position.X", "Layer.Position.Y", "Layer.Position.Z", "Layer.Combined.R"], "Layer.Combined.R"),
        (["color:B", "color:G", "color:R", "height:Y"], "height.Y"),
        (["rgba:A", "rgba:R", "depth:Z"], "depth.Z"),
        (["a.depth:a.depth.Z", "a.rgb:a.rgb.R"], "a.depth.Z"),
        (["bar", "foo"], "bar"),
    ],
)
def test_height_and_depth_names_are_preferred(names, expected):
    assert choice(*names) == expected
    assert choice(*names[::-1]) == ("foo" if expected == "bar" else expected)


def write_parts(path, **parts):
    """Write a file with parts of one channel each, by PART=(channel, pixels)."""
    head = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}
    OpenEXR.File([OpenEXR.Part(head | {"name": part}, {c: v}) for part, (c, v) in parts.items()]).write(str(path))
    return path


@pytest.mark.parametrize(
    ("channel", "taken"),
    [("", 1), ("height.Y", 1), ("height", 1), ("Y", 1), ("color.R", 0), ("COLOR.r", 0), ("R", 0), ("color", 0)],
)
def test_parts_and_channels_are_named(tmp_path, channel, taken):
    pixels = hills(), hills() + 1000.0
    source = write_parts(tmp_path / "a.exr", color=("R", pixels[0]), height=("Y", pixels[1]))
    field, report = imported(tmp_path, source, channel=channel, **SIZE)
    assert np.array_equal(field.heights(), pixels[taken][::-1])
    assert report["format"] == f"OpenEXR channel {('color.R', 'height.Y')[taken]}"
    assert len(report["warnings"]) == (0 if channel else 1)
    assert channel or "2 channels; height.Y is taken as the height" in report["warnings"][0]


def test_layers_are_named_and_unknown_ones_listed(tmp_path):
    source = write_exr(tmp_path / "a.exr", **{"A": hills(), "ground.V": hills() + 1000.0})
    for name in ("ground.V", "ground", "GROUND.v"):
        assert imported(tmp_path, source, channel=name, **SIZE)[0].min_height > 1000.0
    with pytest.raises(TerrainError, match="no channel 'rock.V': choose one of A, ground.V"):
        imported(tmp_path, source, channel="rock.V")


def test_a_name_that_several_parts_share_warns(tmp_path):
    pixels = hills(), hills() + 1000.0
    source = write_parts(tmp_path / "a.exr", first=("Y", pixels[0]), second=("Y", pixels[1]))
    for name in ("Y", "y"):
        field, report = imported(tmp_path, source, channel=name, **SIZE)
        [warning] = report["warnings"]
        assert "first.Y is taken" in warning and "second.Y" in warning and "--channel" in warning
        assert np.array_equal(field.heights(), pixels[0][::-1])
    field, report = imported(tmp_path, source, channel="second.Y", **SIZE)
    assert np.array_equal(field.heights(), pixels[1][::-1]) and report["warnings"] == []


def test_the_name_of_a_layer_takes_its_likeliest_channel(tmp_path):
    source = write_exr(tmp_path / "a.exr", **{"p.X": hills(), "p.Y": hills(), "p.Z": hills() + 1000.0})
    field, report = imported(tmp_path, source, channel="p", **SIZE)
    assert field.min_height > 1000.0 and report["warnings"] == []
