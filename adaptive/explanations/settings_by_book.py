"""Settings worth having over the processes of a book, and what a set of gains does there.

    worth(set) = E[cost(in force)] - E[cost(set)],     cost as in likely_processes.py

The expectation is over processes drawn from the book, each as likely as the others. Odds of the gains in force hold
between the grid's points as well (`over_cells`). A change is made where two looks in a row ask for it.

    less action     Ms is probably too high with the gains in force, and the set holds a process that runs away no worse
    more action     a set with more is probably cheaper, and few processes make a bad loop of it (by loads alone its
                    trial tells): a share of the way, none where most processes run away: nothing is proved on those
    integral time   no shorter than the rule's (SIMC: Skogestad 2003) on most processes: a load that comes back by
                    itself looks like a process that does

While a tone is likelier than none and the setpoint has not told the process, no change follows; below that, less action
is weighed with it.
How the spectrum of a load falls is assumed, and much rests on that in closed loop (Forssell & Ljung 1999). So by loads
alone less action must be better with two thirds of the odds under each order of the walk that the samples do not
refute, and more action needs a loop with room besides: under one order by itself a weak loop and a good one look alike.
"""

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from retuner.adaptive.decision_numbers import Numbers
from retuner.adaptive.declared_setting import require_in_range, setting
from retuner.adaptive.explanations.book import Book
from retuner.adaptive.explanations.likely_processes import (
    LikelyProcesses,
    WorthSettings,
    costs,
    harmless,
    over_cells,
    process_model,
    quantile,
)
from retuner.adaptive.explanations.process_grid import DEAD_TIMES, EVERY_LAG, GAINS, shapes
from retuner.adaptive.explanations.wandering_load import ORDERS
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.process.model import ProcessModel
from retuner.adaptive.rules.rule import Tuning
from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.gains import PidGains, series_kept
from retuner.schedule.late_dataclass import dataclass, field, replace

_MS = "1.1..3.5"  # every limit of Ms lies between these: they follow a person's own (supervision/retuner_settings.py)


@dataclass(frozen=True, slots=True)
class BookSettings:
    """When something follows from all samples. Costs are logarithms of IAE; what a set costs: cost."""

    hazard_s: float = setting(
        30 * 86400.0, "Mean time after which a process is another one", "86400..3.2e7 s", "fouling, wear"
    )
    changed_odds: float = setting(
        0.5, "Odds that a process has changed where two responses differ from all before", "0.1..0.9"
    )
    drawn: int = setting(300, "Processes that stand for the weights", "100..1000")
    tone: float = setting(0.2, "Odds of an external oscillation from which it is told", "0.05..0.9")
    worth: float = setting(
        0.18, "How much cheaper a change must be expected to be", "0.1..0.7", "ln 1.2: below J's limit"
    )
    ms_high: float = setting(2.0, "Ms above which a loop has too little robustness", _MS)
    ms_good: float = setting(1.7, "Ms up to which a loop may have more action", _MS)
    ms_tried: float = setting(2.5, "Ms that no more than cost.bad_share may have on trial, by loads alone", "1.1..7")
    less_odds: float = setting(0.85, "Odds of ms_high from which less action follows", "0.5..0.9")
    sure_odds: float = setting(0.95, "Odds from which it does at once, behind a whole window", "0.9..0.99")
    more_odds: float = setting(0.85, "Odds of being cheaper from which more action follows", "0.5..0.9")
    restless: float = setting(0.3, "Share of samples outside the noise band from which a load wanders", "0.1..0.9")
    most: float = setting(0.7, "How much a change may save or cost on a process", "0.2..2.5", "ln 2: it is on trial")
    borne_out: float = setting(
        2 / 3, "Odds of being better that a change needs by loads alone", "0.5..0.9", "60 changes, seeds 9331 to 9361"
    )
    room: float = setting(1.8, "Times as much of all actions that a loop with room bears", "1.5..3")
    room_odds: float = setting(0.7, "Odds of room from which loads alone ask for more", "0.5..0.95", "193 loops")
    cost: WorthSettings = field(default_factory=lambda: WorthSettings(ms_calm=1.68, unstable_share=0.02))

    def __post_init__(self) -> None:
        require_in_range(self, "book")


