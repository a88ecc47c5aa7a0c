#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Make a release: `release.py --blender PROGRAM [--output DIR]`.

Checks that the version is the same everywhere, builds a zip for each platform and Python, writes a static extension
repository (a folder that any web server can publish) and, at the end, tags the commit. Nothing is pushed.
"""

import argparse
import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

from build_extension import BLENDER_MIN, PIP_PLATFORMS, ROOT, build


def check_version(root: Path) -> str:
    """Return the version of the checkout; raise SystemExit unless all files, the changelog and the tag agree."""
    version = tomllib.loads((root / "blender_manifest.toml").read_text())["version"]
    package = re.search(r'(?m)^__version__ = "(.*)"$', (root / "__init__.py").read_text())
    changes = re.search(r"(?m)^## (\S+)", (root / "CHANGELOG.md").read_text())
    found = {
        "blender_manifest.toml": version,
        "pyproject.toml": tomllib.loads((root / "pyproject.toml").read_text())["project"]["version"],
        "__init__.py": package and package[1],
        "the first section of CHANGELOG.md": changes and changes[1],
    }
    if len(set(found.values())) > 1:
        raise SystemExit("Versions differ: " + ", ".join(f"{value} in {name}" for name, value in found.items()))
    if run_git(root, "status", "--porcelain"):
        raise SystemExit("The checkout has changes: commit them before a release.")
    tagged = run_git(root, "tag", "--list", f"v{version}")
    if tagged and run_git(root, "rev-parse", f"v{version}^{{commit}}") != run_git(root, "rev-parse", "HEAD"):
        raise SystemExit(f"The tag v{version} is at another commit: raise the version.")
    return version


def run_git(root: Path, *arguments: str) -> str:
    """Return the output of a git command."""
    return subprocess.run(["git", *arguments], cwd=root, check=True, capture_output=True, text=True).stdout.strip()


def write_repository(folder: Path, blender: list[str]) -> list[dict]:
    """Write `index.json` and `index.html` for the zips in `folder`; return the entries of the index, one a zip."""
    command = [*blender, "--command", "extension", "server-generate", "--repo-dir", str(folder), "--html"]
    subprocess.run(command, check=True)
    entries = json.loads((folder / "index.json").read_text())["data"]
    listed = sorted(entry["archive_url"].removeprefix("./") for entry in entries)
    zips = sorted(path.name for path in folder.glob("*.zip"))
    if listed != zips:
        raise SystemExit(f"The index lists {listed}; the folder has {zips}.")
    return entries


def main() -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--blender", nargs="+", required=True, help="program that packs (with its wrapper)")
    parser.add_argument("--platform", nargs="+", choices=PIP_PLATFORMS, default=list(PIP_PLATFORMS), help="(all)")
    parser.add_argument("--output", type=Path, default=ROOT / "dist" / "repository", help="(dist/repository)")
    arguments = parser.parse_args()
    version = check_version(ROOT)
    if any(arguments.output.glob("*.zip")):
        sys.exit(f"{arguments.output} has zips; expected a folder without: move them away or choose another --output.")
    cache = ROOT / ".cache"
    cache.mkdir(exist_ok=True)
    for platform in arguments.platform:
        for python in BLENDER_MIN:
            build(platform, python, arguments.output, ROOT / "requirements.lock", cache, arguments.blender)
    entries = write_repository(arguments.output, arguments.blender)
    if not run_git(ROOT, "tag", "--list", f"v{version}"):
        run_git(ROOT, "tag", "--annotate", f"v{version}", "--message", f"Adaptive Terrain {version}")
    print(f"{arguments.output} has {len(entries)} zips of version {version}. Publish the folder and push the tag:")
    print(f"  git push origin v{version}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
