/* Sticking valves: their positions, the coarse scan, and the costs round a fit (valve/valve_model.py, valve/valve_fit.py). */

#ifndef RETUNER_VALVES_H
#define RETUNER_VALVES_H

#include "misfit.h"

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

/* seconds : a second lag for each lag, 0 for none; the valve's output goes through it first, held from sample to sample.
 * valves : (valve_count, VALVE). q : (lag_count, 3, rows) orthonormal basis of bias, start and trend, y : (lag_count,
 * rows) pv free of it, on the rows first, first + stride, ... left, gain : (valve_count, lag_count, theta_count). */
typedef struct {
    const double *valves, *co, *lags, *seconds, *thetas, *q, *y;
    Py_ssize_t valve_count, lag_count, theta_count, first, stride, rows;
    double *left, *gain;
} Scan;

/* How the kept rows are read at a node: from which sample (-1: before the record), and the step from it. */
typedef struct {
    Py_ssize_t *at;
    double *e, *v;
} Reading;

/* How a lag goes from sample to sample. scale : of what it gives. */
static void lag_steps(Work *w, double lag, double scale, double *decay, double *rise) {
    const Problem *p = &w->p;
    Py_ssize_t even = p->dt > 0, many = even ? 1 : p->n;
    w->modes = modes_of(0, 1 / lag, 0);
    intervals(p, &w->modes, w->steps);
    for (Py_ssize_t i = 0; i < p->n; i++) {
        const Interval *step = w->steps + (i < many - !even ? i : 0);
        decay[i] = step->e[0], rise[i] = scale * step->v[0];
    }
}

/* A held input through a lag. */
static void through_lag(const double *decay, const double *rise, const double *u, Py_ssize_t n, double *out) {
    double now = 0;
    for (Py_ssize_t i = 0; i < n; i++) {
        out[i] = now;
        now = decay[i] * now + rise[i] * u[i];
    }
}

