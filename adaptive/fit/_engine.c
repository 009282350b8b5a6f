/* The compiled engine of identification: what adaptive/identification does in numpy, in one call.
 *
 * The formulas, the settings and the order of every decision are those of the numpy engine, which stays the reference:
 * dynamics and misfit (variable projection, Golub & Pereyra 1973; Jacobian after Kaufman 1975), refine (Levenberg-
 * Marquardt, Marquardt 1963), the coarse search, the remainder's colour, the scan of sticking valves, and the grid of
 * processes under a load that wanders. See those files for what is computed and why; engine_c/ says how; here is the
 * door to Python.
 *
 * Two lanes. A process is one real mode, two real modes, or a conjugate pair of complex ones. Its signals are carried
 * as two real lanes (a, b): one lane a mode, or real and imaginary part of the pair's first. Advancing over an interval
 * is a 2 x 2 matrix on the lanes, and every response and every derivative of one is a fixed combination (Form) of
 *
 *     1, x, x^2, a, b, c, x a, x b, x c        x : time since the step; a, b : int_0^x exp(-s y) dy of the modes;
 *                                              c : the same of a load's own lag
 *
 * because the derivative of that integral by s is (x exp(-s x) - integral) / s. So a column costs one recursion and no
 * exponential. Rotations by Householder reflections are not undone: sums of squares and J'J are the same without.
 *
 * No state is kept between calls; the interpreter is released while computing; sums are made in a fixed order, so that
 * the same input gives the same bits.
 */

#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include "engine_c/closed.h"
#include "engine_c/refine.h"
#include "engine_c/screen.h"
#include "engine_c/search.h"
#include "engine_c/steps.h"
#include "engine_c/valves.h"
#include "engine_c/any_load.h"

#define VERSION "16"

/* ---------------------------------------------------------------- the door: buffers of numbers, looked at before use */

typedef struct {
    Py_buffer buffer;
    double *x;
    Py_ssize_t n;
    int open;
} View;

static int view(PyObject *object, View *v, const char *name, int writable) {
    int flags = PyBUF_C_CONTIGUOUS | PyBUF_FORMAT | (writable ? PyBUF_WRITABLE : 0);
    v->open = 0;
    if (PyObject_GetBuffer(object, &v->buffer, flags)) {
        PyErr_Clear();
        PyErr_Format(PyExc_ValueError, "%s: a contiguous%s buffer of doubles is needed", name,
                     writable ? " writable" : "");
        return -1;
    }
    v->open = 1, v->x = v->buffer.buf, v->n = v->buffer.len / (Py_ssize_t)sizeof(double);
    const char *format = v->buffer.format;
    if (!format || strcmp(format, "d") || v->buffer.itemsize != sizeof(double) ||
        (v->n && (uintptr_t)v->x % _Alignof(double))) {
        PyErr_Format(PyExc_ValueError, "%s: a buffer of doubles is needed", name);
        return -1;
    }
    for (Py_ssize_t i = 0; !writable && i < v->n; i++)
        if (isnan(v->x[i])) {
            PyErr_Format(PyExc_ValueError, "%s[%zd] is not a number", name, i);
            return -1;
        }
    return 0;
}

/* Whether all of x is finite: x - x is 0 then and else is not; on eight lanes, as long records are asked. */
WIDE static int all_finite(const double *restrict x, Py_ssize_t n) {
    double sums[8] = {0}, all = 0;
    Py_ssize_t whole = n - n % 8;
    for (Py_ssize_t i = 0; i < whole; i += 8)
        for (int j = 0; j < 8; j++)
            sums[j] += x[i + j] - x[i + j];
    for (Py_ssize_t i = whole; i < n; i++)
        all += x[i] - x[i];
    for (int j = 0; j < 8; j++)
        all += sums[j];
    return all == 0;
}

static int finite_view(PyObject *object, View *v, const char *name, int writable) {
    if (view(object, v, name, writable))
        return -1;
    for (Py_ssize_t i = all_finite(v->x, v->n) ? v->n : 0; i < v->n; i++)
        if (!isfinite(v->x[i])) {
            PyErr_Format(PyExc_ValueError, "%s[%zd] is not a finite number", name, i);
            return -1;
        }
    return 0;
}

static int refuse(const char *sentence) {
    PyErr_SetString(PyExc_ValueError, sentence);
    return -1;
}

static int sized(const View *v, Py_ssize_t n, const char *name) {
    if (v->n == n)
        return 0;
    PyErr_Format(PyExc_ValueError, "%s has %zd numbers; %zd are needed", name, v->n, n);
    return -1;
}

static int increasing(const View *t) {
    for (Py_ssize_t i = 1; i < t->n; i++)
        if (!(t->x[i] > t->x[i - 1])) {
            PyErr_Format(PyExc_ValueError, "time does not increase at sample %zd", i);
            return -1;
        }
    return 0;
}

/* A count among the numbers that describe a problem. */
static int count_in(double x, int most, int *out) {
    if (!(x >= 0 && x <= most && x == floor(x)))
        return refuse("numbers: a count is outside its range");
    *out = (int)x;
    return 0;
}

enum { DT, SPAN, SIGMA, SIGN, TYPE, LOADS, HARMONICS, RAMP, ROUNDED, CORNERS, MOTION, STARTS, ORDER, HEAD };

