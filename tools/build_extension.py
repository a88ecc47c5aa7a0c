#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Build the extension's zips: `build_extension.py [--platform P] [--python V ...] [--output DIR] [--blender PROGRAM]`.

A zip is for one platform and one Python: the wheels of another Python take 20 to 38 MB that Blender never installs. The
package is staged without its tests. The stage has the wheels at the versions of the lock file and a manifest that names
them. With `--blender` the real program validates and packs the stage; without, this script packs it.
"""

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from pathlib import Path, PurePosixPath

ROOT = Path(__file__).resolve().parent.parent
# Wheels of all extensions share one folder with Blender's own: numpy is Blender's and is never shipped.
WHEELS = (
    "affine",
    "attrs",
    "certifi",
    "click",
    "click-plugins",
    "cligj",
    "openexr",
    "pyparsing",
    "rasterio",
    "warp-lang",
)
# The first Blender of each Python: 4.2 to 5.0 have 3.11; 5.1 and later, and 4.3 as Debian packages it, have 3.13;
# distributions with a newer Python have 3.14. Blender 4.2 does not compare a zip's Python with its own, so it is not
# offered the zips of the others.
BLENDER_MIN = {"3.11": "4.2.0", "3.13": "4.3.0", "3.14": "5.1.0"}
PIP_PLATFORMS = {
    "linux-x64": [f"manylinux_2_{minor}_x86_64" for minor in (28, 27, 24, 17)] + ["manylinux2014_x86_64"],
    "windows-x64": ["win_amd64"],
    "macos-arm64": [f"macosx_{major}_0_arm64" for major in (14, 13, 12, 11)],
}
# Library files whose name is not that of their project.
PROJECTS = {"crypto": "openssl", "ssl": "openssl", "sharpyuv": "webp", "sz": "aec", "z": "zlib", "zlib1": "zlib"}
PACKAGE = ("__init__.py", "LICENSE", "README.md", "kernels", "cbt_terrain", "operators")


def get_platform() -> str:
    """Return Blender's name of the platform that runs this script."""
    return {"linux": "linux-x64", "win32": "windows-x64", "darwin": "macos-arm64"}[sys.platform]


def ask_python(blender: list[str]) -> str:
    """Return the version of a Blender program's Python as `3.11`."""
    code = "import sys; print('python %d.%d' % sys.version_info[:2])"
    command = [*blender, "-b", "--factory-startup", "--python-expr", code]
    output = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return re.search(r"(?m)^python (\d+\.\d+)$", output)[1]


def normalize(name: str) -> str:
    """Return a package's name as PyPI normalizes it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def read_lock(lock: Path) -> dict[str, str]:
    """Return the version of each package in the lock file by normalized name."""
    pins = re.findall(r"^([A-Za-z0-9._-]+)==([^\s;\\]+)", lock.read_text(), re.MULTILINE)
    return {normalize(name): version for name, version in pins}


def fetch_wheels(platform: str, python: str, lock: Path, folder: Path) -> list[Path]:
    """Download the wheels that `folder` lacks; return those of the platform and the Python, sorted by name."""
    versions = read_lock(lock)
    tags = [argument for tag in PIP_PLATFORMS[platform] for argument in ("--platform", tag)]
    folder.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps"]
    command += ["--only-binary=:all:", "--python-version", python, *tags, "--dest", str(folder)]
    subprocess.run([*command, *(f"{name}=={versions[name]}" for name in WHEELS)], check=True)
    pythons = ("py3", "py2.py3", f"cp{python.replace('.', '')}")
    wheels = []
    for wheel in sorted(folder.glob("*.whl")):
        name, version, tag = wheel.name.split("-")[:3]
        if tag in pythons and versions.get(normalize(name)) == version:
            wheels.append(wheel)
    return wheels


def list_bundled(wheel: Path) -> set[str]:
    """Return the names of a wheel's package and of the libraries that it bundles, as the manifest spells them."""
    package = normalize(wheel.name.split("-")[0])
    bundled = {package}
    for file in map(PurePosixPath, zipfile.ZipFile(wheel).namelist()):
        if file.name.endswith("-LICENSE.txt"):  # Warp's, for code that is linked into its libraries
            bundled.add(f"{package}/{file.name.removesuffix('-LICENSE.txt')}")
        elif file.parent.name.endswith((".libs", ".dylibs", "platlib")) and not file.name.startswith("."):
            stem = re.sub(r"-[0-9a-f]{8,32}$", "", file.name.split(".")[0]).removeprefix("lib").lower()
            project = re.sub(r"_c$|[-_](\d+|hl|r)(-x64)?$", "", stem)
            bundled.add(f"{package}/{PROJECTS.get(project, project)}")
    return bundled


