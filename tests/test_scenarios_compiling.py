"""Shares of compiled kernels, put together."""

from pathlib import Path

from scenarios.compiling import put_together


def kept(cache: Path) -> dict[str, str]:
    return {
        str(path.relative_to(cache)): path.read_text()
        for path in sorted(cache.rglob("*"))
        if path.is_file()
    }


def test_what_two_shares_compiled_is_kept_once_and_whole(tmp_path: Path) -> None:
    # A part has other versions in each share: its index goes only with its own data.
    one = {"m/k.nbi": "1", "m/k.1.nbc": "k one", "m/part.nbi": "a", "m/part.1.nbc": "part of a"}
    two = {"m/part.nbi": "b", "m/part.1.nbc": "x", "m/part.2.nbc": "y", "n/l.nbi": "2"}
    for name, files in (("one", one), ("two", two)):
        for file, text in files.items():
            path = tmp_path / name / file
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
    cache = tmp_path / "all"
    for name in ("one", "two", "nothing"):
        put_together(tmp_path / name, cache)
    assert kept(cache) == {**one, "n/l.nbi": "2"}
