"""The command that shows: which things it hands to the viewer, and pages that it writes."""

from __future__ import annotations

import importlib
import sys

import pytest

import tenscasadi as tc
from tenscasadi.cli.main import main


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder with a short motion."""
    monkeypatch.chdir(tmp_path)
    tc.simulate(
        tc.Model(tc.Scene(tc.shapes.prism(prestress=50.0))), 0.05, 0.01, compiled=False
    ).save("run.npz")
    return tmp_path


def test_a_page_is_written(here, capsys):
    pytest.importorskip("viser", reason="the viewer needs viser")
    assert main(["view", "run.npz", "prism", "--html", "page.html"]) == 0
    assert capsys.readouterr().out == "wrote page.html\n"
    text = (here / "page.html").read_text(encoding="utf-8")
    assert "<html" in text[:1000].lower()
    assert {"run", "prism"} <= {word for word in ("run", "prism") if word in text}
    assert {path.name for path in here.iterdir()} == {"run.npz", "page.html"}


def test_options_are_passed_to_the_viewer(here, monkeypatch):
    asked = {}
    monkeypatch.setattr(
        importlib.import_module("tenscasadi.viewer"),
        "view",
        lambda things, **options: asked.update(things=things, **options),
    )
    options = "--port 9000 --no-browser --speed 0.5 --follow --side-by-side --color"
    assert main(["view", "run.npz", "d-bar", *options.split(), "force density"]) == 0
    assert {name: type(thing) for name, thing in asked.pop("things").items()} == {
        "run": tc.Trajectory,
        "d-bar": tc.Scene,
    }
    look = {"color": "force density", "speed": 0.5, "follow": True, "side_by_side": True}
    assert asked == {
        **look,
        "html": None,
        "host": "127.0.0.1",
        "port": 9000,
        "browser": False,
        "wait": True,
    }


def test_live_drives_the_groups_of_the_scene(here, monkeypatch):
    asked = {}
    monkeypatch.setattr(
        importlib.import_module("tenscasadi.viewer"),
        "live",
        lambda model, **options: asked.update(model=model, **options),
    )
    assert main(["view", "reach", "--live", "--save", "live.npz"]) == 0
    assert asked["groups"] == {"guys": [0, 1, 2, 3]}
    assert asked["model"].velocities(asked["state"])[1] == pytest.approx([0, 0.5, 0])
    assert (asked["options"].step, asked["title"], str(asked["save"])) == (
        1e-3,
        "reach",
        "live.npz",
    )


def test_live_takes_the_parameters_of_the_scene(here, monkeypatch):
    asked = {}
    monkeypatch.setattr(
        importlib.import_module("tenscasadi.viewer"),
        "live",
        lambda model, **options: asked.update(options),
    )
    scene = tc.Scene(
        tc.shapes.prism(), parameters=tc.Parameters("bar_mass", groups={"bar_mass": "all"})
    )
    tc.save_scene(tc.Simulation(scene, 0.1, parameters={"bar_mass": 3.0}), "heavy.toml")
    assert main(["view", "heavy.toml", "--live"]) == 0
    assert asked["parameters"] == {"bar_mass": 3.0}


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["view", "prism", "d-bar", "--live"], "live takes one scene"),
        (["view", "prism", "--live", "--html", "page.html"], "writes no page"),
        (["view", "prism", "--save", "live.npz"], "--live"),
        (["view", "prism", "--live", "--save", "gone/live.npz"], "gone"),
        (["view", "prism", "--speed", "0", "--html", "page.html"], "speed"),
        (["view", "run.txt"], "run.txt"),
    ],
)
def test_impossible_view_gives_one_line(arguments, named, here, capsys):
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert named in error
    assert error.count("\n") == 1
    assert [path.name for path in here.iterdir()] == ["run.npz"]


def test_missing_viser_is_named_with_its_install_command(here, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    assert main(["view", "run.npz", "--html", "page.html"]) == 2
    assert "pip install 'tenscasadi[view]'" in capsys.readouterr().err
