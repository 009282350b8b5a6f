/* Process, load that wanders and noise: whitened least squares, likelihoods of gains (explanations/wandering_load.py). */

#ifndef RETUNER_WALK_H
#define RETUNER_WALK_H

#include "misfit.h"

enum { LANES = 8, STRETCH = 64, MOST_DEGREE = 3, MOST_FALLS = 4, MOST_TONES = 12, MOST_DEADS = 64, MOST_MIXED = 128 };
enum { MOST_BASIS = 1 + MOST_DEGREE + MOST_FALLS + MOST_TONES, MOST_STARTED = MOST_DEGREE + MOST_FALLS, STARTED = 8 };
enum { DEGREE, ROOTS, BOTTOM = ROOTS + MOST_DEGREE, LOAD = BOTTOM + MOST_DEGREE };
static const double SILENT = 1e-200;          /* what is left in a filter is nothing below this */
static const double FADED = 1e-20;            /* what is left of a start is nothing below this: it began at 1 */
static const double DEPENDENT_SHARE = 1e-10;  /* less of a column than this is round-off: the others have it already */
static const double LEAST_SHARE = 1e-12, LEAST_INFORMATION = 1e-300, SILENT_SHARE = -40, LEAST_POWER = -700;
enum { STEP_COST = 64 }; /* columns are as dear as one step in a row for each so many samples */
static const double LN2_HIGH = 6.93147180369123816490e-01, LN2_LOW = 1.90821492927058770002e-10;

#if defined(__GNUC__)
typedef double Four __attribute__((vector_size(4 * sizeof(double)), aligned(sizeof(double)), may_alias));
enum { WIDTH = 4 };
#else
typedef double Four;
enum { WIDTH = 1 };
#endif

/* A = (1 - root q)(1 - root q)..., C = 1 + bottom q + ...: loads are rows of degree, roots, bottom. The inputs, held from
 * sample to sample, go through a first lag (pole, rise) and each second one (seconds: poles, 0 for none). A pole over 1 runs
 * away: its inputs are laid free of it, as A makes them, for what grows leaves no digits to subtract. falls : poles
 * of what unknown starts of lags add. tones : sinusoids that the load may hold besides, (tone_count, n); a filter
 * makes of one the same one turned, and starts. ends : so many of them are taken, none first. noise : what pv cannot show,
 * squared, a sample. smoothing : of a recorder that made pv and inputs 1 + smoothing q of what they were. rise : 0 for inputs
 * that are behind the lags already. Answers: shape (load_count, end_count, second_count, input_count, dead_count). */
typedef struct {
    const double *pv, *inputs, *loads, *seconds, *falls, *deads, *tones, *ends;
    Py_ssize_t n, input_count, load_count, second_count, fall_count, dead_count, tone_count, end_count;
    double pole, rise, noise, smoothing;
    double *gain, *information, *left;
} Walk;

/* source : what does not depend on the load, (2 + fall_count + seconds by inputs, n): pv, the impulse, falls, inputs out of
 * the lags.
 * reduced : through A, LANES abreast, (blocks, n, LANES): pv, the impulse, the `free` falls whose poles A lacks, inputs;
 * twice, for two loads at once, where they fill half a block. Whitened, a load each: the impulses (wide), the rows of the
 * inputs, each with `pad` zeros before it, and the bases, `base` numbers apart: columns of n and zeros (wide), pv first, so
 * many that LANES divides it. columns : of the basis; it is nothing after `reach` but in pv. starts : columns that are not
 * zero, without pv's. tones : orthonormal among themselves (own : their squares, 1 or 0), whatever the load. What they add to
 * its starts follows from their products with these and with each other (with), as Cholesky's factor does; scale : 1 over its
 * diagonal, 0 where the others have a tone already. toned : pv along the starts, 0, and along what each tone adds. next : rows
 * of the starts' columns follow from the rows before, by this matrix, as the states of a filter do; last : their last row. */
typedef struct {
    Py_ssize_t pad, wide, base, inputs, columns, reach, starts, free;
    int at_once, fall[MOST_FALLS];
    double *source, *reduced, *impulse, *rows, *basis, *tones, *sums, *memory;
    double own[MOST_TONES], with[MOST_TONES][MOST_BASIS], scale[MOST_TONES], toned[MOST_BASIS];
    double next[MOST_STARTED][STARTED], last[STARTED];
} Lanes;

