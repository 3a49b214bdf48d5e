// Number type of LANES doubles, or floats with SINGLE, one for each run. C code by CasADi compiles with it as casadi_real.
// It has no truth value, so code that branches on numbers does not compile instead of following the first lane.
#include <math.h>
#include <stdint.h>
#include <stdlib.h>

#define __STDC_VERSION__ 201112L  // CasADi's helpers then call fmin, log1p and hypot, as they do in C

#ifdef SINGLE
typedef float number;
typedef int32_t whole;
#else
typedef double number;
typedef int64_t whole;
#endif

#if LANES == 1
typedef number lanes;
static inline double get(const lanes &a, int) { return a; }
static inline void set(lanes &a, int, double x) { a = x; }
static inline lanes pick(lanes c, lanes a, lanes b) { return c ? a : b; }
#else
typedef number lanes_v __attribute__((vector_size(sizeof(number) * LANES)));
typedef whole lanes_m __attribute__((vector_size(sizeof(number) * LANES)));

struct lanes {
  lanes_v v;
  lanes() = default;
  lanes(double x) : v((number)x - (lanes_v){}) {}
  lanes(lanes_v x) : v(x) {}
  // 1 if a comparison holds, else 0, as in C
  lanes(lanes_m m) : v((lanes_v)(m & (lanes_m)((lanes_v){} + (number)1))) {}
};

static inline double get(const lanes &a, int k) { return a.v[k]; }
static inline void set(lanes &a, int k, double x) { a.v[k] = x; }

#define LANES_BINARY(OP) static inline lanes operator OP(lanes a, lanes b) { return a.v OP b.v; }
LANES_BINARY(+) LANES_BINARY(-) LANES_BINARY(*) LANES_BINARY(/)
#define LANES_COMPARE(OP) static inline lanes operator OP(lanes a, lanes b) { return (lanes_m)(a.v OP b.v); }
LANES_COMPARE(<) LANES_COMPARE(<=) LANES_COMPARE(>) LANES_COMPARE(>=) LANES_COMPARE(==) LANES_COMPARE(!=)
#define LANES_ASSIGN(OP) static inline lanes &operator OP##=(lanes &a, lanes b) { a.v OP##= b.v; return a; }
LANES_ASSIGN(+) LANES_ASSIGN(-) LANES_ASSIGN(*) LANES_ASSIGN(/)

static inline lanes operator-(lanes a) { return -a.v; }
static inline lanes operator!(lanes a) { return (lanes_m)(a.v == (number)0); }
static inline lanes operator&&(lanes a, lanes b) { return (lanes_m)((a.v != (number)0) & (b.v != (number)0)); }
static inline lanes operator||(lanes a, lanes b) { return (lanes_m)((a.v != (number)0) | (b.v != (number)0)); }

// a if c is true, else b; the other value may be anything
static inline lanes choose(lanes_m c, lanes_v a, lanes_v b) { return (lanes_v)(((lanes_m)a & c) | ((lanes_m)b & ~c)); }
static inline lanes select(lanes c, lanes a) { return (lanes_v)((lanes_m)a.v & (c.v != (number)0)); }
static inline lanes pick(lanes c, lanes a, lanes b) { return choose(c.v != (number)0, a.v, b.v); }
static inline lanes fmax(lanes a, lanes b) { return choose((a.v > b.v) | (b.v != b.v), a.v, b.v); }
static inline lanes fmin(lanes a, lanes b) { return choose((a.v < b.v) | (b.v != b.v), a.v, b.v); }
static inline lanes fabs(lanes a) { return (lanes_v)((lanes_m)a.v & ~(lanes_m)(-(lanes_v){})); }
static inline lanes sign(lanes a) { return choose(a.v < (number)0, lanes(-1.0).v, choose(a.v > (number)0, lanes(1.0).v, a.v).v); }

#define LANES_MAP(F) \
  static inline lanes F(lanes a) { lanes r; for (int k = 0; k < LANES; ++k) r.v[k] = ::F(a.v[k]); return r; }
LANES_MAP(exp) LANES_MAP(log) LANES_MAP(log1p) LANES_MAP(expm1) LANES_MAP(sin) LANES_MAP(cos) LANES_MAP(tan) LANES_MAP(asin)
LANES_MAP(acos) LANES_MAP(atan) LANES_MAP(sinh) LANES_MAP(cosh) LANES_MAP(tanh) LANES_MAP(asinh) LANES_MAP(acosh) LANES_MAP(atanh)
LANES_MAP(erf) LANES_MAP(floor) LANES_MAP(ceil) LANES_MAP(sqrt)
#define LANES_MAP2(F) \
  static inline lanes F(lanes a, lanes b) { lanes r; for (int k = 0; k < LANES; ++k) r.v[k] = ::F(a.v[k], b.v[k]); return r; }
LANES_MAP2(pow) LANES_MAP2(fmod) LANES_MAP2(atan2) LANES_MAP2(hypot) LANES_MAP2(copysign) LANES_MAP2(remainder)
#endif

#define casadi_real lanes
