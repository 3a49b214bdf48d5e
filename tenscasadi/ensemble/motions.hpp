// Motions through time, LANES at once. Around it stand: lanes.hpp, sizes, and CasADi's code of
//   motion_step (z, w, h) -> z after a step          motion_project (x, w) -> x on its bars and joints
//   motion_measure (x, w) -> M errors and energies   motion_energy (x, w) -> total energy
//   motion_stage (x, w) -> cost rate of an interval  motion_final (x, w) -> cost of the end
// z is the state x and, with WORK, the energy supplied. Those that a kernel does not have are not called.

enum { FINISHED, NOT_FINITE, BEYOND, BROKEN, STOPPED };
enum { BARS, JOINTS, ENERGY, KINETIC, ELASTIC_LOW, ELASTIC_HIGH, GRAVITY_LOW, GRAVITY_HIGH, WORST };

struct Request {
  // motions; numbers from the states, inputs and parameters of one to those of the next, 0 where all share one; width of a row of inputs
  int64_t motions, state_stride, input_stride, parameter_stride, width;
  // intervals of time: the row of the inputs in each, its steps and their length; whether feedback decides anew at its start
  int64_t intervals;
  const int64_t *row, *count;
  const double *length;
  const int64_t *decides;
  const double *states, *inputs, *parameters;  // no parameters: inputs hold them, too
  // feedback: controls, states, gains of each decision, and limits; no gains: none
  const int64_t *decision;
  const double *given, *reference, *gains, *lower, *upper;
  int64_t referred;  // entries of the state that are fed back
  // steps from one correction, kept row and look to the next; 0: none
  int64_t correct_every, save_every, look_every, rows;
  double broken, beyond, largest;  // largest: of a start
  // results
  double *last, *saved, *measured, *worst, *cost;
  int64_t *status, *fault, *good;
  // shared by the threads that work on a request
  int64_t *next, *done, *stop;
};

struct Room {  // of one thread
  lanes *z, *after, *w, *measure, *first, *worst, *bars, *u, *work;
  casadi_int *iw;
  const lanes **arg;
  lanes **res;
};

#define EVALUATE(F, A0, A1, A2, R0) \
  (room.arg[0] = (A0), room.arg[1] = (A1), room.arg[2] = (A2), room.res[0] = (R0), F(room.arg, room.res, room.iw, room.work, 0))

struct Group {
  int64_t start;
  int live;  // motions of this group; lanes beyond repeat the last one
  int64_t status[LANES], fault[LANES], good[LANES];

  int64_t motion(int k) const { return start + (k < live ? k : live - 1); }
  bool all_lost() const {
    for (int k = 0; k < live; ++k)
      if (!status[k]) return false;
    return true;
  }
};

static void load(const Request &q, const Group &g, Room &room, int64_t row) {
  for (int k = 0; k < LANES; ++k) {
    const double *w = q.inputs + g.motion(k) * q.input_stride + row * q.width;
    for (int i = 0; i < q.width; ++i) set(room.w[i], k, w[i]);
    const double *p = q.parameters + g.motion(k) * q.parameter_stride;
    for (int64_t i = q.width; i < NW; ++i) set(room.w[i], k, p[i - q.width]);
  }
}

// u = u_k - G_k (x - x_k), within limits
static void decide(const Request &q, Room &room, int64_t decision) {
  const double *u = q.given + decision * NU, *x = q.reference + decision * q.referred, *G = q.gains + decision * NU * q.referred;
  for (int i = 0; i < NU; ++i) {
    lanes sum = 0.0;
    for (int64_t j = 0; j < q.referred; ++j) sum += lanes(G[i * q.referred + j]) * (room.z[j] - lanes(x[j]));
    lanes value = lanes(u[i]) - sum;
    for (int k = 0; k < LANES; ++k) {
      double v = get(value, k);  // what is not a number stays so
      set(room.w[i], k, v < q.lower[i] ? q.lower[i] : v > q.upper[i] ? q.upper[i] : v);
    }
  }
}

// The fault of one motion.
static int64_t fault_of(const Request &q, const Room &room, int k, int64_t step) {
  int64_t fault = FINISHED;
  for (int i = 0; i < NX; ++i) {
    double x = fabs(get(room.z[i], k));
    if (!(x <= 1.7976931348623157e308)) return NOT_FINITE;
    if (x > (step ? q.beyond : q.largest)) fault = BEYOND;
  }
#if M
  double bars = get(room.measure[0], k);
  if (bars != bars) return NOT_FINITE;
  if (!fault && step && bars > q.broken + get(room.bars[0], k)) fault = BROKEN;
#endif
  return fault;
}

