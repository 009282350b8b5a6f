/* A problem, the room to work on it, and everything that is run over the record: lanes, columns. */

#ifndef RETUNER_LANES_H
#define RETUNER_LANES_H

#include "modes.h"

enum { MOST_P = 40, MOST_COLUMNS = 96, MOST_STARTS = 8, MOST_LOADS = 24, MOST_AR = 16, MOST_HARMONICS = 12 };
enum { FOPDT, SOPDT, INTEGRATING, INTEGRATING_LAG, SOPDT_INVERSE, TOPDT, SOPDT_LEAD, TYPES };
static const int SIZE[] = {3, 4, 2, 3, 5, 5, 5}, LAG[] = {2, 2, -1, -1, 2, 2, 2}, SECOND[] = {-1, 3, -1, 2, 3, 3, 3};
static const int INVERSE[] = {-1, -1, -1, -1, 4, -1, 4}, THIRD[] = {-1, -1, -1, -1, -1, 4, -1};
enum { SLOPE, THETA };

static const double LEAST_ZETA = 0.15, SWING_WEIGHT = 30.0; /* structure.py, misfit.py */

/* ---------------------------------------------------------------- problem and workspace */

typedef struct {
    Py_ssize_t n, rows;
    const double *t, *pv, *u;
    double dt, span, sigma, sign;
    int type, loads, harmonics, ramp, rounded, corners, motion, starts, order;
    int size, columns, priors;
    double start[MOST_STARTS], ar[MOST_AR], weight[MOST_COLUMNS];
} Problem;

/* A step that begins at a time: its lanes from the first sample after it. */
typedef struct {
    double at;
    Py_ssize_t first;
    double *a, *b, *c;
} Basis;

typedef struct {
    Problem p;
    double theta, gain, c2, c0, third, rate, tone; /* third : a third lag, 0 for none */
    Modes modes, load_modes;
    Interval *steps, *lag_steps, *load_steps, *reads; /* one each for an even clock, one a sample for an uneven one */
    Py_ssize_t *read_at;
    Basis basis[2 * MOST_STARTS + MOST_LOADS];
    double *a, *b, *a1, *b1, *u_read;                  /* the lanes of co's response, and of its derivative by s */
    double *moved, *column, *rotated, *target, *change; /* column : (columns, n); rotated : (columns, rows) */
    double *scratch;
    double peak[MOST_COLUMNS], beta[MOST_COLUMNS], inside[MOST_COLUMNS], c[MOST_COLUMNS];
    Py_ssize_t peak_at[MOST_COLUMNS];
    double swing, cost;
    double *memory;
} Work;

/* Whether load j is a change of the load's slope: the last ones are. */
static int is_corner(const Problem *p, int j) { return j >= p->loads - p->corners; }

static int start_columns(const Problem *p) { return 1 + (SECOND[p->type] >= 0) + 2 * p->motion; }

static int open_work(Work *w) {
    const Problem *p = &w->p;
    size_t n = (size_t)p->n, rows = (size_t)p->rows, bases = (size_t)(2 * p->starts + p->loads);
    size_t lanes = p->rounded ? 3 : 2, many = p->dt > 0 ? 1 : n, interval = sizeof(Interval) / sizeof(double);
    size_t kinds = 4 * many * interval;
    size_t doubles = kinds + n * lanes * bases + 6 * n + (size_t)p->columns * (n + rows) +
                     rows * (size_t)(1 + p->size) + 2 * n;
    w->memory = malloc(doubles * sizeof(double));
    if (!w->memory)
        return -1;
    double *next = w->memory;
    w->steps = (Interval *)next, w->lag_steps = w->steps + many, w->load_steps = w->lag_steps + many;
    w->reads = w->load_steps + many;
    next += kinds;
    for (size_t j = 0; j < bases; j++, next += lanes * n) {
        w->basis[j].a = next, w->basis[j].b = next + n;
        w->basis[j].c = lanes == 3 && j >= 2 * (size_t)p->starts ? next + 2 * n : next;
    }
    w->a = next, w->b = next + n, w->a1 = next + 2 * n, w->b1 = next + 3 * n, w->u_read = next + 4 * n;
    w->moved = next + 5 * n, next += 6 * n;
    w->column = next, next += (size_t)p->columns * n;
    w->rotated = next, next += (size_t)p->columns * rows;
    w->target = next, next += rows;
    w->change = next, next += rows * (size_t)p->size;
    w->scratch = next, next += n;
    w->read_at = (Py_ssize_t *)next;
    return 0;
}

/* ---------------------------------------------------------------- lanes over the record */

