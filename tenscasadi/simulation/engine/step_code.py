"""Generation of the time loop's code in CasADi, C and C++.

The Functions have the names that `engine.hpp` expects.
"""

from __future__ import annotations

import re
from importlib import resources
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import casadi as ca

from tenscasadi.integrators.adaptive import build_control
from tenscasadi.integrators.breaks import split_at_breaks
from tenscasadi.integrators.events import count_breakable
from tenscasadi.integrators.runge_kutta import (
    SEVERAL,
    EmbeddedRungeKutta,
    ExplicitRungeKutta,
    equal_weights,
    repeats_last,
    select_stages,
)
from tenscasadi.integrators.scheme import Scheme, equations
from tenscasadi.integrators.stabilization import Correction, build_correction, build_effect
from tenscasadi.integrators.tableaux import Tableau
from tenscasadi.util.casadi_tools import symbol_kind

if TYPE_CHECKING:
    from tenscasadi.dynamics.model import Model

Measured = Literal["nothing", "errors", "all"]
# Functions of `struct Model`, in order
CALLS = (
    "ode",
    "step",
    "prepare",
    "decide",
    "project",
    "effect",
    "measure",
    "energy",
    "stage",
    "final",
)
_OWN = ("nx", "nw", "nu", "work", "jumps", "measures", "potential", "modes", "errors", "stages")
MODEL_SIZES = (*_OWN, "size_arg", "size_res", "size_iw", "size_w")

# CasADi writes if_else as a sum of these. Operands are variables or loop entries.
_OPERAND = r"\w+(?:\[\w+\])?|\(\*\w+\+\+\)"
_CONDITION = re.compile(rf"\(({_OPERAND})\?({_OPERAND}):0\)")
_SIGN = re.compile(r"^casadi_real casadi_sign\(.*?\}$", re.DOTALL | re.MULTILINE)
_LOOK_UP = re.compile(
    r"casadi_interpn\([^,;]+, \d+, (\w+), \w+, (\w+),"
)  # points and values of a table
_TABLE_CODE = "clear", "low", "interpn_weights", "interpn_interpolate", "flip", "interpn"
_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
_WIDEST = """
#if defined(__AVX512F__)
#define BYTES 64
#elif defined(__AVX__)
#define BYTES 32
#else
#define BYTES 16
#endif
#ifdef SINGLE
#define LANES (BYTES / 4)
#else
#define LANES (BYTES / 8)
#endif
"""


class KernelFunctions(NamedTuple):
    """CasADi Functions and sizes of a model for `engine.hpp`.

    `functions` are named as in the time loop. With a Runge-Kutta `tableau` the loop evaluates the
    stages of "ode" itself. Otherwise it calls a Function "step".
    """

    functions: dict[str, ca.Function]
    sizes: dict[str, int]
    tableau: Tableau | None

    @property
    def adaptive(self) -> bool:
        """Whether the scheme has error control."""
        return "decide" in self.functions


class Account(NamedTuple):
    """Energies that a run integrates for its energy balance.

    *power*: work of nonconservative forces. *jumps*: energy jumps at changes of the control.
    """

    power: bool
    jumps: bool


def write_program(
    model: Model,
    scheme: Scheme,
    correction: Correction | None,
    account: Account,
    measured: Measured = "nothing",
    costs: tuple[ca.Function | None, ca.Function | None] = (None, None),
) -> KernelFunctions:
    """Build the CasADi Functions that a time loop calls.

    `account` are the energies to integrate, and `measured` selects the errors of saved rows.
    `costs` are the running and the terminal cost.
    """
    power = (
        model.with_stacked_input(model.power) if account.power and model.power is not None else None
    )
    tableau = None if count_breakable(model) and not scheme.adaptive else _tableau(scheme)
    sizes = dict.fromkeys(_OWN, 0) | {"nx": model.nx, "nu": model.nu}
    if isinstance(scheme, EmbeddedRungeKutta) and scheme.adaptive:
        functions = dict(build_control(model, scheme, correction, power is not None)._asdict())
        sizes["modes"] = functions["ode"].size1_in(1) - model.nw
        sizes["errors"] = len(scheme.tableau.errors)
    else:
        functions = _build_steps(model, scheme, correction, power, tableau)
    costing = {name: cost for name, cost in zip(("stage", "final"), costs, strict=True) if cost}
    functions |= costing | _observing(model, account, measured)
    if "measure" in functions:
        sizes["measures"] = functions["measure"].size1_out(0)
    sizes["nw"] = max(model.nw, *(cost.size1_in(1) for cost in costing.values()), 0)
    sizes |= {"work": int(power is not None), "jumps": int(account.jumps)}
    sizes["potential"] = int(model.schedule is None)
    sizes["stages"] = 0 if tableau is None else len(tableau.b) + 1
    if sizes["nw"] > model.nw:
        functions = {name: _widen(f, model.nw, sizes["nw"]) for name, f in functions.items()}
    return KernelFunctions(
        {name: _rename(name, f) for name, f in functions.items()}, sizes, tableau
    )


