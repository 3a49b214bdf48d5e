// Integration loop that advances LANES runs at once. The library also contains lanes.hpp and the two functions of the scheme declared
// below. OWN_MODEL is the struct of a model in the same library. z is the state x and, with `work`, the energy supplied by forces.
// All memory comes from the caller. There are no exceptions.

#ifndef casadi_int
#define casadi_int long long int
#endif

enum { FINISHED, NOT_FINITE, BEYOND, BROKEN, STOPPED, UNSOLVED, STUCK, TIRED };
enum { BARS, JOINTS, ENERGY, KINETIC, ELASTIC_LOW, ELASTIC_HIGH, GRAVITY_LOW, GRAVITY_HIGH, WORST };
enum { REST, NEXT, MEMORY = 11 };                      // memory of error control: time left, next trial step, and more
enum { ENERGY_0, BARS_0, WORK, JUMPS, CARRIED };       // of a run that continues in another request; its memory follows
enum { CHECKED = 64 };                                 // trial steps between checks of their length

typedef int (*Call)(const lanes **, lanes **, casadi_int *, lanes *, int);

struct Model {
  int64_t nx, nw, nu, work, jumps, measures, potential;  // potential: whether elastic and gravity energy are apart from the work
  int64_t modes, errors, stages;  // modes and errors: for error control
  int64_t size_arg, size_res, size_iw, size_w;
  Call ode;      // (z, w) -> zdot; w: control, parameters and modes
  Call step;     // (z, w, h, numbers) -> z after a step; for schemes without a tableau
  Call prepare;  // (z, memory, w) -> length of a trial step, w with the modes
  Call decide;   // (z, memory, w, numbers, h, w with modes, z after, errors, first and last slope) -> z, memory
  Call project;  // (x, w) -> projected x
  Call effect;   // (x before, x after, w) -> movement of a node, energy added by a correction
  Call measure;  // (x, w) -> errors of bars and joints, three energies, and more
  Call energy;   // (x, w) -> total energy
  Call stage;    // (x, w) -> cost rate of an interval
  Call final;    // (x, w) -> terminal cost
};

#ifdef OWN_MODEL
static const Model own = OWN_MODEL;
#define MODEL own
#else
#define MODEL (*room.model)
#endif

struct Request {
  // strides of states, inputs and parameters, 0 if all runs share one row; width of a row of inputs
  int64_t state_stride, input_stride, parameter_stride, width;
  // intervals: row of the inputs, number and length of steps, clock at the start (NaN: unknown) for models with a clock;
  // whether feedback is updated at the start
  int64_t intervals;
  const int64_t *row, *count;
  const double *length, *clock;
  const int64_t *decides;
  const double *states, *inputs, *parameters;  // without parameters, inputs contain them
  // feedback: controls, states and gains of each update, and limits; none without gains
  const int64_t *decision;
  const double *given, *reference, *gains, *lower, *upper;
  int64_t referred;  // number of state entries in the feedback
  const double *numbers;  // numbers of the scheme, such as tolerances
  int64_t counted, trials;  // count of numbers; largest number of trial steps in a grid step
  double shortest;  // shortest trial step
  // steps between corrections, saved rows and, on average, checks; 0: none. Steps before this request and in all requests of these runs
  int64_t correct_every, save_every, look_every, rows, begin, total;
  double broken, beyond, largest;  // largest: bound of a start
  // results; measured: the measures and the energy supplied in each saved row
  double *last, *saved, *measured, *corrected, *worst, *cost, *carry;
  int64_t *status, *fault, *good;
  const int64_t *stop;  // not 0: stop trial steps
  // companions of one run, which take steps of 2 h and 4 h in lanes 1 and 2: steps between compared rows, a multiple of 4, 0: none;
  // states of the run and both companions in these rows; z of both between requests
  int64_t compare_every;
  double *compared, *companions;
};

struct Room {  // workspace of one thread
  const Model *model;
  lanes *z, *after, *w, *measure, *first, *worst, *bars, *jumped, *u, *numbers, *memory, *kept, *v, *errors, *slopes, *point, *entry, *work;
  casadi_int *iw;
  const lanes **arg;
  lanes **res;
};