LESS, LONGER = (0.85, 0.75, 0.65, 0.55, 0.45, 0.35), (1.0, 1.5, 2.0, 4.0)
"""Times all actions, and times the integral time, that are tried for a loop with too little robustness."""
MORE, SHORTER = (1.0, 1.25, 1.4, 1.6, 2.0), (1.0, 0.7, 0.5)  # on gain and integral time of a loop that has room
SHORTEST = (0.35, 0.25)  # on the integral time with less gain
AT_ONCE, PROVED_ON = 2.5, 12
"""Times the integral action that a change may make of it; processes on which one is proved, spread over the odds."""
Kind = tuple[tuple[float, ...], tuple[float, ...], float, float]
"""Candidates: factors on all actions and on the integral time; integral action grows by more than, and to at most."""
MORE_OF_ALL: Kind = (MORE, SHORTER, 1.0, AT_ONCE)
LESS_OF_ALL: Kind = (LESS, (*LONGER, *SHORTER[1:]), 0.0, 1.0)
MORE_GAIN: Kind = (MORE[1:], LONGER[1:], 0.0, AT_ONCE)
MORE_INTEGRAL: Kind = (LESS[:4], (*SHORTER[1:], *SHORTEST), 1.0, AT_ONCE)  # in one step: halfway Ms may be as bad
"""A loop may have too much of gain or integral action for the other: the integral time falls with the gain, too."""


@dataclass(frozen=True, slots=True)
class BookNumbers(Numbers):
    """What the book says of the gains in force. high : probability that Ms is over its limit. room : that they have
    room. ms, ms_low, ms_high : the middle of its odds and where nine of ten lie. records : windows behind it. tone :
    that one from outside moves the loop. worth : expected of the change, ln; None where none is worth making.
    """

    book_high: float
    book_room: float
    book_ms: float
    book_ms_low: float
    book_ms_high: float
    book_records: float
    book_tone: float = 0.0
    book_worth: float | None = None


@dataclass(frozen=True, slots=True)
class ByBook:
    """numbers : of the gains in force. leans : see Book. tuning : settings worth having, None for none.

    models : on which they are to be proved, the one in the middle first; without the share that may come out badly.
    tells_tone : whether a tone is likely enough to be told.
    """

    numbers: BookNumbers
    leans: int = 0
    tuning: Tuning | None = None
    models: tuple[Plausible, ...] = ()
    tells_tone: bool = False

    @property
    def words(self) -> str:
        """What the book says of the gains in force."""
        n = self.numbers
        most = "or more" if n.book_ms_high >= MS_SHOWN else f"to {n.book_ms_high:.2f}"
        odds = f"{n.book_high:.0%} probability that Ms is over its limit, {n.book_room:.0%} that there is room for more"
        tone = f", {n.book_tone:.0%} that an external oscillation moves the loop" if self.tells_tone else ""
        return f"from all samples, Ms {n.book_ms:.2f} ({n.book_ms_low:.2f} {most}); {odds}{tone}"


Spread = dict[Plausible, float]  # processes and how often each was drawn, as a share
MS_SHOWN = 20.0  # a larger Ms, and an unstable loop, is told as this


def by_book(book: Book, gains: PidGains, settings: BookSettings) -> ByBook:
    """What the book says of the gains in force, and the settings that are worth most over it.

    By loads alone less action is the best or none. Once the setpoint has moved the loop, more gain with a longer
    integral time may be better, or less with a shorter one if Ms is too high.
    """
    drawn, told = book.drawn(settings.drawn), book.told_by_setpoint
    ms, cells, (high, room) = drawn.peaks(gains), over_cells(drawn, settings.drawn), shares(drawn, gains, settings)
    shown = np.minimum(cells.peaks(gains), MS_SHOWN)
    middle, low, most = (quantile(shown, cells.weights, share) for share in (0.5, 0.05, 0.95))
    numbers = BookNumbers(high, room, middle, low, most, float(book.records), book.tone)
    by_orders = [book.drawn(settings.drawn, order) for order in (() if told else ORDERS)]
    integral_times = [_integral_times(book, one) for one in (drawn, *by_orders)]
    kinds, tone = [MORE_OF_ALL], book.untold_tone
    if told:
        kinds += [MORE_GAIN, MORE_INTEGRAL] if high >= settings.less_odds else [MORE_GAIN]
    tried = [one for kind in kinds for one in _sets(gains, kind, integral_times, settings)]
    leans, best = 0, _best(drawn, gains, tried, settings, more=True, told=told, tone=tone)
    likely = told or room >= settings.room_odds
    if best is not None and likely and gain(drawn, gains, best[1], settings)[1] >= settings.more_odds:
        leans = 1
    elif high >= settings.less_odds:
        less = _sets(gains, LESS_OF_ALL, integral_times, settings)
        leans, best = -1, _best(drawn, gains, less, settings, more=False, told=told, tone=tone)
    leans = 0 if tone >= HALF else leans
    odds = high if leans < 0 else room if told else 0.0
    sure = odds >= settings.sure_odds and book.records > 0  # a part of a window looks sure too soon
    said = ByBook(numbers, leans, tells_tone=book.tone >= settings.tone)
    unproved = leans > 0 and float(drawn.weights @ drawn.runs_away) >= 1.0 - settings.cost.bad_share
    if best is None or not leans or unproved or (leans != book.leans and not sure):
        return said
    asked = [one for one, odds in zip(by_orders, book.orders, strict=False) if odds >= settings.cost.bad_share]
    if leans < 0 and any(gain(one, gains, best[1], settings)[1] < settings.borne_out for one in asked):
        return said
    worth, new, peaks = best
    proved = ~drawn.runs_away & ((ms <= settings.cost.ms_bad) | (peaks < ms) | (leans < 0))
    models = tuple(_proved_on(book, drawn, np.where(proved, peaks, np.nan), settings))
    numbers, tuning = replace(numbers, book_worth=worth), Tuning("simc", "series", new)
    return replace(said, numbers=numbers, tuning=tuning, models=models)