/* numbers : the head (see above), then the starts, the whitening filter, and the weights of the priors. */
static int read_problem(Problem *p, const View *numbers) {
    const double *x = numbers->x;
    if (numbers->n < HEAD)
        return refuse("numbers: the description of the problem is too short");
    p->dt = x[DT], p->span = x[SPAN], p->sigma = x[SIGMA], p->sign = x[SIGN];
    if (!(p->dt >= 0 && p->span > 0 && p->sigma > 0 && fabs(p->sign) == 1))
        return refuse("numbers: dt >= 0, span > 0, sigma > 0 and a sign of 1 or -1 are needed");
    if (count_in(x[TYPE], TYPES - 1, &p->type) || count_in(x[LOADS], MOST_LOADS, &p->loads) ||
        count_in(x[HARMONICS], MOST_HARMONICS, &p->harmonics) || count_in(x[RAMP], 1, &p->ramp) ||
        count_in(x[ROUNDED], 1, &p->rounded) || count_in(x[CORNERS], p->loads, &p->corners) ||
        count_in(x[MOTION], 1, &p->motion) ||
        count_in(x[STARTS], MOST_STARTS, &p->starts) || count_in(x[ORDER], MOST_AR, &p->order))
        return -1;
    p->priors = p->starts * start_columns(p) + p->ramp;
    p->columns = p->priors + p->loads + 2 * p->harmonics + 1;
    p->size = SIZE[p->type] + p->loads + p->rounded + (p->harmonics > 0);
    if (sized(numbers, HEAD + p->starts + p->order + p->priors, "numbers") || p->columns > MOST_COLUMNS)
        return PyErr_Occurred() ? -1 : refuse("numbers: too many columns");
    memcpy(p->start, x + HEAD, (size_t)p->starts * sizeof *x);
    memcpy(p->ar, x + HEAD + p->starts, (size_t)p->order * sizeof *x);
    memcpy(p->weight, x + HEAD + p->starts + p->order, (size_t)p->priors * sizeof *x);
    p->rows = p->n + p->priors;
    return p->n > p->columns ? 0 : refuse("more unknowns than samples");
}

/* The record and what is asked of it, from the first four arguments; views : four of them. */
static int read_record(Work *w, View *views, PyObject *const *from) {
    static const char *const NAMES[] = {"t", "pv", "co", "numbers"};
    memset(w, 0, sizeof *w);
    for (int i = 0; i < 4; i++)
        if (finite_view(from[i], &views[i], NAMES[i], 0))
            return -1;
    Py_ssize_t n = views[0].n;
    if (n < 3 || n > 10000000)
        return refuse("t: between 3 and 10000000 samples are needed");
    if (sized(&views[1], n, "pv") || sized(&views[2], n, "co") || increasing(&views[0]))
        return -1;
    w->p.n = n, w->p.t = views[0].x, w->p.pv = views[1].x, w->p.u = views[2].x;
    if (read_problem(&w->p, &views[3]))
        return -1;
    if (open_work(w)) {
        PyErr_NoMemory();
        return -1;
    }
    return 0;
}

enum { MOST_VIEWS = 16 };

/* What a call needs: its views, its workspace. */
typedef struct {
    View views[MOST_VIEWS];
    Work work;
} Call;

typedef PyObject *Answer(View *v, Work *w, PyObject *const *from);

/* Every call goes through here: its arguments are counted, and all that it opened is closed again. */
static PyObject *called(Answer *answer, PyObject *args, int arguments) {
    PyObject *from[MOST_VIEWS];
    if (PyTuple_Size(args) != arguments)
        return PyErr_Format(PyExc_TypeError, "%d arguments are needed, not %zd", arguments, PyTuple_Size(args));
    for (int i = 0; i < arguments; i++)
        from[i] = PyTuple_GetItem(args, i);
    Call *call = PyMem_Calloc(1, sizeof *call);
    if (!call)
        return PyErr_NoMemory();
    PyObject *result = answer(call->views, &call->work, from);
    for (int i = 0; i < MOST_VIEWS; i++)
        if (call->views[i].open)
            PyBuffer_Release(&call->views[i].buffer);
    free(call->work.memory);
    PyMem_Free(call);
    return PyErr_Occurred() ? NULL : result;
}

/* refine(t, pv, co, numbers, p, low, high, stride, root, target, explained, evaluations, enough) -> deviance */
static PyObject *py_refine(View *v, Work *w, PyObject *const *from) {
    long evaluations = PyLong_AsLong(from[11]);
    double enough = PyFloat_AsDouble(from[12]), cost = 0;
    if (PyErr_Occurred() || read_record(w, v, from) || finite_view(from[4], &v[4], "p", 1) ||
        view(from[5], &v[5], "low", 0) || view(from[6], &v[6], "high", 0) ||
        finite_view(from[7], &v[7], "stride", 0) || finite_view(from[8], &v[8], "root", 0) ||
        finite_view(from[9], &v[9], "target", 0) || view(from[10], &v[10], "explained", 1))
        return NULL;
    int size = w->p.size, d = SIZE[w->p.type];
    for (int i = 4; i < 8; i++)
        if (sized(&v[i], size, i == 4 ? "p" : i == 5 ? "low" : i == 6 ? "high" : "stride"))
            return NULL;
    if (sized(&v[8], d * v[9].n, "root") || sized(&v[10], w->p.n, "explained"))
        return NULL;
    if (v[9].n > 64 || evaluations < 0 || evaluations > 100000 || !(enough >= 0))
        return refuse("target, evaluations or enough is outside its range"), NULL;
    Search s = {v[8].x, v[9].x, v[5].x, v[6].x, v[7].x, (int)v[9].n, (int)evaluations, enough};
    Py_BEGIN_ALLOW_THREADS
    cost = refine(w, &s, v[4].x);
    put_explained(w, v[10].x);
    Py_END_ALLOW_THREADS
    return PyFloat_FromDouble(cost);
}

