"""A term that the scene lacks builds no expression."""

from __future__ import annotations

import casadi as ca
import numpy as np
from scenes import PRISM

from tenscasadi.dynamics.model import Model
from tenscasadi.scene.ground import Ground
from tenscasadi.scene.loads import Gravity, NodalForce, Pressure
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import ForceDensity
from tenscasadi.structure.structure import Structure


class TestOnlyWhatTheSceneHas:
    """A term that the scene lacks builds no expression."""

    def test_each_term_is_listed_exactly_when_present(self) -> None:
        bare = Model(Scene(Structure(**PRISM)))
        full = Model(
            Scene(
                Structure(**{**PRISM, "damping": 1.0}), gravity=Gravity(), ground=Ground(), pressure=Pressure([(0, 1, 2)], 1.0),
                forces=NodalForce(np.ones((6, 3))),
            )
        )  # fmt: skip
        assert set(bare.describe()) == {"string elasticity", "bars (λ) and inverse mass", "total"}
        assert set(full.describe()) - set(bare.describe()) == {
            "string damping",
            "gravity",
            "ground",
            "pressure",
            "nodal forces",
        }
        assert all(count > 0 for count in full.describe().values())
        assert "string damping" in str(full.describe())

    def test_the_right_hand_side_has_no_instruction_of_an_absent_term(self) -> None:
        structure = Structure(**PRISM)
        bare = dynamics_instructions(Scene(structure))
        for richer in (
            Scene(structure, gravity=Gravity()),
            Scene(structure, ground=Ground()),
            Scene(structure.replace(damping=1.0)),
            Scene(structure, pressure=Pressure([(0, 1, 2)], 1.0)),
            Scene(structure, forces=NodalForce(np.ones((6, 3)))),
        ):
            assert dynamics_instructions(richer) > bare
        assert dynamics_instructions(Scene(structure.replace(damping=0.0))) == bare

    def test_one_damped_string_costs_less_than_nine(self) -> None:
        structure = Structure(**PRISM)
        one = np.zeros(9)
        one[4] = 1.0
        assert dynamics_instructions(Scene(structure.replace(damping=one))) < dynamics_instructions(
            Scene(structure.replace(damping=1.0))
        )

    def test_undamped_strings_do_not_depend_on_velocity_and_string_nets_have_no_multipliers(
        self,
    ) -> None:
        net = Structure(
            [(0, 0, 0), (1, 0, 0), (0, 1, 0)],
            strings=[(0, 1), (1, 2), (2, 0)],
            node_mass=1.0,
            rest_length=0.9,
        )
        model = Model(Scene(net))
        pattern = np.array(ca.DM(model.ode.jac_sparsity(0, 0), 1).full())
        assert not pattern[model.nq :, model.nq :].any()
        assert "inverse mass" in model.describe()
        assert not any("λ" in term or "Ω" in term for term in model.describe())
        division = [
            k for k in range(model.ode.n_instructions()) if model.ode.instruction_id(k) == ca.OP_DIV
        ]
        assert len(division) == 3  # one ρ/s for each string, none for multipliers

    def test_force_densities_build_no_string_law(self) -> None:
        model = Model(Scene(Structure(**PRISM), control=ForceDensity()))
        kinds = {model.ode.instruction_id(k) for k in range(model.ode.n_instructions())}
        assert ca.OP_SQRT not in kinds
        assert ca.OP_LT not in kinds

    def test_joints_build_omega_in_full_coordinates_only(self) -> None:
        chain = Structure([(0, 0, 0), (1, 0, 0), (1, 1, 0)], [(0, 1), (1, 2)])
        assert any("Ω" in term for term in Model(Scene(chain), "full").describe())
        assert not any("Ω" in term for term in Model(Scene(chain)).describe())
        apart = Structure([(0, 0, 0), (1, 0, 0), (1, 1, 0), (2, 2, 0)], [(0, 1), (2, 3)])
        assert not any("Ω" in term for term in Model(Scene(apart), "full").describe())


def dynamics_instructions(scene: Scene) -> int:
    """Instructions of the right-hand side."""
    return int(Model(scene).ode.n_instructions())
