"""What is known of a region as plain JSON values, and back, checked on the way in."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from retuner.adaptive.belief import Belief, Known, RecordPoint
from retuner.adaptive.estimate import LogModel
from retuner.adaptive.plausible import Plausible
from retuner.adaptive.process import ProcessModel, ProcessType


def belief_out(belief: Belief) -> dict[str, object]:
    """What is known of a region."""
    return {
        "known": _known_out(belief.known),
        "records": belief.records,
        "t_s": belief.t_s,
        "rival": None if belief.rival is None else _known_out(belief.rival),
        "points": [
            {"t_s": p.t_s, "x": p.x, "x2": p.x2, "log": _log_out(p.log), "innovation": p.innovation}
            for p in belief.points
        ],
        "plausible": [{"model": p.model.to_dict(), "excess": p.excess} for p in belief.plausible],
        "identifiable": belief.identifiable,
        "reason": belief.reason,
    }


def belief_in(body: Mapping[str, Any]) -> Belief:
    """And back.

    Raises
    ------
    KeyError, TypeError, ValueError
        Something is missing, of the wrong kind, or no number.
    """
    known = _known_in(body["known"])
    if not known:
        raise TypeError("a belief without a model")
    rival = None if body["rival"] is None else _known_in(body["rival"])
    return Belief(
        known,
        int(body["records"]),
        float(body["t_s"]),
        rival,
        tuple(_point_in(point) for point in body["points"]),
        tuple(Plausible(_model_in(p["model"]), float(p["excess"])) for p in body["plausible"]),
        bool(body["identifiable"]),
        str(body["reason"]),
    )


def _known_out(known: Sequence[Known]) -> list[dict[str, object]]:
    """By structure: parameters with their covariance, and the evidence."""
    return [_log_out(k.log) | {"evidence": k.evidence} for k in known]


def _known_in(bodies: Sequence[Mapping[str, Any]]) -> tuple[Known, ...]:
    """And back."""
    return tuple(Known(_log_in(body), float(body["evidence"])) for body in bodies)


def _log_out(log: LogModel) -> dict[str, object]:
    """An estimate in logarithms."""
    return {"type": str(log.type), "x": log.x.tolist(), "p": log.p.tolist(), "sign": log.sign}


def _log_in(body: Mapping[str, Any]) -> LogModel:
    """And back."""
    x, p = (np.array(body[name], dtype=np.float64) for name in ("x", "p"))
    return LogModel(x, p, int(body["sign"]), ProcessType(body["type"]))


def _point_in(body: Mapping[str, Any]) -> RecordPoint:
    """One record by itself."""
    t_s, x, x2, innovation = (float(body[name]) for name in ("t_s", "x", "x2", "innovation"))
    return RecordPoint(t_s, x, x2, _log_in(body["log"]), innovation)


def _model_in(body: Mapping[str, Any]) -> ProcessModel:
    """A model from its own keys."""
    k, tau1, tau2, theta = (float(body[name]) for name in ("k", "tau1", "tau2", "theta"))
    return ProcessModel(ProcessType(body["type"]), k, tau1, tau2, theta, float(body.get("zeta", 1.0)))
