"""A gain table as a program: one C99 header, without allocation or libraries, or an IEC 61131-3 function block.

Their text stands in templates/gains.h.jinja and gains.st.jinja. Both do the same operations in the same order as
schedule/regions.py and schedule/table.py, in double, and round the gains to float at the end: so firmware and host have
the same gains, bit for bit in float32 (but compile C without contraction: -ffp-contract=off). Where a double is too
dear, RETUNER_REAL may be float; then the last bits differ.
"""

from collections.abc import Iterable

from retuner.gain_export.numbers import TableNumbers, comment, finite
from retuner.templates import rendered


def c_header(table: TableNumbers, source: str) -> str:
    """The text of the header; source : where the table comes from, for people."""
    return rendered("gains.h.jinja", t=table, source=source, comment=comment, listed=_listed)


def structured_text(table: TableNumbers, source: str) -> str:
    """The text of the function block; source : where the table comes from, for people."""
    return rendered("gains.st.jinja", t=table, source=source, comment=comment, listed=_listed)


def _listed(values: Iterable[float]) -> str:
    return ", ".join(repr(float(finite(value))) for value in values)
