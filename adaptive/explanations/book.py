"""The book of one loop and region: how likely each process is, by all samples so far, under a load that wanders,
without a tone from outside and with one (tone.py).

    L         the likelihood of a window of samples, whatever the gains were while it was recorded: co is the input
    1/T       its power: what the setpoint makes co do is trusted more than what loads do (wandering_load.py)
    update    ln w  <-  ln w + ln((1 - ODD) L / max L + ODD mean L / max L)
    fade      w  <-  (1 - h) w + h prior,      h = 1 - exp(-t / hazard);      a tone begins and ends likewise
    all   ln L/T  =  (1 - s)/T_LOADS ln W + s (A/(2 T_ANSWERS) + ln W/(2 T_SETPOINT)),          without a tone
    told      w   =  (1 - tone) w_all + tone w_answers,            once the setpoint has told the process
    response  ln w  <-  ln w + ln(1 + L_fit e^(-d^2/2) / L),       loads as steps; d: how far off its fit is (`apart`)

Each process has odds with a tone and without one: a single window of a tone may look like a loop near instability, and
several would make that sure. Under a tone and by loads alone the inverse of the controller explains pv by co as well as
any process does, so such windows say only how likely a tone is. The answers to the setpoint tell the process, whatever
the load (A: any_load.py; s: the setpoint's share in what moves the window). Without a tone they are judged under a load
that wanders (W) as well, which tells slow processes better; the weights of both have the sum 1 (Genest & Zidek 1986).

No window makes anything sure: it may be an odd one, which says nothing. No process of the grid is quite the loop's, so
what it leaves below MODEL_ERROR of pv's range counts as noise. Windows add up on one grid (process_grid.py):
its unit of gains and interval of time stay those of the loop when its book was begun. Before any record each process is
as likely as the others on which a loop at work is neither far beyond its limit of stability nor idle; those that run
away have RUNAWAYS of the odds, shared by the ones that shares of the gains hold.

A window that still grows is weighed anew each time: `whole` is what was known before it. The weights are kept in levels
of STEP, so a stored book is the same as one that was not. A fade of less than a level waits, by the clock, until it is.
"""

import base64
import math
import zlib
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from retuner.adaptive.explanations.any_load import T_ANSWERS, log_likelihood_of_answers
from retuner.adaptive.explanations.likely_processes import LikelyProcesses
from retuner.adaptive.explanations.process_grid import (
    DEAD_TIMES,
    EVERY_LAG,
    GAINS,
    HALF_TURN,
    BoolArray,
    ComplexArray,
    apart,
    control_law,
    gain_unit,
    loop_phases,
    responses_of,
    robustness,
    shapes,
)
from retuner.adaptive.explanations.tone import tone_of
from retuner.adaptive.explanations.wandering_load import (
    ORDERS,
    T_LOADS,
    T_SETPOINT,
    TEMPER,
    Prepared,
    block_means,
    lead_of_steps,
    log_likelihoods,
    setpoint_share,
    temper,
)
from retuner.adaptive.identification.candidate import MODEL_ERROR
from retuner.adaptive.identification.estimate import ModelEstimate
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, replace

