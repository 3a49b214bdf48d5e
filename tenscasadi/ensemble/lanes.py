"""Lanes: CasADi's C as C++ whose numbers are several doubles, so that each instruction moves several motions."""

from __future__ import annotations

import re
from importlib import resources

import casadi as ca

from tenscasadi.ensemble.program import Program
from tenscasadi.ensemble.stages import work_size, write_step

# CasADi writes if_else as a sum of these; the operands are variables, or entries that a loop passes
# over.
_OPERAND = r"\w+(?:\[\w+\])?|\(\*\w+\+\+\)"
_CONDITION = re.compile(rf"\(({_OPERAND})\?({_OPERAND}):0\)")
_SIGN = re.compile(r"^casadi_real casadi_sign\(.*?\}$", re.DOTALL | re.MULTILINE)
_LOOK_UP = re.compile(
    r"casadi_interpn\([^,;]+, \d+, (\w+), \w+, (\w+),"
)  # of a table: its points, and its values
_TABLE_CODE = "clear", "low", "interpn_weights", "interpn_interpolate", "flip", "interpn"
_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)

_WIDEST = """
#if defined(__AVX512F__)
#define LANES 8
#elif defined(__AVX__)
#define LANES 4
#else
#define LANES 2
#endif
"""


def write_source(program: Program, lanes: int | None) -> str:
    """Write the C++ of a program.

    lanes: motions in each instruction; None: as many as the processor's registers hold. One lane is
    plain double, and takes any code.
    """
    functions, sizes, tableau = program.functions, program.sizes, program.tableau
    generator = ca.CodeGenerator("motion.c", {"with_header": False, "verbose": False})
    for function in functions.values():
        generator.add(function)
    room = {
        "SIZE_ARG": max(3, *(function.sz_arg() for function in functions.values())),
        "SIZE_RES": max(function.sz_res() for function in functions.values()),
        "SIZE_IW": max(function.sz_iw() for function in functions.values()),
        "SIZE_W": max(function.sz_w() for function in functions.values()),
    }
    if tableau is not None:
        room["SIZE_W"] += work_size(tableau, sizes["NX"] + sizes["WORK"])
    has = {name.replace("motion_", "HAS_").upper(): 1 for name in functions}
    return "\n".join(
        [
            _WIDEST if lanes is None else f"#define LANES {lanes}",
            _text("lanes.hpp"),
            generator.dump() if lanes == 1 else _replace_branches(generator.dump()),
            *(f"#define {name} {value}" for name, value in {**has, **sizes, **room}.items()),
            "" if tableau is None else write_step(tableau),
            _text("motions.hpp"),
        ]
    )


def _replace_branches(source: str) -> str:
    """Write choices between numbers as functions of lanes; what is not known here does not compile as lanes."""
    source = _CONDITION.sub(r"select(\1, \2)", _tables_lane_by_lane(_COMMENT.sub("", source)))
    return _SIGN.sub(
        "static inline casadi_real casadi_sign(casadi_real x) { return sign(x); }", source
    )


def _tables_lane_by_lane(source: str) -> str:
    """Let tables be looked up in each lane by CasADi's own code for doubles, which branches on numbers."""
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
        if found is None:  # other code than is known here: it does not compile as lanes
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
    return resources.files("tenscasadi.ensemble").joinpath(name).read_text(encoding="utf-8")
