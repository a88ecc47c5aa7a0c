# SPDX-License-Identifier: GPL-3.0-or-later
"""PNG files, written band by band and compressed on several threads (PNG specification, sections 5 to 11)."""

import struct
import zlib
from concurrent.futures import Executor, Future
from pathlib import Path

import numpy as np

from ..run.named_file import open_regular

# Channels -> colour type.
COLOUR = {1: 0, 3: 2, 4: 6}
SIGNATURE = b"\x89PNG\r\n\x1a\n"
LEVEL = 1  # of zlib, twice as fast as the next one for a twentieth more bytes
NO_FILTER, UP = 0, 2
MAX_WAITING = 4  # bands that are being compressed or wait to be written
KEYWORD = b"Comment"
END = struct.pack(">I", 0) + b"IEND" + struct.pack(">I", zlib.crc32(b"IEND"))


class PngFile:
    """A file of whole numbers that is written from the top."""

    def __init__(
        self, path: Path, side: int, channels: int, depth: int, text: str, pool: Executor, lines: int = 0
    ) -> None:
        """Create the file with its header.

        `side`: texels of a line, and lines unless `lines` is given. `channels`: their number, a key of COLOUR. `depth`:
        bits of a value, 8 or 16. `text`: comment in the header. `pool` compresses bands while the next ones are
        computed.
        """
        self._waiting: list[Future] = []
        self._pool, lines = pool, lines or side
        # The checksum of the rows so far, and the bytes of those to come: each has one byte for its filter.
        self._adler, self._bytes_left = 1, lines * (1 + side * channels * depth // 8)
        self._file = open(path, "wb")
        self._file.write(SIGNATURE)
        self._write_chunk(b"IHDR", struct.pack(">IIBBBBB", side, lines, depth, COLOUR[channels], 0, 0, 0))
        self._write_chunk(b"tEXt", KEYWORD + b"\0" + text.encode("latin-1"))
        self._write_chunk(b"IDAT", b"\x78\x01")  # the head of a zlib stream

    def add(self, rows: np.ndarray) -> None:
        """Write the next rows, uint8 [rows, bytes of a row], 16-bit numbers with the higher byte first.

        The call with the file's last row ends the stream of compressed data.
        """
        filtered = np.empty((len(rows), 1 + rows.shape[1]), np.uint8)
        filtered[:, 0], filtered[0, 0] = UP, NO_FILTER  # bands are independent
        filtered[0, 1:] = rows[0]
        np.subtract(rows[1:], rows[:-1], out=filtered[1:, 1:])
        self._bytes_left -= filtered.size
        self._waiting.append(self._pool.submit(_compress_block, filtered, self._bytes_left == 0))
        while len(self._waiting) > MAX_WAITING:
            self._write_oldest()

    def close(self) -> None:
        """Write the waiting blocks, the checksum and the end, and close the file."""
        while self._waiting:
            self._write_oldest()
        self._write_chunk(b"IDAT", struct.pack(">I", self._adler))
        self._file.write(END)
        self._file.close()

    def abandon(self) -> None:
        """Close the file without completing it, after an error. Waiting blocks are not written."""
        for future in self._waiting:
            future.cancel()
        self._file.close()

    def _write_oldest(self) -> None:
        """Wait for the oldest compressed block, add it to the checksum and append it to the file."""
        data, raw = self._waiting.pop(0).result()
        self._adler = zlib.adler32(raw, self._adler)
        self._write_chunk(b"IDAT", data)

    def _write_chunk(self, kind: bytes, data: bytes) -> None:
        """Write a chunk: length, kind, data and checksum."""
        self._file.write(struct.pack(">I", len(data)) + kind)
        self._file.write(data)
        self._file.write(struct.pack(">I", zlib.crc32(data, zlib.crc32(kind))))


def _compress_block(rows: np.ndarray, last: bool) -> tuple[bytes, np.ndarray]:
    """Compress a block of rows as a part of one deflate stream; last: whether it ends the stream.

    Returns the bytes and the rows, for the checksum.
    """
    compressor = zlib.compressobj(LEVEL, zlib.DEFLATED, -15)  # negative: without the head of a zlib stream
    data = compressor.compress(rows.data)
    return data + compressor.flush(zlib.Z_FINISH if last else zlib.Z_SYNC_FLUSH), rows


def comment_of(path: Path) -> str | None:
    """Return the comment of a complete file, None for a file that is incomplete, of another kind or without one."""
    try:
        with open_regular(path, links=True) as file:
            head = file.read(4096)
            file.seek(-len(END), 2)
            is_complete = file.read() == END
    except OSError:
        return None
    # A chunk: length of its content, type, content (keyword, 0, text).
    start = head.find(b"tEXt" + KEYWORD + b"\0")
    if not is_complete or not head.startswith(SIGNATURE) or start < 4:
        return None
    (length,) = struct.unpack(">I", head[start - 4 : start])
    return head[start + 4 + len(KEYWORD) + 1 : start + 4 + length].decode("latin-1")
