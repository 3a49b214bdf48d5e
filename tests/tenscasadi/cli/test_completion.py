"""The shell's completion, asked of the shell itself."""

from __future__ import annotations

import shutil
import subprocess
import sys

import pytest

from tenscasadi.cli.main import main
from tenscasadi.cli.source import TEMPLATES

BASH = shutil.which("bash")


@pytest.fixture
def script(capsys):
    """The script for bash."""
    pytest.importorskip("shtab", reason="completion needs shtab")
    assert main(["completion", "bash"]) == 0
    return capsys.readouterr().out


@pytest.mark.skipif(BASH is None, reason="there is no bash")
@pytest.mark.parametrize(
    ("typed", "wanted"),
    [
        (["sim"], {"simulate"}),
        (["simulate", "d"], {"d-bar", "double-pendulum", "drop.toml"}),
        (["info", "pr"], {"prism"}),
        (["new", "six"], {"six-bar-ball"}),
        (["simulate", "prism", "--grav"], {"--gravity"}),
        (["completion", ""], {"bash", "zsh"}),
    ],
)
def test_bash_completes(typed, wanted, script, tmp_path):
    for name in ("drop.toml", "drop.txt"):
        (tmp_path / name).write_text("")
    words = " ".join(f"'{word}'" for word in ("tenscasadi", *typed))
    asked = f"COMP_WORDS=({words}); COMP_CWORD={len(typed)}; _shtab_tenscasadi; printf '%s\\n' \"${{COMPREPLY[@]}}\""
    done = subprocess.run(
        [BASH, "-c", f"{script}\n{asked}"], capture_output=True, text=True, cwd=tmp_path, check=True
    )
    assert wanted <= set(done.stdout.split())
    assert "drop.txt" not in done.stdout


def test_zsh_gets_a_script_with_all_shapes(capsys):
    pytest.importorskip("shtab", reason="completion needs shtab")
    assert main(["completion", "zsh"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("#compdef tenscasadi")
    assert " ".join(TEMPLATES) in out


def test_missing_shtab_is_named_with_its_install_command(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "shtab", None)
    assert main(["completion", "bash"]) == 2
    assert (
        capsys.readouterr().err
        == "tenscasadi: completion needs shtab: pip install 'tenscasadi[completion]'\n"
    )
