#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Build the extension's zip for one platform: `build_extension.py [--platform P] [--output DIR] [--blender PROGRAM]`.

Stages the package without its tests, fetches the wheels that it needs at the versions of the lock file (for each Python
that a supported Blender has; Blender installs those of its own), writes them into a copy of the manifest and packs the
stage. With `--blender` the real program validates and packs it; without, the zip is packed here.
"""

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
# Wheels of all extensions share one folder with Blender's own: numpy is Blender's and is never shipped.
PURE_WHEELS = ("affine", "attrs", "certifi", "click", "click-plugins", "cligj", "pyparsing")
PLATFORM_WHEELS = ("warp-lang",)
PYTHON_WHEELS = ("openexr", "rasterio")
# Blender 4.2 - 5.0; 5.1 and later, and 4.3 as packaged by Debian; 5.2 as packaged by distributions with a newer Python.
PYTHONS = ("3.11", "3.13", "3.14")
PIP_PLATFORMS = {
    "linux-x64": [f"manylinux_2_{minor}_x86_64" for minor in (28, 27, 24, 17)] + ["manylinux2014_x86_64"],
    "windows-x64": ["win_amd64"],
    "macos-arm64": [f"macosx_{major}_0_arm64" for major in (14, 13, 12, 11)],
}
PACKAGE = ("__init__.py", "LICENSE", "README.md", "kernels", "cbt_terrain", "operators")


def this_platform() -> str:
    return {"linux": "linux-x64", "win32": "windows-x64", "darwin": "macos-arm64"}[sys.platform]


def locked_versions(lock: Path) -> dict[str, str]:
    """Version of each package that the lock file names, by normalised name."""
    pins = re.findall(r"^([A-Za-z0-9._-]+)==([^\s;\\]+)", lock.read_text(), re.MULTILINE)
    return {re.sub(r"[-_.]+", "-", name).lower(): version for name, version in pins}


def fetch_wheels(platform: str, lock: Path, folder: Path) -> list[Path]:
    """Download what is not in `folder` yet; returns the wheels of this platform, sorted by name."""
    versions = locked_versions(lock)
    tags = [argument for tag in PIP_PLATFORMS[platform] for argument in ("--platform", tag)]
    folder.mkdir(parents=True, exist_ok=True)
    for python in PYTHONS:
        names = PYTHON_WHEELS if python != PYTHONS[0] else PURE_WHEELS + PLATFORM_WHEELS + PYTHON_WHEELS
        pins = [f"{name}=={versions[name]}" for name in names]
        command = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps"]
        command += ["--only-binary=:all:", "--python-version", python, *tags, "--dest", str(folder), *pins]
        subprocess.run(command, check=True)
    return sorted(wheel for wheel in folder.glob("*.whl") if _belongs(wheel.name, versions))


def _belongs(wheel: str, versions: dict[str, str]) -> bool:
    name, version = wheel.split("-")[:2]
    return versions.get(re.sub(r"[-_.]+", "-", name).lower()) == version


def stage(platform: str, wheels: list[Path], folder: Path) -> Path:
    """Copy the package and link its wheels into an empty `folder`; returns it."""
    (folder / "wheels").mkdir(parents=True)
    for name in PACKAGE:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
        elif source.exists():
            shutil.copy2(source, folder / name)
    for wheel in wheels:
        (folder / "wheels" / wheel.name).hardlink_to(wheel)
    manifest = (ROOT / "blender_manifest.toml").read_text()
    lines = [f'platforms = ["{platform}"]', "wheels = ["]
    lines += [f'  "./wheels/{wheel.name}",' for wheel in wheels] + ["]", "", "[permissions]"]
    (folder / "blender_manifest.toml").write_text(manifest.replace("[permissions]", "\n".join(lines)))
    return folder


def pack(folder: Path, zip_path: Path) -> None:
    """Write the stage as a zip; wheels are compressed already and are stored."""
    with zipfile.ZipFile(zip_path, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                stored = zipfile.ZIP_STORED if path.suffix == ".whl" else zipfile.ZIP_DEFLATED
                archive.write(path, path.relative_to(folder), compress_type=stored)


def build(platform: str, output: Path, lock: Path, cache: Path, blender: list[str]) -> Path:
    """Build the zip for `platform` in `output`; returns its path."""
    version = tomllib.loads((ROOT / "blender_manifest.toml").read_text())["version"]
    wheels = fetch_wheels(platform, lock, cache / "wheels" / platform)
    output.mkdir(parents=True, exist_ok=True)
    zip_path = output / f"adaptive_terrain-{version}-{platform}.zip"
    with tempfile.TemporaryDirectory(prefix=f"stage-{platform}-", dir=cache) as empty:
        folder = stage(platform, wheels, Path(empty))
        if not blender:
            pack(folder, zip_path)
            return zip_path
        extension = [*blender, "--command", "extension"]
        subprocess.run([*extension, "validate", str(folder)], check=True)
        build_command = [*extension, "build", "--source-dir", str(folder), "--output-filepath", str(zip_path)]
        subprocess.run(build_command, check=True)
    return zip_path


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--platform", choices=sorted(PIP_PLATFORMS), default=this_platform())
    parser.add_argument("--output", type=Path, default=ROOT / "dist", help="folder for the zip (dist)")
    parser.add_argument("--lock", type=Path, default=ROOT / "requirements.lock", help="file with pinned versions")
    parser.add_argument("--cache", type=Path, default=ROOT / ".cache", help="folder for wheels and the stage (.cache)")
    parser.add_argument("--blender", nargs="+", default=[], help="program that validates and packs (with its wrapper)")
    arguments = parser.parse_args()
    print(build(arguments.platform, arguments.output, arguments.lock, arguments.cache, arguments.blender))
    return 0


if __name__ == "__main__":
    sys.exit(main())
