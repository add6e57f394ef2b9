"""What others make of an occupancy map: image coders, general compressors, OctoMap.

Each peer gets symbols 0..15 of `comms.occupancy.classes` (layers, rows, cols) and gives the bytes
that a receiver needs, sizes of the map left out. Peers that are not installed are left out.
"""

import io
import lzma
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from comms.occupancy.classes import STATE_OF, log_odds_of

Symbols = NDArray[np.uint8]
Peer = Callable[[Symbols], int]


def dense(symbols: Symbols) -> Symbols:
    """Return the symbols numbered from 0 without gaps, in the order of log odds.

    Not known comes between free and occupied, as it does in published maps.
    """
    order = np.r_[1:9, 0, 9:16]
    present = [int(symbol) for symbol in order if (symbols == symbol).any()]
    rank = np.zeros(16, np.uint8)
    rank[present] = range(len(present))
    return rank[symbols]


def packed(symbols: Symbols) -> bytes:
    """Return the symbols in 1, 2 or 4 bits each."""
    ranks = dense(symbols).ravel()
    bits = next(b for b in (1, 2, 4) if ranks.max() < 1 << b)
    planes = (ranks[:, None] >> np.arange(bits - 1, -1, -1)) & 1
    return np.packbits(planes).tobytes()


def picture(symbols: Symbols) -> Symbols:
    """Return a picture (rows, cols): the layers of a block one below the other."""
    return np.ascontiguousarray(dense(symbols).reshape(-1, symbols.shape[2]))


def png(symbols: Symbols) -> int:
    """PNG at its strongest, in as few bits per pixel as will do or in eight."""
    from PIL import Image  # noqa: PLC0415 (optional)

    ranks, sizes = picture(symbols), []
    bits = next(b for b in (1, 2, 4) if ranks.max() < 1 << b)
    for depth in (bits, 8):
        image = Image.fromarray(ranks, "P")
        image.putpalette([k // 3 for k in range(3 << bits)])
        file = io.BytesIO()
        image.save(file, "png", optimize=True, compress_level=9, bits=depth)
        sizes.append(len(file.getvalue()))
    done, data = cv2.imencode(".png", ranks, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    return min([*sizes, len(data)] if done else sizes)


def jpeg_xl(symbols: Symbols) -> int:
    """JPEG XL, lossless, effort 9, of ranks or of ranks spread over the greys."""
    import imagecodecs  # noqa: PLC0415

    ranks = picture(symbols)
    greys = (ranks * (255 // max(int(ranks.max()), 1))).astype(np.uint8)
    return min(
        len(imagecodecs.jpegxl_encode(image, lossless=True, effort=9)) for image in (ranks, greys)
    )


def webp(symbols: Symbols) -> int:
    """WebP, lossless, at its strongest."""
    import imagecodecs  # noqa: PLC0415

    image = np.repeat(picture(symbols)[..., None], 3, 2)
    return len(imagecodecs.webp_encode(image, lossless=True, level=6, method=6))


def jbig(symbols: Symbols) -> int:
    """JBIG (T.82; JBIG2's generic coding is of this kind) of two planes: known, and occupied."""
    states = picture(STATE_OF[symbols])
    planes = [states != 1, states == 2]
    return sum(_jbig_plane(plane) for plane in planes if plane.any() and not plane.all())


def _jbig_plane(plane: NDArray[np.bool_]) -> int:
    rows, cols = plane.shape
    bitmap = b"P4\n%d %d\n" % (cols, rows) + np.packbits(plane, axis=1).tobytes()
    run = subprocess.run(["pbmtojbg", "-q"], input=bitmap, capture_output=True, check=True)
    return len(run.stdout)


def zstd(symbols: Symbols) -> int:
    import zstandard  # noqa: PLC0415

    data = zstandard.ZstdCompressor(level=19)
    return min(len(data.compress(raw)) for raw in (packed(symbols), dense(symbols).tobytes()))


def brotli(symbols: Symbols) -> int:
    return min(_brotli(raw) for raw in (packed(symbols), dense(symbols).tobytes()))


def xz(symbols: Symbols) -> int:
    """LZMA without container."""
    preset = 9 | lzma.PRESET_EXTREME
    return min(
        len(lzma.compress(raw, format=lzma.FORMAT_ALONE, preset=preset))
        for raw in (packed(symbols), dense(symbols).tobytes())
    )


def _brotli(raw: bytes) -> int:
    import brotli  # noqa: PLC0415

    return len(brotli.compress(raw, quality=11))


def octomap_files(symbols: Symbols) -> dict[str, int]:
    """Return the sizes of OctoMap's two files, without headers, as they are and in brotli.

    .bt keeps free, occupied and not known (two bits a child); .ot the log odds (five bytes a node).
    Both after pruning, in the tree that OctoMap makes itself.
    """
    import pyoctomap  # noqa: PLC0415

    tree = pyoctomap.OcTree(0.1)
    tree.setClampingThresMin(0.001)
    tree.setClampingThresMax(0.999)
    log_odds = log_odds_of(symbols)
    for z, y, x in np.argwhere(symbols > 0):
        value = float(log_odds[z, y, x]) or -1e-3
        tree.updateNode(np.array([x, y, z]) * 0.1 + 0.05, value)
    found: dict[str, int] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, write in ((".ot", tree.write), (".bt", tree.writeBinary)):
            path = Path(folder) / f"map{name}"
            write(str(path))
            data = path.read_bytes().split(b"data\n", 1)[1]
            found[f"OctoMap {name}"] = len(data)
            found[f"OctoMap {name}, brotli"] = _brotli(data)
    return found


def peers() -> dict[str, Peer]:
    """Return the peers that are installed, for maps of any kind."""
    found: dict[str, Peer] = {}
    if find_spec("PIL"):
        found["PNG"] = png
    if find_spec("imagecodecs"):
        found |= {"JPEG XL": jpeg_xl, "WebP": webp}
    if find_spec("zstandard"):
        found["zstd 19"] = zstd
    if find_spec("brotli"):
        found["brotli 11"] = brotli
    return found | {"xz": xz}


def of_three_states() -> dict[str, Peer]:
    """Return the peers that can hold three states only."""
    return {"JBIG": jbig} if shutil.which("pbmtojbg") else {}