// Whether all motions of a group are on their way and in order, seen at once.
static bool all_fine(const Request &q, const Group &g, const Room &room) {
  lanes fine = 1.0, beyond = q.beyond;
  for (int i = 0; i < NX; ++i) fine = fine && fabs(room.z[i]) <= beyond;
#if M
  fine = fine && room.measure[0] <= lanes(q.broken) + room.bars[0];
#endif
  for (int k = 0; k < g.live; ++k)
    if (g.status[k] || get(fine, k) == 0.0) return false;
  return true;
}

// Measure where motions are, and mark those that are lost.
static void look(const Request &q, Group &g, Room &room, int64_t step) {
#if M
  EVALUATE(motion_measure, room.z, room.w, 0, room.measure);
  if (!step) room.bars[0] = room.measure[0];
#endif
  if (!step || !all_fine(q, g, room))
    for (int k = 0; k < g.live; ++k)
      if (!g.status[k] && (g.status[k] = fault_of(q, room, k, step))) g.fault[k] = step;
  for (int k = 0; k < g.live; ++k)
    if (!g.status[k]) g.good[k] = step;
#if M
  const lanes *m = room.measure;
  lanes total = m[2] + m[3] + m[4];
  if (!step) room.first[0] = total;
  lanes error = total - room.first[0];
  if (WORK) error -= room.z[NX];
  lanes now[WORST] = {m[0], m[1], fabs(error), m[2], m[3], m[3], m[4], m[4]};
  for (int i = 0; i < WORST; ++i) {
    bool low = i == ELASTIC_LOW || i == GRAVITY_LOW;
    lanes worst = !step ? now[i] : low ? fmin(room.worst[i], now[i]) : fmax(room.worst[i], now[i]);
    for (int k = 0; k < g.live; ++k)
      if (g.status[k]) set(worst, k, get(room.worst[i], k));  // as it was when the motion was lost
    room.worst[i] = worst;
  }
#endif
}

static void keep(const Request &q, const Group &g, Room &room, int64_t row) {
  for (int k = 0; k < g.live; ++k) {
    bool lost = g.status[k];
    int64_t place = (g.start + k) * q.rows + row;
    for (int i = 0; i < NX; ++i) q.saved[place * NX + i] = lost ? NAN : get(room.z[i], k);
#if M
    for (int i = 0; i < M; ++i) q.measured[place * (M + 1) + i] = lost ? NAN : get(room.measure[i], k);
    q.measured[place * (M + 1) + M] = lost ? NAN : WORK ? get(room.z[NX], k) : 0.0;
#endif
  }
}

static int advance(const Request &q, Room &room, double length, bool correct) {
  lanes h = length;
  if (EVALUATE(motion_step, room.z, room.w, &h, room.after)) return 1;
#ifdef HAS_PROJECT
  if (correct) {
    lanes *x = room.z;
    if (EVALUATE(motion_project, room.after, room.w, 0, x)) return 1;
    for (int i = NX; i < NX + WORK; ++i) x[i] = room.after[i];
    return 0;
  }
#endif
  lanes *t = room.z;
  room.z = room.after, room.after = t;
  return 0;
}

// The controls of the next interval; what changing them does to the energy counts as supplied.
static void hold(const Request &q, const Group &g, Room &room, int64_t interval) {
#if JUMPS
  lanes before, after;
  if (interval) EVALUATE(motion_energy, room.z, room.w, 0, &before);
#endif
  load(q, g, room, q.row[interval]);
  if (q.gains) {
    if (q.decides[interval]) {
      decide(q, room, q.decision[interval]);
      for (int i = 0; i < NU; ++i) room.u[i] = room.w[i];
    } else
      for (int i = 0; i < NU; ++i) room.w[i] = room.u[i];
  }
#if JUMPS
  if (interval) {
    EVALUATE(motion_energy, room.z, room.w, 0, &after);
    room.z[NX] += after - before;
  }
#endif
}

