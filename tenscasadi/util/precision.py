"""Single precision: C code of CasADi that computes in float, behind the interface in double by which CasADi calls it."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca


@dataclass(frozen=True)
class Single:
    """As machine code that computes in float, some seven digits, as the small processors do that `export_c` writes for.

    States are rounded to float from step to step, and so is each instruction between; errors and energies of the result are
    computed from these states in double.
    """


Compiled = bool | Single | None  # how to run: True, as machine code; False, in CasADi's virtual machine; None, as there is a compiler

# What CasADi reads of a library whose numbers' type shows; all else is the same for both.
_TYPED = ("", "_work", "_work_bytes", "_default_in", "_casadi_real_size")


def c_code(function: ca.Function, single: bool = False) -> str:
    """`function` in C, for `casadi.external`; `single`: with float inside. Raises RuntimeError where CasADi cannot write C."""
    generator = ca.CodeGenerator(function.name() + ".c", {"casadi_real": "float"} if single else {})
    generator.add(function)
    return _behind_double(function, generator.dump()) if single else generator.dump()


def _behind_double(function: ca.Function, source: str) -> str:
    """The source under other names, then functions of the right names that round arguments to float and give results back as double."""
    name, inputs, outputs = function.name(), function.n_in(), function.n_out()
    renamed = [f"#define {name}{suffix} {name}_in_float{suffix}" for suffix in _TYPED]
    restored = [f"#undef {name}{suffix}" for suffix in _TYPED]
    sizes = {
        "NAME": name,
        "N_IN": str(inputs),
        "N_OUT": str(outputs),
        "SIZES_IN": ", ".join(str(function.nnz_in(i)) for i in range(inputs)),
        "SIZES_OUT": ", ".join(str(function.nnz_out(i)) for i in range(outputs)),
        "ROOM": str(function.nnz_in() + function.nnz_out()),
    }
    shell = _SHELL
    for key, value in sizes.items():
        shell = shell.replace(f"@{key}@", value)
    return "\n".join([*renamed, source, *restored, shell])


# A float takes no more room than a double, so that the work space of CasADi holds the copies too.
_SHELL = """
CASADI_SYMBOL_EXPORT int @NAME@_work(casadi_int *sz_arg, casadi_int *sz_res, casadi_int *sz_iw, casadi_int *sz_w) {
  if (@NAME@_in_float_work(sz_arg, sz_res, sz_iw, sz_w)) return 1;
  if (sz_arg) *sz_arg += @N_IN@;
  if (sz_res) *sz_res += @N_OUT@;
  if (sz_w) *sz_w += @ROOM@;
  return 0;
}

CASADI_SYMBOL_EXPORT int @NAME@(const double **arg, double **res, casadi_int *iw, double *w, int mem) {
  static const casadi_int size_in[] = {@SIZES_IN@}, size_out[] = {@SIZES_OUT@};
  const float **given = (const float **)(arg + @N_IN@);
  float **found = (float **)(res + @N_OUT@), *room = (float *)w;
  casadi_int i, k;
  for (i = 0; i < @N_IN@; ++i) {
    given[i] = arg[i] ? room : 0;
    for (k = 0; arg[i] && k < size_in[i]; ++k) *room++ = (float)arg[i][k];
  }
  for (i = 0; i < @N_OUT@; ++i) {
    found[i] = res[i] ? room : 0;
    if (res[i]) room += size_out[i];
  }
  if (@NAME@_in_float(given, found, iw, room, mem)) return 1;
  for (i = 0; i < @N_OUT@; ++i) {
    for (k = 0; res[i] && k < size_out[i]; ++k) res[i][k] = (double)found[i][k];
  }
  return 0;
}
"""
