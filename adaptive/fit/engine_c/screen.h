/* The numbers of a whole record for an audit (adaptive/audit/record_sums.py says what each is): levels and
 * extremes first, then all that is counted against them; what can be added in any order is on eight lanes. */

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

/* Least and greatest of x, shape (n,), and the sum of x - zero, each on eight lanes whose order is fixed. */
WIDE static void range_and_sum(const double *restrict x, Py_ssize_t n, double zero, double *least, double *most,
                               double *sum) {
    double low[8], high[8], sums[8] = {0};
    Py_ssize_t whole = n - n % 8;
    for (int j = 0; j < 8; j++)
        low[j] = high[j] = x[0];
    for (Py_ssize_t i = 0; i < whole; i += 8)
        for (int j = 0; j < 8; j++) {
            double at = x[i + j];
            low[j] = at < low[j] ? at : low[j], high[j] = at > high[j] ? at : high[j], sums[j] += at - zero;
        }
    for (Py_ssize_t i = whole; i < n; i++)
        low[0] = fmin(x[i], low[0]), high[0] = fmax(x[i], high[0]), sums[0] += x[i] - zero;
    *least = low[0], *most = high[0], *sum = 0;
    for (int j = 0; j < 8; j++)
        *least = fmin(low[j], *least), *most = fmax(high[j], *most), *sum += sums[j];
}

/* Levels and extremes; the mean of pv into *pv_mean. */
static void levels(const double *sp, const double *pv, const double *co, Py_ssize_t n, Sums *s, double *pv_mean) {
    double of_sp, of_pv, of_co;
    range_and_sum(sp, n, sp[0], &s->sp_low, &s->sp_high, &of_sp);
    range_and_sum(pv, n, pv[0], &s->pv_low, &s->pv_high, &of_pv);
    range_and_sum(co, n, co[0], &s->co_low, &s->co_high, &of_co);
    s->error_mean = sp[0] - pv[0] + (of_sp - of_pv) / (double)n, *pv_mean = pv[0] + of_pv / (double)n;
}

/* The sum of x - zero, shape (n,), on eight lanes. */
WIDE static double sum_from(const double *restrict x, Py_ssize_t n, double zero) {
    double sums[8] = {0}, all = 0;
    Py_ssize_t whole = n - n % 8;
    for (Py_ssize_t i = 0; i < whole; i += 8)
        for (int j = 0; j < 8; j++)
            sums[j] += x[i + j] - zero;
    for (Py_ssize_t i = whole; i < n; i++)
        all += x[i] - zero;
    for (int j = 0; j < 8; j++)
        all += sums[j];
    return all;
}

/* Standard deviation of the means of `width` samples (one more where that is even) round every width-th one. */
static double slow_std(const double *x, Py_ssize_t n, Py_ssize_t width) {
    Py_ssize_t half = width / 2, many = 0;
    double sum = 0, squares = 0;
    for (Py_ssize_t at = half; at < n; at += width, many++) {
        Py_ssize_t begin = at - half < 0 ? 0 : at - half, end = at + half + 1 > n ? n : at + half + 1;
        double mean = sum_from(x + begin, end - begin, x[0]) / (double)(end - begin);
        sum += mean, squares += mean * mean;
    }
    double level = many ? sum / (double)many : 0;
    return many ? sqrt(fmax(squares / (double)many - level * level, 0)) : 0;
}

static void error_moments(const double *sp, const double *pv, Py_ssize_t n, Sums *s) {
    double e[BLOCK + LAGS] = {0}, sums[LAGS + 1] = {0};
    for (Py_ssize_t first = 0; first < n; first += BLOCK) {
        Py_ssize_t many = n - first < BLOCK ? n - first : BLOCK;
        memmove(e, e + BLOCK, LAGS * sizeof *e);
        for (Py_ssize_t i = 0; i < many; i++)
            e[LAGS + i] = sp[first + i] - pv[first + i] - s->error_mean;
        for (int j = 0; j <= LAGS; j++)
            sums[j] += dot(e + LAGS, e + LAGS - j, many);
    }
    for (int j = 0; j <= LAGS; j++)
        s->covariance[j] = n > j ? sums[j] / (double)(n - j) : 0;
    s->error_variance = s->covariance[0];
}

