/* The compiled engine of identification: what adaptive/identification does in numpy, in one call.
 *
 * The formulas, the settings and the order of every decision are those of the numpy engine, which stays the reference:
 * dynamics and misfit (variable projection, Golub & Pereyra 1973; Jacobian after Kaufman 1975), refine (Levenberg-
 * Marquardt, Marquardt 1963), the coarse search, the remainder's colour, and the scan of sticking valves. See those
 * files for what is computed and why; here stands how.
 *
 * Two lanes. A process is one real mode, two real modes, or a conjugate pair of complex ones. Its signals are carried
 * as two real lanes (a, b): one lane a mode, or real and imaginary part of the pair's first. Advancing over an interval
 * is a 2 x 2 matrix on the lanes, and every response and every derivative of one is a fixed combination (Form) of
 *
 *     1, x, x^2, a, b, c, x a, x b, x c        x : time since the step; a, b : int_0^x exp(-s y) dy of the modes;
 *                                              c : the same of a load's own lag
 *
 * because the derivative of that integral by s is (x exp(-s x) - integral) / s. So a column costs one recursion and no
 * exponential. Rotations by Householder reflections are not undone: sums of squares and J'J are the same without.
 *
 * No state is kept between calls; the interpreter is released while computing; sums are made in a fixed order, so that
 * the same input gives the same bits.
 */

#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include <float.h>
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define VERSION "1"

/* Where the loader can choose, the loops over samples exist twice, for wider registers, too: the same operations in the
 * same order for every sample, so the same bits. */
#if defined(__x86_64__) && defined(__GLIBC__) && defined(__GNUC__) && !defined(__clang__) && !defined(__SANITIZE_ADDRESS__)
#define WIDE __attribute__((target_clones("avx2", "default")))
#else
#define WIDE
#endif

enum { MOST_P = 40, MOST_COLUMNS = 96, MOST_STARTS = 8, MOST_LOADS = 24, MOST_AR = 16, MOST_HARMONICS = 12 };
enum { FOPDT, SOPDT, INTEGRATING, INTEGRATING_LAG };
static const int SIZE[] = {3, 4, 2, 3}, LAG[] = {2, 2, -1, -1}, SECOND[] = {-1, 3, -1, 2};
enum { SLOPE, THETA };

static const double LEAST_DISCRIMINANT = 1e-8, LEAST_SLOPE_DISCRIMINANT = 1e-5, LEAST_APART = 1e-5, STILL = 1e-200;
static const double LEAST_ZETA = 0.35, SWING_WEIGHT = 30.0, USEFUL = 1e-10, NOTHING_NEW = 1e-12;
static const double DAMPING = 1e-2, LESS = 0.2, MORE = 5.0, MOST_DAMPING = 1e8, LEAST_DAMPING = 1e-9;
static const double SMALLEST_STEP = 1e-9;

/* ---------------------------------------------------------------- complex numbers, vectors */

typedef struct {
    double re, im;
} cplx;

static inline cplx cx(double re, double im) { return (cplx){re, im}; }
static inline cplx plus(cplx x, cplx y) { return cx(x.re + y.re, x.im + y.im); }
static inline cplx minus(cplx x, cplx y) { return cx(x.re - y.re, x.im - y.im); }
static inline cplx times(cplx x, cplx y) { return cx(x.re * y.re - x.im * y.im, x.re * y.im + x.im * y.re); }
static inline cplx scaled(cplx x, double k) { return cx(k * x.re, k * x.im); }
static inline int is_zero(cplx x) { return fabs(x.re) < STILL && fabs(x.im) < STILL; }

static cplx over(cplx x, cplx y) {
    if (y.im == 0)
        return cx(x.re / y.re, x.im / y.re);
    double size = y.re * y.re + y.im * y.im;
    return cx((x.re * y.re + x.im * y.im) / size, (x.im * y.re - x.re * y.im) / size);
}

/* Integral of exp(-s y) from 0 to t. */
static cplx held(cplx s, double t) {
    if (is_zero(s))
        return cx(t, 0);
    double decay = expm1(-s.re * t);
    if (s.im == 0)
        return cx(-decay / s.re, 0);
    double turn = -s.im * t, half = sin(turn / 2);
    cplx e = cx(decay * cos(turn) - 2 * half * half, (decay + 1) * sin(turn));
    return scaled(over(e, s), -1);
}

/* Eight running sums, so that the additions do not wait for each other; their order is fixed. */
WIDE static double dot(const double *restrict x, const double *restrict y, Py_ssize_t n) {
    double s[8] = {0};
    Py_ssize_t i = 0;
    for (; i + 8 <= n; i += 8)
        for (int j = 0; j < 8; j++)
            s[j] += x[i + j] * y[i + j];
    for (; i < n; i++)
        s[0] += x[i] * y[i];
    return ((s[0] + s[4]) + (s[1] + s[5])) + ((s[2] + s[6]) + (s[3] + s[7]));
}

WIDE static void add(double *restrict y, double k, const double *restrict x, Py_ssize_t n) {
    for (Py_ssize_t i = 0; i < n; i++)
        y[i] += k * x[i];
}

WIDE static void multiply(double *restrict y, double k, Py_ssize_t n) {
    for (Py_ssize_t i = 0; i < n; i++)
        y[i] *= k;
}

/* The first of the samples that are largest in size. */
WIDE static Py_ssize_t largest(const double *x, Py_ssize_t n) {
    double lane[8] = {0}, most = 0;
    Py_ssize_t whole = n - n % 8;
    for (Py_ssize_t i = 0; i < whole; i += 8)
        for (int j = 0; j < 8; j++)
            lane[j] = fabs(x[i + j]) > lane[j] ? fabs(x[i + j]) : lane[j];
    for (int j = 0; j < 8; j++)
        most = fmax(most, lane[j]);
    for (Py_ssize_t i = whole; i < n; i++)
        most = fmax(most, fabs(x[i]));
    for (Py_ssize_t i = 0; i < n; i++)
        if (fabs(x[i]) == most)
            return i;
    return 0;
}

/* ---------------------------------------------------------------- modes of the process */

/* s : rates. w : weights. ds, dw : their derivatives by ln T (0) and ln c2 (1). count : of different rates;
 * pair : the one rate stands for itself and its conjugate. */
typedef struct {
    int count, pair;
    cplx s[2], w[2], ds[2][2], dw[2][2];
} Modes;

static Modes modes_of(double c2, double c0, double least) {
    Modes m;
    memset(&m, 0, sizeof m);
    m.count = 1;
    if (c2 == 0) {
        m.s[0] = cx(c0, 0), m.w[0] = cx(1, 0), m.ds[0][0] = cx(-c0, 0);
        return m;
    }
    double d = 1 - 4 * c2 * c0;
    if (fabs(d) < least)
        d = copysign(least, d);
    m.pair = d < 0;
    m.count = m.pair ? 1 : 2;
    cplx root = m.pair ? cx(0, sqrt(-d)) : cx(sqrt(d), 0), one = cx(1, 0);
    cplx s1 = over(cx(2 * c0, 0), plus(one, root)), s2 = scaled(plus(one, root), 1 / (2 * c2));
    cplx weight = over(one, scaled(minus(s2, s1), c2));
    cplx bend = over(cx(2 * c2 * c0, 0), times(root, times(root, root)));
    cplx s[2] = {s1, s2};
    for (int j = 0; j < m.count; j++) {
        double side = j ? -1 : 1;
        m.s[j] = s[j], m.w[j] = scaled(weight, side);
        m.ds[0][j] = over(cx(-side * c0, 0), root);
        m.ds[1][j] = over(scaled(times(s[j], s[j]), side * c2), root);
        m.dw[0][j] = scaled(bend, -side), m.dw[1][j] = scaled(bend, side);
    }
    return m;
}

/* Sum over the modes of k_j times something real; and its weights on the lanes, where it is their signal. */
static double total(const Modes *m, const cplx *k) {
    return m->pair ? 2 * k[0].re : m->count == 2 ? k[0].re + k[1].re : k[0].re;
}

static void on_lanes(const Modes *m, const cplx *k, double *lane) {
    lane[0] = m->pair ? 2 * k[0].re : k[0].re;
    lane[1] = m->pair ? -2 * k[0].im : m->count == 2 ? k[1].re : 0;
}

/* What an interval does to the lanes: x -> e x + v u, and the derivative by s: x' -> e x' + e1 x + v1 u. */
typedef struct {
    double e[4], v[2], e1[4], v1[2];
} Interval;

static void as_matrix(const Modes *m, const cplx *k, double *e) {
    e[0] = k[0].re, e[1] = m->pair ? -k[0].im : 0;
    e[2] = m->pair ? k[0].im : 0, e[3] = m->pair ? k[0].re : m->count == 2 ? k[1].re : 0;
}

static Interval interval_of(const Modes *m, double dt) {
    Interval out;
    cplx e[2] = {{0, 0}}, e1[2] = {{0, 0}}, v[2] = {{0, 0}}, v1[2] = {{0, 0}};
    for (int j = 0; j < m->count; j++) {
        v[j] = held(m->s[j], dt);
        e[j] = minus(cx(1, 0), times(m->s[j], v[j]));
        if (is_zero(m->s[j]))
            continue;
        e1[j] = scaled(e[j], -dt);
        v1[j] = over(minus(scaled(e[j], dt), v[j]), m->s[j]);
    }
    as_matrix(m, e, out.e), as_matrix(m, e1, out.e1);
    out.v[0] = v[0].re, out.v[1] = m->pair ? v[0].im : v[1].re;
    out.v1[0] = v1[0].re, out.v1[1] = m->pair ? v1[0].im : v1[1].re;
    return out;
}

/* ---------------------------------------------------------------- forms: responses as combinations of the lanes */

typedef struct {
    double one, x, xx, a, b, c, xa, xb, xc;
} Form;

static Form scaled_form(Form f, double k) {
    return (Form){k * f.one, k * f.x, k * f.xx, k * f.a, k * f.b, k * f.c, k * f.xa, k * f.xb, k * f.xc};
}

static void put_lanes(const Modes *m, const cplx *k, const cplx *xk, Form *f) {
    double lane[2];
    on_lanes(m, k, lane), f->a = lane[0], f->b = lane[1];
    on_lanes(m, xk, lane), f->xa = lane[0], f->xb = lane[1];
}

static Form step_form(const Modes *m) {
    Form f = {0};
    cplx none[2] = {{0, 0}};
    put_lanes(m, m->w, none, &f);
    return f;
}

