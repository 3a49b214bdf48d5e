"""The equation of motion against the paper's formulas, term by term, in plain dense NumPy with the corrections that the paper needs."""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import pytest
from comparison import relative
from scenes import PRISM

from tenscasadi.dynamics import forces
from tenscasadi.dynamics.equation_of_motion import compute_forces, forward_dynamics
from tenscasadi.dynamics.mechanism import UNROLL_MEMBERS
from tenscasadi.dynamics.model import Model
from tenscasadi.scene.loads import Gravity
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import ForceDensity
from tenscasadi.structure.structure import Structure

GRAVITY = np.array([1.0, 2.0, -9.0])


class Paper(NamedTuple):
    """The quantities of sections 5 and 6 and Appendices A and B at one state."""

    B: Any
    gamma: Any
    F: Any
    omega: Any
    lam: Any
    acceleration: Any
    reduced_acceleration: Any


def paper(s: Structure, N: Any, V: Any, gamma: Any = None, constant: bool = False) -> Paper:
    """Evaluate the paper at class-one nodes N and velocities V (3×n'); gamma: Eq. 99 where it is None; constant: λ̂ with l² as printed."""
    c = s.class_one()
    C, J = c.C_b @ c.C_nb, s.bar_inertia  # C_b C_nb
    B, Bd, S, Sd = N @ C.T, V @ C.T, N @ c.C_s.T, V @ c.C_s.T  # Eqs. 65, 66
    squared = s.bar_lengths**2 if constant else (B * B).sum(axis=0)
    if gamma is None:
        length = np.linalg.norm(S, axis=0)
        gamma = (
            s.stiffness * (1 - s.rest_length / length)
            + s.damping * (S * Sd).sum(axis=0) / length**2
        )  # Eq. 99
        gamma = np.where((length > s.rest_length) & (gamma > 0), gamma, 0.0)
    W = np.outer(GRAVITY, c.M_s.sum(axis=1))
    pull = S @ np.diag(gamma) @ c.C_s
    inverse = np.linalg.inv(c.M_s)
    joints = c.P.shape[1]
    U, _, _ = np.linalg.svd(c.P)  # Eq. 88
    U1, U2 = U[:, :joints], U[:, joints:]
    E, K = c.P.T @ inverse @ U1, C @ inverse @ U1  # 𝓔 and 𝓓 of Eq. 103
    L = c.P.T @ C.T  # 𝓒
    half = 1 / (2 * squared)
    spin = J / squared * (Bd * Bd).sum(axis=0)
    known = half * (B * ((pull - W) @ C.T)).sum(axis=0) - spin
    A = (W - pull) @ inverse @ U1 + B @ np.diag(known) @ K
    matrix = np.zeros((3 * joints, 3 * joints))
    for i in range(len(squared)):
        b = B[:, [i]]
        matrix += half[i] * np.kron(L[:, [i]].T, np.kron(b, (b @ K[[i]]).T))
    matrix -= np.vstack(
        [np.kron(E.T, np.eye(3)[[axis]]) for axis in range(3)]
    )  # Eᵀ, where the paper prints E
    omega = np.linalg.solve(matrix, A.ravel()).reshape(joints, 3).T  # Eq. 103
    lam = -spin - half * (B * ((W + omega @ c.P.T - pull) @ C.T)).sum(axis=0)  # Eq. 87
    K_s = (
        c.C_s.T @ np.diag(gamma) @ c.C_s - C.T @ np.diag(lam) @ C
    )  # Eq. 86, with C_nb where the paper prints C_bb
    acceleration = (W + omega @ c.P.T - N @ K_s) @ inverse  # Eq. 85
    eta = np.linalg.solve(
        U2.T @ c.M_s @ U2, ((W - N @ K_s) @ U2).T
    ).T  # Eqs. 94-95, η₁ and η₂ put together as N
    return Paper(B, gamma, W - pull, omega, lam, acceleration, eta @ U2.T)


def prism() -> Structure:
    return Structure(**{**PRISM, "bar_radius": 0.1, "damping": 0.5})


def chain() -> Structure:
    """Two chains of bars, one of them pinned, with string nodes between them: every term of the equations is there."""
    nodes = [
        (0, 0, 0),
        (1, 0.3, 0),
        (2, 0, 0.4),
        (0.2, 2, 0),
        (1.1, 2, 0.5),
        (2, 2.2, 0),
        (1, 1, 1.0),
        (0.5, 1, 1.2),
    ]
    strings = [(0, 6), (6, 5), (2, 7), (7, 3), (6, 7), (1, 4), (2, 5)]
    bars = [(0, 1), (1, 2), (3, 4), (4, 5), (1, 4)]
    mass = [0, 0, 0, 0, 0, 0, 0.3, 0.2]
    return Structure(
        nodes,
        bars,
        strings,
        node_mass=mass,
        bar_mass=[1, 2, 3, 1, 2],
        bar_radius=0.05,
        damping=0.3,
        rest_length=0.6,
        pinned=(0,),
    )


