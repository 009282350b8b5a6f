"""Which structure and how many load steps: rivals refined, each judged by what it leaves, and the best one polished.

    criterion = n ln sigma_e^2 + (unknowns + order of the whitening filter) ln n        (Schwarz 1978)

sigma_e is what remains after the remainder's colour is taken out (fit/misfit.py), so a load step, a second lag and a
drifting disturbance compete on the same footing: a structure that leaves a smooth remainder pays for the filter, and
fake load steps gain little where a filter explains the same. The winner and its close rivals are refitted with the
remainder whitened, which is what makes the estimate unbiased in closed loop and its standard deviations true.
"""

import math
from collections.abc import Sequence
from functools import lru_cache, partial
from itertools import pairwise

import numpy as np

from retuner.adaptive.fit.engine import compiled
from retuner.adaptive.fit.misfit import LOAD_COST, MOST_ORDER, Misfit
from retuner.adaptive.fit.record import Record
from retuner.adaptive.fit.refine import EXACT, Fit, refine
from retuner.adaptive.fit.search import (
    behind_a_lag,
    instants,
    load_times,
    long_lag,
    starts,
    with_one_more,
    with_second_lag,
)
from retuner.adaptive.fit.structure import LAG, SIZE, dynamics_at
from retuner.adaptive.identification.candidate import Candidate, CandidateList, judged
from retuner.adaptive.identification.loads import MOVE_EVALUATIONS, PROMISING, SCAN, improved, linear_gains
from retuner.adaptive.identification.usual_dead_time import usual
from retuner.adaptive.process.model import ProcessType
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.schedule.late_dataclass import dataclass, replace

FIRST, SECOND, INTEGRATING, INTEGRATING_LAG, INVERSE, THIRD, LEAD = (
    ProcessType.FOPDT, ProcessType.SOPDT, ProcessType.INTEGRATING, ProcessType.INTEGRATING_LAG,
    ProcessType.SOPDT_INVERSE, ProcessType.TOPDT, ProcessType.SOPDT_LEAD,
)  # fmt: skip
ROUGH = 12  # evaluations of a refinement that only ranks the starts
RELATIVE_MOVES = 2  # moves with which the other structures may still improve in the winner's clothes
WIDER_SEARCH_RATIO = 1.3  # A remainder this many times the noise asks for a wider search
SWALLOWED = 5.0
"""What is left over the noise of pv from which a filter hides loads: noise itself is seen at a third of it at least."""
WHITE_MOVES = 40
"""Moves tried for loads in what is taken for white: a dozen of them, each found, shifted and tried without."""
CLOSE = 12.0  # rivals within this of the best criterion are kept (a likelihood ratio of e^-6)


@dataclass(frozen=True, slots=True)
class StructureSettings:
    """Settings of the choice.

    seeded_loads : load steps looked for by the coarse search; 0 to 3, default 2.
    most_loads : load steps in all; 0 to 12, default 4.
    most_samples : rivals are compared on at most this many samples; 300 to 3000, default 800.
    starts : starts refined per structure and number of loads; 1 to 8, default 3 (nested local optima).
    most_order : highest order of a whitening filter for what is left; 0 to 8, default 4.
    start_spread : see Misfit; default 0.3, 0 for an experiment that is known to begin at rest.
    further : structures of five numbers that are among those tried; default an inverse response, a third lag and a
        lead; on line no lead. Where causes are compared there is no other: a zero that has not come back yet explains a
        process of the other sign, and a valve that slips late. Without a third lag no start is the process of a part of
        the record either: a part of a tone from outside is a process that swings.
    """

    seeded_loads: int = 2
    most_loads: int = 4
    most_samples: int = 800
    starts: int = 3
    most_order: int = MOST_ORDER
    start_spread: float = 0.3
    further: tuple[ProcessType, ...] = (INVERSE, THIRD, LEAD)


ON_LINE = StructureSettings(further=(INVERSE, THIRD))
"""Settings of the choice on line, where no loop with a lead was tried."""


def too_few(window: Window) -> str:
    """Why a record holds too few samples for any process, in words; empty where it has enough.

    Each gap in time is a start of its own, and a start has unknowns as a process has.
    """
    record = Record.of(window)
    largest = Misfit(record, THIRD, 1, 0, record.noise_std, 1.0, ramp=True)
    if largest.has_room:
        return ""
    gaps = f", cut by {len(record.gaps_s)} gaps," if record.gaps_s else ""
    return f"{len(record.pv)} samples{gaps} are fewer than a process and its starts have unknowns: take more of them"