/* First sample at or after a time. */
static Py_ssize_t first_at(const Problem *p, double at) {
    Py_ssize_t low = 0, high = p->n;
    while (low < high) {
        Py_ssize_t middle = (low + high) / 2;
        if (p->t[middle] < at)
            low = middle + 1;
        else
            high = middle;
    }
    return low;
}

static void intervals(const Problem *p, const Modes *m, Interval *out) {
    if (p->dt > 0) {
        out[0] = interval_of(m, p->dt);
        return;
    }
    for (Py_ssize_t i = 0; i + 1 < p->n; i++)
        out[i] = interval_of(m, p->t[i + 1] - p->t[i]);
}

/* The lanes of a unit step at basis->at, zero before it. */
static void run_step(const Problem *p, const Modes *m, const Interval *steps, double *restrict a, double *restrict b,
                     double at, Py_ssize_t first) {
    Py_ssize_t stride = p->dt > 0 ? 0 : 1, i = first;
    memset(a, 0, (size_t)first * sizeof *a), memset(b, 0, (size_t)first * sizeof *b);
    if (first >= p->n)
        return;
    Interval start = interval_of(m, p->t[first] - at);
    double x = start.v[0], y = start.v[1];
    if (stride == 0 && !m->pair) { /* two chains that do not wait for each other, or one */
        double ex = steps->e[0], ey = steps->e[3], vx = steps->v[0], vy = steps->v[1];
        if (m->count == 1)
            memset(b + i, 0, (size_t)(p->n - i) * sizeof *b);
        for (; m->count == 1 && i < p->n; i++) {
            a[i] = x;
            x = ex * x + vx;
        }
        for (; i < p->n; i++) {
            a[i] = x, b[i] = y;
            x = ex * x + vx, y = ey * y + vy;
        }
        return;
    }
    for (; i < p->n; i++) {
        const Interval *s = steps + i * stride;
        a[i] = x, b[i] = y;
        if (i + 1 == p->n)
            break;
        double next = s->e[0] * x + s->e[1] * y + s->v[0];
        y = s->e[2] * x + s->e[3] * y + s->v[1];
        x = next;
    }
}

/* The lanes of the response to the input at the samples of an uneven clock; with the derivative by s if asked. */
static void run_input(const Work *w, double *restrict a, double *restrict b, double *restrict a1, double *restrict b1,
                      int slopes) {
    const double *u = w->p.u;
    double x = 0, y = 0, x1 = 0, y1 = 0;
    for (Py_ssize_t i = 0; i < w->p.n; i++) {
        const Interval *s = w->steps + (i + 1 < w->p.n ? i : 0);
        a[i] = x, b[i] = y;
        if (slopes) {
            a1[i] = x1, b1[i] = y1;
            double next1 = s->e[0] * x1 + s->e[1] * y1 + (s->e1[0] * x + s->e1[1] * y + s->v1[0] * u[i]);
            y1 = s->e[2] * x1 + s->e[3] * y1 + (s->e1[2] * x + s->e1[3] * y + s->v1[1] * u[i]);
            x1 = next1;
        }
        double next = s->e[0] * x + s->e[1] * y + s->v[0] * u[i];
        y = s->e[2] * x + s->e[3] * y + s->v[1] * u[i];
        x = next;
    }
}

/* On an even clock they are read after the dead time as they come: in sample `first` later, an interval after it. */
static inline void run_even(Work *w, Py_ssize_t first, int slopes, int pair) {
    const double *u = w->p.u;
    double x = 0, y = 0, x1 = 0, y1 = 0;
    Interval s = w->steps[0], r = w->reads[0];
    for (Py_ssize_t i = 0, at = first; at < w->p.n; i++, at++) {
        if (slopes) {
            w->a1[at] = r.e[0] * x1 + r.e[1] * y1 + r.e1[0] * x + r.e1[1] * y + r.v1[0] * u[i];
            w->b1[at] = r.e[2] * x1 + r.e[3] * y1 + r.e1[2] * x + r.e1[3] * y + r.v1[1] * u[i];
            double next1 = s.e[0] * x1 + (s.e1[0] * x + s.v1[0] * u[i]);
            if (pair)
                next1 = s.e[0] * x1 + s.e[1] * y1 + (s.e1[0] * x + s.e1[1] * y + s.v1[0] * u[i]);
            y1 = pair ? s.e[2] * x1 + s.e[3] * y1 + (s.e1[2] * x + s.e1[3] * y + s.v1[1] * u[i])
                      : s.e[3] * y1 + (s.e1[3] * y + s.v1[1] * u[i]); /* no lane waits for the other */
            x1 = next1;
        }
        w->a[at] = r.e[0] * x + r.e[1] * y + r.v[0] * u[i];
        w->b[at] = r.e[2] * x + r.e[3] * y + r.v[1] * u[i];
        w->u_read[at] = u[i];
        double next = pair ? s.e[0] * x + s.e[1] * y + s.v[0] * u[i] : s.e[0] * x + s.v[0] * u[i];
        y = pair ? s.e[2] * x + s.e[3] * y + s.v[1] * u[i] : s.e[3] * y + s.v[1] * u[i];
        x = next;
    }
}