/* What held inputs do at gain one through the lags, for `many` rows from one on, in steps that do not wait for each other. */
static void through_lags(const Walk *w, Py_ssize_t row, int many, double *out) {
    double first[LANES] = {0}, last[LANES] = {0}, other[LANES], stays = w->pole > 1 ? 0 : w->pole, rise = w->rise;
    const double *u[LANES];
    for (int l = 0; l < many; l++)
        u[l] = w->inputs + (row + l) % w->input_count * w->n, other[l] = w->seconds[(row + l) / w->input_count];
    for (Py_ssize_t start = 0; start < w->n; start += STRETCH) {
        for (Py_ssize_t i = start; i < w->n && i < start + STRETCH; i++)
            for (int l = 0; l < many; l++) {
                last[l] = other[l] * last[l] + (1 - other[l]) * first[l];
                first[l] = stays * first[l] + rise * u[l][i];
                out[l * w->n + i] = last[l];
            }
        for (int l = 0; l < many; l++) {
            first[l] = fabs(first[l]) < SILENT ? 0 : first[l];
            last[l] = fabs(last[l]) < SILENT ? 0 : last[l];
        }
    }
}

/* Through 1/(1 + smoothing q) in place. */
static void unsmooth(const Walk *w, double *x) {
    for (Py_ssize_t i = 1; w->smoothing > 0 && i < w->n; i++)
        x[i] -= w->smoothing * x[i - 1];
}

static void lay_sources(const Walk *w, Lanes *lanes) {
    double *inputs = lanes->source + (2 + w->fall_count) * w->n;
    memcpy(lanes->source, w->pv, (size_t)w->n * sizeof *w->pv), unsmooth(w, lanes->source);
    memset(lanes->source + w->n, 0, (size_t)w->n * sizeof *w->pv), lanes->source[w->n] = 1;
    for (Py_ssize_t k = 0; k < w->fall_count; k++) {
        double *fall = lanes->source + (2 + k) * w->n, now = 1;
        for (Py_ssize_t i = 0; i < w->n; i++, now = now > SILENT ? now * w->falls[k] : 0)
            fall[i] = now;
    }
    for (Py_ssize_t row = 0; w->rise > 0 && row < lanes->inputs; row += LANES)
        through_lags(w, row, row + LANES < lanes->inputs ? LANES : (int)(lanes->inputs - row), inputs + row * w->n);
    if (!(w->rise > 0))
        memcpy(inputs, w->inputs, (size_t)(lanes->inputs * w->n) * sizeof *inputs);
    for (Py_ssize_t row = 0; row < lanes->inputs; row++)
        unsmooth(w, inputs + row * w->n);
}

/* Signals side by side, each through three factors 1 - root q. root : (MOST_DEGREE, LANES). out : (n, LANES). */
WIDE static void reduce(const double *const *x, Py_ssize_t n, const double *restrict root, double *restrict out) {
    double before[MOST_DEGREE * LANES] = {0};
    for (Py_ssize_t i = 0; i < n; i++, out += LANES) {
        for (int l = 0; l < LANES; l++)
            out[l] = x[l][i];
        for (int j = 0; j < MOST_DEGREE * LANES; j += LANES)
            for (int l = 0; l < LANES; l++) {
                double now = out[l];
                out[l] = now - root[j + l] * before[j + l], before[j + l] = now;
            }
    }
}

/* All that a load's A makes of the sources. What falls at a pole of A is what the impulse is already. */
static void lay_reduced(const Walk *w, Lanes *lanes, const double *load) {
    int degree = (int)load[DEGREE], known;
    lanes->free = 0;
    for (int k = 0; k < (int)w->fall_count; k++) {
        for (known = 0; known < degree && load[ROOTS + known] != w->falls[k];)
            known++;
        if (known == degree)
            lanes->fall[lanes->free++] = k;
    }
    Py_ssize_t n = w->n, first = 2 + lanes->free, signals = first + lanes->inputs;
    lanes->at_once = 2 * signals <= LANES ? 2 : 1;
    for (Py_ssize_t begin = 0; begin < signals; begin += LANES) {
        const double *x[LANES];
        double root[MOST_DEGREE * LANES] = {0};
        for (int l = 0; l < LANES; l++) {
            Py_ssize_t s = lanes->at_once > 1 ? l % (LANES / 2) : begin + l;
            s = s < signals ? s : 0;
            x[l] = lanes->source + (s < 2 ? s : s < first ? 2 + lanes->fall[s - 2] : 2 + w->fall_count + s - first) * n;
            for (int j = s >= first && w->pole > 1; s != 1 && j < degree; j++)
                root[j * LANES + l] = load[ROOTS + j];
        }
        reduce(x, n, root, lanes->reduced + begin * n);
    }
}

