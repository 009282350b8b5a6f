/* Process and a load of any spectrum: what an autoregression leaves of pv - K x (explanations/any_load.py). */

#ifndef RETUNER_ANY_LOAD_H
#define RETUNER_ANY_LOAD_H

#include "walk.h"

enum { TOGETHER = 4, WORDS = LANES / WIDTH, SIDE = TOGETHER * LANES, MOST_ORDER = SIDE - 1, MOST_REST = TOGETHER - 1 };

/* co goes through a pole (with its rise), a second one (0 for none) and a dead time; what runs away is treated as in Walk.
 * spans : (dead_count, 2), the first gain that is asked for and the one after the last. noise : what pv cannot show, a sum of
 * squares. left : (dead_count, gain_count), infinite where it is not asked. */
typedef struct {
    const double *pv, *co, *deads, *gains, *spans;
    Py_ssize_t n, dead_count, gain_count;
    double pole, rise, second, noise, *left;
    int order;
} AnyLoad;

/* Products of one row at each lag with another at each, and of the other with the one, added: symmetric, below the diagonal. The
 * longest lag is first, so that the sample itself is last. */
typedef double Products[SIDE][SIDE];

/* outside : pv and the rest after the first samples, TOGETHER rows of `many`. The rest is orthonormal: a level, a slope where the
 * process integrates, what unknown starts of its lags fall with. x : at no dead time. pv, late : after `pad` zeros; x late by
 * a fraction of a sample. at : products of the rows outside with such a series at each lag. of_pv, of_x : what these have along
 * the rest, the longest lag first. */
typedef struct {
    Py_ssize_t pad, many, rest;
    double *memory, *outside, *x, *pv, *late, (*at)[TOGETHER], of_pv[MOST_REST][SIDE], of_x[MOST_REST][SIDE];
    Products own, both, by_x;
} Lagged;

/* Adds to out the products of TOGETHER rows with x at LANES lags each, those of a row `back` samples after the ones before. */
WIDE static void add_at_lags(const double *restrict rows, Py_ssize_t apart, const double *restrict x, Py_ssize_t back,
                             Py_ssize_t n, double *restrict out) {
    Four whole[TOGETHER][WORDS] = {0};
    for (Py_ssize_t start = 0; start < n; start += STRETCH) { /* sums of sums keep more digits */
        Four sum[TOGETHER][WORDS] = {0};
        for (Py_ssize_t i = start; i < n && i < start + STRETCH; i++)
            for (int r = 0; r < TOGETHER; r++)
                for (int l = 0; l < WORDS; l++)
                    sum[r][l] += rows[r * apart + i] * *(const Four *)(x + i - r * back - LANES + 1 + l * WIDTH);
        for (int r = 0; r < TOGETHER; r++)
            for (int l = 0; l < WORDS; l++)
                whole[r][l] += sum[r][l];
    }
    for (int r = 0; r < TOGETHER; r++)
        for (int l = 0; l < LANES; l++)
            out[r * LANES + l] += ((const double *)whole[r])[LANES - 1 - l];
}

/* Lays `at` for a series at the lags before `to`, or some more. */
static void lay_at(const AnyLoad *w, const Lagged *g, const double *series, Py_ssize_t to) {
    for (Py_ssize_t lag = 0; lag < to; lag += LANES) {
        double found[SIDE] = {0};
        add_at_lags(g->outside, g->many, series + w->order - lag, 0, g->many, found);
        for (Py_ssize_t k = 0; k < SIDE; k++)
            g->at[lag + k % LANES][k / LANES] = found[k];
    }
}

static void lay_along(const AnyLoad *w, const Lagged *g, Py_ssize_t late, double (*along)[SIDE]) {
    for (Py_ssize_t k = 0; k < g->rest; k++)
        for (int i = 0; i <= w->order; i++)
            along[k][w->order - i] = g->at[late + i][1 + k];
}

/* A form of which the last row is laid, without what both rows have along the rest: each other product from the one a sample
 * later, as one sample goes and one comes. */
