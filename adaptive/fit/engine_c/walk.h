/* Process, load that wanders and noise: whitened least squares, likelihoods of gains (explanations/wandering_load.py). */

#ifndef RETUNER_WALK_H
#define RETUNER_WALK_H

#include "misfit.h"

enum { LANES = 8, MOST_DEGREE = 3, MOST_FALLS = 4, MOST_TONES = 8, MOST_DEADS = 64, MOST_MIXED = 64 };
enum { MOST_BASIS = 1 + MOST_DEGREE + MOST_FALLS + MOST_TONES };
enum { DEGREE, ROOTS, BOTTOM = ROOTS + MOST_DEGREE, LOAD = BOTTOM + MOST_DEGREE };
static const double SILENT = 1e-200;          /* what is left in a filter is nothing below this */
static const double DEPENDENT_SHARE = 1e-10;  /* less of a column than this is round-off: the others have it already */
static const double LEAST_SHARE = 1e-12, LEAST_INFORMATION = 1e-300, SILENT_SHARE = -30;

/* A = (1 - root q)(1 - root q)..., C = 1 + bottom q + ...: loads are rows of degree, roots, bottom. The inputs, held from
 * sample to sample, go through a first lag (pole, rise) and each second one (seconds: poles, 0 for none). A pole over 1 runs
 * away: its inputs are laid free of it, as A makes them, for what grows leaves no digits to subtract. falls : poles
 * of what unknown starts of lags add. tones : sinusoids that the load may hold besides, (tone_count, n); a filter
 * makes of one the same one turned, and starts. ends : so many of them are taken, none first. noise : what pv cannot show,
 * squared, a sample. Answers: shape (load_count, end_count, second_count, input_count, dead_count). */
typedef struct {
    const double *pv, *inputs, *loads, *seconds, *falls, *deads, *tones, *ends;
    Py_ssize_t n, input_count, load_count, second_count, fall_count, dead_count, tone_count, end_count;
    double pole, rise, noise;
    double *gain, *information, *left;
} Walk;

/* Signals lie LANES abreast, (blocks, n, LANES): pv, the impulse, the falls, the inputs as they come out of the lags.
 * rows : the inputs once whitened, each with `pad` zeros before it. basis : (MOST_BASIS, wide), pv first; wide : n and
 * zeros, so many that LANES divides it. columns : of the basis without the tones. starts : those that are not zero,
 * without pv's. toned : pv along each tone. */
typedef struct {
    Py_ssize_t blocks, pad, wide, columns, starts;
    double *source, *reduced, *white, *rows, *basis, *sums, *memory, toned[MOST_TONES];
} Lanes;

static double *lane(double *from, Py_ssize_t n, Py_ssize_t which) {
    return from + which / LANES * n * LANES + which % LANES;
}

/* What held inputs do at gain one through the lags. */
static void through_lags(const Walk *w, Lanes *lanes) {
    Py_ssize_t which = 2 + w->fall_count;
    for (Py_ssize_t s = 0; s < w->second_count; s++)
        for (Py_ssize_t k = 0; k < w->input_count; k++, which++) {
            const double *u = w->inputs + k * w->n;
            double *out = lane(lanes->source, w->n, which), first = 0, last = 0, other = w->seconds[s];
            for (Py_ssize_t i = 0; i < w->n; i++) {
                last = other * last + (1 - other) * first;
                out[i * LANES] = last;
                first = (w->pole > 1 ? 0 : w->pole) * first + w->rise * u[i];
                first = fabs(first) < SILENT ? 0 : first;
                last = fabs(last) < SILENT ? 0 : last;
            }
        }
}

static void lay_sources(const Walk *w, Lanes *lanes) {
    double *pv = lane(lanes->source, w->n, 0);
    for (Py_ssize_t i = 0; i < w->n; i++)
        pv[i * LANES] = w->pv[i];
    lane(lanes->source, w->n, 1)[0] = 1;
    for (Py_ssize_t k = 0; k < w->fall_count; k++) {
        double *fall = lane(lanes->source, w->n, 2 + k), now = 1;
        for (Py_ssize_t i = 0; i < w->n && now > SILENT; i++, now *= w->falls[k])
            fall[i * LANES] = now;
    }
    through_lags(w, lanes);
}

