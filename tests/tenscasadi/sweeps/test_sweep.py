"""Sweeps: what fails or dies takes nothing along, what has finished is never computed again, and Ctrl-C loses nothing."""

from __future__ import annotations

import functools
import multiprocessing
import os
import re
import subprocess
import sys
import threading
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path

import jobs
import numpy as np
import pytest

import tenscasadi as tc
from tenscasadi.util.compile import find_compiler


@pytest.fixture
def one_thread():
    with ThreadPoolExecutor(1) as executor:
        yield executor


# --- processes of this machine ---


def test_sweep_outlives_exceptions_and_dead_workers(monkeypatch):
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "7")
    cases = [{"x": x} for x in (3, "raise", 4.5, "die", -2, "odd", 7, "interrupt", lambda t: t)]
    table = tc.sweep(jobs.square, cases)
    assert table.success.tolist() == [True, False, True, False, True, False, True, False, False]
    assert table["square"][table.success].tolist() == [9.0, 20.25, 4.0, 49.0]
    assert os.getpid() not in table["process"]
    assert set(table["threads"][table.success].ravel()) == {"1"}
    raised, died, odd, interrupted, unsent = (table.errors[k] for k in (1, 3, 5, 7, 8))
    assert raised.endswith("ZeroDivisionError: on purpose\n")
    assert "jobs.py" in raised
    assert "worker process died" in died
    assert "result 'model' is of type object: return numbers, text, or arrays" in odd
    assert interrupted.endswith("KeyboardInterrupt\n")
    assert re.search(
        r"case\['x'\] is <function .*, which other processes cannot get: give numbers, text and arrays",
        unsent,
    )
    assert table.message == "9 cases: 9 computed, 5 failed"


def test_ctrl_c_keeps_finished_cases(tmp_path, keyboard):
    table = tc.sweep(
        jobs.interrupt, [{"number": k, "folder": str(tmp_path)} for k in range(6)], folder=tmp_path
    )
    assert table.interrupted
    assert table.message.endswith("interrupted from the keyboard")
    assert table.success[:2].any()
    assert not table.success[2]
    assert set(table.errors) == {""}
    assert len(list(tmp_path.iterdir())) == table.success.sum()


@pytest.mark.skipif(find_compiler() is None, reason="no C compiler")
def test_processes_share_compiled_code(tmp_path, monkeypatch):
    monkeypatch.setenv("TENSCASADI_CACHE", str(tmp_path / "cache"))
    (tmp_path / "begun").mkdir()
    count = min(2, len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 1)
    cases = [{"folder": str(tmp_path / "begun"), "number": k, "of": count} for k in range(count)]
    table = tc.sweep(jobs.vibrate, cases)
    assert table.success.all(), table.errors
    assert len(set(table["process"])) == count
    here = tc.simulate(
        tc.Model(tc.Scene(tc.shapes.prism(stiffness=321.0))), 0.1, 1e-3, compiled=True
    ).nodes[-1]
    for nodes in table["nodes"]:
        np.testing.assert_array_equal(nodes, here)
    left = sorted(path.name.partition("-")[0] for path in (tmp_path / "cache").iterdir())
    assert left == ["engine", "model"]  # one library each, and no folder of a compilation


def test_functions_that_processes_cannot_import():
    with pytest.raises(ValueError, match=r"other processes cannot import .*top level of a module"):
        tc.sweep(lambda case: case, [1])


def test_script_without_main_guard_is_rejected(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "import tenscasadi as tc\n\n\ndef job(case):\n    return case\n\n\ntc.sweep(job, [1, 2])\n"
    )
    done = subprocess.run(
        [sys.executable, str(script)], capture_output=True, text=True, check=False, timeout=120
    )
    assert done.returncode
    assert "RuntimeError: worker processes cannot begin" in done.stderr
    assert "a script needs `if __name__ == '__main__':`" in done.stderr


