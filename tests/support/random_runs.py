"""Random runs against tight references: warnings that are missing, and warnings that are false.

`python -m tests.support.random_runs 700` prints both counts and every such run.
"""

from __future__ import annotations

import sys
import warnings
from collections import Counter
from collections.abc import Iterator
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

import tenscasadi as tc

ROWS = 20  # compared rows of a run
WRONG = 0.01  # × motion: error of a run that must not go without a warning
RIGHT = 0.001  # × motion: error of a run that needs no warning


class Case(NamedTuple):
    """Model with a start, a control and a duration [s]."""

    name: str
    model: tc.Model
    state: np.ndarray
    control: Any
    t_end: float


class Outcome(NamedTuple):
    """Run of a case and its largest error, relative to the motion."""

    case: Case
    options: dict[str, Any]
    run: tc.Trajectory
    error: float

    @property
    def warned(self) -> bool:
        """Whether the run failed or its message holds a warning."""
        return not self.run.success or ";" in self.run.message

    @property
    def silent(self) -> bool:
        """Whether a wrong run goes without a warning."""
        return self.error > WRONG and not self.warned

    @property
    def alarmed(self) -> bool:
        """Whether a right run has a warning."""
        return self.error < RIGHT and self.warned

    def __str__(self) -> str:
        step = self.options.get("step", np.nan)
        return (
            f"{self.case.name}, {self.options['scheme']}, {self.options.get('correction')}, "
            f"step {step:.3g}: error {self.error:.2g}, estimate {self.run.error_estimate:.2g} m, "
            f"success={self.run.success}: {self.run.message}"
        )


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(10 ** rng.uniform(low, high))


def draw_structure(rng: np.random.Generator) -> tuple[str, tc.Structure]:
    kind = str(rng.choice(["prism", "ball", "t_bar", "d_bar", "pendulum", "chain", "tripod"]))
    laws: dict[str, Any] = {"stiffness": log_uniform(rng, 1.5, 4.5)}
    laws["damping"] = float(rng.choice([0.0, 0.0, 1.0])) * log_uniform(rng, -1.0, 1.5)
    prestress = [None, 5.0, 30.0][int(rng.integers(3))]
    laws["stiffness"] = max(laws["stiffness"], 2.0 * (prestress or 0.0))  # above force densities
    if kind == "prism":
        return kind, tc.shapes.prism(int(rng.integers(3, 5)), prestress=prestress, **laws)
    if kind == "ball":
        return kind, tc.shapes.six_bar_ball(prestress=prestress, **laws)
    if kind == "t_bar":
        return kind, tc.shapes.t_bar(prestress=prestress, **laws)
    if kind == "d_bar":
        return kind, tc.shapes.d_bar(prestress=prestress, pinned=[0], **laws)
    if kind == "pendulum":
        return kind, tc.shapes.double_pendulum()
    if kind == "chain":
        count = int(rng.integers(2, 5))
        nodes = np.column_stack([np.arange(count), 0.2 * rng.normal(size=count), np.zeros(count)])
        masses = [0.0, *10 ** rng.uniform(-1, 0.5, count - 1)]
        strings = [(k, k + 1) for k in range(count - 1)]
        lengths = np.linalg.norm(np.diff(nodes, axis=0), axis=1)
        rest = lengths * rng.uniform(0.8, 1.1, count - 1)
        return kind, tc.Structure(
            nodes, strings=strings, node_mass=masses, pinned=[0], rest_length=rest, **laws
        )
    nodes = np.array([(0, 0, 0), (0, 0, 1), (-1, 0, 0), (1, 0, 0.2), (0, 1, 0.0)])
    strings = [(1, 2), (1, 3), (1, 4)]
    lengths = np.linalg.norm([nodes[b] - nodes[a] for a, b in strings], axis=1)
    rest = lengths * rng.uniform(0.85, 1.05, 3)
    return kind, tc.Structure(
        nodes, [(0, 1)], strings, bar_mass=log_uniform(rng, -0.5, 1.0), pinned=[0, 2, 3, 4],
        rest_length=rest, **laws,
    )  # fmt: skip


def draw_force(rng: np.random.Generator, nodes: int) -> tuple[str, Any]:
    size, rate = log_uniform(rng, -1, 1), log_uniform(rng, 0, 2)
    where = np.zeros((nodes, 3))
    where[int(rng.integers(nodes)), int(rng.integers(3))] = size
    kind = str(rng.choice(["chirp", "step", "ramp"]))
    if kind == "chirp":
        return kind, tc.NodalForce(lambda t: ca.sin(rate * t * (1 + t)) * ca.DM(where))
    if kind == "step":
        return kind, tc.NodalForce(lambda t: ca.if_else(t < 3 / rate, 0, 1) * ca.DM(where))
    return kind, tc.NodalForce(lambda t: ca.fmin(rate * t, 1) * ca.DM(where))


def draw_control(rng: np.random.Generator, model: tc.Model) -> tuple[str, Any]:
    usual = np.array(model.initial_control) + 1.0
    rate = log_uniform(rng, 0, 1.5)
    kind = str(rng.choice(["constant", "table", "chirp", "python step"]))
    if kind == "table":
        return kind, usual * rng.uniform(0.6, 1.4, (int(rng.integers(2, 9)), model.nu))
    if kind == "chirp":
        return kind, lambda t: usual * (1 + 0.4 * np.sin(rate * t * (1 + t)))
    if kind == "python step":
        return kind, lambda t: usual * (1.3 if t > 1 / rate else 0.8)
    return kind, usual


