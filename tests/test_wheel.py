"""The release: an sdist, and the wheel that is built from it, checked, installed into fresh environments, and every module imported there."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tarfile
import venv
import zipfile
from pathlib import Path
from typing import NamedTuple

import pytest

import tenscasadi

pytestmark = pytest.mark.slow  # builds both files, installs them

ROOT = Path(__file__).resolve().parents[1]
DATA = {
    path.relative_to(ROOT).as_posix()
    for package in ("tenscasadi", "ocp")
    for ending in ("hpp", "toml", "c")
    for path in (ROOT / package).rglob(f"*.{ending}")
}
FILES = sorted(
    path.relative_to(ROOT)
    for package in ("tenscasadi", "ocp")
    for path in (ROOT / package).rglob("*.py")
)
MARKS = {"tenscasadi/py.typed", "ocp/py.typed"}
BESIDE = (
    "pyproject.toml",
    "MANIFEST.in",
    "README.md",
    "LICENSE",
    "CHANGELOG.md",
    "CITATION.cff",
    "CONTRIBUTING.md",
    "SECURITY.md",
    ".mkdocs.yml",
)
LARGEST, LARGEST_FILE = 4_000_000, 500_000  # bytes of the sdist, and of a file in it

IMPORT = """
import importlib, sys
from importlib.metadata import version
for name in sys.argv[3:]:
    module = importlib.import_module(name)
    assert module.__file__.startswith(sys.argv[1]), f"{name} is loaded from {module.__file__}"
assert version("tenscasadi") == importlib.import_module("tenscasadi").__version__ == sys.argv[2]
"""


class Release(NamedTuple):
    """The two files that would be published."""

    sdist: Path
    wheel: Path


def run(*command: str | Path) -> str:
    """The output of a command, which succeeds and sees nothing of the tests' own environment."""
    environment = {
        name: value for name, value in os.environ.items() if not name.startswith("PYTHON")
    }
    done = subprocess.run(
        list(map(str, command)),
        capture_output=True,
        text=True,
        check=False,
        env=environment,
        cwd=Path(sys.prefix),
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def release(tmp_path_factory: pytest.TempPathFactory) -> Release:
    """Both files, built from a copy of the sources, as building leaves files behind; the wheel from what the sdist holds."""
    pytest.importorskip("build", reason="tenscasadi[release] is not installed")
    source, folder = (tmp_path_factory.mktemp(name) for name in ("source", "dist"))
    for name in BESIDE:
        shutil.copy(ROOT / name, source)
    for name in ("tenscasadi", "ocp", "tests", "examples", "docs"):
        shutil.copytree(
            ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__", "*.so")
        )
    run(sys.executable, "-m", "build", "--outdir", folder, source)
    (sdist,), (wheel,) = folder.glob("*.tar.gz"), folder.glob("*.whl")
    return Release(sdist, wheel)


def held(wheel: Path) -> set[str]:
    with zipfile.ZipFile(wheel) as archive:
        return {name for name in archive.namelist() if ".dist-info/" not in name}


def packed(sdist: Path) -> dict[str, int]:
    """Names and sizes of the files of an sdist, without its folder."""
    with tarfile.open(sdist) as archive:
        return {
            member.name.partition("/")[2]: member.size
            for member in archive.getmembers()
            if member.isfile()
        }


def test_the_wheel_holds_every_module_and_the_marks_of_types(release: Release) -> None:
    data = {name for name in held(release.wheel) if not name.endswith(".py")}
    assert held(release.wheel) - data == {path.as_posix() for path in FILES}
    assert data == DATA | MARKS


def test_the_sdist_holds_what_it_is_built_and_tested_from_and_nothing_large(
    release: Release,
) -> None:
    files = packed(release.sdist)
    kinds = {
        "tests": ("py", "npz", "json"),
        "examples": ("py", "toml"),
        "docs": ("py", "md", "json"),
    }
    beside = {
        path.relative_to(ROOT).as_posix()
        for folder, ends in kinds.items()
        for end in ends
        for path in (ROOT / folder).rglob(f"*.{end}")
    }
    assert set(files) >= {path.as_posix() for path in FILES} | DATA | MARKS | set(BESIDE) | beside
    assert not [
        name
        for name in files
        if re.search(r"__pycache__|\.pyc$|\.png$|\.so$|^\.(?!mkdocs)|/\.", name)
    ]
    assert max(files.values()) < LARGEST_FILE, max(files, key=lambda name: files[name])
    assert release.sdist.stat().st_size < LARGEST


def test_what_is_published_of_them_is_complete(release: Release) -> None:
    pytest.importorskip("twine", reason="tenscasadi[release] is not installed")
    assert (
        run(sys.executable, "-m", "twine", "--no-color", "check", "--strict", *release).count(
            "PASSED"
        )
        == 2
    )


def test_one_place_says_the_version(release: Release) -> None:
    version = tenscasadi.__version__
    assert [path.name for path in release] == [
        f"tenscasadi-{version}.tar.gz",
        f"tenscasadi-{version}-py3-none-any.whl",
    ]
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\n## {version}\n" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("kind", ["wheel", "sdist"])
def test_every_module_is_imported_from_a_fresh_environment(
    release: Release, kind: str, tmp_path: Path
) -> None:
    venv.create(tmp_path, with_pip=False)
    scripts = tmp_path / ("Scripts" if sys.platform == "win32" else "bin")
    python = scripts / Path(sys.executable).name
    packages = Path(
        run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))").strip()
    )
    run(
        sys.executable,
        "-m",
        "pip",
        "--quiet",
        "--python",
        python,
        "install",
        "--no-deps",
        getattr(release, kind),
    )
    (packages / "dependencies.pth").write_text(
        "\n".join(path for path in sys.path if path.endswith("-packages"))
    )  # behind its own
    names = [
        ".".join(path.with_suffix("").parts).removesuffix(".__init__")
        for path in FILES
        if path.name != "__main__.py"
    ]
    run(python, "-I", "-c", IMPORT, packages, tenscasadi.__version__, *names)
    assert "simulate" in run(scripts / "tenscasadi", "--help")
