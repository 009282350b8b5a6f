"""A gain table as one C99 header: numbers, choice of the region and lookup, without allocation or libraries.

It does the same operations in the same order as schedule/regions.py and schedule/table.py, in double, and rounds the
gains to float at the end: so firmware and host have the same gains, bit for bit in float32 (but compile without
contraction: -ffp-contract=off). Where a double is too dear, RETUNER_REAL may be float; then the last bits differ.
"""

from collections.abc import Iterable

from retuner.gain_export.numbers import AxisNumbers, TableNumbers, comment, finite


def c_header(table: TableNumbers, source: str) -> str:
    """The text of the header; source : where the table comes from, for people."""
    p, n = table.name, len(table.axes)
    lines = [
        f"/* Gains of {comment(table.name)}, revision {table.revision}, exported from {comment(source)} by retuner.",
        " *",
        " * co = kp (b sp - pv) + ki integral(sp - pv) dt - kd d(pv)/dt; co in percent of its range, times in seconds.",
        f" * {_axes_text(table)}",
        " * Compile with -ffp-contract=off for the bits of the host; RETUNER_REAL float where doubles are too dear. */",
        f"#ifndef RETUNER_{p.upper()}_GAINS_H",
        f"#define RETUNER_{p.upper()}_GAINS_H",
        "",
        "#ifndef RETUNER_REAL",
        "#define RETUNER_REAL double",
        "#endif",
        "",
        f"#define {p.upper()}_REGIONS {len(table.gains)}",
        f"#define {p.upper()}_REVISION {table.revision}",
        "",
        f"typedef struct {{ float kp, ki, kd; }} {p}_gains_t;",
        "/* All zero before the first sample. */",
        f"typedef struct {{ int started, part[{n}]; RETUNER_REAL since_s[{n}], y[{n}], t_s; }} {p}_state_t;",
        "",
        *_tables(table),
        "",
        *_functions(table),
        f"#endif /* RETUNER_{p.upper()}_GAINS_H */",
    ]
    return "\n".join(lines) + "\n"


def _axes_text(table: TableNumbers) -> str:
    axes = " and ".join(f"{comment(axis.label)} in {comment(axis.unit)}" for axis in table.axes)
    return f"Scheduled by {axes}, {'interpolated between the centres' if table.interpolated else 'one set a region'}."


def _tables(table: TableNumbers) -> Iterable[str]:
    p = table.name
    for i, axis in enumerate(table.axes):
        for name in ("bounds", "floors", "ceilings", "centres"):
            values = getattr(axis, name) or (0.0,)  # C has no empty arrays; the count says that none is used
            yield f"static const double {p}_{name}_{i}[{len(values)}] = {{{_listed(values)}}};"
    yield f"static const double {p}_table[{len(table.gains)}][3] = {{"
    for name, gains in zip(table.names, table.gains, strict=True):
        yield f"    {{{_listed(gains)}}}, /* {comment(name)} */"
    yield "};"


def _listed(values: Iterable[float]) -> str:
    return ", ".join(repr(float(finite(value))) for value in values)


def _functions(table: TableNumbers) -> Iterable[str]:
    """The choice of the region and the lookup."""
    p = table.name
    yield _COMMON.replace("@", p)
    for i, axis in enumerate(table.axes):
        yield from _move(table, i, axis)
    columns = len(table.axes[1].centres) if len(table.axes) > 1 else 1
    second = f" * {columns} + s->part[1]" if len(table.axes) > 1 else ""
    yield f"/* The region at this sample; t_s : its time in seconds, never backwards. {_inputs(table)} */"
    yield f"static int {p}_choose({p}_state_t *s, {_arguments(table)}, RETUNER_REAL t_s) {{"
    yield from _choose_body(table)
    yield f"    return s->part[0]{second};"
    yield "}"
    yield ""
    yield from (_at_interpolated(table) if table.interpolated else _at_hard(table))
    yield "/* Region and gains of one sample. */"
    yield f"static {p}_gains_t {p}_lookup({p}_state_t *s, {_arguments(table)}, RETUNER_REAL t_s) {{"
    yield f"    int region = {p}_choose(s, {', '.join(_names(table))}, t_s);"
    given = ", ".join(_names(table)) if table.plain else ", ".join(f"s->y[{i}]" for i in range(len(table.axes)))
    yield f"    return {p}_at(region, {given});"
    yield "}"
    yield ""


def _names(table: TableNumbers) -> list[str]:
    return ["x", "x2"][: len(table.axes)]


def _arguments(table: TableNumbers) -> str:
    return ", ".join(f"RETUNER_REAL {name}" for name in _names(table))


def _inputs(table: TableNumbers) -> str:
    pairs = zip(_names(table), table.axes, strict=True)
    return "; ".join(f"{name} : {comment(axis.label)} in {comment(axis.unit)}" for name, axis in pairs)


_COMMON = """static int @_finite(RETUNER_REAL v) {
    return v - v == 0;
}

static int @_bisect(const double *knots, int n, RETUNER_REAL v) {
    int i = 0;
    while (i < n && (RETUNER_REAL)knots[i] <= v)
        i++;
    return i;
}
"""


