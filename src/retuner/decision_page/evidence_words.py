"""The numbers of a diagnosis in words that engineers know, in the groups in which people look at them."""

import math
from collections.abc import Mapping

from retuner.adaptive.indexes.glossary import GLOSSARY, Entry

MARGINS = {
    "ms": Entry("sensitivity peak Ms", "ratio", "at most 1.75", "Astrom & Hagglund 2006"),
    "gm": Entry("gain margin", "ratio", "at least 2; SIMC has 3", ""),
    "pm_deg": Entry("phase margin", "deg", "at least 45; SIMC has 61", ""),
    "ki_ratio": Entry("SIMC's integral gain over the active one", "ratio", "well above 1: slow", "Skogestad 2003"),
    "kp_ratio": Entry("SIMC's gain over the active one", "ratio", "well above 1: slow", "Skogestad 2003"),
}
HYPOTHESES = {
    "loads": Entry("load steps found", "count", "", ""),
    "linear_left": Entry("residual, loop alone", "noise", "near 1: explained", ""),
    "external_left": Entry("residual, external oscillation", "noise", "", ""),
    "stuck_left": Entry("residual, sticking valve", "noise", "", ""),
    "external_lead": Entry("log-likelihood ratio, external", "index", "2 ln(L1/L2): above 10 strong", "Schwarz 1978"),
    "stuck_lead": Entry(
        "log-likelihood ratio, sticking valve", "index", "2 ln(L1/L2): above 10 strong", "Schwarz 1978"
    ),
    "external_period_s": Entry("period of the external oscillation", "s", "", ""),
    "wrong_way_lead": Entry(
        "log-likelihood ratio, opposite action", "index", "2 ln(L1/L2): above 10 strong", "Schwarz 1978"
    ),
    "stand_travel": Entry("travel of co while pv is still", "co ranges", "above 1: a valve, or a drifting load", ""),
    "stand_dwell": Entry("longest standstill of pv", "tau_I", "above 10: not the loop", ""),
    "stand_degree": Entry("how far pv stands and slips", "index", "0 not, 1 stands, 2 and slips as no loop does", ""),
    "stands": Entry("standstills of pv", "count", "", ""),
    "slips_left": Entry("residual, valve with irregular slips", "noise", "", ""),
    "valve_turns": Entry("reversals of the sticking valve", "count", "below 4: band not reliable", ""),
    "slips": Entry("steps of pv from level to level", "count", "", ""),
    "slips_agreed": Entry("steps towards co", "count", "", ""),
    "slip_jump": Entry("slip jump of the valve", "co", "", "Kano et al. 2004"),
    "swing_s": Entry("period at which a load from outside may swing", "s", "", ""),
    "gain_ratio": Entry("process gain at high pv over that at low pv", "ratio", "2 and more: schedule", ""),
    "follows_late_s": Entry("how late pv follows a setpoint that is led", "s", "", ""),
    "tracking_error": Entry("error over the movement of a setpoint that is led", "share", "", ""),
}
WORDS = {**GLOSSARY, **MARGINS, **HYPOTHESES}

GROUPS: dict[str, tuple[str, ...]] = {
    "margins with the active settings": tuple(MARGINS),
    "competing explanations": tuple(HYPOTHESES),
    "oscillation": ("period_s", "cycles", "regularity", "strength", "decay_ratio", "iae_count", "period_to_tau_i",
                    "phase_deg", "amplitude_pv", "amplitude_co"),
    "setpoint and load responses": ("setpoint_steps", "overshoot", "damping", "idle_index"),
    "valve or sinusoid": ("triangle_co", "triangle_pv", "relay_pv", "tone_share", "distortion", "horch_drho",
                      "yamashita_rho1", "jump_share", "flat_share", "stick_band"),
    "limits and recording": ("at_low_limit", "at_high_limit", "still_share", "offset", "noise_share", "quantum_pv",
                             "quantum_co", "compression_pv"),
}  # fmt: skip
"""Headings with the numbers under them; what is not here is in the JSON only, or under "other"."""
SILENT_UP_TO = {
    "at_low_limit": 0.0,
    "at_high_limit": 0.0,
    "still_share": 0.0,
    "quantum_pv": 0.0,
    "quantum_co": 0.0,
    "offset": 1.0,
    "compression_pv": 1.5,
}
"""Numbers that say nothing up to here, and are left to the JSON then."""
OF_OSCILLATION = {
    "period_s", "cycles", "regularity", "strength", "period_to_tau_i", "phase_deg", "amplitude_pv", "amplitude_co",
    "triangle_co", "triangle_pv", "relay_pv", "tone_share", "distortion", "horch_drho", "stick_band",
}  # fmt: skip
"""Numbers for people only where the oscillation is regular: of a transient they say little."""
REGULAR = 1.0  # regularity from which it is
LONGEST = 44  # width of the words in a table


def value_text(name: str, value: float) -> str:
    """A number with its unit."""
    unit = WORDS[name].unit if name in WORDS else ""
    if not math.isfinite(value):
        return "none" if value > 0 else "-"
    if unit == "share":
        return f"{value:.1%}"
    if unit == "count":
        return f"{value:.3g}"
    return f"{value:.3g}" + {"s": " s", "deg": " deg", "pv": " (pv)", "co": " (co)", "noise": " x noise"}.get(unit, "")


def evidence_table(evidence: Mapping[str, float]) -> dict[str, list[tuple[str, str, str]]]:
    """Rows (words, value, how to read it) by heading; only what the evidence holds."""
    found: dict[str, list[tuple[str, str, str]]] = {}
    hidden = OF_OSCILLATION if evidence.get("regularity", 0.0) <= REGULAR and "stuck_left" not in evidence else set()
    for heading, names in {**GROUPS, "other": tuple([name for name in evidence if name not in WORDS])}.items():
        rows = []
        for name in names:
            if name not in evidence or name in hidden or evidence[name] <= SILENT_UP_TO.get(name, -math.inf):
                continue
            entry = WORDS.get(name, Entry(name.replace("_", " "), "", "", ""))
            rows.append((entry.words, value_text(name, evidence[name]), entry.reading))
        if rows:
            found[heading] = rows
    return found


def evidence_lines(evidence: Mapping[str, float], *, readings: bool = True) -> list[str]:
    """The table as text, with or without how to read each number."""
    lines = []
    for heading, rows in evidence_table(evidence).items():
        lines.append(f"  {heading}")
        for words, value, reading in rows:
            lines.append(f"    {words:<{LONGEST}} {value:>12}   {reading if readings else ''}".rstrip())
    return lines