// Take a step of length h; the result is in room.after. Returns 0 on success.
static int take_step(Room &room, lanes h);
// Take a trial step; the results are room.after, errors, and slopes at both ends. Returns 0 on success.
static int try_step(Room &room, lanes h, const lanes *&first, const lanes *&last);

template <int A, int R>
static inline int evaluate(const Room &room, Call function, const lanes *const (&arg)[A], lanes *const (&res)[R]) {
  for (int i = 0; i < A; ++i) room.arg[i] = arg[i];
  for (int i = 0; i < R; ++i) room.res[i] = res[i];
  return function(room.arg, room.res, room.iw, room.work, 0);
}

struct Group {
  int64_t start, pending;  // pending: saved row whose next correction is measured
  int live;  // runs of this group; further lanes repeat the last one
  int64_t status[LANES], fault[LANES], good[LANES];

  int64_t motion(int k) const { return start + (k < live ? k : live - 1); }
  bool all_lost() const {
    for (int k = 0; k < live; ++k)
      if (!status[k]) return false;
    return true;
  }
  void end(int64_t code, int64_t step) {
    for (int k = 0; k < LANES; ++k)
      if (!status[k]) status[k] = code, fault[k] = step;
  }
};

static void load(const Request &q, const Group &g, Room &room, int64_t row) {
  for (int k = 0; k < LANES; ++k) {
    const double *w = q.inputs + g.motion(k) * q.input_stride + row * q.width;
    for (int64_t i = 0; i < q.width; ++i) set(room.w[i], k, w[i]);
    const double *p = q.parameters + g.motion(k) * q.parameter_stride;
    for (int64_t i = q.width; i < MODEL.nw; ++i) set(room.w[i], k, p[i - q.width]);
  }
}

// u = u_k - G_k (x - x_k), within limits
static void decide(const Request &q, Room &room, int64_t decision) {
  const double *u = q.given + decision * MODEL.nu, *x = q.reference + decision * q.referred, *G = q.gains + decision * MODEL.nu * q.referred;
  for (int i = 0; i < MODEL.nu; ++i) {
    lanes sum = 0.0;
    for (int64_t j = 0; j < q.referred; ++j) sum += lanes(G[i * q.referred + j]) * (room.z[j] - lanes(x[j]));
    lanes value = lanes(u[i]) - sum;
    for (int k = 0; k < LANES; ++k) {
      double v = get(value, k);  // NaN stays NaN
      set(room.w[i], k, v < q.lower[i] ? q.lower[i] : v > q.upper[i] ? q.upper[i] : v);
    }
  }
}

static lanes supplied(const Room &room) { return MODEL.work ? room.z[MODEL.nx] + room.jumped[0] : room.jumped[0]; }

// Detect the failure of one run.
static int64_t fault_of(const Request &q, const Room &room, int k, int64_t step) {
  int64_t fault = FINISHED;
  for (int i = 0; i < MODEL.nx; ++i) {
    double x = fabs(get(room.z[i], k));
    if (!(x <= 1.7976931348623157e308)) return NOT_FINITE;
    if (x > (step ? q.beyond : q.largest)) fault = BEYOND;
  }
  if (!MODEL.measures) return fault;
  double bars = get(room.measure[0], k);
  if (bars != bars) return NOT_FINITE;
  if (!fault && step && bars > q.broken + get(room.bars[0], k)) fault = BROKEN;
  return fault;
}

// Return whether all runs of a group are active and valid, by one test.
static bool all_fine(const Request &q, const Group &g, const Room &room) {
  lanes fine = 1.0, beyond = q.beyond;
  for (int i = 0; i < MODEL.nx; ++i) fine = fine && fabs(room.z[i]) <= beyond;
  if (MODEL.measures) fine = fine && room.measure[0] <= lanes(q.broken) + room.bars[0];
  for (int k = 0; k < g.live; ++k)
    if (g.status[k] || get(fine, k) == 0.0) return false;
  return true;
}

