"""Other programs, run to their end or ended with all that they have started."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
from collections.abc import Mapping, Sequence


def run_program(command: Sequence[str], seconds: float, environment: Mapping[str, str]) -> subprocess.CompletedProcess[str]:
    """Run a program to its end, and return what it said.

    Raises OSError where it cannot be run, and subprocess.TimeoutExpired where it takes more than `seconds`. Then, and where Ctrl-C ends the
    wait, it is killed with all that it has started: a compiler's own processes would go on, and write where nobody looks any more.
    """
    own_group = os.name == "posix"
    silent, pipe = subprocess.DEVNULL, subprocess.PIPE
    with subprocess.Popen(
        command, stdin=silent, stdout=pipe, stderr=pipe, text=True, errors="replace", env=environment, start_new_session=own_group
    ) as process:
        try:
            out, told = process.communicate(timeout=seconds)
        except BaseException:
            with contextlib.suppress(OSError):  # it has just ended
                os.killpg(process.pid, signal.SIGKILL) if own_group else process.kill()
            raise
    return subprocess.CompletedProcess(command, process.returncode, out, told)
