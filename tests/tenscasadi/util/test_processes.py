"""Programs that are run: what they say, and that nothing of them is left where they take too long."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tenscasadi.util.processes import run_program


def test_what_it_says_and_how_it_ends() -> None:
    text = "import sys; print(sys.stdin.read() + 'out'); print('err', file=sys.stderr); sys.exit(3)"
    done = run_program([sys.executable, "-c", text], 30.0, os.environ)
    assert (done.stdout, done.stderr, done.returncode) == ("out\n", "err\n", 3)
    with pytest.raises(OSError, match="nowhere"):
        run_program(["/nowhere/at/all"], 30.0, os.environ)


@pytest.mark.skipif(os.name != "posix", reason="process groups")
def test_what_takes_too_long_is_ended_with_what_it_started(tmp_path: Path) -> None:
    witness = tmp_path / "witness"
    began = time.monotonic()
    with pytest.raises(subprocess.TimeoutExpired):
        run_program(
            ["/bin/sh", "-c", f"(while :; do date >> {witness}; sleep 0.05; done) & sleep 100"],
            0.3,
            os.environ,
        )
    assert time.monotonic() - began < 20
    time.sleep(0.2)
    size = witness.stat().st_size
    assert size > 0
    time.sleep(0.3)
    assert witness.stat().st_size == size