STEP, DEEPEST = 0.05, 255
"""Levels of the logarithms that are kept, and the one of what is left out: no loop at work comes from there."""
WEIGHT_AT = np.append(np.exp(-STEP * np.arange(DEEPEST)), 0.0)  # of each level
ODD, FEWEST_SAMPLES, FEWEST_ROWS = 0.02, 30, 16
"""Probability that a window says nothing of the process; samples of one, and of a response, that may say something."""
OF_ANY = 0.5  # weight of a load of any spectrum, beside one that wanders, in what answers to the setpoint say; 0 to 1
TONE, TONE_LASTS = 0.3, 20000
"""Probability of a tone before any record (3 loops of 10 oscillate: Bialkowski 1993), and samples that it lasts."""
GRID = (len(shapes(EVERY_LAG)), len(DEAD_TIMES), len(GAINS))
BY_ALL, ANSWERS = 2, 3  # planes
TOLD = 0.5  # share of the moves of the setpoint from which these tell the process
PLANES, WEIGHED = (4 + len(ORDERS), *GRID), 2
"""Every process by a load that wanders, without a tone and with one: their odds are those of a tone. Then by loads and
answers to the setpoint, without a tone; by answers whatever the load; and without a tone under each order of load.
"""
WHOLE = (slice(WEIGHED), *(slice(i, i + 1) for i in range(WEIGHED, PLANES[0])))  # planes whose weights are one together
ALIKE = (1.0 / len(ORDERS),) * len(ORDERS)  # odds of the orders of load before any record
BEYOND, MOST_ROOM, MS_OF_ROOM = 1.25, 12.0, 1.7
"""A process is left out if the loop is unstable with 1/BEYOND of the gains in force, or if MOST_ROOM times these gains
keep Ms under MS_OF_ROOM: no loop at work comes from either, for even one that acts little has a co that undoes its
load.
"""
SHARES = (1.0, 0.5, 0.25)  # shares of the gains in force, one of which must hold a process that runs away
RUNAWAYS = 0.02
"""Odds that a process runs away by itself, before any record: exothermic reactors, some tanks and vehicles."""
NUMBERS = ("unit", "dt_s", "t_s", "moved", "moved_before", "tone_s")  # of a book, kept as they are
OF_ORDERS = ("orders", "orders_before")


