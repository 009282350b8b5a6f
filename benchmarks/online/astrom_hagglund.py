"""The standard batch of processes that PID rules are tried on.

Nine families, from Astrom & Hagglund (2004), "Revisiting the Ziegler-Nichols step response method for PID control",
J. Process Control 14, section 3 (the test batch), and Astrom & Hagglund (2006), "Advanced PID Control", section 7.2:

    P1  e^-s / (1 + sT)              P6  e^-sL / (s (1 + s(1 - L)))
    P2  e^-s / (1 + sT)^2            P7  T e^-sL / ((1 + sT)(1 + s(1 - L)))
    P3  1 / ((s + 1)(1 + sT)^2)      P8  (1 - as) / (s + 1)^3
    P4  1 / (s + 1)^n                P9  1 / ((s + 1)((sT)^2 + 1.4 sT + 1))
    P5  1 / ((1 + s)(1 + as)(1 + a^2 s)(1 + a^3 s))
"""

from typing import NamedTuple

from retuner.adaptive.process.model import LinearProcess

P1_T = (0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 1, 1.3, 1.5, 2, 4, 6, 8, 10, 20, 50, 100, 200, 500, 1000)
P2_T = (0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 1, 1.3, 1.5, 2, 4, 6, 8, 10, 20, 50, 100, 200, 500)
P3_T = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 2, 5, 10)
P4_N = (3, 4, 5, 6, 7, 8)
P5_A = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)
P6_L = (0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 0.9, 1)
P7_T, P7_L = (1, 2, 5, 10), (0.01, 0.02, 0.05, 0.1, 0.3, 0.5, 0.7, 0.9, 1)
P8_A = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1, 1.1)
P9_T = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1)


class Member(NamedTuple):
    """One process of the batch. family : P1 to P9. parameter : as in the head of this file, for people."""

    family: str
    parameter: str
    process: LinearProcess

    @property
    def name(self) -> str:
        """For example "P7 T=2 L=0.1"."""
        return f"{self.family} {self.parameter}"


def batch() -> list[Member]:
    """All processes of the batch, 134, in the order of the families."""
    return [
        *(Member("P1", f"T={t:g}", LinearProcess(1.0, (t,), (), 1.0)) for t in P1_T),
        *(Member("P2", f"T={t:g}", LinearProcess(1.0, (t, t), (), 1.0)) for t in P2_T),
        *(Member("P3", f"T={t:g}", LinearProcess(1.0, (1.0, t, t))) for t in P3_T),
        *(Member("P4", f"n={n}", LinearProcess(1.0, (1.0,) * n)) for n in P4_N),
        *(Member("P5", f"a={a:g}", LinearProcess(1.0, tuple(a**i for i in range(4)))) for a in P5_A),
        *(Member("P6", f"L={x:g}", LinearProcess(1.0, _lags(1 - x), (), x, 1)) for x in P6_L),
        *(Member("P7", f"T={t} L={x:g}", LinearProcess(t, (t, *_lags(1 - x)), (), x)) for t in P7_T for x in P7_L),
        *(Member("P8", f"a={a:g}", LinearProcess(1.0, (1.0, 1.0, 1.0), (-a,))) for a in P8_A),
        *(Member("P9", f"T={t:g}", LinearProcess(1.0, (1.0,), (), 0.0, 0, ((1.4 * t, t * t),))) for t in P9_T),
    ]


def _lags(lag: float) -> tuple[float, ...]:
    """None where it is nothing."""
    return (lag,) if lag > 0 else ()
