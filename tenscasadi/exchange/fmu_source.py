"""C code of an FMU, in addition to the code of `export_c`."""

FMU_SOURCE = r"""/* Co-simulation of FMI 2.0: steps of the exported model between the communication points. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
/* One unit with names of its own: libraries export a function "step", too. */
#define CASADI_SYMBOL_EXPORT static
#include "tensegrity.c"
#include "start.h"
#include "unit.h"

#ifndef NP
#define NP 0
static const casadi_real p_start[1] = {0};
#endif
#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

typedef void *Unit;
typedef unsigned int Reference;
typedef int Status; /* 0 OK, 1 warning, 2 discard, 3 error */
enum { OK = 0, FAILED = 3 };
#define INPUTS (NU + NP)
#define OUTPUTS (6 * NODES + STRINGS)

typedef struct {
  casadi_real x[NX + 1], next[NX + 1], u[NU + 1], p[NP + 1], out[OUTPUTS + 1];
  int fresh;
  const casadi_real **arg;
  casadi_real **res, *w;
  casadi_int *iw;
} Model;

static void start(Model *m) {
  memcpy(m->x, x_start, NX * sizeof(casadi_real));
  memcpy(m->u, u_start, NU * sizeof(casadi_real));
  memcpy(m->p, p_start, NP * sizeof(casadi_real));
  m->fresh = 0;
}

EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORT const char *fmi2GetVersion(void) { return "2.0"; }
EXPORT void fmi2FreeInstance(Unit c) {
  Model *m = c;
  if (!m) return;
  free((void *)m->arg); free(m->res); free(m->iw); free(m->w); free(m);
}
EXPORT Unit fmi2Instantiate(const char *name, int kind, const char *guid, const char *place,
                            const void *functions, int visible, int logging) {
  casadi_int arg = 0, res = 0, iw = 0, w = 0, a = 0, r = 0, i = 0, v = 0;
  Model *m;
  (void)name; (void)place; (void)functions; (void)visible; (void)logging;
  if (kind != 1 || !guid || strcmp(guid, GUID)) return NULL; /* co-simulation alone */
  if (!(m = calloc(1, sizeof *m))) return NULL;
  step_work(&arg, &res, &iw, &w);
  observe_work(&a, &r, &i, &v);
  arg = a > arg ? a : arg; res = r > res ? r : res; iw = i > iw ? i : iw; w = v > w ? v : w;
  m->arg = calloc((size_t)arg + 5, sizeof *m->arg);
  m->res = calloc((size_t)res + 12, sizeof *m->res);
  m->iw = calloc((size_t)iw + 1, sizeof *m->iw);
  m->w = calloc((size_t)w + 1, sizeof *m->w);
  if (!m->arg || !m->res || !m->iw || !m->w) { fmi2FreeInstance(m); return NULL; }
  start(m);
  return m;
}
EXPORT Status fmi2Reset(Unit c) { start(c); return OK; }
EXPORT Status fmi2SetupExperiment(Unit c, int a, double b, double t, int d, double e) {
  (void)c; (void)a; (void)b; (void)t; (void)d; (void)e; return OK;
}
EXPORT Status fmi2SetDebugLogging(Unit c, int a, size_t n, const char *const s[]) {
  (void)c; (void)a; (void)n; (void)s; return OK;
}
EXPORT Status fmi2EnterInitializationMode(Unit c) { (void)c; return OK; }
EXPORT Status fmi2ExitInitializationMode(Unit c) { (void)c; return OK; }
EXPORT Status fmi2Terminate(Unit c) { (void)c; return OK; }

static int observe_model(Model *m) {
  memset(m->res, 0, (RESULTS + 1) * sizeof *m->res);
  m->arg[0] = m->x; m->arg[1] = m->u; m->arg[2] = m->p;
  m->res[AT_NODES] = m->out;
  m->res[AT_VELOCITIES] = m->out + 3 * NODES;
  m->res[AT_TENSION] = m->out + 6 * NODES;
  m->fresh = !observe(m->arg, m->res, m->iw, m->w, 0);
  return m->fresh;
}
EXPORT Status fmi2SetReal(Unit c, const Reference r[], size_t n, const double value[]) {
  Model *m = c;
  size_t k;
  for (k = 0; k < n; ++k) {
    if (r[k] >= INPUTS) return FAILED;
    if (r[k] < NU) m->u[r[k]] = (casadi_real)value[k];
    else m->p[r[k] - NU] = (casadi_real)value[k];
  }
  m->fresh = 0;
  return OK;
}
EXPORT Status fmi2GetReal(Unit c, const Reference r[], size_t n, double value[]) {
  Model *m = c;
  size_t k;
  for (k = 0; k < n; ++k) {
    if (r[k] >= INPUTS + OUTPUTS) return FAILED;
    if (r[k] < NU) value[k] = (double)m->u[r[k]];
    else if (r[k] < INPUTS) value[k] = (double)m->p[r[k] - NU];
    else {
      if (!m->fresh && !observe_model(m)) return FAILED;
      value[k] = (double)m->out[r[k] - INPUTS];
    }
  }
  return OK;
}
EXPORT Status fmi2DoStep(Unit c, double now, double length, int keep) {
  Model *m = c;
  double count = ceil(length / LARGEST_STEP - 1e-9);
  casadi_real h;
  long k, i, steps;
  (void)now; (void)keep;
  if (!(length >= 0) || count > 1e9) return FAILED;
  if (length == 0) return OK;
  steps = count < 1 ? 1 : (long)count;
  h = (casadi_real)(length / (double)steps);
  for (k = 0; k < steps; ++k) {
    m->arg[0] = m->x; m->arg[1] = m->u;
    if (NP) { m->arg[2] = m->p; m->arg[3] = &h; } else m->arg[2] = &h;
    m->res[0] = m->next;
    if (step(m->arg, m->res, m->iw, m->w, 0)) return FAILED;
    for (i = 0; i < NX; ++i) if (!(m->next[i] - m->next[i] == 0)) return FAILED;
    memcpy(m->x, m->next, NX * sizeof(casadi_real));
  }
  m->fresh = 0;
  return OK;
}
EXPORT Status fmi2CancelStep(Unit c) { (void)c; return FAILED; }

/* This unit has real variables alone, and keeps no states. */
#define NONE(name, kind) \
  EXPORT Status fmi2Get##name(Unit c, const Reference r[], size_t n, kind v[]) { (void)c; (void)r; (void)v; return n ? FAILED : OK; } \
  EXPORT Status fmi2Set##name(Unit c, const Reference r[], size_t n, const kind v[]) { (void)c; (void)r; (void)v; return n ? FAILED : OK; }
typedef const char *Text;
NONE(Integer, int)
NONE(Boolean, int)
NONE(String, Text)
EXPORT Status fmi2GetFMUstate(Unit c, void **s) { (void)c; (void)s; return FAILED; }
EXPORT Status fmi2SetFMUstate(Unit c, void *s) { (void)c; (void)s; return FAILED; }
EXPORT Status fmi2FreeFMUstate(Unit c, void **s) { (void)c; (void)s; return FAILED; }
EXPORT Status fmi2SerializedFMUstateSize(Unit c, void *s, size_t *n) { (void)c; (void)s; (void)n; return FAILED; }
EXPORT Status fmi2SerializeFMUstate(Unit c, void *s, char b[], size_t n) { (void)c; (void)s; (void)b; (void)n; return FAILED; }
EXPORT Status fmi2DeSerializeFMUstate(Unit c, const char b[], size_t n, void **s) { (void)c; (void)b; (void)n; (void)s; return FAILED; }
EXPORT Status fmi2GetDirectionalDerivative(Unit c, const Reference a[], size_t n, const Reference b[], size_t k, const double d[], double e[]) {
  (void)c; (void)a; (void)n; (void)b; (void)k; (void)d; (void)e; return FAILED;
}
EXPORT Status fmi2SetRealInputDerivatives(Unit c, const Reference r[], size_t n, const int o[], const double v[]) {
  (void)c; (void)r; (void)n; (void)o; (void)v; return FAILED;
}
EXPORT Status fmi2GetRealOutputDerivatives(Unit c, const Reference r[], size_t n, const int o[], double v[]) {
  (void)c; (void)r; (void)n; (void)o; (void)v; return FAILED;
}
EXPORT Status fmi2GetStatus(Unit c, int k, Status *v) { (void)c; (void)k; *v = OK; return OK; }
EXPORT Status fmi2GetRealStatus(Unit c, int k, double *v) { (void)c; (void)k; (void)v; return FAILED; }
EXPORT Status fmi2GetIntegerStatus(Unit c, int k, int *v) { (void)c; (void)k; (void)v; return FAILED; }
EXPORT Status fmi2GetBooleanStatus(Unit c, int k, int *v) { (void)c; (void)k; (void)v; return FAILED; }
EXPORT Status fmi2GetStringStatus(Unit c, int k, const char **v) { (void)c; (void)k; (void)v; return FAILED; }
"""
