"""The command line: what it prints, writes and refuses."""

from __future__ import annotations

import importlib
import json
import os
import re
import subprocess
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import ocp
import tenscasadi as tc
from tenscasadi.cli.main import COMMANDS, main
from tenscasadi.cli.source import TEMPLATES, find_source, read_title

ROOT = Path(__file__).resolve().parents[3]
SHAPES = ["pendulum", "double-pendulum", "prism", "d-bar", "six-bar-ball", "reach"]


def run(*arguments):
    return main([str(argument) for argument in arguments])


def written(out: str) -> list[Path]:
    return [Path(line.strip()) for line in out.split("wrote in")[1].splitlines()[1:]]


@pytest.mark.parametrize("shape", SHAPES)
def test_simulate_every_shape(shape, tmp_path, capsys):
    assert (
        run(
            "simulate",
            shape,
            "--t-end",
            0.1,
            "--uncompiled",
            "--output",
            tmp_path / "new" / "folder",
        )
        == 0
    )
    out = capsys.readouterr().out
    for words in (shape, "energy", "bar lengths", "joints", "wall time", "set-up"):
        assert words in out
    files = written(out)
    assert sorted(files) == sorted((tmp_path / "new" / "folder").iterdir())
    trajectory = tc.Trajectory.load(files[0])
    assert trajectory.time[-1] == pytest.approx(0.1)
    assert trajectory.success
    assert np.abs(trajectory.energy_error).max() < 1e-4
    assert (
        np.abs(
            trajectory.velocities[0] if "pendulum" not in shape else trajectory.velocities[-1]
        ).max()
        > 0.1
    )
    with Image.open(files[1]) as image:
        assert image.format == "PNG"


def test_simulate_takes_its_options(tmp_path, capsys):
    options = [
        "--coordinates",
        "full",
        "--gravity",
        1.62,
        "--save-every",
        5,
        "--projection",
        2,
        "--step",
        0.01,
        "--t-end",
        0.3,
        "--gif",
    ]
    assert run("simulate", "d-bar", *options, "--output", tmp_path) == 0
    out = capsys.readouterr().out
    assert "full coordinates" in out
    trajectory = tc.Trajectory.load(tmp_path / "d-bar-simulation.npz")
    assert trajectory.time == pytest.approx(np.append(np.arange(0, 0.3, 0.05), 0.3))
    assert trajectory.energy_parts[-1, 2] < 0  # gravity
    assert trajectory.joint_error[2::2].max() < 1e-14
    assert (tmp_path / "d-bar-simulation.gif").exists()


def test_gravity_zero_builds_none(tmp_path):
    assert (
        run(
            "simulate",
            "six-bar-ball",
            "--gravity",
            0,
            "--t-end",
            0.02,
            "--uncompiled",
            "--output",
            tmp_path,
        )
        == 0
    )
    trajectory = tc.Trajectory.load(tmp_path / "six-bar-ball-simulation.npz")
    assert np.all(trajectory.energy_parts[:, 2] == 0)
    assert trajectory.velocities[-1].mean(axis=0) == pytest.approx(
        trajectory.velocities[0].mean(axis=0)
    )


def test_divergence_is_reported_and_written(tmp_path, capsys):
    assert (
        run("simulate", "prism", "--step", 0.1, "--t-end", 20, "--uncompiled", "--output", tmp_path)
        == 1
    )
    out = capsys.readouterr().out
    assert "diverged" in out
    assert "try step" in out
    assert not tc.Trajectory.load(tmp_path / "prism-simulation.npz").success