def _move(table: TableNumbers, i: int, axis: AxisNumbers) -> Iterable[str]:
    p, n = table.name, len(axis.bounds)
    yield f"static void {p}_move_{i}({p}_state_t *s, RETUNER_REAL x, RETUNER_REAL t_s, RETUNER_REAL dt_s) {{"
    yield "    RETUNER_REAL stay;"
    yield f"    if ({p}_finite(x)) {{"
    if axis.filter_s:
        yield f"        RETUNER_REAL w = dt_s / ((RETUNER_REAL){axis.filter_s!r} + dt_s);"
        yield f"        s->y[{i}] = (1 - w) * s->y[{i}] + w * x;"
    else:
        yield f"        s->y[{i}] = x;"
    yield "    } else {"
    yield "        (void)dt_s;" + (" return; /* a failed sensor: the region stays */" if table.plain else "")
    yield "    }"
    part, value = f"s->part[{i}]", f"s->y[{i}]"
    yield f"    if ((RETUNER_REAL){p}_floors_{i}[{part}] <= {value}"
    yield f"            && {value} <= (RETUNER_REAL){p}_ceilings_{i}[{part}])"
    yield "        return;"
    yield f"    stay = t_s - s->since_s[{i}];"
    yield f"    if (!((RETUNER_REAL){axis.min_stay_s!r} <= stay && {p}_finite(stay)))"
    yield "        return;"
    yield f"    if ({part} != {p}_bisect({p}_bounds_{i}, {n}, {value})) {{"
    yield f"        {part} = {p}_bisect({p}_bounds_{i}, {n}, {value});"
    yield f"        s->since_s[{i}] = t_s;"
    yield "    }"
    yield "}"
    yield ""


def _choose_body(table: TableNumbers) -> Iterable[str]:
    """First sample, then filter and place axis by axis."""
    p, names = table.name, _names(table)
    yield "    RETUNER_REAL dt_s;"
    yield "    if (!s->started) {"
    known = " || ".join(f"!{p}_finite({name})" for name in (*names, "t_s"))
    yield f"        if ({known})"
    yield "            return 0; /* not known yet: the first region, until it is */"
    yield "        s->started = 1;"
    yield "        s->t_s = t_s;"
    for i, (axis, name) in enumerate(zip(table.axes, names, strict=True)):
        yield f"        s->part[{i}] = {p}_bisect({p}_bounds_{i}, {len(axis.bounds)}, {name});"
        yield f"        s->since_s[{i}] = t_s;"
        yield f"        s->y[{i}] = {name};"
    yield "    } else {"
    yield "        dt_s = t_s - s->t_s;"
    if not table.plain:
        yield f"        if (dt_s >= 0 && {p}_finite(dt_s)) {{"
    inner = "        " if table.plain else "            "
    for i, name in enumerate(names):
        yield f"{inner}{p}_move_{i}(s, {name}, t_s, dt_s);"
    if not table.plain:
        yield "            s->t_s = t_s;"
        yield "        }"
    yield "    }"


def _at_hard(table: TableNumbers) -> Iterable[str]:
    p = table.name
    yield "/* The gains of a region. */"
    yield f"static {p}_gains_t {p}_at(int region, {_arguments(table)}) {{"
    yield f"    {p}_gains_t g;"
    yield "".join(f"    (void){name};" for name in _names(table))
    for i, name in enumerate(("kp", "ki", "kd")):
        yield f"    g.{name} = (float){p}_table[region][{i}];"
    yield "    return g;"
    yield "}"
    yield ""


_SHARES = """static int @_shares(const double *c, int n, RETUNER_REAL v, int *at, RETUNER_REAL *w) {
    int above = @_bisect(c, n, v);
    w[0] = 1;
    if (above == 0 || above == n) {
        at[0] = above == 0 ? 0 : n - 1;
        return 1;
    }
    at[0] = above - 1;
    at[1] = above;
    w[1] = (v - (RETUNER_REAL)c[above - 1]) / ((RETUNER_REAL)c[above] - (RETUNER_REAL)c[above - 1]);
    w[0] = 1 - w[1];
    return w[1] == 0 ? 1 : 2;
}
"""


def _at_interpolated(table: TableNumbers) -> Iterable[str]:
    """The mean of the sets whose centres are nearest."""
    p, names = table.name, _names(table)
    yield _SHARES.replace("@", p)
    yield "/* The active gains at these scheduling values. */"
    yield f"static {p}_gains_t {p}_at(int region, {_arguments(table)}) {{"
    yield f"    {p}_gains_t g;"
    yield "    RETUNER_REAL sum[3] = {0, 0, 0}, share;"
    for i, axis in enumerate(table.axes):
        yield f"    int at{i}[2]; RETUNER_REAL w{i}[2];"
        yield f"    int n{i} = {p}_shares({p}_centres_{i}, {len(axis.centres)}, {names[i]}, at{i}, w{i}), i{i};"
    yield "    int k;"
    yield "    (void)region;"
    yield "    for (i0 = 0; i0 < n0; i0++)"
    if len(table.axes) > 1:
        yield "        for (i1 = 0; i1 < n1; i1++)"
        share = "w0[i0] * w1[i1]"
        row = f"at0[i0] * {len(table.axes[1].centres)} + at1[i1]"
    else:
        share, row = "w0[i0]", "at0[i0]"
    yield f"            for (share = {share}, k = 0; share != 0 && k < 3; k++)"
    yield f"                sum[k] += share * (RETUNER_REAL){p}_table[{row}][k];"
    for i, name in enumerate(("kp", "ki", "kd")):
        yield f"    g.{name} = (float)sum[{i}];"
    yield "    return g;"
    yield "}"
    yield ""