// Update the extremes of the measures; those of a failed run stay as before the failure.
static void weigh(const Group &g, Room &room, bool start) {
  const lanes *m = room.measure;
  lanes total = MODEL.potential ? m[2] + m[3] + m[4] : m[2];
  if (start) room.first[0] = total;
  lanes error = total - room.first[0] - supplied(room);
  lanes now[WORST] = {m[0], m[1], fabs(error), m[2], m[3], m[3], m[4], m[4]};
  for (int i = 0; i < WORST; ++i) {
    bool low = i == ELASTIC_LOW || i == GRAVITY_LOW;
    lanes worst = start ? now[i] : low ? fmin(room.worst[i], now[i]) : fmax(room.worst[i], now[i]);
    for (int k = 0; k < g.live; ++k)
      if (g.status[k]) set(worst, k, get(room.worst[i], k));
    room.worst[i] = worst;
  }
}

// Measure the states and mark the runs that failed.
static void look(const Request &q, Group &g, Room &room, int64_t step) {
  if (MODEL.measures) {
    evaluate(room, MODEL.measure, {room.z, room.w}, {room.measure});
    if (!step) room.bars[0] = room.measure[0];
  }
  if (!step || !all_fine(q, g, room))
    for (int k = 0; k < g.live; ++k)
      if (!g.status[k] && (g.status[k] = fault_of(q, room, k, step))) g.fault[k] = step;
  for (int k = 0; k < g.live; ++k)
    if (!g.status[k]) g.good[k] = step;
  if (MODEL.measures) weigh(g, room, !step);
}

// Save the states in a row; NaN for failed runs, and for all if they are over.
static void keep(const Request &q, Group &g, Room &room, int64_t row, bool over) {
  g.pending = row;
  for (int k = 0; k < g.live; ++k) {
    bool lost = over || (g.status[k] && g.status[k] < STOPPED);
    int64_t place = (g.start + k) * q.rows + row;
    for (int i = 0; i < MODEL.nx; ++i) q.saved[place * MODEL.nx + i] = lost ? NAN : get(room.z[i], k);
    if (!q.measured) continue;
    double *measured = q.measured + place * (MODEL.measures + 1);
    for (int i = 0; i < MODEL.measures; ++i) measured[i] = lost ? NAN : get(room.measure[i], k);
    measured[MODEL.measures] = lost ? NAN : get(supplied(room), k);
  }
}

// Return whether a step is checked. Fractions of the golden ratio are evenly spread and meet no period of the motion.
static bool checked(const Request &q, int64_t step) {
  double turns = 0.6180339887498949 * step;
  return q.look_every && (turns - (double)(int64_t)turns) * q.look_every < 1.0;
}

// Save the states of a run and its companions at a time that all have reached.
static void compare(const Request &q, const Room &room, int64_t step) {
  double *row = q.compared + (step + q.compare_every - 1) / q.compare_every * 3 * MODEL.nx;
  for (int k = 0; k < 3; ++k)
    for (int64_t i = 0; i < MODEL.nx; ++i) row[k * MODEL.nx + i] = get(room.z[i], k);
}

// Measure and save the states before a step, or the last ones.
static void observe(const Request &q, Group &g, Room &room, int64_t step, bool end) {
  bool save = q.save_every && (end || step % q.save_every == 0);
  if (save || end || !step || checked(q, step)) look(q, g, room, step);
  if (save) keep(q, g, room, (step + q.save_every - 1) / q.save_every, false);
  if (LANES > 2 && q.compare_every && step % 4 == 0 && (end || step % q.compare_every == 0)) compare(q, room, step);
}

static void measure_correction(const Request &q, Group &g, Room &room, const lanes *before, const lanes *after) {
  lanes effect[2];
  evaluate(room, MODEL.effect, {before, after, room.w}, {effect});
  for (int k = 0; k < g.live; ++k)
    for (int i = 0; i < 2; ++i) q.corrected[((g.start + k) * q.rows + g.pending) * 2 + i] = get(effect[i], k);
  g.pending = -1;
}

