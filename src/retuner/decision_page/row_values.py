"""Values out of a JSON document that may lack them: a ledger of another version, a stage that was not reached."""

import math
from collections.abc import Mapping, Sequence

from retuner.adaptive.process.model import ProcessModel, ProcessType
from retuner.schedule.gains import PidGains

Document = Mapping[str, object]


SMALLEST, LARGEST = 1e-15, 1e15
"""Gains and parameters beyond these are damage, not a controller or process; with them nothing overflows."""


def part(document: Document, name: str) -> Document:
    """A document inside, empty where there is none."""
    value = document.get(name)
    return value if isinstance(value, Mapping) else {}


def parts(document: Document, name: str) -> list[Document]:
    """The documents of a list, empty where there is none."""
    value = document.get(name)
    return [one for one in value if isinstance(one, Mapping)] if isinstance(value, Sequence) else []


def number(document: Document, name: str) -> float | None:
    """A finite number, or None."""
    return finite(document.get(name))


def finite(value: object) -> float | None:
    """The value where it is a finite number, or None."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return float(value) if math.isfinite(value) else None


def numbers(document: Document, name: str) -> list[float]:
    """The finite numbers of a list."""
    value = document.get(name)
    if not isinstance(value, Sequence) or isinstance(value, str):
        return []
    return [one for one in map(finite, value) if one is not None]


def numbers_or_none(document: Document, name: str) -> list[float | None]:
    """The numbers of a list, None where one is null; empty where there is no list."""
    value = document.get(name)
    return [finite(one) for one in value] if isinstance(value, list | tuple) else []


def brief(value: float) -> str:
    """Three figures as people write them: 1,390 and not 1.39e+03."""
    rounded = float(f"{value:.3g}")
    return f"{rounded:,.0f}" if 1e3 <= abs(rounded) < MOST_WRITTEN_OUT else f"{value:.3g}"


MOST_WRITTEN_OUT = 1e7


def in_full(value: float) -> str:
    """A time or a sum as people write it: 28,636 or 0.0312."""
    return f"{value:,.0f}" if abs(value) >= WRITTEN_IN_FULL else f"{value:.4g}"


WRITTEN_IN_FULL = 1e3  # larger numbers are easier to read with an exponent


def words(document: Document, name: str) -> str:
    """A text, empty where there is none."""
    value = document.get(name)
    return value if isinstance(value, str) else ""


def gains_of(document: Document) -> PidGains | None:
    """Gains {kp, ki, kd}, or None where they make no controller."""
    kp, ki, kd = (number(document, name) for name in ("kp", "ki", "kd"))
    if kp is None or ki is None or not _sane(kp, ki, kd or 0.0):
        return None
    try:
        return PidGains(kp, ki, kd or 0.0)
    except ValueError:
        return None


def decided_on(decision: Document) -> ProcessModel | None:
    """The process that a decision rests on: what is known of the region, else the first that was proved on, else the
    one of the record.
    """
    proved = parts(part(decision, "verdict"), "allowed")
    first = model_of(part(proved[0], "model")) if proved else None
    known = model_of(part(part(decision, "known"), "model"))
    return known or first or model_of(part(part(decision, "estimate"), "model"))


def model_of(document: Document) -> ProcessModel | None:
    """A process {type, k, tau1, tau2, theta, zeta, inverse, tau3}, or None where the numbers make none."""
    k = number(document, "k")
    kind = words(document, "type")
    if k is None or kind not in set(ProcessType):
        return None
    tau1, tau2, theta = (number(document, name) or 0.0 for name in ("tau1", "tau2", "theta"))
    if not _sane(k, tau1, tau2, theta):
        return None
    zeta, inverse, tau3 = number(document, "zeta") or 1.0, number(document, "inverse"), number(document, "tau3")
    try:
        return ProcessModel(ProcessType(kind), k, tau1, tau2, theta, zeta, inverse or 0.0, tau3 or 0.0)
    except ValueError:
        return None


def _sane(*values: float) -> bool:
    """Whether each is none at all or of a size that a controller or process may have."""
    return all(value == 0 or SMALLEST < abs(value) < LARGEST for value in values)
