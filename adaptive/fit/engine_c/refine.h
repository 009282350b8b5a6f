/* From a start to the optimum (refine.py). */

#ifndef RETUNER_REFINE_H
#define RETUNER_REFINE_H

#include "misfit.h"

static const double DAMPING = 1e-2, LESS = 0.2, MORE = 5.0, MOST_DAMPING = 1e8, LEAST_DAMPING = 1e-9;
static const double SMALLEST_STEP = 1e-9;

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

#endif
