"""Which set of gains is expected to cost least, over all that may be behind a response.

    expected(set) = (1 - p) sum_m w_m cost(set, m)  +  p cost(set, something else)

    cost(set, m) = ln J + out(ln J / 1.25) + slope softplus(ln Ms / 1.8) + out(ln Ms / 1.8)
    out(x)       = cost of being out of specification / (1 + e^(-x / width))
    w_m          ~ e^(-excess / (2 temper)),      odds of something else = product over what the records are like

m are the models that the records still allow, excess the rise of their deviance (plausible.py), tempered because the
remainders of real records are not white. J is the mean over a setpoint and a load step of IAE over the rule's on the
same model (Grimholt & Skogestad 2012), at the smallest tau_c that keeps the limit of Ms: with a second lag SIMC's own
goes up to 1.98. The limits are those by which settings are judged, Ms of 1.8 and J of 1.25; each is a smooth step, as
wide as typical model error. An IAE under the rule's is no merit where Ms is over its limit: robustness was paid for it.
No Ms costs more than a stated most; a long wait costs all of its length. An unstable loop costs that most or, where a
stable set costs so much, more than any of them: on each model, and as a whole where it is unstable on the likeliest.

Something else: the models are a fiction, and only what was seen is known. The loop in force is stable, and decays as it
did. More action by a factor r is a risk in proportion to ln r, the more the wider the loop swung; a new kind of action
counts as one that doubles. Less action costs its IAE, 1/ki after a load, and helps a loop that swung.

A change is made where it is expected to cost less than staying, by more than the price of a change and, as one more
record costs little, by what the models disagree about:

    gain > price + sure s,    s = standard deviation of cost(set, m) - cost(in force, m) over the models

Waiting loses a set's gain for one response, a wrong change costs for all that follow. The disagreement of the models
that one more record can remove falls with the number n of records that agree: s sqrt(2 / (n + 1)) (preposterior
analysis, Raiffa & Schlaifer 1961), so no loop waits for ever. A change costs once and brings its gain at every
response, as many more of which are to be expected: its price is a share 2 / (n + 1) of that after the first record.

A loop that is unstable in force, on every model or on the likeliest with a second record that agrees, gets what the
guard has proved, however slow. The worst case is the guard's (guard/proof.py); only sets that it proved are weighed.
"""

import math
from collections.abc import Sequence

from retuner.adaptive.choice.choice_settings import ChoiceSettings
from retuner.adaptive.decision_numbers import Numbers
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.identification.robust_simc import RobustSettings, robust_simc_on
from retuner.adaptive.loop.margins import EDGE, sensitivity_peak
from retuner.adaptive.trial.batch_responses import ClosedLoop
from retuner.adaptive.trial.response_numbers import iaes, mean_ratio, storable
from retuner.schedule.gains import PidGains
from retuner.schedule.late_dataclass import dataclass, field, replace

MOST_MODELS = 16  # Models, the most likely ones, over which a cost is expected
FARTHEST = 50.0  # Where an exponential is 0 for every purpose here


@dataclass(frozen=True, slots=True)
class ModelEvidence:
    """What bears on whether the models are a fiction.

    records : that agree, in the model. clear : how many of them are setpoint steps from rest that the loop explains.
    loads : load steps that the fit of this one needed. limited : its output stood at a limit. left : more than noise
    is left of it.
    decay : half-cycle decay ratio of the response; None where it does not tell.
    """

    records: int
    clear: int = 0
    loads: int = 0
    limited: bool = False
    left: bool = False
    decay: float | None = None


def doubt(seen: ModelEvidence, settings: ChoiceSettings) -> float:
    """Probability that something else than any of the models is behind the records."""
    s = settings
    agrees = s.doubt_agrees if seen.clear else s.doubt_alike
    further, loads = min(max(seen.records - 1, 0), s.most_agree), min(seen.loads, s.most_agree)
    odds = s.doubt * agrees**further * s.doubt_load**loads
    odds *= s.doubt_clear if seen.clear else 1.0
    odds *= (s.doubt_limited if seen.limited else 1.0) * (s.doubt_left if seen.left else 1.0)
    return odds / (1.0 + odds)


