# SPDX-License-Identifier: GPL-3.0-or-later
"""The site of docs/: mkdocs builds it without a warning, and a browser finds its pictures."""

import importlib.util
import os
import subprocess
import sys
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import SimpleNamespace

import pytest
from browser import needs_chromium, opened

ROOT = Path(__file__).resolve().parents[1]
OWN = ROOT / ".venv-docs" / "bin" / "python"
PYTHON = OWN if OWN.exists() else Path(sys.executable) if importlib.util.find_spec("mkdocs") else None
needs_mkdocs = pytest.mark.skipif(PYTHON is None, reason="mkdocs is not installed here; `make docs` installs it")


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("site") / "html"
    command = [PYTHON, "-m", "mkdocs", "build", "--quiet", "--strict", "--site-dir", folder]
    quiet = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    result = subprocess.run(command, cwd=ROOT, env=quiet, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    return folder


class QuietHandler(SimpleHTTPRequestHandler):
    def log_message(self, *_arguments) -> None:
        """Write no line for each request."""


@pytest.fixture(scope="module")
def address(site):
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(QuietHandler, directory=site))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()


@needs_mkdocs
@needs_chromium
@pytest.mark.parametrize("name", ["index", "howto/import", "understand/promise", "reference/python-api", "method/mesh"])
def test_a_browser_finds_all_of_a_page(address, name, tmp_path):
    seen = opened(f"{address}/{name}.html", tmp_path / "chromium")
    assert seen.errors == []
    assert [picture for picture, is_there in seen.pictures if picture and not is_there] == []
    assert len(seen.text) > 500 and seen.wide <= 0


@needs_mkdocs
def test_the_site_has_the_hard_cases(site):
    assert "test_case_03_" in (site / "hard_cases.html").read_text(encoding="utf-8")


@needs_mkdocs
def test_the_api_page_has_signatures(site):
    text = (site / "reference" / "python-api.html").read_text(encoding="utf-8")
    assert "vertical_offset" in text and "max_triangles" in text


def test_a_link_to_another_checkout_is_remade(tmp_path, monkeypatch):
    """Checkouts may share `.cache`, and the one that made the link may be gone."""
    if importlib.util.find_spec("markdown") is None:
        for name in ("markdown", "markdown.extensions"):
            monkeypatch.setitem(sys.modules, name, SimpleNamespace(toc=None))
    spec = importlib.util.spec_from_file_location("site_hooks", ROOT / "tools" / "site_hooks.py")
    hooks = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(hooks)
    link, here = tmp_path / "kernels", tmp_path / "here"
    here.mkdir()
    for target in (tmp_path / "gone", here, here):
        hooks.point_link(link, target)
        assert os.readlink(link) == str(target)
    assert link.is_dir() and sorted(path.name for path in tmp_path.iterdir()) == ["here", "kernels"]
