/* A lag for model exchange, FMI 2 or (with FMI3 defined) FMI 3:  tau x' = k u - x,  y = x.
   State event: above x = 50 the lag is twice as long. Time event: at t = 100 s the gain doubles. */
#include <math.h>
#include <stdlib.h>
#ifdef FMI3
#include "fmi3Functions.h"
#define F(name) fmi3##name
typedef fmi3Instance It;
typedef fmi3Float64 Real;
typedef fmi3Boolean Bool;
typedef fmi3ValueReference Vr;
typedef fmi3Status Status;
#define MORE , size_t n_values
#else
#include "fmi2Functions.h"
#define F(name) fmi2##name
typedef fmi2Component It;
typedef fmi2Real Real;
typedef fmi2Boolean Bool;
typedef fmi2ValueReference Vr;
typedef fmi2Status Status;
#define MORE
#endif
enum { T, U, Y, K, TAU, X, DX, COUNT };
typedef struct { double v[COUNT]; int high, doubled; } Model;
#define M ((Model *)it)
#define EVENT_AT 100.0
#define LIMIT 50.0

static It made(void) {
    Model *it = calloc(1, sizeof(Model));
    M->v[K] = 1.0; M->v[TAU] = 10.0;
    return it;
}
static double slope(It it) {
    return (M->v[K] * (M->doubled ? 2.0 : 1.0) * M->v[U] - M->v[X]) / (M->v[TAU] * (M->high ? 2.0 : 1.0));
}
static void settle(It it) {
    M->high = M->v[X] >= LIMIT;
    if (M->v[T] >= EVENT_AT - 1e-9) M->doubled = 1;
}
#ifdef FMI3
It fmi3InstantiateModelExchange(fmi3String a, fmi3String b, fmi3String c, fmi3Boolean d, fmi3Boolean e,
                                fmi3InstanceEnvironment f, fmi3LogMessageCallback g) { return made(); }
Status fmi3EnterInitializationMode(It it, Bool a, Real b, Real t, Bool c, Real d) { M->v[T] = t; return 0; }
Status fmi3UpdateDiscreteStates(It it, Bool *again, Bool *over, Bool *n, Bool *v, Bool *defined, Real *at) {
    settle(it); *again = *over = *n = *v = 0; *defined = !M->doubled; *at = EVENT_AT; return 0;
}
Status fmi3GetContinuousStateDerivatives(It it, Real dx[], size_t n) { dx[0] = slope(it); return 0; }
Status fmi3GetNumberOfContinuousStates(It it, size_t *n) { *n = 1; return 0; }
Status fmi3GetNumberOfEventIndicators(It it, size_t *n) { *n = 1; return 0; }
#else
const char *fmi2GetTypesPlatform(void) { return "default"; }
It fmi2Instantiate(fmi2String a, fmi2Type b, fmi2String c, fmi2String d, const fmi2CallbackFunctions *e, fmi2Boolean f,
                   fmi2Boolean g) { return made(); }
Status fmi2SetupExperiment(It it, Bool a, Real b, Real t, Bool c, Real d) { M->v[T] = t; return 0; }
Status fmi2EnterInitializationMode(It it) { return 0; }
Status fmi2NewDiscreteStates(It it, fmi2EventInfo *info) {
    settle(it);
    info->newDiscreteStatesNeeded = info->terminateSimulation = info->nominalsOfContinuousStatesChanged = 0;
    info->valuesOfContinuousStatesChanged = 0;
    info->nextEventTimeDefined = !M->doubled; info->nextEventTime = EVENT_AT;
    return 0;
}
Status fmi2GetDerivatives(It it, Real dx[], size_t n) { dx[0] = slope(it); return 0; }
#endif
const char *F(GetVersion)(void) { return
#ifdef FMI3
    "3.0";
#else
    "2.0";
#endif
}
void F(FreeInstance)(It it) { free(it); }
Status F(ExitInitializationMode)(It it) { return 0; }
Status F(Terminate)(It it) { return 0; }
Status F(EnterEventMode)(It it) { return 0; }
Status F(EnterContinuousTimeMode)(It it) { return 0; }
Status F(CompletedIntegratorStep)(It it, Bool a, Bool *event, Bool *over) { *event = *over = 0; return 0; }
Status F(SetTime)(It it, Real t) { M->v[T] = t; return 0; }
Status F(SetContinuousStates)(It it, const Real x[], size_t n) { M->v[X] = x[0]; return 0; }
Status F(GetContinuousStates)(It it, Real x[], size_t n) { x[0] = M->v[X]; return 0; }
Status F(GetNominalsOfContinuousStates)(It it, Real x[], size_t n) { x[0] = 1.0; return 0; }
Status F(GetEventIndicators)(It it, Real z[], size_t n) { z[0] = M->v[X] - LIMIT; return 0; }
static Status read(It it, const Vr vr[], size_t n, Real value[]) {
    for (size_t i = 0; i < n; i++) value[i] = vr[i] == Y ? M->v[X] : vr[i] == DX ? slope(it) : M->v[vr[i]];
    return 0;
}
static Status write(It it, const Vr vr[], size_t n, const Real value[]) {
    for (size_t i = 0; i < n; i++) M->v[vr[i]] = value[i];
    return 0;
}
#ifdef FMI3
Status fmi3GetFloat64(It it, const Vr vr[], size_t n, Real v[] MORE) { return read(it, vr, n, v); }
Status fmi3SetFloat64(It it, const Vr vr[], size_t n, const Real v[] MORE) { return write(it, vr, n, v); }
#else
Status fmi2GetReal(It it, const Vr vr[], size_t n, Real v[]) { return read(it, vr, n, v); }
Status fmi2SetReal(It it, const Vr vr[], size_t n, const Real v[]) { return write(it, vr, n, v); }
#endif