/* 1/C on each lane. bottom : (MOST_DEGREE, LANES). out : where each lane goes, NULL for nowhere. */
WIDE static void through_bottom(const double *restrict x, Py_ssize_t n, const double *restrict bottom, double **out) {
    double one[LANES] = {0}, two[LANES] = {0}, three[LANES] = {0}, kept[STRETCH * LANES];
    for (Py_ssize_t start = 0; start < n; start += STRETCH) {
        Py_ssize_t many = n - start < STRETCH ? n - start : STRETCH;
        for (int l = 0; l < LANES; l += 2 * WIDTH) { /* two that do not wait for each other */
            const double *from = x + start * LANES + l, *low = bottom + l, *high = low + WIDTH;
            Four u1 = *(Four *)(one + l), u2 = *(Four *)(two + l), u3 = *(Four *)(three + l), c1 = *(const Four *)low;
            Four v1 = *(Four *)(one + l + WIDTH), v2 = *(Four *)(two + l + WIDTH), v3 = *(Four *)(three + l + WIDTH);
            Four c2 = *(const Four *)(low + LANES), c3 = *(const Four *)(low + 2 * LANES), d1 = *(const Four *)high;
            Four d2 = *(const Four *)(high + LANES), d3 = *(const Four *)(high + 2 * LANES);
            for (Py_ssize_t i = 0; i < many; i++) {
                Four u = *(const Four *)(from + i * LANES) + u2, v = *(const Four *)(from + i * LANES + WIDTH) + v2;
                u2 = u3 - c2 * u1, u3 = -c3 * u1, u1 = u - c1 * u1;
                v2 = v3 - d2 * v1, v3 = -d3 * v1, v1 = v - d1 * v1;
                *(Four *)(kept + i * LANES + l) = u1, *(Four *)(kept + i * LANES + l + WIDTH) = v1;
            }
            *(Four *)(one + l) = u1, *(Four *)(two + l) = u2, *(Four *)(three + l) = u3;
            *(Four *)(one + l + WIDTH) = v1, *(Four *)(two + l + WIDTH) = v2, *(Four *)(three + l + WIDTH) = v3;
        }
        for (int l = 0; l < LANES; l++) {
            if (fabs(one[l]) < SILENT && fabs(two[l]) < SILENT && fabs(three[l]) < SILENT)
                one[l] = two[l] = three[l] = 0;
            double *to = out[l] ? out[l] + start : NULL;
            for (Py_ssize_t i = 0; to && i < many; i++)
                to[i] = kept[i * LANES + l];
        }
    }
}

/* All lanes whitened under `many` loads of one A, of which the reduced ones are. */
static void whiten_all(const Walk *w, Lanes *lanes, const double *load, int many) {
    Py_ssize_t first = 2 + lanes->free, signals = first + lanes->inputs, long_row = lanes->pad + lanes->wide;
    for (Py_ssize_t begin = 0; begin < signals; begin += LANES) {
        double bottom[MOST_DEGREE * LANES] = {0}, *out[LANES] = {NULL};
        for (int which = 0; which < many; which++) {
            double *basis = lanes->basis + which * lanes->base;
            for (Py_ssize_t s = begin; s < signals && s < begin + LANES; s++) {
                Py_ssize_t l = s - begin + which * LANES / 2;
                for (int c = 0; c < MOST_DEGREE; c++)
                    bottom[c * LANES + l] = load[which * LOAD + BOTTOM + c];
                out[l] = s == 0       ? basis
                         : s == 1     ? lanes->impulse + which * lanes->wide
                         : s < first  ? basis + (s - 1 + (Py_ssize_t)load[DEGREE]) * lanes->wide
                                      : lanes->rows + (which * lanes->inputs + s - first) * long_row + lanes->pad;
            }
        }
        through_bottom(lanes->reduced + begin * w->n, w->n, bottom, out);
    }
}

/* Makes column j orthonormal to those before it (Gram-Schmidt, twice: Giraud et al. 2005), or zero where they have it. */
static int made_orthonormal(double *columns, Py_ssize_t j, Py_ssize_t wide, Py_ssize_t n) {
    double *column = columns + j * wide, whole = dot(column, column, n), left = whole, along = j ? dot(columns, column, n) : 0;
    for (Py_ssize_t m = 0; m < 2 * j; m++) {
        const double *other = columns + m % j * wide, *next = columns + (m + 1) % j * wide;
        along = add_then_dot(column, -along, other, next, n);
    }
    left = j ? dot(column, column, n) : whole;
    int adds = left > DEPENDENT_SHARE * DEPENDENT_SHARE * whole && left > 0;
    multiply(column, adds ? 1 / sqrt(left) : 0, n);
    return adds;
}

/* Products with the starts and then with the tones, as products with the starts and then with what each tone adds. */
static void add_tones(const Walk *w, const Lanes *lanes, double *along) {
    for (Py_ssize_t j = 0, before = lanes->columns - 1; j < w->tone_count; j++, before++) {
        for (Py_ssize_t m = 0; m < before; m++)
            along[before] -= lanes->with[j][m] * along[m];
        along[before] *= lanes->scale[j];
    }
}

