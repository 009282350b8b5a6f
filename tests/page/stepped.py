"""A session that goes on only when it is told to, on the whole stack in simulated time; its page in another process."""

import contextlib
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from rich.console import Console
from two_regions import two_regions

from retuner.config.loading import load_session
from retuner.ledger import Ledger
from retuner.live_view.live_screen import LiveScreen
from retuner.live_view.watching_session import Watching
from retuner.schedule.gains import PidGains
from retuner.session.running import Run

QUICK = two_regions(
    "advise", 600.0, "at_s = 0.0, sp = 2.0", "at_s = 20.0, sp = 3.0", "at_s = 50.0, sp = 2.0", "at_s = 80.0, sp = 3.0"
)


class Stepped:
    """The session. gains : what the controller runs, as it reports it."""

    def __init__(self, folder: Path, stack: contextlib.ExitStack) -> None:
        folder.mkdir()
        self.folder = folder
        (folder / "config.toml").write_text(QUICK, encoding="utf-8")
        config, _ = load_session(folder / "config.toml")
        self.ledger = stack.enter_context(Ledger(folder / "ledger.sqlite"))
        self.ledger.append("session", {"config": config.summary(), "versions": {}, "samples": 0}, 0.0)
        screen = LiveScreen(Console(), quiet=True)
        self.watching = Watching(screen, config, folder)
        run = Run(config, self._keep, observer=self.watching, folder=folder)
        self.session, self.bench = stack.enter_context(run.bench())
        stack.callback(self.watching.close)

    def _keep(self, kind: str, t_s: float, body: Mapping[str, object]) -> None:
        self.ledger.append(kind, body, t_s)

    @property
    def gains(self) -> PidGains:
        running = self.session.loops[0].device.running
        return running.gains

    def step(self, turns: int) -> None:
        for _ in range(turns):
            self.bench.turn()
            self.session.poll(self.bench.clock.now_s())

    def until_decided(self, count: int, most: int = 5000) -> None:
        for _ in range(most):
            if len(self.session.loops[0].decisions) >= count:
                return
            self.step(1)
        raise AssertionError(f"not {count} decisions within {most} turns")


@contextlib.contextmanager
def stepped(folder: Path) -> Iterator[Stepped]:
    with contextlib.ExitStack() as stack:
        yield Stepped(folder, stack)


class Server(NamedTuple):
    """The page's own process."""

    process: subprocess.Popen[str]
    address: str
    token: str

    @property
    def port(self) -> int:
        return int(self.address.rstrip("/").rpartition(":")[2])

    def end(self) -> None:
        self.process.kill()
        self.process.communicate()


def serving(folder: Path, port: int = 0) -> Server:
    """Start it; it is up when this returns."""
    command = [sys.executable, "-P", "-m", "retuner", "serve", str(folder), "--port", str(port)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    address = process.stdout.readline().split()[1]
    token = process.stdout.readline().split("#token=")[1].strip()
    return Server(process, address, token)
