"""Pages of the API: one for each task, with its public names in the order of the packages' `__all__`."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

from api_tasks import TASKS

ROOT = Path(__file__).resolve().parents[2]
# the packages, and modules that need more to be installed or loaded
PUBLIC = ("tenscasadi", "ocp", "tenscasadi.plots", "tenscasadi.envs", "tenscasadi.viewer")


@cache
def api_pages() -> dict[str, str]:
    """Build the Markdown of the pages by path.

    Raises ValueError for a public name without a task.
    """
    names = _names_by_task()
    pages = {"api/index.md": _overview(names)}
    for path, task in TASKS.items():
        blocks = [f"::: {name}\n" for name in names[path]]
        pages[f"api/{path}.md"] = "\n".join([f"# {task.title}\n", task.text, "", *blocks])
    return pages


def _names_by_task() -> dict[str, list[str]]:
    """Public names, as users write them, by the path of their task."""
    found: dict[str, list[str]] = {path: [] for path in TASKS}
    places = {module: path for path, task in TASKS.items() for module in task.modules.split()}
    for package in PUBLIC:
        for name, place in _exports(package).items():
            parts = place.split(".")
            leading = (".".join(parts[:count]) for count in range(len(parts), 0, -1))
            path = next((places[module] for module in leading if module in places), "")
            if not path:
                raise ValueError(f"{package}.{name} of {place}: give the module a task")
            found[path].append(f"{package}.{name}")
    found["pictures"].append("tenscasadi.animation.animate")
    return found


def _exports(package: str) -> dict[str, str]:
    """Names in `__all__` of a package, and the dotted path of each, without loading it."""
    path = ROOT / package.replace(".", "/") / "__init__.py"
    module = ast.parse(path.read_text(encoding="utf-8"))
    found = {
        alias.asname or alias.name: f"{node.module}.{alias.name}"
        for node in ast.walk(module)  # names that are loaded late stand under TYPE_CHECKING
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    for node in module.body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            return {name: found[name] for name in ast.literal_eval(node.value)}
    return {}


def _overview(names: dict[str, list[str]]) -> str:
    lines = ["# API", "", "Each task has a page with the public names that serve it.", ""]
    lines += ["| task | names |", "|---|---|"]
    for path, task in TASKS.items():
        links = ", ".join(f"[`{name.split('.')[-1]}`][{name}]" for name in names[path])
        lines.append(f"| [{task.title}]({path}.md) | {links} |")
    return "\n".join(lines)
