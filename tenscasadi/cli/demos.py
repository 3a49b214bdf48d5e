"""One ready-made scene for each shape of the command line: a structure in equilibrium and a start that sets it in motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.stabilization import projection
from tenscasadi.scene.loads import Gravity
from tenscasadi.scene.scene import Scene
from tenscasadi.structure import shapes
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import Array, positive_number


@dataclass(frozen=True)
class Demo:
    """Shape and how it is set in motion: `text` for people, gravity in m/s² downwards, `t_end` in s, `velocities` of the nodes in m/s."""

    text: str
    structure: Callable[[], Structure]
    t_end: float
    gravity: float = 0.0
    velocities: Callable[[Structure], Array] | None = None

    def scene(self, gravity: float | None = None) -> Scene:
        """Return the structure under gravity, m/s² downwards (None: the demo's own; 0 builds no gravity). Raises TypeError, ValueError."""
        g = self.gravity if gravity is None else positive_number("gravity", gravity, zero=True)
        return Scene(self.structure(), gravity=Gravity((0.0, 0.0, -g)) if g else None)

    def start(self, model: Model) -> Array:
        """Return the state that the motion starts from: the structure's nodes, and the velocities nearest to the demo's that keep bar lengths."""
        if self.velocities is None:
            return model.initial_state
        state = model.state(model.structure.nodes, self.velocities(model.scene.structure))
        return np.asarray(projection(model)(state).full()).ravel()


def _spin(structure: Structure, rates: tuple[float, float, float], about: Array) -> Array:
    return np.asarray(np.cross(rates, structure.nodes - about))


def _wring(structure: Structure) -> Array:
    """Turn upper and lower half against each other about the z axis."""
    middle = structure.nodes.mean(axis=0)
    return np.asarray(_spin(structure, (0.0, 0.0, 4.0), middle) * np.sign(structure.nodes[:, 2:] - middle[2]))


def _throw(structure: Structure) -> Array:
    return np.array([3.0, 0.0, 5.0]) + _spin(structure, (1.0, 3.0, 0.5), structure.nodes.mean(axis=0))


def _swing(structure: Structure) -> Array:
    return _spin(structure, (0.0, 0.0, 3.0), structure.nodes[0])


DEMOS = MappingProxyType(
    {
        "pendulum": Demo(
            "one bar of 1 m and 1 kg, released from rest 135° from hanging down, under gravity",
            lambda: shapes.pendulum(angle=0.75 * np.pi),
            t_end=3.0,
            gravity=9.81,
        ),
        "double-pendulum": Demo(
            "two bars of 1 m and 1 kg, released from rest 90° and 120° from hanging down, under gravity",
            lambda: shapes.double_pendulum(angles=(np.pi / 2, 2 * np.pi / 3)),
            t_end=3.0,
            gravity=9.81,
        ),
        "prism": Demo(
            "three bars, nine strings of 1000 N/m with force densities of 50 and 87 N/m; top and bottom start turning against each other at 4 rad/s",
            lambda: shapes.prism(prestress=50.0, stiffness=1000.0, damping=2.0),
            t_end=2.0,
            velocities=_wring,
        ),
        "d-bar": Demo(
            "four bars in a diamond pinned at node 0, two strings of 1000 N/m with 50 N/m; swings about the pin at 3 rad/s",
            lambda: shapes.d_bar(prestress=50.0, stiffness=1000.0, damping=2.0, pinned=[0]),
            t_end=2.0,
            velocities=_swing,
        ),
        "six-bar-ball": Demo(
            "six bars of 1 m and 1 kg, 24 strings of 1000 N/m with 50 N/m; thrown at 3 m/s along x and 5 m/s up, tumbling, under gravity",
            lambda: shapes.six_bar_ball(prestress=50.0, stiffness=1000.0, damping=2.0),
            t_end=1.0,
            gravity=9.81,
            velocities=_throw,
        ),
    }
)


def demo(name: str) -> Demo:
    """Return the demo of that name. Raises ValueError that lists the known ones."""
    if name not in DEMOS:
        raise ValueError(f"unknown shape {name!r}: give one of {', '.join(DEMOS)}")
    return DEMOS[name]