def candidates(
    window: Window,
    signs: tuple[int, ...],
    settings: StructureSettings,
    most_samples: int,
    barred_s: tuple[float, ...] = (),
) -> list[Candidate]:
    """Every structure at its best, the winner first, with all further rivals that came close.

    window : the record. signs : of the gain to try. most_samples : of the final fits. barred_s : setpoint changes, s
    from the first sample, at which no load step is to stand.

    Raises ValueError: the record has too few samples (see too_few).
    """
    if short := too_few(window):
        raise ValueError(short)
    rivals = sorted(_rivals(window, signs, settings, barred_s), key=lambda c: c.criterion)
    seen = CandidateList(rivals)
    # Where the improvement starts: the best, the best of another structure, without load steps, all with a drift
    best = rivals[0]
    same = [c for c in rivals if c.fit.misfit.sign == best.fit.misfit.sign]
    by_type = list({c.fit.misfit.type: c for c in reversed(same)}.values())
    by_type.sort(key=lambda c: c.criterion)
    calm = [c for c in same if c.fit.misfit.loads == 0 and not c.fit.misfit.ramp][:1]
    drifting = {c.fit.misfit.type: c for c in reversed(same) if c.fit.misfit.ramp}
    for seed in list(dict.fromkeys([*by_type[: None if _far(best) else 2], *calm, *drifting.values()])):
        improved(seed, settings.most_loads, seen)
    winner = seen.best()
    if settings.most_loads and _swallows(winner):
        # Beside a filter each load alone pays little while the others are still in what is left: so they are found one
        # by one where all of that counts as white, for the best of each sign
        for sign in {c.fit.misfit.sign for c in rivals}:
            first = next(c.fit for c in rivals if (c.fit.misfit.sign, c.fit.misfit.type) == (sign, FIRST))
            white = judged(refine(replace(first.misfit, most_order=0), first.p))
            fit = improved(white, settings.most_loads, CandidateList([]), WHITE_MOVES).fit
            found = judged(replace(fit, misfit=replace(fit.misfit, most_order=first.misfit.most_order)))
            seen.add(improved(found, settings.most_loads, seen, RELATIVE_MOVES))
        winner = seen.best()
    if THIRD in settings.further and settings.most_loads and _far(winner):
        _from_parts(window, signs, settings, seen)
        winner = seen.best()
    if asked_for(winner) and not np.any(np.diff(window.sp)):
        few = [c for c in rivals if c.fit.misfit.loads < 2]  # two steps that stand for a ramp bend the process most
        with_corners([winner, *few], settings.most_loads, seen)
        winner = seen.best()
    for relative in _relatives(winner, seen, settings.further):
        seen.add(improved(relative, settings.most_loads, seen, RELATIVE_MOVES))
    whole = replace(Record.of(window, most_samples), barred_s=barred_s)
    ranked = seen.ranked(CLOSE)
    finished = {which: _on(whole, c) for which, c in {c.found: c for c in ranked}.items()}
    return CandidateList([finished[c.found] for c in ranked]).ranked(CLOSE)


def _on(record: Record, found: Candidate) -> Candidate:
    """The fit on all samples of the record, whitened, to the last digit."""
    misfit, p, left = found.fit.misfit, found.fit.p, found.colour
    if len(record.pv) > len(misfit.record.pv):
        again = judged(refine(replace(misfit, record=record, ar=(), sigma=record.noise_std), p))
        p, left = again.fit.p, again.colour
    white = replace(misfit, record=record, ar=left.ar, sigma=left.std)
    fit = refine(white, p, enough=EXACT)
    known = usual(misfit.type, fit.x)
    return judged(fit) if known is None else judged(refine(white, fit.p, known, enough=EXACT), known)


def _far(best: Candidate) -> bool:
    """Whether even the best explanation leaves more than white noise."""
    return best.colour.std > WIDER_SEARCH_RATIO * best.fit.misfit.record.noise_std or bool(best.colour.ar)


PARTS = 3  # Parts of a record whose own processes are starts for the whole


def _from_parts(window: Window, signs: tuple[int, ...], settings: StructureSettings, seen: CandidateList) -> None:
    """Notes the better explanations that begin with the process of a part and the loads of the whole record.

    A part has few loads, so its search finds the process; with several sharp loads the search of the whole, which
    places them on a grid, ends in a local optimum. A worse explanation that begins so is no rival, and is not noted.
    """
    fit = seen.best().fit
    record = fit.misfit.record
    if fit.misfit.loads < 2 and np.std(record.pv - fit.explained) <= WIDER_SEARCH_RATIO * record.noise_std:
        return  # one load that leaves next to the noise alone is where it belongs
    edges = np.linspace(0, len(window.t_s), PARTS + 1).round().astype(int).tolist()
    for first, end in pairwise(edges):
        part = window.part(slice(first, end))
        if np.ptp(part.pv) == 0 or np.ptp(part.co) == 0 or too_few(part):
            continue
        lags = [one for one in _rivals(part, signs, settings) if one.fit.misfit.type in LAG]
        if lags:
            best = min(lags, key=lambda c: c.criterion).fit
            bare = replace(best.misfit, record=record, loads=0, ramp=False, ar=(), sigma=record.noise_std)
            times = load_times(bare, best.x, settings.most_loads)
            start = judged(refine(replace(bare, loads=len(times)), np.concatenate([best.x, times])))
            tried, known = CandidateList([start]), seen.best()
            if improved(start, settings.most_loads, tried).criterion < known.criterion:
                for one in tried.ranked(math.inf):
                    seen.add(one)


