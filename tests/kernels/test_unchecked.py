# SPDX-License-Identifier: GPL-3.0-or-later
"""The snippets of kernels/unchecked.py against the same kernels in Warp alone: the same bytes."""

from pathlib import Path

import numpy as np
import pytest
import warp as wp
from adaptive_terrain import kernels
from adaptive_terrain.cbt_terrain.mesh import builder, displacement, meshlet_template, welding
from adaptive_terrain.cbt_terrain.run import launch
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import View
from fields import rough
from invariants import arrays
from twins import load

KERNELS = Path(kernels.__file__).parent / "mesh"
VIEW = View.look((0.0, -400.0, 120.0), (0, 0, 0))


@pytest.fixture
def in_warp_alone(tmp_path, monkeypatch):
    """Replace kernels/unchecked.py by tests/kernels/checked.py in the kernels of the surface."""
    load("checked", Path(__file__).with_name("checked.py"))
    twins = {}
    users = {"weld": [welding], "displace": [displacement], "meshlet": [builder, displacement]}
    for name, modules in users.items():
        source = (KERNELS / f"{name}.py").read_text()
        assert source.count("from ..unchecked import ") == 1
        path = tmp_path / f"{name}_checked.py"
        path.write_text(source.replace("from ..unchecked import ", "from ..checked import "))
        twins[name] = load(f"mesh.{path.stem}", path)
        for module in modules:
            monkeypatch.setattr(module, f"{name}_kernels", twins[name])
    monkeypatch.setattr(meshlet_template, "Template", twins["meshlet"].Template)
    meshlet_template.template.cache_clear()
    yield
    meshlet_template.template.cache_clear()


def updates() -> list[dict[str, bytes]]:
    """Return surfaces that use every snippet: several squares and slices, points on and between samples, meshlets."""
    found = []
    for shape, criterion in (
        ((33, 97), Criterion(error_px=0.6, max_depth=16)),
        ((65, 65), Criterion(error_px=0.0, edge_px=16.0)),
        ((33, 65), Criterion(error_px=1.0, meshlet=1)),
        ((65, 65), Criterion(error_px=2.0, meshlet=3)),
    ):
        terrain = Terrain(rough(*shape), 3)
        terrain.update(Criterion(error_px=3.0, meshlet=criterion.meshlet), [VIEW])  # so that there is something to cut
        found.append(arrays(terrain.update(criterion, [VIEW]).surface))
    return found


def walked(module) -> list[bytes]:
    """Run tests/kernels/walk_snippets.py compiled as `module`; return its output arrays as bytes."""
    count, rng = 37, np.random.default_rng(3)
    made = []
    for dtype, scalar, columns in (
        (wp.uint16, np.uint16, ()),
        (wp.int32, np.int32, ()),
        (wp.int64, np.int64, ()),
        (wp.float32, np.float32, ()),
        (wp.vec2i, np.int32, (2,)),
        (wp.vec4i, np.int32, (4,)),
    ):
        values = rng.integers(0, 1000, (6 * count, *columns)).astype(scalar)
        made.append(wp.array(values, dtype=dtype, device="cpu"))
    before = [array.numpy().copy() for array in made]
    launch.once(module.pass_all, [count, *made], step="test")
    assert all((array.numpy()[2 * count :] != old[2 * count :]).any() for array, old in zip(made, before, strict=True))
    return [array.numpy().tobytes() for array in made]


def test_snippets_of_the_walk_write_the_bytes_of_plain_warp(tmp_path):
    load("checked", Path(__file__).with_name("checked.py"))
    source = Path(__file__).with_name("walk_snippets.py")
    text = source.read_text()
    assert text.count("from ..unchecked import ") == 1
    path = tmp_path / "walk_snippets_checked.py"
    path.write_text(text.replace("from ..unchecked import ", "from ..checked import "))
    assert walked(load("refine.walk_snippets", source)) == walked(load(f"refine.{path.stem}", path))


def test_snippets_write_the_bytes_of_plain_warp(request, eager_threads):
    fast = updates()
    request.getfixturevalue("in_warp_alone")
    assert updates() == fast
