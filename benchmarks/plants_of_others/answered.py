"""Settings judged on a process that is known by its answer to a step alone, sample by sample; nothing is fitted.

    G(z) = sum d_k z^-k + r z^-(n+1) / (1 - z^-1),   L = (kp + ki h / (1 - z^-1)) G,   Ms = max 1/|1 + L|

d_k are the differences of the answer at the controller's own interval h, and r the slope that it ends with. So hold,
sampling and whatever the other loops of the plant do are in it exactly. Stable by the argument principle: from w = 0+
to pi/h the argument of 1 + L comes to rest at 0 (Astrom & Wittenmark, Computer-Controlled Systems, section 3.3).
"""

import math

import numpy as np
from cases.case import FloatArray
from online.judge import J_LIMIT, MS_LIMIT, MS_OVER_BEST, Judgement

from retuner import PidGains

POINTS, LOWEST = 800, 0.05  # Frequencies, the lowest as a share of one over the answer's length
ENDS = 0.05  # Share of the answer that its last slope is taken from
HORIZON_THETA, HORIZON_RESET, MOST = 60.0, 8.0, 6000
"""IAE is simulated for so many dead times and integral times, and at most so many samples."""
MS_BEST = 1.6  # Of the best PI: about what SIMC gives to a lag with dead time
RESETS = 14  # Integral times that are tried for it, over this span of dead times:
SHORTEST, LONGEST = 1.0, 60.0


class Answered:
    """Judges as online.judge.Judge does. seen : pv about rest, from the step of the output by one on; h_s : interval.

    best : J counts over these; None searches for the PI of least IAE with Ms of MS_BEST.
    """

    def __init__(self, seen: FloatArray, h_s: float, best: PidGains | None = None) -> None:
        self.h_s, self._moves = h_s, np.diff(seen)
        n = len(self._moves)
        self._slope = float(np.mean(self._moves[-max(int(ENDS * n), 2) :]))
        self._w = np.geomspace(LOWEST / (n * h_s), math.pi / h_s, POINTS)
        z = np.exp(-1j * self._w * h_s)
        self._g = (z[:, None] ** np.arange(1, n + 1)) @ self._moves + self._slope * z ** (n + 1) / (1 - z)
        self._integral = h_s / (1 - z)
        self._sign = math.copysign(1.0, float(seen[-1]))
        self._known: dict[PidGains, Judgement] = {}
        self.theta_s = math.pi / 2 / self._w180()
        self.best = best or self._searched()
        self.ms_best = self.ms(self.best)
        self.ms_limit = max(MS_LIMIT, MS_OVER_BEST * self.ms_best)
        self._least = [self.iae(self.best, setpoint=which) for which in (True, False)]

    def ms(self, gains: PidGains) -> float:
        """Infinite where unstable."""
        near = 1 + (gains.kp + gains.ki * self._integral) * self._g
        turned = np.unwrap(np.angle(near))
        start = float(turned[0]) - (2 * math.pi if turned[0] > math.pi / 2 else 0.0)
        if abs(start + float(turned[-1] - turned[0])) > math.pi / 2:
            return math.inf
        return float(np.max(1 / np.abs(near)))

    def iae(self, gains: PidGains, *, setpoint: bool) -> float:
        """After a unit step of setpoint or load; infinite where it grows."""
        reset = abs(gains.kp / gains.ki) if gains.ki else 0.0
        n, late = int(min((HORIZON_THETA * self.theta_s + HORIZON_RESET * reset) / self.h_s, MOST)), self._moves[::-1]
        u, total, past = np.zeros(n + len(late)), 0.0, 0.0
        integral, errors = 0.0, np.zeros(n)
        for i in range(n):
            y = float(late @ u[i : i + len(late)]) + past
            errors[i] = e = float(setpoint) - y
            integral += gains.ki * e * self.h_s
            u[i + len(late)] = gains.kp * e + integral + (0.0 if setpoint else 1.0)
            past += self._slope * float(u[i])
        if not np.all(np.isfinite(errors)) or np.max(np.abs(errors[-n // 10 :])) > np.max(np.abs(errors[: n // 2])):
            return math.inf
        total = float(np.sum(np.abs(errors)))
        return total * self.h_s

    def of(self, gains: PidGains) -> Judgement:
        """Judge settings; the same settings are worked out once."""
        if gains not in self._known:
            ms, j = self.ms(gains), math.inf
            if math.isfinite(ms):
                found = [self.iae(gains, setpoint=which) for which in (True, False)]
                j = sum(x / least for x, least in zip(found, self._least, strict=True)) / 2
            self._known[gains] = Judgement(ms, j, ms <= self.ms_limit and j <= J_LIMIT)
        return self._known[gains]

    def _w180(self) -> float:
        phase = np.unwrap(np.angle(self._g * self._sign))
        below = phase < -math.pi
        return float(self._w[np.argmax(below)]) if below.any() else float(self._w[-1])

    def _searched(self) -> PidGains:
        found = []
        for tau_i in self.theta_s * np.geomspace(SHORTEST, LONGEST, RESETS):
            size = float(np.interp(self._w180(), self._w, np.abs(self._g)))
            for kc in np.geomspace(2.0, 0.01, 200) / size:
                gains = PidGains(self._sign * float(kc), self._sign * float(kc) / float(tau_i), 0.0)
                if self.ms(gains) <= MS_BEST:
                    break
            found.append((gains, *(self.iae(gains, setpoint=which) for which in (True, False))))
        least = [min(row[i] for row in found) for i in (1, 2)]
        return min(found, key=lambda row: row[1] / least[0] + row[2] / least[1])[0]
