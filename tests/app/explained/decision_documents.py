"""Documents of decisions as a ledger has them, and samples that go with them."""

import copy
import re

import numpy as np

from retuner.decision_page.decision_view import DecisionView, Samples

FOUND = {
    "overshoot": [0.05, 0.0, 0.08],
    "damping": [0.1, 0.0, 0.2],
    "decay": [0.1, 0.0, 0.2],
    "iae": [106.5, 103.0, 110.0],
    "travel": [1.6, 1.5, 1.7],
    "settle_s": [165.0, 163.0, None],
}
SWINGING = {**FOUND, "iae": [None, None, None], "overshoot": [0.61, 0.5, 0.7]}
PROMISE = {
    "setpoint": FOUND,
    "load": FOUND,
    "setpoint_before": SWINGING,
    "load_before": SWINGING,
    "models": 5,
    "ms": [1.56, 1.5, 1.72],
}
WORSE = {
    "finding": "worse",
    "reason": "worse than predicted: half-cycle decay ratio 0.60",
    "numbers": {
        "overshoot": 0.61,
        "damping": 0.6,
        "decay": 0.6,
        "decay_limit": 0.25,
        "decay_promised": 0.1,
        "decay_before": -1.0,
        "iae": 212.0,
        "iae_promised": 106.5,
        "iae_before": 300.0,
        "ms": 2.64,
        "ms_limit": 2.1,
        "ms_promised": 1.56,
        "ms_before": -1.0,
        "cost": 0.8,
        "cost_limit": 1.5,
    },
}
N, DT = 300, 2.0
START, END = 1100.0, 1500.0
MODEL = {"type": "sopdt", "k": 2.0, "tau1": 240.0, "tau2": 9.0, "theta": 26.0}
BEFORE, WANTED = {"kp": 2.4, "ki": 0.016, "kd": 0.0}, {"kp": 1.5, "ki": 0.006, "kd": 0.0}
RESPONSE = {
    "t_start_s": START,
    "t_end_s": END,
    "peaks": [[1120.0, 15.0], [1210.0, -8.0], [1310.0, 2.4]],
    "ending": "complete",
    "upset": "setpoint",
    "overshoot": 8.0 / 15.0,
    "damping": 10.4 / 23.0,
    "period_s": 190.0,
    "band": 0.25,
}
COMMIT: dict[str, object] = {
    "number": 8, "t_s": END, "loop": "oven", "region": "middle", "mode": "auto", "action": "commit", "code": "accepted",
    "reason": "Ms 2.88 is over 1.8, gain margin 1.72", "numbers": {}, "gains_before": BEFORE, "gains_after": WANTED,
    "response": RESPONSE,
    "estimate": {"identifiable": True, "model": MODEL, "std": {"k": 0.03, "theta": 0.35, "tau1": 2.6, "tau2": 0.4},
                 "reason": "second order + dead time explains 99.9% of pv's variance", "loads": [1405.0],
                 "residual": 0.08, "noise": 0.06, "coloured": 0},
    "surprise": "agrees", "records": 2,
    "diagnosis": {"cause": "aggressive", "confidence": 0.99, "retune": True, "reason": "too much gain",
                  "evidence": {"ms": 2.88, "gm": 1.72, "pm_deg": 30.7, "ki_ratio": 0.36, "kp_ratio": 0.59}},
    "basis": "model", "promise": PROMISE, "judgement": None, "trial": "writing",
    "proposal": {"rule": "simc", "form": "series", "gains": {"kc": 1.5, "tau_i": 250.0, "tau_d": 0.0},
                 "parallel": WANTED, "tau_c": 36.0},
    "verdict": {"accepted": True, "ruling": "accepted", "step": 0.625, "tau_c_s": 36.0, "reason": "proved: robust",
                "ms": {"nominal": 1.6543, "worst": 2.0345, "before": 2.8765},
                "checks": [{"name": "ms_nominal", "value": 1.6543, "limit": 1.75, "passed": True},
                           {"name": "ms_worst", "value": None, "limit": 2.1, "passed": False}],
                "allowed": [{"model": {**MODEL, "theta": theta}, "excess": 1.0} for theta in (26.0, 20.0, 32.0)]},
}  # fmt: skip


def changed(**parts: object) -> dict[str, object]:
    """The commit with other parts."""
    return {**copy.deepcopy(COMMIT), **parts}


REFUSED = changed(
    action="none",
    gains_after=None,
    code="not_robust",
    reason="refused: not robust even at a quarter of the change",
    verdict={
        "accepted": False,
        "ruling": "not_robust",
        "step": 0.0,
        "tau_c_s": 36.0,
        "reason": "refused: not robust",
        "ms": {"nominal": 1.3, "worst": None, "before": 1.3},
    },
    promise=None,
    trial="idle",
)
ADVISED = changed(action="advise", mode="advise")
RESTORED = changed(
    action="restore",
    code="worse_than_promised",
    reason="the loop responds worse than predicted",
    proposal=None,
    verdict=None,
    estimate=None,
    diagnosis=None,
    response=None,
    basis=None,
    surprise=None,
    records=0,
    promise=None,
    judgement=WORSE,
    trial="rolling back to the verified gains",
    number=9,
    t_s=END + 900.0,
    gains_before=WANTED,
    gains_after=BEFORE,
)
PATTERN = changed(
    basis="pattern",
    estimate=None,
    surprise=None,
    records=0,
    verdict=None,
    diagnosis=None,
    proposal={"rule": "pattern", "form": "ideal", "parallel": WANTED, "tau_c": None},
)
BORROWED = changed(basis="borrowed", records=0, known={"model": MODEL, "std": {"k": 0.8, "theta": 9.0}})
EVERY_KIND = {
    "commit": COMMIT,
    "refuse": REFUSED,
    "advise": ADVISED,
    "restore": RESTORED,
    "pattern": PATTERN,
    "borrowed": BORROWED,
}


def samples() -> Samples:
    """A made-up response over the time of the documents."""
    t = 1000.0 + DT * np.arange(N)
    x = np.maximum(t - START, 0.0)
    pv = 120.0 - 15.0 * np.exp(-x / 90.0) * np.cos(x / 30.0)
    return Samples(t, np.where(t < START, 105.0, 120.0), pv, 40.0 + 5.0 * np.exp(-x / 90.0), pv + 0.05)


def view(document: dict[str, object] | None = None, *, drawn: bool = True, unit: str = "degC") -> DecisionView:
    """A decision as its page sees it."""
    return DecisionView(COMMIT if document is None else document, samples() if drawn else None, unit, DT)


def plain(text: str) -> str:
    """A page without what cells know of their heads, for narrow screens."""
    return re.sub(r' data-head="[^"]*"', "", text)
