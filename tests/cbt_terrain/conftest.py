# SPDX-License-Identifier: GPL-3.0-or-later
"""Children of the engine are forked, but in the tests of processes themselves."""

from pathlib import Path

import pytest
from forked_children import fork, fork_children  # noqa: F401

HERE = Path(__file__).parent
# Tests of the start of children, of their rights, of signals to them and of what they import.
STARTED = "run", "sandbox", "importing/test_importing.py", "test_shared_terrain.py", "tiling"


@pytest.fixture(scope="module", autouse=True)
def children_are_forked(request):
    """Fork the children of a module's tests and fixtures, unless children are its subject."""
    with pytest.MonkeyPatch.context() as patch:
        if not any((HERE / name) in (request.path, *request.path.parents) for name in STARTED):
            fork(patch)
        yield
