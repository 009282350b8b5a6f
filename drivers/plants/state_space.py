"""A linear model of several inputs and outputs with dead times, exact for held inputs at any times.

    x' = A x + B u,  y_i(t) = C_i x + sum over j of D_ij u_j,   u_j as it was theta_ij ago on its way to output i

Inputs that reach an output with the same dead time share one copy of the states; each copy is driven by its inputs as
they were theta ago, and goes from change to change of them by the matrix exponential (Astrom & Wittenmark,
Computer-Controlled Systems, section 2.3). So dead times need be no multiples of the sampling, which may change.
"""

import math
from collections.abc import Sequence

import numpy as np

from retuner.adaptive.loop.simulate import held_over
from retuner.adaptive.signals.sample import FloatArray
from retuner.drivers.plants.foreign_model import PlantFaultError

Rows = Sequence[Sequence[float]]
STEPS_KEPT = 64
"""Matrices kept for intervals that come again: a loop's own two, and those between loops of other sample times."""
DIGITS = 9  # digits of an interval that count for that


class StateSpaceModel:
    """The model at rest at u = 0, y = 0: what it works about is the port's.

    a, b, c, d : matrices as rows; d empty for none. theta_s : dead times, a row an output and a column an input.

    Raises PlantFaultError: the matrices do not go together, or a number is none; key names the setting.
    """

    def __init__(self, a: Rows, b: Rows, c: Rows, d: Rows, theta_s: Rows) -> None:
        n = len(a)
        self._a = _matrix("a", a, n, n)
        self._b = _matrix("b", b, n, len(b[0]) if n else len(d[0]) if d else 0)
        inputs = self._b.shape[1]
        self._c = _matrix("c", c, len(c), n)
        outputs = len(c)
        self._d = _matrix("d", d, outputs, inputs) if d else np.zeros((outputs, inputs))
        theta = _matrix("theta_s", theta_s, outputs, inputs)
        if (theta < 0).any():
            raise PlantFaultError("has a negative dead time; give 0 or more seconds", "theta_s")
        self._copies: dict[tuple[float, tuple[bool, ...]], _Copy] = {}
        self._parts: list[list[tuple[_Copy, FloatArray, FloatArray]]] = []  # by output: copy, its row of C and of D
        for i, row in enumerate(theta.tolist()):
            parts = []  # what reaches an output with each dead time
            for late_s in sorted({*row}):
                reaching = [one == late_s for one in row]
                mask = np.array(reaching, dtype=np.float64)
                copy = self._copies.setdefault((late_s, (*reaching,)), _Copy(self._a, self._b * mask, late_s))
                parts.append((copy, self._c[i], self._d[i] * mask))
            self._parts.append(parts)
        self._longest_s = float(theta.max(initial=0.0))
        self._times, self._held = [0.0], [np.zeros(inputs)]  # since when, which inputs; before: none
        self._t_s = 0.0
        self.readings: Sequence[float] = [0.0] * outputs

    def step(self, inputs: Sequence[float], dt_s: float) -> Sequence[float]:
        """See model.PlantModel."""
        self._times.append(self._t_s)
        self._held.append(np.asarray(inputs, dtype=np.float64))
        until = self._t_s + dt_s
        for copy in self._copies.values():
            copy.advance(self._times, self._held, self._t_s, until)
        self._t_s = until
        while len(self._times) > 2 and self._times[1] < until - self._longest_s - dt_s:
            del self._times[0], self._held[0]
        self.readings = [sum(float(c @ copy.x + d @ copy.last) for copy, c, d in parts) for parts in self._parts]
        return self.readings

    def close(self) -> None:
        """Do nothing: nothing is held."""


class _Copy:
    """The states as driven by some inputs with one dead time."""

    def __init__(self, a: FloatArray, b: FloatArray, theta_s: float) -> None:
        self._a, self._b, self._theta_s = a, b, theta_s
        self.x = np.zeros(len(a))
        self.last = np.zeros(b.shape[1])  # the inputs that act at the end of the last step
        self._known: dict[float, tuple[FloatArray, FloatArray]] = {}

    def advance(self, times: Sequence[float], held: Sequence[FloatArray], start_s: float, end_s: float) -> None:
        """Move from one time to another. times, held : since when which inputs, the first before all that matters."""
        at, end = start_s - self._theta_s, end_s - self._theta_s
        rounding = 10.0**-DIGITS * (end_s - start_s)
        i = max((k for k, since in enumerate(times) if since <= at + rounding), default=0)
        while end - at > rounding:
            until = min(times[i + 1], end) if i + 1 < len(times) else end
            if until - at > rounding:
                key = float(f"{until - at:.{DIGITS - 1}e}")
                if key not in self._known:
                    if len(self._known) >= STEPS_KEPT:
                        self._known.clear()
                    self._known[key] = held_over(self._a, self._b, key)
                phi, gamma = self._known[key]
                self.last = held[i]
                self.x = phi @ self.x + gamma @ self.last
                at = until
            i += 1


def _matrix(name: str, rows: Rows, height: int, width: int) -> FloatArray:
    if len(rows) != height or any(len(row) != width for row in rows):
        found = f"{len(rows)} x {'/'.join(map(str, sorted({len(row) for row in rows}))) or 0}"
        raise PlantFaultError(f"is {found}; it must be {height} x {width}", name)
    if not all(math.isfinite(value) for row in rows for value in row):
        raise PlantFaultError("has a number that is not finite", name)
    return np.array(rows, dtype=np.float64).reshape(height, width)


def matrices_of(system: object) -> tuple[Rows, Rows, Rows, Rows]:
    """A, B, C, D of a continuous system of python-control or scipy.signal.

    Raises PlantFaultError: it is neither, or sampled.
    """
    dt = getattr(system, "dt", None)
    if dt not in {None, 0}:
        raise PlantFaultError(f"is sampled (dt = {dt}); give a continuous system", "model")
    try:
        if not hasattr(system, "A") and hasattr(system, "to_ss"):  # a transfer function
            system = system.to_ss()
        elif not hasattr(system, "A") and type(system).__module__.startswith("control."):
            import control  # noqa: PLC0415  the user has it: the system is its

            system = control.ss(system)
    except (TypeError, ValueError) as error:
        raise PlantFaultError(f"is a {type(system).__name__} that has no state space: {error}", "model") from None
    if not all(hasattr(system, name) for name in "ABCD"):
        raise PlantFaultError(
            f"is a {type(system).__name__}; give a system of python-control or scipy.signal (ss, tf, StateSpace, lti)",
            "model",
        )
    a, b, c, d = (np.atleast_2d(np.asarray(getattr(system, name), dtype=np.float64)).tolist() for name in "ABCD")
    return a, b, c, d