@dataclass(frozen=True, slots=True)
class Book:
    """What is known of a process.

    direction : sign of its gain. unit, dt_s : what loop gains and times of the grid are counted in. t_s : time up to
    which samples are entered for good. faded_s : up to which what is known has faded, of the process and of a tone.
    records : windows that said something. leans : what followed at the last look, -1 less action, 1 more, 0 nothing.
    moved : how far the moves of the setpoint tell the process, 0 to 1: the sum of their shares of the windows;
    moved_before : without the window that still grows. tone_s : period of the last window's tone, 0 before any.
    orders : odds of each of ORDERS of load; orders_before : without the window that still grows.
    levels : of each process on each of PLANES, how many STEP its logarithm of the weight lies under the largest;
    whole : without the window that still grows; prior : before any.
    """

    direction: int
    unit: float
    dt_s: float
    t_s: float
    faded_s: tuple[float, float]
    records: int
    leans: int
    moved: float
    moved_before: float
    tone_s: float
    levels: bytes
    whole: bytes
    prior: bytes
    orders: tuple[float, ...] = ALIKE
    orders_before: tuple[float, ...] = ALIKE

    @classmethod
    def begun(cls, gains: PidGains, dt_s: float, t_s: float) -> "Book":
        """The book before any record. gains : in force. dt_s : interval of the condensed samples."""
        unit = gain_unit(gains, dt_s)
        levels = _prior(*_possible(gains, dt_s, unit))
        return cls(gains.direction, unit, dt_s, t_s, (t_s, t_s), 0, 0, 0.0, 0.0, 0.0, levels, levels, levels)

    def under(self, gains: PidGains) -> "Book":
        """The book under these gains: a process that they make possible is no longer left out. Where they act more than
        the first ones, it is as likely as before any record; where less, the process must have changed, so it has the
        least odds that are kept.
        """
        before = _array(self.prior)[0] != DEEPEST
        now = np.concatenate(_possible(gains, self.dt_s, self.unit))
        if not np.any(now & ~before):
            return self
        prior = _prior(*np.split(now | before, [len(shapes())]))
        book, fresh = replace(self, prior=prior), _weights(prior).copy()
        if gain_unit(gains, self.dt_s) <= self.unit:
            least = (np.where(now & ~before, DEEPEST - 1, _array(known)) for known in (self.levels, self.whole))
            levels, whole = (one.astype(np.uint8).tobytes() for one in least)
            return replace(book, levels=levels, whole=whole)
        fresh[:, before] = 0.0
        enters = float(fresh[:WEIGHED].sum())
        levels, whole = (_mixed(_weights(known), fresh, enters) for known in (self.levels, self.whole))
        return replace(book, levels=levels, whole=whole)

    def weights(self) -> FloatArray:
        """Weight of every process of the grid, sum 1; shape (shapes, dead times, gains)."""
        known, tone = _weights(self.levels), self.tone
        return np.asarray((1.0 - tone) * known[BY_ALL] + tone * _beside_a_tone(known, self.moved))

    @property
    def tone(self) -> float:
        """Probability of a tone from outside; a window that still grows ends none that was found before it."""
        now, before = (float(_weights(known)[1].sum()) for known in (self.levels, self.whole))
        return max(now, before) if before > TONE else now

    @property
    def untold_tone(self) -> float:
        """Probability of a tone beside which the moves of the setpoint have not told the process."""
        return self.tone * (1.0 - self.moved)

    @property
    def told_by_setpoint(self) -> bool:
        """Whether the moves of the setpoint have told the process, and not loads alone."""
        return self.moved >= TOLD

    @lru_cache(maxsize=4)  # noqa: B019  a decision asks for the same ones several times
    def drawn(self, count: int, order: int | None = None) -> LikelyProcesses:
        """Processes that stand for the weights, each as likely as the others, by systematic resampling (Kitagawa 1996).
        order : of the loads, as in ORDERS, where the process is to be known under these alone.

        Drawn from the whole and not the likeliest only: where much is possible each of those has next to no weight.
        """
        weights = self.weights() if order is None else _weights(self.levels)[ANSWERS + 1 + ORDERS.index(order)]
        whole = np.cumsum(weights.ravel())
        at = np.searchsorted(whole, (np.arange(count) + 0.5) / count * whole[-1])
        times = np.bincount(np.minimum(at, len(whole) - 1))
        index, counts = np.flatnonzero(times), times[times > 0]
        return _those(np.unravel_index(index, GRID), counts / count, self.unit, self.dt_s)

    def to_dict(self) -> dict[str, object]:
        """Plain values."""
        kept = {
            name: getattr(self, name) for name in (*NUMBERS, *OF_ORDERS, "direction", "faded_s", "records", "leans")
        }
        arrays = {name: zlib.compress(getattr(self, name)) for name in ("levels", "whole", "prior")}
        return kept | {name: base64.b64encode(packed).decode("ascii") for name, packed in arrays.items()}

    @classmethod
    def from_dict(cls, body: Mapping[str, Any]) -> "Book":
        """The book of these plain values.

        Raises KeyError, TypeError, ValueError: something is missing, of the wrong kind, or of another grid.
        """
        levels, whole, prior = (_unpacked(str(body[name])) for name in ("levels", "whole", "prior"))
        process_s, of_tone_s = (float(at) for at in body["faded_s"])
        unit, dt_s, t_s, moved, before, tone_s = (float(body[name]) for name in NUMBERS)
        shares = 0.0 <= moved <= 1.0 and 0.0 <= before <= 1.0 and 0.0 <= tone_s < math.inf
        if not (0 < unit < math.inf and 0 < dt_s < math.inf and math.isfinite(t_s + process_s + of_tone_s) and shares):
            known = f"a book of unit {unit}, interval {dt_s} s, time {t_s} s, moved by {moved}, {before}"
            raise ValueError(f"{known}, tone of {tone_s} s")
        sign, records, leans = 1 if int(body["direction"]) > 0 else -1, int(body["records"]), int(body["leans"])
        faded_s = process_s, of_tone_s
        odds = [tuple(float(one) for one in body.get(name, ALIKE)) for name in OF_ORDERS]  # none in an older memory
        if any(len(one) != len(ORDERS) or not abs(sum(one) - 1.0) < STEP or min(one) < 0.0 for one in odds):
            raise ValueError(f"a book with odds of orders of load {odds}")
        return cls(sign, unit, dt_s, t_s, faded_s, records, leans, moved, before, tone_s, levels, whole, prior, *odds)


@lru_cache(maxsize=64)
def _possible(gains: PidGains, dt_s: float, unit: float) -> tuple[BoolArray, BoolArray]:
    """Processes on which a loop at work may be (head of this file), and those that run away and may be held."""
    known = robustness(gains, dt_s, unit)
    possible = (known.ultimate * BEYOND >= GAINS * known.scale) & (known.room(MS_OF_ROOM) <= MOST_ROOM)
    rows, dead = np.indices((GRID[0] - len(shapes()), GRID[1]))
    rows, law, gain = rows + len(shapes()), control_law(gains, dt_s), np.multiply.outer(SHARES, GAINS / unit)
    size, over = np.abs(responses_of(rows, dead) * law), loop_phases(rows, dead, law) > HALF_TURN
    *cell, at = np.nonzero(over[..., :-1] != over[..., 1:])  # where a phase passes the limit, alike for every gain
    large = gain[..., None] ** 2 * (size[..., :-1] * size[..., 1:])[(*cell, at)] >= 1
    turns = (over[..., 0, None, None] & (gain * size[..., 0, None, None] >= 1)).astype(int)
    np.add.at(turns, tuple(cell), np.moveaxis(np.where(over[(*cell, at)], -1, 1) * large, -1, 0))
    return np.asarray(possible), np.asarray((turns == 1).any(axis=2))  # one turn round -1 holds one pole (Nyquist)


