"""One record of a process that changes along its way: fitted in motion, with curves for its parameters.

A linear model of a long step over a process that changes is a fiction: where the gain falls along the way, pv begins
fast and ends early, and a shorter lag explains it. So the record is fitted as the schedule's design fits a whole day
(schedule_design/joint.py, motion.py): every parameter a curve over the scheduling variable, with a prior about the
linear model of the same record. What that says of any place comes with its covariance: much where the response went,
less beyond.

Nor does a percent of co act alike everywhere (a valve's curve, burst firing): on the way co is far from where it rests.
A fit that knows only the place of pv puts that into lags and bends, and Kc of a tank behind an equal-percentage valve
came out at 0.6 to 3.4 of what is right. So the slope of an installed characteristic is fitted beside, from what all
records so far say of it (co_curve.py). At a place it counts as it is for the co that rests there, by a straight line
between both ends of the record.
"""

import math
from collections.abc import Sequence

import numpy as np

from retuner.adaptive.identification.candidate import MODEL_ERROR
from retuner.adaptive.identification.estimate import LogModel, ModelEstimate, proper_covariance
from retuner.adaptive.process.model import ProcessType
from retuner.adaptive.region_model.co_curve import CoCurve, added, before
from retuner.adaptive.schedule_design.curves import inflation
from retuner.adaptive.schedule_design.joint import CurveForm, Joint, Noise, noise_of, refined
from retuner.adaptive.schedule_design.record_stretches import (
    SLOPE_STD,
    Characteristic,
    CurveAxis,
    CurveShape,
    Stretch,
    over,
    signals_of,
)
from retuner.adaptive.schedule_design.rest_curve import RestCurve
from retuner.adaptive.signals.noise import noise_sigma
from retuner.adaptive.signals.sample import FloatArray, Window
from retuner.schedule.late_dataclass import dataclass, replace

MOST_ROWS = 300  # rows of the record in the fit; longer ones are condensed
ITERATIONS = 15
BESIDE = 2.0
"""Dead times from a setpoint step within which no load step is believed."""
SECOND_LAG = 0.35  # share of theta with which a second lag starts


@dataclass(frozen=True, slots=True)
class InMotion:
    """One structure's curves as one record shows them.

    evidence : n ln sigma^2 and what load steps cost. left : standard deviation of what is not explained, pv units.
    rest : the co that holds a place.
    """

    type: ProcessType
    form: CurveForm
    rest: RestCurve
    z: FloatArray
    covariance: FloatArray
    evidence: float
    left: float

    def at(self, place: float) -> LogModel:
        """The process at a place, with its covariance."""
        rows = np.zeros((len(self.form.shapes), self.form.size))
        for i, (where, shape) in enumerate(zip(self.form.places, self.form.shapes, strict=True)):
            rows[i, where] = self.form.axis.columns(np.array(place), shape)
        if self.form.felt is not None:
            rows[0, self.form.felt_place] = self.form.felt.columns(self.rest.co(np.array([place])))[0]
        ln = np.array(self.form.centre) + rows @ self.z
        if self.form.felt is not None:
            ln[0] += self.form.felt.known(self.rest.co(np.array([place])))[0]
        slopes = np.stack(
            [(_log_of(ln + step) - _log_of(ln - step)) / (2 * STEP) for step in STEP * np.eye(len(ln))], 1
        )
        p = slopes @ rows @ self.covariance @ rows.T @ slopes.T
        return LogModel(_log_of(ln), proper_covariance(p), self.form.sign, self.type)

    @property
    def co_curve(self) -> CoCurve | None:
        """What this record adds to what was known of co's curve; None where that is nothing."""
        felt, i = self.form.felt, self.form.felt_place.start
        if felt is None:
            return None
        unit = felt.doubt * 2 * SLOPE_STD / (felt.axis.high - felt.axis.low)
        now = CoCurve(felt.slope + unit * float(self.z[i]), unit * math.sqrt(float(self.covariance[i, i])))
        return added(CoCurve(felt.slope, unit), now)


STEP = 1e-4


def _log_of(ln: FloatArray) -> FloatArray:
    """The logarithms of fit/structure.py from ln b, ln theta, ln tau (, ln tau2)."""
    b, theta, *lags = np.exp(ln).tolist()
    if len(lags) == 1:
        return np.asarray(ln, dtype=np.float64)
    total = lags[0] + lags[1]
    return np.log([b * lags[0] / total, theta, total, lags[0] * lags[1] / total])


