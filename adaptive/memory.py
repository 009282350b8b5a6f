"""A retuner's memory as plain values, versioned: what it must not lose over a restart.

Everything that later decisions depend on is in it: the table, what is known of each region, where region, noise band
and recogniser stand, and the samples of the response under way. A retuner that is restored from it decides byte for
byte as the one that was never stopped.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from retuner.adaptive.estimate import LogModel
from retuner.adaptive.noise import NoiseState
from retuner.adaptive.process import ProcessType
from retuner.adaptive.recogniser import RecogniserState
from retuner.adaptive.retuner import Retuner, RetunerState
from retuner.adaptive.retuner_settings import RetunerSettings
from retuner.adaptive.sample import LoopSample
from retuner.adaptive.tracker import Belief, Known
from retuner.schedule.document import from_toml, to_toml
from retuner.schedule.regions import RegionState

VERSION = 2
"""Of this layout; newer ones are refused."""


def remember(retuner: Retuner) -> dict[str, object]:
    """The memory as a dict of plain JSON values (infinities as the string "inf")."""
    state = retuner.state()
    return {
        "version": VERSION,
        "table": to_toml(retuner.table),
        "beliefs": {str(region): _belief_out(belief) for region, belief in retuner.beliefs.items()},
        "region": _numbers_out(state.region),
        "recogniser": _numbers_out(state.recogniser),
        "noise": _numbers_out(state.noise),
        "samples": [_numbers_out(sample) for sample in state.samples],
        "decisions": state.decisions,
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
        retuner = Retuner(from_toml(memory["table"]), settings)
        retuner.beliefs = {int(region): _belief_in(body) for region, body in memory["beliefs"].items()}
        retuner.resume(
            RetunerState(
                region=_region_in(memory["region"]),
                recogniser=RecogniserState(*_numbers_in(memory["recogniser"])) if memory["recogniser"] else None,
                noise=NoiseState(*_numbers_in(memory["noise"])),
                samples=tuple(LoopSample(*_numbers_in(sample)) for sample in memory["samples"]),
                decisions=int(memory["decisions"]),
            )
        )
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"the memory is damaged: {error!r}") from error
    return retuner


def _numbers_out(values: Sequence[Any] | None) -> list[Any] | None:
    """A tuple of numbers as JSON can hold it."""
    return None if values is None else [v if v != float("inf") else "inf" for v in values]


def _numbers_in(values: Sequence[Any]) -> list[Any]:
    """And back."""
    return [float(v) if isinstance(v, str) else v for v in values]


def _region_in(values: Sequence[Any] | None) -> RegionState | None:
    """A region state, if there was one."""
    return None if values is None else RegionState(*_numbers_in(values))


def _known_out(known: tuple[Known, ...] | None) -> list[dict[str, object]] | None:
    """What is known by structure: parameters with their covariance, and the evidence."""
    if known is None:
        return None
    return [
        {"type": str(k.log.type), "x": k.log.x.tolist(), "p": k.log.p.tolist(), "sign": k.log.sign,
         "evidence": k.evidence}
        for k in known
    ]  # fmt: skip


def _known_in(bodies: Sequence[Mapping[str, Any]] | None) -> tuple[Known, ...] | None:
    """And back; checked on the way in."""
    if bodies is None:
        return None
    return tuple(
        Known(
            LogModel(
                np.array(body["x"], dtype=np.float64),
                np.array(body["p"], dtype=np.float64),
                int(body["sign"]),
                ProcessType(body["type"]),
            ),
            float(body["evidence"]),
        )
        for body in bodies
    )


def _belief_out(belief: Belief) -> dict[str, object]:
    """What is known of a region."""
    return {
        "known": _known_out(belief.known),
        "records": belief.records,
        "t_s": belief.t_s,
        "rival": _known_out(belief.rival),
    }


def _belief_in(body: Mapping[str, Any]) -> Belief:
    """And back."""
    known = _known_in(body["known"])
    if not known:
        raise TypeError("a belief without a model")
    return Belief(known, int(body["records"]), float(body["t_s"]), _known_in(body["rival"]))
