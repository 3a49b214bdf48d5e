"""Names of nodes, bars and strings in place of indices, in all public values and functions."""

from __future__ import annotations

import numpy as np
import pytest

import ocp
import tenscasadi as tc
from tenscasadi import plots
from tenscasadi.viewer import LiveSimulation
from tenscasadi.viewer.live_mode.sliders import choose_sliders

NODES = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (0, 1, 1)]
BARS = [(0, 4), (1, 5), (2, 3)]
STRINGS = [(0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5)]
PRISM = tc.Structure(
    NODES,
    BARS,
    STRINGS,
    bar_radius=0.01,
    node_names=["base a", "base b", "base c", "tip", "", ""],
    bar_names=["mast", "spar", "boom"],
    string_names=[*(f"guy[{k}]" for k in range(3)), *("" for _ in range(5)), "stay"],
)
CIRCLE = lambda t: (0.1 * np.sin(t), 0.0, 1.0)  # noqa: E731  a function of time


def scene(structure=PRISM, **fields):
    return tc.Scene(structure, **fields)


def model(**fields):
    return tc.Model(scene(control=tc.ForceDensity(), **fields))


def problem(*goals, bounds=(), **fields):
    time = {} if "phases" in fields else {"duration": 1.0}
    return ocp.Problem(model(ground=GROUND), goals=goals, bounds=bounds, **time, **fields)


def limited(bound):
    (found,) = problem(bounds=[bound]).bounds
    return found


def wanted(goal):
    (found,) = problem(goal).goals
    return found


def live():
    return LiveSimulation(model())


def grabbed(node):
    simulation = live()
    simulation.grab(node, (0, 0, 2))
    return simulation.pull.node


def controlled(string):
    simulation = live()
    simulation.set_control([string], 7.0)
    return simulation.control


def labels(figure):
    texts = [text.get_text() for ax in figure.axes for text in ax.texts]
    return [*texts, *(ax.get_ylabel() for ax in figure.axes)]


GROUND = tc.Ground(friction=0.5)
ON_GROUND = {"tip": "base c", 3: 2}