// Take a step of a run, and steps of 2 h and 4 h of its companions once these end.
static int advance_together(const Request &q, Group &g, Room &room, double length, int64_t step, bool correct) {
  const int64_t size = MODEL.nx + MODEL.work;
  lanes h = length, due = 1.0;
  for (int k = 1; k < 3; ++k) set(h, k, (1 << k) * length), set(due, k, step % (1 << k) == 0);
  if (take_step(room, h)) return UNSOLVED;
  lanes *next = room.after;
  if (correct) {
    next = room.entry;
    if (evaluate(room, MODEL.project, {room.after, room.w}, {next})) return UNSOLVED;
    for (int64_t i = MODEL.nx; i < size; ++i) next[i] = room.after[i];
    if (q.corrected && g.pending >= 0) measure_correction(q, g, room, room.after, next);
  }
  for (int64_t i = 0; i < size; ++i) room.z[i] = pick(due, next[i], room.z[i]);
  return FINISHED;
}

// Take a step of fixed length.
static int advance(const Request &q, Group &g, Room &room, double length, int64_t step, bool correct) {
  if (LANES > 2 && q.compare_every) return advance_together(q, g, room, length, step, correct);
  if (take_step(room, length)) return UNSOLVED;
  if (correct) {
    lanes *x = room.z;
    if (evaluate(room, MODEL.project, {room.after, room.w}, {x})) return UNSOLVED;
    for (int64_t i = MODEL.nx; i < MODEL.nx + MODEL.work; ++i) x[i] = room.after[i];
    if (q.corrected && g.pending >= 0) measure_correction(q, g, room, room.after, x);
    return FINISHED;
  }
  lanes *t = room.z;
  room.z = room.after, room.after = t;
  return FINISHED;
}

// Take trial steps to the end of a grid step, with one lane. A failure leaves z at the start of the grid step.
static int try_steps(const Request &q, const Group &g, Room &room, double length) {
  room.memory[REST] = length;
  for (int64_t i = 0; i < MODEL.nw; ++i) room.v[i] = room.w[i];
  for (int64_t trial = 1;; ++trial) {
    lanes h;
    const lanes *first, *last;
    if (evaluate(room, MODEL.prepare, {room.z, room.memory, room.w}, {&h, room.v}) || try_step(room, h, first, last) ||
        evaluate(room, MODEL.decide, {room.z, room.memory, room.w, room.numbers, &h, room.v, room.after, room.errors, first, last}, {room.point, room.kept}))
      return UNSOLVED;
    lanes *t = room.z;
    room.z = room.point, room.point = t;
    t = room.memory, room.memory = room.kept, room.kept = t;
    for (int i = 0; i < MEMORY; ++i)
      if (!(fabs(get(room.memory[i], 0)) <= 1.7976931348623157e308)) return NOT_FINITE;
    if (get(room.memory[REST], 0) <= 0.0) return FINISHED;
    if (MODEL.measures && get(room.memory[REST], 0) < get(room.kept[REST], 0)) {  // an accepted step
      evaluate(room, MODEL.measure, {room.z, room.w}, {room.measure});
      weigh(g, room, false);
    }
    if (*(volatile int64_t *)q.stop) return STOPPED;
    if (trial % CHECKED == 0 && get(room.memory[NEXT], 0) < q.shortest * length) return STUCK;
    if (trial >= q.trials) return TIRED;
  }
}

static int control_error(const Request &q, const Group &g, Room &room, double length) {
  for (int64_t i = 0; i < MODEL.nx + MODEL.work; ++i) room.entry[i] = room.z[i];
  int code = try_steps(q, g, room, length);
  if (code) {
    lanes *t = room.z;
    room.z = room.entry, room.entry = t;
  }
  return code;
}

// Set the controls of the next interval. The energy change by the new controls counts as supplied.
static void hold(const Request &q, const Group &g, Room &room, int64_t interval, bool account) {
  lanes before, after;
  if (account) evaluate(room, MODEL.energy, {room.z, room.w}, {&before});
  load(q, g, room, q.row[interval]);
  if (q.gains) {
    if (q.decides[interval]) {
      decide(q, room, q.decision[interval]);
      for (int i = 0; i < MODEL.nu; ++i) room.u[i] = room.w[i];
    } else
      for (int i = 0; i < MODEL.nu; ++i) room.w[i] = room.u[i];
  }
  if (account) {
    evaluate(room, MODEL.energy, {room.z, room.w}, {&after});
    room.jumped[0] += after - before;
  }
}