def write_observer(model: Model, account: Account, measured: Measured) -> KernelFunctions:
    """Build the Functions that measure errors of SUNDIALS runs.

    `account` are the energies to integrate, and `measured` selects the errors of saved rows.
    """
    functions = _observing(model, account, measured)
    sizes = dict.fromkeys(_OWN, 0) | {"nx": model.nx, "nu": model.nu, "nw": model.nw}
    sizes |= {"work": int(account.power and model.power is not None), "jumps": int(account.jumps)}
    sizes["potential"] = int(model.schedule is None)
    sizes["measures"] = functions["measure"].size1_out(0) if "measure" in functions else 0
    return KernelFunctions(functions, sizes, None)


def _observing(model: Model, account: Account, measured: Measured) -> dict[str, ca.Function]:
    functions = {}
    if measured != "nothing":
        functions["measure"] = _measure(model.with_stacked_input(model.observe), measured == "all")
    if account.jumps:
        functions["energy"] = model.with_stacked_input(model.energy_function)
    return functions


def _build_steps(
    model: Model,
    scheme: Scheme,
    correction: Correction | None,
    power: ca.Function | None,
    tableau: Tableau | None,
) -> dict[str, ca.Function]:
    functions = {}
    if tableau is not None:
        functions["ode"] = _merge_power(equations(model, power), model, power)
    else:  # the loop passes the tolerance, if the scheme takes one
        step = getattr(scheme, "advance_within", scheme.advance)(model, power)
        functions["step"] = split_at_breaks(step, model)
    project = None if correction is None else build_correction(model, correction)
    if project is not None:
        functions |= {"project": project, "effect": build_effect(model)}
    return functions


def _merge_power(ode: ca.Function, model: Model, power: ca.Function | None) -> ca.Function:
    """Merge ode and power into one scalar Function if possible.

    Both use the same forces, which are then computed once.
    """
    if power is None or not power.is_a("SXFunction") or not model.ode.is_a("SXFunction"):
        return ode
    z, w = ca.SX.sym("z", model.nx + 1), ca.SX.sym("w", model.nw)
    rates = ca.vertcat(model.with_stacked_input(model.ode)(z[:-1], w), power(z[:-1], w))
    return ca.Function("ode_and_work", [z, w], ca.cse([rates]))


def _tableau(scheme: Scheme) -> Tableau | None:
    """Return the tableau of a Runge-Kutta scheme, else None.

    Subclasses with their own `advance` or `step` have none.
    """
    if not isinstance(scheme, ExplicitRungeKutta):
        return None
    own = (
        type(scheme).advance is not ExplicitRungeKutta.advance
        or type(scheme).step is not ExplicitRungeKutta.step
    )
    return None if own else scheme.tableau


def _measure(observe: ca.Function, everything: bool) -> ca.Function:
    """Build (x, w) → constraint errors and energies.

    `observe` is a Function whose outputs contain them by name. With `everything`, force densities
    and tensions follow.
    """
    kind = symbol_kind(observe)
    x, w = kind.sym("x", observe.size1_in(0)), kind.sym("w", observe.size1_in(1))
    found = dict(zip(observe.name_out(), observe.call([x, w]), strict=True))
    names = ["bar_length_error", "joint_error", "energy"]
    names += ["force_density", "tension"] if everything else []
    return ca.Function("measure", [x, w], [ca.vertcat(*(found[name] for name in names))])


