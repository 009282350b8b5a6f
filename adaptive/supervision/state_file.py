"""A retuner's memory as plain values, versioned: what it must not lose over a restart.

Everything that later decisions depend on is in it: the table, what is known of each region, where region, noise band
and recogniser stand, and the samples of the response under way. A retuner that is restored from it decides byte for
byte as the one that was never stopped. But for two: a question that is open, and a change that is due elsewhere with
the next sample, are not remembered. The next response that changes nothing where it is finds that change again.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np

from retuner.adaptive.diagnosis.second_opinion import Excitation
from retuner.adaptive.explanations.book import Book
from retuner.adaptive.identification.estimate import LogModel
from retuner.adaptive.identification.plausible import Plausible
from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.adaptive.region_model.co_curve import CoCurve
from retuner.adaptive.region_model.region_model import RecordPoint, RegionModel, StructureModel
from retuner.adaptive.signals.noise import NoiseState
from retuner.adaptive.signals.recogniser import RecogniserPhase, RecogniserState
from retuner.adaptive.signals.sample import LoopSample, Window, finite
from retuner.adaptive.signals.setpoint_steps import SetpointSteps
from retuner.adaptive.signals.step_sequence import SetpointMove
from retuner.adaptive.supervision.question import RetunerState, SetpointLed
from retuner.adaptive.supervision.response_finder import FinderState
from retuner.adaptive.supervision.retuner import Retuner
from retuner.adaptive.supervision.retuner_settings import RetunerSettings
from retuner.schedule.document import from_toml, to_toml
from retuner.schedule.gains import PidGains
from retuner.schedule.regions import RegionState

State = TypeVar("State")  # A named tuple of numbers
SERIES = ("t_s", "sp", "pv", "co")  # what a record is made of

# What is known of a region as plain JSON values, and back, checked on the way in.


def region_model_out(region_model: RegionModel) -> dict[str, object]:
    """What is known of a region."""
    return {
        "known": _known_out(region_model.known),
        "records": region_model.records,
        "t_s": region_model.t_s,
        "alternative": None if region_model.alternative is None else _known_out(region_model.alternative),
        "points": [
            {"t_s": p.t_s, "x": p.x, "x2": p.x2, "log": _log_out(p.log), "innovation": p.innovation}
            | ({} if p.co_curve is None else {"co_curve": [p.co_curve.slope, p.co_curve.std]})
            | {"told": [list(one) for one in p.told]}
            for p in region_model.points
        ],
        "plausible": [{"model": p.model.to_dict(), "excess": p.excess} for p in region_model.plausible],
        "identifiable": region_model.identifiable,
        "reason": region_model.reason,
        "windows": [
            {name: getattr(window, name).tolist() for name in SERIES} | {"noise_std": window.noise_std}
            for window in region_model.windows
        ],
        "sequences": [_steps_out(one) for one in region_model.sequences],
        "bound_s": region_model.bound_s,
    }


def region_model_in(body: Mapping[str, Any]) -> RegionModel:
    """What is known of a region, from its plain form.

    Raises KeyError, TypeError, ValueError: something is missing, of the wrong kind, or no number.
    """
    known = _known_in(body["known"])
    if not known:
        raise TypeError("a region without a model")
    alternative = None if body["alternative"] is None else _known_in(body["alternative"])
    return RegionModel(
        known,
        int(body["records"]),
        float(body["t_s"]),
        alternative,
        tuple(_point_in(point) for point in body["points"]),
        tuple(Plausible(_model_in(p["model"]), float(p["excess"])) for p in body["plausible"]),
        bool(body["identifiable"]),
        str(body["reason"]),
        tuple(_window_in(window) for window in body.get("windows", ())),
        tuple(_steps_in(one) for one in body.get("sequences", ())),  # averages of before have none
        float(body.get("bound_s", 0.0)),
    )


def _window_in(body: Mapping[str, Any]) -> Window:
    t_s, sp, pv, co = (np.array(body[name], dtype=np.float64) for name in SERIES)
    return Window(t_s, sp, pv, co, float(body["noise_std"]))


def _steps_out(one: SetpointSteps) -> dict[str, object]:
    gains, steps = [one.gains.kp, one.gains.ki, one.gains.kd], [list(step) for step in one.steps]
    return {"gains": gains, "dt_s": one.dt_s, "steps": steps, "pv": list(one.pv), "t_s": one.t_s}


def _steps_in(body: Mapping[str, Any]) -> SetpointSteps:
    gains = PidGains(*(float(value) for value in body["gains"]))
    steps = tuple(SetpointMove(int(at), float(size)) for at, size in body["steps"])
    pv = tuple(float(value) for value in body["pv"])
    return SetpointSteps(gains, float(body["dt_s"]), steps, pv, float(body["t_s"]))


def _known_out(known: Sequence[StructureModel]) -> list[dict[str, object]]:
    """The structures: parameters with their covariance, and the evidence."""
    return [_log_out(k.log) | {"evidence": k.evidence} for k in known]


def _known_in(bodies: Sequence[Mapping[str, Any]]) -> tuple[StructureModel, ...]:
    return tuple(StructureModel(_log_in(body), float(body["evidence"])) for body in bodies)


def _log_out(log: LogModel) -> dict[str, object]:
    return {"type": str(log.type), "x": log.x.tolist(), "p": log.p.tolist(), "sign": log.sign}


def _log_in(body: Mapping[str, Any]) -> LogModel:
    x, p = (np.array(body[name], dtype=np.float64) for name in ("x", "p"))
    return LogModel(x, p, int(body["sign"]), ProcessType(body["type"]))


def _point_in(body: Mapping[str, Any]) -> RecordPoint:
    t_s, x, x2, innovation = (float(body[name]) for name in ("t_s", "x", "x2", "innovation"))
    curve = body.get("co_curve")
    co_curve = None if curve is None else CoCurve(*curve)
    told = tuple((float(value), float(variance)) for value, variance in body["told"])
    return RecordPoint(t_s, x, x2, _log_in(body["log"]), innovation, co_curve, told)


def _model_in(body: Mapping[str, Any]) -> ProcessModel:
    k, tau1, tau2, theta = (float(body[name]) for name in ("k", "tau1", "tau2", "theta"))
    zeta, inverse, tau3 = float(body.get("zeta", 1.0)), float(body.get("inverse", 0.0)), float(body.get("tau3", 0.0))
    return ProcessModel(ProcessType(body["type"]), k, tau1, tau2, theta, zeta, inverse, tau3)


VERSION = 15  # version of this layout; any other is refused
STATES = (RegionState, RecogniserState, NoiseState, SetpointLed, LoopSample)
LAYOUT = {kind.__name__: list(kind._fields) for kind in STATES}
"""What is kept by place: numbers that moved would be read as others. Another layout is refused; memories of before
have none."""


def remember(retuner: Retuner) -> dict[str, object]:
    """What a retuner must not lose over a restart.

    Parameters
    ----------
    retuner : at any moment; a question that is open is not remembered.

    Returns
    -------
    dict
        Plain JSON values (infinities and NaN as strings), for `restore`.
    """
    state = retuner.state()
    finder = state.finder
    return {
        "version": VERSION,
        "layout": LAYOUT,
        "table": to_toml(retuner.table),
        "region_models": {
            str(region): region_model_out(region_model) for region, region_model in retuner.region_models.items()
        },
        "commissioned": to_toml(retuner.commissioned),
        "region": _numbers_out(finder.region),
        "recogniser": _numbers_out(finder.recogniser),
        "noise": _numbers_out(finder.noise),
        "setpoint_noise": _numbers_out(finder.setpoint),
        "rounding": finder.rounding,
        "broken": finder.broken,
        "led": _numbers_out(state.led),
        "samples": [_numbers_out(sample) for sample in finder.samples],
        "decisions": state.decisions,
        "samples_observed": state.samples,
        "looked_s": _numbers_out((state.looked_s,)),
        "books": {str(region): book.to_dict() for region, book in retuner.books.items()},
        "trials": retuner.trials.to_dict(),
        "foreign": {str(region): count for region, count in retuner.foreign.items()},
        "excitation": {
            str(region): [e.setpoints, e.loads, e.clear, e.alternative, e.rested, e.lost]
            for region, e in retuner.excitation.items()
        },
    }


def restore(memory: Mapping[str, Any], settings: RetunerSettings) -> Retuner:
    """A retuner that goes on where the remembered one stood.

    Parameters
    ----------
    memory : what `remember` gave. settings : as they were then, or others.

    Returns
    -------
    Retuner
        Tell it by `found_running` what the controller runs by now.

    Raises
    ------
    ValueError
        The memory is of another version, or something in it is missing or no number.
    """
    if memory.get("version") != VERSION:
        raise ValueError(
            f"memory version {memory.get('version')!r} is not {VERSION}; it was written by another release"
        )
    if memory.get("layout", LAYOUT) != LAYOUT:
        raise ValueError("the memory has another layout; it was written by another release")
    try:
        retuner = Retuner(from_toml(memory["table"]), settings, from_toml(memory["commissioned"]))
        retuner.region_models = {int(region): region_model_in(body) for region, body in memory["region_models"].items()}
        retuner.foreign = {int(region): int(count) for region, count in memory["foreign"].items()}
        retuner.excitation = {
            int(region): Excitation(*(int(count) for count in counts))
            for region, counts in memory["excitation"].items()
        }
        retuner.books = {int(region): Book.from_dict(body) for region, body in memory.get("books", {}).items()}
        values = memory["region"]
        finder = FinderState(
            region=None if values is None else _state_in(RegionState, values),
            recogniser=_recogniser_in(memory["recogniser"]),
            noise=_state_in(NoiseState, memory["noise"]),
            samples=_samples_in(memory["samples"]),
            setpoint=_state_in(NoiseState, setpoint) if (setpoint := memory.get("setpoint_noise")) else None,
            rounding=float(memory.get("rounding", 0.0)),
            broken=int(memory.get("broken", 0)),
        )
        retuner.trials.resume(memory["trials"])
        led = _state_in(SetpointLed, memory.get("led", SetpointLed()))
        (looked_s,) = _numbers_in(memory.get("looked_s", ("-inf",)))
        counted = int(memory["decisions"]), int(memory["samples_observed"])
        retuner.resume(RetunerState(finder, *counted, led, float(looked_s)))
    except (KeyError, TypeError, AttributeError, OverflowError) as error:
        raise ValueError(f"the memory is damaged: {error!r}") from error
    return retuner


def _numbers_out(values: Sequence[Any] | None) -> list[Any] | None:
    """A tuple of numbers as JSON can hold it: what is not finite as a string."""
    return None if values is None else [v if math.isfinite(v) else str(v) for v in values]


def _numbers_in(values: Sequence[Any]) -> list[Any]:
    return [float(v) if isinstance(v, str) else v for v in values]


def _recogniser_in(values: Sequence[Any] | None) -> RecogniserState | None:
    if not values:
        return None
    state = _state_in(RecogniserState, values)
    RecogniserPhase(state.phase)
    return state


def _samples_in(rows: Sequence[Sequence[Any]]) -> tuple[LoopSample, ...]:
    samples = tuple(_state_in(LoopSample, row) for row in rows)
    if not all(map(finite, samples)) or any(a.t_s >= b.t_s for a, b in pairwise(samples)):
        raise TypeError("samples whose time does not increase, or that are no numbers")
    return samples


def _state_in(kind: Callable[..., State], values: Sequence[Any]) -> State:
    """A state by its place in the layout; a value of another type shows that the layout was another one.

    Raises TypeError: a value is not of its type, or there are too few or too many.
    """
    found = _numbers_in(values)
    for wanted, value in zip(kind.__annotations__.values(), found, strict=False):  # the last ones may have defaults
        if not isinstance(value, (int, float) if wanted is float else int):
            raise TypeError(f"{value!r} is no {wanted.__name__}")
    return kind(*found)