/* costs(t, pv, co, numbers, points, out): the sum of squares at every point. */
static PyObject *py_costs(View *v, Work *w, PyObject *const *from) {
    if (read_record(w, v, from) || finite_view(from[4], &v[4], "points", 0) || view(from[5], &v[5], "out", 1) ||
        sized(&v[4], w->p.size * v[5].n, "points"))
        return NULL;
    Py_BEGIN_ALLOW_THREADS
    for (Py_ssize_t i = 0; i < v[5].n; i++) {
        solve(w, v[4].x + i * w->p.size);
        v[5].x[i] = w->cost;
    }
    Py_END_ALLOW_THREADS
    return Py_NewRef(Py_None);
}

/* project(t, pv, co, numbers, p, q, r, c, moved, columns, triangle): the linear problem solved at p; shapes (columns,
 * rows), (rows + 1), (columns), (n), (columns, n), (columns, columns). */
static PyObject *py_project(View *v, Work *w, PyObject *const *from) {
    static const char *const NAMES[] = {"q", "r", "c", "moved", "columns", "triangle"};
    if (read_record(w, v, from) || finite_view(from[4], &v[4], "p", 0) || sized(&v[4], w->p.size, "p"))
        return NULL;
    Py_ssize_t n = w->p.n, rows = w->p.rows, k = w->p.columns, sizes[] = {k * rows, rows + 1, k, n, k * n, k * k};
    for (int i = 0; i < 6; i++)
        if (view(from[5 + i], &v[5 + i], NAMES[i], 1) || sized(&v[5 + i], sizes[i], NAMES[i]))
            return NULL;
    Py_BEGIN_ALLOW_THREADS
    solve(w, v[4].x);
    put_basis_vectors(w->rotated, rows, (int)k, w->beta, v[5].x);
    put_residuals(w, v[6].x);
    back(w->rotated, rows, (int)k, w->inside, v[7].x);
    memcpy(v[8].x, w->moved, (size_t)n * sizeof(double));
    memcpy(v[9].x, w->column, (size_t)(k * n) * sizeof(double));
    for (Py_ssize_t i = 0; i < k; i++)
        for (Py_ssize_t j = 0; j < k; j++)
            v[10].x[i * k + j] = i <= j ? w->rotated[j * rows + i] : 0;
    Py_END_ALLOW_THREADS
    return Py_NewRef(Py_None);
}

/* jacobian(t, pv, co, numbers, p, out): shape (size, rows + 1). */
static PyObject *py_jacobian(View *v, Work *w, PyObject *const *from) {
    if (read_record(w, v, from) || finite_view(from[4], &v[4], "p", 0) || sized(&v[4], w->p.size, "p") ||
        view(from[5], &v[5], "out", 1) || sized(&v[5], w->p.size * (w->p.rows + 1), "out"))
        return NULL;
    Py_BEGIN_ALLOW_THREADS
    solve(w, v[4].x);
    put_jacobian(w, v[4].x, v[5].x);
    Py_END_ALLOW_THREADS
    return Py_NewRef(Py_None);
}

/* gains(t, pv, co, numbers, p, instants, corner, out): what a further load step (corner 0), or a change of the load's
 * slope (1), at each instant would bring. */
static PyObject *py_gains(View *v, Work *w, PyObject *const *from) {
    long corner = PyLong_AsLong(from[6]);
    if (PyErr_Occurred() || read_record(w, v, from) || finite_view(from[4], &v[4], "p", 0) ||
        sized(&v[4], w->p.size, "p") || finite_view(from[5], &v[5], "instants", 0) || view(from[7], &v[6], "out", 1) ||
        sized(&v[6], v[5].n, "out"))
        return NULL;
    Py_ssize_t rows = w->p.rows;
    double *memory = malloc((size_t)((w->p.columns + 1) * rows + 1) * sizeof *memory);
    if (!memory)
        return PyErr_NoMemory();
    Py_BEGIN_ALLOW_THREADS
    solve(w, v[4].x);
    put_basis_vectors(w->rotated, rows, w->p.columns, w->beta, memory);
    put_residuals(w, memory + w->p.columns * rows);
    load_gains(w, memory, memory + w->p.columns * rows, v[5].x, v[5].n, corner != 0, v[6].x);
    free(memory);
    Py_END_ALLOW_THREADS
    return Py_NewRef(Py_None);
}

/* colour(r, least, most_order) -> (std, coefficients) of the whitening filter of a remainder. */
static PyObject *py_colour(View *v, Work *w, PyObject *const *from) {
    (void)w;
    double least = PyFloat_AsDouble(from[1]), ar[MOST_AR], std;
    long most = PyLong_AsLong(from[2]);
    if (PyErr_Occurred() || finite_view(from[0], &v[0], "r", 0))
        return NULL;
    if (v[0].n < 1 || !(least > 0 && isfinite(least)) || most < 0 || most > MOST_AR || most >= v[0].n + (most == 0))
        return refuse("r, least or most_order is outside its range"), NULL;
    int order = colour_of(v[0].x, v[0].n, least, (int)most, ar, &std);
    PyObject *found = PyTuple_New(order);
    for (int i = 0; found && i < order; i++)
        PyTuple_SetItem(found, i, PyFloat_FromDouble(ar[i]));
    return Py_BuildValue("dN", std, found);
}