def _those(at: tuple[npt.NDArray[np.intp], ...], weights: FloatArray, unit: float, dt_s: float) -> LikelyProcesses:
    """Processes of the grid. at : shapes, dead times and gains."""
    responses: ComplexArray = responses_of(at[0], at[1]) * (GAINS[at[2]] / unit)[:, None]
    return LikelyProcesses(tuple(zip(*(one.tolist() for one in at), strict=True)), weights, responses, dt_s)


def _prior(possible: BoolArray, held: BoolArray) -> bytes:
    """Weights before any record, as levels."""
    rare = math.log(RUNAWAYS / (1.0 - RUNAWAYS) * int(np.sum(possible)) / max(int(np.sum(held)), 1))
    kept = np.concatenate([possible, held])
    logs = np.where(np.nonzero(kept)[0] < len(possible), 0.0, rare)
    of_plane = np.log([1.0 - TONE, TONE, *[1.0] * (PLANES[0] - WEIGHED)])
    return _levels(logs + of_plane[:, None], kept)


def update(
    book: Book, window: Window, *, hazard_s: float = math.inf, grows: bool = False, swings: bool = False
) -> Book:
    """Take in a window of all samples since the last one. A window shorter than the interval of the book says nothing.

    hazard_s : mean time after which the process is another one. grows : the window will come again, with more samples.
    swings : it goes from limit to limit of the output, so it says nothing: that is one frequency, again and again,
    which a process that runs away explains as well as the loop's own.
    """
    last_s, share, tone_s = float(window.t_s[-1]), 0.0, book.tone_s
    window = window.on_even_clock()  # as many rows for the setpoint as for pv and co
    n = max(round(book.dt_s / window.sample_time_s), 1)
    if len(window.t_s) < n:
        return book
    record, known = Prepared.at(window, book.dt_s), faded(book, last_s, hazard_s)
    record = replace(record, resolution=max(record.resolution, MODEL_ERROR * float(np.ptp(record.pv))))
    levels, of_orders, moves = known.whole, known.orders_before, np.ptp(record.pv) > 0 and np.ptp(record.co) > 0
    says = moves and len(record.pv) >= FEWEST_SAMPLES and not swings
    if says:
        logs, kept = _logs(levels)
        setpoint = block_means(window.sp, n)
        setpoint, tone = setpoint - setpoint[0], tone_of(window, book.dt_s, known.tone_s)
        whole, orders = log_likelihoods(record, book.direction, book.unit, tone.columns, tone.taken, EVERY_LAG, kept)
        alone, *toned = (one[kept] - price / TEMPER for one, price in zip(whole, tone.prices, strict=True))
        beside, tone_s = np.logaddexp.reduce(toned) - (0.0 if tone.goes_on else math.log(len(toned))), tone.period_s
        likeliest = np.argmax(np.maximum(alone + math.log(1.0 - TONE), beside + math.log(TONE)))
        share = _moved_by_setpoint(record, setpoint, int(np.flatnonzero(kept)[likeliest]))
        power, answers = TEMPER / temper(share), np.zeros(len(alone))
        if share:
            answers = share / T_ANSWERS * log_likelihood_of_answers(record, book.direction, book.unit, kept)[kept]
        by_all = power * alone + OF_ANY * (answers - share * TEMPER / T_SETPOINT * alone)
        found = np.array([power * alone, power * beside, by_all, answers, *(power * one[kept] for one in orders)])
        of_orders = _odds_of_orders(of_orders, logs[ANSWERS + 1 :], found[ANSWERS + 1 :])
        for one in WHOLE:
            logs[one] += _told(found[one])
        levels = _levels(logs, kept)
    moved = min(known.moved_before + share, 1.0)
    if grows:
        return replace(book, levels=levels, moved=moved, orders=of_orders)
    entered = replace(known, t_s=last_s, records=book.records + bool(says), tone_s=tone_s)
    entered = replace(entered, orders=of_orders, orders_before=of_orders)
    return replace(entered, levels=levels, whole=levels, moved=moved, moved_before=moved)


