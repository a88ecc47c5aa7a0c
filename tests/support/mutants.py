# SPDX-License-Identifier: GPL-3.0-or-later
"""Stores with damage: copies of a store in which one or two files differ from those of an import.

It shares nothing with the package, so that it also runs inside the Blender program: this file describes a
store's bytes a second time.
"""

import hashlib
import json
import os
import re
import shutil
import zlib
from pathlib import Path

import numpy as np

PAGE, BLOCK = 4096, 1 << 18
VALUES = (np.nan, np.inf, -np.inf, 3e38, -3e38, -1e9, 1e9, -1.0, 1e-38, 0.0)

REPLACEMENTS = "cut", "longer", "header", "fortran", "object", "zip", "empty", "missing", "folder", "link", "pipe"


def mutate(store: Path, out: Path, rng: np.random.Generator) -> str:
    """Write a damaged copy of `store` to `out`; return its description. Most mutants have checksums that fit."""
    shutil.rmtree(out, ignore_errors=True)
    shutil.copytree(store, out)
    content = json.loads((out / "store.json").read_text())
    files = sorted((out / content["data"]).glob("*.npy"))
    done = []
    for _ in range(int(rng.choice([1, 1, 1, 2]))):
        if rng.random() < 0.12:
            done.append(_change_json(out / "store.json", content, rng))
        elif rng.random() < 0.12:
            done.append(_replace(files[rng.integers(len(files))], rng))
        else:
            file = files[rng.integers(len(files))]
            if rng.random() < 0.3:
                file = next(f for f in files if f.name in ("error.npy", "error_pages.npy"))
            done.append(_damage(file, rng))
    return "; ".join(done)


def _damage(file: Path, rng: np.random.Generator) -> str:
    """Change values or bytes of an array."""
    if not file.is_file() or file.is_symlink() or file.stat().st_size <= PAGE:
        return f"{file.name} was gone"
    raw = bytearray(file.read_bytes())
    dtype = np.dtype(re.search(rb"'descr': '([^']*)'", raw[:PAGE])[1].decode())
    if dtype.hasobject:
        return f"{file.name} was replaced"
    nbytes = _data_bytes(len(raw))
    data = np.frombuffer(raw, np.uint8, nbytes, PAGE)
    values = data[: nbytes // dtype.itemsize * dtype.itemsize].view(dtype)
    how = str(rng.choice(["values", "all", "scaled", "bytes", "bits", "swapped", "shuffled", "rows"]))
    some = rng.integers(len(values), size=int(10 ** rng.uniform(0, np.log10(len(values)))))
    with np.errstate(all="ignore"):
        if how in ("values", "all"):
            value = (
                rng.choice(VALUES)
                if dtype.kind == "f"
                else rng.choice([0, 1, 128, 255 if dtype.itemsize == 1 else 65535])
            )
            values[some if how == "values" else slice(None)] = value
        elif how == "scaled":
            values[some] = (values[some] * 10 ** rng.uniform(-6, 12)).astype(dtype)
        elif how == "bytes":
            start = int(rng.integers(nbytes))
            data[start : start + 10 ** int(rng.integers(1, 6))] = rng.integers(256, size=1)
            data[rng.integers(nbytes, size=len(some))] = rng.integers(256, size=len(some))
        elif how == "bits":
            data[rng.integers(nbytes, size=len(some))] ^= np.uint8(1 << rng.integers(8))
        elif how == "shuffled":
            values[:] = rng.permutation(values)
        else:
            size = 64 if how == "swapped" else max(1, len(values) // 7)
            a, b = rng.integers(max(len(values) - size, 1), size=2)
            values[a : a + size] = values[b : b + size].copy()
    fits = rng.random() < 0.85
    if fits:
        put_checksums(raw)
    file.write_bytes(raw)
    return f"{file.name} {how}{'' if fits else ', checksums of before'}"


def _data_bytes(size: int) -> int:
    """Return the number of data bytes in an array's file, without its header and the four bytes of each block."""
    behind = size - PAGE
    return behind - 4 * -(-behind // (BLOCK + 4))


def put_checksums(raw: bytearray) -> None:
    """Make the checksums of an array's file those of its data."""
    end = PAGE + _data_bytes(len(raw))
    sums = [zlib.crc32(raw[at : min(at + BLOCK, end)]) for at in range(PAGE, end, BLOCK)]
    raw[end:] = np.array(sums, "<u4").tobytes()


def _replace(file: Path, rng: np.random.Generator) -> str:
    """Put something in the place of an array's file, or break its header or its end."""
    if not file.is_file() or file.is_symlink():
        return f"{file.name} was gone"
    raw = file.read_bytes()
    how = str(rng.choice(REPLACEMENTS))
    file.unlink()
    if how == "cut":
        file.write_bytes(raw[: rng.integers(len(raw))])
    elif how == "longer":
        file.write_bytes(raw + b"\0" * int(rng.integers(1, 9999)))
    elif how == "header":
        head = bytearray(raw[:PAGE])
        head[rng.integers(120)] = rng.integers(256)
        file.write_bytes(bytes(head) + raw[PAGE:])
    elif how == "fortran":
        file.write_bytes(raw[:PAGE].replace(b"False", b"True ") + raw[PAGE:])
    elif how == "object":
        file.write_bytes(
            re.sub(rb"'descr': '[^']*'", b"'descr': '|O'", raw[:PAGE])[: PAGE - 1].ljust(PAGE) + raw[PAGE:]
        )
    elif how == "zip":
        np.savez(file.with_suffix(".npz"), np.zeros(9))
        file.with_suffix(".npz").rename(file)
    elif how == "empty":
        file.write_bytes(b"")
    elif how == "folder":
        file.mkdir()
    elif how == "link":
        file.symlink_to(rng.choice(["/dev/zero", "/etc/passwd", file.name]))
    elif how == "pipe":
        os.mkfifo(file)
    return f"{file.name} {how}"


def _change_json(file: Path, content: dict, rng: np.random.Generator) -> str:
    """Change an entry, mostly with a checksum that fits, or the text."""
    if rng.random() < 0.2:
        text = bytearray(file.read_bytes())
        text[rng.integers(len(text))] = rng.integers(256)
        file.write_bytes(text)
        return "store.json, a byte"
    if rng.random() < 0.1:
        file.write_text("[" * 100_000 if rng.random() < 0.5 else json.dumps(content | {"report": "x" * (1 << 23)}))
        return "store.json, deep or huge"
    place = content["lattice"] if rng.random() < 0.3 else content
    name = str(rng.choice(sorted(place)))
    values = [0, -1, 1, 2, 31, 2**31, 2**62, 1e30, -1e30, 1e300, 1e-300, None, True, "x", [], {}, [1e300] * 3]
    value = values[rng.integers(len(values))]
    if isinstance(place[name], int | float) and rng.random() < 0.5:
        value = place[name] * float(rng.choice([-1, 0.5, 2, 1e3, 1e-3]))
        value = int(value) if isinstance(place[name], int) else value
    place[name] = value
    if name != "sum":
        others = {key: item for key, item in content.items() if key != "sum"}
        content["sum"] = hashlib.blake2b(json.dumps(others, sort_keys=True).encode(), digest_size=8).hexdigest()
    file.write_text(json.dumps(content))
    return f"store.json, {name} = {str(value)[:40]}"
