"""Other programs, run to their end or ended with all that they have started."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor


def run_program(
    command: Sequence[str], seconds: float, environment: Mapping[str, str]
) -> subprocess.CompletedProcess[str]:
    """Run a program to its end, and return what it said.

    Raises OSError where it cannot be run, and subprocess.TimeoutExpired where it takes more than
    `seconds`. Then, and where Ctrl-C ends the wait, it is killed with all that it has started: a
    compiler's own processes would go on, and write where nobody looks any more.
    """
    own_group = os.name == "posix"
    silent, pipe = subprocess.DEVNULL, subprocess.PIPE
    started: list[subprocess.Popen[str]] = []

    def start() -> None:
        started.append(
            subprocess.Popen(
                command,
                stdin=silent,
                stdout=pipe,
                stderr=pipe,
                text=True,
                errors="replace",
                env=environment,
                start_new_session=own_group,
            )
        )

    with (
        ThreadPoolExecutor(1) as starter
    ):  # Ctrl-C reaches the main thread alone, so never between a program's start and its handle
        try:
            starter.submit(start).result()
            out, told = started[0].communicate(timeout=seconds)
        except BaseException:
            starter.shutdown()
            for process in started:
                with contextlib.suppress(OSError):  # it has just ended
                    os.killpg(process.pid, signal.SIGKILL) if own_group else process.kill()
                with process:  # closes what it wrote to, and hears of its end
                    pass
            raise
    return subprocess.CompletedProcess(command, started[0].returncode, out, told)
