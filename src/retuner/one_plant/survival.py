"""Whether the loops on one plant survive a change of one of them, as far as the plant is known.

all loops' records -> answers to every output (interaction/) -> Ms of each loop, closed together, before and after
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from retuner.adaptive.interaction.together import Closed, together
from retuner.adaptive.interaction.windows import Record, seen_in
from retuner.adaptive.supervision.pipeline import decide
from retuner.adaptive.supervision.pipeline_types import IN_PART, Question, StageResult, half_way, without_change
from retuner.schedule.gains import PidGains

NO_WORSE = 1.05
"""An Ms over the limit may grow by this factor: the plant is known no better."""


@dataclass(frozen=True, slots=True)
class Among:
    """A loop among the others on its plant; plain values, so that another process may work it out.

    names, closed, records : of all loops. dt_s : of the records. own : index of the loop. ms_most : largest Ms of a
    loop among the others.
    """

    names: tuple[str, ...]
    closed: tuple[Closed, ...]
    records: tuple[Record, ...]
    dt_s: float
    own: int
    ms_most: float

    def answered(self, question: Question, result: StageResult) -> StageResult:
        """The answer to a question; with half of its change, or none, where the others do not survive it."""
        gains = None if result.verdict is None else result.verdict.gains
        words = "" if gains is None else self._against(gains)
        if gains is None or not words:
            return result
        half = decide(half_way(question, gains))
        less = half.verdict.gains if half.verdict is not None and half.verdict.accepted else None
        if less is None or self._against(less):
            return without_change(result, words)
        return replace(half, reason=f"{IN_PART}{words}: {half.reason}")

    def _against(self, gains: PidGains) -> str:
        """What speaks against these gains; empty for nothing, or where the plant is not known."""
        plant = seen_in(self.records, self.dt_s)
        if plant is None:
            return ""
        now = together(plant, self.closed)
        changed = [replace(one, gains=gains) if i == self.own else one for i, one in enumerate(self.closed)]
        then = together(plant, changed)
        told = [
            f"Ms of {name} {_shown(after)}, now {_shown(before)}"
            for name, before, after in zip(self.names, now, then, strict=True)
            if after > max(self.ms_most, NO_WORSE * before)
        ]
        if not told:
            return ""
        others = " and ".join(name for i, name in enumerate(self.names) if i != self.own)
        return f"refused: with {others} on the same plant: {'; '.join(told)}; limit {self.ms_most:g}"


def _shown(ms: float) -> str:
    return "infinite" if ms == float("inf") else f"{ms:.2f}"


def on_one_clock(samples: Sequence[Sequence[tuple[float, ...]]], dt_s: float) -> tuple[Record, ...]:
    """What loops have kept as records at the same times, from when all were watched; samples : (t_s, sp, pv, co, ...).

    Each controller counts its own time: the newest samples are taken for simultaneous where they are further apart than
    two sample times.
    """
    import numpy as np  # noqa: PLC0415  only where loops share a plant

    every = [np.array([sample[:4] for sample in one], dtype=np.float64) for one in samples]
    end = float(every[0][-1, 0])
    for one in every[1:]:
        off = end - float(one[-1, 0])
        one[:, 0] += off if abs(off) > 2 * dt_s else 0.0
    begin = max(float(one[0, 0]) for one in every)
    t = end - dt_s * np.arange(int((end - begin) / dt_s + 1e-9), -1, -1)
    rows = [one[np.maximum(np.searchsorted(one[:, 0], t + dt_s / 1000, "right") - 1, 0)] for one in every]
    return tuple(Record(row[:, 1], row[:, 2], row[:, 3]) for row in rows)