static int roll_group(const Request &q, Group &g, Room &room) {
  for (int k = 0; k < LANES; ++k) {
    const double *x = q.states + g.motion(k) * q.state_stride;
    for (int i = 0; i < NX; ++i) set(room.z[i], k, x[i]);
    for (int i = NX; i < NX + WORK; ++i) set(room.z[i], k, 0.0);
    for (int i = 0; i < WORST; ++i) set(room.worst[i], k, NAN);
    g.status[k] = FINISHED, g.fault[k] = -1, g.good[k] = 0;
  }
  lanes cost = 0.0, value;
  int64_t step = 0, row = 0, total = 0;
  for (int64_t i = 0; i < q.intervals; ++i) total += q.count[i];
  bool fresh = true;
  for (int64_t interval = 0; interval < q.intervals; ++interval) {
    bool changed = interval == 0 || q.gains || q.row[interval] != q.row[interval - 1];
    if (changed) hold(q, g, room, interval);
    if (fresh) {
      look(q, g, room, 0);
      if (q.save_every) keep(q, g, room, row++);
      fresh = false;
    }
    for (int64_t j = 0; j < q.count[interval]; ++j) {
      if (*(volatile int64_t *)q.stop) {
        for (int k = 0; k < LANES; ++k)
          if (!g.status[k]) g.status[k] = STOPPED, g.fault[k] = step;
        break;
      }
      ++step;
      if (advance(q, room, q.length[interval], q.correct_every && step % q.correct_every == 0)) return 1;
      bool save = q.save_every && (step % q.save_every == 0 || step == total);
      if (save || step == total || (q.look_every && step % q.look_every == 0)) look(q, g, room, step);
      if (save) keep(q, g, room, row++);
    }
#ifdef HAS_STAGE
    if (EVALUATE(motion_stage, room.z, room.w, 0, &value)) return 1;
    cost += value * lanes(q.length[interval] * q.count[interval]);
#endif
    __atomic_fetch_add(q.done, g.live * q.count[interval], __ATOMIC_RELAXED);
    if (g.all_lost()) break;
  }
#ifdef HAS_FINAL
  if (EVALUATE(motion_final, room.z, room.w, 0, &value)) return 1;
  cost += value;
#endif
  if (q.save_every)
    while (row < q.rows) keep(q, g, room, row++);
  for (int k = 0; k < g.live; ++k) {
    int64_t n = g.start + k;
    bool lost = g.status[k];
    for (int i = 0; i < NX; ++i) q.last[n * NX + i] = lost ? NAN : get(room.z[i], k);
    q.cost[n] = lost ? INFINITY : get(cost, k);
    q.status[n] = g.status[k], q.fault[n] = g.fault[k], q.good[n] = g.good[k];
#if M
    for (int i = 0; i < WORST; ++i) q.worst[n * WORST + i] = get(room.worst[i], k);
#endif
  }
  return 0;
}

static lanes *take(char *&memory, int64_t count) {
  lanes *found = (lanes *)memory;
  memory += count * sizeof(lanes);
  return found;
}

extern "C" __attribute__((visibility("default"))) int64_t motion_lanes(void) { return LANES; }

// Roll motions until none is left that no other thread has taken. 0: done, 1: a function failed, 2: no memory.
extern "C" __attribute__((visibility("default"))) int motion_roll(const Request *request) {
  const Request &q = *request;
  int64_t numbers = 2 * (NX + WORK) + NW + NU + M + 2 + WORST + SIZE_W;
  int64_t pointers = SIZE_ARG + SIZE_RES + SIZE_IW;
  char *memory = (char *)malloc(numbers * sizeof(lanes) + pointers * 8 + sizeof(lanes));
  if (!memory) return 2;
  char *place = memory + (sizeof(lanes) - (uintptr_t)memory % sizeof(lanes)) % sizeof(lanes);
  Room room;
  room.z = take(place, NX + WORK), room.after = take(place, NX + WORK), room.w = take(place, NW), room.u = take(place, NU);
  room.measure = take(place, M), room.first = take(place, 1), room.bars = take(place, 1), room.worst = take(place, WORST);
  room.work = take(place, SIZE_W);
  room.iw = (casadi_int *)place, place += 8 * SIZE_IW;
  room.arg = (const lanes **)place, place += 8 * SIZE_ARG;
  room.res = (lanes **)place;
  int failed = 0;
  while (!failed) {
    Group g;
    g.start = LANES * __atomic_fetch_add(q.next, 1, __ATOMIC_RELAXED);
    if (g.start >= q.motions) break;
    g.live = q.motions - g.start < LANES ? (int)(q.motions - g.start) : LANES;
    failed = roll_group(q, g, room);
  }
  free(memory);
  return failed;
}