def d_bar() -> Structure:
    return Structure(
        [(0, 0, 0), (1, 0.2, 0), (2, 0, 0), (1, -0.8, 0.1)],
        [(0, 1), (1, 2), (2, 3), (3, 0)],
        [(0, 2), (1, 3)],
        pinned=(0,),
    )


def motion_of(model: Model, x: Any, u: Any) -> tuple[Any, ...]:
    """N, V, the sum of forces, what acts on the mass, N̈, λ and Ω as arrays."""
    given = *model.unpack(ca.DM(x))[:2], ca.DM(u), 0
    F, (applied, _) = (
        forces.total(model.scene, model.mechanism, *given),
        compute_forces(model, *given),
    )
    return tuple(
        ca.DM(value).full() for value in (*given[:2], F, applied, *forward_dynamics(model, *given))
    )


@pytest.mark.parametrize("bar_length", ["current", "constant"])
@pytest.mark.parametrize("controlled", [False, True], ids=["elastic", "force densities"])
@pytest.mark.parametrize("structure", [prism, chain, d_bar], ids=lambda make: make.__name__)
def test_every_term_is_that_of_the_paper(structure: Any, controlled: bool, bar_length: Any) -> None:
    rng = np.random.default_rng(11)
    s = structure()
    model = Model(
        Scene(s, control=ForceDensity() if controlled else None, gravity=Gravity(GRAVITY)),
        "full",
        bar_length,
    )
    x = model.initial_state + 0.05 * rng.normal(
        size=model.nx
    )  # bars off their lengths, joints open: l² and bᵀb differ
    u = rng.uniform(1, 30, model.nu)
    N, V, F, applied, A, lam, omega = motion_of(model, x, u)
    expected = paper(s, N, V, u if controlled else None, bar_length == "constant")
    assert relative(model.mechanism.bar_vectors(ca.DM(N)).full(), expected.B) < 1e-15
    assert relative(model.force_density(x, u), expected.gamma) < 1e-13
    assert relative(F, expected.F) < 1e-13
    assert np.array_equal(applied, F)
    assert relative(lam.ravel(), expected.lam) < 1e-9
    assert relative(omega, expected.omega) < 1e-9
    assert relative(A, expected.acceleration) < 1e-9
    if bar_length == "current":
        C_b, P = model.mechanism.C_b.toarray(), model.mechanism.P.toarray()
        assert (
            np.abs(((V @ C_b.T) ** 2).sum(axis=0) + ((N @ C_b.T) * (A @ C_b.T)).sum(axis=0)).max()
            < 1e-8
        )  # Eq. 28
        assert np.abs(A @ P).max(initial=0.0) < 1e-8  # Eq. 84


@pytest.mark.parametrize("structure", [chain, d_bar], ids=lambda make: make.__name__)
def test_reduced_coordinates_are_those_of_equation_95(structure: Any) -> None:
    rng = np.random.default_rng(12)
    s = structure()
    model = Model(Scene(s, gravity=Gravity(GRAVITY)), "reduced")
    columns = s.class_one().physical
    N, V, _, _, A, lam, _ = motion_of(
        model, model.initial_state + 0.05 * rng.normal(size=model.nx), []
    )
    expected = paper(s, N[:, columns], V[:, columns])
    assert relative(A[:, columns], expected.reduced_acceleration) < 1e-9
    assert relative(A[:, columns], expected.acceleration) < 1e-9
    assert relative(lam.ravel(), expected.lam) < 1e-9


@pytest.mark.parametrize("coordinates", ["reduced", "full"])
def test_large_structures_agree_too(coordinates: Any) -> None:
    count = UNROLL_MEMBERS // 2 + 1
    nodes = np.column_stack(
        [np.arange(count + 1.0), 0.2 * (np.arange(count + 1) % 2), np.zeros(count + 1)]
    )
    bars = [(k, k + 1) for k in range(count)]
    s = Structure(
        nodes,
        bars,
        [(k, k + 2) for k in range(count - 1)],
        damping=0.1,
        rest_length=1.5,
        pinned=(0,),
    )
    model = Model(Scene(s, gravity=Gravity(GRAVITY)), coordinates)
    assert model.mechanism.large
    x = model.state(
        nodes, np.vstack([np.zeros(3), 0.1 * np.random.default_rng(13).normal(size=(count, 3))])
    )
    N, V, _, _, A, lam, _ = motion_of(model, x, [])
    columns = s.class_one().physical
    if coordinates == "reduced":
        N, V, A = (Z[:, columns] for Z in (N, V, A))
    expected = paper(s, N, V)
    assert relative(A, expected.acceleration) < 1e-8
    assert relative(lam.ravel(), expected.lam) < 1e-8