@dataclass(frozen=True, slots=True)
class Choosable:
    """A set that may run. gains : what runs. between : largest Ms on the ways to the neighbours, as a share of its
    limit; 0 where nobody asks.
    """

    gains: PidGains
    between: float = 0.0


@dataclass(frozen=True, slots=True)
class Outlook:
    """What a set is expected to do.

    cost : on the models, see the head of this file. unknown : over the set in force where they are a fiction.
    j : IAE over that of SIMC. ms, ms_most : Ms. Both on the most likely model, ms_most on the worst; may be infinite.
    spread : standard deviation over the models of its cost over that of the set in force.
    unstable_on_all : whether it is unstable on every model.
    """

    cost: float
    unknown: float
    j: float
    ms: float
    ms_most: float
    spread: float = 0.0
    unstable_on_all: bool = False

    @property
    def stable(self) -> bool:
        """Whether the set is stable on the most likely model."""
        return math.isfinite(self.ms)


@dataclass(frozen=True, slots=True)
class LoopSettings:
    """The controller's sampling time in seconds, setpoint weight, filter time of the derivative in seconds."""

    sample_time_s: float
    b: float = 1.0
    tau_f_s: float = 0.0


def outlooks(
    allowed: Sequence[Plausible],
    sets: Sequence[Choosable],
    decay: float | None,
    loop: LoopSettings,
    settings: ChoiceSettings,
) -> list[Outlook]:
    """What each set is expected to do; the first is the one in force.

    allowed : at least one model. decay : see ModelEvidence.
    """
    found = sorted(allowed, key=lambda model: model.excess)[:MOST_MODELS]  # stable: the best one stays first
    sampled = [plausible.model.seen_by_controller(loop.sample_time_s) for plausible in found]
    weights = [math.exp(-plausible.excess / (2 * settings.temper)) for plausible in found]
    processes, n = [model.linear() for model in sampled], len(sampled)
    # J by set and process, over that of the rule within the limit of Ms
    robust = RobustSettings(settings.ms_limit, ms_worst=math.inf, ms_third=math.inf, tau_f_s=loop.tau_f_s)
    rules = [(m.linear(), robust_simc_on(m, (), 0.0, robust, sets[0].gains).tuning.gains) for m in sampled]
    pairs = [(process, choosable.gains) for choosable in sets for process in processes]
    loops = [ClosedLoop(process, gains, loop.b, loop.tau_f_s) for process, gains in (*pairs, *rules)]
    iae = iaes(loops)
    of_rule = iae[-n:]
    rows = [[_j(iae[i * n + k], of_rule[k]) for k in range(n)] for i in range(len(sets))]
    peaks = [[sensitivity_peak(process, one.gains, loop.tau_f_s) for process in processes] for one in sets]
    table = [[cost(j, ms, settings) for j, ms in zip(*pair, strict=True)] for pair in zip(rows, peaks, strict=True)]
    ends = [[math.isfinite(j + ms) for j, ms in zip(*pair, strict=True)] for pair in zip(rows, peaks, strict=True)]
    for k in range(n):  # on a model an unstable set costs more than every stable one
        stable = [costs[k] for costs, stays in zip(table, ends, strict=True) if stays[k]]
        most = max([settings.most, *(one + settings.out for one in stable)])
        for costs, stays in zip(table, ends, strict=True):
            costs[k] = costs[k] if stays[k] else most
    made: list[Outlook] = []
    for choosable, row, ms, costs in zip(sets, rows, peaks, table, strict=True):
        between = over(choosable.between, settings) if choosable.between else 0.0
        over_now = [c - stays for c, stays in zip(costs, table[0], strict=True)]
        middle = _mean(over_now, weights)
        spread = math.sqrt(_mean([(c - middle) ** 2 for c in over_now], weights))
        unknown = if_unknown(sets[0].gains, choosable.gains, decay, settings)
        on_all = all(map(math.isinf, ms))
        made.append(Outlook(_mean(costs, weights) + between, unknown, row[0], ms[0], max(ms), spread, on_all))
    # A set that is unstable on the likeliest model costs no less than every stable one there
    stable = [one.cost + settings.out for one in made if one.stable]
    return [one if one.stable else replace(one, cost=max([one.cost, *stable])) for one in made]


