/* Closed loops from sample to sample: many on few points (trial/batch_responses.py), and one whose process may run away by
 * itself (diagnosis/unstable_process.py). */

#ifndef RETUNER_CLOSED_H
#define RETUNER_CLOSED_H

#include "misfit.h"

enum { KP, KI, KD, FOLLOW, WEIGHT, SETPOINT, LOADED, WHOLE, SHARE, LANE, MOST_STATES = 16 };

/* Each lane has phi (states, states), gamma, c and x (states), and LANE numbers. e, u : (lanes, n). most : where u stops. */
typedef struct {
    const double *phi, *gamma, *c, *x, *numbers;
    Py_ssize_t lanes, states, n;
    double most, *e, *u;
} Closed;

static void lane_answer(const Closed *l, Py_ssize_t which) {
    Py_ssize_t m = l->states, n = l->n;
    const double *phi = l->phi + which * m * m, *gamma = l->gamma + which * m, *c = l->c + which * m;
    const double *p = l->numbers + which * LANE;
    double *e = l->e + which * n, *u = l->u + which * n, x[MOST_STATES], next[MOST_STATES], z = 0, filtered = 0;
    Py_ssize_t whole = (Py_ssize_t)p[WHOLE];
    memcpy(x, l->x + which * m, (size_t)m * sizeof *x);
    for (Py_ssize_t i = 0; i < n; i++) {
        double y = 0;
        for (Py_ssize_t j = 0; j < m; j++)
            y += c[j] * x[j];
        e[i] = p[SETPOINT] - y;
        z += i ? 0.5 * (e[i] + e[i - 1]) : 0;
        double raw = p[KP] * (p[WEIGHT] * p[SETPOINT] - y) + p[KI] * z - p[KD] * (y - filtered);
        filtered += p[FOLLOW] * (y - filtered);
        u[i] = raw > l->most ? l->most : raw < -l->most ? -l->most : raw;
        double now = i >= whole ? u[i - whole] : 0, before = i > whole ? u[i - whole - 1] : 0;
        double arrives = (1 - p[SHARE]) * now + p[SHARE] * before + p[LOADED];
        for (Py_ssize_t j = 0; j < m; j++) {
            double sum = 0;
            for (Py_ssize_t k = 0; k < m; k++)
                sum += phi[j * m + k] * x[k];
            next[j] = sum + gamma[j] * arrives;
        }
        memcpy(x, next, (size_t)m * sizeof *x);
    }
}

enum { SLOW, SLOW_OLD, SLOW_NEW, FAST, FAST_OLD, FAST_NEW, AT_ONE, RATE, DT_S, P_GAIN, I_GAIN, D_GAIN, B_WEIGHT, LATE, FAR_OFF, HELD };

/* pv after a unit setpoint step; the rest stays as it was from where pv is FAR_OFF: their number. u : (n + late + 2). */
static Py_ssize_t held_answer(const double *p, Py_ssize_t n, double *u, double *pv) {
    double x = 0, y = 0, integral = 0, rate = 0, last = 0;
    double *late = u + (Py_ssize_t)p[LATE] + 1;
    for (Py_ssize_t i = 0; i < n; i++) {
        double now = p[AT_ONE] * (x - y);
        if (!(fabs(now) < p[FAR_OFF]))
            return i;
        pv[i] = now;
        rate += p[RATE] * ((now - last) / p[DT_S] - rate);
        last = now;
        late[i] = p[P_GAIN] * (p[B_WEIGHT] - now) + integral - p[D_GAIN] * rate;
        integral += p[I_GAIN] * p[DT_S] * (1.0 - now);
        double old = u[i], new = u[i + 1];
        x = p[SLOW] * x + p[SLOW_OLD] * old + p[SLOW_NEW] * new;
        y = p[FAST] * y + p[FAST_OLD] * old + p[FAST_NEW] * new;
    }
    return n;
}

#endif