@pytest.mark.skipif(
    not Path("/proc/self/stat").exists(), reason="no /proc, which tells the processes that live"
)
def test_workers_end_with_a_sweep_that_is_killed(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "import jobs\nimport tenscasadi as tc\n\nif __name__ == '__main__':\n    tc.sweep(jobs.slow, range(1000), folder='results')\n"
    )
    paths = os.pathsep.join([str(Path(jobs.__file__).parent), str(Path(tc.__file__).parents[1])])
    killed = subprocess.Popen(
        [sys.executable, str(script)], cwd=tmp_path, env={**os.environ, "PYTHONPATH": paths}
    )
    wait_for(lambda: len(list((tmp_path / "results").glob("*.npz"))) > 2)
    killed.kill()
    killed.wait()
    workers = {int(np.load(path)["value.process"]) for path in (tmp_path / "results").glob("*.npz")}
    wait_for(lambda: not any(map(lives, workers)))


def wait_for(condition, seconds=60.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def lives(process):
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except FileNotFoundError:
        return False


# --- folder ---


def test_restart_computes_missing_cases_only(tmp_path, one_thread):
    computed, broken = [], {2}

    def job(case):
        computed.append(case["x"])
        if case["x"] in broken:
            raise ValueError("not yet")
        return {
            "text": f"<{case['x']}>",
            "vector": np.arange(3) * case["x"],
            "whole": case["x"],
            "flag": case["x"] > 1,
        }

    cases = [{"x": x} for x in range(4)]
    first = tc.sweep(job, cases, one_thread, tmp_path)
    assert first.success.tolist() == [True, True, False, True]
    broken.clear()
    again = tc.sweep(job, [*cases, {"x": 4}, {"x": 0}], one_thread, tmp_path)
    assert computed == [0, 1, 2, 3, 2, 4]
    assert again.success.all()
    assert again.message == f"6 cases: 2 computed, 3 read from {tmp_path}"
    assert again["text"].tolist() == ["<0>", "<1>", "<2>", "<3>", "<4>", "<0>"]
    assert again["vector"].tolist() == [[0, x, 2 * x] for x in (0, 1, 2, 3, 4, 0)]
    assert [again[name].dtype.kind for name in ("text", "vector", "whole", "flag")] == [
        "U",
        "i",
        "i",
        "b",
    ]
    np.testing.assert_array_equal(again.seconds[[0, 1, 3]], first.seconds[[0, 1, 3]])


def test_each_case_is_on_disk_at_once(tmp_path):
    """A case waits for the file of the one before."""

    def job(case):
        for _ in range(1000):
            if len(list(tmp_path.glob("*.npz"))) == case:
                return case
            time.sleep(0.005)
        raise TimeoutError

    with ThreadPoolExecutor(1) as executor:
        assert tc.sweep(job, range(3), executor, tmp_path).success.all()


def test_files_that_are_damaged_are_computed_again(tmp_path, one_thread):
    def job(case):
        return 2 * case

    tc.sweep(job, [1, 2, 3], one_thread, tmp_path)
    damaged = sorted(tmp_path.iterdir())[1]
    damaged.write_bytes(damaged.read_bytes()[:100])
    table = tc.sweep(job, [1, 2, 3], one_thread, tmp_path)
    assert table["result"].tolist() == [2, 4, 6]
    assert table.message.endswith(
        f"1 computed, 2 read from {tmp_path}; 1 files could not be read, their cases were computed again"
    )


def test_results_of_an_older_function_are_reported(tmp_path, one_thread):
    for text in ("return 1", "return 2"):
        space: dict = {}
        path = tmp_path / "module.py"
        path.write_text(f"def job(case):\n    {text}\n")
        import linecache

        linecache.checkcache(str(path))
        exec(compile(path.read_text(), str(path), "exec"), space)  # noqa: S102
        table = tc.sweep(space["job"], [0], one_thread, tmp_path / "results")
    assert table["result"].tolist() == [1]
    assert "1 results are of an older text of job: take a new folder" in table.message


def test_folder_of_another_script_is_rejected(tmp_path, one_thread):
    """Functions of one name and of other text: one is an older version of the other only in the same script."""
    found = []
    for module, text in (
        ("first", "return 1"),
        ("packed.first", "return 1.5"),
        ("second", "return 2"),
        ("second", "return 1"),
    ):
        job = defined(tmp_path / f"{module}-{len(found)}.py", text, module)
        try:
            found.append(tc.sweep(job, [0], one_thread, tmp_path / "results")["result"].tolist())
        except ValueError as error:
            found.append(str(error))
    assert found == [
        [1],
        [1],
        f"folder {tmp_path / 'results'} holds results of job of first, not of second: give each its own folder",
        [1],
    ]


def defined(path, text, module):
    space: dict = {"__name__": module}
    path.write_text(f"def job(case):\n    {text}\n")
    exec(compile(path.read_text(), str(path), "exec"), space)  # noqa: S102
    return space["job"]


class Times:
    def __init__(self, factor):
        self.factor = factor

    def __call__(self, case):
        return self.factor * case

    method = __call__


def scaled(case, factor):
    return factor * case


def closure_of(factor):
    return lambda case: factor * case


@pytest.mark.parametrize(
    "make",
    [
        lambda k: functools.partial(scaled, factor=k),
        lambda k: functools.partial(functools.partial(scaled), factor=k),
        Times,
        lambda k: Times(k).method,
        closure_of,
        lambda k: lambda case, factor=k: factor * case,
    ],
    ids=["partial", "partial of a partial", "object", "method", "closure", "default"],
)
def test_content_of_a_function_identifies_its_results(tmp_path, one_thread, make):
    for k, read in ((2, 0), (3, 0), (2, 2)):
        table = tc.sweep(make(k), [1, 10], one_thread, tmp_path)
        assert table["result"].tolist() == [k, 10 * k]
        assert table.message == f"2 cases: {2 - read} computed, {read} read from {tmp_path}"


def test_function_without_identity_is_rejected_with_a_folder(tmp_path, one_thread):
    with pytest.raises(
        TypeError, match=r"function\['keywords'\]\['factor'\] is <object .*: give numbers, text"
    ):
        tc.sweep(functools.partial(scaled, factor=object()), [1], one_thread, tmp_path)


def test_ctrl_c_before_anything_is_done_gives_a_table(keyboard):
    asked = threading.Event()

    def job(case):
        if not asked.is_set():
            asked.set()
            os.kill(os.getpid(), 2)
        return case

    with ThreadPoolExecutor(1) as executor:
        table = tc.sweep(job, range(2000), executor)
    assert table.interrupted
    assert table.success.sum() < 2000


# --- arguments ---


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((3, [1]), "function is 3: give a function"),
        ((abs, {"k": 1}), "cases is {'k': 1}: give a list"),
        ((abs, 5), "cases is 5: give a list"),
        ((abs, [1], "dask"), "executor is 'dask': give a concurrent.futures.Executor"),
        ((abs, [1], None, 7), "folder is 7: give a file or folder"),
    ],
)
def test_wrong_arguments(arguments, message):
    with pytest.raises(TypeError, match=message):
        tc.sweep(*arguments)


