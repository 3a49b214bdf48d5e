"""The wheel holds all of both packages: built, installed into a fresh environment, and every module imported from there."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
HEADERS = {path.relative_to(ROOT).as_posix() for path in (ROOT / "tenscasadi").rglob("*.hpp")}
FILES = sorted(path.relative_to(ROOT) for package in ("tenscasadi", "ocp") for path in (ROOT / package).rglob("*.py"))

IMPORT = """
import importlib, sys
for name in sys.argv[2:]:
    module = importlib.import_module(name)
    assert module.__file__.startswith(sys.argv[1]), f"{name} is loaded from {module.__file__}"
"""


def run(*command: str | Path) -> str:
    """The output of a command, which succeeds and sees nothing of the tests' own environment."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True, check=False, env=environment, cwd=Path(sys.prefix))
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, built from a copy of the sources, as building leaves files behind."""
    source, folder = (tmp_path_factory.mktemp(name) for name in ("source", "wheel"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    for package in ("tenscasadi", "ocp"):
        shutil.copytree(ROOT / package, source / package, ignore=shutil.ignore_patterns("__pycache__"))
    run(sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", folder, source)
    (found,) = folder.glob("tenscasadi-*.whl")
    return found


def test_it_holds_every_module_and_the_marks_of_types(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = {name for name in archive.namelist() if ".dist-info/" not in name}
    assert names == {path.as_posix() for path in FILES} | HEADERS | {"tenscasadi/py.typed", "ocp/py.typed"}


def test_every_module_is_imported_from_a_fresh_environment(wheel: Path, tmp_path: Path) -> None:
    venv.create(tmp_path, with_pip=False)
    scripts = tmp_path / ("Scripts" if sys.platform == "win32" else "bin")
    python = scripts / Path(sys.executable).name
    packages = Path(run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))").strip())
    run(sys.executable, "-m", "pip", "--quiet", "--python", python, "install", "--no-deps", "--no-index", wheel)
    (packages / "dependencies.pth").write_text("\n".join(path for path in sys.path if path.endswith("-packages")))  # behind its own
    names = [".".join(path.with_suffix("").parts).removesuffix(".__init__") for path in FILES if path.name != "__main__.py"]
    run(python, "-I", "-c", IMPORT, packages, *names)
    assert "simulate" in run(scripts / "tenscasadi", "--help")
