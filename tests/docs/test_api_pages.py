"""The API reference has every public name once, under the task that it serves."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "docs" / "site"))

import api_pages
from api_tasks import TASKS

import ocp
import tenscasadi as tc


def test_each_task_has_a_page():
    pages = api_pages.api_pages()
    assert set(pages) == {"api/index.md", *(f"api/{path}.md" for path in TASKS)}
    for path, task in TASKS.items():
        assert f"[{task.title}]({path}.md)" in pages["api/index.md"]
        assert pages[f"api/{path}.md"].startswith(f"# {task.title}\n")


def test_each_public_name_is_on_one_page():
    text = "\n".join(api_pages.api_pages().values())
    for package in (tc, ocp):
        for name in package.__all__:
            assert text.count(f"::: {package.__name__}.{name}\n") == 1, name


@pytest.mark.parametrize(
    ("name", "task"),
    [
        ("tenscasadi.simulate", "simulation"),
        ("tenscasadi.rollouts", "studies"),
        ("tenscasadi.recommend", "accuracy"),
        ("tenscasadi.to_jax", "learning"),
        ("ocp.AtRest", "problems"),
        ("ocp.solve", "plans"),
        ("ocp.export_mpc", "feedback"),
        ("ocp.export_acados", "feedback"),
        ("ocp.load_problem", "files"),
    ],
)
def test_names_are_on_the_page_of_their_task(name, task):
    assert f"::: {name}\n" in api_pages.api_pages()[f"api/{task}.md"]


def test_names_without_a_task_are_rejected(monkeypatch):
    api_pages.api_pages.cache_clear()
    monkeypatch.delitem(TASKS, "statics")
    with pytest.raises(ValueError, match="give the module a task"):
        api_pages.api_pages()
    monkeypatch.undo()
    api_pages.api_pages.cache_clear()
