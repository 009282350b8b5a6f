"""What people want done, as files in a session's folder: orders/NAME.json, written whole, taken once.

    approve : write a proposal, named by its hash          revert : back to the gains before a decision, in its region
    unlock  : let a locked-out region change again         reject : no to a proposal, or to what was tried and waits
    mode    : what may be done from now on, in a region or (without one) in all; off rolls back what is on trial
    propose : gains of one's own for a region, proved as any; they wait for approval

A running session looks for them at its samples; without one, the next session into the same folder finds them. A taken
file is moved to orders/taken/, one that is no order to orders/refused/: nothing that lies there can be taken again, and
nothing in it is trusted before every field has been looked at. Who ordered what and when goes into the ledger.
"""

import contextlib
import json
import os
import re
import secrets
import stat
from collections.abc import Iterable, Mapping
from enum import StrEnum
from pathlib import Path
from typing import Any, NamedTuple

from retuner.errors import UserError
from retuner.files import write_whole
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass
from retuner.schedule.plain_values import plain_values
from retuner.session.outputs import ORDERS

TAKEN, REFUSED = "taken", "refused"
LARGEST = 4096  # Bytes of an order file
LONGEST = 200  # characters of a text in it
MOST_DECISIONS = 10**9  # largest number of a decision
MOST_AT_ONCE = 16  # files looked at in one turn; the rest waits for the next one
LOOK_ANYWAY = 32
"""Turns after which the folder is listed even if its time has not changed: two files within one tick look like one."""
MOST_OF_A_MOMENT = 999  # orders of one kind and second
RANDOM_BYTES = 8  # bytes of the random part of a file's name
HASH = re.compile(r"[0-9a-f]{64}")
MOMENT = re.compile(r"[0-9]{4}-[0-9]{2}-[0-9]{2}T[0-9]{2}:[0-9]{2}:[0-9]{2}Z")


class OrderKind(StrEnum):
    """What is wanted."""

    APPROVE = "approve"
    REVERT = "revert"
    UNLOCK = "unlock"
    REJECT = "reject"
    MODE = "mode"
    PROPOSE = "propose"


HASHED = (OrderKind.APPROVE, OrderKind.REJECT)  # orders that name a decision by its hash
REGIONAL = (OrderKind.UNLOCK, OrderKind.PROPOSE)  # orders that need a region
GAINS = ("kp", "ki", "kd")
KINDS = {str: "text", int: "a whole number", dict: "kp, ki, kd"}
MODES = ("off", "advise", "trial", "auto")


@dataclass(frozen=True, slots=True)
class Order:
    """One order.

    by : who. at : when, UTC, as 2030-01-31T12:00:00Z. note : why, may be empty. digest : of the decision that is
    approved or rejected. decision : number of the one that is undone with all after it in its region. region : that is
    unlocked, or gets another mode (empty: all). mode : off, advise, trial or auto. gains : that are proposed.

    Raises ValueError: a field is missing for this kind, too long, or not of its form; the message names it.
    """

    kind: OrderKind
    by: str
    at: str
    note: str = ""
    digest: str = ""
    decision: int = 0
    region: str = ""
    mode: str = ""
    gains: PidGains | None = None

    def __post_init__(self) -> None:
        for name, text in (("by", self.by), ("note", self.note), ("region", self.region)):
            if len(text) > LONGEST or not text.isprintable():
                raise ValueError(f"{name} must be at most {LONGEST} characters that can be printed on one line")
        if not self.by.strip():
            raise ValueError("by is empty: an order names who gives it")
        if not MOMENT.fullmatch(self.at):
            raise ValueError("at must be a moment in UTC, as 2030-01-31T12:00:00Z")
        if self.kind in HASHED and not HASH.fullmatch(self.digest):
            raise ValueError("digest must be the 64 hexadecimal digits of the proposal's hash")
        if (self.mode in MODES) != (self.kind is OrderKind.MODE) or (self.mode and self.mode not in MODES):
            raise ValueError(f"mode must be one of {', '.join(MODES)} in an order of a mode, and empty in any other")
        if not (self.kind is OrderKind.REVERT) <= self.decision <= MOST_DECISIONS:
            raise ValueError("decision must be the number of a decision, 1 or more")
        if self.kind in REGIONAL and not self.region:
            raise ValueError(f"region must name the region to {self.kind}")
        if (self.gains is not None) != (self.kind is OrderKind.PROPOSE):
            raise ValueError("gains must be kp, ki, kd in an order that proposes them, and missing in any other")

    def to_dict(self) -> dict[str, object]:
        """Plain values."""
        own = [name for name in ("mode", "gains") if getattr(self, name)]
        return plain_values(self, " ".join(("order=kind by at note digest decision region", *own)))

    @classmethod
    def from_dict(cls, body: Mapping[str, Any]) -> "Order":
        """The order from its plain form, every field of its kind.

        Raises ValueError: a field is missing, unknown, or no value of its kind.
        """
        known = {"order": str, "by": str, "at": str, "note": str, "digest": str, "decision": int, "region": str}
        if body.get("order") == OrderKind.MODE:
            known["mode"] = str
        if body.get("order") == OrderKind.PROPOSE:
            known["gains"] = dict
        if set(body) != set(known):
            raise ValueError(f"fields must be {', '.join(known)}")
        for name, kind in known.items():
            if type(body[name]) is not kind:
                raise ValueError(f"{name} must be {KINDS[kind]}")
        if body["order"] not in tuple(OrderKind):
            raise ValueError(f"order must be {', '.join(OrderKind)}")
        order, by, at, note, digest, decision, region = (body[name] for name in list(known)[:7])  # every order's
        mode, gains = body.get("mode", ""), proposed_gains(body.get("gains"))
        return cls(OrderKind(order), by, at, note, digest, decision, region, mode, gains)


