# SPDX-License-Identifier: GPL-3.0-or-later
"""Say which Debian packages this machine lacks before anything is downloaded.

`check_system.py` ends with 1 and one message where something is missing; `check_system.py --packages` prints every
package that the project may need, for a script that installs them. Only the standard library is used.
"""

import ctypes
import importlib.util
import sys

# Shared libraries that the wheels of bpy and rasterio load from the system, and the Debian package of each.
LIBRARIES = {
    "libEGL.so.1": "libegl1",
    "libGL.so.1": "libgl1",
    "libOpenGL.so.0": "libopengl0",
    "libX11.so.6": "libx11-6",
    "libXext.so.6": "libxext6",
    "libXfixes.so.3": "libxfixes3",
    "libXi.so.6": "libxi6",
    "libXrender.so.1": "libxrender1",
    "libXt.so.6": "libxt6",
    "libSM.so.6": "libsm6",
    "libICE.so.6": "libice6",
    "libxkbcommon.so.0": "libxkbcommon0",
    "libexpat.so.1": "libexpat1",
    "libgcc_s.so.1": "libgcc-s1",
    "libstdc++.so.6": "libstdc++6",
    "libz.so.1": "zlib1g",
}
# Loaded by name at run time, so nothing fails to link without it: the software renderer behind EGL.
ALSO = ["libgl1-mesa-dri"]
# What only tests need: a browser that opens the pages.
TESTS = ["chromium-headless-shell"]


def missing() -> list[str]:
    """Debian packages whose library cannot be loaded here, sorted by name."""
    packages = set()
    for library, package in LIBRARIES.items():
        try:
            ctypes.CDLL(library)
        except OSError:
            packages.add(package)
    if importlib.util.find_spec("ensurepip") is None:
        packages.add(f"python{sys.version_info.major}.{sys.version_info.minor}-venv")
    return sorted(packages)


def main() -> int:
    """Run the command line."""
    if "--packages" in sys.argv:
        print(" ".join(sorted({*LIBRARIES.values(), *ALSO, *TESTS})))
        return 0
    if sys.version_info[:2] not in ((3, 11), (3, 13)):
        found = ".".join(map(str, sys.version_info[:3]))
        print(
            f"Python {found} was found, but bpy has wheels for 3.11 and 3.13 only: "
            "install python3.11 and python3.11-venv, or name one with `make PYTHON=/path/to/python3.11`.",
            file=sys.stderr,
        )
        return 1
    if sys.platform != "linux":
        return 0
    if packages := missing():
        print(
            "This machine lacks libraries that Blender's Python module loads. On Debian or Ubuntu install them with\n\n"
            f"    apt-get install {' '.join(sorted({*packages, *ALSO}))}\n",
            file=sys.stderr,
        )
        return 1
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
