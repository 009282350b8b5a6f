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

from retuner.adaptive.schedule_design.joint import At, Form, Joint, Noise, at, noise_of, refined
from retuner.adaptive.schedule_design.shapes import Axis, Shape
from retuner.adaptive.schedule_design.start import start, with_loads
from retuner.adaptive.schedule_design.stretches import Stretch
from retuner.adaptive.signals.noise import noise_sigma
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


def curves(stretches: Sequence[Stretch], axis: Axis, progress: Progress) -> Curves:
    """The curves of some stretches over an axis.

    Raises
    ------
    ValueError
        There is no stretch in which pv and co move.
    """
    if not stretches:
        raise ValueError("no stretch of the records is long enough and moves both pv and co: nothing to learn from")
    joint = Joint.of(stretches)
    floor = np.array([0.1 * noise_sigma(s.pv) + 1e-12 * float(np.ptp(s.pv)) for s in joint.stretches])
    progress("one process for all", 0.0)
    form, z = start(stretches, axis)
    noise = Noise((0.9,), np.array([2 * noise_sigma(s.pv) + 1e-9 * float(np.ptp(s.pv)) for s in joint.stretches]))
    noise = noise_of(at(joint, form, z, noise, derivatives=False).left, float(np.median(floor)))
    now = refined(joint, form, z, noise)
    joint = with_loads(joint, form, now, noise)
    progress("curves", 0.2)
    form, z = form.with_shapes((Shape.BENT,) * 3, now.z)
    fit = _settled(joint, form, z, 2)
    progress("a second lag", 0.5)
    fit = _better(fit, _settled(fit[0], *_with_second_lag(fit[1], fit[3].z), 2))
    progress("which of them change", 0.8)
    chosen, gain = chosen_shapes(fit[1], fit[3])
    form, z = fit[1].with_shapes(chosen, fit[3].z)
    joint, form, noise, now = _settled(fit[0], form, z, 1)
    progress("curves", 1.0)
    return Curves(form, now.z, _covariance(form, now), joint, noise, now, _log_likelihood(now, noise), gain)


Fit = tuple[Joint, Form, Noise, At]


def _settled(joint: Joint, form: Form, z: FloatArray, rounds: int) -> Fit:
    """Curves, noise and load steps in turn."""
    noise = _noise(joint, at(joint, form, z, Noise((0.9,), np.ones(len(joint.loads))), derivatives=False))
    now = refined(joint, form, z, noise)
    for _ in range(rounds):
        noise = _noise(joint, now)
        joint = with_loads(joint, form, now, noise)
        now = refined(joint, form, now.z, noise)
    noise = _noise(joint, now)
    return joint, form, noise, refined(joint, form, now.z, noise)


MODEL_ERROR = 0.005
"""What a model of second order leaves of a real response, as a share of pv's travel (identification/candidate.py)."""


def _noise(joint: Joint, now: At) -> Noise:
    """What is left, and no stretch believed more closely than a model can follow it."""
    found = noise_of(now.left, 1e-9)
    travel = np.array([float(np.ptp(s.pv)) for s in joint.stretches])
    return replace(found, sigma=np.hypot(found.sigma, MODEL_ERROR * travel))


def _with_second_lag(form: Form, z: FloatArray) -> tuple[Form, FloatArray]:
    """A lag beside the first, out of the dead time."""
    ln_theta = form.centre[1]
    centre = (form.centre[0], ln_theta + math.log(1 - SECOND_LAG), form.centre[2], ln_theta + math.log(SECOND_LAG))
    return replace(form, shapes=(*form.shapes, Shape.CONSTANT), centre=centre), np.append(z, 0.0)


def _better(one: Fit, two: Fit) -> Fit:
    """The larger form where it leaves clearly less."""
    gain = _log_likelihood(two[3], two[2]) - _log_likelihood(one[3], one[2])
    return two if gain > SIMPLER + 0.5 * math.log(len(one[3].r)) else one


def _log_likelihood(now: At, noise: Noise) -> float:
    """Of the white remainder, shares of correlated samples counted as what they are worth."""
    sizes = np.array([len(x) for x in now.left])
    return float(-np.sum(sizes * np.log(noise.sigma)) - 0.5 * now.r @ now.r) / inflation(now)


def inflation(now: At) -> float:
    """c: variance of what is left over that of white noise of its sigma, times what correlation takes from it."""
    r = now.r
    rho = min(max(float(r[1:] @ r[:-1]) / max(float(r @ r), 1e-300), 0.0), 0.98)
    return max(float(r @ r) / max(len(r), 1), 0.2) * (1 + rho) / (1 - rho)


def _covariance(form: Form, now: At) -> FloatArray:
    """Of z."""
    assert now.jacobian is not None
    return np.asarray(
        np.linalg.inv(now.jacobian.T @ now.jacobian / inflation(now) + np.eye(form.size)), dtype=np.float64
    )


def chosen_shapes(form: Form, now: At) -> tuple[tuple[Shape, ...], float]:
    """The shapes with the most evidence, and ln E of them over that of constants.

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
    best = max(ranked, key=ranked.__getitem__)
    return best, ranked[best] - ranked[tuple([Shape.CONSTANT] * len(form.shapes))]