/* x - root x(before it), in place, in lanes before `end`; the impulse (lane 1 of the first block) stays. */
WIDE static void reduce(double *restrict x, Py_ssize_t n, double each, Py_ssize_t end) {
    double before[LANES] = {0}, now[LANES], root[LANES];
    for (int l = 0; l < LANES; l++)
        root[l] = l < end ? each : 0;
    for (Py_ssize_t i = 0; i < n; i++)
        for (int l = 0; l < LANES; l++) {
            now[l] = x[i * LANES + l];
            x[i * LANES + l] = now[l] - root[l] * before[l];
            before[l] = now[l];
        }
}

WIDE static void through_bottom(const double *restrict x, Py_ssize_t n, const double *bottom, double *restrict y) {
    double one[LANES] = {0}, two[LANES] = {0}, three[LANES] = {0}, c1 = bottom[0], c2 = bottom[1], c3 = bottom[2];
    for (Py_ssize_t start = 0; start < n; start += 64) {
        Py_ssize_t end = start + 64 < n ? start + 64 : n;
        for (Py_ssize_t i = start; i < end; i++)
            for (int l = 0; l < LANES; l++) {
                double out = x[i * LANES + l] + one[l];
                one[l] = two[l] - c1 * out;
                two[l] = three[l] - c2 * out;
                three[l] = -c3 * out;
                y[i * LANES + l] = out;
            }
        for (int l = 0; l < LANES; l++)
            if (fabs(one[l]) < SILENT && fabs(two[l]) < SILENT && fabs(three[l]) < SILENT)
                one[l] = two[l] = three[l] = 0;
    }
}

/* All lanes whitened under a load. before : the load that `reduced` holds, NULL for none. */
static void whiten_all(const Walk *w, Lanes *lanes, const double *load, const double *before) {
    Py_ssize_t size = w->n * LANES;
    if (!before || memcmp(before, load, BOTTOM * sizeof *load)) {
        memcpy(lanes->reduced, lanes->source, (size_t)(lanes->blocks * size) * sizeof(double));
        for (Py_ssize_t b = 0; b < lanes->blocks; b++)
            for (int j = 0; j < (int)load[DEGREE]; j++)
                reduce(lanes->reduced + b * size, w->n, load[ROOTS + j],
                       j == 0 && w->pole > 1 ? 2 + w->fall_count - b * LANES : LANES);
        double *impulse = lane(lanes->reduced, w->n, 1);
        for (Py_ssize_t i = 0; i < w->n; i++)
            impulse[i * LANES] = i == 0;
    }
    for (Py_ssize_t b = 0; b < lanes->blocks; b++)
        through_bottom(lanes->reduced + b * size, w->n, load + BOTTOM, lanes->white + b * size);
    for (Py_ssize_t r = 0; r < w->second_count * w->input_count; r++) {
        const double *from = lane(lanes->white, w->n, 2 + w->fall_count + r);
        double *row = lanes->rows + r * (lanes->pad + lanes->wide) + lanes->pad;
        for (Py_ssize_t i = 0; i < w->n; i++)
            row[i] = from[i * LANES];
    }
}

/* Makes column j orthonormal to those before it (Gram-Schmidt, twice: Giraud et al. 2005), or zero where they have it. */
static int made_orthonormal(double *columns, Py_ssize_t j, Py_ssize_t wide, Py_ssize_t n) {
    double *column = columns + j * wide, whole = dot(column, column, n), left;
    for (int pass = 0; pass < 2; pass++)
        for (Py_ssize_t m = 0; m < j; m++)
            add(column, -dot(columns + m * wide, column, n), columns + m * wide, n);
    left = dot(column, column, n);
    int adds = left > DEPENDENT_SHARE * DEPENDENT_SHARE * whole && left > 0;
    multiply(column, adds ? 1 / sqrt(left) : 0, n);
    return adds;
}