/* Where the record is read theta earlier: the sample before, and the interval from it to the reading. */
static Py_ssize_t reading(Work *w) {
    const Problem *p = &w->p;
    if (p->dt > 0) {
        double late = ceil(w->theta / p->dt - 1e-12);
        if (!(late < (double)p->n))
            return p->n;
        w->reads[0] = interval_of(&w->modes, fmax(late * p->dt - w->theta, 0));
        return late > 0 ? (Py_ssize_t)late : 0;
    }
    Py_ssize_t at = -1, first = p->n;
    for (Py_ssize_t i = 0; i < p->n; i++) {
        double when = p->t[i] - w->theta;
        while (at + 1 < p->n && p->t[at + 1] <= when)
            at++;
        w->read_at[i] = at;
        if (at < 0)
            continue;
        first = first < i ? first : i;
        w->reads[i] = interval_of(&w->modes, fmax(when - p->t[at], 0));
    }
    return first;
}

/* The same on an uneven clock. */
static void run_uneven(Work *w, Py_ssize_t first, int slopes) {
    run_input(w, w->a, w->b, w->a1, w->b1, slopes);
    for (Py_ssize_t i = w->p.n - 1; i >= first; i--) { /* backwards: reads lie before what is written */
        const Interval *s = w->reads + i;
        Py_ssize_t at = w->read_at[i];
        double x = w->a[at], y = w->b[at], u = w->p.u[at];
        if (slopes) {
            double x1 = w->a1[at], y1 = w->b1[at];
            w->a1[i] = s->e[0] * x1 + s->e[1] * y1 + s->e1[0] * x + s->e1[1] * y + s->v1[0] * u;
            w->b1[i] = s->e[2] * x1 + s->e[3] * y1 + s->e1[2] * x + s->e1[3] * y + s->v1[1] * u;
        }
        w->a[i] = s->e[0] * x + s->e[1] * y + s->v[0] * u;
        w->b[i] = s->e[2] * x + s->e[3] * y + s->v[1] * u;
        w->u_read[i] = u;
    }
}

/* The lanes of the input's response after the dead time, in w->a, b [, a1, b1], and the input read there. */
static void run_late(Work *w, int slopes) {
    const Problem *p = &w->p;
    Py_ssize_t first = reading(w);
    if (p->dt > 0)
        switch (first < p->n ? 2 * (slopes != 0) + w->modes.pair : -1) {
        case 0: run_even(w, first, 0, 0); break;
        case 1: run_even(w, first, 0, 1); break;
        case 2: run_even(w, first, 1, 0); break;
        case 3: run_even(w, first, 1, 1);
        }
    else
        run_uneven(w, first, slopes);
    for (Py_ssize_t i = 0; i < first && i < p->n; i++) {
        w->a[i] = w->b[i] = w->u_read[i] = 0;
        if (slopes)
            w->a1[i] = w->b1[i] = 0;
    }
}

static void read_parameters(Work *w, const double *p, double least) {
    int type = w->p.type, size = SIZE[type], loads = w->p.loads;
    w->gain = w->p.sign * exp(p[SLOPE]), w->theta = exp(p[THETA]);
    w->c2 = SECOND[type] >= 0 ? exp(p[SECOND[type]]) : 0;
    w->c0 = LAG[type] >= 0 ? exp(-p[LAG[type]]) : 0;
    w->third = THIRD[type] >= 0 ? exp(p[THIRD[type]]) : 0;
    double zero = INVERSE[type] >= 0 ? exp(p[INVERSE[type]]) : 0;
    w->modes = inverse_of(modes_of(w->c2, w->c0, least), type == SOPDT_LEAD ? -zero : zero);
    w->rate = w->p.rounded ? 1 / exp(p[size + loads]) : 0;
    w->load_modes = w->p.rounded ? apart_from(w->modes, w->rate) : w->modes;
    w->tone = w->p.harmonics ? exp(p[w->p.size - 1]) : 0;
    double least_zeta = type == SOPDT_LEAD ? 1 : LEAST_ZETA, most = -log(4 * least_zeta * least_zeta);
    w->swing = LAG[type] >= 0 && SECOND[type] >= 0 ? SWING_WEIGHT * fmax(0, p[SECOND[type]] - p[LAG[type]] - most) : 0;
}