def _widen(function: ca.Function, own: int, nw: int) -> ca.Function:
    """Extend the input w of a Function to `nw` entries.

    It has had `own` entries. The Function ignores the new ones. Functions without such an input are
    returned unchanged.
    """
    if function.n_in() < 2 or function.size1_in(1) != own:
        return function
    inputs: list[Any] = function.sx_in() if function.is_a("SXFunction") else function.mx_in()
    x, old, *others = inputs
    w = type(old).sym("w", nw)
    return ca.Function(
        "widened", [x, w, *others], function.call([x, w[:own], *others], True, False)
    )


def _rename(name: str, function: ca.Function) -> ca.Function:
    """Rename a Function, and make its outputs dense.

    The new name is "motion_" and `name`. The graph is inlined if possible, since a nested call
    would copy the outputs.
    """
    scalar = function.is_a("SXFunction")
    inputs: Any = function.sx_in() if scalar else function.mx_in()
    outputs = function.call(inputs, not scalar and function.is_a("MXFunction"), False)
    return ca.Function(f"motion_{name}", inputs, [ca.densify(value) for value in outputs])


# --- sources ---


def room_sizes(program: KernelFunctions) -> dict[str, int]:
    """Return the sizes of the Functions' work arrays.

    The Functions are those of a program.
    """
    functions = program.functions.values()
    return {
        "size_arg": max(10, *(f.sz_arg() for f in functions)),  # `decide` has 10 inputs
        "size_res": max(2, *(f.sz_res() for f in functions)),
        "size_iw": max(f.sz_iw() for f in functions),
        "size_w": max(f.sz_w() for f in functions),
    }


def write_model(program: KernelFunctions, single: bool = False) -> str:
    """Generate the C code of a program's Functions.

    With `single` it uses single precision.
    """
    options: dict[str, Any] = {"with_header": False, "verbose": False}
    options |= {"casadi_real": "float"} if single else {}
    generator = ca.CodeGenerator("motion.c", options)
    for function in program.functions.values():
        generator.add(function)
    return str(generator.dump())


def write_lane_model(program: KernelFunctions, lanes: int) -> str:
    """Generate C++ code that evaluates a program for several runs.

    Each of the `lanes` of a SIMD register holds one run.
    """
    code = _replace_branches(write_model(program))
    return "\n".join([f"#define LANES {lanes}", _text("lanes.hpp"), 'extern "C" {', code, "}"])


def write_engine(program: KernelFunctions, single: bool = False, lanes: int = 1) -> str:
    """Generate the C++ time loop for Functions in another library.

    The Functions are those of a program. It is used for all models with this Runge-Kutta tableau.
    With `single` it uses single precision. Each step advances as many runs as `lanes`.
    """
    head = ["#define SINGLE"] if single else []
    return "\n".join([*head, f"#define LANES {lanes}", _text("lanes.hpp"), *_engine(program)])


def write_lanes(program: KernelFunctions, lanes: int | None, single: bool = False) -> str:
    """Generate C++ code of a program and its time loop for several SIMD lanes.

    With `lanes` None, their number fills the processor's registers; `single` uses single precision.
    """
    sizes = program.sizes | room_sizes(program)
    calls = [f"motion_{name}" if name in program.functions else "0" for name in CALLS]
    own = ", ".join([*(str(sizes[name]) for name in MODEL_SIZES), *calls])
    return "\n".join(
        [
            *(["#define SINGLE"] if single else []),
            _WIDEST if lanes is None else f"#define LANES {lanes}",
            _text("lanes.hpp"),
            _replace_branches(write_model(program)),
            f"#define OWN_MODEL {{{own}}}",
            *_engine(program),
        ]
    )


def _engine(program: KernelFunctions) -> list[str]:
    tableau = program.tableau
    if tableau is None:
        take = (
            "  return evaluate(room, MODEL.step, {room.z, room.w, &h, room.numbers}, {room.after});"
        )
        steps = [_TAKE.format(body=take)]
    else:
        steps = [_TAKE.format(body=_write_stages(tableau, select_stages(tableau), "w"))]
    body = "  return 1;" if tableau is None or not program.adaptive else _write_trial(tableau)
    return [_text("engine.hpp"), *steps, _TRY.format(body=body)]


_TAKE = "static int take_step(Room &room, lanes h) {{\n{body}\n}}"
_TRY = "static int try_step(Room &room, lanes h, const lanes *&first, const lanes *&last) {{\n{body}\n}}"
_SLOPE = "  if (evaluate(room, MODEL.ode, {{{at}, room.{held}}}, {{k{i}}})) return 1;"


