"""Co-simulation units: fmpy accepts them, and they move as `simulate` does."""

from __future__ import annotations

import zipfile

import numpy as np
import pytest

import tenscasadi as tc
from tenscasadi.util.compile import CompileError, find_compiler

fmpy = pytest.importorskip("fmpy", reason="tenscasadi[fmu] is not installed")
PRISM = tc.shapes.prism(stiffness=1000.0, damping=2.0, prestress=50.0)
needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="there is no C compiler")


def run(path, duration, start=None, inputs=None):
    return fmpy.simulate_fmu(
        str(path),
        stop_time=duration,
        output_interval=0.01,
        start_values=start or {},
        input=inputs,
        output=["node[4].position.z", "node[4].velocity.x", "tension[7]"],
    )


@pytest.fixture(scope="module")
def unit(tmp_path_factory):
    scene = tc.Scene(
        PRISM,
        control=tc.RestLength(),
        gravity=tc.Gravity(),
        ground=tc.Ground(height=-0.1, stiffness=1e3, damping=5.0),
        parameters=tc.Parameters("gravity", scale=["stiffness"]),
    )
    model = tc.Model(scene)
    return model, tc.export_fmu(model, tmp_path_factory.mktemp("unit") / "prism.fmu")


@needs_compiler
def test_fmpy_finds_no_fault(unit):
    from fmpy.validation import validate_fmu

    _, path = unit
    assert validate_fmu(str(path)) == []
    about = fmpy.read_model_description(str(path))
    assert about.fmiVersion == "2.0"
    assert len(about.modelVariables) == 9 + 4 + 36 + 9
    with zipfile.ZipFile(path) as pack:
        assert {"sources/fmu.c", "modelDescription.xml"} <= set(pack.namelist())


@needs_compiler
def test_unit_moves_as_simulate_does(unit):
    model, path = unit
    parameters = {"gravity": [0.0, 0.0, -5.0], "stiffness": 1.2}
    values = np.repeat(model.control_at(model.parameters.values(parameters))[None], 31, axis=0)
    values[:, 3] *= 0.9
    same = tc.simulate(
        model,
        0.3,
        1e-3,
        control=values[:-1],
        parameters=parameters,
        correction=tc.Projection(1),
        save_every=10,
        verify=False,
    )
    given = np.array(
        [(0.0, values[0, 3]), (1.0, values[0, 3])],
        dtype=[("time", float), ("control.rest_length[3]", float)],
    )
    seen = run(
        path,
        0.3,
        {"gravity[z]": -5.0, "stiffness scale": 1.2, "control.rest_length[3]": values[0, 3]},
        given,
    )
    assert seen["time"] == pytest.approx(same.time, abs=1e-9)
    assert seen["node[4].position.z"] == pytest.approx(same.nodes[:, 4, 2], abs=1e-9)
    assert seen["node[4].velocity.x"] == pytest.approx(same.velocities[:, 4, 0], abs=1e-8)
    assert seen["tension[7]"][1:] == pytest.approx(same.tension[1:, 7], abs=1e-6)


@needs_compiler
def test_unit_that_diverges_reports_an_error(tmp_path):
    model = tc.Model(tc.Scene(PRISM, control=tc.RestLength()))
    path = tc.export_fmu(model, tmp_path / "coarse.fmu", step=10.0)
    with pytest.raises(Exception, match="fmi2DoStep"):
        fmpy.simulate_fmu(
            str(path),
            stop_time=1e4,
            output_interval=10.0,
            start_values={"control.rest_length[0]": 0.3},
        )


def test_wrong_arguments_are_named(tmp_path, monkeypatch):
    model = tc.Model(tc.Scene(PRISM))
    with pytest.raises(ValueError, match=r"ends in \.fmu"):
        tc.export_fmu(model, tmp_path / "prism.zip")
    with pytest.raises(ValueError, match="step"):
        tc.export_fmu(model, tmp_path / "prism.fmu", step=0.0)
    with pytest.raises(ValueError, match="chooses its steps"):
        tc.export_fmu(model, tmp_path / "prism.fmu", scheme=tc.Cvodes())
    monkeypatch.setattr("tenscasadi.exchange.fmu.find_compiler", lambda: None)
    with pytest.raises(CompileError, match="install gcc"):
        tc.export_fmu(model, tmp_path / "prism.fmu")
    assert not list(tmp_path.iterdir())


@needs_compiler
@pytest.mark.parametrize(
    ("control", "name", "unit"),
    [
        (tc.Tension(), "control.tension[0]", "N"),
        (tc.ForceDensity(), "control.force_density[0]", "N/m"),
        (None, None, None),
    ],
)
def test_inputs_are_named_by_the_control(control, name, unit, tmp_path):
    model = tc.Model(tc.Scene(PRISM, control=control))
    about = fmpy.read_model_description(str(tc.export_fmu(model, tmp_path / "unit.fmu")))
    inputs = [v for v in about.modelVariables if v.causality == "input"]
    assert len(inputs) == model.nu
    if name is not None:
        assert (inputs[0].name, inputs[0].unit) == (name, unit)
