"""Make docs/page.svg, decision.svg and audit.svg: pages as a browser shows them, each light and dark in one picture.

python scripts/page_pictures.py [FOLDER]     FOLDER : keeps the demo's run for another time
"""

import base64
import io
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from PIL import Image
from selenium import webdriver

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
RETUNER = Path(sys.executable).parent / "retuner"
PORT = 8764
PATIENCE = 30
"""Most looks, at a server that starts and at a page that is drawn."""
COLOURS = 96
"""Of a picture: lines and words need no more."""
LOOK = "<style>.dark{display:none}@media(prefers-color-scheme:dark){.light{display:none}.dark{display:inline}}</style>"


def main(folder: Path) -> None:
    """Run what is needed, and look at it."""
    if not (folder / "runs" / "demo" / "report.html").exists():
        _retuner(folder, "run", str(ROOT / "examples" / "oven.toml"), "--out", "runs/demo")
    _retuner(folder, "report", "runs/demo", "--decision", "9", "--out", "decision.html")
    _retuner(ROOT, "audit", "examples/trends", "--out", str(folder / "audit"))
    with _served(folder):
        _picture("page", f"http://127.0.0.1:{PORT}/#/loop/demo/1", (1280, 860), "The live page of a loop")
    _picture("decision", (folder / "decision.html").as_uri(), (1000, 2900), "The page of a decision")
    _picture("audit", (folder / "audit" / "index.html").as_uri(), (1180, 700), "The page of an audit")


def _retuner(folder: Path, *words: str) -> None:
    subprocess.run([RETUNER, *words], cwd=folder, check=True, stdout=subprocess.DEVNULL)


@contextmanager
def _served(folder: Path) -> Iterator[None]:
    """The live page of what ran, for as long as it is looked at."""
    process = subprocess.Popen([RETUNER, "serve", "runs", "--read-only", "--port", str(PORT)], cwd=folder)
    try:
        for _ in range(PATIENCE):
            try:
                urllib.request.urlopen(f"http://127.0.0.1:{PORT}/").close()
                break
            except OSError:
                time.sleep(1.0)
        yield
    finally:
        process.terminate()
        process.wait()


def _picture(name: str, address: str, size: tuple[int, int], title: str) -> None:
    """Write one picture."""
    seen = {look: _seen(address, size, dark=look == "dark") for look in ("light", "dark")}
    images = "".join(
        f'<image class="{look}" width="{size[0]}" height="{size[1]}" href="data:image/png;base64,{data}"/>'
        for look, data in seen.items()
    )
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {size[0]} {size[1]}" role="img"><title>{title}</title>'
    )
    (DOCS / f"{name}.svg").write_text(f"{head}{LOOK}{images}</svg>\n", encoding="utf-8")


def _seen(address: str, size: tuple[int, int], *, dark: bool) -> str:
    """A page as PNG in base64."""
    options = webdriver.ChromeOptions()
    for flag in ("--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"):
        options.add_argument(flag)
    driver = webdriver.Chrome(options=options)
    try:
        measures = {"width": size[0], "height": size[1], "deviceScaleFactor": 1, "mobile": False}
        driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", measures)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [scheme]})
        driver.get(address)
        before, shot = b"", driver.get_screenshot_as_png()
        for _ in range(PATIENCE):  # what is drawn late is there when two looks are the same
            if before == shot:
                break
            time.sleep(2.0)
            before, shot = shot, driver.get_screenshot_as_png()
        image = Image.open(io.BytesIO(shot)).convert("RGB").quantize(COLOURS)
    finally:
        driver.quit()
    out = io.BytesIO()
    image.save(out, "PNG", optimize=True)
    return base64.b64encode(out.getvalue()).decode()


if __name__ == "__main__":
    if len(sys.argv) > 1:
        main(Path(sys.argv[1]))
    else:
        with tempfile.TemporaryDirectory() as made:
            main(Path(made))