/* How the rows of k orthonormal columns follow from each other: what a filter does from any start it does from the next row on.
 * The impulses, the first `degree`, do so by themselves, and each fall with these and those before it. */
static void put_next(Lanes *lanes, const double *columns, Py_ssize_t k, Py_ssize_t degree, Py_ssize_t reach, int ends) {
    memset(lanes->next, 0, sizeof lanes->next), memset(lanes->last, 0, sizeof lanes->last);
    for (Py_ssize_t j = 0; ends && j < k; j++)
        lanes->last[j] = columns[j * lanes->wide + reach - 1];
    for (Py_ssize_t j = 0; j < k; j++) {
        Py_ssize_t among = j < degree ? degree : j + 1;
        double size = 1, along = 0;
        for (Py_ssize_t i = 0; i < among; i++) {
            lanes->next[i][j] = dot(columns + i * lanes->wide, columns + j * lanes->wide + 1, reach - 1);
            along += lanes->last[i] * lanes->next[i][j], size -= lanes->last[i] * lanes->last[i];
        }
        for (Py_ssize_t i = 0; i < among; i++)
            lanes->next[i][j] += lanes->last[i] * along / size;
    }
}

/* What unknown starts and tones add, orthonormal, and pv free of the starts. Returns pv'pv. */
static double put_starts(const Walk *w, Lanes *lanes, double *y, const double *impulse, int degree) {
    Py_ssize_t n = w->n, k = degree + lanes->free, reach = 1, apart = lanes->wide;
    double *columns = y + apart;
    for (Py_ssize_t j = degree - 1; j < k; j++) /* the last sample that is something, of the impulse and each fall */
        for (Py_ssize_t i = n; i > reach; i--)
            reach = fabs(j < degree ? impulse[i - 1] : columns[j * apart + i - 1]) < FADED ? reach : i;
    lanes->reach = (reach + degree + LANES - 2) / LANES * LANES, lanes->reach = lanes->reach < n ? lanes->reach : apart;
    reach = lanes->reach < n ? lanes->reach : n, lanes->starts = 0, lanes->columns = 1 + k;
    for (Py_ssize_t j = 0; j < k; j++) {
        double *column = columns + j * apart;
        for (Py_ssize_t i = 0; j < degree && i < reach; i++)
            column[i] = i < j ? 0 : impulse[i - j];
        lanes->starts += made_orthonormal(columns, j, apart, reach);
        add(y, -dot(column, y, reach), column, reach);
    }
    put_next(lanes, columns, k, degree, reach, lanes->reach >= n);
    memset(lanes->toned, 0, sizeof lanes->toned);
    for (Py_ssize_t j = 0; j < w->tone_count; j++) {
        const double *tone = lanes->tones + j * apart;
        double left = lanes->own[j], *with = lanes->with[j];
        for (Py_ssize_t m = 0; m < k + j; left -= with[m] * with[m], m++) {
            with[m] = m < k ? dot(tone, columns + m * apart, reach) : 0;
            for (Py_ssize_t i = 0; m >= k && i < m; i++)
                with[m] -= with[i] * lanes->with[m - k][i];
            with[m] *= m < k ? 1 : lanes->scale[m - k];
        }
        lanes->scale[j] = left > DEPENDENT_SHARE ? 1 / sqrt(left) : 0;
        lanes->toned[k + j] = dot(tone, y, n);
    }
    add_tones(w, lanes, lanes->toned);
    return dot(y, y, n);
}

/* Inner products of four rows with a column, each as `dot` makes it, bit for bit; the column is read once for all four.
 * n : a multiple of LANES. */
#if defined(__GNUC__)
static inline double summed(Four low, Four high) {
    Four both = low + high;
    return (both[0] + both[1]) + (both[2] + both[3]);
}

WIDE static void four_dots(const double *restrict column, const double *const *rows, Py_ssize_t n, double *restrict out) {
    Four a = {0}, b = {0}, c = {0}, d = {0}, e = {0}, f = {0}, g = {0}, h = {0};
    const double *first = rows[0], *second = rows[1], *third = rows[2], *fourth = rows[3];
    for (Py_ssize_t i = 0; i < n; i += LANES) {
        const Four *x = (const Four *)(column + i), *one = (const Four *)(first + i), *two = (const Four *)(second + i);
        const Four *three = (const Four *)(third + i), *four = (const Four *)(fourth + i);
        a += one[0] * x[0], b += one[1] * x[1], c += two[0] * x[0], d += two[1] * x[1];
        e += three[0] * x[0], f += three[1] * x[1], g += four[0] * x[0], h += four[1] * x[1];
    }
    out[0] = summed(a, b), out[1] = summed(c, d), out[2] = summed(e, f), out[3] = summed(g, h);
}
#else
static void four_dots(const double *column, const double *const *rows, Py_ssize_t n, double *out) {
    for (int j = 0; j < 4; j++)
        out[j] = dot(column, rows[j], n);
}
#endif