def check_licences(wheels: list[Path], manifest: dict) -> None:
    """Raise SystemExit unless the manifest has licence and holder of all that the wheels bundle."""
    entries = re.findall(r"(?m)^[\d-]+ [^:]+: (\S+), \S", "\n".join(manifest["copyright"]))
    bundled = set().union(*map(list_bundled, wheels))
    missing = bundled - set(entries)
    unused = {name for name in entries if "/" not in name} - bundled
    if missing or unused:
        raise SystemExit(
            f"blender_manifest.toml must name what the wheels bundle in `copyright`. Missing: {sorted(missing)}; "
            f"not bundled: {sorted(unused)}."
        )


def stage(platform: str, python: str, wheels: list[Path], folder: Path) -> None:
    """Copy the package into an empty `folder`, link its wheels and write its manifest."""
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
    manifest = manifest.replace("[permissions]", "\n".join(lines))
    manifest = re.sub(r'(?m)^(blender_version_min = )".*"', rf'\1"{BLENDER_MIN[python]}"', manifest)
    (folder / "blender_manifest.toml").write_text(manifest)


def pack(folder: Path, zip_path: Path) -> None:
    """Write the stage as a zip; wheels are compressed already and are stored."""
    with zipfile.ZipFile(zip_path, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                stored = zipfile.ZIP_STORED if path.suffix == ".whl" else zipfile.ZIP_DEFLATED
                archive.write(path, path.relative_to(folder), compress_type=stored)


def build(platform: str, python: str, output: Path, lock: Path, cache: Path, blender: list[str]) -> Path:
    """Build the zip of a platform and a Python in `output`; return its path."""
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text())
    version = manifest["version"]
    wheels = fetch_wheels(platform, python, lock, cache / "wheels" / platform)
    check_licences(wheels, manifest)
    output.mkdir(parents=True, exist_ok=True)
    zip_path = output / f"adaptive_terrain-{version}-{platform}-py{python.replace('.', '')}.zip"
    with tempfile.TemporaryDirectory(prefix=f"stage-{platform}-", dir=cache) as empty:
        folder = Path(empty)
        stage(platform, python, wheels, folder)
        if not blender:
            pack(folder, zip_path)
            return zip_path
        extension = [*blender, "--command", "extension"]
        subprocess.run([*extension, "validate", str(folder)], check=True)
        build_command = [*extension, "build", "--source-dir", str(folder), "--output-filepath", str(zip_path)]
        subprocess.run(build_command, check=True)
    return zip_path


def main() -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--platform", choices=sorted(PIP_PLATFORMS), default=get_platform())
    parser.add_argument("--python", nargs="+", choices=BLENDER_MIN, help="(that of --blender, or all)")
    parser.add_argument("--output", type=Path, default=ROOT / "dist", help="folder for the zips (dist)")
    parser.add_argument("--lock", type=Path, default=ROOT / "requirements.lock", help="file with pinned versions")
    parser.add_argument("--cache", type=Path, default=ROOT / ".cache", help="folder for wheels and the stage (.cache)")
    parser.add_argument("--blender", nargs="+", default=[], help="program that validates and packs (with its wrapper)")
    arguments = parser.parse_args()
    rest = (arguments.output, arguments.lock, arguments.cache, arguments.blender)
    pythons = arguments.python or ([ask_python(arguments.blender)] if arguments.blender else BLENDER_MIN)
    for python in pythons:
        print(build(arguments.platform, python, *rest))
    return 0


if __name__ == "__main__":
    sys.exit(main())
