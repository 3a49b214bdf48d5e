"""Export of a model as an FMU for co-simulation (FMI 2.0)."""

from __future__ import annotations

import hashlib
import os
import platform
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

from tenscasadi.dynamics.model import Model
from tenscasadi.exchange.fmu_source import FMU_SOURCE
from tenscasadi.integrators.runge_kutta import RungeKutta4
from tenscasadi.integrators.scheme import Scheme
from tenscasadi.simulation.export import export_c
from tenscasadi.util.compile import CompileError, find_compiler, run_compiler
from tenscasadi.util.validate import FilePath, file_path, instance, positive_number
from tenscasadi.util.whole_file import whole_file
from tenscasadi.version import __version__

_NAME = "tensegrity"  # of the library
_SYSTEMS = {"linux": ("linux", ".so"), "darwin": ("darwin", ".dylib"), "win32": ("win", ".dll")}


class _Variable(NamedTuple):
    """Input, parameter or output of an FMU.

    `causality` is "input", "output" or "parameter", and `start` the initial value (None for
    outputs).
    """

    name: str
    unit: str
    causality: str
    start: float | None = None


def export_fmu(
    model: Model,
    path: FilePath,
    step: float = 1e-3,
    scheme: Scheme = RungeKutta4(),
) -> Path:
    """Write a model as a co-simulation unit of FMI 2.0.

    Inputs are the control of the strings, tunable parameters those of the model. Outputs are
    positions and velocities of the nodes and tensions of the strings. Simulink, OpenModelica,
    Dymola and fmpy read such units. The unit contains its sources, and a library for this machine.

    Parameters
    ----------
    model : Model
        Model without a clock.
    path : path-like
        File to write, which ends in ``.fmu``.
    step : float
        Largest step between communication points [s].
    scheme : Scheme
        Scheme with fixed steps. A projection onto bars and joints follows each step.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    CompileError
        There is no C compiler, or it rejects the code.
    TypeError, ValueError
        An argument is wrong.
    OSError
        The file cannot be written.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.prism(), control=tc.RestLength()))
    >>> tc.export_fmu(model, "prism.fmu").name
    'prism.fmu'
    """
    instance("model", model, Model, "a tenscasadi.Model")
    target, longest = file_path("path", path), positive_number("step", step)
    if target.suffix != ".fmu":
        raise ValueError(f"path is {os.fspath(path)!r}: give a file name that ends in .fmu")
    with TemporaryDirectory() as name:
        folder = Path(name)
        export_c(model, folder, scheme)
        for unused in ("main.c", f"{_NAME}.h"):
            (folder / unused).unlink()
        variables = list(_list_variables(model))
        source = (folder / f"{_NAME}.c").read_bytes() + (folder / "start.h").read_bytes()
        guid = hashlib.sha256(source + FMU_SOURCE.encode()).hexdigest()[:32]
        (folder / "fmu.c").write_text(FMU_SOURCE, encoding="utf-8")
        (folder / "unit.h").write_text(_write_header(model, guid, longest), encoding="utf-8")
        system, ending = _SYSTEMS.get(sys.platform, _SYSTEMS["linux"])
        library = folder / f"{_NAME}{ending}"
        _compile(folder, library)
        bits = "64" if sys.maxsize > 2**32 else "32"
        with whole_file(target) as file, zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as pack:
            pack.writestr("modelDescription.xml", _describe(variables, guid))
            pack.write(library, f"binaries/{system}{bits}/{library.name}")
            for part in sorted(folder.glob("*.[ch]")):
                pack.write(part, f"sources/{part.name}")
    return target


def _compile(folder: Path, library: Path) -> None:
    compiler = find_compiler()
    if compiler is None:
        raise CompileError("an FMU needs a C compiler: install gcc or clang, or name one by CC")
    flags = ["-O2", "-shared", *([] if platform.system() == "Windows" else ["-fPIC"])]
    command = [*compiler, *flags, str(folder / "fmu.c"), "-lm", "-o", str(library)]
    run_compiler(command)


def _list_variables(model: Model) -> Iterator[_Variable]:
    """Yield inputs, parameters and outputs in the order of their references."""
    p, control = model.parameters.nominal, model.scene.control
    if control is not None:
        quantity = control.name.replace(" ", "_").replace("-", "_")
        for k, value in enumerate(model.control_at(p)):
            yield _Variable(f"control.{quantity}[{k}]", control.unit, "input", float(value))
    for name, unit, value in zip(model.parameters.names, model.parameters.units, p, strict=True):
        yield _Variable(name, unit.replace("·", " ").replace("²", "2"), "parameter", float(value))
    nodes = range(len(model.structure.nodes))
    for quantity, unit in (("position", "m"), ("velocity", "m/s")):
        for node in nodes:
            for axis in "xyz":
                yield _Variable(f"node[{node}].{quantity}.{axis}", unit, "output")
    for k in range(len(model.structure.strings)):
        yield _Variable(f"tension[{k}]", "N", "output")


def _write_header(model: Model, guid: str, step: float) -> str:
    outputs = model.observe.name_out()
    places = {name: outputs.index(name) for name in ("nodes", "velocities", "tension")}
    lines = [
        f'#define GUID "{guid}"',
        f"#define LARGEST_STEP {step!r}",
        f"#define STRINGS {len(model.structure.strings)}",
        f"#define RESULTS {len(outputs)}",
        *(f"#define AT_{name.upper()} {place}" for name, place in places.items()),
    ]
    return "\n".join(lines) + "\n"


def _describe(variables: list[_Variable], guid: str) -> str:
    """Build the text of modelDescription.xml.

    `guid` identifies the FMU, and `variables` are in the order of their value references.
    """
    variability = {"input": "continuous", "output": "continuous", "parameter": "tunable"}
    units = sorted({variable.unit for variable in variables})
    scalars = []
    for k, (name, unit, causality, start) in enumerate(variables):
        given = "" if start is None else f' start="{start!r}"'
        scalars.append(
            f'    <ScalarVariable name={quoteattr(name)} valueReference="{k}" causality="{causality}" '
            f'variability="{variability[causality]}"><Real unit={quoteattr(unit)}{given}/></ScalarVariable>'
        )
    outputs = [k for k, variable in enumerate(variables) if variable.causality == "output"]
    unknowns = "".join(f'<Unknown index="{k + 1}"/>' for k in outputs)
    return "\n".join(
        [
            '<?xml version="1.0" encoding="UTF-8"?>',
            f'<fmiModelDescription fmiVersion="2.0" modelName="tensegrity" guid="{guid}" '
            f'generationTool="tenscasadi {__version__}" variableNamingConvention="flat">',
            f'  <CoSimulation modelIdentifier="{_NAME}" canHandleVariableCommunicationStepSize="true">',
            '    <SourceFiles><File name="fmu.c"/></SourceFiles>',
            "  </CoSimulation>",
            "  <UnitDefinitions>",
            *(f"    <Unit name={quoteattr(unit)}/>" for unit in units),
            "  </UnitDefinitions>",
            "  <ModelVariables>",
            *scalars,
            "  </ModelVariables>",
            f"  <ModelStructure><Outputs>{unknowns}</Outputs><InitialUnknowns>{unknowns}</InitialUnknowns></ModelStructure>",
            "</fmiModelDescription>",
            "",
        ]
    )
