"""A gain table as a function block in IEC 61131-3 structured text: the same choice of the region, the same lookup."""

from collections.abc import Iterable

from retuner.gain_export.numbers import TableNumbers, comment, finite


def structured_text(table: TableNumbers, source: str) -> str:
    """The text of the function block; source : where the table comes from, for people."""
    name = "FB_" + "".join(part.capitalize() for part in table.name.split("_")) + "Gains"
    inputs = [f"    x{i + 1} : LREAL; (* {comment(a.label)} in {comment(a.unit)} *)" for i, a in enumerate(table.axes)]
    lines = [
        f"(* Gains of {comment(table.name)}, revision {table.revision}, exported from {comment(source)} by retuner.",
        "   co = kp (b sp - pv) + ki integral(sp - pv) dt - kd d(pv)/dt; co in percent of its range, times in seconds.",
        "   Call it once a sample; inputs must be finite numbers. *)",
        f"FUNCTION_BLOCK {name}",
        "VAR_INPUT",
        *inputs,
        "    t_s : LREAL; (* time of the sample in seconds, never backwards *)",
        "END_VAR",
        "VAR_OUTPUT",
        "    region : INT; (* counted from 0 *)",
        "    kp : REAL;",
        "    ki : REAL;",
        "    kd : REAL;",
        "END_VAR",
        "VAR CONSTANT",
        *_constants(table),
        "END_VAR",
        "VAR",
        *_variables(table),
        "END_VAR",
        *_body(table),
        "END_FUNCTION_BLOCK",
    ]
    return "\n".join(lines) + "\n"


def _array(name: str, values: Iterable[float]) -> str:
    """An array of constants; one that would be empty has a place that nobody reads."""
    given = list(values) or [0.0]
    listed = ", ".join(repr(float(finite(value))) for value in given)
    return f"    {name} : ARRAY[0..{len(given) - 1}] OF LREAL := [{listed}];"


def _constants(table: TableNumbers) -> Iterable[str]:
    for i, axis in enumerate(table.axes):
        for name in ("bounds", "floors", "ceilings", "centres"):
            yield _array(f"{name}{i + 1}", getattr(axis, name))
    for k, gain in enumerate(("kp", "ki", "kd")):
        yield _array(f"table_{gain}", (gains[k] for gains in table.gains))


def _variables(table: TableNumbers) -> Iterable[str]:
    """What is kept from sample to sample, and what the interpolation needs."""
    yield "    started : BOOL := FALSE;"
    yield "    i : INT;"
    yield "    row : INT;"
    yield "    share : LREAL;"
    yield "    w : LREAL;"
    yield "    dt_s : LREAL;"
    yield "    last_s : LREAL;"
    for n in range(1, len(table.axes) + 1):
        yield f"    part{n} : INT;"
        yield f"    place{n} : INT;"
        yield f"    since{n} : LREAL;"
        yield f"    y{n} : LREAL;"
        yield f"    at{n} : INT;"
        yield f"    high{n} : LREAL;"
    for gain in ("kp", "ki", "kd"):
        yield f"    sum_{gain} : LREAL;"


def _body(table: TableNumbers) -> Iterable[str]:
    yield "IF NOT started THEN"
    yield "    started := TRUE;"
    yield "    last_s := t_s;"
    for n, axis in enumerate(table.axes, 1):
        yield f"    y{n} := x{n};"
        yield f"    since{n} := t_s;"
        yield from _bisect(f"place{n}", f"bounds{n}", len(axis.bounds), f"x{n}", "    ")
        yield f"    part{n} := place{n};"
    yield "END_IF;"
    yield "dt_s := t_s - last_s;"
    yield "IF dt_s >= 0.0 THEN"
    for n, axis in enumerate(table.axes, 1):
        if axis.filter_s:
            yield f"    w := dt_s / ({axis.filter_s!r} + dt_s);"
            yield f"    y{n} := (1.0 - w) * y{n} + w * x{n};"
        else:
            yield f"    y{n} := x{n};"
        outside = f"(y{n} < floors{n}[part{n}]) OR (y{n} > ceilings{n}[part{n}])"
        yield f"    IF ({outside}) AND (t_s - since{n} >= {axis.min_stay_s!r}) THEN"
        yield from _bisect(f"place{n}", f"bounds{n}", len(axis.bounds), f"y{n}", "        ")
        yield f"        IF place{n} <> part{n} THEN"
        yield f"            part{n} := place{n};"
        yield f"            since{n} := t_s;"
        yield "        END_IF;"
        yield "    END_IF;"
    yield "    last_s := t_s;"
    yield "END_IF;"
    second = f" * {len(table.axes[1].centres)} + part2" if len(table.axes) > 1 else ""
    yield f"region := part1{second};"
    yield from (_interpolated(table) if table.interpolated else _hard())


def _bisect(found: str, knots: str, count: int, value: str, inner: str) -> Iterable[str]:
    """How many knots are not above the value."""
    yield f"{inner}{found} := 0;"
    if count:
        yield f"{inner}FOR i := 0 TO {count - 1} DO"
        yield f"{inner}    IF {knots}[i] <= {value} THEN"
        yield f"{inner}        {found} := i + 1;"
        yield f"{inner}    END_IF;"
        yield f"{inner}END_FOR;"


def _hard() -> Iterable[str]:
    for gain in ("kp", "ki", "kd"):
        yield f"{gain} := LREAL_TO_REAL(table_{gain}[region]);"


def _interpolated(table: TableNumbers) -> Iterable[str]:
    """The mean of the sets whose centres are nearest: at : the lower centre, high : share of the one above it."""
    for n, axis in enumerate(table.axes, 1):
        count = len(axis.centres)
        yield from _bisect(f"place{n}", f"centres{n}", count, f"y{n}", "")
        yield f"IF (place{n} = 0) OR (place{n} = {count}) THEN"
        yield f"    at{n} := place{n};"
        yield f"    IF place{n} = {count} THEN"
        yield f"        at{n} := {count - 1};"
        yield "    END_IF;"
        yield f"    high{n} := 0.0;"
        yield "ELSE"
        yield f"    at{n} := place{n} - 1;"
        yield f"    high{n} := (y{n} - centres{n}[at{n}]) / (centres{n}[place{n}] - centres{n}[at{n}]);"
        yield "END_IF;"
    for gain in ("kp", "ki", "kd"):
        yield f"sum_{gain} := 0.0;"
    steps = [(i, j) for i in (0, 1) for j in ((0, 1) if len(table.axes) > 1 else (0,))]
    for i, j in steps:
        share = f"high{1}" if i else "(1.0 - high1)"
        row = "at1 + 1" if i else "at1"
        if len(table.axes) > 1:
            share += " * high2" if j else " * (1.0 - high2)"
            row = f"({row}) * {len(table.axes[1].centres)} + at2" + (" + 1" if j else "")
        yield f"share := {share};"
        yield "IF share <> 0.0 THEN"
        yield f"    row := {row};"
        for gain in ("kp", "ki", "kd"):
            yield f"    sum_{gain} := sum_{gain} + share * table_{gain}[row];"
        yield "END_IF;"
    for gain in ("kp", "ki", "kd"):
        yield f"{gain} := LREAL_TO_REAL(sum_{gain});"
