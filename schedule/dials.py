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

from retuner.schedule.gains import Form
from retuner.schedule.vendor_units import SECONDS_PER_MINUTE, Quantity


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


def _dials(
    gain: Dial, integral: tuple[str, str, float], derivative: tuple[str, str, float], *, apart: bool = False
) -> tuple[Dial, Dial, Dial]:
    """A gain with two times, or with two gains of their own (apart), which share what the gain is told of."""
    (i_word, i_unit, i_scale), (d_word, d_unit, d_scale) = integral, derivative
    i_is, d_is = (Quantity.KI, Quantity.KD) if apart else (Quantity.TN, Quantity.TV)
    return (
        gain,
        Dial(i_word, i_is, i_word, i_unit, i_scale, of_span=apart and gain.of_span),
        Dial(d_word, d_is, d_word, d_unit, d_scale, of_span=apart and gain.of_span),
    )


def _gain(word: str, *, of_span: bool = True) -> Dial:
    return Dial(word, Quantity.KP, word, of_span=of_span)


_MINUTE = SECONDS_PER_MINUTE
_RATES = ("IGain", "/min", 1.0 / _MINUTE), ("DGain", " min", _MINUTE)
_DELTAV = _dials(_gain("GAIN"), ("RESET", " s", 1.0), ("RATE", " s", 1.0))
_HONEYWELL = _dials(_gain("K"), ("T1", " min", _MINUTE), ("T2", " min", _MINUTE))
_COPTER = _dials(_gain("P", of_span=False), ("I", "/s", 1.0), ("D", " s", 1.0), apart=True)
NO_DERIVATIVE = Dial("", Quantity.KD, "")  # Stands where a controller has no derivative action
CONTROLLERS = {
    "deltav-standard": NamedController(_DELTAV, Form.IDEAL),
    "deltav-series": NamedController(_DELTAV, Form.SERIES),
    "honeywell-a": NamedController(_HONEYWELL, Form.IDEAL),
    "honeywell-b": NamedController(_HONEYWELL, Form.IDEAL),
    "honeywell-c": NamedController(_HONEYWELL, Form.IDEAL),
    "siemens-cont-c": NamedController(
        _dials(_gain("GAIN", of_span=False), ("TI", " s", 1.0), ("TD", " s", 1.0)), Form.IDEAL
    ),
    "siemens-pid-compact": NamedController(
        _dials(_gain("Gain", of_span=False), ("Ti", " s", 1.0), ("Td", " s", 1.0)), Form.IDEAL
    ),
    "yokogawa": NamedController(
        _dials(Dial("P", Quantity.XP, "P", " %", of_span=True), ("I", " s", 1.0), ("D", " s", 1.0)), Form.IDEAL
    ),
    "rockwell-pide": NamedController(_dials(_gain("PGain"), *_RATES, apart=True), Form.PARALLEL),
    "rockwell-pide-dependent": NamedController(
        _dials(_gain("PGain"), ("IGain", " min", _MINUTE), ("DGain", " min", _MINUTE)), Form.IDEAL
    ),
    "abb-800xa": NamedController(_dials(_gain("Gain"), ("Ti", " s", 1.0), ("Td", " s", 1.0)), Form.IDEAL),
    "abb-fc19": NamedController(
        (
            _gain("K", of_span=False),
            Dial("KI", Quantity.REPEATS, "KI", "/min"),
            Dial("KD", Quantity.TV, "KD", " min", _MINUTE),
        ),
        Form.IDEAL,
    ),
    "ovation": NamedController(
        (
            _gain("PGAIN"),
            Dial("INTG", Quantity.KI_TIME, "INTG", " s", of_span=True),
            Dial("DGAIN", Quantity.KD, "DGAIN", " s", of_span=True),
        ),
        Form.PARALLEL,
    ),
    "ardupilot": NamedController(_COPTER, Form.PARALLEL),
    "px4": NamedController(_COPTER, Form.PARALLEL),
    "odrive": NamedController(
        (
            _gain("vel_gain", of_span=False),
            Dial("vel_integrator_gain", Quantity.KI, "vel_integrator_gain", "/s"),
            NO_DERIVATIVE,
        ),
        Form.PARALLEL,
    ),
}
"""Vendors' controllers by their names."""


def told_of_spans(name: str) -> bool:
    """Whether a name, of a controller or of units, tells gains of the spans of pv and output."""
    vendor = name.lower().replace("_", "-")
    if vendor in CONTROLLERS:
        return CONTROLLERS[vendor].dials[0].of_span
    gain = GAINS.get(name.split("-", maxsplit=1)[0])
    return gain is not None and gain.of_span
