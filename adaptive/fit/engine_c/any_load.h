/* Process and a load of any spectrum: what an autoregression leaves of pv - K x (explanations/any_load.py). */

#ifndef RETUNER_ANY_LOAD_H
#define RETUNER_ANY_LOAD_H

#include "walk.h"

enum { MOST_ORDER = 32, SIDE = MOST_ORDER + 1, MOST_REST = 8 };

/* x : at no dead time, (n). rest : orthonormal columns that are there besides, (rest_count, n - order). spans : (dead_count, 2),
 * the first gain that is asked for and the one after the last. noise : what pv cannot show, a sum of squares. left : (dead_count,
 * gain_count), infinite where it is not asked. */
typedef struct {
    const double *pv, *x, *rest, *deads, *gains, *spans;
    Py_ssize_t n, rest_count, dead_count, gain_count;
    int order;
    double noise, *left;
} AnyLoad;

typedef struct {
    double of[SIDE][SIDE], along[SIDE][MOST_REST];
} Lagged;

/* What a row at each lag, 0 first, has along the rest. */
static void lay_along(const AnyLoad *w, const double *row, Lagged *out) {
    Py_ssize_t many = w->n - w->order;
    for (int i = 0; i <= w->order; i++)
        for (Py_ssize_t k = 0; k < w->rest_count; k++)
            out->along[i][k] = dot(row + w->order - i, w->rest + k * many, many);
}

/* Products of a at each lag with b at each, without what both have along the rest: those of lag 0, and each other from the one
 * before it, as one sample goes and one comes. */
static void lay_products(const AnyLoad *w, const double *a, const double *b, const Lagged *first, const Lagged *second,
                         double (*out)[SIDE]) {
    Py_ssize_t n = w->n, p = w->order;
    for (Py_ssize_t j = 0; j <= p; j++) {
        out[0][j] = dot(a + p, b + p - j, n - p);
        out[j][0] = a == b ? out[0][j] : dot(a + p - j, b + p, n - p);
    }
    for (Py_ssize_t i = 0; i < p; i++)
        for (Py_ssize_t j = 0; j < p; j++)
            out[i + 1][j + 1] = out[i][j] + a[p - 1 - i] * b[p - 1 - j] - a[n - 1 - i] * b[n - 1 - j];
    for (Py_ssize_t i = 0; i <= p; i++)
        for (Py_ssize_t j = 0; j <= p; j++)
            for (Py_ssize_t k = 0; k < w->rest_count; k++)
                out[i][j] -= first->along[i][k] * second->along[j][k];
}

/* What is left at LANES gains: the last pivot of Cholesky's factor, the sample itself after its past. */
WIDE static void pivots(double (*own)[SIDE], double (*both)[SIDE], double (*by_x)[SIDE], int order, double noise,
                        const double *restrict gains, double *restrict left) {
    double factor[SIDE][SIDE][LANES], squares[LANES];
    for (int l = 0; l < LANES; l++)
        squares[l] = gains[l] * gains[l];
    for (int i = 0; i <= order; i++)
        for (int j = 0; j <= i; j++) {
            int r = order - i, c = order - j;
            double two = both[r][c] + both[c][r], mine = own[r][c] + (i == j ? noise : 0), its = by_x[r][c];
            double sum[LANES];
            for (int l = 0; l < LANES; l++)
                sum[l] = mine - gains[l] * two + squares[l] * its;
            for (int k = 0; k < j; k++)
                for (int l = 0; l < LANES; l++)
                    sum[l] -= factor[i][k][l] * factor[j][k][l];
            if (i == j)
                for (int l = 0; l < LANES; l++)
                    factor[i][i][l] = sqrt(sum[l] > LEAST_INFORMATION ? sum[l] : LEAST_INFORMATION);
            else
                for (int l = 0; l < LANES; l++)
                    factor[i][j][l] = sum[l] / factor[j][j][l];
        }
    for (int l = 0; l < LANES; l++)
        left[l] = factor[order][order][l] * factor[order][order][l];
}

/* What is left at every dead time and gain; -1 without memory. */
static int any_load(const AnyLoad *w) {
    double *late = malloc((size_t)w->n * sizeof *late), both[SIDE][SIDE];
    Lagged pv, x;
    if (!late)
        return -1;
    lay_along(w, w->pv, &pv);
    lay_products(w, w->pv, w->pv, &pv, &pv, pv.of);
    for (Py_ssize_t d = 0; d < w->dead_count; d++) {
        Py_ssize_t whole = (Py_ssize_t)w->deads[d], from = (Py_ssize_t)w->spans[2 * d], to = (Py_ssize_t)w->spans[2 * d + 1];
        double part = w->deads[d] - (double)whole, *left = w->left + d * w->gain_count;
        for (Py_ssize_t i = 0; i < w->n; i++)
            late[i] = (i < whole ? 0 : (1 - part) * w->x[i - whole]) + (i < whole + 1 ? 0 : part * w->x[i - whole - 1]);
        lay_along(w, late, &x);
        lay_products(w, late, late, &x, &x, x.of);
        lay_products(w, w->pv, late, &pv, &x, both);
        for (Py_ssize_t g = 0; g < w->gain_count; g++)
            left[g] = INFINITY;
        for (Py_ssize_t g = from; g < to; g += LANES) {
            double gains[LANES], found[LANES];
            for (Py_ssize_t l = 0; l < LANES; l++)
                gains[l] = w->gains[g + l < to ? g + l : to - 1];
            pivots(pv.of, both, x.of, w->order, w->noise, gains, found);
            for (Py_ssize_t l = 0; l < LANES && g + l < to; l++)
                left[g + l] = found[l];
        }
    }
    free(late);
    return 0;
}

#endif