/* Products of one row or column with `count` others, LANES divides n, `apart` from each other in out. */
static void put_dots(const double *one, const double *const *others, Py_ssize_t count, Py_ssize_t n, double *out,
                     Py_ssize_t apart) {
    double four[4];
    Py_ssize_t j = 0;
    for (; j + 4 <= count; j += 4) {
        four_dots(one, others + j, n, four);
        for (int i = 0; i < 4; i++)
            out[(j + i) * apart] = four[i];
    }
    for (; j < count; j++)
        out[j * apart] = dot(one, others[j], n);
}

/* The whole delays that are asked for: a fraction lies between two. */
static int whole_delays(const Walk *w, Py_ssize_t *late, int *place) {
    int count = 0;
    for (Py_ssize_t d = 0; d < w->dead_count; d++) {
        Py_ssize_t wanted = (Py_ssize_t)w->deads[d];
        int parts = w->deads[d] > (double)wanted ? 2 : 1;
        for (int k = 0; k < parts; k++) {
            int at = 0;
            while (at < count && late[at] != wanted + k)
                at++;
            if (at == count)
                late[count++] = wanted + k;
            place[2 * d + k] = at;
        }
    }
    return count;
}

/* Sums over the first samples of a row, of its squares and of its products with itself one sample later: as many samples
 * as remain of one that comes late. sums : (pad + 1, 2), for n - pad samples and more. */
static void own_sums(const double *row, Py_ssize_t n, Py_ssize_t pad, double *sums) {
    Py_ssize_t first = n > pad ? n - pad : 0;
    double square = dot(row, row, first), beside = first > 1 ? dot(row + 1, row, first - 1) : 0;
    for (Py_ssize_t k = 0; k <= pad; k++) {
        Py_ssize_t kept = n - pad + k;
        if (kept > first)
            square += row[kept - 1] * row[kept - 1], beside += kept > 1 ? row[kept - 1] * row[kept - 2] : 0;
        sums[2 * k] = kept > 0 ? square : 0, sums[2 * k + 1] = kept > 0 ? beside : 0;
    }
}

/* Products of a row that comes one sample later with the starts' columns, from those as it is; lost : its sample that goes. */
static inline void follow(const Lanes *lanes, Py_ssize_t starts, double lost, double *now) {
    double then[STARTED] = {0};
    for (Py_ssize_t i = 0; i < starts; i++) {
        double kept = now[i] - lost * lanes->last[i];
        for (int j = 0; j < STARTED; j++)
            then[j] += kept * lanes->next[i][j];
    }
    memcpy(now, then, sizeof then);
}

/* Least squares of pv on one row at every dead time and number of tones, `cells` apart; information as it comes. */
WIDE static void fit_row(const Walk *w, const Lanes *lanes, const double *basis, const double *row, const Py_ssize_t *late,
                    int count, const int *place, Py_ssize_t cells, double *gain, double *information) {
    double along[(2 * MOST_DEADS) * MOST_BASIS], now[STARTED] = {0};
    const double *others[2 * MOST_DEADS];
    Py_ssize_t starts = lanes->columns - 1, wide = lanes->wide;
    for (int k = 0; k < count; k++)
        others[k] = row - late[k];
    put_dots(basis, others, count, wide, along, MOST_BASIS);
    for (int k = 0; k < count; k++) {
        double *to = along + k * MOST_BASIS;
        Py_ssize_t later = k ? late[k] - late[k - 1] : -1;
        for (; later > 0 && STEP_COST * later <= lanes->reach * starts; later--)
            follow(lanes, starts, row[w->n - 1 - late[k] + later], now);
        for (Py_ssize_t j = 0; later && j < starts; j++)
            others[j] = basis + (1 + j) * wide;
        if (later)
            put_dots(row - late[k], others, starts, lanes->reach, now, 1);
        memcpy(to + 1, now, sizeof now);
        for (Py_ssize_t j = 0; j < w->tone_count; j++)
            others[j] = lanes->tones + j * wide;
        put_dots(row - late[k], others, w->tone_count, wide, to + 1 + starts, 1);
        add_tones(w, lanes, to + 1);
    }
    own_sums(row, w->n, lanes->pad, lanes->sums);
    for (Py_ssize_t d = 0; d < w->dead_count; d++) {
        double part = w->deads[d] - floor(w->deads[d]), whole = 1 - part, most, both;
        const double *at = along + place[2 * d] * MOST_BASIS, *next = at;
        const double *own = lanes->sums + 2 * (lanes->pad - late[place[2 * d]]), *after = own;
        if (part > 0)
            next = along + place[2 * d + 1] * MOST_BASIS, after = lanes->sums + 2 * (lanes->pad - late[place[2 * d + 1]]);
        most = whole * whole * own[0] + part * part * after[0] + 2 * whole * part * own[1];
        both = whole * at[0] + part * next[0]; /* y'x; divided later */
        Py_ssize_t j = 1;
        for (Py_ssize_t e = 0; e < w->end_count; e++) {
            for (; j < lanes->columns + (Py_ssize_t)w->ends[e]; j++) {
                double one = whole * at[j] + part * next[j];
                most -= one * one;
                both -= one * lanes->toned[j - 1];
            }
            gain[e * cells + d] = both, information[e * cells + d] = most;
        }
    }
}