def test_cases_without_identity_are_rejected_before_computing(tmp_path, one_thread):
    with pytest.raises(
        TypeError, match=r"cases\[1\]\['f'\] is <function .*: give numbers, text, arrays"
    ):
        tc.sweep(pytest.fail, [{"f": 1}, {"f": lambda t: t}], one_thread, tmp_path)


def test_nothing_to_do(tmp_path):
    table = tc.sweep(jobs.square, [], folder=tmp_path)
    assert (len(table), table.message) == (0, f"0 cases: 0 computed, 0 read from {tmp_path}")
    assert table.to_csv() == "case_seconds,case_error\n"


def test_progress_is_shown(capsys, one_thread):
    tc.sweep(abs, [-1, -2], one_thread, progress=True)
    assert "2/2" in capsys.readouterr().err


@pytest.mark.slow
def test_next_sweep_computes_the_cases_of_a_broken_pool(tmp_path):
    cases = [{"x": x} for x in (1, 2, "die", *range(5, 25))]
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as executor:
        first = tc.sweep(jobs.square, cases, executor, tmp_path)
        refused = tc.sweep(
            jobs.square, cases, executor, tmp_path
        )  # the pool takes nothing any more
    assert first.success[:2].all()
    assert not first.success[2:].any()
    assert "no result came back: BrokenProcessPool" in first.errors[-1]
    assert refused.message.startswith("23 cases: 21 computed, 21 failed, 2 read")
    again = tc.sweep(jobs.square, cases, folder=tmp_path)
    assert again.success.tolist() == [k != 2 for k in range(23)]


