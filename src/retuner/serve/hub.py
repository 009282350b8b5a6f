"""What has moved since the last look, told to everybody who watches: one message a tick, made once for all.

A browser that lags is not waited for: it finds the messages that are still kept, or is told that there is a gap, and
asks for the trend of the time that it missed.
"""

import asyncio
import json
from collections import deque
from collections.abc import AsyncIterator, Iterable
from secrets import token_hex

from retuner.live_view.live_file import thinned
from retuner.serve.runs import RecordedRuns, WatchedLoop

TICK_S = 0.04  # time between two looks: a sample waits for half of that on average
LOOK_TICKS = 25  # ticks between two looks for new sessions, and for new rows of ledgers
KEPT = 500  # messages kept for those who come back: 20 s of them
AT_ONCE = 250  # samples of a loop in a message; where there are more (simulated time) they are thinned
SILENT_TICKS = 125  # ticks after which a word is said though nothing has moved, so that a dead connection is noticed
DECIMALS = 6
COLUMNS = 6  # The first so many FIELDS go out: t, sp, pv, co, region, limited


class Message:
    """What moved in a tick: by loop, and in ledgers. number : of the tick."""

    __slots__ = ("loops", "number", "rows", "texts")

    def __init__(self, number: int, loops: dict[str, str], rows: str) -> None:
        self.number, self.loops, self.rows = number, loops, rows
        self.texts: dict[frozenset[str] | None, bytes] = {}

    def text(self, wanted: frozenset[str] | None, boot: str) -> bytes:
        """The news as an event of a stream, for the wanted loops (None: all); empty where nothing of it is wanted."""
        if wanted not in self.texts:
            parts = [f'"{key}":{body}' for key, body in self.loops.items() if wanted is None or key in wanted]
            data = f'{{"loops":{{{",".join(parts)}}},"rows":{self.rows}}}'
            moved = bool(parts) or self.rows != "{}"
            self.texts[wanted] = f"id: {boot}-{self.number}\ndata: {data}\n\n".encode() if moved else b""
        return self.texts[wanted]


class Hub:
    """Looks at the runs for all who watch.

    runs : what there is to be seen.
    """

    def __init__(self, runs: RecordedRuns) -> None:
        self.runs = runs
        self.boot = token_hex(4)
        self.watchers = 0
        self._number = 0
        self._kept: deque[Message] = deque(maxlen=KEPT)
        self._moved = asyncio.Event()
        self._marks: dict[str, bytes] = {}

    async def run(self) -> None:
        """Look again and again."""
        while True:
            self.tick()
            await asyncio.sleep(TICK_S)

    def tick(self) -> None:
        """One look."""
        self._number += 1
        rows: dict[str, int] = {}
        if self._number % LOOK_TICKS == 1:
            self.runs.look()
        if self._number % 5 == 1:
            rows = {s.name: s.ledger.count for s in self.runs.sessions.values() if s.ledger.read_on()}
        loops = {loop.key: body for loop in self.runs.loops() if (body := self._loop(loop))}
        if loops or rows:
            self._kept.append(Message(self._number, loops, json.dumps(rows)))
            self._moved.set()
            self._moved = asyncio.Event()

    def _loop(self, loop: WatchedLoop) -> str:
        """What moved in a loop, as JSON; empty when nothing did."""
        fresh = loop.reader.since(loop.following)
        loop.following = fresh.following
        if not len(fresh.table):
            return ""
        table = thinned(fresh.table, AT_ONCE)[:, :COLUMNS]
        samples = json.dumps([[round(value, DECIMALS) for value in row] for row in table.tolist()])
        mark = loop.reader.mark()
        if mark == self._marks.get(loop.key):
            return f'{{"samples":{samples}}}'
        self._marks[loop.key] = mark
        return f'{{"samples":{samples},"state":{json.dumps(loop.reader.state())}}}'

    async def events(self, wanted: Iterable[str] | None, last: str) -> AsyncIterator[bytes]:
        """The stream for one browser, without an end. last : the id of the last event that it has seen, if any."""
        keys = None if wanted is None else frozenset(wanted)
        yield b"retry: 1000\n\n"
        boot, _, seen = last.partition("-")
        at = int(seen) if boot == self.boot and seen.isdecimal() else self._number
        if last and (boot != self.boot or not self._reaches(at)):
            yield b"event: gap\ndata: {}\n\n"
            at = self._number
        self.watchers += 1
        try:
            while True:
                moved = self._moved
                if at < self._number and not self._reaches(at):
                    yield b"event: gap\ndata: {}\n\n"
                    at = self._number
                new = b"".join(message.text(keys, self.boot) for message in self._kept if message.number > at)
                at = self._number
                if new:
                    yield new
                else:
                    try:
                        await asyncio.wait_for(moved.wait(), SILENT_TICKS * TICK_S)
                    except TimeoutError:
                        yield b": still here\n\n"
        finally:
            self.watchers -= 1

    def _reaches(self, number: int) -> bool:
        """Whether every message after a tick is still kept."""
        return len(self._kept) < KEPT or not self._kept or self._kept[0].number <= number + 1