static int positive(const View *v, const char *sentence) {
    for (Py_ssize_t i = 0; i < v->n; i++)
        if (!(v->x[i] > 0))
            return refuse(sentence);
    return 0;
}

/* search(t, pv, co, numbers, lags, thetas, at, most, deviance, slope, chosen): shapes (nodes, most + 1) twice and (nodes,
 * most); infinity in deviance where a load step more brings nothing. An infinite lag is an integrating process. */
static PyObject *py_search(View *v, Work *w, PyObject *const *from) {
    static const char *const NAMES[] = {"deviance", "slope", "chosen"};
    long most = PyLong_AsLong(from[7]);
    if (PyErr_Occurred() || read_record(w, v, from) || view(from[4], &v[4], "lags", 0) ||
        finite_view(from[5], &v[5], "thetas", 0) || finite_view(from[6], &v[6], "at", 0) ||
        positive(&v[4], "lags: above 0") || positive(&v[5], "thetas: above 0"))
        return NULL;
    Py_ssize_t nodes = v[4].n * v[5].n;
    if (most < 0 || most > MOST_LOADS || v[6].n < most || w->p.n < 3 + most || v[6].n > 100000 || nodes > 1000000)
        return refuse("search: most or the grid is outside its range"), NULL;
    Py_ssize_t sizes[] = {nodes * (most + 1), nodes * (most + 1), nodes * most};
    for (int i = 0; i < 3; i++)
        if (view(from[8 + i], &v[8 + i], NAMES[i], 1) || sized(&v[8 + i], sizes[i], NAMES[i]))
            return NULL;
    Grid g = {v[4].x, v[5].x, v[6].x, v[4].n,   v[5].n,   v[6].n,
              (int)most, w->p.sigma,  v[8].x, v[9].x, v[10].x};
    int failed;
    Py_BEGIN_ALLOW_THREADS
    for (Py_ssize_t i = 0; i < v[8].n; i++)
        v[8].x[i] = INFINITY;
    failed = search(w, &g);
    Py_END_ALLOW_THREADS
    return failed ? PyErr_NoMemory() : Py_NewRef(Py_None);
}

static int are_valves(const View *v) {
    if (v->n % VALVE)
        return refuse("valves: four numbers each are needed");
    for (Py_ssize_t i = 0; i < v->n; i += VALVE) {
        const double *x = v->x + i;
        if (!((x[FAMILY] == 0 || x[FAMILY] == 1) && x[STICK] > 0 && x[JUMP] >= 0 && fabs(x[START]) <= 1))
            return refuse("valves: a family of 0 or 1, a band above 0, a jump from 0, a start within -1 and 1");
    }
    return 0;
}

/* position(valve, co, out): counted from the first value. */
static PyObject *py_position(View *v, Work *w, PyObject *const *from) {
    (void)w;
    if (finite_view(from[0], &v[0], "valve", 0) || sized(&v[0], VALVE, "valve") || are_valves(&v[0]) ||
        finite_view(from[1], &v[1], "co", 0) || view(from[2], &v[2], "out", 1) || sized(&v[2], v[1].n, "out"))
        return NULL;
    if (v[1].n < 1)
        return refuse("co: at least one sample is needed"), NULL;
    position(v[0].x, v[1].x, v[1].n, v[2].x);
    return Py_NewRef(Py_None);
}

/* scan(t, pv, co, numbers, valves, lags, seconds, thetas, q, y, first, stride, left, gain) */
static PyObject *py_scan(View *v, Work *w, PyObject *const *from) {
    Py_ssize_t first = PyLong_AsSsize_t(from[10]), stride = PyLong_AsSsize_t(from[11]);
    if (PyErr_Occurred() || read_record(w, v, from) || finite_view(from[4], &v[4], "valves", 0) ||
        are_valves(&v[4]) || finite_view(from[5], &v[5], "lags", 0) || finite_view(from[6], &v[6], "seconds", 0) ||
        finite_view(from[7], &v[7], "thetas", 0) || positive(&v[5], "lags: above 0") ||
        positive(&v[7], "thetas: above 0") || finite_view(from[8], &v[8], "q", 0) ||
        finite_view(from[9], &v[9], "y", 0) || view(from[12], &v[10], "left", 1) || view(from[13], &v[11], "gain", 1))
        return NULL;
    if (first < 0 || first >= w->p.n || stride < 1 || v[5].n > 64 || v[7].n > 64)
        return refuse("scan: rows or nodes are outside their range"), NULL;
    Py_ssize_t rows = (w->p.n - first - 1) / stride + 1, nodes = v[5].n * v[7].n, many = v[4].n / VALVE;
    if (sized(&v[6], v[5].n, "seconds") || sized(&v[8], 3 * v[5].n * rows, "q") ||
        sized(&v[9], v[5].n * rows, "y") || sized(&v[10], many * nodes, "left") || sized(&v[11], many * nodes, "gain"))
        return NULL;
    Scan s = {v[4].x, v[2].x, v[5].x, v[6].x, v[7].x, v[8].x, v[9].x,  many,
              v[5].n, v[7].n, first,  stride, rows,   v[10].x, v[11].x};
    int failed;
    Py_BEGIN_ALLOW_THREADS
    failed = scan(w, &s);
    Py_END_ALLOW_THREADS
    return failed ? PyErr_NoMemory() : Py_NewRef(Py_None);
}

