/* A signal as steps through one response, found one by one and moved to where they fit best (valve/plateaus.py,
 * valve/slips.py). */

#ifndef RETUNER_STEPS_H
#define RETUNER_STEPS_H

#include "misfit.h"

enum { MOST_POLES = 4 };
static const double FADED_STEP = 1e-200; /* what is left of a response is nothing below this */

/* Column j is a step at row j + 1: its response from there on. top, bottom : the response is that of the filter (top[0] + top[1] q) /
 * (1 + bottom[0] q + ...) to an impulse; without a filter (poles < 0) it is any other. rest : (rest_count, n), orthonormal, of
 * what is there without any step. A step is a further one where more than `unique` of its column is not explained by the
 * others. */
typedef struct {
    const double *pv, *response, *rest;
    Py_ssize_t n, rest_count, poles;
    double unique, top[2], bottom[MOST_POLES];
} Stepped;

/* Products of a signal with every column: behind a filter each follows from the next ones. */
static void against(const Stepped *s, const double *x, double *out) {
    double one = 0, two = 0, three = 0, four = 0;
    for (Py_ssize_t j = s->n - 2; j >= 0; j--) {
        if (s->poles < 0) {
            out[j] = dot(x + j + 1, s->response, s->n - 1 - j);
            continue;
        }
        double now = x[j + 1] - s->bottom[3] * four - s->bottom[2] * three - s->bottom[1] * two - s->bottom[0] * one;
        now = fabs(now) < FADED_STEP ? 0 : now;
        out[j] = s->top[0] * now + s->top[1] * one;
        four = three, three = two, two = one, one = now;
    }
}

/* Squares of every column. */
static void lay_squares(const Stepped *s, double *out) {
    double sum = 0;
    for (Py_ssize_t k = 0; k + 1 < s->n; k++)
        sum += s->response[k] * s->response[k], out[s->n - 2 - k] = sum;
}

static void put_column(const Stepped *s, Py_ssize_t j, double *out) {
    memset(out, 0, (size_t)(j + 1) * sizeof *out);
    memcpy(out + j + 1, s->response, (size_t)(s->n - 1 - j) * sizeof *out);
}

/* What orthonormal columns leave of a signal, in place. */
static void free_of(const double *basis, Py_ssize_t count, double *x, Py_ssize_t n) {
    for (Py_ssize_t k = 0; k < count; k++)
        add(x, -dot(basis + k * n, x, n), basis + k * n, n);
}

/* Up to `most` steps, each where it takes away most. rows : their columns. left : sums of squares, before the first and
 * after each. Returns how many, -1 without memory. */
static Py_ssize_t choose_steps(const Stepped *s, Py_ssize_t most, double *rows, double *left) {
    Py_ssize_t n = s->n, count = 0;
    double *basis = malloc((size_t)((s->rest_count + most + 5) * n) * sizeof *basis);
    if (!basis)
        return -1;
    double *remainder = basis + (s->rest_count + most) * n, *along = remainder + n, *whole = along + n;
    double *unexplained = whole + n, *told = unexplained + n;
    memcpy(basis, s->rest, (size_t)(s->rest_count * n) * sizeof *basis);
    memcpy(remainder, s->pv, (size_t)n * sizeof *remainder);
    free_of(basis, s->rest_count, remainder, n);
    against(s, remainder, along);
    lay_squares(s, whole), lay_squares(s, unexplained);
    for (Py_ssize_t k = 0; k < s->rest_count; k++) {
        against(s, s->rest + k * n, told);
        for (Py_ssize_t j = 0; j + 1 < n; j++)
            unexplained[j] -= told[j] * told[j];
    }
    left[0] = dot(remainder, remainder, n);
    for (; count < most; count++) {
        double best = 0, *new = basis + (s->rest_count + count) * n;
        Py_ssize_t chosen = -1;
        for (Py_ssize_t j = 0; j + 1 < n; j++)
            told[j] = unexplained[j] > s->unique * whole[j] ? along[j] * along[j] / unexplained[j] : 0;
        for (Py_ssize_t j = 0; j + 1 < n; j++)
            if (told[j] > best)
                best = told[j], chosen = j;
        if (chosen < 0)
            break;
        put_column(s, chosen, new);
        free_of(basis, s->rest_count + count, new, n);
        double size = dot(new, new, n);
        if (!(size > 0))
            break;
        multiply(new, 1 / sqrt(size), n);
        double taken = dot(new, remainder, n);
        add(remainder, -taken, new, n);
        against(s, new, told);
        for (Py_ssize_t j = 0; j + 1 < n; j++)
            along[j] -= taken * told[j], unexplained[j] -= told[j] * told[j];
        rows[count] = (double)chosen, left[count + 1] = dot(remainder, remainder, n);
    }
    free(basis);
    return count;
}