/* What unknown starts and tones add, orthonormal, and pv free of the starts. Returns pv'pv. */
static double put_starts(const Walk *w, Lanes *lanes, int degree) {
    Py_ssize_t n = w->n, k = degree + w->fall_count;
    double *y = lanes->basis, *columns = y + lanes->wide;
    const double *impulse = lane(lanes->white, n, 1), *pv = lane(lanes->white, n, 0);
    for (Py_ssize_t i = 0; i < n; i++)
        y[i] = pv[i * LANES];
    lanes->starts = 0, lanes->columns = 1 + k;
    for (Py_ssize_t j = 0; j < k; j++) {
        double *column = columns + j * lanes->wide;
        const double *from = j < degree ? impulse : lane(lanes->white, n, 2 + j - degree);
        Py_ssize_t late = j < degree ? j : 0;
        for (Py_ssize_t i = 0; i < n; i++)
            column[i] = i < late ? 0 : from[(i - late) * LANES];
        lanes->starts += made_orthonormal(columns, j, lanes->wide, n);
        add(y, -dot(column, y, n), column, n);
    }
    for (Py_ssize_t j = 0; j < w->tone_count; j++) {
        memcpy(columns + (k + j) * lanes->wide, w->tones + j * n, (size_t)n * sizeof *y);
        made_orthonormal(columns, k + j, lanes->wide, n);
        lanes->toned[j] = dot(columns + (k + j) * lanes->wide, y, n);
    }
    k += w->tone_count;
    memset(columns + k * lanes->wide, 0, (size_t)((MOST_BASIS - 1 - k) * lanes->wide) * sizeof *y);
    return dot(y, y, n);
}

/* Inner products of four columns with a row, each as `dot` makes it, bit for bit; the row is read once for all four. n : a
 * multiple of LANES; columns lie n apart. */
#if defined(__GNUC__)
typedef double Four __attribute__((vector_size(4 * sizeof(double)), aligned(sizeof(double)), may_alias));

static inline double summed(Four low, Four high) {
    Four both = low + high;
    return (both[0] + both[1]) + (both[2] + both[3]);
}

WIDE static void four_dots(const double *restrict columns, const double *restrict row, Py_ssize_t n, double *restrict out) {
    Four a = {0}, b = {0}, c = {0}, d = {0}, e = {0}, f = {0}, g = {0}, h = {0};
    for (Py_ssize_t i = 0; i < n; i += LANES) {
        const Four *x = (const Four *)(row + i), *one = (const Four *)(columns + i), *two = (const Four *)(columns + n + i);
        const Four *three = (const Four *)(columns + 2 * n + i), *four = (const Four *)(columns + 3 * n + i);
        a += one[0] * x[0], b += one[1] * x[1], c += two[0] * x[0], d += two[1] * x[1];
        e += three[0] * x[0], f += three[1] * x[1], g += four[0] * x[0], h += four[1] * x[1];
    }
    out[0] = summed(a, b), out[1] = summed(c, d), out[2] = summed(e, f), out[3] = summed(g, h);
}
#else
static void four_dots(const double *columns, const double *row, Py_ssize_t n, double *out) {
    for (int j = 0; j < 4; j++)
        out[j] = dot(columns + j * n, row, n);
}
#endif

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

/* Least squares of pv on one row at every dead time and number of tones, `cells` apart; information as it comes. */
static void fit_row(const Walk *w, const Lanes *lanes, const double *row, const Py_ssize_t *late, int count,
                    const int *place, Py_ssize_t cells, double *gain, double *information) {
    double along[(2 * MOST_DEADS) * MOST_BASIS];
    for (int k = 0; k < count; k++)
        for (Py_ssize_t j = 0; j < lanes->columns + w->tone_count; j += 4)
            four_dots(lanes->basis + j * lanes->wide, row - late[k], lanes->wide, along + k * MOST_BASIS + j);
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
                both -= j < lanes->columns ? 0 : one * lanes->toned[j - lanes->columns];
            }
            gain[e * cells + d] = both, information[e * cells + d] = most;
        }
    }
}