/* What a record is counted against: the longest interval that counts, s; the band of co's noise, 0 where every move
 * counts; the fewest intervals in which co stands still; the samples of a mean. */
typedef struct {
    double longest, band, shortest;
    Py_ssize_t width;
} Measure;

/* What needs no memory of the samples before, on eight running sums whose order is fixed; of intervals that are not the
 * first, so that a step of pv has one before it. */
enum {
    SUM_HELD,
    SUM_GAPS,
    SUM_SIZE,
    SUM_TRAVEL,
    SUM_MOVES,
    SUM_SP_MOVES,
    SUM_REPEATED,
    SUM_STRAIGHT,
    SUM_SQUARES,
    SUM_KINDS
};

WIDE static void added(const double *restrict t, const double *restrict sp, const double *restrict pv,
                       const double *restrict co, Py_ssize_t many, double longest, double enough, double pv_mean,
                       double sums[SUM_KINDS][8]) {
    for (Py_ssize_t i = 0; i < many; i += 8)
        for (int j = 0; j < 8; j++) {
            Py_ssize_t at = i + j;
            double dt = t[at + 1] - t[at], next = pv[at + 1] - pv[at], move = co[at + 1] - co[at];
            double held = dt < longest ? dt : longest, level = pv[at] - pv_mean;
            sums[SUM_HELD][j] += held, sums[SUM_GAPS][j] += dt > longest ? 1.0 : 0.0;
            sums[SUM_SIZE][j] += fabs(sp[at] - pv[at]) * held, sums[SUM_TRAVEL][j] += fabs(move);
            sums[SUM_MOVES][j] += move != 0 ? 1.0 : 0.0, sums[SUM_SP_MOVES][j] += sp[at + 1] != sp[at] ? 1.0 : 0.0;
            sums[SUM_REPEATED][j] += next == 0 ? 1.0 : 0.0;
            sums[SUM_STRAIGHT][j] += fabs(next - (pv[at] - pv[at - 1])) <= enough ? 1.0 : 0.0;
            sums[SUM_SQUARES][j] += level * level;
        }
}

/* The intervals by eights, the first one and those that are left over by themselves. */
static void add_up(const double *t, const double *sp, const double *pv, const double *co, Py_ssize_t n,
                   const Measure *by, double pv_mean, Sums *s) {
    double sums[SUM_KINDS][8] = {{0}}, all[SUM_KINDS] = {0}, enough = STRAIGHT_PART * (s->pv_high - s->pv_low);
    Py_ssize_t whole = (n - 2) - (n - 2) % 8;
    added(t + 1, sp + 1, pv + 1, co + 1, whole, by->longest, enough, pv_mean, sums);
    for (int k = 0; k < SUM_KINDS; k++)
        for (int j = 0; j < 8; j++)
            all[k] += sums[k][j];
    for (Py_ssize_t i = 0; i < n; i = i == 0 ? whole + 1 : i + 1) {
        all[SUM_SQUARES] += (pv[i] - pv_mean) * (pv[i] - pv_mean);
        if (i + 1 == n)
            break;
        double dt = t[i + 1] - t[i], next = pv[i + 1] - pv[i], move = co[i + 1] - co[i];
        double held = dt < by->longest ? dt : by->longest;
        all[SUM_HELD] += held, all[SUM_GAPS] += dt > by->longest, all[SUM_SIZE] += fabs(sp[i] - pv[i]) * held;
        all[SUM_TRAVEL] += fabs(move), all[SUM_MOVES] += move != 0, all[SUM_SP_MOVES] += sp[i + 1] != sp[i];
        all[SUM_REPEATED] += next == 0, all[SUM_STRAIGHT] += i > 0 && fabs(next - (pv[i] - pv[i - 1])) <= enough;
    }
    s->held = all[SUM_HELD], s->gaps = all[SUM_GAPS], s->size = all[SUM_SIZE], s->travel = all[SUM_TRAVEL];
    s->moves = all[SUM_MOVES], s->sp_moves = all[SUM_SP_MOVES], s->repeated = all[SUM_REPEATED];
    s->straight = all[SUM_STRAIGHT];
    s->pv_variance = all[SUM_SQUARES] / (double)n;
}

