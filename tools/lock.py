# SPDX-License-Identifier: GPL-3.0-or-later
"""Write requirements.lock from two environments that work, one for each Python that bpy has wheels for.

    python tools/lock.py .venv .venv-3.13 > requirements.lock

A package with one version in both stands without a marker; any other carries the Python that it is for.
"""

import subprocess
import sys


def frozen(environment: str) -> tuple[str, dict[str, str]]:
    """Return the environment's Python version as `3.11`, and the version of each package by name."""
    python = f"{environment}/bin/python"
    version = subprocess.check_output(
        [python, "-c", "import sys; print('%d.%d' % sys.version_info[:2])"], text=True
    ).strip()
    lines = subprocess.check_output([python, "-m", "pip", "freeze", "--all", "--exclude-editable"], text=True)
    packages = dict(line.split("==") for line in lines.splitlines() if "==" in line and not line.startswith("#"))
    packages.pop("pip", None)
    return version, packages


def main() -> None:
    """Run the command line."""
    environments = dict(frozen(path) for path in sys.argv[1:])
    print("# Written by tools/lock.py: every package of the environment that `make` sets up, for both Pythons of bpy.")
    for name in sorted({name for packages in environments.values() for name in packages}, key=str.lower):
        versions = {python: packages.get(name) for python, packages in environments.items()}
        if len(set(versions.values())) == 1:
            print(f"{name}=={versions.popitem()[1]}")
            continue
        for python, version in versions.items():
            if version:
                print(f'{name}=={version} ; python_version == "{python}"')


if __name__ == "__main__":
    main()
