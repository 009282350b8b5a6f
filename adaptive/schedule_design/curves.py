"""From stretches to curves: one joint fit, and evidence for what changes along the way at all.

    constant process -> load steps -> a second lag -> every parameter free to bend -> the installed characteristic of co

Each of these is fitted as rich as it may become; agreement.py says what the stretches tell together, curve_shapes.py
which shapes follow. With or without a second lag, with or without a characteristic: the evidence decides, under one
noise, in Laplace's approximation (MacKay 1992, section 2). c counts what is left above white noise and what is
correlated in it, so that a model which does not explain a record does not become sure of a bend.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np

from retuner.adaptive.schedule_design.agreement import agreement
from retuner.adaptive.schedule_design.curve_shapes import SHAPES, SIMPLER, weighed
from retuner.adaptive.schedule_design.joint import (
    At,
    CurveForm,
    Joint,
    Noise,
    at,
    noise_of,
    refined,
    starts,
    with_loads,
)
from retuner.adaptive.schedule_design.record_stretches import LEVEL_STD, CurveAxis, CurveShape, Second, Stretch, over
from retuner.adaptive.schedule_design.rest_curve import RestCurve
from retuner.adaptive.signals.sample import FloatArray
from retuner.schedule.late_dataclass import dataclass, replace

FIRST_ORDER = 3  # parameters of a process without a second lag
SECOND_LAG = 0.35  # share of theta with which a second lag starts

Progress = Callable[[str, float], None]  # told what is being done, and the share that is done


@dataclass(frozen=True, slots=True)
class Curves:
    """What the records say of the process along a variable.

    form, z : the curves. rich, covariance : the richest form, and how well its coefficients are known round these.
    joint, now : the fit behind them. log_likelihood : of the white remainder, by which variables are compared.
    evidence : ln E of the shapes over that of a constant process. weight : ln E among other structures. rest : the co
    that holds each place. differences : standard deviation of each ln p between the stretches, beside the curves.
    second_evidence : ln E of the shapes over the best in which nothing changes with the second variable.
    """

    form: CurveForm
    z: FloatArray
    rich: CurveForm
    covariance: FloatArray
    joint: Joint
    now: At
    log_likelihood: float
    evidence: float
    weight: float
    rest: RestCurve
    differences: tuple[float, ...] = ()
    second_evidence: float = 0.0

    def ln(self, x: FloatArray, x2: FloatArray | None = None) -> FloatArray:
        """ln b, ln theta, ln tau (, ln tau2) at places, shape (n, parameters), at the co that holds each.

        x2 : of the second variable, where there is one.
        """
        found = np.stack([curve[:, 0] for curve in self.form.curves(x, self.z[:, None], x2)], axis=1)
        if self.form.felt is not None:
            found[:, 0] += self.form.felt.columns(self.rest.co(x)) @ self.z[self.form.felt_place]
        return found

    def ln_covariance(self, x: float, x2: float | None = None) -> FloatArray:
        """Covariance of the parameters at one place."""
        rich, felt = self.rich, self.form.felt
        rows = np.zeros((len(rich.shapes), rich.size))
        for i, (place, shape) in enumerate(zip(rich.places, rich.shapes, strict=True)):
            rows[i, place] = rich.axis.columns(np.array(x), shape)
        for i, place in enumerate(rich.second_places):
            assert rich.second is not None
            rows[i, place] = rich.second.columns(np.array(0.0 if x2 is None else x2), i)
        held = self.rest.co(np.array([x]))
        if rich.felt is not None:
            rows[0, rich.felt_place] = rich.felt.columns(held)[0]
        loads = 0.0
        if felt is not None:
            beside = felt.columns(held + self.rest.std) - felt.columns(held)
            loads = float((beside @ self.z[self.form.felt_place])[0])
        found = rows @ self.covariance @ rows.T
        found[0, 0] += loads**2
        return np.asarray(found, dtype=np.float64)


def curves(
    stretches: Sequence[Stretch],
    axis: CurveAxis,
    sign: int | None,
    progress: Progress,
    *,
    pushed: bool = False,
    second: Second | None = None,
    known: CurveForm | None = None,
) -> Curves:
    """The curves of some stretches over an axis.

    sign : of the process gain, where it is known. pushed : see Form. second : axis and push of another variable; the
    stretches have it as x2. known : a form whose second lag and characteristic there shall be; left out, both are
    weighed.

    Raises ValueError: there is no stretch in which pv and co move.
    """
    if not stretches:
        raise ValueError("no stretch of the records is long enough and moves both pv and co: nothing to learn from")
    joint = Joint.of(stretches)
    progress("one process for all", 0.0)
    begun = starts(stretches, axis, sign, pushed=pushed, second=second)
    first = [_settled(joint, form, np.zeros(form.size), 1) for form in begun]
    constant = max(first, key=_innovations)
    progress("a second lag", 0.2)
    constants = [constant] if known is None or len(known.shapes) == FIRST_ORDER else []
    if known is None or len(known.shapes) > FIRST_ORDER:
        constants.append(_settled(constant[0], *_with_second_lag(constant[1], constant[3].z), 1))
    progress("curves", 0.3)
    bent = []
    for one, form, _, now in constants:
        shapes = (CurveShape.BENT,) * len(form.shapes)
        bent.append(_settled(one, *form.with_shapes(shapes, now.z, None, shapes), 2))
    progress("the installed characteristic", 0.55)
    felt = over(stretches) if known is None or known.felt is not None else None
    if felt is not None:
        bent += [
            _settled(one, *form.with_shapes(form.shapes, now.z, felt, form.second_shapes), 1)
            for one, form, _, now in bent
        ]
    progress("which of them change", 0.75)
    noise = max(bent, key=_innovations)[2]
    rich = [_under(noise, *fit[:2], fit[3].z) for fit in bent]
    c = max(1.0, *(inflation(fit[3]) for fit in rich))
    return max((_chosen(fit, c) for fit in rich), key=lambda found: found.weight)


Fit = tuple[Joint, CurveForm, Noise, At]


def _chosen(rich: Fit, c: float) -> Curves:
    """The shapes for which most speaks, fitted. rich : with every shape as rich as it may become."""
    joint, form, noise, now = rich
    together = agreement(form, now, [len(left) for left in now.left], c)
    told = weighed(form, together)
    felt = None if form.felt is None or told.felt is CurveShape.CONSTANT else replace(form.felt, shape=told.felt)
    fit = _under(noise, joint, *form.with_shapes(told.shapes, now.z, felt, told.second))
    return Curves(
        form=fit[1],
        z=fit[3].z,
        rich=form,
        covariance=told.covariance,
        joint=fit[0],
        now=fit[3],
        log_likelihood=_innovations(fit),
        evidence=told.evidence,
        weight=evidence_of(fit, c),
        rest=RestCurve.of(joint.stretches),
        differences=together.differences,
        second_evidence=told.second_evidence,
    )


def _with_second_lag(form: CurveForm, z: FloatArray) -> tuple[CurveForm, FloatArray]:
    """A lag beside the first, out of the dead time."""
    ln_theta = form.centre[1] + float(form.axis.columns(np.array(form.axis.low), form.shapes[1]) @ z[form.places[1]])
    centre = (form.centre[0], form.centre[1], form.centre[2], ln_theta + math.log(SECOND_LAG))
    less = z.copy()
    less[form.places[1].start] += math.log(1 - SECOND_LAG) / LEVEL_STD
    second = form.second
    if second is not None:
        second = replace(second, shapes=(*second.shapes, CurveShape.CONSTANT))
    form = replace(form, shapes=(*form.shapes, CurveShape.CONSTANT), centre=centre, second=second)
    return form, np.append(less, 0.0)


def _settled(joint: Joint, form: CurveForm, z: FloatArray, rounds: int) -> Fit:
    """Curves, noise and load steps in turn."""
    noise = _noise(joint, at(joint, form, z, Noise((), np.ones(len(joint.loads))), derivatives=False))
    now = refined(joint, form, z, noise)
    for _ in range(rounds):
        noise = _noise(joint, now)
        joint = with_loads(joint, form, now, noise)
        now = refined(joint, form, now.z, noise)
    return joint, form, _noise(joint, now), now


def _under(noise: Noise, joint: Joint, form: CurveForm, z: FloatArray) -> Fit:
    now = at(joint, form, z, noise, derivatives=False)
    joint = with_loads(joint, form, now, noise)
    return joint, form, noise, refined(joint, form, z, noise)


MODEL_ERROR = 0.005
"""What a model of second order leaves of a real response, as a share of pv's travel (identification/candidate.py)."""