/* valve_costs(t, pv, co, numbers, p, valves, out) */
static PyObject *py_valve_costs(View *v, Work *w, PyObject *const *from) {
    if (read_record(w, v, from) || finite_view(from[4], &v[4], "p", 0) || sized(&v[4], w->p.size, "p") ||
        finite_view(from[5], &v[5], "valves", 0) || are_valves(&v[5]) || view(from[6], &v[6], "out", 1) ||
        sized(&v[5], VALVE * v[6].n, "valves"))
        return NULL;
    double *input = malloc((size_t)w->p.n * sizeof *input);
    if (!input)
        return PyErr_NoMemory();
    Py_BEGIN_ALLOW_THREADS
    valve_costs(w, v[4].x, v[5].x, v[6].n, v[2].x, input, v[6].x);
    free(input);
    Py_END_ALLOW_THREADS
    return Py_NewRef(Py_None);
}

/* slip_costs(t, pv, co, numbers, p, slips, rows, out) */
static PyObject *py_slip_costs(View *v, Work *w, PyObject *const *from) {
    if (read_record(w, v, from) || finite_view(from[4], &v[4], "p", 0) || sized(&v[4], w->p.size, "p") ||
        finite_view(from[5], &v[5], "slips", 0) || finite_view(from[6], &v[6], "rows", 0) ||
        view(from[7], &v[7], "out", 1) || sized(&v[7], v[5].n / 3 * 2, "out") || sized(&v[5], v[5].n / 3 * 3, "slips"))
        return NULL;
    Py_ssize_t all = 0;
    for (Py_ssize_t i = 0; i < v[5].n; i += 3) {
        int many;
        if (count_in(v[5].x[i], 100000, &many) || all + many > v[6].n)
            return PyErr_Occurred() ? NULL : (refuse("rows: fewer than the slips have"), NULL);
        double before = -1;
        for (; many; many--, before = v[6].x[all++])
            if (!(v[6].x[all] > before && v[6].x[all] < (double)w->p.n && v[6].x[all] == floor(v[6].x[all])))
                return refuse("rows: of the record, ascending, are needed"), NULL;
    }
    double *input = malloc((size_t)w->p.n * sizeof *input);
    if (!input)
        return PyErr_NoMemory();
    Py_BEGIN_ALLOW_THREADS
    slip_costs(w, v[4].x, v[5].x, v[5].n / 3, v[6].x, v[2].x, input, v[7].x);
    free(input);
    Py_END_ALLOW_THREADS
    return Py_NewRef(Py_None);
}

/* screen(t, sp, pv, co, longest, band, shortest, width, out): the numbers of a record, in the order of Sums. */
static PyObject *py_screen(View *v, Work *w, PyObject *const *from) {
    (void)w;
    static const char *const NAMES[] = {"t", "sp", "pv", "co"};
    Measure by = {PyFloat_AsDouble(from[4]), PyFloat_AsDouble(from[5]), PyFloat_AsDouble(from[6]),
                  PyLong_AsSsize_t(from[7])};
    if (PyErr_Occurred())
        return NULL;
    for (int i = 0; i < 4; i++)
        if (finite_view(from[i], &v[i], NAMES[i], 0) || sized(&v[i], v[0].n, NAMES[i]))
            return NULL;
    if (increasing(&v[0]) || view(from[8], &v[4], "out", 1) || sized(&v[4], SUMS, "out"))
        return NULL;
    if (v[0].n < 3 || !(by.longest > 0 && by.band >= 0 && by.shortest >= 1) || by.width < 1 || by.width > v[0].n)
        return refuse("screen: three samples, longest and shortest above 0, band from 0, a width of 1 to all are needed"),
               NULL;
    Sums sums;
    Py_BEGIN_ALLOW_THREADS
    screen(v[0].x, v[1].x, v[2].x, v[3].x, v[0].n, &by, &sums);
    Py_END_ALLOW_THREADS
    memcpy(v[4].x, &sums, sizeof sums);
    return Py_NewRef(Py_None);
}

/* Whether all of some numbers lie within two bounds. */
static int within(const View *v, double low, double high, const char *sentence) {
    for (Py_ssize_t i = 0; i < v->n; i++)
        if (!(v->x[i] >= low && v->x[i] <= high))
            return refuse(sentence);
    return 0;
}

static int are_loads(const View *v) {
    if (v->n % LOAD)
        return refuse("loads: seven numbers each are needed");
    for (Py_ssize_t i = 0; i < v->n; i += LOAD)
        if (!(v->x[i] == floor(v->x[i]) && v->x[i] >= 1 && v->x[i] <= MOST_DEGREE))
            return refuse("loads: a degree of 1 to 3");
    return 0;
}

/* walk(pv, inputs, loads, seconds, falls, deads, numbers, tones, ends, gain, information, left): see Walk; numbers are pole,
 * rise, noise and smoothing. */
