"""The command `analyse`: report, pictures, files of other programs."""

from __future__ import annotations

import pytest

import tenscasadi as tc
from tenscasadi.cli.main import main


def test_a_shape_is_analyzed(tmp_path, capsys):
    assert main(["analyse", "prism", "--output", str(tmp_path)]) == 0
    told = capsys.readouterr().out
    assert "self-stresses 1" in told
    assert "frequencies" in told
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["prism-analysis-forces.png", "prism-analysis-modes.png"]
    assert all(path.stat().st_size > 5000 for path in tmp_path.iterdir())


def test_a_matlab_file_is_prestressed_and_analyzed(tmp_path, capsys):
    tc.save_mat(tc.shapes.prism(stiffness=1e5, bar_radius=0.01), tmp_path / "prism.mat")
    order = [
        "analyse",
        str(tmp_path / "prism.mat"),
        "--prestress",
        "250",
        "--output",
        str(tmp_path),
    ]
    assert main([*order, "--modulus", "2e11", "--strength", "2.35e8"]) == 0
    told = capsys.readouterr().out
    assert "tensions      250 …" in told
    assert "utilization   " in told
    assert "at most, in" in told


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (
            ["prism", "--modulus", "2e11"],
            "strength is missing: give modulus and strength, or neither",
        ),
        (["prism", "--prestress", "-3"], "prestress is -3: it must be greater than 0"),
        (["double-pendulum", "--prestress", "3"], "the structure has no self-stress"),
        (["nothing.mat"], "nothing.mat: No such file"),
    ],
)
def test_wrong_input_gives_one_line(options, told, tmp_path, capsys):
    assert main(["analyse", *options, "--output", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert told in error
    assert len(error.splitlines()) == 1
