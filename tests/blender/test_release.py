# SPDX-License-Identifier: GPL-3.0-or-later
"""The static extension repository of a release, published by a loopback server to the real program."""

import functools
import json
import re
import threading
import zipfile
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer

import pytest
from real_program import Program

REPOSITORY = "terrain_releases"
SHOW = "import bpy, json; print('RESULT ' + json.dumps([list(bpy.context.preferences.addons.keys()), "
SHOW += "hasattr(bpy.types.Object, 'adaptive_terrain')]))"


@pytest.fixture
def publish():
    """Return a function that publishes a folder and returns its address and the list of the requests."""
    servers = []

    def serve(folder) -> tuple[str, list[str]]:
        requests: list[str] = []

        class Handler(SimpleHTTPRequestHandler):
            def log_message(self, _form, request, *_rest):
                requests.append(request.split()[1])

        handler = functools.partial(Handler, directory=str(folder))
        servers.append(ThreadingHTTPServer(("127.0.0.1", 0), handler))
        threading.Thread(target=servers[-1].serve_forever, daemon=True).start()
        return f"http://127.0.0.1:{servers[-1].server_port}", requests

    yield serve
    for server in servers:
        server.shutdown()
        server.server_close()


def write_zip_of_another_python(source, folder) -> None:
    """Write a zip without wheels whose manifest names those of Python 3.10."""
    with zipfile.ZipFile(source) as archive:
        manifest = re.sub(r"-cp3\d+-cp3\d+-", "-cp310-cp310-", archive.read("blender_manifest.toml").decode())
    with zipfile.ZipFile(folder / "adaptive_terrain-py310.zip", "w") as archive:
        archive.writestr("blender_manifest.toml", manifest)
        archive.writestr("__init__.py", "raise ImportError('of another Python')\n")


@pytest.mark.thorough
def test_blender_installs_the_extension_from_a_repository(release, publish, bare_program, extension_zip, tmp_path):
    program = Program(bare_program.wrapper, tmp_path / "user")
    program.user.mkdir()
    repository = tmp_path / "repository"
    repository.mkdir()
    (repository / extension_zip.name).hardlink_to(extension_zip)
    write_zip_of_another_python(extension_zip, repository)
    entries = release.write_repository(repository, bare_program.command())
    assert [entry["id"] for entry in entries] == ["adaptive_terrain"] * 2
    assert len({tuple(entry["python_versions"]) for entry in entries}) == 2
    address, requests = publish(repository)
    extension = ("--online-mode", "--command", "extension")
    url = f"{address}/index.json"
    program.run(*extension, "repo-add", "--clear-all", "--name", "Terrain", "--url", url, REPOSITORY)
    program.run(*extension, "sync")
    assert "adaptive_terrain" in program.run(*extension, "list")
    program.run(*extension, "install", "--enable", f"{REPOSITORY}.adaptive_terrain")
    said = program.run("-b", "--python-expr", SHOW)
    [result] = [line.removeprefix("RESULT ") for line in said.splitlines() if line.startswith("RESULT ")]
    addons, registered = json.loads(result)
    assert f"bl_ext.{REPOSITORY}.adaptive_terrain" in addons and registered
    assert [request for request in requests if request.endswith(".zip")] == [f"/{extension_zip.name}"]