static int open_lanes(const Walk *w, Lanes *lanes) {
    double latest = 0;
    for (Py_ssize_t d = 0; d < w->dead_count; d++)
        latest = fmax(latest, w->deads[d]);
    size_t n = (size_t)w->n, rows = (size_t)(w->second_count * w->input_count), signals = 2 + (size_t)w->fall_count + rows;
    size_t wide = (n + LANES - 1) / LANES * LANES, reduced = (signals + LANES - 1) / LANES * LANES * n;
    lanes->pad = (Py_ssize_t)latest + 2, lanes->wide = (Py_ssize_t)wide, lanes->inputs = (Py_ssize_t)rows;
    size_t twins = 2 * (2 + rows) <= LANES ? 2 : 1, long_rows = twins * rows * (wide + (size_t)lanes->pad);
    lanes->base = (Py_ssize_t)((1 + MOST_DEGREE + (size_t)w->fall_count + 3) / 4 * 4 * wide);
    size_t bases = twins * (size_t)lanes->base, tones = ((size_t)w->tone_count + 3) / 4 * 4 * wide;
    lanes->memory = malloc((signals * n + reduced + 2 * wide + long_rows + bases + tones + 2 * (size_t)lanes->pad + 2) *
                           sizeof(double));
    if (!lanes->memory)
        return -1;
    lanes->source = lanes->memory, lanes->reduced = lanes->source + signals * n, lanes->impulse = lanes->reduced + reduced;
    lanes->rows = lanes->impulse + 2 * wide, lanes->basis = lanes->rows + long_rows, lanes->tones = lanes->basis + bases;
    lanes->sums = lanes->tones + tones;
    for (size_t r = 0, apart = wide + (size_t)lanes->pad; r < twins * rows; r++) {
        memset(lanes->rows + r * apart, 0, (size_t)lanes->pad * sizeof(double));
        memset(lanes->rows + (r + 1) * apart - (wide - n), 0, (wide - n) * sizeof(double));
    }
    for (size_t end = wide; end <= bases + tones; end += wide)
        memset(lanes->basis + end - (wide - n), 0, (wide - n) * sizeof(double));
    return 0;
}

/* Gains from y'x, and what is left. whole : y'y. silent : of what pv cannot show. */
static void put_left(double *gain, double *information, double *left, Py_ssize_t cells, double whole, double silent) {
    double most = 0;
    for (Py_ssize_t i = 0; i < cells; i++)
        most = fmax(most, information[i]);
    double least = LEAST_SHARE * most + LEAST_INFORMATION;
    for (Py_ssize_t i = 0; i < cells; i++) {
        double along = gain[i];
        information[i] = fmax(information[i], least);
        gain[i] = along / information[i];
        left[i] = fmax(whole - gain[i] * along, 0) + silent;
    }
}

/* Least squares under load l, which of those whitened. */
static void fit_rows(const Walk *w, Lanes *lanes, Py_ssize_t which, Py_ssize_t l, const Py_ssize_t *late, int count,
                     const int *place) {
    Py_ssize_t cells = lanes->inputs * w->dead_count, first = l * w->end_count * cells, taken = 0;
    double *gain = w->gain + first, *information = w->information + first, *left = w->left + first;
    double *basis = lanes->basis + which * lanes->base;
    double whole = put_starts(w, lanes, basis, lanes->impulse + which * lanes->wide, (int)w->loads[l * LOAD + DEGREE]);
    const double *row = lanes->rows + which * lanes->inputs * (lanes->pad + lanes->wide) + lanes->pad;
    for (Py_ssize_t r = 0; r < lanes->inputs; r++, row += lanes->pad + lanes->wide)
        fit_row(w, lanes, basis, row, late, count, place, cells, gain + r * w->dead_count, information + r * w->dead_count);
    for (Py_ssize_t e = 0; e < w->end_count; e++, gain += cells, information += cells, left += cells) {
        for (; taken < (Py_ssize_t)w->ends[e]; taken++)
            whole -= lanes->toned[lanes->columns - 1 + taken] * lanes->toned[lanes->columns - 1 + taken];
        put_left(gain, information, left, cells, fmax(whole, 0), (double)(w->n - lanes->starts - taken) * w->noise);
    }
}

