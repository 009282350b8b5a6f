"""What the page costs, and how late it is: CPU of its server by loops and browsers, delay from sample to browser.

    python benchmarks/page.py [--loops 32] [--rate 50] [--seconds 20] [--browsers 1]

A session's live files are written at the rate of a controller by this process; the server is `retuner serve` in a
process of its own; a browser is a socket that reads the stream. Delay: from the moment at which a sample is written to
the one at which its event has been read, by one clock. The share of a core is the server's own CPU time (user and
system) over the time that passed. The numbers depend on how busy the machine is: the load is told beside them.
"""

import argparse
import json
import os
import random
import socket
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from statistics import median

from many_loops import cpu_s

from retuner.config.loading import load_config
from retuner.ledger import Ledger
from retuner.live_view.live_file import LiveWriter
from retuner.live_view.watching_session import head_of
from retuner.session.outputs import live_file

ROOT = Path(__file__).resolve().parents[1]


def writers(folder: Path, loops: int) -> tuple[Ledger, list[LiveWriter]]:
    """A session of so many loops."""
    config = load_config(ROOT / "examples" / "oven.toml")
    ledger = Ledger(folder / "ledger.sqlite")
    ledger.append("session", {"config": config.summary(), "versions": {}, "samples": 0}, 0.0)
    head = head_of(config, config.gain_table())
    made = [LiveWriter(live_file(folder, i + 1), {**head, "loop": f"loop {i}"}) for i in range(loops)]
    return ledger, made


class Browser(threading.Thread):
    """Reads the stream; delays_s : of each event's newest sample of the first loop."""

    def __init__(self, port: int) -> None:
        super().__init__(daemon=True)
        self.delays_s: list[float] = []
        self.bytes = 0
        self._socket = socket.create_connection(("127.0.0.1", port))
        ask = f"GET /api/stream HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nAccept: text/event-stream\r\n\r\n"
        self._socket.sendall(ask.encode())

    def run(self) -> None:
        """Read until the server is gone."""
        left = b""
        while part := self._socket.recv(1 << 20):
            now_s = time.monotonic()
            self.bytes += len(part)
            left += part
            *whole, left = left.split(b"\n\n")
            for event in whole:
                at = event.find(b"data: {")
                if at >= 0:
                    told = json.loads(event[at + 6 :].split(b"\r\n")[0])
                    for moved in list(told["loops"].values())[:1]:
                        self.delays_s.append(now_s - moved["samples"][-1][0])


def play(made: list[LiveWriter], rate: float, seconds: float, seed: int) -> None:
    """Samples at their times; t is this machine's clock, so whoever reads it knows its age."""
    noise = random.Random(seed)
    begun = time.monotonic()
    for i in range(int(rate * seconds)):
        time.sleep(max(begun + i / rate - time.monotonic(), 0.0))
        for writer in made:
            t_s = time.monotonic()
            writer.sample((t_s, 50.0, 50.0 + noise.gauss(0.0, 0.1), 15.0, 0.0, 0.0, 1.0, 0.1, 0.0))
            if i % 50 == 0:
                writer.state({"t_s": t_s, "regions": [], "i": i})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--loops", type=int, default=32)
    parser.add_argument("--rate", type=float, default=50.0)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--browsers", type=int, default=1)
    parser.add_argument("--seed", type=int, default=20261122)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "run"
        folder.mkdir()
        ledger, made = writers(folder, options.loops)
        command = [sys.executable, "-P", "-m", "retuner", "serve", str(folder), "--port", "0", "--read-only"]
        server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        try:
            assert server.stdout is not None
            port = int(server.stdout.readline().strip().rstrip("/").rpartition(":")[2])
            browsers = [Browser(port) for _ in range(options.browsers)]
            for browser in browsers:
                browser.start()
            play(made, options.rate, 2.0, options.seed)
            for browser in browsers:
                browser.delays_s.clear()
                browser.bytes = 0
            before, begun = cpu_s(server.pid), time.monotonic()
            play(made, options.rate, options.seconds, options.seed + 1)
            passed = time.monotonic() - begun
            share = (cpu_s(server.pid) - before) / passed
        finally:
            server.kill()
            server.wait()
            ledger.close()
    delays = sorted(delay for browser in browsers for delay in browser.delays_s)
    told = {
        "loops": options.loops,
        "rate_hz": options.rate,
        "browsers": options.browsers,
        "seconds": round(passed, 1),
        "seed": options.seed,
        "server_share_of_a_core_pct": round(100 * share, 2),
        "delay_median_ms": round(1e3 * median(delays), 1),
        "delay_95_ms": round(1e3 * delays[int(0.95 * len(delays))], 1),
        "events": len(delays),
        "kB_per_s_and_browser": round(sum(b.bytes for b in browsers) / passed / len(browsers) / 1e3, 1),
        "load_average": os.getloadavg()[0],
    }
    print(json.dumps(told, indent=2))


if __name__ == "__main__":
    main()