def _swallows(winner: Candidate) -> bool:
    """Whether a filter takes for coloured noise what is many times the noise: loads that were not found yet."""
    record = winner.fit.misfit.record
    return bool(winner.colour.ar) and float(np.std(record.pv - winner.fit.explained)) > SWALLOWED * record.noise_std


def _rivals(
    window: Window, signs: tuple[int, ...], settings: StructureSettings, barred_s: tuple[float, ...] = ()
) -> list[Candidate]:
    """Every structure with 0, 1, ... seeded loads, judged by what it leaves."""
    plain = replace(settings, most_loads=0, most_order=0, further=())
    found = (fit for sign in signs for fit in _structures(window.content, sign, plain, barred_s))
    return [judged(replace(fit, misfit=replace(fit.misfit, most_order=settings.most_order))) for fit in found]


@lru_cache(maxsize=16)  # a record is looked at by identification and by diagnosis, which judge by filters of their own
def _structures(
    content: tuple[tuple[bytes, ...], float], sign: int, settings: StructureSettings, barred_s: tuple[float, ...]
) -> list[Fit]:
    record = replace(Record.of(Window.holding(content), settings.most_samples), barred_s=barred_s)

    def misfit(type_: ProcessType, loads: int) -> Misfit:
        return Misfit(record, type_, sign, loads, record.noise_std, settings.start_spread)

    seeds = starts(misfit(FIRST, 0), settings.seeded_loads, settings.starts)
    slopes = starts(misfit(INTEGRATING, 0), settings.seeded_loads, 1)
    found: list[Fit] = []
    for loads in range(settings.seeded_loads + 1):
        if not seeds[loads] or not slopes[loads] or not misfit(SECOND, loads).has_room:
            break
        integrating = refine(misfit(INTEGRATING, loads), slopes[loads][0])
        points = [*seeds[loads][: settings.starts - (loads > 0)], long_lag(integrating, FIRST)]
        first = _best(misfit(FIRST, loads), points)
        with_lag = with_second_lag(integrating, INTEGRATING_LAG, [], 1)
        found += [integrating, first, with_lag]
        found.append(with_second_lag(first, SECOND, [with_lag], 2 + (loads > 0)))
    drifting = partial(replace, ramp=True)
    return [*found, *_drifting(drifting(misfit(FIRST, 0)), drifting(misfit(INTEGRATING, 0)), seeds[0])]


def _drifting(lag: Misfit, slope: Misfit, points: list[FloatArray]) -> list[Fit]:
    """Every structure beside a load that drifts: where all optima without one are fictions, no move leads there.

    points : starts of the lag. The integrating process has a search of its own, for a drift hides its gain.
    """
    if not points:
        return []
    first = _best(lag, points)
    integrating = refine(slope, starts(slope, 0, 1)[0][0])
    with_lag = with_second_lag(integrating, INTEGRATING_LAG, [], 1)
    return [first, with_second_lag(first, SECOND, [with_lag], 2), integrating, with_lag]


def _best(misfit: Misfit, points: list[FloatArray]) -> Fit:
    """The best optimum from several starts: roughly at first, then to the end from the best."""
    rough = [refine(misfit, p, evaluations=ROUGH) for p in points]
    best = min(rough, key=lambda fit: fit.deviance)
    return refine(misfit, best.p)


def _relatives(winner: Candidate, seen: CandidateList, further: Sequence[ProcessType]) -> list[Candidate]:
    """The other structures of the winner's sign, each with the winner's loads, drift and whitening filter."""
    fit = winner.fit
    found = []
    tail = fit.p[SIZE[fit.misfit.type] :]
    for type_ in SIZE:
        if type_ in {fit.misfit.type, INVERSE, THIRD, LEAD}:
            continue
        own = seen.best(type_, fit.misfit.sign)
        best = refine(replace(fit.misfit, type=type_), np.concatenate([own.fit.x, tail]))
        if type_ == SECOND and fit.misfit.type == FIRST:
            best = min(best, with_second_lag(fit, SECOND, []), key=lambda f: f.deviance)
        if type_ == INTEGRATING_LAG and fit.misfit.type == INTEGRATING:
            best = min(best, with_second_lag(fit, type_, []), key=lambda f: f.deviance)
        found.append(judged(best))
        seen.add(found[-1])
    return [*found, *_larger(winner, seen, further)] if further else found


