"""Controllers by name, and the dials that stand on them: each number with its word, its unit and what it is.

The controllers of vendors, with the form of their law and where it stands:

    deltav-standard, deltav-series   Emerson DeltaV, PID block, FORM: GAIN of the scaled signals, RESET s, RATE s;
                      DeltaV Books Online, "PID function block parameters"; the laws: Emerson 00809-0500-4880, fig. 8-13
    honeywell-a, -b, -c   Honeywell Experion, PID block, CTLEQN: K of the scaled signals, T1 and T2 min. In A all terms
                      act on the error, in B the derivative on pv alone, in C only the integral on the error (Experion
                      Control Builder Components Theory, PID; HC900 Function Block Reference, table 79, says A and B)
    siemens-cont-c    SIMATIC FB 41 CONT_C: GAIN in percent of LMN per unit of PV_IN, TI and TD s; C79000-G7076-C516
    siemens-pid-compact   PID_Compact: Gain in percent of Output per unit of Input, Ti and Td s; A5E35300227, 9.1
    yokogawa          CENTUM PID: P proportional band %, I and D s; K = 100/PB as in IM 21B04C01, 16.5
    rockwell-pide     Logix PIDE, independent gains: PGain, IGain 1/min, DGain min of the error in percent of span;
                      1756-RM006K, p. 80
    rockwell-pide-dependent   the same block with DependIndepend set: IGain minutes per repeat, DGain min
    abb-800xa         AC 800M PidCC, PidLoop: Gain of the scaled signals, Ti and Td s
    abb-fc19          Symphony/Bailey function code 19 with KP = 1: K in output per unit of pv, KI 1/min, KD min
    ovation           Emerson Ovation PID, three terms side by side: PGAIN + 1/(INTG s) + DGAIN s, of scaled signals
    ardupilot         ArduPilot AC_PID (ATC_RAT_*_P, _I, _D): three gains side by side, per second
    px4               PX4 rate controller (MC_*RATE_P, _I, _D) with MC_*RATE_K = 1: the same; PX4-Autopilot 12472
    odrive            ODrive velocity controller: vel_gain, vel_integrator_gain per second; no derivative

The laws of honeywell, abb and ovation stand as they are known in the trade: their manuals are not public. Where the
signals are scaled a gain is told of the spans of pv and output. Time constants of derivative filters are not told.
"""

from typing import NamedTuple

from retuner.schedule.gains import SECONDS_PER_MINUTE, Form
from retuner.schedule.vendor_units import Quantity


class Dial(NamedTuple):
    """One number of a controller.

    key : of the configuration. quantity : what it is, see vendor_units.py. label, unit : as it is written, label first.
    scale : ours for one of the controller's. of_span : in percent of the spans of pv and output.
    """

    key: str
    quantity: Quantity
    label: str
    unit: str = ""
    scale: float = 1.0
    of_span: bool = False

    def written(self, number: float, digits: int = 3) -> str:
        """The number with its label and unit; 1030 s, where so many digits alone would be 1.03e+03."""
        rounded = f"{number:.{digits}g}"
        plain = f"{float(rounded):.0f}" if 1e3 <= abs(number) < PLAIN_BELOW else rounded
        return f"{self.label} {plain}{self.unit}".strip()


PLAIN_BELOW = 1e6  # numbers that are written without an exponent
GAINS = {
    "kc": Dial("kc", Quantity.KP, "Kc"),
    "gain": Dial("gain", Quantity.KP, "gain", " %/%", of_span=True),
    "pb": Dial("pb_pct", Quantity.XP, "PB", " %", of_span=True),
}
"""What the proportional action is dialled as, by the first part of a name."""
TIMES = {
    "s": (Dial("tau_i_s", Quantity.TN, "tau_I", " s"), Dial("tau_d_s", Quantity.TV, "tau_D", " s")),
    "min": (
        Dial("tau_i_min", Quantity.TN, "tau_I", " min", SECONDS_PER_MINUTE),
        Dial("tau_d_min", Quantity.TV, "tau_D", " min", SECONDS_PER_MINUTE),
    ),
    "rpm": (
        Dial("repeats_per_min", Quantity.REPEATS, "reset", " repeats/min"),
        Dial("tau_d_min", Quantity.TV, "tau_D", " min", SECONDS_PER_MINUTE),
    ),
}
"""What integral and derivative action are dialled as, by the second part of a name."""
PARALLEL = (Dial("kp", Quantity.KP, "kp"), Dial("ki", Quantity.KI, "ki", "/s"), Dial("kd", Quantity.KD, "kd", " s"))
KEYS = {dial.key: dial for dial in (*GAINS.values(), *(dial for pair in TIMES.values() for dial in pair))}
"""The dials by their keys in the configuration."""