/* Way of co over each of many intervals, moves within the band not counted: -1, 0, 1. */
WIDE static void ways(const double *restrict co, double zero, double band, Py_ssize_t many, int32_t *restrict way) {
    double level[BLOCK + 1];
    for (Py_ssize_t i = 0; i <= many; i++)
        level[i] = band > 0 ? rint((co[i] - zero) / band) : co[i];
    for (Py_ssize_t i = 0; i < many; i++)
        way[i] = (level[i + 1] > level[i]) - (level[i + 1] < level[i]);
}

/* Turns of co, and how long it stands still: a long stretch counts whole. Masks stand for branches that noise would
 * make unforeseeable. */
static void turns_and_stills(const double *co, Py_ssize_t n, const Measure *by, Sums *s) {
    int32_t way[BLOCK], last = 0, turned = 0;
    Py_ssize_t since = 0, shortest = (Py_ssize_t)ceil(fmin(by->shortest, (double)n)), stood = 0;
    for (Py_ssize_t first = 0; first < n - 1; first += BLOCK) {
        Py_ssize_t many = n - 1 - first < BLOCK ? n - 1 - first : BLOCK;
        ways(co + first, co[0], by->band, many, way);
        for (Py_ssize_t i = 0; i < many; i++) {
            int32_t moved = -(way[i] != 0);
            turned += way[i] * last < 0;
            last = (last & ~moved) | (way[i] & moved);
        }
        for (Py_ssize_t i = first; i < first + many; i++) {
            Py_ssize_t moved = -(Py_ssize_t)(co[i + 1] != co[i]), stands = i - since;
            stood += stands & moved & -(Py_ssize_t)(stands >= shortest);
            since = (since & ~moved) | ((i + 1) & moved);
        }
    }
    stood += n - 1 - since >= shortest ? n - 1 - since : 0;
    s->still = (double)stood, s->turns = (double)turned;
}

/* Samples at the extremes of co. */
static void extremes(const double *restrict t, const double *restrict sp, const double *restrict pv,
                     const double *restrict co, Py_ssize_t n, double longest, Sums *restrict s) {
    double low = 0, high = 0, lowest = s->co_low, highest = s->co_high;
    for (Py_ssize_t i = 0; i < n; i++) {
        int is_low = co[i] == lowest, is_high = co[i] == highest;
        if (!(is_low | is_high) && low + high == 0)
            continue;
        double dt = i + 1 < n ? t[i + 1] - t[i] : 0, held = dt < longest ? dt : longest, error = sp[i] - pv[i];
        if (is_low)
            at_extreme(&s->low, &low, held, error);
        else
            end_run(&s->low, low), low = 0;
        if (is_high)
            at_extreme(&s->high, &high, held, error);
        else
            end_run(&s->high, high), high = 0;
    }
    end_run(&s->low, low), end_run(&s->high, high);
}

static void screen(const double *t, const double *sp, const double *pv, const double *co, Py_ssize_t n,
                   const Measure *by, Sums *s) {
    double pv_mean;
    memset(s, 0, sizeof *s);
    levels(sp, pv, co, n, s, &pv_mean);
    error_moments(sp, pv, n, s);
    add_up(t, sp, pv, co, n, by, pv_mean, s);
    turns_and_stills(co, n, by, s);
    extremes(t, sp, pv, co, n, by->longest, s);
    s->pv_slow = slow_std(pv, n, by->width), s->co_slow = slow_std(co, n, by->width);
}

#endif
