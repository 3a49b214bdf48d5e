"""Planning problems of sixteen kinds, drawn at random.

Each kind is a function of a seed, so that problems can be held out: nobody looks at those of
`HELD_OUT` and `FRESH` while the planner is tuned. Most goals are states that a simulated motion
under admissible force densities reaches, so that each problem has a plan.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import casadi as ca
import contact_problems
import numpy as np

import ocp
import tenscasadi as tc
from ocp_problems.case import Case
from ocp_problems.shape_changes import EFFORT
from ocp_problems.structures import driven, hub, net, prism, six_bar_ball, spread, tower

# Problems of each kind, by their seeds. Kinds vary with the remainders of a seed by 2, 3 and 4, all of
# which occur among the seeds that are held out.
SEEDS, HELD_OUT, FRESH = range(8), range(12, 16), range(40, 44)

Rng = np.random.Generator
Goals = Sequence[Any]


# --- goals that a simulated motion reaches ---


def wavy_control(rng: Rng, strings: int, lower: float, upper: float, intervals: int = 24) -> Any:
    """Draw smooth force densities (intervals, strings) inside their limits."""
    time = np.linspace(0.0, 1.0, intervals)[:, None]
    level = rng.uniform(0.25, 0.6, strings)
    wave = 0.2 * np.sin(
        2 * np.pi * (rng.uniform(0.3, 1.2, strings) * time + rng.uniform(size=strings))
    )
    return lower + (upper - lower) * np.clip(level + wave, 0.05, 0.9)


def simulated(
    rng: Rng,
    model: tc.Model,
    duration: float,
    limits: tuple[float, float],
    state: Any = None,
) -> tc.Trajectory:
    """Simulate a model under random force densities within limits."""
    control = wavy_control(rng, model.nu, *limits)
    return tc.simulate(
        model,
        duration,
        min(1e-3, duration / 500),
        state=state,
        control=control,
        compiled=False,
        correction=tc.Projection() if len(model.scene.structure.bars) else None,
    )


def end_goals(rng: Rng, model: tc.Model, run: tc.Trajectory) -> Goals:
    """Draw goals that the end of a simulation meets.

    They are positions of some nodes, the lengths of all strings, or the shape.
    """
    structure = model.scene.structure
    count = len(structure.nodes)
    nodes = run.nodes[-1][:count]
    moving = [k for k in range(count) if not structure.fixed[k].all()]
    kind = rng.integers(3)
    if kind == 0 or count > 14:
        chosen = rng.choice(moving, max(1, len(moving) // 2), replace=False)
        places = {
            int(k): tuple(
                None if structure.fixed[k, axis] else float(nodes[k, axis]) for axis in range(3)
            )
            for k in chosen
        }
        return [ocp.NodePositions(places)]
    if kind == 1:
        ends = nodes[structure.strings]
        return [ocp.StringLengths(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1))]
    if len(moving) < count:
        return [ocp.NodePositions({k: tuple(nodes[k]) for k in moving})]
    return [ocp.Shape(nodes)]


def problem(
    model: tc.Model,
    duration: Any,
    goals: Goals,
    limits: tuple[float, float],
    start: Any = None,
    bounds: Sequence[Any] = (),
) -> ocp.Problem:
    """Build a problem of minimum effort with limits of the force densities."""
    own = [ocp.ForceDensityLimits(*limits), *bounds]
    return ocp.Problem(model, duration, start, goals=goals, bounds=own, costs=EFFORT)


def reaching(
    rng: Rng, model: tc.Model, duration: float, limits: tuple[float, float], state: Any = None
) -> ocp.Problem:
    """Build the problem of reaching the final state of a random simulation."""
    run = simulated(rng, model, duration, limits, state)
    return problem(model, duration, end_goals(rng, model, run), limits, state)


# --- structures ---


def hung_mass(rng: Rng, anchors: int, mass: float = 0.5) -> tc.Structure:
    """Build a point mass on strings to pinned nodes around it."""
    around = rng.normal(size=(anchors, 3))
    around /= np.linalg.norm(around, axis=1)[:, None]
    around = np.vstack([around, -around.mean(axis=0) / (np.linalg.norm(around.mean(axis=0)) + 0.1)])
    around = np.vstack([around, [(0, 0, 1.2)]])
    strings = [(0, k) for k in range(1, len(around) + 1)]
    return tc.Structure(
        np.vstack([(0, 0, 0), around]),
        bars=[],
        strings=strings,
        node_mass=mass,
        pinned=range(1, len(around) + 1),
    )


def ring(rng: Rng, count: int) -> tc.Structure:
    """Build a closed loop of hinged bars with two strings from each hinge.

    The strings lead to a ring of pinned nodes.
    """
    angles = 2 * np.pi * (np.arange(count) + rng.uniform(-0.1, 0.1, count)) / count
    inner = 0.4 * np.column_stack([np.cos(angles), np.sin(angles), 0.1 * rng.normal(size=count)])
    around = 2 * np.pi * (np.arange(count) + 0.5) / count
    outer = np.column_stack([np.cos(around), np.sin(around), np.tile([0.4, -0.4], count)[:count]])
    strings = [(k, count + k) for k in range(count)]
    strings += [(k, count + (k - 1) % count) for k in range(count)]
    return tc.Structure(
        np.vstack([inner, outer]),
        [(k, (k + 1) % count) for k in range(count)],
        strings,
        bar_mass=0.3,
        pinned=range(count, 2 * count),
    )


def mast(levels: int, rng: Rng) -> tc.Structure:
    """Build a chain of bars, with three strings at the upper end of each."""
    nodes: list[Any] = [(0.0, 0.0, 0.8 * j) for j in range(levels + 1)]
    strings, turn = [], rng.uniform(0, 1)
    for joint in range(1, levels + 1):
        for angle in 2 * np.pi * np.arange(3) / 3 + turn * joint:
            strings.append((joint, len(nodes)))
            nodes.append((np.cos(angle), np.sin(angle), 0.8 * joint - 0.5))
    pinned = [0, *range(levels + 1, len(nodes))]
    return tc.Structure(nodes, [(j, j + 1) for j in range(levels)], strings, pinned=pinned)


def scaled(structure: tc.Structure, length: float, mass: float) -> tc.Structure:
    """Convert a structure to other units of length and mass."""
    return tc.Structure(
        structure.nodes * length,
        structure.bars,
        structure.strings,
        bar_mass=structure.bar_mass * mass,
        node_mass=structure.node_mass * mass,
        pinned=np.flatnonzero(structure.fixed.all(axis=1)),
    )


# --- kinds ---


def nets(seed: int) -> ocp.Problem:
    """Nets and masses on strings, without bars."""
    rng = np.random.default_rng(seed)
    gravity = tc.Gravity() if seed % 2 else None
    if seed % 4 < 2:
        model = driven(hung_mass(rng, int(rng.integers(3, 7))), gravity=gravity)
        place = tuple(0.35 * rng.uniform(-1, 1, 3))
        goals: Goals = [ocp.NodePositions({0: place}), ocp.AtRest()]
        limits = (0.5, 60.0)
        if seed == 3:
            ball = ocp.Obstacle(tuple(0.5 * x for x in place), 0.08, bars=[], nodes=[0])
            return problem(model, 1.5, goals, limits, bounds=[ball])
        return problem(model, 1.0, goals, limits)
    return reaching(rng, driven(net(int(rng.integers(1, 4))), gravity=gravity), 0.6, (1.0, 60.0))


def planar(seed: int) -> ocp.Problem:
    """Flat structures that move in their plane."""
    rng = np.random.default_rng(100 + seed)
    if seed % 3 == 0:
        structure = tc.shapes.t_bar(rng.uniform(0.6, 1.2), rng.uniform(0.5, 1.0))
    elif seed % 3 == 1:
        pins = [0] if seed % 2 else []
        structure = tc.shapes.d_bar(angle=rng.uniform(0.5, 1.0), pinned=pins)
    else:
        count = int(rng.integers(4, 7))
        angles = 2 * np.pi * np.arange(count) / count
        inner = 0.4 * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(count)])
        strings = [(k, count + j % count) for k in range(count) for j in (k, k + 1)]
        structure = tc.Structure(
            np.vstack([inner, 2.5 * inner]),
            [(k, (k + 1) % count) for k in range(count)],
            strings,
            bar_mass=0.3,
            pinned={
                **dict.fromkeys(range(count), "z"),
                **dict.fromkeys(range(count, 2 * count), "xyz"),
            },
        )
    gravity = tc.Gravity((0.0, -9.81, 0.0)) if seed % 4 == 1 else None
    return reaching(rng, driven(structure, gravity=gravity), 0.6, (2.0, 40.0))


def closed_loops(seed: int) -> ocp.Problem:
    """Closed loops of hinged bars, some in full coordinates."""
    rng = np.random.default_rng(200 + seed)
    scene = tc.Scene(
        ring(rng, int(rng.integers(3, 7))),
        control=tc.ForceDensity(),
        gravity=tc.Gravity() if seed % 2 else None,
    )
    model = tc.Model(scene, coordinates="full" if seed % 4 == 3 else "reduced")
    return reaching(rng, model, 0.6, (2.0, 30.0))


def redundant_bars(seed: int) -> ocp.Problem:
    """Structures with redundant bars, in reduced or full coordinates."""
    rng = np.random.default_rng(300 + seed)
    corners = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], float)
    nodes = np.vstack([0.25 * corners * rng.uniform(0.7, 1.2), corners])
    strings = [(k, 4 + k) for k in range(4)] + [(k, 4 + (k + 1) % 4) for k in range(4)]
    flat = seed % 2 == 0
    pins = {**dict.fromkeys(range(4), "z"), **dict.fromkeys(range(4, 8), "xyz")}
    if not flat:
        nodes[4:, 2] = [0.5, -0.5, 0.5, -0.5]
        pins = dict.fromkeys(range(4, 8), "xyz")
    square = tc.Structure(
        nodes,
        [(0, 1), (1, 2), (2, 3), (3, 0), (0, 2), (1, 3)],
        strings,
        bar_mass=0.2,
        pinned=pins,
    )
    scene = tc.Scene(square, control=tc.ForceDensity())
    model = tc.Model(scene, coordinates="full" if seed % 3 == 0 else "reduced")
    limits = (1.0, 20.0)
    run = simulated(rng, tc.Model(scene), 0.6, limits)
    free = [axis for axis in range(3) if not flat or axis < 2]
    goal = {
        k: tuple(float(run.nodes[-1][k, axis]) if axis in free else None for axis in range(3))
        for k in (0, 2)
    }
    return problem(model, 0.6, [ocp.NodePositions(goal)], limits)


def moving_supports(seed: int) -> ocp.Problem:
    """Supports that move and return, with fixed or free duration."""
    rng = np.random.default_rng(400 + seed)
    size, turns = rng.uniform(0.03, 0.1), int(rng.integers(1, 3))
    axis = int(rng.integers(3))
    structure = prism(int(rng.integers(3, 5)), 1.0, pinned=range(3))
    feet = np.flatnonzero(structure.fixed.all(axis=1)).tolist()

    def move(place: Any) -> Callable[[Any], Any]:
        return lambda t: tuple(
            place[k] + (size * ca.sin(turns * np.pi * t) ** 2 if k == axis else 0.0)
            for k in range(3)
        )

    supports = tc.SupportMotion({k: move(structure.nodes[k]) for k in feet})
    model = driven(structure, supports=supports)
    top = [k for k in range(len(structure.nodes)) if k not in feet]
    if seed % 2:
        goals: list[Any] = [ocp.NodePositions({k: tuple(structure.nodes[k]) for k in top[-2:]})]
    else:
        goals = [ocp.StringLengths(structure.string_lengths)]
    goals += [ocp.AtRest()] if seed % 3 else []
    duration: Any = (1.0, (0.8, 1.4), 1.0, (0.5, 2.0))[seed % 4]
    return problem(model, duration, goals, (1.0, 200.0))


def units(seed: int) -> ocp.Problem:
    """Structures in units of mm and g, µm, or km and t."""
    rng = np.random.default_rng(500 + seed)
    length, mass = ((1e3, 1e3), (1e-3, 1e-3), (1e-3, 1e6), (1e6, 1e9))[seed % 4]
    structure = prism(int(rng.integers(3, 5)), 1.0)
    if seed % 3 == 2:
        structure = tc.shapes.d_bar(angle=rng.uniform(0.6, 1.0), pinned=[0])
    return reaching(rng, driven(scaled(structure, length, mass)), 0.5, (2.0 * mass, 40.0 * mass))


def mass_ratios(seed: int) -> ocp.Problem:
    """Structures with mass ratios of a million."""
    rng = np.random.default_rng(600 + seed)
    structure = prism(int(rng.integers(3, 5)), 1.0, pinned=range(3) if seed % 2 else ())
    masses = 10 ** rng.uniform(-3, 3, len(structure.nodes))
    masses[[-1, -2]] = 1e-3, 1e3
    if seed % 3 == 0:
        structure = structure.replace(bar_mass=10 ** rng.uniform(-3, 3, len(structure.bars)))
    else:
        structure = structure.replace(node_mass=masses)
    limits = (1.0, 400.0)
    duration = 1.0 if seed % 3 else 0.5
    return reaching(rng, driven(structure), duration, limits)


def large_turns(seed: int) -> ocp.Problem:
    """Large rotations of unsupported structures."""
    rng = np.random.default_rng(700 + seed)
    flat = seed % 3 == 0
    if flat:
        structure, axis = tc.shapes.t_bar(0.8, 0.6), np.array([0.0, 0.0, 1.0])
    else:
        structure = prism(int(rng.integers(3, 6)), 0.8) if seed % 3 == 1 else six_bar_ball(1.0)
        axis = rng.normal(size=3)
    axis *= rng.uniform(0.8, 3.2) / np.linalg.norm(axis)
    drift = rng.normal(size=3) * (1.0, 1.0, 0.0 if flat else 1.0)
    model = driven(structure)
    state = np.ravel(
        model.state(structure.nodes, velocities=np.cross(axis, structure.nodes) + 0.3 * drift)
    )
    run = simulated(rng, model, 1.0, (4.0, 40.0), state)
    return problem(model, 1.0, [ocp.NodePositions(run.nodes[-1])], (4.0, 40.0), state)


def swing_ups(seed: int) -> ocp.Problem:
    """Swing-up of hanging bars to the upright position at rest."""
    rng = np.random.default_rng(800 + seed)
    bars = 1 + seed % 2
    nodes: list[Any] = [(0.0, 0.0, -float(k)) for k in range(bars + 1)]
    strings = []
    for joint in range(1, bars + 1):
        for x, y in ((2.0, 0.3), (-2.0, 0.3), (0.0, -2.0)):
            strings.append((joint, len(nodes)))
            nodes.append((x, y, rng.uniform(-0.3, 0.3)))
    pinned = [0, *range(bars + 1, len(nodes))]
    arm = tc.Structure(nodes, [(k, k + 1) for k in range(bars)], strings, pinned=pinned)
    model = driven(arm, gravity=tc.Gravity())
    up = {k: (0.0, 0.0, float(k)) for k in range(1, bars + 1)}
    goals = [ocp.NodePositions({bars: up[bars]}), ocp.AtRest()]
    if seed % 3 == 0:
        goals = [ocp.NodePositions(up)]
    return problem(model, float(rng.uniform(1.0, 2.0)), goals, (0.0, 40.0 * bars))


def standing_chains(seed: int) -> ocp.Problem:
    """Masts of hinged bars, and towers, that stand under gravity and lean over."""
    rng = np.random.default_rng(900 + seed)
    if seed % 4 == 3:
        structure, top = tower(2, 0.65, pinned=range(3)), 6
        x, y, _ = structure.nodes[top]
        goals = [ocp.NodePositions({top: (x + 0.05, y, None)}), ocp.AtRest()]
        model = driven(structure, gravity=tc.Gravity())
        return problem(model, float(rng.uniform(0.7, 2.0)), goals, (15.0, 300.0))
    levels = 1 + seed % 4
    model = driven(mast(levels, rng), gravity=tc.Gravity())
    lean = 0.15 * rng.uniform(-1, 1, 2)
    goals = [ocp.NodePositions({levels: (*lean, None)}), ocp.AtRest()]
    return problem(model, float(rng.uniform(1.0, 4.0)), goals, (1.0, 200.0 * levels))


def stiff_rest_lengths(seed: int) -> ocp.Problem:
    """Rest lengths of stiff strings: other shapes within limits of the winding rate."""
    rng = np.random.default_rng(1000 + seed)
    stiffness = float(10 ** rng.uniform(3, 6))
    bars = int(rng.integers(3, 5))
    options = {"stiffness": stiffness, "damping": 1e-2 * stiffness, "prestress": 20.0}
    low, high = (
        prism(bars, height, 1.2, **options) for height in (0.8, 0.8 + rng.uniform(0.02, 0.06))
    )
    model = tc.Model(tc.Scene(low, control=tc.RestLength()))
    goals = [ocp.StringLengths(high.string_lengths), ocp.AtRest()]
    bounds: list[Any] = [ocp.ForceDensityLimits(lower=2.0)]
    bounds += [ocp.RestLengthRateLimits(0.5)] if seed % 3 else []
    return ocp.Problem(model, 1.0, goals=goals, bounds=bounds, costs=EFFORT)


def free_durations(seed: int) -> ocp.Problem:
    """Free durations, at least effort or at least time."""
    rng = np.random.default_rng(1100 + seed)
    gravity = tc.Gravity() if seed % 4 == 1 else None
    structure = (
        prism(int(rng.integers(3, 5)), 1.0, pinned=range(3) if seed % 2 else ())
        if seed % 3
        else hub(spread(4, 0.3), pinned=[0])
    )
    model = driven(structure, gravity=gravity)
    limits = (2.0, 150.0)
    goals = [*end_goals(rng, model, simulated(rng, model, 0.5, (2.0, 60.0)))]
    span = (float(rng.uniform(0.15, 0.3)), float(rng.uniform(0.8, 1.5)))
    costs = [ocp.Duration(), ocp.Effort(1e-5)] if seed % 2 else EFFORT
    bounds = [ocp.ForceDensityLimits(*limits)]
    return ocp.Problem(model, span, goals=goals, bounds=bounds, costs=costs)


def phases(seed: int) -> ocp.Problem:
    """Jumps of a prism in phases: it stands, and flies to the top."""
    rng = np.random.default_rng(1200 + seed)
    model = contact_problems.low_prism(damping=60.0)
    center = model.structure.nodes.mean(axis=0)
    rise = float(rng.uniform(0.05, 0.3))
    push = ocp.Phase((0.1, 0.6), [0, 1, 2])
    if seed % 3 == 2:  # it lands
        flight = ocp.Phase((0.1, 0.5))
        stance = ocp.Phase((0.2, 0.8), [0, 1, 2], goals=[ocp.AtRest()])
        parts = [push, flight, stance]
        goals: Goals = []
    else:
        top = (None, None, float(center[2] + rise))
        parts = [push, ocp.Phase((0.1, 0.5), goals=[ocp.CenterOfMass(top)])]
        goals = []
    return ocp.Problem(
        model,
        goals=goals,
        phases=parts,
        bounds=[ocp.ForceDensityLimits(5.0, 500.0)],
        costs=[ocp.Prestress(50.0)],
    )


def contact(seed: int) -> ocp.Problem:
    """Jumps and shape changes on a compliant ground."""
    rng = np.random.default_rng(1300 + seed)
    if seed % 3 == 0:
        return contact_problems.prism_jumps(
            float(rng.uniform(0.1, 0.35)), stiffness=float(10 ** rng.uniform(3.7, 4.5))
        )
    if seed % 3 == 1:
        model = contact_problems.low_prism(damping=60.0)
        places = {
            int(k): (None, None, float(model.structure.nodes[k, 2] - rng.uniform(0.03, 0.1)))
            for k in (3, 4, 5)
        }
        return problem(model, 0.8, [ocp.NodePositions(places)], (5.0, 500.0))
    return contact_problems.prism_lands(float(rng.uniform(0.08, 0.2)))


def waypoints(seed: int) -> ocp.Problem:
    """Waypoints with positions and shapes, obstacles, and tension limits."""
    rng = np.random.default_rng(1400 + seed)
    feet = range(3) if seed % 2 else ()
    model = driven(prism(int(rng.integers(3, 5)), 1.0, pinned=feet))
    limits = (2.0, 120.0)
    run = simulated(rng, model, 0.8, (2.0, 60.0))
    half = len(run.time) // 2
    nodes = run.nodes[half]
    way = ocp.Waypoint(
        [ocp.NodePositions({5: tuple(nodes[5])})], share=float(half) / (len(run.time) - 1)
    )
    goals = [way, *end_goals(rng, model, run)]
    bounds: list[Any] = [ocp.TensionLimits(upper=100.0)] if seed % 3 == 0 else []
    return problem(model, 0.8, goals, limits, bounds=bounds)


def caught(seed: int) -> ocp.Problem:
    """Structures in flight whose final state is at rest or has a given shape."""
    rng = np.random.default_rng(1500 + seed)
    structure = prism(3, 0.9) if seed % 2 else six_bar_ball(1.0)
    model = driven(structure, gravity=tc.Gravity() if seed % 3 else None)
    drift, spin = rng.normal(size=3), 0.8 * rng.normal(size=3)
    arms = structure.nodes - structure.nodes.mean(axis=0)
    state = np.ravel(model.state(structure.nodes, velocities=np.cross(spin, arms) + drift))
    limits = (4.0, 60.0)
    run = simulated(rng, model, 0.7, (4.0, 40.0), state)
    ends = run.nodes[-1][structure.strings]
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    goals = [ocp.StringLengths(lengths)] if seed % 4 else [ocp.Shape(run.nodes[-1])]
    return problem(model, 0.7, goals, limits, state)


KINDS: dict[str, Callable[[int], ocp.Problem]] = {
    "net": nets,
    "planar": planar,
    "closed loop": closed_loops,
    "redundant bars": redundant_bars,
    "moving supports": moving_supports,
    "units": units,
    "mass ratio": mass_ratios,
    "large turn": large_turns,
    "swing-up": swing_ups,
    "standing chain": standing_chains,
    "stiff strings": stiff_rest_lengths,
    "free duration": free_durations,
    "phases": phases,
    "contact": contact,
    "waypoint": waypoints,
    "thrown": caught,
}


def wide_cases(seeds: Sequence[int]) -> Iterator[Case]:
    """Problems of all kinds, at the default tolerance of `ocp.solve`."""
    for kind, make in KINDS.items():
        for seed in seeds:
            yield Case(kind, f"{kind} {seed}", lambda make=make, seed=seed: make(seed), np.nan)  # type: ignore[misc]