class NamedController(NamedTuple):
    """A vendor's controller: its dials and the form of its law."""

    dials: tuple[Dial, Dial, Dial]
    form: Form


def _gain(word: str, *, of_span: bool = True) -> Dial:
    return Dial(word, Quantity.KP, word, of_span=of_span)


def _timed(gain: Dial, integral: str, derivative: str, unit: str = " s", form: Form = Form.IDEAL) -> NamedController:
    """A gain with two times in one unit."""
    scale = _MINUTE if unit == " min" else 1.0
    times = Dial(integral, Quantity.TN, integral, unit, scale), Dial(derivative, Quantity.TV, derivative, unit, scale)
    return NamedController((gain, *times), form)


def _apart(gain: Dial, integral: tuple[str, str, float], derivative: tuple[str, str, float]) -> NamedController:
    """Three gains side by side, all told of the same: word, unit and scale of the other two."""
    (i_word, i_unit, i_scale), (d_word, d_unit, d_scale) = integral, derivative
    i_gain = Dial(i_word, Quantity.KI, i_word, i_unit, i_scale, gain.of_span)
    d_gain = Dial(d_word, Quantity.KD, d_word, d_unit, d_scale, gain.of_span)
    return NamedController((gain, i_gain, d_gain), Form.PARALLEL)


_MINUTE = SECONDS_PER_MINUTE
_COPTER = _apart(_gain("P", of_span=False), ("I", "/s", 1.0), ("D", " s", 1.0))
_KI, _KD = Dial("KI", Quantity.REPEATS, "KI", "/min"), Dial("KD", Quantity.TV, "KD", " min", _MINUTE)
_INTG = Dial("INTG", Quantity.KI_TIME, "INTG", " s", of_span=True)
_DGAIN = Dial("DGAIN", Quantity.KD, "DGAIN", " s", of_span=True)
_ODRIVE = Dial("vel_integrator_gain", Quantity.KI, "vel_integrator_gain", "/s")
NO_DERIVATIVE = Dial("", Quantity.KD, "")  # Stands where a controller has no derivative action
CONTROLLERS = {
    "deltav-standard": _timed(_gain("GAIN"), "RESET", "RATE"),
    "deltav-series": _timed(_gain("GAIN"), "RESET", "RATE", form=Form.SERIES),
    **dict.fromkeys(("honeywell-a", "honeywell-b", "honeywell-c"), _timed(_gain("K"), "T1", "T2", " min")),
    "siemens-cont-c": _timed(_gain("GAIN", of_span=False), "TI", "TD"),
    "siemens-pid-compact": _timed(_gain("Gain", of_span=False), "Ti", "Td"),
    "yokogawa": _timed(Dial("P", Quantity.XP, "P", " %", of_span=True), "I", "D"),
    "rockwell-pide": _apart(_gain("PGain"), ("IGain", "/min", 1.0 / _MINUTE), ("DGain", " min", _MINUTE)),
    "rockwell-pide-dependent": _timed(_gain("PGain"), "IGain", "DGain", " min"),
    "abb-800xa": _timed(_gain("Gain"), "Ti", "Td"),
    "abb-fc19": NamedController((_gain("K", of_span=False), _KI, _KD), Form.IDEAL),
    "ovation": NamedController((_gain("PGAIN"), _INTG, _DGAIN), Form.PARALLEL),
    "ardupilot": _COPTER,
    "px4": _COPTER,
    "odrive": NamedController((_gain("vel_gain", of_span=False), _ODRIVE, NO_DERIVATIVE), Form.PARALLEL),
}
"""Vendors' controllers by their names."""


def told_of_spans(name: str) -> bool:
    """Whether a name, of a controller or of units, tells gains of the spans of pv and output."""
    vendor = name.lower().replace("_", "-")
    if vendor in CONTROLLERS:
        return CONTROLLERS[vendor].dials[0].of_span
    gain = GAINS.get(name.split("-", maxsplit=1)[0])
    return gain is not None and gain.of_span
