/* The colour of a remainder (misfit.py) and the coarse search (search.py). */

#ifndef RETUNER_SEARCH_H
#define RETUNER_SEARCH_H

#include "misfit.h"

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

#endif