/* Four steps on an even clock, of modes that are not a pair: chains that do not wait for each other. */
static void run_four_steps(const Problem *p, const Modes *m, const Interval *steps, Basis *const *of) {
    double x[4] = {0}, y[4] = {0}, vx[4] = {0}, vy[4] = {0}, ex = steps->e[0], ey = steps->e[3];
    for (Py_ssize_t i = 0, next; i < p->n; i = next) {
        next = p->n;
        for (int j = 0; j < 4; j++)
            if (of[j]->first == i) {
                Interval start = interval_of(m, p->t[i] - of[j]->at);
                x[j] = start.v[0], vx[j] = steps->v[0];
                y[j] = m->count > 1 ? start.v[1] : 0, vy[j] = m->count > 1 ? steps->v[1] : 0;
            } else if (of[j]->first > i && of[j]->first < next)
                next = of[j]->first;
        double *a = of[0]->a, *b = of[0]->b, *c = of[1]->a, *d = of[1]->b;
        double *e = of[2]->a, *f = of[2]->b, *g = of[3]->a, *h = of[3]->b;
        for (Py_ssize_t k = i; k < next; k++) {
            a[k] = x[0], b[k] = y[0], c[k] = x[1], d[k] = y[1], e[k] = x[2], f[k] = y[2], g[k] = x[3], h[k] = y[3];
            for (int j = 0; j < 4; j++)
                x[j] = ex * x[j] + vx[j], y[j] = ey * y[j] + vy[j];
        }
    }
}

/* The lanes of steps, in basis->at. */
static void run_steps(Work *w, const Modes *m, const Interval *steps, Basis *const *of, int count) {
    int j = 0;
    Basis none = {0, w->p.n, w->scratch, w->scratch, NULL}; /* begins nowhere */
    for (int k = 0; k < count; k++)
        of[k]->first = first_at(&w->p, of[k]->at);
    for (; w->p.dt > 0 && !m->pair && j + 2 <= count; j += 4) {
        Basis *four[] = {of[j], of[j + 1], j + 2 < count ? of[j + 2] : &none, j + 3 < count ? of[j + 3] : &none};
        run_four_steps(&w->p, m, steps, four);
    }
    for (; j < count; j++)
        run_step(&w->p, m, steps, of[j]->a, of[j]->b, of[j]->at, of[j]->first);
}

/* All lanes at the parameters p. */
static void run_lanes(Work *w, const double *p, double least, int slopes) {
    const Problem *q = &w->p;
    read_parameters(w, p, least);
    intervals(q, &w->modes, w->steps);
    if (q->rounded) {
        Modes lag = modes_of(0, w->rate, 0);
        intervals(q, &lag, w->lag_steps);
        intervals(q, &w->load_modes, w->load_steps);
    }
    Basis *plain[2 * MOST_STARTS + MOST_LOADS], *rounded[MOST_LOADS] = {NULL};
    int many = 0, few = 0;
    for (int j = 0; j < q->starts; j++)
        w->basis[j].at = q->start[j], plain[many++] = &w->basis[j];
    for (int j = 0; q->motion && j < q->starts; j++)
        w->basis[q->starts + j].at = q->start[j] + w->theta, plain[many++] = &w->basis[q->starts + j];
    for (int j = 0; j < q->loads; j++) {
        Basis *of = &w->basis[2 * q->starts + j];
        of->at = p[SIZE[q->type] + j];
        if (q->rounded && !is_corner(q, j))
            rounded[few++] = of;
        else
            plain[many++] = of, of->c = of->a; /* not used, but read */
    }
    run_steps(w, &w->modes, w->steps, plain, many);
    run_steps(w, &w->load_modes, w->load_steps, rounded, few);
    Modes lag = few ? modes_of(0, w->rate, 0) : w->modes;
    for (int j = 0; j < few; j++) /* the second lane is not used */
        run_step(q, &lag, w->lag_steps, rounded[j]->c, w->scratch, rounded[j]->at, rounded[j]->first);
    run_late(w, slopes);
}

/* ---------------------------------------------------------------- columns */

