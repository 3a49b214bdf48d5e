"""Recipes of containers and conda agree with pyproject.toml."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

import ocp
import tenscasadi

ROOT = Path(__file__).resolve().parents[1]
pytestmark = pytest.mark.skipif(
    not (ROOT / "Dockerfile").exists(), reason="source distributions hold no recipes"
)


@pytest.fixture(scope="module")
def project():
    tomllib = pytest.importorskip("tomllib", reason="Python 3.10 reads no TOML")
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def used_extras(text):
    return {name for found in re.findall(r"\.\[([\w,-]+)\]", text) for name in found.split(",")}


def test_conda_recipe_has_the_dependencies_of_the_package(project):
    yaml = pytest.importorskip("yaml", reason="tenscasadi[exchange] is not installed")
    text = (ROOT / "packaging/conda/meta.yaml").read_text(encoding="utf-8")
    recipe = yaml.safe_load(text)
    needed = {name.partition(";")[0] for name in project["dependencies"]}
    given = {
        name.replace(" ", "").replace("matplotlib-base", "matplotlib")
        for name in recipe["requirements"]["run"]
    }
    assert given - {f"python{project['requires-python']}"} == needed
    assert recipe["package"]["version"] == tenscasadi.__version__
    (command,) = recipe["build"]["entry_points"]
    assert command == f"tenscasadi = {project['scripts']['tenscasadi']}"


def test_containers_install_extras_that_exist(project):
    docker = (ROOT / "Dockerfile").read_text(encoding="utf-8")
    container = json.loads((ROOT / ".devcontainer/devcontainer.json").read_text(encoding="utf-8"))
    extras = used_extras(docker), used_extras(container["postCreateCommand"])
    assert extras == ({"all"}, {"test", "docs"})
    assert set().union(*extras) <= set(project["optional-dependencies"])


def test_extra_all_names_extras_of_users(project):
    (combined,) = project["optional-dependencies"]["all"]
    names = set(re.fullmatch(r"tenscasadi\[(.*)\]", combined)[1].split(","))
    assert {"view", "video", "exchange", "gym"} <= names <= set(project["optional-dependencies"])


def test_each_extra_for_users_is_in_the_installation_page(project):
    page = (ROOT / "docs/index.md").read_text(encoding="utf-8")
    developers = {"fmu", "peers", "rockit", "release", "do-mpc"}
    assert set(project["optional-dependencies"]) - developers == used_extras(page)


def test_release_notes_name_old_and_new_names():
    text = (ROOT / "docs/release_notes.md").read_text(encoding="utf-8")
    before, table, after = re.split(r"\| 0\.1 \| 0\.2 \|\n|\n## Changed", text)
    rows = [line.split("|")[1:3] for line in table.splitlines() if "`" in line]
    packages = {"tc": tenscasadi, "ocp": ocp}

    def find_names(text):
        return re.findall(r"`(tc|ocp)\.(\w+)", text)

    now = find_names(before + after) + [pair for _, new in rows for pair in find_names(new)]
    old = [pair for words, _ in rows for pair in find_names(words)]
    assert len(now) > 20
    assert [name for package, name in now if name not in packages[package].__all__] == []
    assert len(old) > 10
    for package, name in old:
        assert name not in packages[package].__all__
        with pytest.warns(DeprecationWarning, match=name):
            assert getattr(packages[package], name) is not None