def test_without_a_compiler_it_says_so(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    assert run("simulate", "pendulum", "--t-end", 0.1, "--output", tmp_path) == 0
    assert "not compiled" in capsys.readouterr().out
    assert run("info", "pendulum", "--output", tmp_path) == 0
    assert "none found" in capsys.readouterr().out
    assert run("plan", "prism", "--intervals", 10, "--output", tmp_path) == 0
    assert "runs uncompiled" in capsys.readouterr().out


@pytest.mark.parametrize("shape", SHAPES)
def test_shapes_start_with_bars_that_keep_their_length(shape):
    simulation = find_source(shape).simulation()
    model, x = simulation.model, simulation.start
    s, v = model.structure, model.velocities(x)
    first, second = s.bars.T
    stretching = np.einsum("bi,bi->b", s.nodes[second] - s.nodes[first], v[second] - v[first])
    assert np.abs(stretching).max() < 1e-13


@pytest.mark.parametrize("shape", SHAPES)
def test_info(shape, tmp_path, capsys):
    assert run("info", shape, "--output", tmp_path) == 0
    out = capsys.readouterr().out
    for words in ("nodes", "bars", "strings", "bars (λ)", "largest stable step", "C compiler"):
        assert words in out
    with np.load(tmp_path / f"{shape}-structure.npz") as saved:
        assert saved["nodes"] == pytest.approx(find_source(shape).scene().structure.nodes)
    assert (tmp_path / f"{shape}-structure.png") in written(out)


@pytest.mark.parametrize(
    "text",
    [
        "nodes = [[0, 0, 0], [0, 0, 1]]\nnode_mass = 1",
        "shape = 'membrane'\np = 3\nq = 2\nnode_mass = 0.1",
    ],
)
def test_info_without_bars(text, tmp_path, capsys):
    (tmp_path / "scene.toml").write_text(f'format = 1\nunits = "SI"\n[structure]\n{text}\n')
    assert run("info", tmp_path / "scene.toml", "--output", tmp_path) == 0
    assert "bars          0\n" in capsys.readouterr().out


def test_info_is_of_the_values_of_the_simulation(tmp_path, capsys):
    scene = tc.Scene(
        tc.shapes.prism(prestress=20.0),
        parameters=tc.Parameters("bar_mass", groups={"bar_mass": "all"}),
    )
    heavy = {"bar_mass": 4.0}
    tc.save_scene(tc.Simulation(scene, 0.1, parameters=heavy), tmp_path / "heavy.toml")
    assert run("info", tmp_path / "heavy.toml", "--output", tmp_path) == 0
    told = capsys.readouterr().out
    assert "mass 12 kg in all" in told
    built = tc.Model(replace(scene, parameters=None, structure=scene.structure.replace(**heavy)))
    assert f"largest stable step of RungeKutta4 {tc.stable_step(built, safety=1.0):.3g} s" in told


def test_info_of_the_prism_knows_its_self_stress(tmp_path, capsys):
    run("info", "prism", "--output", tmp_path)
    assert "1 : 1.732" in capsys.readouterr().out


def test_plan(tmp_path, capsys):
    assert run("plan", "prism", "--intervals", 12, "--to-height", 1.1, "--output", tmp_path) == 0
    out = capsys.readouterr().out
    assert float(re.search(r"replay +ends (\S+) m", out)[1]) < 1e-3
    files = written(out)
    assert sorted(files) == sorted(tmp_path.iterdir())
    plan = ocp.Plan.load(files[0])
    assert plan.force_density.shape == (12, 9)
    assert plan.force_density.min() >= 10.0
    end = plan.replay().nodes[-1]
    # from base to top, whatever way the free prism has turned
    assert np.linalg.norm(end[3:].mean(axis=0) - end[:3].mean(axis=0)) == pytest.approx(
        1.1, abs=1e-3
    )


def test_without_intervals_the_way_is_chosen(tmp_path, capsys):
    assert run("plan", "prism", "--to-height", 1.1, "--output", tmp_path) == 0
    assert "chosen: " in capsys.readouterr().out
    assert ocp.Plan.load(tmp_path / "prism-plan.npz").success


def test_tradeoff(tmp_path, capsys):
    options = [
        "--t-end",
        0.1,
        "--steps",
        0.01,
        0.005,
        "--rtol",
        1e-6,
        "--tolerance",
        1e-4,
        "--uncompiled",
    ]
    assert run("tradeoff", "prism", *options, "--output", tmp_path) == 0
    out = capsys.readouterr().out
    assert re.search(r"fastest within 0.0001 m: \w+", out)
    files = written(out)
    assert sorted(files) == sorted(tmp_path.iterdir())
    table = tc.Tradeoff.load(files[0])
    assert len(table.rows) == 2 * (4 * 2 + 1)
    assert {row.step for row in table.rows if row.step > 0} == {0.01, 0.005}
    assert not any(row.compiled for row in table.rows)


def test_tradeoff_without_accurate_run_is_reported_and_written(tmp_path, capsys):
    options = [
        "--t-end",
        0.1,
        "--steps",
        0.02,
        "--rtol",
        1e-4,
        "--tolerance",
        1e-15,
        "--uncompiled",
        "--no-plots",
    ]
    assert run("tradeoff", "pendulum", *options, "--output", tmp_path) == 1
    out = capsys.readouterr().out
    assert "tolerance is 1e-15 m: the " in out
    assert len(tc.Tradeoff.load(written(out)[0]).rows) == 10


@pytest.mark.parametrize("rows", [0, 3])
def test_ctrl_c_in_a_tradeoff_keeps_finished_rows(rows, tmp_path, capsys, monkeypatch):
    module = importlib.import_module("tenscasadi.analysis.tradeoff")
    original, cases = module._measure_rows, []

    def some(case, name, lengths, reference, repeats):
        for row in original(case, name, lengths, reference, repeats):
            if len(cases) == rows:
                raise KeyboardInterrupt
            cases.append(row)
            yield row

    monkeypatch.setattr(module, "_measure_rows", some)
    options = ["--t-end", 0.1, "--steps", 0.02, 0.01, "--tolerance", 1e-3, "--uncompiled"]
    assert run("tradeoff", "prism", *options, "--output", tmp_path) == 130
    out = capsys.readouterr().out
    assert f"interrupted from the keyboard after {rows} of 22 runs" in out
    if rows:
        table = tc.Tradeoff.load(written(out)[0])
        assert (len(table.rows), table.complete) == (3, False)
    else:
        assert not list(tmp_path.iterdir())


def test_single_precision_is_measured_too_when_asked(tmp_path, monkeypatch):
    ways = []

    def asked(*_: object, compiled: object, **__: object) -> None:
        ways.append(compiled)
        raise KeyboardInterrupt

    monkeypatch.setattr("tenscasadi.cli.commands.tradeoff", asked)
    for options in (["--single"], ["--single", "--uncompiled"], []):
        assert run("tradeoff", "pendulum", *options, "--output", tmp_path) == 130
    assert ways == [(None, tc.Single()), (False, tc.Single()), (None,)]


def test_failed_plan_is_reported_and_written(tmp_path, capsys):
    options = ["--intervals", 5, "--duration", 0.02, "--upper", 20, "--lower", 5]
    assert run("plan", "prism", *options, "--output", tmp_path) == 1
    assert "no plan" in capsys.readouterr().out
    assert not ocp.Plan.load(tmp_path / "prism-plan.npz").success


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ([], "COMMAND"),
        (["fly"], "fly"),
        (["completion"], "shell"),
        (["completion", "sh"], "bash"),
        (["simulate"], "NAME|FILE"),
        (["simulate", "cube"], "tower, or a scene file"),
        (["info", "cube"], "six-bar-ball"),
        (["tradeoff", "cube"], "six-bar-ball"),
        (["tradeoff", "prism", "--steps", "0"], "steps[0]"),
        (["tradeoff", "prism", "--steps"], "--steps"),
        (["tradeoff", "prism", "--rtol", "2"], "rtol"),
        (["tradeoff", "prism", "--tolerance", "-1"], "tolerance"),
        (["plan", "cube"], "prism"),
        (["simulate", "prism", "--t-end", "soon"], "t_end"),
        (["simulate", "prism", "--t-end", "nan"], "t_end"),
        (["simulate", "prism", "--t-end", "-1"], "t_end"),
        (["simulate", "prism", "--step", "0"], "step"),
        (["simulate", "prism", "--step", "1e-300"], "step"),
        (["simulate", "prism", "--coordinates", "polar"], "coordinates"),
        (["simulate", "prism", "--gravity", "-9.81"], "gravity"),
        (["simulate", "prism", "--save-every", "0"], "save_every"),
        (["simulate", "prism", "--projection", "0"], "Projection.every"),
        (
            ["simulate", "prism", "--sped", "3"],
            "--sped is no option and no number: did you mean 'speed'",
        ),
        (["simulate", "prism", "extra"], "extra"),
        (["export", "prism", "p.toml", "--height", "3"], "--height"),
        (["simulate", "prism", "--set", "step"], "set is 'step': give KEY=VALUE"),
        (
            ["simulate", "prism", "--set", "numbers.new=3"],
            "--set numbers.new is no option and no number",
        ),
        (["new", "cube"], "six-bar-ball"),
        (["simulate", "gone.toml"], "new prism > gone.toml"),
        (["plan", "gone.toml"], "gone.toml"),
        (["plan", "pendulum"], "[plan]"),
        (["plan", "d-bar", "--bars", "4"], "--bars"),
        (["view", "gone.npz", "--html", "gone.html"], "gone.npz"),
        (["view", "prism", "--html", "page.txt"], ".html"),
        (["view", "prism", "--html", "no/page.html"], "no/page.html"),
        (["export", "prism", "prism.doc"], ".doc"),
        (["plan", "prism", "--bars", "2"], "bars"),
        (["plan", "prism", "--height", "-1"], "height"),
        (["plan", "prism", "--radius", "inf"], "radius"),
        (["plan", "prism", "--to-height", "2"], "to_height"),
        (["plan", "prism", "--to-height", "nan"], "to_height"),
        (["plan", "prism", "--duration", "0"], "duration"),
        (["plan", "prism", "--intervals", "0"], "intervals"),
        (["plan", "prism", "--lower", "20", "--upper", "10"], "lower"),
    ],
)
def test_invalid_input_gives_one_line(arguments, named, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    try:
        code = main(arguments)
    except SystemExit as leaving:  # argparse's way
        code = leaving.code
    told = capsys.readouterr()
    assert code == 2
    assert named in told.err
    assert told.err.startswith("tenscasadi")
    assert told.err.count("\n") == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("command", ["simulate", "tradeoff", "info", "plan", "control"])
def test_output_that_is_a_file_is_rejected_first(command, tmp_path, capsys, monkeypatch):
    for module in ("commands", "plan"):
        monkeypatch.delattr(f"tenscasadi.cli.{module}.find_source")  # nothing is built
    (tmp_path / "file").write_text("")
    for output in ("file", "file/new/folder"):
        assert run(command, "prism", "--output", tmp_path / output) == 2
        assert (
            capsys.readouterr().err
            == f"tenscasadi: output is {tmp_path / output}: {tmp_path / 'file'} is a file, give another folder\n"
        )
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_unwritable_output_is_rejected_first(tmp_path, capsys, monkeypatch):
    tmp_path.chmod(0o500)
    if os.access(tmp_path, os.W_OK):
        pytest.skip("the superuser may write everywhere")
    monkeypatch.delattr("tenscasadi.cli.commands.find_source")
    assert run("simulate", "prism", "--output", tmp_path / "new") == 2
    assert f"{tmp_path} cannot be written to" in capsys.readouterr().err


def test_interrupted(monkeypatch, capsys):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("tenscasadi.cli.commands.find_source", interrupt)
    assert run("info", "prism") == 130
    assert capsys.readouterr().err == "tenscasadi: interrupted\n"


@pytest.mark.parametrize("command", ["new", "simulate", "tradeoff", "info", "plan", "view"])
def test_help_describes_every_template(command, capsys):
    with pytest.raises(SystemExit) as leaving:
        main([command, "--help"])
    assert leaving.value.code == 0
    out = capsys.readouterr().out
    for name in TEMPLATES:
        assert name in out
        assert read_title(name) in out


def test_fields_of_sections_are_options(tmp_path, capsys):
    with pytest.raises(SystemExit):
        main(["simulate", "--help"])
    out = capsys.readouterr().out
    for name in ("t_end", "step", "scheme", "correction", "save_every", "energy_balance"):
        assert f"--{name.replace('_', '-')}" in out
    assert "End of the run [s]." in out  # from the docstring
    options = ["--scheme", "Rattle", "--correction", "{kind = 'Projection', every = 3}"]
    options += ["--t-end", "0.02", "--set", "scene.gravity=[0, 0, '-g']", "--no-plots"]
    assert run("simulate", "prism", "--output", tmp_path, *options) == 2
    assert (
        "--set scene.gravity=[0, 0, '-g'], scene.gravity[2]: 'g' is not" in capsys.readouterr().err
    )
    options[-2] = "scene.gravity=[0, 0, '-9.81 / 6']"
    assert run("simulate", "prism", "--output", tmp_path, *options, "--height", 1.5) == 0
    loaded = tc.Trajectory.load(tmp_path / "prism-simulation.npz")
    assert loaded.scene.gravity == tc.Gravity((0.0, 0.0, -9.81 / 6))
    assert np.ptp(loaded.nodes[0, :, 2]) == pytest.approx(1.5)
    assert {path.name for path in tmp_path.iterdir()} == {"prism-simulation.npz"}


@pytest.mark.parametrize(
    ("command", "names"),
    [
        (["simulate", "prism", "--t-end", "0.02"], {"message", "step", "error_estimate", "files"}),
        (["plan", "reach", "--duration", "0.9"], {"objective", "replay_error", "status", "files"}),
        (["info", "prism"], {"nodes", "fastest_rate", "mass"}),
        (
            ["tradeoff", "pendulum", "--t-end=0.02", "--steps=0.01", "--rtol=1e-3", "--uncompiled"],
            {"rows"},
        ),
    ],
)
def test_json_is_one_object(command, names, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run(*command, "--json", "--no-plots", "-o", "out") == 0
    told = capsys.readouterr()
    found = json.loads(told.out, parse_constant=lambda word: pytest.fail(word))
    assert found["success"] is True
    assert names <= found.keys()
    assert {Path(name).suffix for name in found["files"]} == {".npz"}


def test_json_tells_of_errors(capsys):
    assert run("simulate", "prism", "--t-end", -1, "--json") == 2
    told = capsys.readouterr()
    assert json.loads(told.out) == {
        "success": False,
        "message": "--t-end -1, simulation.t_end: Simulation.t_end is -1: it must be greater than 0",
    }
    assert told.err.startswith("tenscasadi: --t-end -1")


def test_quiet_prints_nothing(tmp_path, capsys):
    assert run("simulate", "pendulum", "--t-end", 0.02, "--quiet", "-o", tmp_path) == 0
    assert capsys.readouterr() == ("", "")
    assert len(list(tmp_path.iterdir())) == 3


def test_info_writes_no_files_unless_asked(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run("info", "prism") == 0
    assert not list(tmp_path.iterdir())


def test_as_a_process(tmp_path):
    command = [
        sys.executable,
        "-m",
        "tenscasadi",
        "simulate",
        "pendulum",
        "--t-end",
        "0.1",
        "--uncompiled",
        "--output",
        str(tmp_path),
    ]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert len(written(done.stdout)) == 3
    refused = subprocess.run(
        [*command[:4], "cube"], capture_output=True, text=True, cwd=ROOT, check=False
    )
    assert refused.returncode == 2
    assert "Traceback" not in refused.stderr


def test_a_reader_that_leaves_is_no_error(tmp_path):
    command = [sys.executable, "-u", "-m", "tenscasadi", "info", "prism", "--output", str(tmp_path)]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == ""
    assert process.returncode == 1


def test_warnings_are_one_line_each(capsys, monkeypatch):
    def warn() -> int:
        """Warn."""
        warnings.warn("two\n  lines", stacklevel=1)
        return 0

    monkeypatch.setitem(COMMANDS, "info", COMMANDS["info"]._replace(run=warn))
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        assert run("info") == 0
    assert capsys.readouterr().err == "tenscasadi: warning: two lines\n"


def test_help_does_not_import_matplotlib():
    code = (
        "import sys; from tenscasadi.cli.main import COMMANDS; "
        "from tenscasadi.cli.parser import command_parser; "
        "command_parser(COMMANDS).format_help(); sys.exit('matplotlib' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False).returncode == 0


def test_version(capsys):
    with pytest.raises(SystemExit, match="0"):
        main(["--version"])
    assert capsys.readouterr().out == f"tenscasadi {tc.__version__}\n"
