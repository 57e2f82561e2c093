"""Take a picture of `tsa dashboard` during a demo with a headless Chromium.

Usage: tools/run figures/dashboard [--out .readme/dashboard.png] [--seconds 8] [--width 1100]

The command starts the demo, the dashboard on the daemon's socket, and Chromium.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.dashboard.chromium import chromium
from tools import command
from tsa_ctrl.errors import BusError
from tsa_ctrl.system.process_supervisor import end_process, tsa

PATIENCE = 60.0  # s for the daemon's socket


@contextmanager
def running(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(tsa(*arguments), stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        yield process
    finally:
        end_process(process, 60.0)


def socket_in(folder: Path) -> Path:
    """Return the socket of the daemon in `folder` as soon as it is in the phase "running"."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        for path in folder.rglob("*.sock"):
            asked = subprocess.run(tsa("status", "--json", "--socket", str(path)), capture_output=True, text=True)
            if asked.returncode == 0 and '"running"' in asked.stdout:
                return path
        time.sleep(0.2)
    raise BusError(f"no daemon came up in {folder}; run tsa demo and read its messages")


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--out", type=Path, default=command.ROOT / ".readme" / "dashboard.png")
    parser.add_argument("--seconds", type=float, default=8.0, help="of motion before the picture")
    parser.add_argument("--width", type=int, default=1100, help="px")
    options = parser.parse_args()
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if browser is None:
        raise BusError("no Chromium here; install the distribution's package chromium")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        seconds = str(options.seconds + 20.0)
        with running("demo", "--seconds", seconds, "--rate", "500", "--out", str(folder / "demo")):
            path = socket_in(folder)
            with running("dashboard", "--socket", str(path)) as page_server:
                assert page_server.stdout is not None
                address = page_server.stdout.readline().removeprefix("dashboard: ").strip()
                with chromium(browser, folder) as page:
                    page.open(address)
                    page.until("document.getElementById('phase')?.textContent === 'running'")
                    time.sleep(options.seconds)
                    page.resize(options.width)
                    time.sleep(1.0)  # the charts have the new width after the next redraw
                    page.picture(options.out, options.width, page.evaluate("document.body.scrollHeight"))
    print(options.out)
    return 0