def in_motion(
    window: Window, x: FloatArray, axis: CurveAxis, alone: ModelEstimate, curves: Sequence[CoCurve] = ()
) -> tuple[InMotion, ...]:
    """The curves, one or two lags, the more likely first; none where the linear models have no lag.

    window : the record. x : where the process is at its samples, shape (n,). axis : of the table. alone : the linear
        models of the record, from which it starts. curves : what other records say of co's curve.
    """
    every = -(-len(window.t_s) // MOST_ROWS)
    stretch = Stretch(signals_of(window, x, every), 0, -(-len(window.t_s) // every), changed=True)
    stretch = replace(stretch, end=len(stretch.signals.t_s))
    joint = Joint.of([stretch])
    lagged = next((a.log.model() for a in alone.alternatives if a.log.type in _STARTS), None)
    if lagged is None:
        return ()
    lag = lagged.tau1_s + lagged.tau2_s
    centre = (math.log(abs(lagged.k) / lag), math.log(lagged.theta_s), math.log(lag))
    form = CurveForm(axis, (CurveShape.BENT,) * 3, centre, 1 if lagged.k > 0 else -1, _felt(stretch, curves))
    found = []
    for loads in sorted({joint.loads[0], _rows(stretch, alone)}, key=len):
        one = _fitted(replace(joint, loads=(loads,)), form)
        found += [one, _fitted(replace(joint, loads=(loads,)), *_with_second_lag(one))]
    best = [min((f for f in found if f.type is t), key=lambda f: f.evidence) for t in _STARTS]
    return tuple(sorted(best, key=lambda one: one.evidence + len(one.form.shapes) * math.log(len(stretch))))


def _felt(stretch: Stretch, curves: Sequence[CoCurve]) -> Characteristic | None:
    """How co acts, as it is known before this record; None where co stands still."""
    found = over([stretch], CurveShape.LINE)
    if found is None:
        return None
    travel = found.axis.high - found.axis.low
    known = before(curves, travel)
    return replace(found, slope=known.slope, doubt=known.std * travel / (2 * SLOPE_STD))


def _rows(stretch: Stretch, alone: ModelEstimate) -> tuple[int, ...]:
    """Where load steps enter by the linear models, but for those beside the setpoint's step: curves explain them."""
    model = alone.log.model()
    changes = [stretch.signals.t_s[row] for row in stretch.signals.changes]
    loads = [t for t in alone.load_times_s if all(abs(t - at_s) > BESIDE * model.theta_s for at_s in changes)]
    rows = np.searchsorted(stretch.t_s, loads) - 1
    return tuple(sorted({int(row) for row in rows if 0 < row < len(stretch) - 2}))


_STARTS = (ProcessType.FOPDT, ProcessType.SOPDT)


def _with_second_lag(one: InMotion) -> tuple[CurveForm, FloatArray]:
    """A lag beside the first, out of the dead time; its start."""
    b, theta, tau = one.form.centre
    centre = (b, theta + math.log1p(-SECOND_LAG), tau, theta + math.log(SECOND_LAG))
    shapes = (*one.form.shapes, CurveShape.CONSTANT)
    return replace(one.form, shapes=shapes, centre=centre), np.insert(one.z, one.form.felt_place.start, 0.0)


def _fitted(joint: Joint, form: CurveForm, start: FloatArray | None = None) -> InMotion:
    """One structure: first as if what is left were white, or slow noise would stand for what the curves can say."""
    pv = joint.stretches[0].pv
    floor = math.hypot(noise_sigma(pv), MODEL_ERROR * float(np.ptp(pv)))
    noise = Noise((), np.array([floor]))
    now = refined(joint, form, np.zeros(form.size) if start is None else start, noise, ITERATIONS)
    found = noise_of(now.left, 1e-6 * floor)
    now = refined(joint, form, now.z, replace(found, sigma=np.hypot(found.sigma, floor)), ITERATIONS)
    c = max(inflation(now), 1.0)
    assert now.jacobian is not None
    information = np.eye(form.size) + now.jacobian.T @ now.jacobian / c
    covariance = proper_covariance(np.asarray(np.linalg.inv(information), dtype=np.float64))
    evidence = len(now.r) * math.log(float(np.mean(now.left[0] ** 2))) + 2 * len(joint.loads[0]) * math.log(len(now.r))
    type_ = ProcessType.SOPDT if len(form.shapes) > 3 else ProcessType.FOPDT
    rest = RestCurve.on_the_way(joint.stretches[0])
    return InMotion(type_, form, rest, now.z, covariance, evidence, float(np.std(now.left[0])))
