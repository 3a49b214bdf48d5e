// Look up a table in each lane. CasADi's code for doubles, in namespace scalar, selects the values. A table with one output is then
// interpolated in all lanes at once, with the same rounding.
static inline void casadi_interpn(lanes *res, casadi_int ndim, const double *grid, const casadi_int *offset, const double *values,
                                  const lanes *x, const casadi_int *lookup_mode, casadi_int m, casadi_int *iw, lanes *) {
  if (ndim == 1) {
    lanes below, above;
    casadi_int place[LANES];
    for (int k = 0; k < LANES; ++k) {
      const casadi_int i = place[k] = scalar::casadi_low(get(*x, k), grid, offset[1], *lookup_mode);
      set(below, k, grid[i]);
      set(above, k, grid[i + 1]);
    }
    const lanes share = (*x - below) / (above - below), rest = lanes(1.0) - share;
    for (casadi_int c = 0; c < m; ++c) {
      for (int k = 0; k < LANES; ++k) {
        set(below, k, values[place[k] * m + c]);
        set(above, k, values[(place[k] + 1) * m + c]);
      }
      res[c] = lanes(0.0) + rest * below + share * above;
    }
    return;
  }
  double at[ndim], work[ndim], found[m];
  for (int k = 0; k < LANES; ++k) {
    for (casadi_int i = 0; i < ndim; ++i) at[i] = get(x[i], k);
    scalar::casadi_interpn(found, ndim, grid, offset, values, at, lookup_mode, m, iw, work);
    for (casadi_int c = 0; c < m; ++c) set(res[c], k, found[c]);
  }
}