def _noise(joint: Joint, now: At) -> Noise:
    """What is left, and no stretch believed more closely than a model can follow it."""
    found = noise_of(now.left, 1e-9)
    travel = np.array([float(np.ptp(s.pv)) for s in joint.stretches])
    return replace(found, sigma=np.hypot(found.sigma, MODEL_ERROR * travel))


LOAD_PRICE = 6.0  # nats that a load step costs: its size, and its time among those in which it might have stood


def _innovations(fit: Fit) -> float:
    """ln likelihood by the size of the innovations, each stretch with its own: what variables are compared by."""
    joint, form, _, now = fit
    noise = noise_of(now.left, 1e-12)
    sizes = np.array([len(x) for x in now.left])
    pushes = form.pushed + (form.second is not None and form.second.pushed)
    bought = sum(map(len, joint.loads)) / 2 + len(sizes) * pushes
    return float(-np.sum(sizes * np.log(noise.sigma))) - LOAD_PRICE * bought


def evidence_of(fit: Fit, c: float) -> float:
    """ln of the evidence of a fit under its noise, load steps and shapes paid for. c : inflation of all compared."""
    joint, form, _, now = fit
    assert now.jacobian is not None
    occam = float(np.linalg.slogdet(np.eye(form.size) + now.jacobian.T @ now.jacobian / c)[1])
    steps = sum(SHAPES.index(shape) for shape in form.shapes) + (len(form.shapes) - 3)
    steps += sum(SHAPES.index(shape) for shape in form.second_shapes)
    steps += 0 if form.felt is None else SHAPES.index(form.felt.shape)
    loads = sum(map(len, joint.loads)) / 2
    return -0.5 * (float(now.r @ now.r) / c + float(now.z @ now.z) + occam) - SIMPLER * steps - LOAD_PRICE * loads


def inflation(now: At) -> float:
    """c: variance of what is left over that of white noise of its sigma, times what correlation takes from it."""
    r = now.r
    rho = min(max(float(r[1:] @ r[:-1]) / max(float(r @ r), 1e-300), 0.0), 0.98)
    return max(float(r @ r) / max(len(r), 1), 0.2) * (1 + rho) / (1 - rho)
