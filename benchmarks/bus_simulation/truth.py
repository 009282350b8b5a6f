"""What really happened in the device, and the invariants over it: each promise of developers/protocol.md as a function.

Each takes what has just happened and raises ViolationError when a promise is broken. `Truth` only remembers.
"""

import math
from collections import Counter
from typing import NamedTuple

from retuner.drivers.device import RunningSet, WriteDone, WriteFailed
from retuner.drivers.protocol.frames import GainBox, newer
from retuner.schedule.gains import PidGains


class ViolationError(AssertionError):
    """A promise is broken; the message begins with the invariant's name."""


class Order(NamedTuple):
    """A set that somebody meant to run, whole: who is the life of a host, or the intruder."""

    epoch: int
    seq: int
    base: int
    gains: PidGains
    owner: int
    who: str


class Ran(NamedTuple):
    """A set began to run in a step."""

    step: int
    epoch: int
    seq: int
    gains: PidGains


class Truth:
    """The record of one run.

    first : set that runs at the start.
    box : that the device has certified.
    authentic : whether only hosts with the key may have sets committed.
    forged : whether somebody forges the device's own frames with right checksums: then a host may be deceived, and the
        invariants about what it believes say nothing.
    """

    def __init__(self, first: Ran, box: GainBox, *, authentic: bool, forged: bool) -> None:
        self.box, self.authentic, self.forged = box, authentic, forged
        self.orders: dict[tuple[int, int], list[Order]] = {}
        self.ran = [first]
        self.confirmed = {(first.seq, first.gains)}
        self.dead: set[PidGains] = set()
        self.newest_swapped: int | None = None
        self.swapped: set[int] = set()
        self.driven = False  # whether somebody has made the device's newest number leap in this epoch
        self.ledgers: dict[str, list[tuple[str, object]]] = {}
        self.counts: Counter[str] = Counter()

    def ordered(self, order: Order) -> None:
        """Somebody means this set to run."""
        self.orders.setdefault((order.epoch, order.seq), []).append(order)

    def began(self, ran: Ran) -> None:
        """A set runs from now on."""
        self.ran.append(ran)

    def running_since(self, step: int) -> list[Ran]:
        """The sets that ran at some time from step on, newest first."""
        found = []
        for ran in reversed(self.ran):
            found.append(ran)
            if ran.step < step:
                break
        return found


def running_set_is_a_committed_one(truth: Truth, now: Ran, holder: int) -> Order:
    """A swapped-in set is, gain for gain, one that somebody committed under this number in this boot epoch.

    When several meant the same, it is that of the lease's holder, and of these the one built on what ran before.
    """
    orders = [order for order in truth.orders.get((now.epoch, now.seq), ()) if order.gains == now.gains]
    if not orders:
        raise ViolationError(f"running_set_is_a_committed_one: {now} was ordered by nobody")
    base = truth.ran[-1].seq
    return min(orders, key=lambda order: (order.owner != holder, order.base != base))


def built_on_what_ran(order: Order, before: Ran) -> None:
    """A set replaces the one that its author had seen running."""
    if order.base != before.seq:
        raise ViolationError(f"built_on_what_ran: {order} replaced {before}")


def authentic(truth: Truth, order: Order) -> None:
    """With a key, only who has it gets a set committed."""
    if truth.authentic and order.who == "intruder":
        raise ViolationError(f"authentic: {order} has no right code")


def one_owner(order: Order, holder: int) -> None:
    """A commit is accepted from the holder of the lease alone."""
    if order.owner != holder:
        raise ViolationError(f"one_owner: {order} was accepted while {holder} held the lease")


def finite_and_inside_the_box(truth: Truth, now: Ran, before: Ran) -> None:
    """What the device has certified holds for every set that runs, and for the step to it."""
    box, new, old = truth.box, now.gains, before.gains
    pairs = ((new.kp, old.kp, box.kp_max), (new.ki, old.ki, box.ki_max), (new.kd, old.kd, box.kd_max))
    for value, last, largest in pairs:
        inside = math.isfinite(value) and abs(value) <= largest and value * box.direction >= 0
        near = not (value and last) or 1 / box.ratio_max <= value / last <= box.ratio_max
        if not (inside and near):
            raise ViolationError(f"finite_and_inside_the_box: {now} after {before}")


