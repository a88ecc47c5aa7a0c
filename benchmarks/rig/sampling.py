# SPDX-License-Identifier: GPL-3.0-or-later
"""Where this process spends its time, by Linux perf: samples of the machine's clock, each with what was running.

A sample inside a Warp kernel is followed to the line of Python that the instruction was made from, through all
functions inlined there. For that Warp must compile with line tables (`with_lines`), which changes no instruction.
"""

import ast
import atexit
import bisect
import ctypes
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import warp as wp

from ...cbt_terrain.errors import TerrainError

TOOLS = ("perf", "addr2line", "nm")
SAMPLES_A_SECOND = 1999  # not a multiple of what else happens at a fixed rate
START_S = 0.5  # that perf takes to attach


@dataclass(frozen=True)
class Sample:
    """What was running. In a kernel: `kernel` is its module and name, `frames` are (Python file, function, line) from
    the kernel inwards. Elsewhere: `library` and `symbol`.
    """

    kernel: str = ""
    frames: tuple[tuple[str, str, int], ...] = ()
    library: str = ""
    symbol: str = ""


def with_lines() -> None:
    """Have Warp write line tables into what it compiles; to be called before any kernel is imported.

    Into a cache of this process alone: where a kept one has the same instructions, it may still name the lines and the
    folder of a file that has changed or moved since.
    """
    if any(name.endswith(".kernels") for name in sys.modules):
        raise RuntimeError("kernels were imported before their line tables were asked for")
    cache = tempfile.TemporaryDirectory(prefix="adaptive-terrain-kernels-")
    atexit.register(cache.cleanup)
    wp.config.kernel_cache_dir = cache.name
    wp.config.lineinfo = True
    wp.config.cpu_compiler_flags = (
        f"{wp.config.cpu_compiler_flags or '-march=native'} -debug-info-kind=line-tables-only"
    )


def need_tools() -> None:
    missing = [tool for tool in TOOLS if not shutil.which(tool)]
    if missing:
        raise TerrainError(f"A profile needs {', '.join(missing)}; install Linux perf and binutils.")


def sampled(work: Callable[[], object], seconds: float) -> Counter[Sample]:
    """Call `work` again and again for so long; returns how often each place was met on any thread of this process."""
    with tempfile.TemporaryDirectory(prefix="adaptive-terrain-profile-") as folder:
        data, log = Path(folder) / "perf.data", Path(folder) / "log"
        command = ["perf", "record", "-e", "cpu-clock", "-F", str(SAMPLES_A_SECOND), "-o", str(data)]
        with log.open("wb") as log_file:
            perf = subprocess.Popen([*command, "-p", str(os.getpid())], stdout=log_file, stderr=log_file)
        time.sleep(START_S)
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            work()
        perf.send_signal(signal.SIGINT)
        perf.wait()
        if not data.exists() or data.stat().st_size == 0:
            said = log.read_text(errors="replace").split("\n\n")[0].strip() or "no message"
            raise TerrainError(f"perf cannot sample this process ({' '.join(said.split())}).")
        script = ["perf", "script", "-i", str(data), "-F", "ip,sym,dso"]
        lines = subprocess.run(script, capture_output=True, text=True, check=True).stdout.splitlines()
    return _resolved(Counter(line.strip() for line in lines if line.strip()))


def _resolved(lines: Counter[str]) -> Counter[Sample]:
    """Lines of `perf script`: address, symbol, (library)."""
    kernels = sorted(_loaded_kernels(), key=lambda kernel: kernel.start)
    starts = [kernel.start for kernel in kernels]
    samples: Counter[Sample] = Counter()
    inside: dict[int, Counter[int]] = {}
    for line, count in lines.items():
        address, _, rest = line.partition(" ")
        symbol, _, library = rest.strip().rpartition(" (")
        at = bisect.bisect_right(starts, int(address, 16)) - 1
        if at >= 0 and int(address, 16) < kernels[at].start + kernels[at].size:
            inside.setdefault(at, Counter())[int(address, 16) - kernels[at].start] += count
        else:
            samples[Sample(library=Path(library.rstrip(")")).name, symbol=symbol.split("+0x")[0])] += count
    for at, offsets in inside.items():
        frames = kernels[at].frames(list(offsets))
        for offset, count in offsets.items():
            samples[Sample(kernel=kernels[at].name, frames=frames[offset])] += count
    return samples


@dataclass
class _Kernel:
    """A compiled kernel in memory; `value` is its place in `section` of the object file."""

    name: str
    start: int
    size: int
    value: int
    section: str
    file: Path

    def frames(self, offsets: list[int]) -> dict[int, tuple]:
        """(file, function, line) of Python from the kernel inwards, of each offset into it."""
        asked = "".join(f"{self.value + offset:#x}\n" for offset in offsets)
        command = ["addr2line", "-e", str(self.file), "-j", self.section, "-i", "-f", "-a"]
        answer = subprocess.run(command, input=asked, capture_output=True, text=True, check=True).stdout
        found: dict[int, list] = {}
        place = None
        for line in answer.splitlines():
            if line.startswith("0x"):
                place = found.setdefault(int(line, 16) - self.value, [])
            elif ":" in line and line.rpartition(":")[0].endswith(".py"):
                path, _, number = line.partition(" (")[0].rpartition(":")
                name = function_at(path, int(number)) if number.isdigit() else ""
                if name:
                    place.append((Path(path).name, name, int(number)))
        return {offset: tuple(reversed(frames)) for offset, frames in found.items()}


def _loaded_kernels() -> list[_Kernel]:
    from ...cbt_terrain.run import warmup

    found = []
    for module in warmup.kernel_modules():
        loaded = wp.get_module(module.__name__)
        for compiled in loaded.execs.values():
            file = warmup.compiled_file(module)
            symbols = subprocess.run(["nm", "-f", "sysv", str(file)], capture_output=True, text=True, check=True).stdout
            rows = [list(map(str.strip, line.split("|"))) for line in symbols.splitlines()]
            places = {row[0]: (int(row[1], 16), int(row[4], 16), row[6]) for row in rows if row[3:4] == ["FUNC"]}
            for kernel in loaded.kernels.values():
                mangled, name = kernel.get_mangled_name(), f"{module.__name__.rpartition('.')[2]}.{kernel.key}"
                hook = ctypes.cast(compiled.get_kernel_hooks(kernel).forward, ctypes.c_void_p).value
                moved = hook - places[f"{mangled}_cpu_forward"][0]
                for symbol, (value, size, section) in places.items():
                    if mangled in symbol and "_forward" in symbol:  # a large body is a function of its own
                        found.append(_Kernel(name, value + moved, size, value, section, file))
    return found


def function_at(path: str, line: int) -> str:
    """Name of the function of a Python file that has this line; "" between functions, where Warp's own lines lie."""
    for name, first, last in _functions(path):
        if first <= line <= last:
            return name
    return ""


_spans: dict[str, list[tuple[str, int, int]]] = {}


def _functions(path: str) -> list[tuple[str, int, int]]:
    if path not in _spans:
        tree = ast.parse(Path(path).read_text(encoding="utf-8"))
        _spans[path] = [(f.name, f.lineno, f.end_lineno) for f in tree.body if isinstance(f, ast.FunctionDef)]
    return _spans[path]
