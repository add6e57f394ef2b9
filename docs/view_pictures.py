"""Makes the pictures of docs/view.md: a report, a live view, and two runs side by side.

python docs/view_pictures.py RUN RUN     # e.g. runs/demo runs/thin
"""

import asyncio
import sys
import tempfile
import threading
from pathlib import Path

from scenarios.runner import run
from scenarios.schema import load
from scenarios.view.chromium import Tab, browser, find_browser
from scenarios.view.compare import read_all, write_comparison
from scenarios.view.livepage import LivePage
from scenarios.view.report import write_report

IMAGES = Path(__file__).parent / "images"
READY = "document.documentElement?.dataset.ready"
SETTLE_S = 1.0
"""Wall seconds that a page has to draw itself."""
LIVE_SETS = ("air=memory", "limit_s=700")
CUT_AFTER_S = 300


async def shoot(tab: Tab, name: str) -> None:
    """Take a picture of what is on the screen."""
    await tab.until(READY)
    await asyncio.sleep(SETTLE_S)
    await tab.picture(IMAGES / name)


async def live(tab: Tab, folder: Path) -> None:
    """Take a picture of a run that goes on, with a robot cut off."""
    said: list[str] = []
    page = LivePage(opens=False, say=said.append)
    scenario = load("cliff", LIVE_SETS)
    thread = threading.Thread(target=lambda: run(scenario, folder, quiet=True, page=page))
    thread.start()
    while not said:
        await asyncio.sleep(0.1)
    await tab.open(said[0].split()[-1])
    await tab.until(f"Number(document.querySelector('.track input')?.value) > {CUT_AFTER_S}", 600)
    await tab.value("document.querySelectorAll('[data-deed=cut]')[1].click()")
    await tab.until("document.querySelector('.said').textContent.includes('cut off')")
    await asyncio.sleep(2 * SETTLE_S)
    await tab.value("document.querySelector('.runbar .play').click()")
    await tab.until("document.querySelector('.status').textContent === 'Paused'")
    await shoot(tab, "live.png")
    assert page.desk is not None
    page.desk.ask({"do": "go"})
    while thread.is_alive():
        await asyncio.sleep(0.1)


async def main(runs: list[Path]) -> None:
    """Make all pictures."""
    program = find_browser()
    if program is None:
        sys.exit("no Chromium was found; Debian's package is called chromium")
    with tempfile.TemporaryDirectory() as folder:
        async with browser(program) as tab:
            await tab.size(1280, 1010)
            await tab.open(f"{write_report(runs[0]).absolute().as_uri()}#t=700")
            await shoot(tab, "report.png")
            await tab.size(1280, 760)
            page = write_comparison(read_all(runs), Path(folder) / "compare.html")
            await tab.open(page.as_uri())
            await tab.until("document.title.startsWith('Runs')")
            await shoot(tab, "compare.png")
            await tab.size(1280, 900, dark=True)
            await live(tab, Path(folder) / "run")


if __name__ == "__main__":
    asyncio.run(main([Path(argument) for argument in sys.argv[1:]]))