static PyObject *py_walk(View *v, Work *w, PyObject *const *from) {
    (void)w;
    static const char *const NAMES[] = {"pv", "inputs", "loads", "seconds", "falls", "deads", "numbers", "tones", "ends"};
    static const char *const ANSWERS[] = {"gain", "information", "left"};
    for (int i = 0; i < 9; i++)
        if (finite_view(from[i], &v[i], NAMES[i], 0))
            return NULL;
    Py_ssize_t n = v[0].n, inputs = n ? v[1].n / n : 0, rows = inputs * v[3].n, tones = n ? v[7].n / n : 0;
    if (n < LANES || n > 10000000 || inputs > 4096 || v[3].n > 64 || v[4].n > MOST_FALLS || v[5].n > MOST_DEADS)
        return refuse("walk: too few samples, or too many inputs, lags or dead times"), NULL;
    if (tones > MOST_TONES || v[8].n < 1 || v[8].n > 1 + MOST_TONES)
        return refuse("walk: too many tones, or no number of them"), NULL;
    if (sized(&v[1], inputs * n, "inputs") || are_loads(&v[2]) ||
        within(&v[3], 0, 1, "seconds: poles from 0 to 1") || within(&v[4], 0, 1, "falls: poles from 0 to 1") ||
        within(&v[5], 0, 100000, "deads: 0 to 100000 samples") || sized(&v[6], 4, "numbers") ||
        within(&v[6], 0, 1e300, "numbers: none below 0") || sized(&v[7], tones * n, "tones") ||
        within(&v[8], 0, (double)tones, "ends: numbers of tones"))
        return NULL;
    if (!(v[6].x[1] > 0)) /* inputs that are behind the lags already are one row each */
        return refuse("numbers: a rise above 0"), NULL;
    for (int i = 0; i < 3; i++)
        if (view(from[9 + i], &v[9 + i], ANSWERS[i], 1) ||
            sized(&v[9 + i], v[2].n / LOAD * v[8].n * rows * v[5].n, ANSWERS[i]))
            return NULL;
    Walk of = {v[0].x, v[1].x, v[2].x, v[3].x, v[4].x, v[5].x, v[7].x, v[8].x, n, inputs, v[2].n / LOAD, v[3].n, v[4].n,
               v[5].n, tones, v[8].n, v[6].x[0], v[6].x[1], v[6].x[2], v[6].x[3], v[9].x, v[10].x, v[11].x};
    int failed;
    Py_BEGIN_ALLOW_THREADS
    failed = walk(&of);
    Py_END_ALLOW_THREADS
    return failed ? PyErr_NoMemory() : Py_NewRef(Py_None);
}

/* whiten(pv, inputs, load, numbers, out) -> columns: see whiten_one; numbers are smoothing, pole of the further lag and the
 * pole that an unknown start falls with, 0 for none. out : pv, the shock and room for five columns. */
static PyObject *py_whiten(View *v, Work *w, PyObject *const *from) {
    (void)w;
    static const char *const NAMES[] = {"pv", "inputs", "load", "numbers"};
    for (int i = 0; i < 4; i++)
        if (finite_view(from[i], &v[i], NAMES[i], 0))
            return NULL;
    Py_ssize_t n = v[0].n, inputs = v[1].n ? 1 : 0;
    if (n < LANES || n > 10000000)
        return refuse("whiten: too few samples"), NULL;
    if (sized(&v[1], inputs * n, "inputs") || sized(&v[2], LOAD, "load") || are_loads(&v[2]) || sized(&v[3], 3, "numbers") ||
        within(&v[3], 0, 1, "numbers: 0 to 1") || view(from[4], &v[4], "out", 1) || sized(&v[4], 7 * n, "out"))
        return NULL;
    static const double NO_LAG[] = {0};
    Walk of = {v[0].x, v[1].x, v[2].x, NO_LAG, v[3].x + 2, NULL, NULL, NULL, n, inputs, 1, 1, v[3].x[2] > 0, 0, 0, 0, 0, 0, 0,
               v[3].x[0], NULL, NULL, NULL};
    Py_ssize_t columns;
    Py_BEGIN_ALLOW_THREADS
    columns = whiten_one(&of, v[3].x[1], v[4].x, v[4].x + n, v[4].x + 2 * n);
    Py_END_ALLOW_THREADS
    return columns < 0 ? PyErr_NoMemory() : PyLong_FromSsize_t(columns);
}

/* mix(gain, information, left, half, gains, groups, spans, size, rows, out): see Mixture. */
static PyObject *py_mix(View *v, Work *w, PyObject *const *from) {
    (void)w;
    static const char *const NAMES[] = {"gain", "information", "left", "half", "gains", "groups", "spans"};
    double size = PyFloat_AsDouble(from[7]);
    Py_ssize_t rows = PyLong_AsSsize_t(from[8]);
    if (PyErr_Occurred())
        return NULL;
    for (int i = 0; i < 7; i++)
        if (finite_view(from[i], &v[i], NAMES[i], 0))
            return NULL;
    Py_ssize_t loads = v[3].n, groups = loads ? v[5].n / loads : 0, deads = rows > 0 && loads ? v[0].n / loads / rows : 0, many = rows > 0 ? v[4].n / rows : 0;
    if (loads < 1 || loads > MOST_MIXED || rows < 1 || deads < 1 || !(size > 0 && isfinite(size)))
        return refuse("mix: loads, rows or size are outside their range"), NULL;
    for (int i = 0; i < 3; i++)
        if (v[0].n / loads / rows != deads || sized(&v[i], loads * rows * deads, NAMES[i]))
            return NULL;
    if (sized(&v[4], rows * many, "gains") || sized(&v[5], groups * loads, "groups") ||
        sized(&v[6], 2 * rows * deads, "spans") || within(&v[6], 0, (double)many, "spans: gains of the grid") ||
        view(from[9], &v[7], "out", 1) || sized(&v[7], groups * rows * deads * many, "out"))
        return NULL;
    Mixture m = {v[0].x, v[1].x, v[2].x, v[3].x, v[4].x, v[5].x, v[6].x, loads, rows, deads, many, groups, size, v[7].x};
    Py_BEGIN_ALLOW_THREADS
    mix(&m);
    Py_END_ALLOW_THREADS
    return Py_NewRef(Py_None);
}