static int open_lanes(const Walk *w, Lanes *lanes) {
    double latest = 0;
    for (Py_ssize_t d = 0; d < w->dead_count; d++)
        latest = fmax(latest, w->deads[d]);
    size_t n = (size_t)w->n, rows = (size_t)(w->second_count * w->input_count);
    lanes->blocks = (Py_ssize_t)((2 + (size_t)w->fall_count + rows + LANES - 1) / LANES);
    lanes->pad = (Py_ssize_t)latest + 2;
    size_t wide = (n + LANES - 1) / LANES * LANES, block = (size_t)lanes->blocks * n * LANES;
    size_t all = rows * (wide + (size_t)lanes->pad);
    lanes->wide = (Py_ssize_t)wide;
    lanes->memory = calloc(3 * block + all + wide * MOST_BASIS + 2 * (size_t)lanes->pad + 2, sizeof(double));
    if (!lanes->memory)
        return -1;
    lanes->source = lanes->memory, lanes->reduced = lanes->source + block, lanes->white = lanes->reduced + block;
    lanes->rows = lanes->white + block, lanes->basis = lanes->rows + all;
    lanes->sums = lanes->basis + wide * MOST_BASIS;
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

/* The least squares of every load, number of tones, row and dead time; -1 without memory. */
static int walk(const Walk *w) {
    Lanes lanes;
    Py_ssize_t late[2 * MOST_DEADS], rows = w->second_count * w->input_count, cells = rows * w->dead_count;
    int place[2 * MOST_DEADS], count = whole_delays(w, late, place);
    if (open_lanes(w, &lanes))
        return -1;
    lay_sources(w, &lanes);
    for (Py_ssize_t l = 0; l < w->load_count; l++) {
        const double *load = w->loads + l * LOAD;
        Py_ssize_t first = l * w->end_count * cells;
        double *gain = w->gain + first, *information = w->information + first, *left = w->left + first;
        whiten_all(w, &lanes, load, l ? load - LOAD : NULL);
        double whole = put_starts(w, &lanes, (int)load[DEGREE]);
        for (Py_ssize_t r = 0; r < rows; r++)
            fit_row(w, &lanes, lanes.rows + r * (lanes.pad + lanes.wide) + lanes.pad, late, count, place, cells,
                    gain + r * w->dead_count, information + r * w->dead_count);
        Py_ssize_t taken = 0;
        for (Py_ssize_t e = 0; e < w->end_count; e++, gain += cells, information += cells, left += cells) {
            for (; taken < (Py_ssize_t)w->ends[e]; taken++)
                whole -= lanes.toned[taken] * lanes.toned[taken];
            put_left(gain, information, left, cells, fmax(whole, 0), (double)(w->n - lanes.starts - taken) * w->noise);
        }
    }
    free(lanes.memory);
    return 0;
}

/* ln of the mean over loads of exp(-half ln((left + information (K - gain)^2) / size)) at every gain K of a row's grid.
 * gain, information, left : (load_count, row_count, dead_count). gains : (row_count, gain_count). half : (load_count). */
typedef struct {
    const double *gain, *information, *left, *half, *gains;
    Py_ssize_t load_count, row_count, dead_count, gain_count;
    double size, *out;
} Mixture;

static void mix(const Mixture *m) {
    Py_ssize_t cells = m->row_count * m->dead_count;
    double value[MOST_MIXED], most[MOST_MIXED];
    Py_ssize_t order[MOST_MIXED];
    for (Py_ssize_t cell = 0; cell < cells; cell++) {
        for (Py_ssize_t l = 0; l < m->load_count; l++) { /* the likeliest first, each at its own gain */
            double one = -m->half[l] * log(m->left[l * cells + cell] / m->size);
            Py_ssize_t at = l;
            for (; at > 0 && most[at - 1] < one; at--)
                most[at] = most[at - 1], order[at] = order[at - 1];
            most[at] = one, order[at] = l;
        }
        for (Py_ssize_t g = 0; g < m->gain_count; g++) {
            double gain = m->gains[cell / m->dead_count * m->gain_count + g], top = -INFINITY, sum = 0;
            Py_ssize_t count = 0;
            for (; count < m->load_count && most[count] - top > SILENT_SHARE; count++) {
                Py_ssize_t at = order[count] * cells + cell;
                double off = gain - m->gain[at];
                value[count] = -m->half[order[count]] * log((m->left[at] + m->information[at] * (off * off)) / m->size);
                top = value[count] > top ? value[count] : top;
            }
            for (Py_ssize_t l = 0; l < count; l++)
                sum += value[l] - top > SILENT_SHARE ? exp(value[l] - top) : 0;
            m->out[cell * m->gain_count + g] = top + log(sum / (double)m->load_count);
        }
    }
}

#endif
