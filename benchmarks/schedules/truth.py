"""What is true of a subject: the best settings at each place, who is in spec there, and how few sets could do it.

In spec as everywhere: true Ms <= max(1.8, 1.03 of SIMC with perfect knowledge) and J <= 1.25 of that SIMC (judge.py).
"""

import math
from dataclasses import dataclass
from functools import cached_property

from online.judge import Judge, Judgement

from retuner.schedule.gains import PidGains
from schedules.lookups import Curve, Lookup, mixed
from schedules.subject import Subject


@dataclass(frozen=True)
class Truth:
    """At so many places."""

    subject: Subject
    count: int

    @cached_property
    def places(self) -> list[float]:
        """Where it is judged."""
        return self.subject.places(self.count)

    @cached_property
    def judges(self) -> list[Judge]:
        """One a place."""
        return [self.subject.judge(place) for place in self.places]

    def best(self) -> list[PidGains]:
        """SIMC with perfect knowledge at each place."""
        return [judge.best for judge in self.judges]

    def perfect(self) -> Curve:
        """The continuous table: perfect knowledge at every place."""
        return Curve(self.places, self.best())

    def judged(self, lookup: Lookup) -> list[Judgement]:
        """The gains in force at each place."""
        return [judge.of(lookup.frozen(x)) for judge, x in zip(self.judges, self.places, strict=True)]

    @cached_property
    def fewest(self) -> tuple[int, int]:
        """How few regions with steps, and how few knots with straight lines between, have every place in spec.

        Only sets that are best at some place are tried. Steps: each region as long as one set of its own does. Lines:
        the shortest way over knots at the places; outside the outermost knots the gains stay. An upper bound of the
        fewest, and 0 where even the best sets are not in spec.
        """
        best = self.best()
        if not all(self._ok(i, best[i]) for i in range(self.count)):
            return 0, 0
        regions, begin = 0, 0
        while begin < self.count:
            ends = [begin]
            for gains in best[begin:]:
                end = begin
                while end < self.count and self._ok(end, gains):
                    end += 1
                ends.append(end)
                if end <= begin:
                    break
            begin, regions = max(ends), regions + 1
        n = self.count
        starts = [all(self._ok(m, best[j]) for m in range(j)) for j in range(n)]
        fewest = [1 if ok else n for ok in starts]
        for j in range(1, n):
            for i in range(j):
                if fewest[i] + 1 < fewest[j] and self._between(best, i, j):
                    fewest[j] = fewest[i] + 1
        return regions, min(fewest[i] for i in range(n) if all(self._ok(m, best[i]) for m in range(i + 1, n)))

    def _ok(self, i: int, gains: PidGains) -> bool:
        return self.judges[i].of(gains).in_spec

    def _between(self, best: list[PidGains], i: int, j: int) -> bool:
        inside = sorted(range(i + 1, j), key=lambda m: abs(2 * m - i - j))
        return all(self._ok(m, mixed(best[i], best[j], (m - i) / (j - i))) for m in inside)


def counts(truth: Truth, lookup: Lookup) -> dict[str, float]:
    """Places in spec, those where Ms is too large, those that are unstable, and the worst Ms."""
    judged = truth.judged(lookup)
    fast = sum(j.ms > judge.ms_limit for j, judge in zip(judged, truth.judges, strict=True))
    return {
        "places": len(judged),
        "spec": sum(j.in_spec for j in judged),
        "fast": fast,
        "unstable": sum(not math.isfinite(j.ms) for j in judged),
        "ms": max(j.ms for j in judged),
    }