/* any_load(pv, co, deads, gains, spans, numbers, order, left): see AnyLoad; numbers are pole, rise, second pole and noise. */
static PyObject *py_any_load(View *v, Work *w, PyObject *const *from) {
    (void)w;
    static const char *const NAMES[] = {"pv", "co", "deads", "gains", "spans", "numbers"};
    Py_ssize_t order = PyLong_AsSsize_t(from[6]);
    if (PyErr_Occurred())
        return NULL;
    for (int i = 0; i < 6; i++)
        if (finite_view(from[i], &v[i], NAMES[i], 0))
            return NULL;
    Py_ssize_t n = v[0].n, deads = v[2].n, gains = v[3].n;
    if (order < 1 || order > MOST_ORDER || n <= 2 * order || n > 10000000 || gains < 1)
        return refuse("any_load: too few samples or gains, or the order is outside its range"), NULL;
    if (sized(&v[1], n, "co") || within(&v[2], 0, 100000, "deads: 0 to 100000 samples") || sized(&v[4], 2 * deads, "spans") ||
        within(&v[4], 0, (double)gains, "spans: gains of the grid") || sized(&v[5], 4, "numbers") ||
        within(&v[5], 0, 1e300, "numbers: none below 0") || view(from[7], &v[6], "left", 1) ||
        sized(&v[6], deads * gains, "left"))
        return NULL;
    AnyLoad of = {v[0].x, v[1].x, v[2].x, v[3].x, v[4].x, n, deads, gains, v[5].x[0], v[5].x[1], v[5].x[2], v[5].x[3], v[6].x,
                  (int)order};
    int failed;
    Py_BEGIN_ALLOW_THREADS
    failed = any_load(&of);
    Py_END_ALLOW_THREADS
    return failed ? PyErr_NoMemory() : Py_NewRef(Py_None);
}

/* pv, response and rest, from the first three arguments, and numbers from the fourth: the share, then top and bottom, or none. */
static int read_stepped(Stepped *s, View *v, PyObject *const *from) {
    static const char *const NAMES[] = {"pv", "response", "rest", "numbers"};
    for (int i = 0; i < 4; i++)
        if (finite_view(from[i], &v[i], NAMES[i], 0))
            return -1;
    s->poles = v[3].n - 3;
    if (v[3].n != 1 && !(s->poles >= 0 && s->poles <= MOST_POLES))
        return refuse("numbers: a share, and a filter of two terms and 0 to 4 poles or none are needed");
    s->unique = v[3].x[0];
    memset(s->bottom, 0, sizeof s->bottom);
    if (s->poles >= 0)
        memcpy(s->top, v[3].x + 1, sizeof s->top), memcpy(s->bottom, v[3].x + 3, (size_t)s->poles * sizeof *s->bottom);
    s->pv = v[0].x, s->response = v[1].x, s->rest = v[2].x, s->n = v[0].n;
    s->rest_count = s->n ? v[2].n / s->n : 0;
    if (s->n < 2 || s->rest_count > 16 || !(s->unique >= 0))
        return refuse("steps: two samples, at most 16 columns beside the steps and a share from 0 are needed");
    return sized(&v[1], s->n, "response") || sized(&v[2], s->rest_count * s->n, "rest") ? -1 : 0;
}

enum { MOST_STEPS = 256 };

/* steps(pv, response, rest, numbers, rows, left) -> how many: up to as many as rows has room for; left has one more. */
static PyObject *py_steps(View *v, Work *w, PyObject *const *from) {
    (void)w;
    Stepped s;
    if (read_stepped(&s, v, from) || view(from[4], &v[4], "rows", 1) || view(from[5], &v[5], "left", 1) ||
        sized(&v[5], v[4].n + 1, "left"))
        return NULL;
    if (v[4].n > MOST_STEPS)
        return refuse("steps: too many"), NULL;
    Py_ssize_t count;
    Py_BEGIN_ALLOW_THREADS
    count = choose_steps(&s, v[4].n, v[4].x, v[5].x);
    Py_END_ALLOW_THREADS
    return count < 0 ? PyErr_NoMemory() : PyLong_FromSsize_t(count);
}