def _mean(values: Sequence[float], weights: Sequence[float]) -> float:
    return sum(w * x for w, x in zip(weights, values, strict=True)) / sum(weights)


def _j(now: Sequence[float], rule: Sequence[float]) -> float:
    """Mean of the ratios; infinite where a loop never comes to rest, 1 where the rule's does not."""
    return (mean_ratio(now, rule) or 1.0) if all(map(math.isfinite, now)) else math.inf


def cost(j: float, ms: float, settings: ChoiceSettings) -> float:
    """Cost of a set on one model (see the head of this file); for an unstable one its least cost."""
    if not math.isfinite(ms) or not math.isfinite(j):
        return settings.most
    late = math.log(j / settings.j_limit)
    kept = _step(-math.log(ms / settings.ms_limit) / settings.ms_width)
    slow = math.log(j) * (kept if j < 1.0 else 1.0) + settings.out * _step(late / settings.j_width)
    return max(slow, min(slow + over(ms / settings.ms_limit, settings), settings.most))


def over(ratio: float, settings: ChoiceSettings) -> float:
    """Cost of an Ms that is so many times its limit."""
    if not math.isfinite(ratio):
        return settings.most
    x = math.log(ratio) / settings.ms_width
    rise = settings.ms_slope * settings.ms_width * (math.log1p(math.exp(x)) if x < FARTHEST else x)
    return rise + settings.out * _step(x)


def _step(x: float) -> float:
    return 1.0 / (1.0 + math.exp(-max(min(x, FARTHEST), -FARTHEST)))


def if_unknown(now: PidGains, new: PidGains, decay: float | None, settings: ChoiceSettings) -> float:
    """Cost of new gains over those in force where nothing is known but the response."""
    swung, s = decay or 0.0, settings
    pairs = ((now.kp, new.kp), (now.ki, new.ki))
    more = max([*(_log_factor(a, b) for a, b in (*pairs, (now.kd, new.kd))), 0.0])
    less = -min([*(_log_factor(a, b) for a, b in pairs), 0.0])
    risk = s.most_risk * -math.expm1(-more * (s.risk + s.risk_swing * swung) / s.most_risk)
    slower = s.most if now.ki and not new.ki else max(-_log_factor(now.ki, new.ki), 0.0)
    helped = s.relief * max(swung - s.calm_decay, 0.0) * less
    return max(min(risk + slower - helped, s.most), -s.most)


def _log_factor(old: float, new: float) -> float:
    """Logarithm of the factor from one gain to another; an action that comes or goes counts as twice or half of one.

    At the period at which it weighs as much as the action beside it, it doubles what the controller does.
    """
    if not (old or new):
        return 0.0
    return math.log(abs(new) / abs(old)) if old and new else math.copysign(math.log(2.0), abs(new) - abs(old))


@dataclass(frozen=True, slots=True)
class ChoiceNumbers(Numbers):
    """What was weighed, of the best set that may be written.

    gain : expected, as a natural logarithm of IAE, with its price. spread : its standard deviation over the models.
    doubt : probability of something else.
    iae : J over J in force on the most likely model. ms, ms_most : Ms there and on the worst one; ms_before : in force.
    -1 where it is not known or unstable.
    """

    gain: float
    price: float
    doubt: float
    iae: float
    ms: float
    ms_most: float
    ms_before: float
    spread: float = 0.0


@dataclass(frozen=True, slots=True)
class Choice:
    """index : of the set to run, 0 for the one in force. best : of the best other one. waits : with more records that
    agree it may go. numbers : what was weighed. reason : in words.
    """

    index: int
    best: int
    waits: bool
    numbers: ChoiceNumbers
    reason: str = field(default="")