def shares(drawn: LikelyProcesses, gains: PidGains, settings: BookSettings) -> tuple[float, float]:
    """Probability that Ms is over its limit with these gains, and that there is room for more action."""
    cells = over_cells(drawn, settings.drawn)
    high = float(cells.weights @ (cells.peaks(gains) > settings.ms_high))
    room = float(cells.weights @ (cells.peaks(_times(gains, settings.room, 1.0)) <= settings.ms_good))
    return high, room


def gain(drawn: LikelyProcesses, now: PidGains, new: PidGains, settings: BookSettings) -> tuple[float, float]:
    """How much less a set is expected to cost than another, ln, and the probability that it does so and is stable."""
    goes, peaks = costs(drawn, new, settings.cost)
    each = costs(drawn, now, settings.cost)[0] - goes
    better = (each > 0.0) & np.isfinite(peaks)
    return float(drawn.weights @ np.clip(each, -settings.most, settings.most)), float(drawn.weights @ better)


def worth_of(
    drawn: LikelyProcesses, saves: FloatArray, settings: BookSettings, *, more: bool, tone: float, faster: float
) -> float:
    """What a change is worth, ln. saves : on each process. tone : Book.untold_tone. faster : of `faster`.

    More action goes on trial, which bounds what it may cost on a process: unlikely ones on which it is unstable do not
    outweigh what it saves on the others. Where a tone moves the loop, less action saves nothing and is slower.
    """
    expected = float(drawn.weights @ saves)
    bounded = float(drawn.weights @ np.clip(saves, -settings.most, settings.most))
    return max(expected, bounded) if more else (1.0 - tone) * expected + tone * faster


def faster(now: PidGains, new: PidGains) -> float:
    """How much faster a load is rejected, ln: by integral action, or gain where there is none."""
    return math.log(new.ki / now.ki if now.ki else new.kp / now.kp)


def lets_go(drawn: LikelyProcesses, now: PidGains, new: PidGains, settings: BookSettings) -> bool:
    """Whether new gains hold processes that run away by themselves worse than those in force, on more than the share of
    the odds that may come out badly. What holds one is gain: from a least one up (De Paor & O'Malley 1989).
    """
    worse = drawn.peaks(new) > np.maximum(drawn.peaks(now), settings.ms_high)
    return float(drawn.weights @ (drawn.runs_away & worse)) > settings.cost.bad_share


def bears(drawn: LikelyProcesses, now: PidGains, new: PidGains, settings: BookSettings) -> bool:
    """Whether more action costs less with the odds that it needs, and makes a bad loop on no more than it may."""
    fits = harmless(drawn.weights, drawn.peaks(now), drawn.peaks(new), settings.cost)
    return fits and gain(drawn, now, new, settings)[1] >= settings.more_odds


def _times(gains: PidGains, all_of_them: float, integral_time: float) -> PidGains:
    """All actions so many times, and the integral time besides; the derivative as a series form has it."""
    times = (all_of_them * gain for gain in (gains.kp, gains.ki / integral_time, gains.kd))
    return series_kept(PidGains(*times), gains)


def _sets(
    gains: PidGains, kind: Kind, integral_times: Sequence[FloatArray], settings: BookSettings
) -> Iterator[PidGains]:
    """Candidates of a kind. integral_times : of the rule, seconds, on each process as likely as the others; by the
    whole, then under each order of load by itself.
    """
    all_of_them, longer, least, most = kind
    for times in all_of_them:
        for other in _bearable(gains, longer, integral_times, settings):
            if least < times / other <= most:
                yield _times(gains, times, other)