static void scan_readings(Work *w, const Scan *s, const Reading *reads, double *steps) {
    const Problem *p = &w->p;
    Py_ssize_t even = p->dt > 0;
    for (Py_ssize_t l = 0; l < s->lag_count; l++) {
        double *own = steps + 4 * l * p->n;
        if (s->seconds[l] > 0)
            lag_steps(w, s->seconds[l], 1 / s->seconds[l], own + 2 * p->n, own + 3 * p->n);
        lag_steps(w, s->lags[l], 1, own, own + p->n);
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
    size_t doubles = (size_t)(6 * lags * n + n + s->rows + 2 * nodes * s->rows);
    double *memory = malloc(doubles * sizeof *memory + (size_t)(nodes * s->rows) * sizeof(Py_ssize_t)), *next = memory;
    Reading *reads = malloc((size_t)nodes * sizeof *reads);
    if (!memory || !reads) {
        free(memory), free(reads);
        return -1;
    }
    double *steps = next, *x = steps + 4 * lags * n, *u = x + lags * n, *moved = u + lags * n, *column = moved + n;
    next = column + s->rows;
    for (Py_ssize_t k = 0; k < nodes; k++, next += 2 * s->rows)
        reads[k].e = next, reads[k].v = next + s->rows;
    for (Py_ssize_t k = 0; k < nodes; k++)
        reads[k].at = (Py_ssize_t *)next + k * s->rows;
    scan_readings(w, s, reads, steps);
    for (Py_ssize_t j = 0; j < s->valve_count; j++) {
        double travel = position(s->valves + j * VALVE, s->co, n, moved);
        for (Py_ssize_t l = 0; travel > 0 && l < lags; l++) {
            const double *own = steps + 4 * l * n;
            if (s->seconds[l] > 0)
                through_lag(own + 2 * n, own + 3 * n, moved, n, u + l * n);
            else
                memcpy(u + l * n, moved, (size_t)n * sizeof *u);
            through_lag(own, own + n, u + l * n, n, x + l * n);
        }
        for (Py_ssize_t k = 0; k < nodes; k++) {
            Py_ssize_t l = k / s->theta_count;
            s->left[j * nodes + k] = INFINITY, s->gain[j * nodes + k] = 0;
            if (travel > 0)
                scan_node(s, l, reads + k, x + l * n, u + l * n, column, s->left + j * nodes + k,
                          s->gain + j * nodes + k);
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

/* Where lags and dead time are held: what a basis leaves of pv, and what an input in place of co, with the best gain,
 * leaves of that; neither whitened nor with priors. */
typedef struct {
    Work *w;
    int kept;
    double *input, *y, all, lane[2];
} Held;

static Held held_at(Work *w, const double *p, double *input) {
    Problem *q = &w->p;
    Held h = {w, plain_basis(w, p), input, w->target, 0, {0, 0}};
    memcpy(h.y, q->pv, (size_t)q->n * sizeof *h.y);
    leave(w->rotated, h.kept, h.y, q->n);
    h.all = dot(h.y, h.y, q->n);
    q->u = input;
    on_lanes(&w->modes, w->modes.w, h.lane);
    return h;
}

/* Sum of squares with what stands in the input; *gain : in units of the held one. */
static double left_by_input(const Held *h, double *gain) {
    Work *w = h->w;
    Py_ssize_t n = w->p.n;
    run_late(w, 0);
    for (Py_ssize_t i = 0; i < n; i++)
        w->moved[i] = w->gain * (h->lane[0] * w->a[i] + h->lane[1] * w->b[i]);
    lagged(w, w->moved);
    double whole = dot(w->moved, w->moved, n);
    leave(w->rotated, h->kept, w->moved, n);
    double size = dot(w->moved, w->moved, n), along = dot(w->moved, h->y, n);
    *gain = size > NOTHING_NEW * whole ? along / size : 0;
    return size > NOTHING_NEW * whole ? h->all - along * along / size : h->all;
}

static void valve_costs(Work *w, const double *p, const double *valves, Py_ssize_t many, const double *co, double *input,
                        double *out) {
    Held h = held_at(w, p, input);
    double gain;
    for (Py_ssize_t j = 0; j < many; j++) {
        position(valves + j * VALVE, co, w->p.n, input);
        out[j] = left_by_input(&h, &gain);
    }
}

/* Where a slipping valve is (valve/slips.py): at each of its rows it comes loose, goes to co but for a share of the
 * distance, and on with co until that stops, turns, or the next slip. */
static void slipped(const double *rows, Py_ssize_t many, double share, double first, const double *u, Py_ssize_t n,
                    double *out) {
    Py_ssize_t i = 0, end = many ? (Py_ssize_t)rows[0] : n;
    double y = first;
    while (i < end)
        out[i++] = y;
    for (Py_ssize_t j = 0; j < many; j++) {
        double apart = u[i] - y, way = apart > 0 ? 1 : -1;
        end = j + 1 < many ? (Py_ssize_t)rows[j + 1] : n;
        for (int on = 1; on && i < end; i++) {
            y = out[i] = u[i] - share * apart;
            on = i + 1 < n && way * (u[i + 1] - u[i]) > 0;
        }
        while (i < end)
            out[i++] = y;
    }
}

/* slips : how many rows, share and first each. rows : those of all of them, one after the other. out : gain and sum of
 * squares each. */
static void slip_costs(Work *w, const double *p, const double *slips, Py_ssize_t many, const double *rows,
                       const double *co, double *input, double *out) {
    Held h = held_at(w, p, input);
    for (Py_ssize_t j = 0; j < many; j++, slips += 3, rows += (Py_ssize_t)slips[-3]) {
        slipped(rows, (Py_ssize_t)slips[0], slips[1], slips[2], co, w->p.n, input);
        out[2 * j + 1] = left_by_input(&h, out + 2 * j);
    }
}

#endif
