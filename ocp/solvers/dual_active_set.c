  /* Body of a CasADi JitFunction: see dual_active_set.py for the program, the inputs and the sizes.

     Goldfarb, Idnani, A numerically stable dual method for solving strictly convex quadratic
     programs, Math. Programming 1983, 27, 1, with a Cholesky factor L of the Gram matrix
     K = C H^-1 C^T of the active constraints C x >= d, and rows W = C H^-1.
     Constraints: 0..size-1 lower bounds, size..2 size-1 upper bounds, then the rows. */
#define stride (size + 1)
#define ADD_PRODUCT(result, sign, left, right, end) /* result += sign left . right, in 8 independent sums */ \
  { \
    casadi_real sum[8] = {0}; \
    for (j = 0; j + 8 <= end; j += 8) \
      for (q = 0; q < 8; ++q) sum[q] += left[j + q] * right[j + q]; \
    for (; j < end; ++j) sum[0] += left[j] * right[j]; \
    result = result sign(sum[0] + sum[1] + (sum[2] + sum[3]) + (sum[4] + sum[5] + (sum[6] + sum[7]))); \
  }
#define ADD_ROWS(row, sign, factors, at, rows8, first, end) /* row += sign factors[:, at]^T rows8 */ \
  { \
    const casadi_real s0 = sign factors[0][at], s1 = sign factors[1][at], s2 = sign factors[2][at]; \
    const casadi_real s3 = sign factors[3][at], s4 = sign factors[4][at], s5 = sign factors[5][at]; \
    const casadi_real s6 = sign factors[6][at], s7 = sign factors[7][at]; \
    const casadi_real *r0 = rows8[0], *r1 = rows8[1], *r2 = rows8[2], *r3 = rows8[3]; \
    const casadi_real *r4 = rows8[4], *r5 = rows8[5], *r6 = rows8[6], *r7 = rows8[7]; \
    for (j = first; j < end; ++j) \
      row[j] += s0 * r0[j] + s1 * r1[j] + s2 * r2[j] + s3 * r3[j] + (s4 * r4[j] + s5 * r5[j] + s6 * r6[j] + s7 * r7[j]); \
  }
  casadi_real *U = work, *Z = U + size * size, *inverse = Z + size * size, *W = U; /* U and Z are temporary */
  casadi_real *K = inverse + size * size, *L = K + stride * stride, *x = L + stride * stride;
  casadi_real *least = x + size, *most = least + size, *dual = most + size, *step = dual + stride;
  casadi_real *zero = step + stride, *c = zero + size, *v = x, largest = 0, excess = 0, worst;
  const casadi_real *part[8], *other[8];
  casadi_int active[stride], is_active[2 * size + rows];
  casadi_int i, j, k, m, q, count = 0, from = 0, chosen = -1, iteration;
  for (i = 0; i < 3 * size * size; ++i) work[i] = 0;
  for (i = 0; i < 2 * size + rows; ++i) is_active[i] = 0;
  for (i = 0; i < size; ++i) {
    zero[i] = 0;
    least[i] = i < n ? low[i] : 0;
    most[i] = i < n ? high[i] : infinity;
    U[i * size + i] = i < n ? weights[i] : penalty;
    c[i] = i < n ? -weights[i] * offset[i] : -penalty; /* negative gradient */
  }
  for (k = 0; k < blocks; ++k) { /* H */
    const casadi_int width = (k + 1) * group;
    for (q = 0; q < outputs; q += 8) {
      for (m = 0; m < 8; ++m) part[m] = q + m < outputs ? G[k] + (q + m) * width : zero;
      for (i = 0; i < width; ++i) ADD_ROWS((U + i * size), , part, i, part, i, width)
    }
    for (q = 0; q < outputs; ++q)
      for (i = 0; i < width; ++i) c[i] -= residual[k * outputs + q] * G[k][q * width + i];
  }
  for (i = 0; i < size; ++i) { /* H = U^T U, Z = U^-T */
    casadi_real *row = U + i * size, *z = Z + i * size, root;
    for (k = 0; k < i; k += 8) {
      for (m = 0; m < 8; ++m) part[m] = k + m < i ? U + (k + m) * size : zero;
      for (m = 0; m < 8; ++m) other[m] = k + m < i ? Z + (k + m) * size : zero;
      ADD_ROWS(row, -, part, i, part, i, size)
      ADD_ROWS(z, -, part, i, other, 0, (k + 8 < i ? k + 8 : i))
    }
    root = 1 / sqrt(row[i]);
    z[i] = 1;
    for (j = i; j < size; ++j) row[j] *= root;
    for (j = 0; j <= i; ++j) z[j] *= root;
  }
  for (k = 0; k < size; k += 8) { /* H^-1 = Z^T Z */
    for (m = 0; m < 8; ++m) part[m] = k + m < size ? Z + (k + m) * size : zero;
    for (i = 0; i < size && i < k + 8; ++i) ADD_ROWS((inverse + i * size), , part, i, part, i, (k + 8 < size ? k + 8 : size))
  }
  for (i = 0; i < size; ++i)
    for (j = 0; j < i; ++j) inverse[i * size + j] = inverse[j * size + i];
  *status = 1;
  for (iteration = 0; iteration < 10 * (2 * size + rows) && *status; ++iteration) {
    for (i = 0; i < size; ++i) v[i] = 0;
    for (j = 0; j < size; ++j) /* v = H^-1 c */
      for (i = 0; i < size && c[j] != 0; ++i) v[i] += c[j] * inverse[j * size + i];
    if (chosen < 0) for (i = 0; i < size; ++i) largest = fmax(largest, fabs(x[i]));
    while (chosen >= 0) { /* steps until the chosen constraint is active */
      casadi_real curvature = 0, t = infinity;
      casadi_int blocking = -1;
      for (i = 0; i <= count; ++i) {
        m = active[i];
        K[count * stride + i] = m < size ? v[m] : m < 2 * size ? -v[m - size] : v[n];
        if (m >= 2 * size) ADD_PRODUCT(K[count * stride + i], -, (a + (m - 2 * size) * n), v, n)
      }
      for (k = from; k <= count; ++k) {
        casadi_real *row = L + k * stride;
        for (i = 0; i <= k; ++i) {
          curvature = K[k * stride + i];
          for (q = 0; q < i; ++q) curvature -= row[q] * L[i * stride + q];
          row[i] = i < k ? curvature / L[i * stride + i] : sqrt(curvature);
        }
      }
      for (i = 0; i < count; ++i) step[i] = L[count * stride + i];
      for (i = count; i-- > 0;) {
        step[i] /= L[i * stride + i];
        for (q = 0; q < i; ++q) step[q] -= L[i * stride + q] * step[i];
        if (step[i] > 0 && dual[i] / step[i] < t) t = fmax(dual[i] / step[i], 0), blocking = i;
      }
      if (count < size && curvature > 1e-12 * K[count * stride + count]) {
        if (excess / curvature <= t) t = excess / curvature, blocking = count;
        for (j = 0; j < size; ++j) x[j] += t * v[j];
        for (i = 0; i < count; ++i) for (j = 0; j < size; ++j) x[j] -= t * step[i] * W[i * size + j];
        excess -= t * curvature;
      }
      if (blocking < 0) break; /* the constraints contradict each other, or are NaN */
      for (i = 0; i < count; ++i) dual[i] -= t * step[i];
      dual[count] += t;
      from = blocking;
      if (blocking == count) {
        is_active[chosen] = 1;
        from = ++count;
        chosen = -1;
        continue;
      }
      is_active[active[blocking]] = 0;
      for (i = blocking; i < count; ++i) {
        active[i] = active[i + 1];
        dual[i] = dual[i + 1];
        for (j = 0; j < size; ++j) W[i * size + j] = W[(i + 1) * size + j];
        for (j = 0; j <= i; ++j) K[i * stride + j] = K[(i + 1) * stride + j + (j >= blocking)];
      }
      v = W + --count * size;
    }
    if (chosen >= 0) break;
    *status = 0;
    for (m = 0, worst = 1; m < 2 * size + rows; ++m) { /* the constraint with the largest excess in its tolerance */
      casadi_real over, tolerance = largest;
      if (is_active[m]) continue;
      if (m < 2 * size) {
        over = m < size ? least[m] - x[m] : x[m - size] - most[m - size];
        tolerance += fabs(m < size ? least[m] : most[m - size]);
      } else {
        over = -b[m - 2 * size] - x[n];
        tolerance = 1 + fabs(b[m - 2 * size]);
        ADD_PRODUCT(over, +, (a + (m - 2 * size) * n), x, n)
      }
      tolerance = 1e-9 * tolerance + 1e-100;
      if (over <= worst * tolerance && over < infinity) continue; /* false for NaN */
      worst = over < infinity ? over / tolerance : infinity;
      excess = over;
      chosen = m;
    }
    if (chosen < 0) break;
    *status = 1;
    active[count] = chosen;
    dual[count] = 0;
    v = W + count * size;
    for (j = 0; j < size; ++j)
      c[j] = chosen < 2 * size ? (j == chosen) - (j + size == chosen) : j < n ? -a[(chosen - 2 * size) * n + j] : 1;
  }
  for (i = 0; i < n; ++i) change[i] = x[i];
#undef stride
#undef ADD_PRODUCT
#undef ADD_ROWS