/* move_steps(pv, response, rest, numbers, rows, reach, passes) -> what is left; rows are moved in place. */
static PyObject *py_move_steps(View *v, Work *w, PyObject *const *from) {
    (void)w;
    Stepped s;
    Py_ssize_t reach = PyLong_AsSsize_t(from[5]), passes = PyLong_AsSsize_t(from[6]);
    if (PyErr_Occurred() || read_stepped(&s, v, from) || view(from[4], &v[4], "rows", 1))
        return NULL;
    if (v[4].n > MOST_STEPS || reach < 0 || reach > 10000000 || passes < 0 || passes > 100)
        return refuse("move_steps: steps, reach or passes are outside their range"), NULL;
    for (Py_ssize_t i = 0; i < v[4].n; i++)
        if (!(v[4].x[i] >= 0 && v[4].x[i] <= (double)(s.n - 2) && v[4].x[i] == floor(v[4].x[i])))
            return refuse("rows: columns of the record are needed"), NULL;
    double left;
    Py_BEGIN_ALLOW_THREADS
    left = move_steps(&s, v[4].x, v[4].n, reach, (int)passes);
    Py_END_ALLOW_THREADS
    return left < 0 ? PyErr_NoMemory() : PyFloat_FromDouble(left);
}

/* closed(phi, gamma, c, x, numbers, most, e, u): see Closed. */
static PyObject *py_closed(View *v, Work *w, PyObject *const *from) {
    (void)w;
    static const char *const NAMES[] = {"phi", "gamma", "c", "x", "numbers"};
    double most = PyFloat_AsDouble(from[5]);
    if (PyErr_Occurred())
        return NULL;
    for (int i = 0; i < 5; i++)
        if (finite_view(from[i], &v[i], NAMES[i], 0))
            return NULL;
    Py_ssize_t lanes = v[4].n / LANE, states = lanes ? v[1].n / lanes : 0;
    if (lanes < 1 || states < 1 || states > MOST_STATES || !(most > 0))
        return refuse("closed: too few lanes, too many states, or a limit that is none"), NULL;
    if (sized(&v[0], lanes * states * states, NAMES[0]) || sized(&v[4], lanes * LANE, NAMES[4]))
        return NULL;
    for (int i = 1; i < 4; i++)
        if (sized(&v[i], lanes * states, NAMES[i]))
            return NULL;
    for (Py_ssize_t i = 0; i < lanes; i++)
        if (!(v[4].x[i * LANE + WHOLE] >= 0 && v[4].x[i * LANE + WHOLE] <= 1e9))
            return refuse("numbers: a delay is outside its range"), NULL;
    if (view(from[6], &v[5], "e", 1) || view(from[7], &v[6], "u", 1) || v[5].n % lanes || sized(&v[6], v[5].n, "u"))
        return PyErr_Occurred() ? NULL : (refuse("e: as many points for each lane"), NULL);
    Closed l = {v[0].x, v[1].x, v[2].x, v[3].x, v[4].x, lanes, states, v[5].n / lanes, most, v[5].x, v[6].x};
    Py_BEGIN_ALLOW_THREADS
    for (Py_ssize_t i = 0; i < lanes; i++)
        lane_answer(&l, i);
    Py_END_ALLOW_THREADS
    return Py_NewRef(Py_None);
}

/* held(numbers, pv) -> samples of pv that were written: see held_answer. */
static PyObject *py_held(View *v, Work *w, PyObject *const *from) {
    (void)w;
    if (view(from[0], &v[0], "numbers", 0) || sized(&v[0], HELD, "numbers") || view(from[1], &v[1], "pv", 1))
        return NULL;
    if (!(v[0].x[LATE] >= 0 && v[0].x[LATE] <= 1e7))
        return refuse("numbers: a delay is outside its range"), NULL;
    double *u = calloc((size_t)v[1].n + (size_t)v[0].x[LATE] + 2, sizeof *u);
    Py_ssize_t count = 0;
    if (u) {
        Py_BEGIN_ALLOW_THREADS
        count = held_answer(v[0].x, v[1].n, u, v[1].x);
        Py_END_ALLOW_THREADS
        free(u);
    }
    return u ? PyLong_FromSsize_t(count) : PyErr_NoMemory();
}

/* Every function with how many arguments it has. */
#define FUNCTIONS(M)                                                                                                  \
    M(refine, 13) M(costs, 6) M(project, 11) M(jacobian, 6) M(gains, 8) M(colour, 3) M(search, 11) M(position, 3)     \
    M(scan, 14) M(valve_costs, 7) M(slip_costs, 8) M(screen, 9) M(walk, 12) M(mix, 10) M(any_load, 8) M(steps, 6)          \
    M(whiten, 5) M(move_steps, 7) M(closed, 8) M(held, 2)
#define DOOR(name, arguments)                                                                                         \
    static PyObject *door_##name(PyObject *self, PyObject *args) {                                                    \
        (void)self;                                                                                                   \
        return called(py_##name, args, arguments);                                                                    \
    }
#define METHOD(name, arguments) {#name, door_##name, METH_VARARGS, NULL},

FUNCTIONS(DOOR)

static PyMethodDef METHODS[] = {FUNCTIONS(METHOD){NULL, NULL, 0, NULL}};

static int on_load(PyObject *module) { return PyModule_AddStringConstant(module, "version", VERSION); }

static PyModuleDef_Slot SLOTS[] = {{Py_mod_exec, (void *)on_load}, {0, NULL}};

static struct PyModuleDef MODULE = {
    PyModuleDef_HEAD_INIT, "_engine", "The compiled engine of identification.", 0, METHODS, SLOTS, NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit__engine(void) { return PyModuleDef_Init(&MODULE); }