def _larger(winner: Candidate, seen: CandidateList, further: Sequence[ProcessType]) -> list[Candidate]:
    """A zero of either side and a third lag, with as many load steps as the winner or fewer: these can pass for one.

    So can a load's own lag and a drift: behind a first order, the third lag is looked for without them.
    """
    misfit = winner.fit.misfit
    seconds = seen.by_loads(SECOND, misfit.sign, misfit.loads)
    firsts = seen.by_loads(FIRST, misfit.sign, misfit.loads, plain=True)
    tried = {type_: [with_one_more(c.fit, type_) for c in seconds] for type_ in further}
    for c in firsts if THIRD in further else ():
        larger = replace(c.fit.misfit, type=THIRD)
        tried[THIRD].append(refine(larger, behind_a_lag(c.fit, larger)))
    return [min(map(judged, tried[type_]), key=lambda c: c.criterion) for type_ in further]


# Loads that move along ramps: found corner by corner, where steps are a poor cover for them.
#
# A load that goes from one place to another in a time of its own is two changes of its slope. Steps that stand for it
# leave a remainder, and what they do not explain the process does: ramps into six loops of a seed gave one model,
# which was wrong. Ramps are asked for where nobody moved the setpoint, and where a single sharp step does not do.


SAMPLES_EACH = 4  # samples that a record needs for each unknown before another corner is looked for
PAIR = 2  # corners of one ramp


def asked_for(winner: Candidate) -> bool:
    """Whether loads may be ramps for all that a fit with steps shows: more than one sharp step, or a coloured rest."""
    misfit = winner.fit.misfit
    return misfit.loads > 1 or misfit.rounded or misfit.ramp or bool(winner.colour.ar)


def with_corners(starts: Sequence[Candidate], most: int, seen: CandidateList) -> None:
    """Notes the best explanations by ramps that are reached from these starts.

    starts : fits whose process is kept at first, while their loads are not. most : loads in all.
    """
    found = [_cornered(start, most, seen) for start in starts]
    best = min((c for c in found if c is not None), key=lambda c: c.criterion, default=None)
    if best is not None:
        improved(best, most, seen)


def _cornered(start: Candidate, most: int, seen: CandidateList) -> Candidate | None:
    """The best with one corner after another, None where there is room for none."""
    kept = replace(start.fit.misfit, loads=0, corners=0, rounded=False, ramp=False, ar=())
    kept = replace(kept, sigma=kept.record.noise_std)
    at, best = judged(refine(kept, start.fit.x, evaluations=0)), None
    for _ in range(most):
        found = _with_corner(at)
        if found is None:
            break
        at = found
        seen.add(at)
        if best is None or at.criterion < best.criterion:
            best = at
    return best


def _with_corner(at: Candidate) -> Candidate | None:
    """One corner more, where it takes away most; the first of a pair leaves the process as it is."""
    misfit, p = at.fit.misfit, at.fit.p
    if len(misfit.record.pv) < SAMPLES_EACH * (misfit.unknowns + LOAD_COST):
        return None
    record, places = misfit.record, instants(misfit.record.span_s, SCAN)
    engine = compiled()
    gains = engine.load_gains(misfit, p, places, corner=True) if engine else linear_gains(at, _ramps(at, places))
    best = int(np.argmax(gains))
    if gains[best] < PROMISING * LOAD_COST * math.log(len(record.pv)):
        return None
    after = SIZE[misfit.type] + misfit.loads
    more = replace(misfit, loads=misfit.loads + 1, corners=misfit.corners + 1)
    start = np.insert(p, after, places[best])
    single = more.corners % PAIR
    return judged(refine(more, start, evaluations=0 if single else MOVE_EVALUATIONS))


def _ramps(at: Candidate, places: FloatArray) -> FloatArray:
    """The responses to unit ramps that begin there, each one in size at most, shape (n, places)."""
    dynamics = dynamics_at(at.fit.misfit.type, at.fit.p)
    ramps = at.fit.misfit.lagged(at.fit.p, dynamics.ramp(at.fit.misfit.record.t_s[:, None] - places[None, :]))
    largest = np.maximum(np.max(np.abs(ramps), axis=0), np.finfo(np.float64).tiny)
    return np.asarray(ramps / largest, dtype=np.float64)