WIDE static void lay_form(const AnyLoad *w, Py_ssize_t rest, const double *a, const double *b,
                          double (*of_a)[SIDE], double (*of_b)[SIDE], double (*restrict form)[SIDE]) {
    Py_ssize_t p = w->order, last = w->n - p;
    for (Py_ssize_t r = p - 1; r >= 0; r--)
        for (Py_ssize_t c = 0; c <= r; c++)
            form[r][c] = form[r + 1][c + 1] + (a[r] * b[c] + a[c] * b[r]) -
                         (a[last + r] * b[last + c] + a[last + c] * b[last + r]);
    for (Py_ssize_t k = 0; k < rest; k++)
        for (Py_ssize_t r = 0; r <= p; r++)
            for (Py_ssize_t c = 0; c <= r; c++)
                form[r][c] -= of_a[k][r] * of_b[k][c] + of_a[k][c] * of_b[k][r];
}

/* What is left at LANES gains: the last pivot of an elimination, the sample itself after its past. */
WIDE static void pivots(const Lagged *g, int order, const double *restrict gains, double *restrict left) {
    Four column[SIDE][SIDE + TOGETHER][WORDS], over[SIDE][WORDS], row[SIDE][WORDS], gain[WORDS], square[WORDS];
    for (int l = 0; l < WORDS; l++)
        gain[l] = *(const Four *)(gains + l * WIDTH), square[l] = gain[l] * gain[l];
    for (int j = 0; j <= order; j++) {
        for (int k = 0; k < j; k++)
            for (int l = 0; l < WORDS; l++)
                row[k][l] = column[k][j][l] * over[k][l];
        for (int i = j; i <= order; i += TOGETHER) {
            Four sum[TOGETHER][WORDS];
            for (int r = 0; r < TOGETHER; r++) {
                int of = i + r < order ? i + r : order;
                double mine = g->own[of][j] / 2, two = g->both[of][j], its = g->by_x[of][j] / 2;
                for (int l = 0; l < WORDS; l++)
                    sum[r][l] = mine - gain[l] * two + square[l] * its;
            }
            for (int k = 0; k < j; k++)
                for (int r = 0; r < TOGETHER; r++)
                    for (int l = 0; l < WORDS; l++)
                        sum[r][l] -= column[k][i + r][l] * row[k][l];
            memcpy(column[j][i], sum, sizeof sum);
        }
        memcpy(left, column[j][j], sizeof column[j][j]);
        for (int l = 0; l < LANES; l++)
            left[l] = left[l] > LEAST_INFORMATION ? left[l] : LEAST_INFORMATION;
        for (int l = 0; l < WORDS; l++)
            over[j][l] = 1 / *(const Four *)(left + l * WIDTH);
    }
}

static int open_lagged(const AnyLoad *w, Lagged *g) {
    double latest = 0;
    for (Py_ssize_t d = 0; d < w->dead_count; d++)
        latest = fmax(latest, w->deads[d]);
    Py_ssize_t n = w->n, many = n - w->order, pad = (Py_ssize_t)latest + SIDE + LANES;
    g->pad = pad, g->many = many, g->rest = 1 + (w->pole <= 1) + (w->second > 0);
    g->memory = calloc((size_t)(TOGETHER * (many + pad) + 3 * n + 2 * pad), sizeof(double));
    if (!g->memory)
        return -1;
    g->outside = g->memory, g->x = g->outside + TOGETHER * many, g->pv = g->x + n + pad;
    g->late = g->pv + n + pad, g->at = (double (*)[TOGETHER])(g->late + n);
    Walk lags = {.inputs = w->co, .seconds = &w->second, .n = n, .input_count = 1, .pole = w->pole, .rise = w->rise};
    through_lags(&lags, 0, 1, g->x);
    double reduced = w->pole > 1 ? w->pole : 0; /* pv is 1 - pole q of what it was, and so is its noise */
    for (Py_ssize_t i = 0; i < n; i++)
        g->pv[i] = w->pv[i] - (i ? reduced * w->pv[i - 1] : 0);
    memcpy(g->outside, g->pv + w->order, (size_t)many * sizeof(double));
    const double poles[] = {1, w->pole <= 1 ? w->pole : w->second, w->second};
    for (Py_ssize_t k = 0; k < g->rest; k++) {
        double *row = g->outside + (1 + k) * many, now = 1;
        for (Py_ssize_t i = 0; i < many; i++, now *= poles[k])
            row[i] = k && poles[k] == 1 ? (double)i : now;
        made_orthonormal(g->outside + many, k, many, many);
    }
    lay_at(w, g, g->pv, w->order + 1);
    lay_along(w, g, 0, g->of_pv);
    for (int j = 0; j <= w->order; j++)
        g->own[w->order][w->order - j] = 2 * g->at[j][0];
    lay_form(w, g->rest, g->pv, g->pv, g->of_pv, g->of_pv, g->own);
    for (int j = 0; j <= w->order; j++) {
        g->own[j][j] += 2 * w->noise * (1 + reduced * reduced);
        if (j)
            g->own[j][j - 1] -= 2 * w->noise * reduced;
    }
    return 0;
}