static Form impulse_form(const Modes *m) {
    Form f = {0};
    cplx none[2] = {{0, 0}}, k[2] = {{0, 0}};
    for (int j = 0; j < m->count; j++)
        k[j] = scaled(times(m->w[j], m->s[j]), -1);
    put_lanes(m, k, none, &f);
    f.one = total(m, m->w);
    return f;
}

static Form ramp_form(const Modes *m) {
    Form f = {0};
    cplx none[2] = {{0, 0}}, k[2] = {{0, 0}}, x[2] = {{0, 0}};
    for (int j = 0; j < m->count; j++) {
        if (is_zero(m->s[j])) {
            f.xx += m->w[j].re / 2;
            continue;
        }
        x[j] = over(m->w[j], m->s[j]);
        k[j] = scaled(x[j], -1);
    }
    put_lanes(m, k, none, &f);
    f.x = total(m, x);
    return f;
}

/* Derivatives by ln T (q = 0) and ln c2 (q = 1); a rate of zero stays zero. */
static Form step_slope(const Modes *m, int q) {
    Form f = {0};
    cplx k[2] = {{0, 0}}, xk[2] = {{0, 0}}, x[2] = {{0, 0}};
    for (int j = 0; j < m->count; j++) {
        cplx moving = times(m->w[j], m->ds[q][j]);
        k[j] = m->dw[q][j];
        if (is_zero(m->s[j]))
            continue;
        x[j] = over(moving, m->s[j]);
        k[j] = minus(k[j], x[j]);
        xk[j] = scaled(moving, -1);
    }
    put_lanes(m, k, xk, &f);
    f.x = total(m, x);
    return f;
}

static Form impulse_slope(const Modes *m, int q) {
    Form f = {0};
    cplx k[2] = {{0, 0}}, xk[2] = {{0, 0}}, x[2] = {{0, 0}};
    for (int j = 0; j < m->count; j++) {
        x[j] = scaled(times(m->w[j], m->ds[q][j]), -1);
        k[j] = scaled(times(m->dw[q][j], m->s[j]), -1);
        xk[j] = scaled(times(x[j], m->s[j]), -1);
    }
    put_lanes(m, k, xk, &f);
    f.one = total(m, m->dw[q]), f.x = total(m, x);
    return f;
}

static Form ramp_slope(const Modes *m, int q) {
    Form f = {0};
    cplx k[2] = {{0, 0}}, xk[2] = {{0, 0}}, x[2] = {{0, 0}};
    for (int j = 0; j < m->count; j++) {
        if (is_zero(m->s[j])) {
            f.xx += m->dw[q][j].re / 2;
            continue;
        }
        cplx twice = scaled(over(over(times(m->w[j], m->ds[q][j]), m->s[j]), m->s[j]), 2);
        x[j] = minus(over(m->dw[q][j], m->s[j]), twice);
        k[j] = scaled(x[j], -1);
        xk[j] = over(times(m->w[j], m->ds[q][j]), m->s[j]);
    }
    put_lanes(m, k, xk, &f);
    f.x = total(m, x);
    return f;
}

/* The same modes for steps that come through a lag of rate r: none of them at that rate. */
static Modes apart_from(Modes m, double rate) {
    for (int j = 0; j < m.count; j++) {
        cplx apart = minus(cx(rate, 0), m.s[j]);
        if (hypot(apart.re, apart.im) < LEAST_APART * rate)
            m.s[j] = cx(rate - LEAST_APART * rate, 0);
    }
    return m;
}

static Form rounded_form(const Modes *m, double rate) {
    Form f = {0};
    cplx none[2] = {{0, 0}}, k[2] = {{0, 0}};
    for (int j = 0; j < m->count; j++)
        k[j] = over(scaled(m->w[j], rate), minus(cx(rate, 0), m->s[j]));
    put_lanes(m, k, none, &f);
    f.c = -total(m, k);
    return f;
}

/* Derivative by time. */
static Form rounded_rise(const Modes *m, double rate) {
    Form f = {0};
    cplx none[2] = {{0, 0}}, k[2] = {{0, 0}}, share[2] = {{0, 0}};
    for (int j = 0; j < m->count; j++) {
        share[j] = over(scaled(m->w[j], rate), minus(cx(rate, 0), m->s[j]));
        k[j] = scaled(times(share[j], m->s[j]), -1);
    }
    put_lanes(m, k, none, &f);
    f.c = rate * total(m, share);
    return f;
}

static Form rounded_slope(const Modes *m, double rate, int q) {
    Form f = {0};
    cplx k[2] = {{0, 0}}, xk[2] = {{0, 0}}, x[2] = {{0, 0}}, c[2] = {{0, 0}};
    for (int j = 0; j < m->count; j++) {
        cplx apart = minus(cx(rate, 0), m->s[j]);
        cplx moving = over(scaled(times(m->w[j], m->ds[q][j]), rate), apart);
        c[j] = plus(over(scaled(m->dw[q][j], rate), apart), over(moving, apart));
        k[j] = c[j];
        if (is_zero(m->s[j]))
            continue;
        x[j] = over(moving, m->s[j]);
        k[j] = minus(k[j], x[j]);
        xk[j] = scaled(moving, -1);
    }
    put_lanes(m, k, xk, &f);
    f.x = total(m, x), f.c = -total(m, c);
    return f;
}

/* Derivative by the logarithm of the loads' own lag. */
static Form rounded_by_lag(const Modes *m, double rate) {
    Form f = {0};
    cplx none[2] = {{0, 0}}, k[2] = {{0, 0}}, share[2] = {{0, 0}};
    for (int j = 0; j < m->count; j++) {
        cplx apart = minus(cx(rate, 0), m->s[j]);
        share[j] = over(scaled(m->w[j], rate), apart);
        k[j] = over(times(share[j], m->s[j]), apart);
    }
    put_lanes(m, k, none, &f);
    double whole = total(m, share);
    f.x = whole, f.xc = -rate * whole, f.c = -whole - total(m, k);
    return f;
}

/* ---------------------------------------------------------------- problem and workspace */

