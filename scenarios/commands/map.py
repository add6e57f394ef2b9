"""`ropeteam map`: your own elevation maps in few bytes, and back."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from scenarios.commands.parsing import OK, Commands, Parser, number
from scenarios.errors import UsageError

if TYPE_CHECKING:
    from scenarios.formats.rtm import ElevationMap

_DESCRIPTION = """\
Packs an elevation map so that every known cell comes back within a bound that you choose, and the
unknown cells exactly. IN is an .npz (elevation in m, NaN unknown, row 0 north; cell_size in m;
optional: origin, crs, sigma) or a GeoTIFF.
"""
_EXAMPLES = """\
examples:
  ropeteam map pack ground.npz ground.rtm --max-error 0.05
  ropeteam map info ground.rtm
  ropeteam map unpack ground.rtm again.npz
"""


def add(commands: Commands) -> None:
    """Add the command."""
    command = commands.add_parser(
        "map",
        help="pack elevation maps into few bytes, and unpack them",
        description=_DESCRIPTION,
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    actions = command.add_subparsers(
        dest="action", metavar="ACTION", required=True, parser_class=Parser
    )
    pack = actions.add_parser("pack", help="make an .rtm of an .npz or a GeoTIFF")
    pack.add_argument("source", metavar="IN", type=Path)
    pack.add_argument("target", metavar="OUT.rtm", type=Path)
    pack.add_argument(
        "--max-error", type=number, required=True, metavar="M", help="of any known cell, metres"
    )
    pack.add_argument(
        "--cell-m", type=number, metavar="M", help="of a GeoTIFF that does not give it in metres"
    )
    pack.set_defaults(run=_pack)
    unpack = actions.add_parser("unpack", help="make an .npz of an .rtm")
    unpack.add_argument("source", metavar="IN.rtm", type=Path)
    unpack.add_argument("target", metavar="OUT.npz", type=Path)
    unpack.set_defaults(run=_unpack)
    for writing in (pack, unpack):
        writing.add_argument("--overwrite", action="store_true", help="replace OUT if it exists")
    info = actions.add_parser("info", help="say what a map holds")
    info.add_argument("source", metavar="FILE", type=Path, help="an .rtm, .npz or GeoTIFF")
    info.set_defaults(run=_info)


def _pack(args: argparse.Namespace) -> int:
    _check_target(args, ".rtm")
    from scenarios.formats.maps import npz_bytes, read_map
    from scenarios.formats.rtm import pack, unpack, write_file

    given = read_map(args.source, args.cell_m)
    data = pack(given, args.max_error)
    found_m = _largest_error_m(given, unpack(data, str(args.target)).map)
    write_file(args.target, data)
    cells = given.elevation_m.size
    deflated = len(npz_bytes(given))
    print(f"{args.target}: {len(data):,} bytes, {8 * len(data) / cells:.2f} bits per cell")
    print(f"  {_what(given)}")
    print(f"  {4 * cells / len(data):,.1f} times smaller than float32 ({4 * cells:,} bytes)")
    print(
        f"  {deflated / len(data):,.1f} times smaller than .npz with deflate ({deflated:,} bytes)"
    )
    print(f"  largest error found when decoded again {found_m:.6g} m, of {args.max_error:g} m")
    return OK


def _unpack(args: argparse.Namespace) -> int:
    _check_target(args, ".npz")
    from scenarios.formats.maps import npz_bytes
    from scenarios.formats.rtm import read_packed, write_file

    packed = read_packed(args.source)
    data = npz_bytes(packed.map)
    write_file(args.target, data)
    print(f"{args.target}: {len(data):,} bytes; {_what(packed.map)}")
    print(f"  every known cell within {packed.max_error_m:g} m of the map that was packed")
    return OK


def _info(args: argparse.Namespace) -> int:
    from scenarios.formats.maps import read_map
    from scenarios.formats.rtm import is_packed, read_packed

    _check_exists(args.source)
    if is_packed(args.source):
        packed = read_packed(args.source)
        found = packed.map
        bits = 8 * packed.bytes / found.elevation_m.size
        print(f"{args.source}: {packed.bytes:,} bytes, {bits:.2f} bits per cell")
        print(f"  every known cell within {packed.max_error_m:g} m of the map that was packed")
    else:
        found = read_map(args.source)
        print(f"{args.source}: {args.source.stat().st_size:,} bytes")
    print(f"  {_what(found)}")
    for line in _more(found):
        print(f"  {line}")
    return OK


def _what(elevations: "ElevationMap") -> str:
    """Return size, cells and how much is known, in a line."""
    import numpy as np

    rows, cols = elevations.elevation_m.shape
    share = 100 * float(np.isfinite(elevations.elevation_m).mean())
    width_m, height_m = cols * elevations.cell_m, rows * elevations.cell_m
    return (
        f"{rows} x {cols} cells of {elevations.cell_m:g} m ({width_m:g} m east, {height_m:g} m"
        f" north), {share:.1f} % known"
    )


def _more(elevations: "ElevationMap") -> list[str]:
    """Return heights, standard deviations and place, as far as there are such."""
    import numpy as np

    told: list[str] = []
    for name, values in (("heights", elevations.elevation_m), ("sigmas", elevations.sigma_m)):
        if values is not None and np.isfinite(values).any():
            told.append(f"{name} {np.nanmin(values):.6g} to {np.nanmax(values):.6g} m")
    if elevations.origin_m is not None:
        east, north = elevations.origin_m
        told.append(f"south-west corner {east:.10g} east, {north:.10g} north")
    if elevations.crs is not None:
        told.append(f"CRS {elevations.crs}")
    return told


def _largest_error_m(given: "ElevationMap", found: "ElevationMap") -> float:
    """Return the largest error of a cell; the masks are the same, or it is a fault of ours."""
    import numpy as np

    known = np.isfinite(given.elevation_m)
    assert np.array_equal(known, np.isfinite(found.elevation_m)), "the mask has changed"
    error_m = np.abs(given.elevation_m - found.elevation_m)[known]
    return float(error_m.max(initial=0.0))


def _check_target(args: argparse.Namespace, suffix: str) -> None:
    """Refuse what can't be read or may not be written, before any work."""
    target: Path = args.target
    _check_exists(args.source)
    if target.suffix.lower() != suffix:
        raise UsageError(f"{target}: must end in {suffix}")
    if not target.parent.is_dir():
        raise UsageError(f"{target}: its folder {target.parent} does not exist")
    if target.exists() and (target.is_dir() or not args.overwrite):
        what = "is a folder" if target.is_dir() else "exists; add --overwrite to replace it"
        raise UsageError(f"{target}: {what}")


def _check_exists(source: Path) -> None:
    if not source.is_file():
        raise UsageError(
            f"{source}: does not exist" if not source.exists() else f"{source}: is no file"
        )