/* The forms where x comes so late. past : products of pv at each lag with x at none. squares : of x with itself at each lag, over
 * the samples after the first ones that are there yet. */
static void lay_dead_time(const AnyLoad *w, Lagged *g, Py_ssize_t late, const double *past, const double *squares) {
    Py_ssize_t p = w->order, n = w->n, early = late < p ? late : p, there = n - late - p + early;
    const double *x = g->late, *first = x + p - early;
    double own[SIDE];
    memcpy(own, squares, sizeof own);
    add_at_lags(first, 0, first, LANES, early < there ? early : there, own);
    for (Py_ssize_t j = 0; j <= p; j++) {
        Py_ssize_t ago = j > late ? j - late : 0, then = late > j ? late - j : 0;
        double before = ago ? past[ago] : g->at[then][0];
        for (Py_ssize_t s = 1; s <= j - ago; s++)
            before += g->pv[p - ago - s] * x[p - then - s] - g->pv[n - ago - s] * x[n - then - s];
        g->both[p][p - j] = g->at[late + j][0] + before;
        g->by_x[p][p - j] = 2 * own[j];
    }
    lay_along(w, g, late, g->of_x);
    lay_form(w, g->rest, g->pv, x - late, g->of_pv, g->of_x, g->both);
    lay_form(w, g->rest, x - late, x - late, g->of_x, g->of_x, g->by_x);
}

/* What is left at the gains that are asked for of one dead time. */
static void put_gains(const AnyLoad *w, const Lagged *g, Py_ssize_t d) {
    Py_ssize_t to = (Py_ssize_t)w->spans[2 * d + 1];
    for (Py_ssize_t at = (Py_ssize_t)w->spans[2 * d]; at < to; at += LANES) {
        double gains[LANES], found[LANES];
        for (Py_ssize_t l = 0; l < LANES; l++)
            gains[l] = w->gains[at + l < to ? at + l : to - 1];
        pivots(g, w->order, gains, found);
        for (Py_ssize_t l = 0; l < LANES && at + l < to; l++)
            w->left[d * w->gain_count + at + l] = found[l];
    }
}

/* What is left at every dead time with this fraction of a sample, up to so many whole ones. The last comes first, so that sums go
 * on to the ones before it. */
static void any_load_late_by(const AnyLoad *w, Lagged *g, double part, Py_ssize_t latest) {
    Py_ssize_t n = w->n, summed = w->order;
    double past[SIDE] = {0}, squares[SIDE] = {0};
    for (Py_ssize_t i = 0; i < n; i++)
        g->late[i] = (1 - part) * g->x[i] + (i ? part * g->x[i - 1] : 0);
    add_at_lags(g->late + w->order, 0, g->pv + w->order, LANES, g->many, past);
    lay_at(w, g, g->late, latest + w->order + 1);
    for (Py_ssize_t d = w->dead_count - 1; d >= 0; d--) {
        Py_ssize_t late = (Py_ssize_t)w->deads[d], there = n - late;
        if (w->deads[d] - (double)late != part)
            continue;
        if (there < summed)
            memset(squares, 0, sizeof squares), summed = w->order;
        if (there > summed)
            add_at_lags(g->late + summed, 0, g->late + summed, LANES, there - summed, squares), summed = there;
        lay_dead_time(w, g, late, past, squares);
        put_gains(w, g, d);
    }
}

/* What is left at every dead time and gain; -1 without memory. */
static int any_load(const AnyLoad *w) {
    Lagged g;
    if (open_lagged(w, &g))
        return -1;
    for (Py_ssize_t i = 0; i < w->dead_count * w->gain_count; i++)
        w->left[i] = INFINITY;
    for (Py_ssize_t d = 0; d < w->dead_count; d++) {
        double part = w->deads[d] - floor(w->deads[d]), latest = w->deads[d];
        int again = 0;
        for (Py_ssize_t e = 0; e < w->dead_count; e++)
            if (w->deads[e] - floor(w->deads[e]) == part)
                latest = fmax(latest, w->deads[e]), again |= e < d;
        if (!again)
            any_load_late_by(w, &g, part, (Py_ssize_t)latest);
    }
    free(g.memory);
    return 0;
}

#endif