/* Products of all columns but one factored: L of L L', (k, k), and L^-1 of their products with pv. Returns whether they
 * are independent. */
static int factored(const double *products, const double *onto, Py_ssize_t all, Py_ssize_t without, double *l, double *y) {
    for (Py_ssize_t i = 0, row = 0; row < all; row++) {
        if (row == without)
            continue;
        for (Py_ssize_t j = 0, column = 0; j <= i; column++) {
            if (column == without)
                continue;
            double sum = products[row * all + column];
            for (Py_ssize_t k = 0; k < j; k++)
                sum -= l[i * all + k] * l[j * all + k];
            if (i == j && !(sum > 0))
                return 0;
            l[i * all + j] = i == j ? sqrt(sum) : sum / l[j * all + j];
            j++;
        }
        double sum = onto[row];
        for (Py_ssize_t k = 0; k < i; k++)
            sum -= l[i * all + k] * y[k];
        y[i] = sum / l[i * all + i];
        i++;
    }
    return 1;
}

/* What a step in column j takes away beside the others, 0 where it is no further one. told : products of the others and pv with
 * every column. z : room for them. */
static double taken_by(const Stepped *s, const double *told, Py_ssize_t all, Py_ssize_t without, Py_ssize_t j, double size,
                       const double *l, const double *y, double *z) {
    double along = told[all * s->n + j];
    for (Py_ssize_t i = 0, row = 0; row < all; row++) {
        if (row == without)
            continue;
        double sum = told[row * s->n + j];
        for (Py_ssize_t k = 0; k < i; k++)
            sum -= l[i * all + k] * z[k];
        z[i] = sum / l[i * all + i];
        size -= z[i] * z[i], along -= y[i] * z[i];
        i++;
    }
    return size > s->unique * (double)s->n ? along * along / size : 0;
}

/* Puts step i into its column, and what this says of the others and of pv. */
static void put_step(const Stepped *s, Py_ssize_t all, Py_ssize_t mine, Py_ssize_t at, double *columns, double *told,
                     double *products, double *onto) {
    put_column(s, at, columns + mine * s->n);
    against(s, columns + mine * s->n, told + mine * s->n);
    onto[mine] = told[all * s->n + at];
    for (Py_ssize_t j = 0; j < all; j++)
        products[mine * all + j] = products[j * all + mine] = told[j * s->n + at];
}

/* Every step at its best column within `reach`, the others held where they are, so many times. Returns what is left,
 * negative without memory. */
static double move_steps(const Stepped *s, double *rows, Py_ssize_t count, Py_ssize_t reach, int passes) {
    Py_ssize_t n = s->n, rest = s->rest_count, all = rest + count;
    double *columns = calloc((size_t)((2 * all + 3) * n + 2 * all * all + 3 * all), sizeof *columns);
    if (!columns)
        return -1;
    double *told = columns + all * n, *left = told + (all + 1) * n, *sizes = left + n, *products = sizes + n;
    double *l = products + all * all, *onto = l + all * all, *y = onto + all, *z = y + all;
    memcpy(columns, s->rest, (size_t)(rest * n) * sizeof *columns);
    lay_squares(s, sizes), against(s, s->pv, told + all * n);
    for (Py_ssize_t i = 0; i < rest; i++) {
        against(s, columns + i * n, told + i * n);
        onto[i] = dot(columns + i * n, s->pv, n), products[i * all + i] = 1;
    }
    for (Py_ssize_t i = rest; i < all; i++)
        put_step(s, all, i, (Py_ssize_t)rows[i - rest], columns, told, products, onto);
    for (Py_ssize_t turn = 0; turn < passes * count; turn++) {
        Py_ssize_t i = turn % count, mine = rest + i, at = (Py_ssize_t)rows[i], chosen = -1;
        Py_ssize_t first = at > reach ? at - reach : 0, end = at + reach + 1 < n - 1 ? at + reach + 1 : n - 1;
        double best = 0;
        if (!factored(products, onto, all, mine, l, y))
            continue;
        for (Py_ssize_t j = first; j < end; j++) {
            double taken = taken_by(s, told, all, mine, j, sizes[j], l, y, z);
            if (taken > best)
                best = taken, chosen = j;
        }
        if (chosen >= 0)
            rows[i] = (double)chosen, put_step(s, all, mine, chosen, columns, told, products, onto);
    }
    memcpy(left, s->pv, (size_t)n * sizeof *left);
    for (Py_ssize_t i = 0; i < all; i++) {
        double *column = columns + i * n;
        free_of(columns, i, column, n), free_of(columns, i, column, n);
        double size = dot(column, column, n);
        multiply(column, size > 0 ? 1 / sqrt(size) : 0, n);
        free_of(column, 1, left, n);
    }
    double found = dot(left, left, n);
    free(columns);
    return found;
}

#endif