static void enter(const Request &q, Group &g, Room &room) {
  const int64_t entries = CARRIED + MEMORY + MODEL.nw, row = q.begin && q.save_every ? (q.begin - 1) / q.save_every : 0;
  const bool corrected = !q.correct_every || q.begin / q.correct_every > row * q.save_every / q.correct_every;
  g.pending = q.begin && q.save_every && !corrected ? row : -1;
  for (int k = 0; k < LANES; ++k) {
    const int64_t n = g.motion(k);
    const double *x = q.states + n * q.state_stride, *carry = q.carry ? q.carry + n * entries : 0;
    for (int i = 0; i < MODEL.nx; ++i) set(room.z[i], k, x[i]);
    for (int i = 0; i < WORST; ++i) set(room.worst[i], k, q.begin && MODEL.measures ? q.worst[n * WORST + i] : NAN);
    if (MODEL.work) set(room.z[MODEL.nx], k, carry ? carry[WORK] : 0.0);
    set(room.jumped[0], k, carry ? carry[JUMPS] : 0.0);
    if (carry) {
      set(room.first[0], k, carry[ENERGY_0]), set(room.bars[0], k, carry[BARS_0]);
      for (int i = 0; i < MEMORY; ++i) set(room.memory[i], k, carry[CARRIED + i]);
      for (int64_t i = 0; i < MODEL.nw; ++i) set(room.w[i], k, carry[CARRIED + MEMORY + i]);
      for (int64_t i = 0; i < MODEL.nu; ++i) room.u[i] = room.w[i];
    }
    for (int64_t i = 0; i < q.counted; ++i) set(room.numbers[i], k, q.numbers[i]);
    if (q.compare_every && q.begin && (k == 1 || k == 2))
      for (int64_t i = 0; i < MODEL.nx + MODEL.work; ++i) set(room.z[i], k, q.companions[(k - 1) * (MODEL.nx + MODEL.work) + i]);
    g.status[k] = q.begin ? q.status[n] : FINISHED, g.fault[k] = q.begin ? q.fault[n] : -1, g.good[k] = q.begin ? q.good[n] : 0;
  }
}

static void leave(const Request &q, const Group &g, const Room &room, const lanes &cost) {
  const int64_t entries = CARRIED + MEMORY + MODEL.nw, size = MODEL.nx + MODEL.work;
  for (int k = 1; LANES > 2 && q.compare_every && k < 3; ++k)
    for (int64_t i = 0; i < size; ++i) q.companions[(k - 1) * size + i] = get(room.z[i], k);
  for (int k = 0; k < g.live; ++k) {
    int64_t n = g.start + k;
    bool lost = g.status[k] && g.status[k] < STOPPED;
    for (int i = 0; i < MODEL.nx; ++i) q.last[n * MODEL.nx + i] = lost ? NAN : get(room.z[i], k);
    q.cost[n] = g.status[k] ? INFINITY : get(cost, k);
    q.status[n] = g.status[k], q.fault[n] = g.fault[k], q.good[n] = g.good[k];
    if (MODEL.measures)
      for (int i = 0; i < WORST; ++i) q.worst[n * WORST + i] = get(room.worst[i], k);
    if (!q.carry) continue;
    double *carry = q.carry + n * entries;
    carry[ENERGY_0] = get(room.first[0], k), carry[BARS_0] = get(room.bars[0], k);
    carry[WORK] = MODEL.work ? get(room.z[MODEL.nx], k) : 0.0, carry[JUMPS] = get(room.jumped[0], k);
    for (int i = 0; i < MEMORY; ++i) carry[CARRIED + i] = get(room.memory[i], k);
    for (int64_t i = 0; i < MODEL.nw; ++i) carry[CARRIED + MEMORY + i] = get(room.w[i], k);
  }
}

