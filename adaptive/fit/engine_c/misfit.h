/* The linear unknowns projected out, the Jacobian of what is left, and what a solution shows (misfit.py, changes.py). */

#ifndef RETUNER_MISFIT_H
#define RETUNER_MISFIT_H

#include "lanes.h"

static const double USEFUL = 1e-10, NOTHING_NEW = 1e-12; /* misfit.py, valve/valve_fit.py */

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

/* `add`, and the `dot` of another vector with what comes of it, bit for bit. */
WIDE static double add_then_dot(double *restrict y, double k, const double *restrict x, const double *restrict z,
                                Py_ssize_t n) {
    double s[8] = {0};
    Py_ssize_t i = 0;
    for (; i + 8 <= n; i += 8)
        for (int j = 0; j < 8; j++) {
            double now = y[i + j] + k * x[i + j];
            y[i + j] = now, s[j] += z[i + j] * now;
        }
    for (; i < n; i++) {
        y[i] += k * x[i];
        s[0] += z[i] * y[i];
    }
    return ((s[0] + s[4]) + (s[1] + s[5])) + ((s[2] + s[6]) + (s[3] + s[7]));
}

/* The reflections of the first columns on a vector, one after the other; while one acts the next one is measured. */
static void rotate(const double *a, Py_ssize_t rows, int columns, const double *beta, double *y) {
    int j = 0, next;
    while (j < columns && beta[j] == 0)
        j++;
    double along = j < columns ? dot(a + j * rows + j + 1, y + j + 1, rows - j - 1) : 0;
    for (; j < columns; j = next) {
        const double *v = a + j * rows;
        double d = beta[j] * (y[j] + along);
        y[j] -= d;
        for (next = j + 1; next < columns && beta[next] == 0; next++)
            ;
        Py_ssize_t from = next < columns ? next + 1 : rows;
        add(y + j + 1, -d, v + j + 1, from - j - 1);
        if (next < columns)
            along = add_then_dot(y + from, -d, v + from, a + next * rows + from, rows - from);
    }
}

/* Householder's decomposition of the columns in place: the triangle above, the reflections below the diagonal. */
static void decompose(double *a, Py_ssize_t rows, int columns, double *beta) {
    for (int j = 0; j < columns; j++) {
        double *v = a + j * rows;
        rotate(a, rows, j, beta, v);
        double alpha = v[j], size = sqrt(dot(v + j + 1, v + j + 1, rows - j - 1));
        beta[j] = 0;
        if (size > 0) {
            double diagonal = -copysign(hypot(alpha, size), alpha);
            beta[j] = (diagonal - alpha) / diagonal;
            multiply(v + j + 1, 1 / (alpha - diagonal), rows - j - 1);
            v[j] = diagonal;
        }
    }
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
    lagged(w, w->moved);
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
    if (w->third > 0) {
        memset(w->scratch, 0, (size_t)w->p.n * sizeof *w->scratch);
        add_form(w, basis, f, w->scratch);
        if (other)
            add_form(w, other, g, w->scratch);
        lagged(w, w->scratch);
        add(change, share, w->scratch, w->p.n);
        add(change, -w->c[k] * (w->scratch[w->peak_at[k]] / peak), w->column + k * w->p.n, w->p.n);
        return;
    }
    double rise = form_at(w, basis, f, w->peak_at[k]);
    add_form(w, basis, scaled_form(f, share), change);
    if (other) {
        rise += form_at(w, other, g, w->peak_at[k]);
        add_form(w, other, scaled_form(g, share), change);
    }
    add(change, -w->c[k] * (rise / peak), w->column + k * w->p.n, w->p.n);
}

static const Form NO_FORM = {0};

/* By ln T (q = 0), ln c2 (q = 1) or ln b (q = 2). */
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
    lagged(w, change);
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
        add_change(w, k++, &w->basis[2 * p->starts + j], is_corner(p, j) ? ramp : load, NULL, NO_FORM, change);
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
    lagged(w, change);
    Form rise = scaled_form(impulse_form(m), -w->theta), step = scaled_form(step_form(m), w->theta);
    int k = p->starts * (1 + (SECOND[p->type] >= 0));
    for (int j = 0; p->motion && j < p->starts; j++) {
        const Basis *late = &w->basis[p->starts + j];
        add_change(w, k++, late, rise, NULL, NO_FORM, change);
        add_change(w, k++, late, step, NULL, NO_FORM, change);
    }
}

static int first_load(const Problem *p) { return p->priors; }

/* By ln d of the third lag: what it takes away is what it would take away once more. */
static void change_by_third(Work *w, double *change) {
    const Problem *p = &w->p;
    memcpy(change, w->moved, (size_t)p->n * sizeof *change);
    lagged(w, change), add(change, -1, w->moved, p->n);
    for (int k = 0; k < p->priors + p->loads; k++) {
        const double *column = w->column + k * p->n;
        if ((p->ramp && k == p->priors - 1) || w->peak[k] == 0)
            continue;
        memcpy(w->scratch, column, (size_t)p->n * sizeof *w->scratch);
        lagged(w, w->scratch), add(w->scratch, -1, column, p->n);
        add(change, w->c[k], w->scratch, p->n);
        add(change, -w->c[k] * w->scratch[w->peak_at[k]] / column[w->peak_at[k]], column, p->n);
    }
}

static void change_by_load_time(Work *w, int j, double *change) {
    Form rise = is_corner(&w->p, j) ? step_form(&w->modes)
                : w->p.rounded      ? rounded_rise(&w->load_modes, w->rate)
                                    : impulse_form(&w->modes);
    memset(change, 0, (size_t)w->p.n * sizeof *change);
    add_change(w, first_load(&w->p) + j, &w->basis[2 * w->p.starts + j], scaled_form(rise, -1), NULL, NO_FORM, change);
}

static void change_by_load_lag(Work *w, double *change) {
    Form slope = rounded_by_lag(&w->load_modes, w->rate);
    memset(change, 0, (size_t)w->p.n * sizeof *change);
    for (int j = 0; j < w->p.loads - w->p.corners; j++)
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
    else if (j == THIRD[p->type])
        change_by_third(w, change);
    else if (j < d)
        change_by_dynamics(w, j == INVERSE[p->type] ? 2 : j == SECOND[p->type], change);
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

/* By how much a further load step, or a corner, at each instant would lower n ln sigma^2, everything nonlinear held.
 * q : (columns, rows), r : (rows + 1), of the solution at p. */
static void load_gains(Work *w, const double *q, const double *r, const double *at, Py_ssize_t many, int corner,
                       double *out) {
    static const double UNIQUE = 1e-9;
    const Problem *p = &w->p;
    Py_ssize_t n = p->n;
    double *lane = w->change, *whitened = w->scratch, all = dot(r, r, n);
    Form form = corner ? ramp_form(&w->modes) : step_form(&w->modes);
    for (Py_ssize_t k = 0; k < many; k++) {
        Basis basis = {at[k], first_at(p, at[k]), lane, w->target, lane};
        memset(w->moved, 0, (size_t)n * sizeof *w->moved);
        run_step(p, &w->modes, w->steps, basis.a, basis.b, at[k], basis.first);
        add_form(w, &basis, form, w->moved);
        lagged(w, w->moved);
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

#endif