# --- a cluster ---


@pytest.mark.slow
def test_dask_goes_on_without_a_worker_that_is_killed(tmp_path):
    distributed = pytest.importorskip(
        "distributed", reason="distributed is not installed: pip install 'tenscasadi[cluster]'"
    )
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=None
        ) as cluster,
        distributed.Client(cluster) as client,
        client.get_executor() as executor,
    ):
        workers = list(client.run(os.getpid).values())
        assert len(workers) == 2

        def kill() -> None:
            while len(list(tmp_path.glob("*.npz"))) < 3:
                time.sleep(0.01)
            os.kill(workers[0], 9)

        killer = threading.Thread(target=kill)
        killer.start()
        table = tc.sweep(jobs.slow, [float(x) for x in range(12)], executor, tmp_path)
        killer.join()
        odd = tc.sweep(
            jobs.square, [{"x": "interrupt"}, {"x": threading.Lock()}, {"x": 3}], executor
        )
        with pytest.raises(
            ValueError, match=r"function is .*, which other processes cannot import"
        ):
            tc.sweep(functools.partial(scaled, factor=threading.Lock()), [1], executor)
    assert table.success.all(), table.errors
    assert odd.success.tolist() == [False, False, True]
    assert odd.errors[0].endswith("KeyboardInterrupt\n")
    assert "case['x'] is <unlocked _thread.lock object" in odd.errors[1]
    assert table["double"].tolist() == [2.0 * x for x in range(12)]
    assert set(workers) & set(table["process"])
    assert os.getpid() not in table["process"]
    assert tc.sweep(
        jobs.slow, [float(x) for x in range(12)], folder=Path(tmp_path)
    ).message.startswith("12 cases: 0 computed, 12 read")


SBATCH = """#!/bin/sh
cp "$1" "{folder}/job.sh"
setsid sh "{folder}/job.sh" > "{folder}/job.log" 2>&1 < /dev/null &
echo $! > "{folder}/job.pid"
echo "Submitted batch job 1"
"""
SCANCEL = """#!/bin/sh
kill -- -$(cat "{folder}/job.pid")
"""


@pytest.mark.slow
@pytest.mark.skipif(
    sys.platform != "linux", reason="the scripts in place of SLURM's commands need setsid"
)
def test_slurm_computes_by_jobs_that_dask_jobqueue_submits(tmp_path, monkeypatch):
    """Scripts stand in for SLURM's commands; what they run is what SLURM would run."""
    jobqueue = pytest.importorskip(
        "dask_jobqueue", reason="dask-jobqueue is not installed: pip install 'tenscasadi[cluster]'"
    )
    from distributed import Client

    for name, text in (("sbatch", SBATCH), ("scancel", SCANCEL)):
        (tmp_path / name).write_text(text.format(folder=tmp_path))
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    paths = os.pathsep.join([str(Path(jobs.__file__).parent), str(Path(tc.__file__).parents[1])])
    options = {
        "queue": "normal",
        "cores": 2,
        "processes": 2,
        "memory": "2GB",
        "walltime": "02:00:00",
        "local_directory": str(tmp_path),
    }
    options |= {
        "job_script_prologue": [f"export PYTHONPATH={paths}", "export OMP_NUM_THREADS=1"],
        "scheduler_options": {"dashboard_address": None},
    }
    with jobqueue.SLURMCluster(**options) as cluster:
        script = cluster.job_script()
        cluster.scale(jobs=1)
        with Client(cluster) as client:
            table = tc.sweep(
                jobs.slow, [float(x) for x in range(8)], client.get_executor(), tmp_path / "results"
            )
    for line in (
        "#SBATCH -p normal",
        "#SBATCH --cpus-per-task=2",
        "#SBATCH -t 02:00:00",
        "export OMP_NUM_THREADS=1",
    ):
        assert line in script.splitlines()
    assert "--nthreads 1 " in script
    assert "--nworkers 2 " in script
    assert table["double"].tolist() == [2.0 * x for x in range(8)], (
        table.errors,
        (tmp_path / "job.log").read_text(),
    )
    assert 1 <= len(set(table["process"]) - {os.getpid()}) <= 2
    assert len(list((tmp_path / "results").glob("*.npz"))) == 8