typedef struct {
    Py_ssize_t n, rows;
    const double *t, *pv, *u;
    double dt, span, sigma, sign;
    int type, loads, harmonics, ramp, rounded, motion, starts, order;
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
    double theta, gain, c2, c0, rate, tone;
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

/* The lanes of the response to the input at the samples; with the derivative by s if asked. */
static void run_input(const Work *w, double *restrict a, double *restrict b, double *restrict a1, double *restrict b1,
                      int slopes) {
    Py_ssize_t n = w->p.n, stride = w->p.dt > 0 ? 0 : 1;
    const double *u = w->p.u;
    double x = 0, y = 0, x1 = 0, y1 = 0;
    if (stride == 0 && !w->modes.pair) { /* no lane waits for the other */
        Interval s = w->steps[0];
        for (Py_ssize_t i = 0; i < n; i++) {
            a[i] = x, b[i] = y;
            if (slopes) {
                a1[i] = x1, b1[i] = y1;
                x1 = s.e[0] * x1 + (s.e1[0] * x + s.v1[0] * u[i]);
                y1 = s.e[3] * y1 + (s.e1[3] * y + s.v1[1] * u[i]);
            }
            x = s.e[0] * x + s.v[0] * u[i];
            y = s.e[3] * y + s.v[1] * u[i];
        }
        return;
    }
    for (Py_ssize_t i = 0; i < n; i++) {
        const Interval *s = w->steps + (i + 1 < n ? i * stride : 0);
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

/* The lanes of the input's response after the dead time, in w->a, b [, a1, b1], and the input read there. */
static void run_late(Work *w, int slopes) {
    const Problem *p = &w->p;
    Py_ssize_t first = reading(w), even = p->dt > 0;
    run_input(w, w->a, w->b, w->a1, w->b1, slopes);
    for (Py_ssize_t i = p->n - 1; i >= first; i--) { /* backwards: reads lie before what is written */
        const Interval *s = even ? w->reads : w->reads + i;
        Py_ssize_t at = even ? i - first : w->read_at[i];
        double x = w->a[at], y = w->b[at], u = p->u[at];
        if (slopes) {
            double x1 = w->a1[at], y1 = w->b1[at];
            w->a1[i] = s->e[0] * x1 + s->e[1] * y1 + s->e1[0] * x + s->e1[1] * y + s->v1[0] * u;
            w->b1[i] = s->e[2] * x1 + s->e[3] * y1 + s->e1[2] * x + s->e1[3] * y + s->v1[1] * u;
        }
        w->a[i] = s->e[0] * x + s->e[1] * y + s->v[0] * u;
        w->b[i] = s->e[2] * x + s->e[3] * y + s->v[1] * u;
        w->u_read[i] = u;
    }
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
    w->modes = modes_of(w->c2, w->c0, least);
    w->rate = w->p.rounded ? 1 / exp(p[size + loads]) : 0;
    w->load_modes = w->p.rounded ? apart_from(w->modes, w->rate) : w->modes;
    w->tone = w->p.harmonics ? exp(p[w->p.size - 1]) : 0;
    double most = -log(4 * LEAST_ZETA * LEAST_ZETA);
    w->swing = type == SOPDT ? SWING_WEIGHT * fmax(0, p[SECOND[type]] - p[LAG[type]] - most) : 0;
}

static void put_basis(Work *w, int j, double at, const Modes *m, const Interval *steps, int rounded) {
    Basis *basis = &w->basis[j];
    basis->at = at, basis->first = first_at(&w->p, at);
    run_step(&w->p, m, steps, basis->a, basis->b, at, basis->first);
    if (rounded) {
        Modes lag = modes_of(0, w->rate, 0);
        run_step(&w->p, &lag, w->lag_steps, basis->c, w->scratch, at, basis->first); /* the second lane is not used */
    }
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
    for (int j = 0; j < q->starts; j++)
        put_basis(w, j, q->start[j], &w->modes, w->steps, 0);
    for (int j = 0; q->motion && j < q->starts; j++)
        put_basis(w, q->starts + j, q->start[j] + w->theta, &w->modes, w->steps, 0);
    for (int j = 0; j < q->loads; j++)
        put_basis(w, 2 * q->starts + j, p[SIZE[q->type] + j], &w->load_modes, q->rounded ? w->load_steps : w->steps,
                  q->rounded);
    run_late(w, slopes);
}

/* ---------------------------------------------------------------- columns */

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
    for (Py_ssize_t i = 0; p->ramp && i < p->n; i++)
        w->column[k * p->n + i] = p->t[i] / p->span;
    k += p->ramp;
    for (int j = 0; j < p->loads; j++)
        put_form(w, k, &w->basis[2 * p->starts + j], load), make_unit(w, k++);
    if (p->harmonics)
        put_tones(w, k);
    k += 2 * p->harmonics;
    for (Py_ssize_t i = 0; i < p->n; i++)
        w->column[k * p->n + i] = 1;
}

/* ---------------------------------------------------------------- projection */

/* Through the whitening filter 1 + a_1 z^-1 + ... */
static void whiten(const Problem *p, const double *restrict x, double *restrict out) {
    memcpy(out, x, (size_t)p->n * sizeof *out);
    for (int lag = 1; lag <= p->order && lag < p->n; lag++)
        add(out + lag, p->ar[lag - 1], x, p->n - lag);
}

/* Reflection j of the decomposition, on a vector. */
static inline void reflect(const double *rotated, Py_ssize_t rows, int j, double beta, double *y) {
    const double *v = rotated + j * rows;
    double d = beta * (y[j] + dot(v + j + 1, y + j + 1, rows - j - 1));
    y[j] -= d;
    add(y + j + 1, -d, v + j + 1, rows - j - 1);
}

/* Householder's decomposition of the columns in place: the triangle above, the reflections below the diagonal. */
static void decompose(double *a, Py_ssize_t rows, int columns, double *beta) {
    for (int j = 0; j < columns; j++) {
        double *v = a + j * rows, alpha = v[j];
        double size = sqrt(dot(v + j + 1, v + j + 1, rows - j - 1));
        beta[j] = 0;
        if (size > 0) {
            double diagonal = -copysign(hypot(alpha, size), alpha);
            beta[j] = (diagonal - alpha) / diagonal;
            multiply(v + j + 1, 1 / (alpha - diagonal), rows - j - 1);
            v[j] = diagonal;
        }
        for (int k = j + 1; beta[j] != 0 && k < columns; k++)
            reflect(a, rows, j, beta[j], a + k * rows);
    }
}

static void rotate(const double *a, Py_ssize_t rows, int columns, const double *beta, double *y) {
    for (int j = 0; j < columns; j++)
        if (beta[j] != 0)
            reflect(a, rows, j, beta[j], y);
}

/* One-sided Jacobi (Hestenes 1958): the shortest solution of a triangle whose columns are not independent. */
static void shortest(const double *triangle, Py_ssize_t rows, int n, const double *right, double *c) {
    static const int SWEEPS = 30;
    double u[MOST_COLUMNS][MOST_COLUMNS], v[MOST_COLUMNS][MOST_COLUMNS], most = 0;
    for (int j = 0; j < n; j++)
        for (int i = 0; i < n; i++)
            u[j][i] = i <= j ? triangle[j * rows + i] : 0, v[j][i] = i == j;
    for (int sweep = 0, turned = 1; sweep < SWEEPS && turned; sweep++) {
        turned = 0;
        for (int j = 0; j < n; j++)
            for (int k = j + 1; k < n; k++) {
                double x = dot(u[j], u[j], n), y = dot(u[k], u[k], n), z = dot(u[j], u[k], n);
                if (!(fabs(z) > 1e-15 * sqrt(x * y)))
                    continue;
                double cot = (y - x) / (2 * z), tangent = copysign(1 / (fabs(cot) + hypot(1, cot)), cot);
                double cosine = 1 / hypot(1, tangent), sine = cosine * tangent;
                turned = 1;
                for (int i = 0; i < n; i++) {
                    double p = u[j][i], q = v[j][i];
                    u[j][i] = cosine * p - sine * u[k][i], u[k][i] = sine * p + cosine * u[k][i];
                    v[j][i] = cosine * q - sine * v[k][i], v[k][i] = sine * q + cosine * v[k][i];
                }
            }
    }
    for (int j = 0; j < n; j++)
        most = fmax(most, dot(u[j], u[j], n));
    memset(c, 0, (size_t)n * sizeof *c);
    for (int j = 0; j < n; j++) {
        double size = dot(u[j], u[j], n);
        if (size > USEFUL * USEFUL * most)
            add(c, dot(u[j], right, n) / size, v[j], n);
    }
}

/* Coefficients from the triangle; columns that say nothing get none. */
static void back(const double *triangle, Py_ssize_t rows, int n, const double *right, double *c) {
    double least = INFINITY, most = 0;
    for (int j = 0; j < n; j++) {
        double size = fabs(triangle[j * rows + j]);
        least = fmin(least, size), most = fmax(most, size);
    }
    if (!(least > USEFUL * most)) {
        shortest(triangle, rows, n, right, c);
        return;
    }
    memcpy(c, right, (size_t)n * sizeof *c);
    for (int j = n - 1; j >= 0; j--) {
        c[j] /= triangle[j * rows + j];
        add(c, -c[j], triangle + j * rows, j);
    }
}

/* The linear unknowns solved for at p; what remains stands rotated in w->target from row `columns` on. */
static void solve(Work *w, const double *p) {
    const Problem *q = &w->p;
    double lane[2];
    run_lanes(w, p, LEAST_DISCRIMINANT, 0);
    on_lanes(&w->modes, w->modes.w, lane);
    for (Py_ssize_t i = 0; i < q->n; i++)
        w->moved[i] = w->gain * (lane[0] * w->a[i] + lane[1] * w->b[i]);
    put_columns(w);
    for (int k = 0; k < q->columns; k++) {
        double *column = w->rotated + k * q->rows;
        whiten(q, w->column + k * q->n, column);
        memset(column + q->n, 0, (size_t)q->priors * sizeof *column);
        if (k < q->priors)
            column[q->n + k] = q->weight[k];
    }
    for (Py_ssize_t i = 0; i < q->n; i++)
        w->scratch[i] = q->pv[i] - w->moved[i];
    whiten(q, w->scratch, w->target);
    memset(w->target + q->n, 0, (size_t)q->priors * sizeof *w->target);
    decompose(w->rotated, q->rows, q->columns, w->beta);
    rotate(w->rotated, q->rows, q->columns, w->beta, w->target);
    memcpy(w->inside, w->target, (size_t)q->columns * sizeof *w->inside);
    double left = dot(w->target + q->columns, w->target + q->columns, q->rows - q->columns);
    w->cost = left / (q->sigma * q->sigma) + w->swing * w->swing;
}

/* ---------------------------------------------------------------- Jacobian */

static double form_at(const Work *w, const Basis *basis, Form f, Py_ssize_t i) {
    if (i < basis->first)
        return 0;
    double x = w->p.t[i] - basis->at, a = basis->a[i], b = basis->b[i], c = basis->c[i];
    return f.one + f.a * a + f.b * b + f.c * c + x * (f.x + f.xx * x + f.xa * a + f.xb * b + f.xc * c);
}

/* A coefficient times the derivative of its unit column; the column itself has the derivative f from one basis, and g
 * from another, where there is one. */
static void add_change(const Work *w, int k, const Basis *basis, Form f, const Basis *other, Form g, double *change) {
    double peak = w->peak[k], share = w->c[k] / fabs(peak);
    if (peak == 0 || w->c[k] == 0)
        return;
    double rise = form_at(w, basis, f, w->peak_at[k]);
    add_form(w, basis, scaled_form(f, share), change);
    if (other) {
        rise += form_at(w, other, g, w->peak_at[k]);
        add_form(w, other, scaled_form(g, share), change);
    }
    add(change, -w->c[k] * (rise / peak), w->column + k * w->p.n, w->p.n);
}

static const Form NO_FORM = {0};

/* By ln T (q = 0) or ln c2 (q = 1). */
static void change_by_dynamics(Work *w, int q, double *change) {
    const Problem *p = &w->p;
    const Modes *m = &w->modes;
    double at[2], by[2];
    cplx moving[2] = {{0, 0}};
    for (int j = 0; j < m->count; j++)
        moving[j] = times(m->w[j], m->ds[q][j]);
    on_lanes(m, m->dw[q], at), on_lanes(m, moving, by);
    for (Py_ssize_t i = 0; i < p->n; i++)
        change[i] = w->gain * (at[0] * w->a[i] + at[1] * w->b[i] + by[0] * w->a1[i] + by[1] * w->b1[i]);
    Form step = step_slope(m, q), ramp = ramp_slope(m, q);
    Form load = p->rounded ? rounded_slope(&w->load_modes, w->rate, q) : step;
    int k = 0;
    for (int j = 0; j < p->starts; j++)
        add_change(w, k++, &w->basis[j], step, NULL, NO_FORM, change);
    for (int j = 0; SECOND[p->type] >= 0 && j < p->starts; j++)
        add_change(w, k++, &w->basis[j], impulse_slope(m, q), NULL, NO_FORM, change);
    for (int j = 0; p->motion && j < p->starts; j++) {
        const Basis *late = &w->basis[p->starts + j];
        add_change(w, k++, late, step, NULL, NO_FORM, change);
        add_change(w, k++, &w->basis[j], ramp, late, scaled_form(ramp, -1), change);
    }
    k += p->ramp;
    for (int j = 0; j < p->loads; j++)
        add_change(w, k++, &w->basis[2 * p->starts + j], load, NULL, NO_FORM, change);
}

static void change_by_theta(Work *w, double *change) {
    const Problem *p = &w->p;
    const Modes *m = &w->modes;
    double lane[2];
    cplx rate[2] = {{0, 0}};
    for (int j = 0; j < m->count; j++)
        rate[j] = times(m->w[j], m->s[j]);
    on_lanes(m, rate, lane);
    double whole = total(m, m->w), gain = w->gain * w->theta;
    for (Py_ssize_t i = 0; i < p->n; i++)
        change[i] = gain * (lane[0] * w->a[i] + lane[1] * w->b[i] - whole * w->u_read[i]);
    Form rise = scaled_form(impulse_form(m), -w->theta), step = scaled_form(step_form(m), w->theta);
    int k = p->starts * (1 + (SECOND[p->type] >= 0));
    for (int j = 0; p->motion && j < p->starts; j++) {
        const Basis *late = &w->basis[p->starts + j];
        add_change(w, k++, late, rise, NULL, NO_FORM, change);
        add_change(w, k++, late, step, NULL, NO_FORM, change);
    }
}

static int first_load(const Problem *p) { return p->priors; }

static void change_by_load_time(Work *w, int j, double *change) {
    Form rise = w->p.rounded ? rounded_rise(&w->load_modes, w->rate) : impulse_form(&w->modes);
    memset(change, 0, (size_t)w->p.n * sizeof *change);
    add_change(w, first_load(&w->p) + j, &w->basis[2 * w->p.starts + j], scaled_form(rise, -1), NULL, NO_FORM, change);
}

static void change_by_load_lag(Work *w, double *change) {
    Form slope = rounded_by_lag(&w->load_modes, w->rate);
    memset(change, 0, (size_t)w->p.n * sizeof *change);
    for (int j = 0; j < w->p.loads; j++)
        add_change(w, first_load(&w->p) + j, &w->basis[2 * w->p.starts + j], slope, NULL, NO_FORM, change);
}

static void change_by_tone(Work *w, double *change) {
    const Problem *p = &w->p;
    int k = first_load(p) + p->loads;
    memset(change, 0, (size_t)p->n * sizeof *change);
    for (int h = 0; h < p->harmonics; h++, k += 2) {
        const double *c = w->column + k * p->n, *s = c + p->n;
        double turn = (h + 1) * w->tone;
        for (Py_ssize_t i = 0; i < p->n; i++)
            change[i] += turn * p->t[i] * (w->c[k + 1] * c[i] - w->c[k] * s[i]);
    }
}

static void put_change(Work *w, int j, double *change) {
    const Problem *p = &w->p;
    int d = SIZE[p->type];
    if (j == SLOPE)
        memcpy(change, w->moved, (size_t)p->n * sizeof *change);
    else if (j == THETA)
        change_by_theta(w, change);
    else if (j < d)
        change_by_dynamics(w, j == SECOND[p->type], change);
    else if (j < d + p->loads)
        change_by_load_time(w, j - d, change);
    else if (j < d + p->loads + p->rounded)
        change_by_load_lag(w, change);
    else
        change_by_tone(w, change);
}

/* Minus sigma times the Jacobian at the p that was solved last, rotated, in w->change (size, rows); its first `columns`
 * rows do not count. Close to equal lags the derivative is that of lags a little further apart. */
static void put_changes(Work *w, const double *p) {
    const Problem *q = &w->p;
    double d = 1 - 4 * w->c2 * w->c0;
    back(w->rotated, q->rows, q->columns, w->inside, w->c);
    if (fabs(d) < LEAST_SLOPE_DISCRIMINANT)
        run_lanes(w, p, LEAST_SLOPE_DISCRIMINANT, 1);
    else
        run_late(w, 1);
    for (int j = 0; j < q->size; j++) {
        double *change = w->change + j * q->rows;
        put_change(w, j, change);
        if (q->order) {
            memcpy(w->scratch, change, (size_t)q->n * sizeof *change);
            whiten(q, w->scratch, change);
        }
        memset(change + q->n, 0, (size_t)q->priors * sizeof *change);
        rotate(w->rotated, q->rows, q->columns, w->beta, change);
    }
}

/* Derivative of the last residual, the wall of the least damping, by p[j]. */
static double wall(const Work *w, int j) {
    int type = w->p.type;
    return !(w->swing > 0) ? 0 : j == SECOND[type] ? SWING_WEIGHT : j == LAG[type] ? -SWING_WEIGHT : 0;
}

/* ---------------------------------------------------------------- Levenberg-Marquardt */

typedef struct {
    const double *root, *target, *low, *high, *stride;
    int known, evaluations;
    double enough;
} Search;

static double prior_residual(const Search *s, int d, int i, const double *p) {
    return dot(s->root + i * d, p, d) - s->target[i];
}

static double cost_with_prior(const Work *w, const Search *s, const double *p) {
    double cost = w->cost;
    for (int i = 0; i < s->known; i++) {
        double r = prior_residual(s, SIZE[w->p.type], i, p);
        cost += r * r;
    }
    return cost;
}

static void normal_equations(Work *w, const Search *s, const double *p, double normal[][MOST_P], double *gradient) {
    const Problem *q = &w->p;
    int size = q->size, d = SIZE[q->type];
    Py_ssize_t rest = q->rows - q->columns;
    double scale = 1 / (q->sigma * q->sigma);
    put_changes(w, p);
    for (int j = 0; j < size; j++) {
        const double *x = w->change + j * q->rows + q->columns;
        gradient[j] = -scale * dot(x, w->target + q->columns, rest) + wall(w, j) * w->swing;
        for (int k = 0; k <= j; k++) {
            const double *y = w->change + k * q->rows + q->columns;
            normal[j][k] = normal[k][j] = scale * dot(x, y, rest) + wall(w, j) * wall(w, k);
        }
    }
    for (int i = 0; i < s->known; i++) {
        double r = prior_residual(s, d, i, p);
        for (int j = 0; j < d; j++) {
            gradient[j] += s->root[i * d + j] * r;
            for (int k = 0; k < d; k++)
                normal[j][k] += s->root[i * d + j] * s->root[i * d + k];
        }
    }
}

/* Gauss with row exchange; 0 where the matrix is singular. */
static int solve_square(double a[][MOST_P], double *x, int n) {
    for (int j = 0; j < n; j++) {
        int best = j;
        for (int i = j + 1; i < n; i++)
            best = fabs(a[i][j]) > fabs(a[best][j]) ? i : best;
        if (!(fabs(a[best][j]) > 0))
            return 0;
        for (int k = 0; best != j && k < n; k++) {
            double kept = a[j][k];
            a[j][k] = a[best][k], a[best][k] = kept;
        }
        double kept = x[j];
        x[j] = x[best], x[best] = kept;
        for (int i = j + 1; i < n; i++) {
            double factor = a[i][j] / a[j][j];
            for (int k = j + 1; k < n; k++)
                a[i][k] -= factor * a[j][k];
            x[i] -= factor * x[j];
        }
    }
    for (int j = n - 1; j >= 0; j--) {
        for (int k = j + 1; k < n; k++)
            x[j] -= a[j][k] * x[k];
        x[j] /= a[j][j];
    }
    return 1;
}

/* The damped step of the parameters that are free to move; its largest share of a stride. */
static double damped_step(const Search *s, const double *p, double normal[][MOST_P], const double *gradient,
                          double damping, int size, double *step) {
    double a[MOST_P][MOST_P], x[MOST_P], most = 0, share = 0;
    int place[MOST_P], n = 0;
    for (int j = 0; j < size; j++) {
        step[j] = 0;
        if (!((p[j] <= s->low[j] && gradient[j] > 0) || (p[j] >= s->high[j] && gradient[j] < 0)))
            place[n++] = j;
    }
    for (int j = 0; j < n; j++)
        most = fmax(most, normal[place[j]][place[j]]);
    for (int j = 0; j < n; j++) {
        for (int k = 0; k < n; k++)
            a[j][k] = normal[place[j]][place[k]];
        a[j][j] += damping * fmax(a[j][j], 1e-12 * fmax(most, 1e-300));
        x[j] = -gradient[place[j]];
    }
    if (!solve_square(a, x, n))
        return 0;
    for (int j = 0; j < n; j++) {
        step[place[j]] = x[j];
        share = fmax(share, fabs(x[j]) / s->stride[place[j]]);
    }
    return share;
}

static double clipped(double x, double low, double high) { return fmin(fmax(x, low), high); }

/* Minimise from p, in place; returns the deviance. On return w holds the solution at p. */
static double refine(Work *w, const Search *s, double *p) {
    double normal[MOST_P][MOST_P], gradient[MOST_P], step[MOST_P], ahead[MOST_P], damping = DAMPING;
    int size = w->p.size, ends = 0, at_p = 1;
    for (int j = 0; j < size; j++)
        p[j] = clipped(p[j], s->low[j], s->high[j]);
    solve(w, p);
    double cost = cost_with_prior(w, s, p);
    normal_equations(w, s, p, normal, gradient);
    for (int i = 0; i < s->evaluations; i++) {
        double share = damped_step(s, p, normal, gradient, damping, size, step);
        double factor = fmin(1, 1 / fmax(share, 1e-300));
        for (int j = 0; j < size; j++)
            ahead[j] = clipped(p[j] + factor * step[j], s->low[j], s->high[j]);
        solve(w, ahead);
        double cost_ahead = cost_with_prior(w, s, ahead);
        at_p = cost_ahead < cost;
        if (!at_p) {
            damping *= MORE;
            if (damping > MOST_DAMPING || factor * share < SMALLEST_STEP)
                break;
            continue;
        }
        ends = cost - cost_ahead < s->enough * cost ? ends + 1 : 0;
        memcpy(p, ahead, (size_t)size * sizeof *p);
        cost = cost_ahead, damping = fmax(damping * LESS, LEAST_DAMPING);
        if (ends > 1)
            break;
        normal_equations(w, s, p, normal, gradient);
    }
    if (!at_p)
        solve(w, p);
    return cost;
}

/* ---------------------------------------------------------------- what a fit shows of itself */

static void put_explained(Work *w, double *out) {
    const Problem *p = &w->p;
    back(w->rotated, p->rows, p->columns, w->inside, w->c);
    memcpy(out, w->moved, (size_t)p->n * sizeof *out);
    for (int k = 0; k < p->columns; k++)
        add(out, w->c[k], w->column + k * p->n, p->n);
}

/* Undo a rotation. */
static void rotate_back(const double *a, Py_ssize_t rows, int columns, const double *beta, double *y) {
    for (int j = columns - 1; j >= 0; j--)
        if (beta[j] != 0)
            reflect(a, rows, j, beta[j], y);
}

/* The orthonormal basis that a decomposition stands for, shape (columns, rows). */
static void put_basis_vectors(const double *a, Py_ssize_t rows, int columns, const double *beta, double *q) {
    memset(q, 0, (size_t)(columns * rows) * sizeof *q);
    for (int k = 0; k < columns; k++) {
        q[k * rows + k] = 1;
        rotate_back(a, rows, columns, beta, q + k * rows);
    }
}

/* r : (rows + 1), the wall last. */
static void put_residuals(Work *w, double *r) {
    Py_ssize_t rows = w->p.rows;
    memcpy(r, w->target, (size_t)rows * sizeof *r);
    memset(r, 0, (size_t)w->p.columns * sizeof *r);
    rotate_back(w->rotated, rows, w->p.columns, w->beta, r);
    for (Py_ssize_t i = 0; i < rows; i++)
        r[i] /= w->p.sigma;
    r[rows] = w->swing;
}

/* out : (size, rows + 1). */
static void put_jacobian(Work *w, const double *p, double *out) {
    Py_ssize_t rows = w->p.rows;
    put_changes(w, p);
    for (int j = 0; j < w->p.size; j++) {
        double *row = out + j * (rows + 1);
        memcpy(row, w->change + j * rows, (size_t)rows * sizeof *row);
        memset(row, 0, (size_t)w->p.columns * sizeof *row);
        rotate_back(w->rotated, rows, w->p.columns, w->beta, row);
        for (Py_ssize_t i = 0; i < rows; i++)
            row[i] /= -w->p.sigma;
        row[rows] = wall(w, j);
    }
}

/* By how much a further load step at each instant would lower n ln sigma^2, everything nonlinear held.
 * q : (columns, rows), r : (rows + 1), of the solution at p. */
static void load_gains(Work *w, const double *q, const double *r, const double *at, Py_ssize_t many, double *out) {
    static const double UNIQUE = 1e-9;
    const Problem *p = &w->p;
    Py_ssize_t n = p->n;
    double *lane = w->change, *whitened = w->scratch, all = dot(r, r, n);
    Form step = step_form(&w->modes);
    for (Py_ssize_t k = 0; k < many; k++) {
        Basis basis = {at[k], first_at(p, at[k]), lane, w->target, lane};
        memset(w->moved, 0, (size_t)n * sizeof *w->moved);
        run_step(p, &w->modes, w->steps, basis.a, basis.b, at[k], basis.first);
        add_form(w, &basis, step, w->moved);
        double most = fmax(fabs(w->moved[largest(w->moved, n)]), DBL_MIN);
        multiply(w->moved, 1 / most, n);
        whiten(p, w->moved, whitened);
        memcpy(lane, whitened, (size_t)n * sizeof *lane);
        for (int j = 0; j < p->columns; j++)
            add(lane, -dot(q + j * p->rows, whitened, n), q + j * p->rows, n);
        double size = dot(lane, lane, n), along = dot(r, lane, n);
        double taken = size > UNIQUE * (double)n ? along * along / size : 0;
        out[k] = -(double)n * log(fmax(1 - taken / all, DBL_MIN));
    }
}

/* ---------------------------------------------------------------- the colour of a remainder */

/* Yule-Walker equations by Levinson's recursion; the order by Schwarz's criterion. Returns the order. */
static int colour_of(const double *r, Py_ssize_t n, double least, int most_order, double *ar, double *std) {
    static const int LEAST_SAMPLES = 12;
    double covariance[MOST_AR + 1], a[MOST_AR] = {0}, kept[MOST_AR];
    double white = fmax(sqrt(dot(r, r, n) / (double)n), least), lowest = (double)n * log(white * white);
    int best = 0;
    *std = white;
    if (n < LEAST_SAMPLES || white <= least)
        return 0;
    for (int k = 0; k <= most_order; k++)
        covariance[k] = dot(r, r + k, n - k) / (double)n;
    double innovation = covariance[0];
    for (int order = 1; order <= most_order && innovation > 0; order++) {
        double along = covariance[order];
        for (int k = 0; k < order - 1; k++)
            along += a[k] * covariance[order - 1 - k];
        double partial = -along / innovation, variance = covariance[0];
        memcpy(kept, a, sizeof kept);
        for (int k = 0; k < order - 1; k++)
            a[k] = kept[k] + partial * kept[order - 2 - k];
        a[order - 1] = partial;
        innovation *= 1 - partial * partial;
        for (int k = 0; k < order; k++)
            variance += a[k] * covariance[k + 1];
        variance = fmax(variance, least * least);
        double criterion = (double)n * log(variance) + order * log((double)n);
        if (criterion < lowest) {
            lowest = criterion, best = order, *std = sqrt(variance);
            memcpy(ar, a, (size_t)order * sizeof *ar);
        }
    }
    return best;
}

/* ---------------------------------------------------------------- the coarse search */

typedef struct {
    const double *lags, *thetas, *at;
    Py_ssize_t lag_count, theta_count, at_count;
    int most;
    double sigma;
    double *deviance, *slope, *chosen;
} Grid;

/* Orthonormal vectors so far, what they leave of pv, and the products of both with the steps. */
typedef struct {
    Py_ssize_t n, many;
    const double *steps;
    double *q[3 + MOST_LOADS], *left, *size, *along, *inside;
    int count;
} Span;

/* One vector more, orthogonalised twice; returns its length before it was made one, 0 where it says nothing new. */
static double span_with(Span *s, const double *x, double *parts) {
    double *q = s->q[s->count], whole = sqrt(dot(x, x, s->n));
    memcpy(q, x, (size_t)s->n * sizeof *q);
    for (int k = 0; k < s->count; k++)
        parts[k] = 0;
    for (int twice = 0; twice < 2; twice++)
        for (int k = 0; k < s->count; k++) {
            double part = dot(s->q[k], q, s->n);
            parts[k] += part;
            add(q, -part, s->q[k], s->n);
        }
    double size = sqrt(dot(q, q, s->n));
    if (!(size > 1e-12 * whole))
        return 0;
    for (Py_ssize_t i = 0; i < s->n; i++)
        q[i] /= size;
    double part = dot(q, s->left, s->n);
    s->inside[s->count] = part;
    add(s->left, -part, q, s->n);
    for (Py_ssize_t j = 0; j < s->many; j++) {
        double shared = dot(q, s->steps + j * s->n, s->n);
        s->size[j] -= shared * shared, s->along[j] -= part * shared;
    }
    s->count++;
    return size;
}

/* One node: misfit, slope gain and chosen load steps, with 0, 1, ... of them. */
static void search_node(const Grid *g, Span *s, const double *x, Py_ssize_t node) {
    static const double LOAD_GAIN = 10, UNIQUE = 1e-9;
    double triangle[1 + MOST_LOADS][3 + MOST_LOADS];
    double first = span_with(s, x, triangle[0]), own = first > 0 ? s->inside[s->count - 1] : 0;
    int place = s->count - 1;
    for (int loads = 0;; loads++) {
        Py_ssize_t out = node * (g->most + 1) + loads, best = 0;
        double c[1 + MOST_LOADS], taken = 0; /* back substitution from the last load to x */
        for (int k = loads; k >= 1 && first > 0; k--) {
            c[k] = s->inside[place + k];
            for (int l = k + 1; l <= loads; l++)
                c[k] -= triangle[l][place + k] * c[l];
            c[k] /= triangle[k][place + k];
        }
        double slope = own;
        for (int k = 1; k <= loads && first > 0; k++)
            slope -= triangle[k][place] * c[k];
        g->deviance[out] = dot(s->left, s->left, s->n), g->slope[out] = first > 0 ? slope / first : 0;
        if (loads == g->most)
            return;
        for (Py_ssize_t j = 0; j < s->many; j++) {
            double gain = s->size[j] > UNIQUE * (double)s->n ? s->along[j] * s->along[j] / s->size[j] : 0;
            if (gain > taken)
                taken = gain, best = j;
        }
        if (!(taken >= LOAD_GAIN * g->sigma * g->sigma))
            return;
        double size = span_with(s, s->steps + best * s->n, triangle[loads + 1]);
        if (!(size > 0))
            return;
        triangle[loads + 1][s->count - 1] = size;
        g->chosen[node * g->most + loads] = (double)best;
    }
}

/* The steps of a node's lag, each about one in size, and what the bias and the start leave of them and of pv. */
static void search_lag(Work *w, const Grid *g, double *steps, Span *s) {
    Py_ssize_t n = w->p.n;
    double parts[3], *column = w->moved;
    Form step = step_form(&w->modes);
    s->count = 0;
    memcpy(s->left, w->p.pv, (size_t)n * sizeof *s->left);
    for (Py_ssize_t j = 0; j < g->at_count; j++) {
        Basis basis = {g->at[j], first_at(&w->p, g->at[j]), w->a, w->b, w->a};
        double *out = steps + j * n;
        run_step(&w->p, &w->modes, w->steps, basis.a, basis.b, basis.at, basis.first);
        memset(out, 0, (size_t)n * sizeof *out);
        add_form(w, &basis, step, out);
        double most = fmax(fabs(out[largest(out, n)]), 1e-300);
        for (Py_ssize_t i = 0; i < n; i++)
            out[i] /= most;
        s->size[j] = dot(out, out, n), s->along[j] = dot(out, s->left, n);
    }
    for (Py_ssize_t i = 0; i < n; i++)
        column[i] = 1;
    span_with(s, column, parts);
    Basis start = {w->p.t[0], 0, w->a, w->b, w->a};
    run_step(&w->p, &w->modes, w->steps, start.a, start.b, start.at, 0);
    memset(column, 0, (size_t)n * sizeof *column);
    add_form(w, &start, step, column);
    span_with(s, column, parts);
}

/* Every node of the grid; g->deviance (nodes, most + 1) begins as infinity where nothing is written. */
static int search(Work *w, const Grid *g) {
    Py_ssize_t n = w->p.n, many = g->at_count;
    size_t vectors = (size_t)(3 + g->most + 2 + many);
    double *memory = malloc((vectors * (size_t)n + 4 * (size_t)many + 3 + MOST_LOADS) * sizeof *memory), *next = memory;
    if (!memory)
        return -1;
    Span s = {.n = n, .many = many}, kept;
    for (int k = 0; k < 3 + g->most; k++, next += n)
        s.q[k] = next;
    double *left = next, *steps = next + 2 * n;
    s.left = next + n, s.steps = steps, next += (2 + many) * n;
    double *size = next, *along = next + many;
    s.size = next + 2 * many, s.along = next + 3 * many, s.inside = next + 4 * many;
    for (Py_ssize_t i = 0; i < g->lag_count; i++) {
        w->modes = modes_of(0, 1 / g->lags[i], 0);
        intervals(&w->p, &w->modes, w->steps);
        search_lag(w, g, steps, &s);
        memcpy(left, s.left, (size_t)n * sizeof *left);
        memcpy(size, s.size, (size_t)many * sizeof *size), memcpy(along, s.along, (size_t)many * sizeof *along);
        kept = s;
        for (Py_ssize_t j = 0; j < g->theta_count; j++) {
            s.count = kept.count, w->theta = g->thetas[j];
            memcpy(s.left, left, (size_t)n * sizeof *left);
            memcpy(s.size, size, (size_t)many * sizeof *size), memcpy(s.along, along, (size_t)many * sizeof *along);
            run_late(w, 0);
            search_node(g, &s, w->a, i * g->theta_count + j);
        }
    }
    free(memory);
    return 0;
}

/* ---------------------------------------------------------------- sticking valves */

enum { FAMILY, STICK, JUMP, START, VALVE };

/* Position of a valve for the output co, Kano et al. (2004) or He et al. (2007), counted from its first value;
 * returns its largest distance from there. */
static double position(const double *valve, const double *co, Py_ssize_t n, double *out) {
    double f_static = (valve[STICK] + valve[JUMP]) / 2, f_kinetic = (valve[STICK] - valve[JUMP]) / 2;
    double begun = co[0] + valve[START] * f_static, y = begun, left = -valve[START] * f_static, travel = 0;
    int direction = 0, moving = 0;
    out[0] = 0;
    for (Py_ssize_t i = 1; i < n; i++) {
        double u = co[i], change = u - co[i - 1], push = left + u - co[i - 1];
        if (valve[FAMILY] == 0) {
            moving = moving && change * direction > 0;
            if (!moving && fabs(u - y) > f_static)
                moving = 1, direction = u > y ? 1 : -1;
            y = moving ? u - direction * f_kinetic : y;
        } else if (push > f_static || -push > f_static) {
            left = copysign(f_kinetic, push);
            y += push - left;
        } else
            left = push;
        out[i] = y - begun;
        travel = fmax(travel, fabs(out[i]));
    }
    return travel;
}

/* valves : (valve_count, VALVE). q : (lag_count, 3, rows) orthonormal basis of bias, start and trend, y : (lag_count,
 * rows) pv free of it, on the rows first, first + stride, ... left, gain : (valve_count, lag_count, theta_count). */
typedef struct {
    const double *valves, *co, *lags, *thetas, *q, *y;
    Py_ssize_t valve_count, lag_count, theta_count, first, stride, rows;
    double *left, *gain;
} Scan;

/* How the kept rows are read at a node: from which sample (-1: before the record), and the step from it. */
typedef struct {
    Py_ssize_t *at;
    double *e, *v;
} Reading;

static void scan_readings(Work *w, const Scan *s, const Reading *reads, double *decay, double *rise) {
    const Problem *p = &w->p;
    Py_ssize_t many = p->dt > 0 ? 1 : p->n, even = p->dt > 0;
    for (Py_ssize_t l = 0; l < s->lag_count; l++) {
        w->modes = modes_of(0, 1 / s->lags[l], 0);
        intervals(p, &w->modes, w->steps);
        for (Py_ssize_t i = 0; i < p->n; i++) {
            const Interval *step = w->steps + (i < many - !even ? i : 0);
            decay[l * p->n + i] = step->e[0], rise[l * p->n + i] = step->v[0];
        }
        for (Py_ssize_t k = 0; k < s->theta_count; k++) {
            const Reading *r = reads + l * s->theta_count + k;
            w->theta = s->thetas[k];
            Py_ssize_t begun = reading(w);
            for (Py_ssize_t i = 0; i < s->rows; i++) {
                Py_ssize_t row = s->first + i * s->stride;
                const Interval *step = w->reads + (even ? 0 : row);
                r->at[i] = row < begun ? -1 : even ? row - begun : w->read_at[row];
                r->e[i] = row < begun ? 0 : step->e[0], r->v[i] = row < begun ? 0 : step->v[0];
            }
        }
    }
}

/* One node: what a valve's output leaves of pv, with the gain that is best. */
static void scan_node(const Scan *s, Py_ssize_t lag, const Reading *r, const double *x, const double *u, double *column,
                      double *left, double *gain) {
    const double *y = s->y + lag * s->rows;
    for (Py_ssize_t i = 0; i < s->rows; i++) {
        Py_ssize_t at = r->at[i] < 0 ? 0 : r->at[i];
        column[i] = r->e[i] * x[at] + r->v[i] * u[at];
    }
    double whole = dot(column, column, s->rows);
    for (int k = 0; k < 3; k++) {
        const double *q = s->q + (lag * 3 + k) * s->rows;
        add(column, -dot(q, column, s->rows), q, s->rows);
    }
    double size = dot(column, column, s->rows);
    *gain = size > NOTHING_NEW * whole ? dot(y, column, s->rows) / size : 0;
    *left = dot(y, y, s->rows) - *gain * *gain * size;
}

static int scan(Work *w, const Scan *s) {
    Py_ssize_t n = w->p.n, nodes = s->lag_count * s->theta_count, lags = s->lag_count;
    size_t doubles = (size_t)(3 * lags * n + n + s->rows + 2 * nodes * s->rows);
    double *memory = malloc(doubles * sizeof *memory + (size_t)(nodes * s->rows) * sizeof(Py_ssize_t)), *next = memory;
    Reading *reads = malloc((size_t)nodes * sizeof *reads);
    if (!memory || !reads) {
        free(memory), free(reads);
        return -1;
    }
    double *decay = next, *rise = next + lags * n, *x = next + 2 * lags * n, *u = x + lags * n, *column = u + n;
    next = column + s->rows;
    for (Py_ssize_t k = 0; k < nodes; k++, next += 2 * s->rows)
        reads[k].e = next, reads[k].v = next + s->rows;
    for (Py_ssize_t k = 0; k < nodes; k++)
        reads[k].at = (Py_ssize_t *)next + k * s->rows;
    scan_readings(w, s, reads, decay, rise);
    for (Py_ssize_t j = 0; j < s->valve_count; j++) {
        double travel = position(s->valves + j * VALVE, s->co, n, u);
        for (Py_ssize_t l = 0; travel > 0 && l < lags; l++) {
            const double *e = decay + l * n, *v = rise + l * n;
            double *out = x + l * n, now = 0;
            for (Py_ssize_t i = 0; i < n; i++) {
                out[i] = now;
                now = e[i] * now + v[i] * u[i];
            }
        }
        for (Py_ssize_t k = 0; k < nodes; k++) {
            s->left[j * nodes + k] = INFINITY, s->gain[j * nodes + k] = 0;
            if (travel > 0)
                scan_node(s, k / s->theta_count, reads + k, x + k / s->theta_count * n, u, column,
                          s->left + j * nodes + k, s->gain + j * nodes + k);
        }
    }
    free(memory), free(reads);
    return 0;
}

/* What the first `count` vectors of a basis leave of y. */
static void leave(const double *q, int count, double *y, Py_ssize_t n) {
    for (int k = 0; k < count; k++)
        add(y, -dot(q + k * n, y, n), q + k * n, n);
}

/* The columns at p as an orthonormal basis in w->rotated, (count, n), without those that say nothing; the count. */
static int plain_basis(Work *w, const double *p) {
    const Problem *q = &w->p;
    size_t bytes = (size_t)q->n * sizeof(double);
    double most = 0, *a = w->rotated;
    int kept = 0;
    run_lanes(w, p, LEAST_DISCRIMINANT, 0);
    put_columns(w);
    memcpy(a, w->column, (size_t)q->columns * bytes);
    decompose(a, q->n, q->columns, w->beta);
    for (int k = 0; k < q->columns; k++)
        most = fmax(most, fabs(a[k * q->n + k]));
    for (int k = 0; k < q->columns; k++)
        if (fabs(a[k * q->n + k]) > USEFUL * most)
            memmove(w->column + kept++ * q->n, w->column + k * q->n, bytes);
    decompose(w->column, q->n, kept, w->beta);
    put_basis_vectors(w->column, q->n, kept, w->beta, a);
    return kept;
}

/* Misfit with each valve where lags and dead time are held, the gain free; neither whitened nor with priors. */
static void valve_costs(Work *w, const double *p, const double *valves, Py_ssize_t many, const double *co, double *input,
                        double *out) {
    Problem *q = &w->p;
    Py_ssize_t n = q->n;
    int kept = plain_basis(w, p);
    double lane[2], *y = w->target;
    memcpy(y, q->pv, (size_t)n * sizeof *y);
    leave(w->rotated, kept, y, n);
    double all = dot(y, y, n);
    q->u = input;
    on_lanes(&w->modes, w->modes.w, lane);
    for (Py_ssize_t j = 0; j < many; j++) {
        position(valves + j * VALVE, co, n, input);
        run_late(w, 0);
        for (Py_ssize_t i = 0; i < n; i++)
            w->moved[i] = w->gain * (lane[0] * w->a[i] + lane[1] * w->b[i]);
        double whole = dot(w->moved, w->moved, n);
        leave(w->rotated, kept, w->moved, n);
        double size = dot(w->moved, w->moved, n), along = dot(w->moved, y, n);
        out[j] = size > NOTHING_NEW * whole ? all - along * along / size : all;
    }
}

/* ---------------------------------------------------------------- the door: buffers of numbers, looked at before use */

typedef struct {
    Py_buffer buffer;
    double *x;
    Py_ssize_t n;
    int open;
} View;

static int view(PyObject *object, View *v, const char *name, int writable) {
    int flags = PyBUF_C_CONTIGUOUS | PyBUF_FORMAT | (writable ? PyBUF_WRITABLE : 0);
    v->open = 0;
    if (PyObject_GetBuffer(object, &v->buffer, flags)) {
        PyErr_Clear();
        PyErr_Format(PyExc_ValueError, "%s: a contiguous%s buffer of doubles is needed", name,
                     writable ? " writable" : "");
        return -1;
    }
    v->open = 1, v->x = v->buffer.buf, v->n = v->buffer.len / (Py_ssize_t)sizeof(double);
    const char *format = v->buffer.format;
    if (!format || strcmp(format, "d") || v->buffer.itemsize != sizeof(double) ||
        (uintptr_t)v->x % _Alignof(double)) {
        PyErr_Format(PyExc_ValueError, "%s: a buffer of doubles is needed", name);
        return -1;
    }
    for (Py_ssize_t i = 0; !writable && i < v->n; i++)
        if (isnan(v->x[i])) {
            PyErr_Format(PyExc_ValueError, "%s[%zd] is not a number", name, i);
            return -1;
        }
    return 0;
}

static int finite_view(PyObject *object, View *v, const char *name, int writable) {
    if (view(object, v, name, writable))
        return -1;
    for (Py_ssize_t i = 0; i < v->n; i++)
        if (!isfinite(v->x[i])) {
            PyErr_Format(PyExc_ValueError, "%s[%zd] is not a finite number", name, i);
            return -1;
        }
    return 0;
}

static void close_views(View *views, int count) {
    for (int i = 0; i < count; i++)
        if (views[i].open)
            PyBuffer_Release(&views[i].buffer);
}

static int refuse(const char *sentence) {
    PyErr_SetString(PyExc_ValueError, sentence);
    return -1;
}

static int sized(const View *v, Py_ssize_t n, const char *name) {
    if (v->n == n)
        return 0;
    PyErr_Format(PyExc_ValueError, "%s has %zd numbers; %zd are needed", name, v->n, n);
    return -1;
}

static int increasing(const View *t) {
    for (Py_ssize_t i = 1; i < t->n; i++)
        if (!(t->x[i] > t->x[i - 1])) {
            PyErr_Format(PyExc_ValueError, "time does not increase at sample %zd", i);
            return -1;
        }
    return 0;
}

/* A count among the numbers that describe a problem. */
static int count_in(double x, int most, int *out) {
    if (!(x >= 0 && x <= most && x == floor(x)))
        return refuse("numbers: a count is outside its range");
    *out = (int)x;
    return 0;
}

enum { DT, SPAN, SIGMA, SIGN, TYPE, LOADS, HARMONICS, RAMP, ROUNDED, MOTION, STARTS, ORDER, HEAD };

/* numbers : the head (see above), then the starts, the whitening filter, and the weights of the priors. */
static int read_problem(Problem *p, const View *numbers) {
    const double *x = numbers->x;
    if (numbers->n < HEAD)
        return refuse("numbers: the description of the problem is too short");
    p->dt = x[DT], p->span = x[SPAN], p->sigma = x[SIGMA], p->sign = x[SIGN];
    if (!(p->dt >= 0 && p->span > 0 && p->sigma > 0 && fabs(p->sign) == 1))
        return refuse("numbers: dt >= 0, span > 0, sigma > 0 and a sign of 1 or -1 are needed");
    if (count_in(x[TYPE], 3, &p->type) || count_in(x[LOADS], MOST_LOADS, &p->loads) ||
        count_in(x[HARMONICS], MOST_HARMONICS, &p->harmonics) || count_in(x[RAMP], 1, &p->ramp) ||
        count_in(x[ROUNDED], 1, &p->rounded) || count_in(x[MOTION], 1, &p->motion) ||
        count_in(x[STARTS], MOST_STARTS, &p->starts) || count_in(x[ORDER], MOST_AR, &p->order))
        return -1;
    p->priors = p->starts * start_columns(p) + p->ramp;
    p->columns = p->priors + p->loads + 2 * p->harmonics + 1;
    p->size = SIZE[p->type] + p->loads + p->rounded + (p->harmonics > 0);
    if (sized(numbers, HEAD + p->starts + p->order + p->priors, "numbers") || p->columns > MOST_COLUMNS)
        return PyErr_Occurred() ? -1 : refuse("numbers: too many columns");
    memcpy(p->start, x + HEAD, (size_t)p->starts * sizeof *x);
    memcpy(p->ar, x + HEAD + p->starts, (size_t)p->order * sizeof *x);
    memcpy(p->weight, x + HEAD + p->starts + p->order, (size_t)p->priors * sizeof *x);
    p->rows = p->n + p->priors;
    return p->n > p->columns ? 0 : refuse("more unknowns than samples");
}

/* The record and what is asked of it, from the first four arguments; views : four of them. */
static int read_record(Work *w, View *views, PyObject *const *from) {
    static const char *const NAMES[] = {"t", "pv", "co", "numbers"};
    memset(w, 0, sizeof *w);
    for (int i = 0; i < 4; i++)
        if (finite_view(from[i], &views[i], NAMES[i], 0))
            return -1;
    Py_ssize_t n = views[0].n;
    if (n < 3 || n > 10000000)
        return refuse("t: between 3 and 10000000 samples are needed");
    if (sized(&views[1], n, "pv") || sized(&views[2], n, "co") || increasing(&views[0]))
        return -1;
    w->p.n = n, w->p.t = views[0].x, w->p.pv = views[1].x, w->p.u = views[2].x;
    if (read_problem(&w->p, &views[3]))
        return -1;
    if (open_work(w)) {
        PyErr_NoMemory();
        return -1;
    }
    return 0;
}

enum { MOST_VIEWS = 16 };

/* Of a call: its views, its workspace. */
typedef struct {
    View views[MOST_VIEWS];
    int count;
    Work work;
} Call;

static PyObject *ended(Call *call, PyObject *result) {
    close_views(call->views, MOST_VIEWS);
    free(call->work.memory);
    PyMem_Free(call);
    return PyErr_Occurred() ? NULL : result;
}

static Call *begun(PyObject *args, PyObject **from, int arguments) {
    if (PyTuple_Size(args) != arguments) {
        PyErr_Format(PyExc_TypeError, "%d arguments are needed, not %zd", arguments, PyTuple_Size(args));
        return NULL;
    }
    for (int i = 0; i < arguments; i++)
        from[i] = PyTuple_GetItem(args, i);
    Call *call = PyMem_Calloc(1, sizeof *call);
    if (!call)
        PyErr_NoMemory();
    return call;
}

/* refine(t, pv, co, numbers, p, low, high, stride, root, target, explained, evaluations, enough) -> deviance */
static PyObject *py_refine(PyObject *self, PyObject *args) {
    (void)self;
    PyObject *from[13];
    Call *call = begun(args, from, 13);
    if (!call)
        return NULL;
    View *v = call->views;
    Work *w = &call->work;
    long evaluations = PyLong_AsLong(from[11]);
    double enough = PyFloat_AsDouble(from[12]), cost = 0;
    if (PyErr_Occurred() || read_record(w, v, from) || finite_view(from[4], &v[4], "p", 1) ||
        view(from[5], &v[5], "low", 0) || view(from[6], &v[6], "high", 0) ||
        finite_view(from[7], &v[7], "stride", 0) || finite_view(from[8], &v[8], "root", 0) ||
        finite_view(from[9], &v[9], "target", 0) || view(from[10], &v[10], "explained", 1))
        return ended(call, NULL);
    int size = w->p.size, d = SIZE[w->p.type];
    for (int i = 4; i < 8; i++)
        if (sized(&v[i], size, i == 4 ? "p" : i == 5 ? "low" : i == 6 ? "high" : "stride"))
            return ended(call, NULL);
    if (sized(&v[8], d * v[9].n, "root") || sized(&v[10], w->p.n, "explained"))
        return ended(call, NULL);
    if (v[9].n > 64 || evaluations < 0 || evaluations > 100000 || !(enough >= 0))
        return refuse("target, evaluations or enough is outside its range"), ended(call, NULL);
    Search s = {v[8].x, v[9].x, v[5].x, v[6].x, v[7].x, (int)v[9].n, (int)evaluations, enough};
    Py_BEGIN_ALLOW_THREADS
    cost = refine(w, &s, v[4].x);
    put_explained(w, v[10].x);
    Py_END_ALLOW_THREADS
    return ended(call, PyFloat_FromDouble(cost));
}

/* costs(t, pv, co, numbers, points, out): the sum of squares at every point. */
static PyObject *py_costs(PyObject *self, PyObject *args) {
    (void)self;
    PyObject *from[6];
    Call *call = begun(args, from, 6);
    if (!call)
        return NULL;
    View *v = call->views;
    Work *w = &call->work;
    if (read_record(w, v, from) || finite_view(from[4], &v[4], "points", 0) || view(from[5], &v[5], "out", 1) ||
        sized(&v[4], w->p.size * v[5].n, "points"))
        return ended(call, NULL);
    Py_BEGIN_ALLOW_THREADS
    for (Py_ssize_t i = 0; i < v[5].n; i++) {
        solve(w, v[4].x + i * w->p.size);
        v[5].x[i] = w->cost;
    }
    Py_END_ALLOW_THREADS
    return ended(call, Py_NewRef(Py_None));
}

/* project(t, pv, co, numbers, p, q, r, c, moved, columns, triangle): the linear problem solved at p; shapes (columns,
 * rows), (rows + 1), (columns), (n), (columns, n), (columns, columns). */
static PyObject *py_project(PyObject *self, PyObject *args) {
    (void)self;
    static const char *const NAMES[] = {"q", "r", "c", "moved", "columns", "triangle"};
    PyObject *from[11];
    Call *call = begun(args, from, 11);
    if (!call)
        return NULL;
    View *v = call->views;
    Work *w = &call->work;
    if (read_record(w, v, from) || finite_view(from[4], &v[4], "p", 0) || sized(&v[4], w->p.size, "p"))
        return ended(call, NULL);
    Py_ssize_t n = w->p.n, rows = w->p.rows, k = w->p.columns, sizes[] = {k * rows, rows + 1, k, n, k * n, k * k};
    for (int i = 0; i < 6; i++)
        if (view(from[5 + i], &v[5 + i], NAMES[i], 1) || sized(&v[5 + i], sizes[i], NAMES[i]))
            return ended(call, NULL);
    Py_BEGIN_ALLOW_THREADS
    solve(w, v[4].x);
    put_basis_vectors(w->rotated, rows, (int)k, w->beta, v[5].x);
    put_residuals(w, v[6].x);
    back(w->rotated, rows, (int)k, w->inside, v[7].x);
    memcpy(v[8].x, w->moved, (size_t)n * sizeof(double));
    memcpy(v[9].x, w->column, (size_t)(k * n) * sizeof(double));
    for (Py_ssize_t i = 0; i < k; i++)
        for (Py_ssize_t j = 0; j < k; j++)
            v[10].x[i * k + j] = i <= j ? w->rotated[j * rows + i] : 0;
    Py_END_ALLOW_THREADS
    return ended(call, Py_NewRef(Py_None));
}

/* jacobian(t, pv, co, numbers, p, out): shape (size, rows + 1). */
static PyObject *py_jacobian(PyObject *self, PyObject *args) {
    (void)self;
    PyObject *from[6];
    Call *call = begun(args, from, 6);
    if (!call)
        return NULL;
    View *v = call->views;
    Work *w = &call->work;
    if (read_record(w, v, from) || finite_view(from[4], &v[4], "p", 0) || sized(&v[4], w->p.size, "p") ||
        view(from[5], &v[5], "out", 1) || sized(&v[5], w->p.size * (w->p.rows + 1), "out"))
        return ended(call, NULL);
    Py_BEGIN_ALLOW_THREADS
    solve(w, v[4].x);
    put_jacobian(w, v[4].x, v[5].x);
    Py_END_ALLOW_THREADS
    return ended(call, Py_NewRef(Py_None));
}

/* gains(t, pv, co, numbers, p, instants, out): what a further load step at each instant would bring. */
static PyObject *py_gains(PyObject *self, PyObject *args) {
    (void)self;
    PyObject *from[7];
    Call *call = begun(args, from, 7);
    if (!call)
        return NULL;
    View *v = call->views;
    Work *w = &call->work;
    if (read_record(w, v, from) || finite_view(from[4], &v[4], "p", 0) || sized(&v[4], w->p.size, "p") ||
        finite_view(from[5], &v[5], "instants", 0) || view(from[6], &v[6], "out", 1) ||
        sized(&v[6], v[5].n, "out"))
        return ended(call, NULL);
    Py_ssize_t rows = w->p.rows;
    double *memory = malloc((size_t)((w->p.columns + 1) * rows + 1) * sizeof *memory);
    if (!memory)
        return PyErr_NoMemory(), ended(call, NULL);
    Py_BEGIN_ALLOW_THREADS
    solve(w, v[4].x);
    put_basis_vectors(w->rotated, rows, w->p.columns, w->beta, memory);
    put_residuals(w, memory + w->p.columns * rows);
    load_gains(w, memory, memory + w->p.columns * rows, v[5].x, v[5].n, v[6].x);
    free(memory);
    Py_END_ALLOW_THREADS
    return ended(call, Py_NewRef(Py_None));
}

/* colour(r, least, most_order) -> (std, coefficients) of the whitening filter of a remainder. */
static PyObject *py_colour(PyObject *self, PyObject *args) {
    (void)self;
    PyObject *from[3];
    Call *call = begun(args, from, 3);
    if (!call)
        return NULL;
    View *v = call->views;
    double least = PyFloat_AsDouble(from[1]), ar[MOST_AR], std;
    long most = PyLong_AsLong(from[2]);
    if (PyErr_Occurred() || finite_view(from[0], &v[0], "r", 0))
        return ended(call, NULL);
    if (v[0].n < 1 || !(least > 0 && isfinite(least)) || most < 0 || most > MOST_AR || most >= v[0].n + (most == 0))
        return refuse("r, least or most_order is outside its range"), ended(call, NULL);
    int order = colour_of(v[0].x, v[0].n, least, (int)most, ar, &std);
    PyObject *found = PyTuple_New(order);
    for (int i = 0; found && i < order; i++)
        PyTuple_SetItem(found, i, PyFloat_FromDouble(ar[i]));
    return ended(call, Py_BuildValue("dN", std, found));
}

static int positive(const View *v, const char *sentence) {
    for (Py_ssize_t i = 0; i < v->n; i++)
        if (!(v->x[i] > 0))
            return refuse(sentence);
    return 0;
}

/* search(t, pv, co, numbers, lags, thetas, at, most, deviance, slope, chosen): shapes (nodes, most + 1) twice and (nodes,
 * most); infinity in deviance where a load step more brings nothing. An infinite lag is an integrating process. */
static PyObject *py_search(PyObject *self, PyObject *args) {
    (void)self;
    static const char *const NAMES[] = {"deviance", "slope", "chosen"};
    PyObject *from[11];
    Call *call = begun(args, from, 11);
    if (!call)
        return NULL;
    View *v = call->views;
    Work *w = &call->work;
    long most = PyLong_AsLong(from[7]);
    if (PyErr_Occurred() || read_record(w, v, from) || view(from[4], &v[4], "lags", 0) ||
        finite_view(from[5], &v[5], "thetas", 0) || finite_view(from[6], &v[6], "at", 0) ||
        positive(&v[4], "lags: above 0") || positive(&v[5], "thetas: above 0"))
        return ended(call, NULL);
    Py_ssize_t nodes = v[4].n * v[5].n;
    if (most < 0 || most > MOST_LOADS || v[6].n < most || w->p.n < 3 + most || v[6].n > 100000 || nodes > 1000000)
        return refuse("search: most or the grid is outside its range"), ended(call, NULL);
    Py_ssize_t sizes[] = {nodes * (most + 1), nodes * (most + 1), nodes * most};
    for (int i = 0; i < 3; i++)
        if (view(from[8 + i], &v[8 + i], NAMES[i], 1) || sized(&v[8 + i], sizes[i], NAMES[i]))
            return ended(call, NULL);
    Grid g = {v[4].x, v[5].x, v[6].x, v[4].n,   v[5].n,   v[6].n,
              (int)most, w->p.sigma,  v[8].x, v[9].x, v[10].x};
    int failed;
    Py_BEGIN_ALLOW_THREADS
    for (Py_ssize_t i = 0; i < v[8].n; i++)
        v[8].x[i] = INFINITY;
    failed = search(w, &g);
    Py_END_ALLOW_THREADS
    return failed ? PyErr_NoMemory(), ended(call, NULL) : ended(call, Py_NewRef(Py_None));
}

static int are_valves(const View *v) {
    if (v->n % VALVE)
        return refuse("valves: four numbers each are needed");
    for (Py_ssize_t i = 0; i < v->n; i += VALVE) {
        const double *x = v->x + i;
        if (!((x[FAMILY] == 0 || x[FAMILY] == 1) && x[STICK] > 0 && x[JUMP] >= 0 && fabs(x[START]) <= 1))
            return refuse("valves: a family of 0 or 1, a band above 0, a jump from 0, a start within -1 and 1");
    }
    return 0;
}

/* position(valve, co, out): counted from the first value. */
static PyObject *py_position(PyObject *self, PyObject *args) {
    (void)self;
    PyObject *from[3];
    Call *call = begun(args, from, 3);
    if (!call)
        return NULL;
    View *v = call->views;
    if (finite_view(from[0], &v[0], "valve", 0) || sized(&v[0], VALVE, "valve") || are_valves(&v[0]) ||
        finite_view(from[1], &v[1], "co", 0) || view(from[2], &v[2], "out", 1) || sized(&v[2], v[1].n, "out"))
        return ended(call, NULL);
    if (v[1].n < 1)
        return refuse("co: at least one sample is needed"), ended(call, NULL);
    position(v[0].x, v[1].x, v[1].n, v[2].x);
    return ended(call, Py_NewRef(Py_None));
}

/* scan(t, pv, co, numbers, valves, lags, thetas, q, y, first, stride, left, gain) */
static PyObject *py_scan(PyObject *self, PyObject *args) {
    (void)self;
    PyObject *from[13];
    Call *call = begun(args, from, 13);
    if (!call)
        return NULL;
    View *v = call->views;
    Work *w = &call->work;
    Py_ssize_t first = PyLong_AsSsize_t(from[9]), stride = PyLong_AsSsize_t(from[10]);
    if (PyErr_Occurred() || read_record(w, v, from) || finite_view(from[4], &v[4], "valves", 0) ||
        are_valves(&v[4]) || finite_view(from[5], &v[5], "lags", 0) || finite_view(from[6], &v[6], "thetas", 0) ||
        positive(&v[5], "lags: above 0") || positive(&v[6], "thetas: above 0") ||
        finite_view(from[7], &v[7], "q", 0) || finite_view(from[8], &v[8], "y", 0) ||
        view(from[11], &v[9], "left", 1) || view(from[12], &v[10], "gain", 1))
        return ended(call, NULL);
    if (first < 0 || first >= w->p.n || stride < 1 || v[5].n > 64 || v[6].n > 64)
        return refuse("scan: rows or nodes are outside their range"), ended(call, NULL);
    Py_ssize_t rows = (w->p.n - first - 1) / stride + 1, nodes = v[5].n * v[6].n, many = v[4].n / VALVE;
    if (sized(&v[7], 3 * v[5].n * rows, "q") || sized(&v[8], v[5].n * rows, "y") ||
        sized(&v[9], many * nodes, "left") || sized(&v[10], many * nodes, "gain"))
        return ended(call, NULL);
    Scan s = {v[4].x, v[2].x, v[5].x, v[6].x, v[7].x, v[8].x, many,    v[5].n,
              v[6].n, first,  stride, rows,   v[9].x, v[10].x};
    int failed;
    Py_BEGIN_ALLOW_THREADS
    failed = scan(w, &s);
    Py_END_ALLOW_THREADS
    return failed ? PyErr_NoMemory(), ended(call, NULL) : ended(call, Py_NewRef(Py_None));
}

/* valve_costs(t, pv, co, numbers, p, valves, out) */
static PyObject *py_valve_costs(PyObject *self, PyObject *args) {
    (void)self;
    PyObject *from[7];
    Call *call = begun(args, from, 7);
    if (!call)
        return NULL;
    View *v = call->views;
    Work *w = &call->work;
    if (read_record(w, v, from) || finite_view(from[4], &v[4], "p", 0) || sized(&v[4], w->p.size, "p") ||
        finite_view(from[5], &v[5], "valves", 0) || are_valves(&v[5]) || view(from[6], &v[6], "out", 1) ||
        sized(&v[5], VALVE * v[6].n, "valves"))
        return ended(call, NULL);
    double *input = malloc((size_t)w->p.n * sizeof *input);
    if (!input)
        return PyErr_NoMemory(), ended(call, NULL);
    Py_BEGIN_ALLOW_THREADS
    valve_costs(w, v[4].x, v[5].x, v[6].n, v[2].x, input, v[6].x);
    free(input);
    Py_END_ALLOW_THREADS
    return ended(call, Py_NewRef(Py_None));
}

static PyMethodDef METHODS[] = {
    {"refine", py_refine, METH_VARARGS, NULL},     {"costs", py_costs, METH_VARARGS, NULL},
    {"project", py_project, METH_VARARGS, NULL},   {"jacobian", py_jacobian, METH_VARARGS, NULL},
    {"gains", py_gains, METH_VARARGS, NULL},       {"colour", py_colour, METH_VARARGS, NULL},
    {"search", py_search, METH_VARARGS, NULL},     {"position", py_position, METH_VARARGS, NULL},
    {"scan", py_scan, METH_VARARGS, NULL},         {"valve_costs", py_valve_costs, METH_VARARGS, NULL},
    {NULL, NULL, 0, NULL},
};

static int on_load(PyObject *module) { return PyModule_AddStringConstant(module, "version", VERSION); }

static PyModuleDef_Slot SLOTS[] = {{Py_mod_exec, (void *)on_load}, {0, NULL}};

static struct PyModuleDef MODULE = {
    PyModuleDef_HEAD_INIT, "_engine", "The compiled engine of identification.", 0, METHODS, SLOTS, NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit__engine(void) { return PyModuleDef_Init(&MODULE); }
