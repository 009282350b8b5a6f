"""From stretches to curves: one joint fit, and evidence for what changes along the way at all.

    constant process -> load steps -> every parameter free to bend -> a second lag -> load steps anew -> which shapes?

The shapes are weighed by their evidence in Laplace's approximation (MacKay 1992, section 2), every parameter by itself:

    ln E(S) = -1/2 min (|r|^2 / c + |z|^2) - 1/2 ln det(I + J_S' J_S / c) - 2 nats for each step from constant to bent

c counts what is left above white noise and what is correlated in it, so that a model which does not explain a record
does not become sure of a bend.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from retuner.adaptive.schedule_design.agreement import agreement
from retuner.adaptive.schedule_design.joint import At, Form, Joint, Noise, at, noise_of, refined
from retuner.adaptive.schedule_design.shapes import LEVEL_STD, Axis, Shape
from retuner.adaptive.schedule_design.start import starts, with_loads
from retuner.adaptive.schedule_design.stretches import Stretch
from retuner.adaptive.signals.sample import FloatArray

SHAPES = (Shape.CONSTANT, Shape.LINE, Shape.BENT)
SIMPLER = 2.0
"""Nats that a step from constant to line to bent must bring beyond its evidence."""
SECOND_LAG = 0.35
"""Share of theta with which a second lag starts."""

Progress = Callable[[str, float], None]
"""Told what is being done, and the share that is done."""


@dataclass(frozen=True, slots=True)
class Curves:
    """What the records say of the process along a variable.

    form, z, covariance : the curves and how well their coefficients are known. joint, noise, now : the fit behind them.
    log_likelihood : of the white remainder, by which variables are compared. evidence : ln E of the shapes over that of
    a constant process.
    """

    form: Form
    z: FloatArray
    covariance: FloatArray
    joint: Joint
    noise: Noise
    now: At
    log_likelihood: float
    evidence: float

    def ln(self, x: FloatArray) -> FloatArray:
        """ln b, ln theta, ln tau (, ln tau2) at places, shape (n, parameters)."""
        return np.stack([curve[:, 0] for curve in self.form.curves(x, self.z[:, None])], axis=1)

    def ln_covariance(self, x: float) -> FloatArray:
        """Their covariance at one place."""
        rows = np.zeros((len(self.form.shapes), self.form.size))
        for i, (place, shape) in enumerate(zip(self.form.places, self.form.shapes, strict=True)):
            rows[i, place] = self.form.axis.columns(np.array(x), shape)
        return np.asarray(rows @ self.covariance @ rows.T, dtype=np.float64)


def curves(stretches: Sequence[Stretch], axis: Axis, sign: int | None, progress: Progress) -> Curves:
    """The curves of some stretches over an axis. sign : of the process gain, where it is known.

    Raises
    ------
    ValueError
        There is no stretch in which pv and co move.
    """
    if not stretches:
        raise ValueError("no stretch of the records is long enough and moves both pv and co: nothing to learn from")
    joint = Joint.of(stretches)
    progress("one process for all", 0.0)
    first = [_settled(joint, form, np.zeros(form.size), 1) for form in starts(stretches, axis, sign)]
    constant = max(first, key=_innovations)
    progress("a second lag", 0.2)
    constants = [constant, _settled(constant[0], *_with_second_lag(constant[1], constant[3].z), 1)]
    progress("curves", 0.35)
    bent = [_settled(fit[0], *_bent(fit), 2) for fit in constants]
    progress("which of them change", 0.7)
    noise = max(bent, key=_innovations)[2]
    rich = [_under(noise, *fit[:2], fit[3].z) for fit in bent]
    chosen = [_under(noise, fit[0], *fit[1].with_shapes(chosen_shapes(fit[1], fit[3]), fit[3].z)) for fit in rich]
    level = [_under(noise, *fit[:2], fit[3].z) for fit in constants]
    return _weighed(level, [*chosen, *rich], max(1.0, *(inflation(fit[3]) for fit in rich)))


def _weighed(level: Sequence["Fit"], others: Sequence["Fit"], c: float) -> Curves:
    """The fit with the most evidence, all of them under one noise."""
    constant = max(evidence_of(fit, c) for fit in level)
    best = max([*level, *others], key=lambda fit: evidence_of(fit, c))
    joint, form, noise, now = best
    covariance = agreement(form, now, [len(left) for left in now.left], c).covariance
    return Curves(form, now.z, covariance, joint, noise, now, _innovations(best), evidence_of(best, c) - constant)


Fit = tuple[Joint, Form, Noise, At]


def _bent(fit: Fit) -> tuple[Form, FloatArray]:
    """Slope gain, dead time and lag free to bend; a second lag stays what it is everywhere."""
    _, form, _, now = fit
    return form.with_shapes([*(Shape.BENT,) * 3, *(Shape.CONSTANT,) * (len(form.shapes) - 3)], now.z)


def _settled(joint: Joint, form: Form, z: FloatArray, rounds: int) -> Fit:
    """Curves, noise and load steps in turn."""
    noise = _noise(joint, at(joint, form, z, Noise((), np.ones(len(joint.loads))), derivatives=False))
    now = refined(joint, form, z, noise)
    for _ in range(rounds):
        noise = _noise(joint, now)
        joint = with_loads(joint, form, now, noise)
        now = refined(joint, form, now.z, noise)
    return joint, form, _noise(joint, now), now


def _under(noise: Noise, joint: Joint, form: Form, z: FloatArray) -> Fit:
    """The same under a noise that is given."""
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


def _with_second_lag(form: Form, z: FloatArray) -> tuple[Form, FloatArray]:
    """A lag beside the first, out of the dead time."""
    ln_theta = form.centre[1] + float(form.axis.columns(np.array(form.axis.low), form.shapes[1]) @ z[form.places[1]])
    centre = (form.centre[0], form.centre[1], form.centre[2], ln_theta + math.log(SECOND_LAG))
    less = z.copy()
    less[form.places[1].start] += math.log(1 - SECOND_LAG) / LEVEL_STD
    return replace(form, shapes=(*form.shapes, Shape.CONSTANT), centre=centre), np.append(less, 0.0)


LOAD_PRICE = 6.0
"""Nats that a load step costs: its size, and its time among those in which it might have stood."""


def _innovations(fit: Fit) -> float:
    """ln likelihood by the size of the innovations, each stretch with its own: what variables are compared by."""
    joint, _, _, now = fit
    noise = noise_of(now.left, 1e-12)
    sizes = np.array([len(x) for x in now.left])
    return float(-np.sum(sizes * np.log(noise.sigma))) - LOAD_PRICE * sum(map(len, joint.loads)) / 2


def evidence_of(fit: Fit, c: float) -> float:
    """ln of the evidence of a fit under its noise, load steps and shapes paid for. c : inflation of all compared."""
    joint, form, _, now = fit
    assert now.jacobian is not None
    occam = float(np.linalg.slogdet(np.eye(form.size) + now.jacobian.T @ now.jacobian / c)[1])
    steps = sum(SHAPES.index(shape) for shape in form.shapes) + (len(form.shapes) - 3)
    loads = sum(map(len, joint.loads)) / 2
    return -0.5 * (float(now.r @ now.r) / c + float(now.z @ now.z) + occam) - SIMPLER * steps - LOAD_PRICE * loads


def inflation(now: At) -> float:
    """c: variance of what is left over that of white noise of its sigma, times what correlation takes from it."""
    r = now.r
    rho = min(max(float(r[1:] @ r[:-1]) / max(float(r @ r), 1e-300), 0.0), 0.98)
    return max(float(r @ r) / max(len(r), 1), 0.2) * (1 + rho) / (1 - rho)


def chosen_shapes(form: Form, now: At) -> tuple[Shape, ...]:
    """The shapes with the most evidence, as far as the misfit is a parabola.

    form, now : a fit with every shape as rich as it may become.
    """
    assert now.jacobian is not None
    c = inflation(now)
    a = np.concatenate([now.jacobian / math.sqrt(c), np.eye(form.size)])
    target = np.concatenate([now.jacobian @ now.z - now.r, np.zeros(form.size)]) / math.sqrt(c)
    normal, right, whole = a.T @ a, a.T @ target, float(target @ target)

    def evidence(shapes: Sequence[Shape]) -> float:
        kept = np.concatenate(
            [
                np.arange(p.start, p.start + min(int(s), int(m)))
                for p, s, m in zip(form.places, shapes, form.shapes, strict=True)
            ]
        )
        sub = normal[np.ix_(kept, kept)]
        least = whole - float(right[kept] @ np.linalg.solve(sub, right[kept]))
        steps = sum(SHAPES.index(s) for s in shapes)
        return -0.5 * least - 0.5 * float(np.linalg.slogdet(sub)[1]) - SIMPLER * steps

    options = [[s for s in SHAPES if s <= most] for most in form.shapes]
    ranked = {shapes: evidence(shapes) for shapes in product(*options)}
    return max(ranked, key=ranked.__getitem__)