def _told(logs: FloatArray) -> FloatArray:
    """ln of what a window tells of each process. It may be an odd one, which tells nothing."""
    part = np.exp(logs - float(np.max(logs)))
    return np.asarray(np.log((1.0 - ODD) * part + ODD * float(np.mean(part))))


def _odds_of_orders(before: tuple[float, ...], logs: FloatArray, found: FloatArray) -> tuple[float, ...]:
    """Odds of the orders of load with a window. logs, found : of the processes under each, before it and by it."""
    known = logs - np.logaddexp.reduce(logs, axis=1, keepdims=True)
    said = np.logaddexp.reduce(known + found, axis=1)
    told = (1.0 - ODD) * np.exp(said - float(np.max(said))) + ODD
    odds = np.maximum(before, WEIGHT_AT[DEEPEST - 1]) * told  # none is lost for good, as no process is
    return tuple((odds / float(odds.sum())).tolist())


def _moved_by_setpoint(record: Prepared, setpoint: FloatArray, likeliest: int) -> float:
    """The setpoint's share in what moves a window (setpoint_share), as far as the likeliest process has answered."""
    row, dead, _ = np.unravel_index(likeliest, GRID)
    shape, n = shapes(EVERY_LAG)[row], len(setpoint)
    late = math.ceil(DEAD_TIMES[dead] + shape.second + 1.0)
    return setpoint_share(record, np.concatenate([np.zeros(late), setpoint])[:n], abs(shape.lag))[1]


def faded(book: Book, now_s: float, hazard_s: float) -> Book:
    """What is known by now: the process may have become another one, and a tone may have begun or ended."""
    lasts = hazard_s, TONE_LASTS * book.dt_s
    shares = [-math.expm1(-max(now_s - at, 0.0) / one) for at, one in zip(book.faded_s, lasts, strict=True)]
    change, turn = (share if share >= STEP else 0.0 for share in shares)
    if not (change or turn):
        return book
    weights, (process_s, tone_s) = _weights(book.whole).copy(), book.faded_s
    alone, (goes_on, began) = weights[:WEIGHED].sum(axis=0), weights[:WEIGHED].sum(axis=(1, 2, 3))
    ended = began * turn * (1.0 - TONE)
    ended /= ended + goes_on * (1.0 - turn * TONE)  # of the odds that there is none
    weights[BY_ALL] += ended * (_beside_a_tone(weights, book.moved_before) - weights[BY_ALL])
    weights[:WEIGHED] += turn * (np.array([1.0 - TONE, TONE])[:, None, None, None] * alone - weights[:WEIGHED])
    faded_s = now_s if change else process_s, now_s if turn else tone_s
    whole, moved = _mixed(weights, _weights(book.prior), change), (1.0 - change) * book.moved_before
    return replace(book, whole=whole, moved_before=moved, faded_s=faded_s)


def doubted(book: Book, change: float) -> Book:
    """Where the process has become another one with this probability."""
    levels, whole = (_mixed(_weights(known), _weights(book.prior), change) for known in (book.levels, book.whole))
    moved, before = ((1.0 - change) * known for known in (book.moved, book.moved_before))
    return replace(book, moved=moved, moved_before=before, levels=levels, whole=whole)


def heard(book: Book, sure: float, *, tone: bool) -> Book:
    """Where the diagnosis of a response has found a tone, or a swing of the loop's own, under loads that are steps.
    sure : share of first answers that are right; tempered, for the samples stand in windows as well.
    """
    lead = (math.log(sure / (1.0 - sure)) - math.log(TONE / (1.0 - TONE))) / TEMPER
    more = np.array([0.0, lead if tone else -lead, *[0.0] * (PLANES[0] - WEIGHED)])[:, None]
    levels, whole = (_levels(logs + more, kept) for logs, kept in (_logs(book.levels), _logs(book.whole)))
    return replace(book, levels=levels, whole=whole)