/* The least squares of every load, number of tones, row and dead time; -1 without memory. */
static int walk(const Walk *w) {
    Lanes lanes;
    Py_ssize_t late[2 * MOST_DEADS];
    int place[2 * MOST_DEADS], count = whole_delays(w, late, place);
    if (open_lanes(w, &lanes))
        return -1;
    lay_sources(w, &lanes);
    for (Py_ssize_t j = 0; j < w->tone_count; j++) {
        memcpy(lanes.tones + j * lanes.wide, w->tones + j * w->n, (size_t)w->n * sizeof *w->tones);
        lanes.own[j] = made_orthonormal(lanes.tones, j, lanes.wide, w->n);
    }
    for (Py_ssize_t l = 0, many; l < w->load_count; l += many) {
        const double *load = w->loads + l * LOAD;
        if (!l || memcmp(load - LOAD, load, BOTTOM * sizeof *load))
            lay_reduced(w, &lanes, load);
        many = lanes.at_once > 1 && l + 1 < w->load_count && !memcmp(load, load + LOAD, BOTTOM * sizeof *load) ? 2 : 1;
        whiten_all(w, &lanes, load, (int)many);
        for (Py_ssize_t which = 0; which < many; which++)
            fit_rows(w, &lanes, which, l + which, late, count, place);
    }
    free(lanes.memory);
    return 0;
}

/* Under its one load, whose shocks are looked for (jumping_load.py): pv whitened; what a shock does a row later, behind one more
 * lag (pole, 0 for none); columns that are there without any, orthonormal: of unknown starts, and the inputs. Returns how
 * many columns, -1 without memory. */
static Py_ssize_t whiten_one(const Walk *w, double pole, double *y, double *response, double *columns) {
    Lanes lanes;
    Py_ssize_t n = w->n, k;
    if (open_lanes(w, &lanes))
        return -1;
    lay_sources(w, &lanes), lay_reduced(w, &lanes, w->loads), whiten_all(w, &lanes, w->loads, 1);
    memcpy(y, lanes.basis, (size_t)n * sizeof *y);
    response[0] = 0;
    for (Py_ssize_t i = 1; i < n; i++) {
        double now = lanes.impulse[i - 1] + pole * response[i - 1];
        response[i] = fabs(now) < SILENT ? 0 : now;
    }
    put_starts(w, &lanes, lanes.basis, lanes.impulse, (int)w->loads[DEGREE]);
    k = lanes.columns - 1, memset(columns, 0, (size_t)(k * n) * sizeof *columns);
    for (Py_ssize_t j = 0; j < k; j++)
        memcpy(columns + j * n, lanes.basis + (j + 1) * lanes.wide, (size_t)(lanes.reach < n ? lanes.reach : n) * sizeof *y);
    for (Py_ssize_t r = 0; r < lanes.inputs; r++, k++) {
        memcpy(columns + k * n, lanes.rows + r * (lanes.pad + lanes.wide) + lanes.pad, (size_t)n * sizeof *y);
        made_orthonormal(columns, k, n, n);
    }
    free(lanes.memory);
    return k;
}

/* ln and exp of many numbers in place, within one unit of the last digit (fdlibm, Sun Microsystems 1993), without a branch, so
 * that several are worked out at once. Of ln they are positive; TURNING lies at the root of a half. */
WIDE static void logs(double *restrict x, Py_ssize_t n) {
    const int64_t ONE = 0x3ff0000000000000, TURNING = 0x3fe6a09e00000000, PLACES = 0x000fffffffffffff;
    for (Py_ssize_t i = 0; i < n; i++) {
        int64_t bits, whole;
        double f, k;
        memcpy(&bits, x + i, sizeof bits);
        bits += ONE - TURNING, whole = (int64_t)((uint64_t)bits >> 52) | 0x4330000000000000;
        bits = (bits & PLACES) + TURNING;
        memcpy(&f, &bits, sizeof f), memcpy(&k, &whole, sizeof k);
        k -= 4503599627370496.0 + 1023, f -= 1;
        double s = f / (2 + f), z = s * s, w = z * z, half = 0.5 * f * f;
        double even = w * (3.999999999940941908e-01 + w * (2.222219843214978396e-01 + w * 1.531383769920937332e-01));
        double odd = w * (1.818357216161805012e-01 + w * 1.479819860511658591e-01);
        odd = z * (6.666666666666735130e-01 + w * 2.857142874366239149e-01 + w * odd);
        x[i] = s * (half + even + odd) + k * LN2_LOW - half + f + k * LN2_HIGH;
    }
}