def sequence_is_monotonic(truth: Truth, now: Ran) -> None:
    """Within an epoch every swapped-in number is newer than all before it.

    Not when a forger has driven the numbers round their circle with leaps: then none is used twice all the same.
    """
    last, used = truth.newest_swapped, truth.swapped
    if now.seq in used or not (last is None or truth.driven or newer(now.seq, last)):
        raise ViolationError(f"sequence_is_monotonic: {now} after {last}")
    truth.newest_swapped = now.seq
    used.add(now.seq)


def restarted(truth: Truth) -> None:
    """Numbers begin anew in a new epoch."""
    truth.newest_swapped, truth.driven = None, False
    truth.swapped.clear()


def failed_sets_stay_dead(truth: Truth, now: Ran) -> None:
    """What was reported as failed does not run afterwards."""
    if not truth.forged and now.gains in truth.dead:
        raise ViolationError(f"failed_sets_stay_dead: {now} runs after it was reported as failed")


def reverted_to_the_confirmed_set(truth: Truth, now: Ran) -> None:
    """A set that was not confirmed gives way to one that was."""
    if (now.seq, now.gains) not in truth.confirmed:
        raise ViolationError(f"reverted_to_the_confirmed_set: {now} was never confirmed")


def restarted_on_a_confirmed_set(truth: Truth, now: Ran) -> None:
    """After a restart a stored set runs, and only confirmed ones are stored; or the commissioned one."""
    if (now.seq, now.gains) not in truth.confirmed:
        raise ViolationError(f"restarted_on_a_confirmed_set: {now} was never confirmed")


def reported_is_what_ran(truth: Truth, running: RunningSet, asked_step: int) -> None:
    """What a host reports as running ran at some time since it asked."""
    if truth.forged:
        return
    if not any((ran.seq, ran.gains) == (running.seq, running.gains) for ran in truth.running_since(asked_step)):
        raise ViolationError(
            f"reported_is_what_ran: {running} reported, since step {asked_step} ran {truth.running_since(asked_step)}"
        )


def done_is_what_was_ordered(outcome: WriteDone | WriteFailed, order: Order) -> None:
    """Done means that exactly the ordered gains run; failed that others do."""
    same = outcome.running.gains == order.gains
    if same != isinstance(outcome, WriteDone) or outcome.seq != order.seq:
        raise ViolationError(f"done_is_what_was_ordered: {outcome} for {order}")


def ledger_has_the_intent(rows: list[tuple[str, object]], order: Order) -> None:
    """A set that begins to run was in its host's ledger before."""
    if ("intent", order.gains) not in rows:
        raise ViolationError(f"ledger_has_the_intent: {order} runs, and its host's ledger does not know it")


def ledger_has_every_outcome(rows: list[tuple[str, object]], open_writes: int) -> None:
    """Every write of a host that did not die is done, failed or still open."""
    intents = sum(kind == "intent" for kind, _ in rows)
    ended = sum(kind in {"committed", "failed", "refused", "died"} for kind, _ in rows)
    if intents != ended + open_writes:
        raise ViolationError(f"ledger_has_every_outcome: {intents} intents, {ended} ended, {open_writes} open")


def time_goes_forward(last_s: float, t_s: float) -> None:
    """A host's samples never go back in time or repeat."""
    if t_s <= last_s:
        raise ViolationError(f"time_goes_forward: sample of {t_s} s after {last_s} s")


def known_after_calm(*, connected: bool, writing: bool, running: RunningSet | None, truth: Truth) -> None:
    """When the faults have stopped, the host gets to know what runs, within a bounded time, and it is right."""
    real = truth.ran[-1]
    if not connected or writing or running is None:
        raise ViolationError(f"known_after_calm: connected {connected}, writing {writing}, running {running}")
    if (running.seq, running.gains) != (real.seq, real.gains):
        raise ViolationError(f"known_after_calm: {running} believed, {real} runs")


def writes_succeed_in_calm(outcome: object) -> None:
    """On a healthy bus a legal write by the owner of the lease is done."""
    if not isinstance(outcome, WriteDone):
        raise ViolationError(f"writes_succeed_in_calm: {outcome}")
