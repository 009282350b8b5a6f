"""A session's folder as a run leaves or fills it, and its page behind starlette's test client."""

from pathlib import Path

from starlette.testclient import TestClient

from retuner import Action, Decision, LoopSample, Mode, PidGains, load_config
from retuner.drivers.device import RunningSet
from retuner.ledger import Ledger
from retuner.live_view.loop_seen import LoopObserver
from retuner.live_view.watching_session import Publisher, head_of
from retuner.serve.application import PageAnswers
from retuner.serve.hub import Hub
from retuner.serve.page_access import PageAccess
from retuner.serve.runs import RecordedRuns
from retuner.session.assembly import make_retuner

ROOT = Path(__file__).resolve().parents[2]
HOST = "127.0.0.1:8017"
ORIGIN = {"origin": f"http://{HOST}"}
GAINS, AFTER = PidGains(0.22, 0.22 / 260), PidGains(0.88, 0.88 / 248)


class Clock:
    """A clock that stands until it is moved."""

    def __init__(self) -> None:
        self.s = 0.0

    def __call__(self) -> float:
        return self.s


class Session:
    """A session as far as its files go: samples, rows, decisions."""

    def __init__(self, folder: Path, loop: str = "oven", region: str = "low", by_hand: str = "") -> None:
        folder.mkdir()
        text = (ROOT / "examples" / "oven.toml").read_text(encoding="utf-8")
        text = text.replace('name = "oven"', f'name = "{loop}"', 1).replace('name = "low"', f'name = "{region}"', 1)
        (folder / "config.toml").write_text(text, encoding="utf-8")
        self.folder, self.region = folder, region
        self.config = load_config(folder / "config.toml")
        self.retuner = make_retuner(self.config)
        self.ledger = Ledger(folder / "ledger.sqlite")
        self.append("session", 0.0, {"config": self.config.summary(), "versions": {}})
        self.running: RunningSet | None = RunningSet(1, GAINS, 0)
        head = head_of(self.config, self.retuner.table) | {"by_hand": by_hand}
        self.publisher = Publisher(folder, head, LoopObserver(self.retuner, self), print)
        self.t_s = 0.0

    def append(self, kind: str, t_s: float, body: dict[str, object]) -> None:
        self.ledger.append(kind, {**body, "samples": 0}, t_s)

    def samples(self, count: int, pv: float = 50.0) -> None:
        for _ in range(count):
            self.t_s += 2.0
            sample = LoopSample(t_s=self.t_s, sp=50.0, pv=pv, co=15.0, x=50.0)
            self.retuner.observe(sample)
            self.publisher.sample(sample)

    def proposes(self, number: int = 1) -> Decision:
        """A proposal, in the ledger."""
        made = Decision(
            number=number,
            t_s=self.t_s,
            loop=self.config.loop.name,
            region=self.region,
            mode=Mode.ADVISE,
            action=Action.ADVISE,
            code="model",
            reason="the loop is slower than it could be",
            gains_before=GAINS,
            gains_after=AFTER,
        )
        self.append("decision", self.t_s, made.to_dict())
        return made

    def ends(self) -> None:
        self.append("end", self.t_s, {"interrupted": False})
        self.publisher.close()

    def close(self) -> None:
        self.publisher.close()
        self.ledger.close()


class Served:
    """Its page."""

    def __init__(self, root: Path, *, read_only: bool = False) -> None:
        self.clock = Clock()
        self.access = PageAccess([HOST], self.clock, secure=False, read_only=read_only, port=8017)
        self.hub = Hub(RecordedRuns(root))
        self.client = TestClient(PageAnswers(self.hub, self.access).application(), base_url=f"http://{HOST}")

    def look(self) -> None:
        """The hub takes in what has come."""
        for _ in range(6):
            self.hub.tick()

    def login(self) -> None:
        assert self.client.post("/api/login", json={"token": self.access.token}, headers=ORIGIN).status_code == 200

    def close(self) -> None:
        self.client.close()
        self.hub.runs.close()
