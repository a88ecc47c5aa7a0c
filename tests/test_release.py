# SPDX-License-Identifier: GPL-3.0-or-later
"""What a release promises: one version everywhere, and the licence and holder of everything in its wheels."""

import re
import subprocess
import tomllib
import zipfile
from importlib import metadata
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
MANIFEST = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))
LICENCES = {
    name: licence
    for line in MANIFEST["copyright"]
    for name, licence in re.findall(r"^[0-9]{4}(?:-[0-9]{4})? [^:]+: (\S+), (.+)$", line)
}
# Texts of packages whose metadata does not name the SPDX identifier.
FREE_TEXT = {"BSD": "BSD-3-Clause", "New BSD": "BSD-3-Clause"}


def git(folder, *arguments) -> None:
    identity = ["-c", "user.name=Test", "-c", "user.email=test@example.org"]
    subprocess.run(["git", *identity, *arguments], cwd=folder, check=True, capture_output=True)


@pytest.fixture
def checkout(tmp_path):
    """Write a repository with the four files that name the version, each with 1.2.3."""
    (tmp_path / "blender_manifest.toml").write_text('version = "1.2.3"\n')
    (tmp_path / "pyproject.toml").write_text('[project]\nversion = "1.2.3"\n')
    (tmp_path / "__init__.py").write_text('__version__ = "1.2.3"\n')
    (tmp_path / "CHANGELOG.md").write_text("# Changelog\n\n## 1.2.3\n\n* New.\n\n## 1.2.2\n")
    git(tmp_path, "init")
    git(tmp_path, "add", "-A")
    git(tmp_path, "commit", "-m", "first")
    return tmp_path


def test_a_release_needs_one_version_everywhere(release, checkout):
    assert release.check_version(checkout) == "1.2.3"
    git(checkout, "tag", "v1.2.3")
    assert release.check_version(checkout) == "1.2.3"
    for name in ("blender_manifest.toml", "pyproject.toml", "__init__.py", "CHANGELOG.md"):
        text = (checkout / name).read_text()
        (checkout / name).write_text(text.replace("1.2.3", "Unreleased"))
        with pytest.raises(SystemExit, match=f"Unreleased in [^,]*{re.escape(name)}"):
            release.check_version(checkout)
        (checkout / name).write_text(text)
    (checkout / "new.py").write_text("")
    with pytest.raises(SystemExit, match="changes"):
        release.check_version(checkout)
    git(checkout, "add", "-A")
    git(checkout, "commit", "-m", "second")
    with pytest.raises(SystemExit, match="tag v1.2.3 is at another commit"):
        release.check_version(checkout)


def test_this_checkout_has_one_version():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert project["version"] == MANIFEST["version"]
    assert f'__version__ = "{MANIFEST["version"]}"\n' in (ROOT / "__init__.py").read_text(encoding="utf-8")


def test_the_manifest_lists_exactly_the_bundled_packages(release):
    from build_extension import WHEELS

    assert {name for name in LICENCES if "/" not in name} == set(WHEELS)
    assert len(LICENCES) == len(MANIFEST["copyright"]) - 1, "every line but our own has a package and a licence"


def test_licences_are_those_of_the_installed_packages():
    for name in (name for name in LICENCES if "/" not in name):
        about = metadata.metadata(name)
        stated = about["License-Expression"] or about["License"]
        if stated:
            assert LICENCES[name] == FREE_TEXT.get(stated, stated), name
        else:
            [text] = [file for file in metadata.files(name) if file.name == "LICENSE.md"]
            assert name == "openexr" and "Neither the name of the copyright holder" in text.read_text()


def test_the_manifest_lists_libraries_in_the_wheels():
    files = [file.name for file in metadata.files("rasterio") if file.parts[0] == "rasterio.libs"]
    assert len(files) >= 28
    projects = {"crypto": "openssl", "ssl": "openssl", "sharpyuv": "webp", "sz": "aec", "geos_c": "geos"}
    projects |= {"hdf5_hl": "hdf5", "pcre2-8": "pcre2", "Lerc": "lerc"}
    libraries = [re.fullmatch(r"lib(.+)-[0-9a-f]{8}\.so[.0-9]*", name)[1] for name in files]
    missing = {projects.get(library, library) for library in libraries}
    assert not {f"rasterio/{name}" for name in missing} - LICENCES.keys()
    stated = [file.name for file in metadata.files("warp-lang") if file.name.endswith("-LICENSE.txt")]
    assert {f"warp-lang/{name.removesuffix('-LICENSE.txt')}" for name in stated} == {
        name for name in LICENCES if name.startswith("warp-lang/")
    }


def test_a_wheel_with_an_unlisted_library_is_refused(release, tmp_path):
    from build_extension import check_licences, list_bundled

    wheel = tmp_path / "Some_Package-1.0-py3-none-any.whl"
    with zipfile.ZipFile(wheel, "w") as archive:
        for name in ("libjson-c-20af2e5b.so.5.4.0", "libgeos_c-23da760b.so.1", "libcrypto-3-x64-b41a9ee5911a26d6.dll"):
            archive.writestr(f"some_package.libs/{name}", "")
        archive.writestr("some_package-1.0.dist-info/licenses/licenses/svd-LICENSE.txt", "")
    names = ["some-package", *(f"some-package/{name}" for name in ("geos", "json-c", "openssl", "svd"))]
    assert sorted(list_bundled(wheel)) == names
    lines = [f"2020-2026 Somebody: {name}, MIT" for name in names]
    check_licences([wheel], {"copyright": ["2026 We", *lines]})
    with pytest.raises(SystemExit, match=r"Missing: \['some-package/json-c'\]"):
        check_licences([wheel], {"copyright": [line for line in lines if "json-c" not in line]})
    with pytest.raises(SystemExit, match=r"not bundled: \['numpy'\]"):
        check_licences([wheel], {"copyright": [*lines, "2026 Numpy: numpy, BSD-3-Clause"]})
