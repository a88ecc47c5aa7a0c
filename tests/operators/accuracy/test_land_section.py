# SPDX-License-Identifier: GPL-3.0-or-later
"""The report of accuracy says what each level of shaped land has cost and changed."""

import numpy as np
from accuracy_rows import known_rows
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.height_operators.shape_store import run_shape
from adaptive_terrain.cbt_terrain.height_operators.stack import Entry, Stack
from adaptive_terrain.operators.accuracy.land_section import HEAD, land_section
from adaptive_terrain.operators.accuracy.page import table_blocks
from adaptive_terrain.operators.accuracy.subject import AccuracySubject
from adaptive_terrain.operators.text.page_blocks import Heading, Table
from rasters import hills, imported


def test_every_level_of_every_operator_has_its_line(tmp_path):
    np.save(tmp_path / "hills.npy", hills(700, 520))
    source, _ = imported(tmp_path, tmp_path / "hills.npy", extent=(6990.0, 5190.0))
    stack = Stack((Entry("relief"), Entry("scree", on=False), Entry("relief", seed=2)))
    run_shape(source.path, stack, tmp_path / "shaped")
    heading, text, table = land_section(open_store(tmp_path / "shaped"), " of hills")
    assert heading.text == "What finer land of hills costs and changes" and table.head == HEAD
    assert [line[:2] for line in table.rows] == [["Fine Relief", step] for _ in range(2) for step in ("10", "20", "40")]
    before, after = (field.heights().astype(np.float64) for field in (source, open_store(tmp_path / "shaped")))
    assert abs(after - before).max() <= sum(float(line[3]) for line in table.rows) * 1.01
    finest = max((line for line in table.rows if line[1] == "10"), key=lambda line: float(line[2]))
    assert "Without the finest level, 10 m," in text.text and f"off by {float(finest[2]):.2g} m rms" in text.text


def test_land_that_nothing_has_shaped_has_no_such_part():
    field = from_array(np.zeros((5, 5), np.float32))
    blocks = table_blocks(AccuracySubject("x", field, [], [], "", None, rows=known_rows()), "")
    assert not any(isinstance(block, Heading) and "land" in block.text for block in blocks)
    assert not any(isinstance(block, Table) and block.head == HEAD for block in blocks)
