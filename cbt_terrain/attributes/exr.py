# SPDX-License-Identifier: GPL-3.0-or-later
"""OpenEXR files, written band by band, without the library, which clashes with Blender's.

Scan lines in blocks of 16, compressed by zlib (Technical Introduction to OpenEXR; OpenEXR File Layout).
"""

import struct
import zlib
from concurrent.futures import Executor, Future
from pathlib import Path

import numpy as np

from ..run.named_file import open_regular

NAMES = {1: ("Y",), 2: ("R", "G"), 3: ("R", "G", "B"), 4: ("R", "G", "B", "A")}
MAGIC = struct.pack("<II", 20000630, 2)
BLOCK = 16  # lines
LEVEL = 4  # of zlib
HALF, FLOAT = 1, 2
COMMENT = "comments"


class ExrFile:
    """A file of half floats or floats that is written from the top."""

    def __init__(
        self, path: Path, side: int, channels: int, depth: int, text: str, pool: Executor, lines: int = 0
    ) -> None:
        """Create the file with its header and an empty table of offsets.

        `side`: texels of a line, and lines unless `lines` is given. `channels`: their number, a key of NAMES. `depth`:
        bits of a value, 16 or 32. `text`: comment in the header. `pool` compresses blocks.
        """
        names = sorted(NAMES[channels])
        self._order = [NAMES[channels].index(name) for name in names]  # channels are in alphabetical order
        self._dtype, self._pool = np.dtype(f"<f{depth // 8}"), pool
        self._waiting: list[Future] = []
        self._offsets: list[int] = []
        kind = HALF if depth == 16 else FLOAT
        channel_list = b"".join(name.encode() + b"\0" + struct.pack("<iiii", kind, 0, 1, 1) for name in names) + b"\0"
        box = struct.pack("<iiii", 0, 0, side - 1, (lines or side) - 1)
        entries = (
            ("channels", "chlist", channel_list),
            (COMMENT, "string", text.encode("latin-1")),
            ("compression", "compression", b"\x03"),  # zlib, 16 lines a block
            ("dataWindow", "box2i", box),
            ("displayWindow", "box2i", box),
            ("lineOrder", "lineOrder", b"\0"),  # from the top
            ("pixelAspectRatio", "float", struct.pack("<f", 1.0)),
            ("screenWindowCenter", "v2f", struct.pack("<ff", 0.0, 0.0)),
            ("screenWindowWidth", "float", struct.pack("<f", 1.0)),
        )
        self._file, self._line = open(path, "wb"), 0
        self._file.write(MAGIC + b"".join(_header_entry(*entry) for entry in entries) + b"\0")
        self._table = self._file.tell()
        self._file.write(bytes(8 * -(-(lines or side) // BLOCK)))

    def add(self, values: np.ndarray) -> None:
        """Write the next lines, float32 [lines, side, channels]; whole blocks except for the last.

        Numbers beyond the range of half floats become the largest ones.
        """
        # A line has all values of one channel, then those of the next, in the order of their names (`_order`).
        limit = np.finfo(self._dtype).max
        lines = np.clip(values, -limit, limit).astype(self._dtype).transpose(0, 2, 1)[:, self._order]
        for first in range(0, len(lines), BLOCK):
            self._waiting.append(self._pool.submit(_compress, lines[first : first + BLOCK].tobytes()))
        while len(self._waiting) > 64:  # blocks, so that memory stays bounded
            self._write_oldest()

    def close(self) -> None:
        """Write the waiting blocks and the table of their offsets, and close the file."""
        while self._waiting:
            self._write_oldest()
        self._file.seek(self._table)
        self._file.write(struct.pack(f"<{len(self._offsets)}Q", *self._offsets))
        self._file.close()

    def abandon(self) -> None:
        """Close the file without completing it, after an error. Waiting blocks are not written."""
        for future in self._waiting:
            future.cancel()
        self._file.close()

    def _write_oldest(self) -> None:
        """Wait for the oldest compressed block and append it to the file."""
        data = self._waiting.pop(0).result()
        self._offsets.append(self._file.tell())
        self._file.write(struct.pack("<ii", self._line, len(data)) + data)
        self._line += BLOCK


def _compress(data: bytes) -> bytes:
    """Compress a block as the format requires; return `data` if that saves nothing, which readers see by its size.

    The even bytes come first, then the odd ones, each as its difference from the byte before plus 128.
    """
    raw = np.frombuffer(data, np.uint8)
    split = np.concatenate([raw[::2], raw[1::2]])
    split[1:] = split[1:] - split[:-1] + np.uint8(128)
    compressed = zlib.compress(split.tobytes(), LEVEL)
    return compressed if len(compressed) < len(data) else data


def _header_entry(name: str, kind: str, value: bytes) -> bytes:
    """Return an attribute of an OpenEXR header: its name, its type and its value as bytes."""
    return name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(value)) + value


def comment_of(path: Path) -> str | None:
    """Return the comment of a complete file, None for a file that is incomplete, of another kind or without one.

    The offset of the last block is written last, so a file is complete if that block ends with the file.
    """
    try:
        with open_regular(path, links=True) as file:
            head = file.read(4096)
            start = head.find(COMMENT.encode() + b"\0string\0")
            end = head.find(b"screenWindowWidth\0float\0")
            if not head.startswith(MAGIC) or start < 0 or end < 0:
                return None
            text_start = start + len(COMMENT) + 8  # after the name and type, which end with 0
            (length,) = struct.unpack("<i", head[text_start : text_start + 4])
            window_start = head.find(b"dataWindow\0box2i\0") + 21  # after name, type and size
            last_line = struct.unpack("<iiii", head[window_start : window_start + 16])[3]
            # The table follows the last entry (24 bytes of name and type, size, value) and the header's final 0.
            file.seek(end + 33 + 8 * (last_line // BLOCK))
            (last_block,) = struct.unpack("<Q", file.read(8))
            file.seek(last_block + 4)  # a block: number of its first line, size, data
            (size,) = struct.unpack("<i", file.read(4))
            is_complete = last_block > 0 and file.seek(0, 2) == last_block + 8 + size
    except (OSError, struct.error):
        return None
    return head[text_start + 4 : text_start + 4 + length].decode("latin-1") if is_complete else None
