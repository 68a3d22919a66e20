"""Pictures that notebooks show."""

import struct
import zlib

import numpy as np
from numpy.typing import NDArray


class Picture(np.ndarray):
    """An array of height x width x 3 bytes, which a notebook shows as a picture."""

    def _repr_png_(self) -> bytes | None:
        if self.ndim != 3 or self.shape[2] != 3 or self.dtype != np.uint8 or not self.size:
            return None
        return png(self)


def picture(pixels: bytes, width: int, height: int) -> Picture:
    """A picture that can be written to."""
    return np.frombuffer(pixels, np.uint8).reshape(height, width, 3).copy().view(Picture)


def png(pixels: NDArray[np.uint8]) -> bytes:
    """A PNG file of height x width x 3 bytes."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    height, width, _ = pixels.shape
    lines = np.zeros((height, 1 + 3 * width), np.uint8)
    lines[:, 1:] = pixels.reshape(height, 3 * width)
    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    data = zlib.compress(lines.tobytes(), 6)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", data) + chunk(b"IEND", b"")