def proposed_gains(body: object) -> PidGains | None:
    """The gains of an order: an object with kp, ki and kd; None where there is none.

    Raises ValueError: it is something else, or no gains.
    """
    if body is None:
        return None
    named = body if isinstance(body, dict) else {}
    values = [named.get(name) for name in GAINS]
    if len(named) != len(GAINS) or any(type(value) not in {int, float} for value in values):
        raise ValueError("gains must be kp, ki and kd, each a number")
    with contextlib.suppress(OverflowError):
        return PidGains(*(float(value) for value in values if value is not None))
    raise ValueError("gains must be finite numbers")


def put_order(session: Path, order: Order) -> Path:
    """Put an order into a session's folder, whole or not at all; its file.

    Its name tells the moment, the kind and how many there were; a random part makes it nobody else's, so that people
    who order at one moment, from whatever process or thread, never write over each other.

    Raises UserError: there are too many orders of this moment. OSError: the system refuses.
    """
    folder = session / ORDERS
    folder.mkdir(exist_ok=True)
    stem = f"{order.at.replace(':', '').replace('-', '')}-{order.kind}-"
    names = {path.name for path in (*folder.glob(f"{stem}*.json"), *folder.glob(f"*/{stem}*.json"))}
    if len(names) >= MOST_OF_A_MOMENT:
        raise UserError(f"{folder}: holds a thousand orders of this moment; wait a second")
    path = folder / f"{stem}{len(names) + 1:03d}-{secrets.token_hex(RANDOM_BYTES)}.json"
    write_whole(path, json.dumps(order.to_dict(), indent=2) + "\n")
    return path


def read_order(path: Path) -> Order:
    """The order in a file.

    Raises ValueError: it is no plain file, too large, no JSON, or no order; the message says which.
    Raises OSError: it cannot be read.
    """
    state = path.lstat()
    if not stat.S_ISREG(state.st_mode):
        raise ValueError("is no plain file")
    if state.st_size > LARGEST:
        raise ValueError(f"has {state.st_size} bytes; an order has at most {LARGEST}")
    with path.open("rb") as stream:
        raw = stream.read(LARGEST + 1)
    try:
        body = json.loads(raw.decode("utf-8"))
    except (ValueError, RecursionError):
        raise ValueError("is no JSON document") from None
    return Order.from_dict(body if isinstance(body, dict) else {})


class OrderFile(NamedTuple):
    """A file in the folder: its name, and the order in it or why there is none."""

    name: str
    order: Order | None
    refused: str


class OrderBox:
    """The orders of one session's folder.

    session : the folder; orders/ in it need not exist. done : names of files there that were dealt with before.
    """

    def __init__(self, session: Path, done: Iterable[str] = ()) -> None:
        self._folder = session / ORDERS
        self._text = str(self._folder)
        self._changed = -1
        self._turns = 0
        self._more = False
        self._done = set(done)

    def take(self) -> list[OrderFile]:
        """Orders that came since the last call, oldest first; most turns cost one look at the folder's time."""
        self._turns += 1
        try:
            changed = os.stat(self._text).st_mtime_ns  # noqa: PTH116  at every sample; a Path costs three times as much
        except OSError:
            return []
        if changed == self._changed and not self._more and self._turns % LOOK_ANYWAY:
            return []
        self._changed = changed
        # what lies there and is not half written; subfolders are where the taken ones are
        names, put_away = list[str](), self._done | {TAKEN, REFUSED}
        with contextlib.suppress(OSError), os.scandir(self._text) as entries:  # where it fails midway, those it gave
            for one in entries:
                if not one.name.startswith(".") and one.name not in put_away:
                    names.append(one.name)
        names.sort()
        self._more = len(names) > MOST_AT_ONCE
        taken = []
        for name in names[:MOST_AT_ONCE]:
            self._done.add(name)
            try:
                found = OrderFile(name, read_order(self._folder / name), "")
            except ValueError as error:
                found = OrderFile(name, None, str(error))
            except OSError as error:
                found = OrderFile(name, None, f"cannot be read: {error.strerror}")
            taken.append(found)
            where = TAKEN if found.order else REFUSED
            with contextlib.suppress(OSError):  # what cannot be put away is remembered
                (self._folder / where).mkdir(exist_ok=True)
                (self._folder / name).rename(self._folder / where / name)
                self._done.discard(name)
        return taken