def _write_stages(tableau: Tableau, stages: set[int], held: str, end: str = "  return 0;") -> str:
    """Write C++ code for the stages of a Runge-Kutta step.

    `tableau` has its coefficients. `stages` are the numbers of those that affect the result. `held`
    is the C++ expression of the inputs, and `end` the last line. Each stage takes one pass over the
    state; CasADi would take one for each term. Rounding is that of `runge_kutta.build_step`.
    """
    lines = [
        "  const int64_t n = MODEL.nx + MODEL.work;",
        "  const lanes *x = room.z;",
        "  lanes *after = room.after, *y = room.point;",
    ]
    lines += [f"  lanes *k{i} = room.slopes + {i} * n;" for i in sorted(stages)]
    for i in sorted(stages):
        moves = any(tableau.a[i])
        lines += [_pass("y[i]", tableau.a[i])] if moves else []
        lines += [_SLOPE.format(at="y" if moves else "x", held=held, i=i)]
    return "\n".join([*lines, _pass("after[i]", tableau.b), end])


def _write_trial(tableau: Tableau) -> str:
    """Write C++ code for a Runge-Kutta step with error estimates.

    `tableau` has its coefficients. It corresponds to `runge_kutta.build_trial`.
    """
    count = len(tableau.b)
    lines = [
        _pass(f"room.errors[{j} * n + i]", row, "lanes(0.0)")
        for j, row in enumerate(tableau.errors)
    ]
    if repeats_last(tableau):
        lines += [f"  first = k0, last = k{count - 1};"]
    else:
        lines += [
            f"  lanes *k{count} = room.slopes + {count} * n;",
            f"  if (MODEL.modes && evaluate(room, MODEL.ode, {{after, room.v}}, {{k{count}}})) return 1;",
            f"  first = k0, last = k{count};",
        ]
    return _write_stages(tableau, set(range(count)), "v", "\n".join([*lines, "  return 0;"]))


def _pass(target: str, weights: tuple[float, ...], base: str = "x[i]") -> str:
    """Write C++ code for target = base + h Σ weight · slope.

    Terms are in the order of `runge_kutta`, for equal rounding.
    """
    used = {
        weight: " + ".join(f"k{k}[i]" for k in stages)
        for weight, stages in equal_weights(weights).items()
    }
    factors = "".join(
        f"const lanes c{j} = lanes({weight!r}) * h; " for j, weight in enumerate(used)
    )
    terms = [f"c{j} * ({slopes})" for j, slopes in enumerate(used.values())]
    if len(used) > SEVERAL:
        terms = ["(" + " + ".join(["lanes(0.0)", *terms]) + ")"]
    return (
        f"  {{ {factors}for (int64_t i = 0; i < n; ++i) {target} = {' + '.join([base, *terms])}; }}"
    )


# --- C as lanes ---


def _replace_branches(source: str) -> str:
    """Replace conditional expressions in C `source` code by SIMD selections.

    C++ code for SIMD vectors does not compile with other branches.
    """
    source = _CONDITION.sub(r"select(\1, \2)", _tables_lane_by_lane(_COMMENT.sub("", source)))
    return _SIGN.sub(
        "static inline casadi_real casadi_sign(casadi_real x) { return sign(x); }", source
    )


def _tables_lane_by_lane(source: str) -> str:
    """Evaluate look-up tables separately for each SIMD lane.

    `source` is the C code to change. CasADi's code for tables branches on numbers, so it works on
    one double at a time.
    """
    used = _LOOK_UP.findall(source)
    if not used:
        return source
    for name in {name for pair in used for name in pair}:
        source = source.replace(f"static const casadi_real {name}[", f"static const double {name}[")
    code = []
    for name in _TABLE_CODE:
        found = re.search(
            rf"^(?:void|casadi_int) casadi_{name}\(.*?^\}}$", source, re.DOTALL | re.MULTILINE
        )
        if found is None:  # unknown CasADi version: not compiled in lanes
            return source
        code.append(found[0])
    for part in code[1:-1]:
        source = source.replace(part, "")
    scalar = "\n".join(
        [
            "namespace scalar {",
            *(part.replace("casadi_real", "double") for part in code),
            "}",
            _text("tables.hpp"),
        ]
    )
    return source.replace(code[-1], scalar)


def _text(name: str) -> str:
    return resources.files("tenscasadi.simulation.engine").joinpath(name).read_text("utf-8")