def with_response(book: Book, window: Window, estimate: ModelEstimate) -> Book:
    """The book with the fit of a response: loads are steps, as likely before it as one that wanders.

    Where a load wanders, nothing is added; where steps explain the response better, the fit tells the process.
    """
    window = window.on_even_clock()
    record, n = Prepared.at(window, book.dt_s), len(window.pv)
    if len(record.pv) < FEWEST_ROWS:
        return book
    kept, no_tones = _array(book.levels)[0] != DEEPEST, np.zeros((0, len(record.pv)))
    (walk,), orders = log_likelihoods(record, book.direction, book.unit, no_tones, (0,), EVERY_LAG, kept)
    left = (1.0 - estimate.explained) * record.size * len(record.pv) / n
    lead = lead_of_steps(left, len(estimate.load_times_s), n, record, walk)
    if lead <= 0.0:
        return book
    by_steps = lead / T_LOADS - apart(estimate.best.log, T_LOADS, book.unit, book.dt_s)[kept] / 2.0
    best, under = float(np.max(walk)), {0: walk, BY_ALL: walk} | {ANSWERS + 1 + i: one for i, one in enumerate(orders)}
    added = np.zeros((PLANES[0], len(by_steps)))  # beside a tone nothing
    for plane, one in under.items():
        entered = _told(TEMPER / T_LOADS * (one[kept] - best))
        either = np.logaddexp(entered, by_steps)
        added[plane] = _told(either) + float(np.max(either)) - entered
    levels, whole = (_levels(_logs(known)[0] + added, kept) for known in (book.levels, book.whole))
    return replace(book, levels=levels, whole=whole)


def _beside_a_tone(weights: FloatArray, told: float) -> FloatArray:
    """Weights where there is a tone: by answers to the setpoint, as far as these tell."""
    return np.asarray((1.0 - told) * weights[1] / float(weights[1].sum()) + told * weights[ANSWERS])


def _mixed(weights: FloatArray, fresh: FloatArray, change: float) -> bytes:
    """Where the process is another one with this probability, of these weights; a tone that is there stays."""
    kept = (1.0 - change) * weights[0] + change * fresh[0] > 0.0  # what was left out stays out
    weights, fresh = weights[:, kept], fresh[:, kept]
    known, before = (np.sum(x, axis=1, keepdims=True) for x in (weights, fresh))
    return _levels(np.log((1.0 - change) * weights + change * fresh * known / before), kept)


def _array(levels: bytes) -> npt.NDArray[np.uint8]:
    return np.frombuffer(levels, dtype=np.uint8).reshape(PLANES)


def _logs(levels: bytes) -> tuple[FloatArray, BoolArray]:
    """Logarithms of the weights of those that are not left out, and which these are, as _levels takes them."""
    each = _array(levels)
    kept = each[0] != DEEPEST
    return -STEP * each[:, kept].astype(np.float64), kept


@lru_cache(maxsize=4)  # a decision asks the same ones many times
def _weights(levels: bytes) -> FloatArray:
    weights: FloatArray = WEIGHT_AT[_array(levels)]
    for one in WHOLE:
        weights[one] /= float(weights[one].sum())
    weights.flags.writeable = False
    return weights


def _levels(logs: FloatArray, kept: BoolArray) -> bytes:
    """Logarithms of weights as levels under the largest. kept : of shape GRID, those not left out from the beginning;
    logs : of these, shape (PLANES[0], number).
    """
    levels, at = np.full((PLANES[0], kept.size), DEEPEST, dtype=np.uint8), np.flatnonzero(kept)
    for one in WHOLE:
        top = float(np.max(logs[one]))
        levels[one, at] = np.minimum(np.rint((top - logs[one]) / STEP), DEEPEST - 1)
    return levels.tobytes()


def _unpacked(text: str) -> bytes:
    try:
        levels = zlib.decompress(base64.b64decode(text, validate=True))
    except (ValueError, zlib.error) as error:
        raise ValueError(f"weights of a book that cannot be read: {error}") from None
    if len(levels) != math.prod(PLANES) or min(levels) != 0:
        raise ValueError(f"a book of {len(levels)} weights, of {math.prod(PLANES)} that are kept")
    return levels
