/* The numbers of a whole record for an audit (adaptive/audit/record_sums.py says what each is): two runs over the
 * samples, the first for levels and extremes, the second for all that is counted against them. */

#ifndef RETUNER_SCREEN_H
#define RETUNER_SCREEN_H

#include "modes.h"

enum { LAGS = 20, BLOCK = 2048 };

/* Samples at one extreme of co: how many, in how many runs, how many of these are long, and the longest; for how long,
 * and the integrals of the error and of its magnitude meanwhile. */
typedef struct {
    double samples, runs, long_runs, longest, held, error, size;
} Extreme;

typedef struct {
    double held, gaps, error_mean, error_variance, size, travel, turns, moves, pv_low, pv_high, pv_variance, straight,
        repeated, sp_moves, sp_low, sp_high, still, co_low, co_high, pv_slow, co_slow;
    Extreme low, high;
    double covariance[LAGS + 1];
} Sums;

enum { SUMS = sizeof(Sums) / sizeof(double), LONG_RUN = 5 };
static const double STRAIGHT_PART = 1e-6;

/* A run at an extreme has ended, or has not begun. */
static void end_run(Extreme *e, double run) {
    if (run > 0) {
        e->runs += 1;
        e->long_runs += run >= LONG_RUN;
        e->longest = fmax(e->longest, run);
    }
}

static void at_extreme(Extreme *e, double *run, double held, double error) {
    *run += 1, e->samples += 1;
    e->held += held, e->error += error * held, e->size += fabs(error) * held;
}

/* Levels and extremes; the mean of pv into *pv_mean. */
WIDE static void levels(const double *sp, const double *pv, const double *co, Py_ssize_t n, Sums *s, double *pv_mean) {
    double e0 = sp[0] - pv[0], p0 = pv[0], e = 0, p = 0;
    s->pv_low = s->pv_high = pv[0], s->co_low = s->co_high = co[0], s->sp_low = s->sp_high = sp[0];
    for (Py_ssize_t i = 0; i < n; i++) {
        e += sp[i] - pv[i] - e0, p += pv[i] - p0;
        s->pv_low = pv[i] < s->pv_low ? pv[i] : s->pv_low, s->pv_high = pv[i] > s->pv_high ? pv[i] : s->pv_high;
        s->co_low = co[i] < s->co_low ? co[i] : s->co_low, s->co_high = co[i] > s->co_high ? co[i] : s->co_high;
        s->sp_low = sp[i] < s->sp_low ? sp[i] : s->sp_low, s->sp_high = sp[i] > s->sp_high ? sp[i] : s->sp_high;
    }
    s->error_mean = e0 + e / (double)n, *pv_mean = p0 + p / (double)n;
}

/* Standard deviation of the means of `width` samples (one more where that is even) round every width-th one. */
static double slow_std(const double *x, Py_ssize_t n, Py_ssize_t width) {
    Py_ssize_t half = width / 2, many = 0;
    double sum = 0, squares = 0;
    for (Py_ssize_t at = half; at < n; at += width, many++) {
        Py_ssize_t begin = at - half < 0 ? 0 : at - half, end = at + half + 1 > n ? n : at + half + 1;
        double mean = 0;
        for (Py_ssize_t i = begin; i < end; i++)
            mean += x[i] - x[0];
        mean /= (double)(end - begin);
        sum += mean, squares += mean * mean;
    }
    double level = many ? sum / (double)many : 0;
    return many ? sqrt(fmax(squares / (double)many - level * level, 0)) : 0;
}

/* Sums of e_i e_(i-j) for samples begin to end; e : the error without its mean, LAGS samples more in front. */
WIDE static void covariances(const double *e, Py_ssize_t begin, Py_ssize_t end, double *sums) {
    for (Py_ssize_t i = begin; i < end; i++)
        for (int j = 0; j <= LAGS; j++)
            sums[j] += e[i] * e[i - LAGS + j];
}

static void error_moments(const double *sp, const double *pv, Py_ssize_t n, Sums *s) {
    double e[BLOCK + LAGS] = {0}, sums[LAGS + 1] = {0};
    for (Py_ssize_t first = 0; first < n; first += BLOCK) {
        Py_ssize_t many = n - first < BLOCK ? n - first : BLOCK;
        memmove(e, e + BLOCK, LAGS * sizeof *e);
        for (Py_ssize_t i = 0; i < many; i++)
            e[LAGS + i] = sp[first + i] - pv[first + i] - s->error_mean;
        covariances(e, LAGS, LAGS + many, sums);
    }
    for (int j = 0; j <= LAGS; j++)
        s->covariance[j] = n > j ? sums[LAGS - j] / (double)(n - j) : 0;
    s->error_variance = s->covariance[0];
}

/* What a record is counted against: the longest interval that counts, s; the band of co's noise, 0 where every move
 * counts; the fewest intervals in which co stands still; the samples of a mean. */
typedef struct {
    double longest, band, shortest;
    Py_ssize_t width;
} Measure;

WIDE static void counted(const double *restrict t, const double *restrict sp, const double *restrict pv,
                         const double *restrict co, Py_ssize_t n, const Measure *by, double pv_mean,
                         Sums *restrict s) {
    double longest = by->longest, band = by->band, shortest = by->shortest;
    double enough = STRAIGHT_PART * (s->pv_high - s->pv_low), step = 0, way = 0, level = 0, squares = 0;
    double still = 0, low = 0, high = 0;
    for (Py_ssize_t i = 0; i < n; i++) {
        double error = sp[i] - pv[i], held = 0;
        squares += (pv[i] - pv_mean) * (pv[i] - pv_mean);
        if (i + 1 < n) {
            double dt = t[i + 1] - t[i], next = pv[i + 1] - pv[i], move = co[i + 1] - co[i];
            held = dt < longest ? dt : longest, s->held += held, s->gaps += dt > longest, s->size += fabs(error) * held;
            s->travel += fabs(move), s->moves += move != 0, s->sp_moves += sp[i + 1] != sp[i];
            s->repeated += next == 0, s->straight += i > 0 && fabs(next - step) <= enough;
            step = next;
            if (move != 0) {
                s->still += still >= shortest ? still : 0;
                still = 0;
            } else
                still += 1;
            double to = band > 0 ? nearbyint((co[i + 1] - co[0]) / band) : co[i + 1], on = band > 0 ? to - level : move;
            s->turns += on * way < 0;
            way = on > 0 ? 1 : on < 0 ? -1 : way;
            level = to;
        }
        if (co[i] == s->co_low)
            at_extreme(&s->low, &low, held, error);
        else
            end_run(&s->low, low), low = 0;
        if (co[i] == s->co_high)
            at_extreme(&s->high, &high, held, error);
        else
            end_run(&s->high, high), high = 0;
    }
    end_run(&s->low, low), end_run(&s->high, high);
    s->still += still >= shortest ? still : 0;
    s->pv_variance = squares / (double)n;
}

static void screen(const double *t, const double *sp, const double *pv, const double *co, Py_ssize_t n,
                   const Measure *by, Sums *s) {
    double pv_mean;
    memset(s, 0, sizeof *s);
    levels(sp, pv, co, n, s, &pv_mean);
    error_moments(sp, pv, n, s);
    counted(t, sp, pv, co, n, by, pv_mean, s);
    s->pv_slow = slow_std(pv, n, by->width), s->co_slow = slow_std(co, n, by->width);
}

#endif