def choose(found: Sequence[Outlook], way: Outlook | None, seen: ModelEvidence, settings: ChoiceSettings) -> Choice:
    """Which set shall run.

    found : the set in force first, then at least one that is proved.
    way : of the whole way on which limits allow a step only; such a step need not bring its price by itself.
    """
    p = doubt(seen, settings)
    gains = [_gain(found[0], outlook, p) for outlook in found]
    danger = in_danger(found, seen)
    # in danger the best of what is stable on the most likely model; where nothing is, the whole of the proved change
    able = [i for i in range(1, len(found)) if found[i].stable or not danger] or [1]
    best = max(able, key=lambda i: gains[i])
    asked = [(gains[best], (1.0 - p) * found[best].spread)]
    if way is not None:
        asked.append((_gain(found[0], way, p), (1.0 - p) * way.spread))
    share = 2.0 / (max(seen.records, 1) + 1.0)
    sure, price = settings.sure * math.sqrt(share), settings.price * max(share, settings.price_settled)
    brings, spread = max(asked, key=lambda one: one[0] - sure * one[1])
    pays = gains[best] > 0.0 and brings > price
    goes = danger or (pays and brings > price + sure * spread)
    more = doubt(replace(seen, records=seen.records + 1), settings)
    waits = not goes and (pays or _gain(found[0], found[best], more) > price)
    now, then = found[0], found[best]
    iae = then.j / now.j if math.isfinite(now.j) and math.isfinite(then.j) else -1.0
    told = storable(then.ms), storable(then.ms_most), storable(now.ms)
    numbers = ChoiceNumbers(brings, price, p, iae, *told, spread)
    return Choice(best if goes else 0, best, waits, numbers, _words(numbers, goes=goes, waits=waits, pays=pays))


def in_danger(found: Sequence[Outlook], seen: ModelEvidence) -> bool:
    """Whether the set in force is unstable and what was proved in its place is to run, whatever it costs."""
    now = found[0]
    return not now.stable and (now.unstable_on_all or seen.records > 1)


def _gain(now: Outlook, then: Outlook, p: float) -> float:
    """What a set is expected to cost less than the one in force."""
    return (1.0 - p) * (now.cost - then.cost) - p * then.unknown


def _words(numbers: ChoiceNumbers, *, goes: bool, waits: bool, pays: bool) -> str:
    iae = f"IAE {percent(numbers.iae)} of the present" if numbers.iae >= 0 else "IAE not comparable"
    then = f"Ms {_ms(numbers.ms)} (at most {_ms(numbers.ms_most)}) instead of {_ms(numbers.ms_before)}"
    chance = percent(numbers.doubt) if numbers.doubt >= LEAST_SAID else f"less than {percent(LEAST_SAID)}"
    sure = f"{chance} chance that something other than the tuning explains this"
    if goes:
        return f"expected: {iae}, {then}; {sure}"
    worth, needed = percent(numbers.gain), percent(numbers.price)
    if pays:
        why = f"expected benefit {worth} +- {percent(numbers.spread)}: another record must agree"
    elif waits:
        why = "a second record must agree first"
    elif numbers.gain > numbers.price:
        why = f"the whole change would bring {worth}, but the part that the limits allow does not pay"
    else:
        if worth == needed:  # rounded down, so that what is too little reads as too little
            worth, needed = percent(math.floor(1000.0 * numbers.gain) / 1000.0, 1), percent(numbers.price, 1)
        why = f"expected benefit {worth}; changes start at {needed}"
    return f"no change{' yet' if waits else ''}: expected {iae}, {then}; {sure}; {why}"


def percent(share: float, digits: int = 0) -> str:
    """A share in percent."""
    return f"{100.0 * share:.{digits}f} %"


LEAST_SAID = 0.01  # probability below which its digits say nothing


def _ms(ms: float) -> str:
    if ms > EDGE:
        return f"over {EDGE:g}"
    return f"{ms:.2f}" if ms >= 0 else "unstable"
