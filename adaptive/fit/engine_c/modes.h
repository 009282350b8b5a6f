/* The process as modes on two lanes, and its responses as combinations of them (see _engine.c; dynamics.py has the
 * formulas). */

#ifndef RETUNER_MODES_H
#define RETUNER_MODES_H

#include <float.h>
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

/* Where the loader can choose, the loops over samples exist twice, for wider registers, too: the same operations in the
 * same order for every sample, so the same bits. */
#if defined(__x86_64__) && defined(__GLIBC__) && defined(__GNUC__) && !defined(__clang__) && !defined(__SANITIZE_ADDRESS__)
#define WIDE __attribute__((target_clones("avx2", "default")))
#else
#define WIDE
#endif

/* Equal lags are told apart by this much in the discriminant, by more for derivatives; a load's own lag from the modes by
 * this share of it; a rate below STILL is none. */
static const double LEAST_DISCRIMINANT = 1e-8, LEAST_SLOPE_DISCRIMINANT = 1e-5, LEAST_APART = 1e-5, STILL = 1e-200;

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

/* The first of the samples that are largest in size: their block, then their place in it. */
WIDE static Py_ssize_t largest(const double *x, Py_ssize_t n) {
    enum { BLOCK = 64 };
    Py_ssize_t at = 0;
    double most = 0;
    for (Py_ssize_t start = 0; start < n; start += BLOCK) {
        Py_ssize_t end = start + BLOCK < n ? start + BLOCK : n, i = start;
        double lane[8] = {0}, here = 0;
        for (; i + 8 <= end; i += 8)
            for (int j = 0; j < 8; j++)
                lane[j] = fabs(x[i + j]) > lane[j] ? fabs(x[i + j]) : lane[j];
        for (; i < end; i++)
            here = fmax(here, fabs(x[i]));
        for (int j = 0; j < 8; j++)
            here = fmax(here, lane[j]);
        if (here > most)
            most = here, at = start;
    }
    for (Py_ssize_t i = at; i < n; i++)
        if (fabs(x[i]) == most)
            return i;
    return 0;
}

/* ---------------------------------------------------------------- modes of the process */

/* s : rates. w : weights. ds, dw : their derivatives by ln T (0), ln c2 (1) and ln |b| (2). count : of different rates;
 * pair : the one rate stands for itself and its conjugate. */
typedef struct {
    int count, pair;
    cplx s[2], w[2], ds[3][2], dw[3][2];
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

/* The same behind a zero 1 - b s of either sign: the weight of a mode e^(-s t) grows by 1 + b s. */
static Modes inverse_of(Modes m, double b) {
    for (int j = 0; b != 0 && j < m.count; j++) {
        cplx grown = plus(cx(1, 0), scaled(m.s[j], b)), w = m.w[j];
        for (int q = 0; q < 2; q++)
            m.dw[q][j] = plus(times(m.dw[q][j], grown), scaled(times(w, m.ds[q][j]), b));
        m.w[j] = times(w, grown), m.dw[2][j] = scaled(times(w, m.s[j]), b);
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

/* Derivatives by ln T (q = 0), ln c2 (q = 1) and ln |b| (q = 2); a rate of zero stays zero. */
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

#endif