# each place: a function of (nodes by name or index, bar, string), and the result for indices
VALUES = {
    "Structure.bars": lambda n, b, s: PRISM.replace(bars=[(n, 4), (1, 5), (2, 0)]).bars,
    "Structure.strings": lambda n, b, s: (
        tc.Structure(NODES, BARS, [(n, 4)], node_names=PRISM.node_names).strings
    ),
    "Structure.pinned": lambda n, b, s: PRISM.replace(pinned=[n]).pinned,
    "Structure.pinned axes": lambda n, b, s: PRISM.replace(pinned={n: "xz"}).pinned,
    "Structure.rollers": lambda n, b, s: PRISM.replace(rollers={n: (1, 0, 1)}).rollers,
    "Structure.cables": lambda n, b, s: PRISM.replace(cables=[[s, 5]]).cables,
    "Structure.bodies": lambda n, b, s: PRISM.replace(bodies=[tc.RigidBody([n, 4], 1.0)]).bodies,
    "Structure.prestressed": lambda n, b, s: PRISM.prestressed(
        np.where(np.arange(9) == 8, -1.0, 1.0), compression_strings=[s]
    ).rest_length,
    "equilibrium_force_density": lambda n, b, s: tc.equilibrium_force_density(
        tc.shapes.prism().replace(string_names=PRISM.string_names), compression_strings=[s]
    ),
    "form_find lengths": lambda n, b, s: tc.form_find(PRISM, lengths={s: 1.1}).structure.nodes,
    "form_find positions": lambda n, b, s: tc.form_find(
        PRISM, positions={n: (0, 0, None)}
    ).structure.nodes,
    "form_find groups": lambda n, b, s: tc.form_find(PRISM, groups=[[s, 7]]).force_density,
    "form_find bars": lambda n, b, s: tc.form_find(PRISM, groups=[[b if b != 2 else 11, 9]]).bar_force,
    "form_find equal_tension": lambda n, b, s: tc.form_find(
        PRISM, equal_tension=[[s, 7]]
    ).force_density,
    "find_prestress groups": lambda n, b, s: tc.find_prestress(PRISM, groups=[[s, 7]]).tension,
    "Ground.nodes": lambda n, b, s: scene(ground=tc.Ground(nodes=[n])).ground.nodes,
    "Ground.bars": lambda n, b, s: scene(ground=tc.Ground(bars=[b])).ground.bars,
    "Terrain.nodes": lambda n, b, s: (
        scene(ground=[tc.Terrain([[0, 0], [0, 0]], (0, 0), (1, 1), nodes=[n])]).ground.nodes
    ),
    "Pressure.faces": lambda n, b, s: scene(pressure=tc.Pressure([(0, 1, n)], 1.0)).pressure.faces,
    "NodalForce.bars": lambda n, b, s: (
        scene(forces=tc.NodalForce(np.ones((6, 3)), bars={n: b})).forces.bars
    ),
    "SupportMotion.positions": lambda n, b, s: list(
        scene(PRISM.replace(pinned=[n]), supports=tc.SupportMotion({n: CIRCLE})).supports.nodes
    ),
    "Scene.slack": lambda n, b, s: scene(slack={s: tc.Linear()}).slack,
    "Breaking.force": lambda n, b, s: scene(strength=tc.Breaking({s: 5.0})).strength.force,
    "Yielding.force": lambda n, b, s: scene(strength=tc.Yielding({s: 5.0}, 1.0)).strength.force,
    "BarContact.pairs": lambda n, b, s: (
        scene(bar_contact=tc.BarContact([(0, b)])).bar_contact.pairs
    ),
    "Parameters.groups": lambda n, b, s: scene(
        parameters=tc.Parameters(
            "stiffness", "bar_mass", "node_mass",
            groups={"stiffness": [[s]], "bar_mass": [[0, b]], "node_mass": [[n]]},
        )
    ).parameters.groups,
    "NodePositions": lambda n, b, s: wanted(ocp.NodePositions({n: (0, None, 1)})).positions,
    "NodeVelocities": lambda n, b, s: wanted(ocp.NodeVelocities({n: (0, None, 1)})).velocities,
    "StringLengths": lambda n, b, s: wanted(ocp.StringLengths({s: 0.9})).lengths,
    "BarOrientation": lambda n, b, s: wanted(ocp.BarOrientation(b, (0, 0, 1))).bar,
    "NodeTripleOrientation": lambda n, b, s: (
        wanted(ocp.NodeTripleOrientation([n, 1, 2], (0, 0, 0.1))).nodes
    ),
    "Waypoint": lambda n, b, s: (
        wanted(ocp.Waypoint([ocp.NodePositions({n: (0, 0, 1)})], share=0.5)).goals[0].positions
    ),
    "Goal.soft": lambda n, b, s: (
        problem(ocp.NodePositions({n: (0, 0, 1)}).soft(2.0)).costs[-1].goal.positions
    ),
    "FreeStart.goals": lambda n, b, s: (
        problem(start=ocp.FreeStart(goals=[ocp.NodePositions({n: (0, 0, 1)})]))
        .start.goals[0].positions
    ),
    "AboveGround.nodes": lambda n, b, s: limited(ocp.AboveGround(-1.0, nodes=[n])).nodes,
    "AboveSurface.nodes": lambda n, b, s: limited(ocp.AboveSurface(GROUND, nodes=[n])).nodes,
    "InsideBox.nodes": lambda n, b, s: (
        limited(ocp.InsideBox(upper=(None, None, 2), nodes=[n])).nodes
    ),
    "NodeAccelerationLimits.nodes": lambda n, b, s: (
        limited(ocp.NodeAccelerationLimits(9.0, nodes=[n])).nodes
    ),
    "BarClearance.pairs": lambda n, b, s: limited(ocp.BarClearance(0.01, [(0, b)])).pairs,
    "Obstacle": lambda n, b, s: [
        getattr(limited(ocp.Obstacle((9, 9, 9), 1.0, bars=[b], nodes=[n])), field)
        for field in ("bars", "nodes")
    ],
    "Phase.contact_nodes": lambda n, b, s: (
        problem(phases=[ocp.Phase(0.5, contact_nodes=[0, ON_GROUND.get(n, n)])]).phases[0].contact_nodes
    ),
    "Phase.goals": lambda n, b, s: (
        problem(phases=[ocp.Phase(0.5, goals=[ocp.NodePositions({n: (0, 0, 1)})])])
        .phases[0].goals[0].positions
    ),
    "Tracking.positions": lambda n, b, s: (
        problem(costs=[ocp.Tracking({n: (0, 0, 1)})]).costs[0].positions
    ),
    "LiveSimulation.grab": lambda n, b, s: grabbed(n),
    "LiveSimulation.set_control": lambda n, b, s: controlled(s),
    "Live groups": lambda n, b, s: [
        slider.strings for slider in choose_sliders(live(), {"own": [s, 7]})
    ],
    "Rollouts.path": lambda n, b, s: (
        tc.rollouts(model(), 0.01, 0.01, controls=np.ones((1, 9))).path(n)
    ),
    "plots.fan": lambda n, b, s: labels(
        plots.fan(tc.rollouts(model(), 0.02, 0.01, controls=np.ones((2, 9)), save_every=1), n)
    ),
    "plots.node_histories": lambda n, b, s: labels(plots.node_histories(RUN, nodes=[n, 4])),
    "plots.phase_portrait": lambda n, b, s: labels(plots.phase_portrait(RUN, nodes=[n, 4])),
    "plots.tensions": lambda n, b, s: labels(plots.tensions(RUN, strings=[s, 4])),
    "plots.force_densities": lambda n, b, s: labels(plots.force_densities(RUN, strings=[s, 4])),
}  # fmt: skip
RUN = tc.simulate(model(), 0.02, step=0.01, control=np.ones(9), compiled=False)


def same(one, other):
    """Whether two results are equal, arrays or nested values."""
    if isinstance(one, np.ndarray):
        return np.array_equal(one, other)
    return repr(one) == repr(other)


@pytest.mark.parametrize("place", VALUES)
def test_a_name_gives_the_result_of_its_index(place):
    assert same(VALUES[place]("tip", "boom", "stay"), VALUES[place](3, 2, 8))


@pytest.mark.parametrize("place", VALUES)
def test_an_unknown_name_is_rejected_with_the_nearest(place):
    with pytest.raises(ValueError, match=r"which is not there: did you mean '(tip|boom|stay)'"):
        VALUES[place]("tpi", "bom", "sty")


def test_messages_of_statics_name_members():
    loads = np.zeros((6, 3))
    loads[3] = (0, 0, 1e3)
    with pytest.raises(tc.EquilibriumError, match=r"most at node 3 .*\(node 3: tip\)"):
        tc.equilibrium_force_density(PRISM.replace(nodes=NODES, pinned=[0, 1, 2, 4, 5]), loads)
    line = {"nodes": [(0, 0, 0), (2, 0, 0), (1, 0, 0)], "strings": [(0, 2), (2, 1)]}
    net = tc.Structure(**line, node_mass=1.0, pinned=[0, 1], string_names=["left", "right"])
    form = tc.form_find(net, lengths={"left": 0.5, "right": 0.5})
    assert form.message.endswith("(string 0: left)")