def _bearable(
    gains: PidGains, factors: tuple[float, ...], integral_times: Sequence[FloatArray], settings: BookSettings
) -> Iterator[float]:
    """Factors on the integral time; of the shorter ones those that are not shorter than the rule's next to anywhere,
    nor probably under one order of load: a real one makes too short a lag as good as sure.
    """
    both = bool(gains.kp and gains.ki)
    for factor in factors if both else (1.0,):
        least = factor * gains.kp / gains.ki if both else math.inf
        short = [float(np.mean(one > SLACK * least)) for one in integral_times]
        if factor >= 1.0 or (short[0] <= settings.cost.bad_share and max(short) <= HALF):
            yield factor


HALF = 0.5  # odds up to which a shorter integral time may be too short under each order of load, or a tone be there
SLACK, PER_PROCESS = 1.25, 300
"""The rule's integral time over one that is too short for it; times that a process with all of the weight counts."""


def _integral_times(book: Book, drawn: LikelyProcesses) -> FloatArray:
    """SIMC's integral time on each process, seconds: min(tau1, 8 theta) by the half rule, tau_c = theta."""
    found = []
    for i, j, _ in drawn.index:
        shape, dead = shapes(EVERY_LAG)[i], DEAD_TIMES[j] + 0.5
        second = shape.second if shape.integrates else shape.second / 2
        found.append(min(shape.lag + second if shape.lag > 0 else math.inf, 8.0 * (dead + second)))
    return np.repeat(np.array(found) * book.dt_s, np.maximum(np.round(drawn.weights * PER_PROCESS), 1).astype(int))


def _best(
    drawn: LikelyProcesses, gains: PidGains, candidates: Iterable[PidGains], settings: BookSettings, *,
    more: bool, told: bool, tone: float,
) -> tuple[float, PidGains, FloatArray] | None:  # fmt: skip
    """Worth, gains and Ms on each process of the candidate that is most worth a change; None where none is."""
    (stays, before), found = costs(drawn, gains, settings.cost), []
    most = settings.cost.ms_bad if told else settings.ms_tried
    for new in candidates:
        peaks = drawn.peaks(new)
        good = not told or float(drawn.weights @ (peaks <= settings.ms_good)) >= settings.more_odds
        if more and not (good and harmless(drawn.weights, before, peaks, settings.cost, most)):
            continue
        if not more and lets_go(drawn, gains, new, settings):
            continue
        saves = stays - costs(drawn, new, settings.cost)[0]
        worth = worth_of(drawn, saves, settings, more=more, tone=tone, faster=faster(gains, new))
        if worth >= settings.worth:
            found.append((float(drawn.weights @ saves) if more else worth, new, peaks))
    return max(found, key=lambda one: one[0], default=None)


def _proved_on(book: Book, drawn: LikelyProcesses, peaks: FloatArray, settings: BookSettings) -> Spread:
    """Processes spread over the odds by their Ms with the new gains, without the worst that may come out badly.

    peaks : that Ms, not a number for no answer: of those that run away the guard has no model, `lets_go` has asked; and
    what is bad already, more action does not make so.
    """
    order = np.argsort(peaks, kind="stable")
    order = order[~np.isnan(peaks[order])]
    whole = np.cumsum(drawn.weights[order])
    if not len(whole):
        return {}
    at = whole[-1] * (1.0 - settings.cost.bad_share) * (np.arange(PROVED_ON) + 0.5) / PROVED_ON
    at = np.searchsorted(whole, np.array([0.5 * whole[-1], *at]))
    chosen = Counter(int(order[min(int(i), len(order) - 1)]) for i in at)
    return {Plausible(_model(book, drawn, i), 0.0): times / len(at) for i, times in chosen.items()}


def spread(book: Book, gains: PidGains, settings: BookSettings) -> tuple[Spread, FloatArray, FloatArray]:
    """Processes that stand for the book with their weights, spread over its odds by Ms with these gains, but for the
    share that may come out badly; and Ms and weight of all that were drawn. Of those that run away there is no model.
    """
    drawn = book.drawn(settings.drawn)
    ms = drawn.peaks(gains)
    return _proved_on(book, drawn, np.where(drawn.runs_away, np.nan, ms), settings), ms, drawn.weights


def _model(book: Book, drawn: LikelyProcesses, at: int) -> ProcessModel:
    i, j, k = drawn.index[at]
    shape = shapes()[i]
    return process_model(shape, DEAD_TIMES[j], GAINS[k] * shape.unit / book.unit, book.direction, book.dt_s)
