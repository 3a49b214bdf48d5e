"""Ctrl-C from outside, in every scheme: the motion up to there is kept, and it comes soon."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

import tenscasadi as tc
from tenscasadi.util.compile import find_compiler

SCHEMES = [
    *(
        tc.RungeKutta4(),
        tc.DormandPrince54(),
        tc.DormandPrince853(),
        tc.Rattle(),
        tc.Collocation(2),
    ),
    *(tc.DormandPrince54(rtol=1e-6), tc.DormandPrince853(rtol=1e-6), tc.Cvodes(), tc.Idas()),
]
COMPILED = [tc.RungeKutta4(), tc.Collocation(2), tc.DormandPrince54(rtol=1e-6)]
needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="no C compiler")

CHILD = """
import signal, sys
import tenscasadi as tc
signal.signal(signal.SIGINT, signal.default_int_handler)
model = tc.Model(tc.Scene(tc.shapes.prism(stiffness=1000.0, prestress=30.0), control=tc.ForceDensity()))

def control(t):
    return model.initial_control

for text in sys.argv[2:]:
    scheme, compiled = eval("tc." + text), sys.argv[1] == "True"
    # makes the code: Ctrl-C during compilation raises KeyboardInterrupt
    tc.simulate(model, 1e6, 0.01, scheme, control=control, compiled=compiled, time_limit=0.01)
    print("begun", flush=True)
    run = tc.simulate(model, 1e6, 0.01, scheme, control=control, compiled=compiled)
    found = run.interrupted and not run.success and run.message.startswith("interrupted from the keyboard")
    print(found, run.time[-1], flush=True)
"""


@pytest.mark.skipif(os.name != "posix", reason="signals")
@pytest.mark.parametrize(
    ("compiled", "schemes"), [(False, SCHEMES), pytest.param(True, COMPILED, marks=needs_compiler)]
)
def test_ctrl_c_keeps_the_motion_up_to_there(compiled: bool, schemes: list[Any]) -> None:
    environment = {**os.environ, "PYTHONPATH": str(Path(tc.__file__).parents[1])}
    command = [sys.executable, "-c", CHILD, str(compiled), *map(repr, schemes)]
    with subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as child:
        assert child.stdout is not None
        for scheme in schemes:
            assert child.stdout.readline() == "begun\n"
            time.sleep(0.2)
            sent = time.monotonic()
            child.send_signal(signal.SIGINT)
            found, last = child.stdout.readline().split()
            assert found == "True"
            assert float(last) > 0.5, (
                scheme
            )  # of the million seconds that were asked for; rows are a thousand seconds apart
            assert time.monotonic() - sent < 10
        assert child.wait(30) == 0