static void roll_group(const Request &q, Group &g, Room &room) {
  enter(q, g, room);
  if (g.all_lost()) return;
  lanes cost = 0.0, value;
  int64_t step = q.begin;
  for (int64_t interval = 0; interval < q.intervals && !g.all_lost(); ++interval) {
    if (q.clock && q.clock[interval] == q.clock[interval]) room.z[MODEL.nx - 1] = lanes(q.clock[interval]);  // without rounding
    if (interval == 0 || q.gains || q.row[interval] != q.row[interval - 1]) hold(q, g, room, interval, MODEL.jumps && step);
    for (int64_t j = 0; j < q.count[interval]; ++j) {
      observe(q, g, room, step, false);
      if (g.all_lost()) break;
      bool correct = q.correct_every && (step + 1) % q.correct_every == 0;
      int code = MODEL.decide ? control_error(q, g, room, q.length[interval]) : advance(q, g, room, q.length[interval], step, correct);
      if (code) {
        g.end(code, step);
        break;
      }
      ++step;
    }
    if (MODEL.stage) {
      if (evaluate(room, MODEL.stage, {room.z, room.w}, {&value})) g.end(UNSOLVED, step);
      cost += value * lanes(q.length[interval] * q.count[interval]);
    }
  }
  if (step == q.total || g.all_lost()) observe(q, g, room, step, true);
  if (MODEL.final) {
    if (evaluate(room, MODEL.final, {room.z, room.w}, {&value})) g.end(UNSOLVED, step);
    cost += value;
  }
  if (q.save_every && g.all_lost())
    for (int64_t row = (step + q.save_every - 1) / q.save_every + 1; row < q.rows; ++row) keep(q, g, room, row, true);
  leave(q, g, room, cost);
}

static lanes *take(char *&memory, int64_t count) {
  lanes *found = (lanes *)memory;
  memory += count * sizeof(lanes);
  return found;
}

// Divide memory into a workspace. Returns the number of bytes; without memory, it only counts them.
static int64_t furnish(Room &room, int64_t counted, char *memory) {
  const int64_t nz = MODEL.nx + MODEL.work, nv = MODEL.nw + MODEL.modes;
  const int64_t sizes[] = {nz, nz, MODEL.nw, MODEL.measures, 1, WORST, 1, 1, MODEL.nu, counted, MEMORY, MEMORY, nv, nz * MODEL.errors, nz * MODEL.stages, nz, nz, MODEL.size_w};
  lanes **places[] = {&room.z, &room.after, &room.w, &room.measure, &room.first, &room.worst, &room.bars, &room.jumped, &room.u,
                      &room.numbers, &room.memory, &room.kept, &room.v, &room.errors, &room.slopes, &room.point, &room.entry, &room.work};
  char *place = memory + (sizeof(lanes) - (uintptr_t)memory % sizeof(lanes)) % sizeof(lanes);
  for (unsigned i = 0; i < sizeof(sizes) / sizeof(sizes[0]); ++i) *places[i] = take(place, sizes[i]);
  place += (8 - (uintptr_t)place % 8) % 8;
  room.iw = (casadi_int *)place, place += 8 * MODEL.size_iw;
  room.arg = (const lanes **)place, place += 8 * MODEL.size_arg;
  room.res = (lanes **)place, place += 8 * MODEL.size_res;
  return place - memory + sizeof(lanes);
}

#define EXPORT extern "C" __attribute__((visibility("default")))

EXPORT int64_t motion_lanes(void) { return LANES; }

// Return the bytes of workspace that a thread needs.
EXPORT int64_t motion_room(const Model *model, int64_t counted) {
  Room room;
  room.model = model;
  return furnish(room, counted, 0);
}

// Integrate the runs from `first` to before `last`. The memory is zero.
EXPORT void motion_roll(const Model *model, const Request *request, int64_t first, int64_t last, char *memory) {
  Room room;
  room.model = model;
  furnish(room, request->counted, memory);
  for (Group g; first < last; first += LANES) {
    g.start = first;
    g.live = last - first < LANES ? (int)(last - first) : LANES;
    roll_group(*request, g, room);
  }
}