def draw_case(seed: int) -> Case:
    """Draw a scene with a start, a control and a duration."""
    rng = np.random.default_rng(seed)
    name, structure = draw_structure(rng)
    options: dict[str, Any] = {}
    if rng.random() < 0.7:
        options["gravity"] = tc.Gravity()
    if rng.random() < 0.3:
        options["ground"] = tc.Ground(
            stiffness=log_uniform(rng, 3, 4.7),
            damping=float(rng.choice([0.0, 1.0])) * log_uniform(rng, 0, 2),
            friction=rng.choice([None, 0.3, 0.8]),
        )
        lowest = structure.nodes[:, 2].min()
        height = rng.uniform(-0.001, 0.1)
        structure = structure.replace(nodes=structure.nodes + [0, 0, height - lowest])
        name += " on ground"
    if rng.random() < 0.25:
        kind, options["forces"] = draw_force(rng, len(structure.nodes))
        name += f", force {kind}"
    driven = rng.random() < 0.3 and len(structure.strings)
    control = None
    model = tc.Model(tc.Scene(structure, control=tc.ForceDensity() if driven else None, **options))
    if driven:
        kind, control = draw_control(rng, model)
        name += f", control {kind}"
    speed = float(rng.choice([0.0, 0.3, 2.0]))
    velocities = speed * rng.normal(size=structure.nodes.shape)
    velocities[sorted(structure.pinned)] = 0.0
    state = model.state(structure.nodes, velocities)
    state = np.asarray(tc.build_projection(model)(state).full()).ravel()
    return Case(f"{seed}: {name}", model, state, control, log_uniform(rng, -0.7, 0.3))


def draw_options(rng: np.random.Generator, case: Case) -> dict[str, Any]:
    """Draw a scheme with a step or a tolerance, and a correction."""
    rtol = log_uniform(rng, -8, -2.5)
    scheme: Any = rng.choice(
        np.array(
            [
                *(tc.RungeKutta4(), tc.DormandPrince54(), tc.DormandPrince853()),
                *(tc.Rattle(), tc.Rattle(order=4), tc.Collocation(2), tc.Collocation(3, "radau")),
                *(tc.DormandPrince54(rtol), tc.DormandPrince853(rtol)),
                *(tc.Cvodes(rtol), tc.Idas(rtol), tc.RungeKutta4(), tc.DormandPrince54(rtol)),
            ],
            dtype=object,
        )
    )
    options: dict[str, Any] = {"scheme": scheme}
    if scheme.adaptive:
        return options | {"step": case.t_end / 100, "save_every": 100 // ROWS}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        limit = tc.stable_step(case.model, case.state, scheme=tc.RungeKutta4())
    count = np.clip(case.t_end / min(limit, 0.02) * log_uniform(rng, -0.5, 1.5), ROWS, 2e4)
    blocks = int(np.ceil(count / ROWS))
    options |= {"step": case.t_end / (ROWS * blocks) * (1 + 1e-12), "save_every": blocks}
    if rng.random() < 0.25 and not scheme.implicit:
        options["correction"] = tc.Projection()
    return options


def solve_tightly(case: Case) -> tc.Trajectory | None:
    """Compute a reference; None without a motion, or if two tolerances do not agree."""
    runs = [
        tc.simulate(
            case.model,
            case.t_end,
            case.t_end / 100,
            tc.DormandPrince853(rtol),
            case.state,
            case.control,
            save_every=100 // ROWS,
            compiled=False,
            verify=False,
            energy_balance=False,
        )
        for rtol in (1e-10, 1e-12)
    ]
    if not all(run.success for run in runs) or np.ptp(runs[1].nodes, axis=0).max() < 1e-6:
        return None  # chaos, or rest
    if measure_error(runs[0], runs[1]) > 1e-5:
        return None
    return runs[1]


def measure_error(run: tc.Trajectory, reference: tc.Trajectory) -> float:
    """Compute the largest distance of a node, relative to the motion."""
    motion = float(np.ptp(reference.nodes, axis=0).max())
    place = np.clip(np.searchsorted(reference.time, run.time), 1, len(reference.time) - 1)
    place -= run.time - reference.time[place - 1] < reference.time[place] - run.time
    common = abs(reference.time[place] - run.time) < 1e-9 * run.time[-1]
    away = np.linalg.norm(run.nodes[common] - reference.nodes[place[common]], axis=2)
    return float(away.max(initial=0.0)) / motion


def check_runs(count: int, seed: int = 0, each: int = 4) -> Iterator[Outcome]:
    """Run `count` cases with known errors, `each` with the same scene."""
    found = 0
    while found < count:
        case, seed = draw_case(seed), seed + 1
        reference = solve_tightly(case)
        if reference is None:
            continue
        rng = np.random.default_rng([seed, 1])
        for _ in range(each):
            options = draw_options(rng, case)
            try:
                run = tc.simulate(
                    case.model, case.t_end, state=case.state, control=case.control,
                    compiled=False, **options,
                )  # fmt: skip
            except ValueError as error:  # such as Idas with redundant constraints
                if "redundant" not in str(error) and "support" not in str(error):
                    raise
                continue
            found += 1
            finished = run.time[-1] > case.t_end * (1 - 1e-9)
            yield Outcome(case, options, run, measure_error(run, reference) if finished else 1.0)


def main() -> None:
    count, seed = (int(given) for given in (sys.argv[1:] + ["700", "0"][len(sys.argv) - 1 :]))
    kinds: Counter[str] = Counter()
    for outcome in check_runs(count, seed):
        kinds["runs"] += 1
        kinds["wrong"] += outcome.error > WRONG
        kinds["warned"] += outcome.warned
        for kind in ("silent", "alarmed"):
            if getattr(outcome, kind):
                kinds[kind] += 1
                print(f"{kind}: {outcome}", flush=True)
        kinds["alarmed below 0.5 %"] += outcome.warned and outcome.error < WRONG / 2
    print(dict(kinds))


if __name__ == "__main__":
    main()
