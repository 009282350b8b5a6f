"""A retuner's memory as plain values, versioned: what it must not lose over a restart.

Everything that later decisions depend on is in it: the table, what is known of each region, where region, noise band
and recogniser stand, and the samples of the response under way. A retuner that is restored from it decides byte for
byte as the one that was never stopped.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from retuner.adaptive.belief_memory import belief_in, belief_out
from retuner.adaptive.diagnosis.cause import Cause
from retuner.adaptive.diagnosis.confirmation import Excitation
from retuner.adaptive.diagnosis.online import Standing
from retuner.adaptive.noise import NoiseState
from retuner.adaptive.recogniser import RecogniserState
from retuner.adaptive.retuner import Retuner, RetunerState
from retuner.adaptive.retuner_settings import RetunerSettings
from retuner.adaptive.sample import LoopSample
from retuner.adaptive.watcher import WatcherState
from retuner.schedule.document import from_toml, to_toml
from retuner.schedule.regions import RegionState

VERSION = 6
"""Of this layout; newer ones are refused."""


def remember(retuner: Retuner) -> dict[str, object]:
    """The memory as a dict of plain JSON values (infinities and NaN as strings)."""
    state = retuner.state()
    watcher = state.watcher
    return {
        "version": VERSION,
        "table": to_toml(retuner.table),
        "beliefs": {str(region): belief_out(belief) for region, belief in retuner.beliefs.items()},
        "commissioned": to_toml(retuner.commissioned),
        "region": _numbers_out(watcher.region),
        "recogniser": _numbers_out(watcher.recogniser),
        "noise": _numbers_out(watcher.noise),
        "samples": [_numbers_out(sample) for sample in watcher.samples],
        "decisions": state.decisions,
        "trials": retuner.desk.to_dict(),
        "standing": {
            str(region): [str(s.cause), s.period_s, s.t_s, s.reason] for region, s in retuner.standing.items()
        },
        "excitation": {
            str(region): [e.setpoints, e.loads, e.asked, e.clear, e.rival] for region, e in retuner.excitation.items()
        },
    }


def restore(memory: Mapping[str, Any], settings: RetunerSettings) -> Retuner:
    """A retuner that goes on where the remembered one stood.

    Raises
    ------
    ValueError
        The memory is of another version, or something in it is missing or no number.
    """
    if memory.get("version") != VERSION:
        raise ValueError(
            f"memory version {memory.get('version')!r} is not {VERSION}; it was written by another release"
        )
    try:
        retuner = Retuner(from_toml(memory["table"]), settings, from_toml(memory["commissioned"]))
        retuner.beliefs = {int(region): belief_in(body) for region, body in memory["beliefs"].items()}
        retuner.standing = {
            int(region): Standing(Cause(cause), float(period_s), float(t_s), str(reason))
            for region, (cause, period_s, t_s, reason) in memory["standing"].items()
        }
        retuner.excitation = {
            int(region): Excitation(*(int(count) for count in counts))
            for region, counts in memory["excitation"].items()
        }
        watcher = WatcherState(
            region=_region_in(memory["region"]),
            recogniser=RecogniserState(*_numbers_in(memory["recogniser"])) if memory["recogniser"] else None,
            noise=NoiseState(*_numbers_in(memory["noise"])),
            samples=tuple(LoopSample(*_numbers_in(sample)) for sample in memory["samples"]),
        )
        retuner.desk.resume(memory["trials"])
        retuner.resume(RetunerState(watcher, int(memory["decisions"])))
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"the memory is damaged: {error!r}") from error
    return retuner


def _numbers_out(values: Sequence[Any] | None) -> list[Any] | None:
    """A tuple of numbers as JSON can hold it: what is not finite as a string."""
    return None if values is None else [v if math.isfinite(v) else str(v) for v in values]


def _numbers_in(values: Sequence[Any]) -> list[Any]:
    """And back."""
    return [float(v) if isinstance(v, str) else v for v in values]


def _region_in(values: Sequence[Any] | None) -> RegionState | None:
    """A region state, if there was one."""
    return None if values is None else RegionState(*_numbers_in(values))
