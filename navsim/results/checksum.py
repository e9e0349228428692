"""Checksums at the end of a file, and reading with checks.

A file with checksums is its content, then the SHA-256 of each block of the content, then a footer: the content's length
in bytes (8 bytes, little-endian), the SHA-256 of checksums and length, `MARK`. HDF5 does not look beyond its own end,
so other programs read such a result as usual. Only blocks that are read are checked, before their data are returned. A
large file need not be read as a whole, and HDF5 never meets a damaged byte.
"""

from __future__ import annotations

import hashlib
import io
import os
import struct
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, BinaryIO

BLOCK = 65536
"""Bytes under one checksum."""
MARK = b"navsim checksums"
_DIGEST = hashlib.sha256().digest_size
_FOOTER = struct.Struct(f"<Q{_DIGEST}s{len(MARK)}s")
_STRETCH = 64 * BLOCK
"""Bytes that a thread takes on at once."""
_THREADS = 4
"""Number of threads that compute checksums for a tenth of a second, for any number of workers."""
_REMEMBERED = 64
"""Number of cached blocks, since HDF5 reads its metadata in small pieces."""


class CorruptFile(OSError):
    """A file that is not as it was written."""


def checksum_trailer(size: int, part: Callable[[int, int], bytes | memoryview]) -> bytes:
    """Trailer for a content of this size, bytes.

    part: returns the bytes from one position up to another, in several threads at once. Raises Damaged if it returns
    fewer, and its errors.
    """

    def digests(first: int) -> bytes:
        out = bytearray()
        for start in range(first, min(first + _STRETCH, size), BLOCK):
            end = min(start + BLOCK, size)
            block = part(start, end)
            if len(block) != end - start:
                raise CorruptFile("it became shorter while it was written")
            out += hashlib.sha256(block).digest()
        return bytes(out)

    with ThreadPoolExecutor(_THREADS) as pool:
        table = b"".join(pool.map(digests, range(0, size, _STRETCH)))
    return table + _FOOTER.pack(size, _digest(table, size), MARK)


def _digest(table: bytes, length: int) -> bytes:
    return hashlib.sha256(table + length.to_bytes(8, "little")).digest()


class Reader(io.RawIOBase):
    """Content of a file, checked while it is read if the file has checksums.

    sealed: whether it has. size: of the content, bytes. damage: errors so far; callers check it, since HDF5 may hide a
    failed read.
    """

    def __init__(self, file: BinaryIO) -> None:
        """file: open for reading; the reader owns it. Raises Damaged if the checksums themselves are damaged."""
        super().__init__()
        self.damage: str | None = None
        self._file = file
        self._at = 0
        self._kept: dict[int, bytes] = {}
        self._table = b""
        self.size = os.fstat(file.fileno()).st_size
        self.sealed = False
        if self.size >= _FOOTER.size:
            file.seek(self.size - _FOOTER.size)
            length, digest, mark = _FOOTER.unpack(file.read(_FOOTER.size))
            if mark == MARK:
                self._unseal(length, digest)

    def _unseal(self, length: int, digest: bytes) -> None:
        count = -(-length // BLOCK)
        if length + count * _DIGEST + _FOOTER.size != self.size:
            raise CorruptFile("its length is not the one it was written with")
        self._file.seek(length)
        self._table = self._file.read(count * _DIGEST)
        if _digest(self._table, length) != digest:
            raise CorruptFile("its checksums are damaged")
        self.size, self.sealed = length, True

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        self._at = offset + {os.SEEK_SET: 0, os.SEEK_CUR: self._at, os.SEEK_END: self.size}[whence]
        return self._at

    def tell(self) -> int:
        return self._at

    def readinto(self, buffer: Any) -> int:
        """Fill the buffer. Raises Damaged where a checksum does not fit, or the file ends before."""
        wanted = memoryview(buffer).cast("B")
        try:
            if self._at < 0 or self._at + len(wanted) > self.size:
                raise CorruptFile("it ends before its data do")
            if self.sealed:
                done = 0
                while done < len(wanted):
                    index, offset = divmod(self._at + done, BLOCK)
                    piece = self._block(index)[offset : offset + len(wanted) - done]
                    wanted[done : done + len(piece)] = piece
                    done += len(piece)
            else:
                self._file.seek(self._at)
                if self._file.readinto(wanted) != len(wanted):  # type: ignore[attr-defined]
                    raise CorruptFile("it ends before its data do")
        except OSError as error:
            self.damage = self.damage or error.strerror or str(error)
            raise
        self._at += len(wanted)
        return len(wanted)

    def _block(self, index: int) -> bytes:
        """A block of the content, checked."""
        found = self._kept.get(index)
        if found is None:
            self._file.seek(index * BLOCK)
            found = self._file.read(min(BLOCK, self.size - index * BLOCK))
            if hashlib.sha256(found).digest() != self._table[index * _DIGEST : (index + 1) * _DIGEST]:
                raise CorruptFile("a checksum does not fit: its content is not as it was written")
            if len(self._kept) >= _REMEMBERED:
                del self._kept[next(iter(self._kept))]
            self._kept[index] = found
        return found

    def close(self) -> None:
        self._file.close()
        super().close()
