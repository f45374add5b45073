"""PNG files of opaque pictures: rows as they are, which zlib packs smaller than rows filtered as photographs are.

Pillow, which matplotlib uses, tries all filters on every row: three times as long, for larger files.
"""

from __future__ import annotations

import struct
import zlib
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

SIGNATURE = b"\x89PNG\r\n\x1a\n"
RGB = bytes([8, 2, 0, 0, 0])  # eight bits a channel, three channels, deflated, filters by row, not interlaced
LEVEL = 3  # levels above take long and gain little
INCH = 0.0254  # metres


def write_png(stream: BinaryIO, pixels: NDArray[np.uint8], dpi: float) -> None:
    """Write an opaque picture.

    Arguments:
        stream: the file, open for writing.
        pixels: red, green and blue, and more that is left out; shape (height, width, 3 or more).
        dpi: pixels an inch.
    """
    height, width = pixels.shape[:2]
    rows = np.zeros((height, 1 + 3 * width), dtype=np.uint8)  # each row begins with its filter: none
    for channel in range(3):  # one at a time takes a seventh of the time: numpy is slow along three
        rows[:, 1 + channel :: 3] = pixels[..., channel]
    metre = round(dpi / INCH)
    stream.write(SIGNATURE)
    for kind, content in (
        (b"IHDR", struct.pack(">II", width, height) + RGB),
        (b"pHYs", struct.pack(">IIB", metre, metre, 1)),
        (b"IDAT", zlib.compress(rows.data, LEVEL)),
        (b"IEND", b""),
    ):
        stream.write(struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content)))