/* Adds exp(x - top), none of which is over one, to each sum, unless all are nothing. */
WIDE static void add_exps(const double *restrict x, const double *restrict top, Py_ssize_t n, double *restrict sum) {
    int counts = 0;
    double off[STRETCH];
    for (Py_ssize_t i = 0; i < n; i++)
        counts |= x[i] > top[i] + SILENT_SHARE;
    for (Py_ssize_t i = 0; i < n; i++)
        off[i] = x[i] - top[i] > LEAST_POWER ? x[i] - top[i] : LEAST_POWER;
    for (Py_ssize_t i = 0; i < (counts ? n : 0); i++) {
        double from = off[i], turned = 1.44269504088896338700 * from + 6755399441055744.0, y;
        double k = turned - 6755399441055744.0, high = from - k * LN2_HIGH, low = k * LN2_LOW, r = high - low, rr = r * r;
        double c = 6.61375632143793436117e-05 + rr * (-1.65339022054652515390e-06 + rr * 4.13813679705723846039e-08);
        c = r - rr * (1.66666666666666019037e-01 + rr * (-2.77777777770155933842e-03 + rr * c));
        y = 1 + (r * c / (2 - c) - low + high);
        uint64_t bits, power;
        memcpy(&bits, &y, sizeof bits), memcpy(&power, &turned, sizeof power);
        bits += power << 52;
        memcpy(&y, &bits, sizeof bits);
        sum[i] += y;
    }
}

/* ln of the mean over some loads of exp(-half ln((left + information (K - gain)^2) / size)) at every gain K of a row's grid.
 * gain, information, left : (load_count, row_count, dead_count). gains : (row_count, gain_count). half : (load_count).
 * groups : (group_count, load_count), 1 for a load that is in one; one of none has no answer (NaN). spans : (row_count,
 * dead_count, 2), the first gain that is asked for and the one after the last; ln 0 for the others. out : (group_count,
 * row_count, dead_count, gain_count). */
typedef struct {
    const double *gain, *information, *left, *half, *gains, *groups, *spans;
    Py_ssize_t load_count, row_count, dead_count, gain_count, group_count;
    double size, *out;
} Mixture;

WIDE static void mix(const Mixture *m) {
    Py_ssize_t cells = m->row_count * m->dead_count, loads = m->load_count;
    double value[MOST_MIXED][STRETCH], top[STRETCH], sum[STRETCH];
    for (Py_ssize_t i = 0; i < m->group_count * cells * m->gain_count; i++)
        m->out[i] = -INFINITY;
    for (Py_ssize_t cell = 0; cell < cells; cell++)
        for (Py_ssize_t start = (Py_ssize_t)m->spans[2 * cell], end = (Py_ssize_t)m->spans[2 * cell + 1], many; start < end;
             start += many) {
            const double *gains = m->gains + cell / m->dead_count * m->gain_count + start;
            many = end - start < STRETCH ? end - start : STRETCH;
            for (Py_ssize_t l = 0; l < loads; l++) {
                double gain = m->gain[l * cells + cell], left = m->left[l * cells + cell];
                double information = m->information[l * cells + cell];
                for (Py_ssize_t g = 0; g < many; g++)
                    value[l][g] = (left + information * ((gains[g] - gain) * (gains[g] - gain))) / m->size;
                logs(value[l], many);
                multiply(value[l], -m->half[l], many);
            }
            for (Py_ssize_t of = 0; of < m->group_count; of++) {
                const double *group = m->groups + of * loads;
                double *out = m->out + (of * cells + cell) * m->gain_count + start, count = 0;
                for (Py_ssize_t g = 0; g < many; g++)
                    top[g] = -INFINITY, sum[g] = 0;
                for (Py_ssize_t l = 0; l < loads; l++)
                    for (Py_ssize_t g = 0; group[l] > 0 && g < many; g++)
                        top[g] = value[l][g] > top[g] ? value[l][g] : top[g];
                for (Py_ssize_t l = 0; l < loads; l++)
                    if (group[l] > 0)
                        add_exps(value[l], top, many, sum), count++;
                multiply(sum, 1 / count, many), logs(sum, many);
                for (Py_ssize_t g = 0; g < many; g++)
                    out[g] = top[g] + sum[g];
            }
        }
}

#endif