/* Through the third lag, where there is one; in place (through_lag of dynamics.py). */
static void lagged(const Work *w, double *x) {
    const Problem *p = &w->p;
    double h = p->dt, decay = 0, kept = 0, now = 0, before = x[0];
    if (!(w->third > 0))
        return;
    x[0] = 0;
    for (Py_ssize_t i = 1; i < p->n; i++) {
        if (i == 1 || !(p->dt > 0)) {
            h = p->dt > 0 ? p->dt : p->t[i] - p->t[i - 1];
            decay = exp(-h / w->third), kept = -expm1(-h / w->third) * w->third / h;
        }
        now = decay * now + (kept - decay) * before + (1 - kept) * x[i];
        before = x[i], x[i] = now;
    }
}

WIDE static void add_form(const Work *w, const Basis *basis, Form f, double *restrict out) {
    const double *restrict t = w->p.t, *restrict a = basis->a, *restrict b = basis->b, *restrict c = basis->c;
    double at = basis->at;
    if (f.c == 0 && f.xc == 0 && f.xa == 0 && f.xb == 0 && f.x == 0 && f.xx == 0) {
        for (Py_ssize_t i = basis->first; i < w->p.n; i++)
            out[i] += f.one + f.a * a[i] + f.b * b[i];
        return;
    }
    for (Py_ssize_t i = basis->first; i < w->p.n; i++) {
        double x = t[i] - at;
        out[i] += f.one + f.a * a[i] + f.b * b[i] + f.c * c[i] +
                  x * (f.x + f.xx * x + f.xa * a[i] + f.xb * b[i] + f.xc * c[i]);
    }
}

/* Scaled to a largest value of one. */
static void make_unit(Work *w, int k) {
    double *column = w->column + k * w->p.n;
    lagged(w, column);
    Py_ssize_t at = largest(column, w->p.n);
    double size = fabs(column[at]);
    w->peak_at[k] = at, w->peak[k] = column[at];
    if (size > 0)
        multiply(column, 1 / size, w->p.n);
}

static void put_form(Work *w, int k, const Basis *basis, Form f) {
    double *column = w->column + k * w->p.n;
    memset(column, 0, (size_t)w->p.n * sizeof *column);
    add_form(w, basis, f, column);
}

static void put_tones(Work *w, int k) {
    Py_ssize_t n = w->p.n;
    int even = w->p.dt > 0, harmonics = w->p.harmonics;
    double turn_c = cos(w->tone * w->p.dt), turn_s = sin(w->tone * w->p.dt), c = 1, s = 0;
    for (Py_ssize_t i = 0; i < n; i++) {
        if (!even)
            c = cos(w->tone * w->p.t[i]), s = sin(w->tone * w->p.t[i]);
        double ch = c, sh = s;
        for (int h = 0; h < harmonics; h++) {
            w->column[(k + 2 * h) * n + i] = ch, w->column[(k + 2 * h + 1) * n + i] = sh;
            double next = ch * c - sh * s;
            sh = sh * c + ch * s;
            ch = next;
        }
        double next = c * turn_c - s * turn_s;
        s = s * turn_c + c * turn_s;
        c = next;
    }
}

static void put_columns(Work *w) {
    const Problem *p = &w->p;
    int k = 0;
    Form step = step_form(&w->modes), impulse = impulse_form(&w->modes), ramp = ramp_form(&w->modes);
    Form load = p->rounded ? rounded_form(&w->load_modes, w->rate) : step;
    for (int j = 0; j < p->starts; j++)
        put_form(w, k, &w->basis[j], step), make_unit(w, k++);
    for (int j = 0; SECOND[p->type] >= 0 && j < p->starts; j++)
        put_form(w, k, &w->basis[j], impulse), make_unit(w, k++);
    for (int j = 0; p->motion && j < p->starts; j++) {
        const Basis *late = &w->basis[p->starts + j];
        put_form(w, k, late, step), make_unit(w, k++);
        put_form(w, k, &w->basis[j], ramp);
        add_form(w, late, scaled_form(ramp, -1), w->column + k * p->n), make_unit(w, k++);
    }
    for (Py_ssize_t i = 0; p->ramp && i < p->n; i++) {
        double share = p->t[i] / p->span;
        w->column[k * p->n + i] = LAG[p->type] >= 0 ? share : share * share;
    }
    k += p->ramp;
    for (int j = 0; j < p->loads; j++)
        put_form(w, k, &w->basis[2 * p->starts + j], is_corner(p, j) ? ramp : load), make_unit(w, k++);
    if (p->harmonics)
        put_tones(w, k);
    k += 2 * p->harmonics;
    for (Py_ssize_t i = 0; i < p->n; i++)
        w->column[k * p->n + i] = 1;
}

#endif
