"""Export and import: files of other tools by their endings."""

from __future__ import annotations

import numpy as np
import pytest
from public_calls import table

import tenscasadi as tc
from tenscasadi.cli.main import main
from tenscasadi.cli.source import find_source


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder with a short motion."""
    monkeypatch.chdir(tmp_path)
    tc.simulate(tc.Model(find_source("prism").scene()), 0.02, 0.01, compiled=False).save("run.npz")
    return tmp_path


@pytest.mark.filterwarnings("ignore:out.yaml differs")
@pytest.mark.parametrize("ending", ["xml", "mat", "yaml", "toml", "json"])
def test_scenes_go_out_and_come_back(ending, here, capsys):
    assert main(["export", "prism", f"out.{ending}"]) == 0
    assert capsys.readouterr().out == f"wrote out.{ending}\n"
    back = f"out.{ending}"
    if ending in ("xml", "mat", "yaml"):
        assert main(["import", back, "back.toml"]) == 0
        back = "back.toml"
    ours, theirs = find_source("prism").scene().structure, tc.load_scene(back).structure
    assert theirs.nodes == pytest.approx(ours.nodes, abs=1e-9)
    assert {frozenset(bar) for bar in theirs.bars.tolist()} == {
        frozenset(bar) for bar in ours.bars.tolist()
    }
    assert np.sort(theirs.stiffness) == pytest.approx(np.sort(ours.stiffness))


def test_a_scene_file_is_not_written_over_itself(here, capsys):
    assert main(["new", "prism"]) == 0
    text = capsys.readouterr().out
    (here / "p.toml").write_text(text)
    assert main(["export", "p.toml", "./p.toml"]) == 2
    assert "OUT is p.toml, the file that is read: give another" in capsys.readouterr().err
    assert (here / "p.toml").read_text() == text


def test_export_lists_sections_left_out(here, capsys):
    assert main(["export", "prism", "out.toml"]) == 0
    assert capsys.readouterr().err == "tenscasadi: left out: [start], [simulation], [plan]\n"
    assert main(["export", "pendulum", "out.mat"]) == 0
    assert capsys.readouterr().err == "tenscasadi: left out: [scene], [simulation]\n"
    assert main(["export", "out.toml", "out.xml"]) == 0
    assert capsys.readouterr().err == ""
    assert main(["export", "mpc", "mpc.toml"]) == 0
    left = "[plan], [refinement], [robustness], [closed_loop]"
    assert capsys.readouterr().err == f"tenscasadi: left out: {left}\n"


def test_imported_scene_is_simulated_with_t_end(here, capsys):
    assert main(["export", "prism", "out.mat"]) == 0
    assert main(["import", "out.mat", "back.toml"]) == 0
    assert main(["simulate", "back.toml", "--t-end", "0.01", "--uncompiled"]) == 0
    assert tc.Trajectory.load("back-simulation.npz").time[-1] == pytest.approx(0.01)
    assert main(["simulate", "back.toml"]) == 2
    assert "it has no [simulation]: give one with t_end" in capsys.readouterr().err
    assert main(["simulate", "back.toml", "--t-end", "-1"]) == 2
    assert "t_end" in capsys.readouterr().err


def test_motions_go_out(here):
    pytest.importorskip("meshio", reason="ParaView's files need meshio")
    for name in ("run.csv", "run.mat", "run.pvd", "run.glb"):
        assert main(["export", "run.npz", name]) == 0
        assert (here / name).exists()
    assert np.loadtxt("run.csv", delimiter=",", skiprows=1)[:, 0] == pytest.approx(
        [0.0, 0.01, 0.02]
    )
    assert tc.load_mat_trajectory("run.mat").time == pytest.approx([0.0, 0.01, 0.02])


def test_nodes_of_a_net_carry_the_mass_of_strings(here):
    net = tc.Structure(
        np.eye(4, 3), [], [(0, 1), (1, 2), (1, 3)], string_mass=0.2, pinned=[0, 2, 3]
    )
    tc.save_mat(net, "net.mat")
    assert main(["import", "net.mat", "net.toml"]) == 0
    assert tc.Model(tc.load_scene("net.toml")).structure.node_mass[1] == pytest.approx(0.3)


@pytest.mark.filterwarnings("default")
def test_ntrt_comes_in(here, capsys):
    pytest.importorskip("yaml", reason="files of NTRT need PyYAML")
    text = "nodes: {a: [0, 0, 0], b: [0, 10, 0], c: [5, 0, 0], d: [5, 10, 0]}\npair_groups: {rod: [[a, b], [c, d]], string: [[a, c], [b, d]]}\n"
    (here / "two.yaml").write_text(text)
    assert main(["import", "two.yaml", "two.toml", "--length-unit", "0.1"]) == 0
    assert tc.load_scene("two.toml").structure.bar_lengths.tolist() == [1.0, 1.0]
    (here / "joined.yaml").write_text(
        text.replace("[c, d]]", "[b, d]]")
        .replace("[[a, c], [b, d]]", "[[a, d]]")
        .replace("c: [5, 0, 0], ", "")
    )
    assert main(["import", "joined.yaml", "welded.toml", "--no-ball-joints"]) == 0
    assert len(tc.load_scene("welded.toml").structure.bodies) == 1
    capsys.readouterr()
    assert main(["import", "joined.yaml", "joined.toml", "--ball-joints"]) == 0
    assert "warning: joined.yaml was imported with 1 change" in capsys.readouterr().err


@pytest.mark.filterwarnings("default")
def test_lenient_import_leaves_out_unknown_entries(here, capsys):
    pytest.importorskip("yaml", reason="files of NTRT need PyYAML")
    text = "nodes: {a: [0, 0, 0], b: [0, 10, 0]}\npair_groups: {rod: [[a, b]], ball: [[a, b]]}\n"
    (here / "boxed.yaml").write_text(text)
    assert main(["import", "boxed.yaml", "boxed.toml"]) == 2
    assert main(["import", "boxed.yaml", "boxed.toml", "--lenient"]) == 0
    assert "line 2, ball: has the tags ball, which no builder fits" in capsys.readouterr().err
    assert len(tc.load_scene("boxed.toml").structure.bars) == 1


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (
            ["export", "prism", "out.csv"],
            "out.csv does not end as the files of scenes do: give one of .glb, .json, .mat, .toml, .xml",
        ),
        (["export", "run.npz", "out.xml"], "give one of .csv, .glb, .mat, .pvd"),
        (["export", "gone.npz", "out.csv"], "gone.npz"),
        (["export", "other.npz", "out.csv"], "other.npz is no trajectory, rollouts or plan"),
        (
            ["export", "table.npz", "out.csv"],
            "table.npz is no trajectory, rollouts or plan: it holds a tradeoff",
        ),
        (["export", "prism", "folder/out.xml"], "there is no folder folder"),
        (["import", "gone.mat", "out.toml"], "tenscasadi: gone.mat: No such file"),
        (["import", "run.npz", "out.toml"], "give one of .mat, .xml, .yaml, .yml"),
        (["import", "gone.mat", "out.txt"], "give one of .json, .toml"),
    ],
)
def test_impossible_exchange_gives_one_line(arguments, named, here, capsys):
    np.savez("other.npz", x=np.ones(2))
    table().save("table.npz")
    before = sorted(here.iterdir())
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert named in error
    assert error.count("\n") == 1
    assert sorted(here.iterdir()) == before
