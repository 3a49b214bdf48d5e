"""Corrections of constraint drift, and their effect on a run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np
import scipy.sparse as sp

from tenscasadi.dynamics.base_model import check_model
from tenscasadi.dynamics.constraint_forces import (
    project_velocities,
    remove_residuals,
    residuals,
    stretch_bars,
)
from tenscasadi.schema.value import Value
from tenscasadi.util.casadi_tools import sparse, symbol_kind
from tenscasadi.util.validate import Count, Positive, instance

if TYPE_CHECKING:
    from tenscasadi.dynamics.mechanism import Mechanism
    from tenscasadi.dynamics.model import Model


class Correction(Value):
    """Base class of corrections of bar lengths and joints during a run."""

    every: int

    def step(self, model: Model) -> ca.Function | None:
        """Build one correction of a model's state.

        Parameters
        ----------
        model : Model
            Model with the bars and joints.

        Returns
        -------
        casadi.Function or None
            Function (x) → corrected x, both (nx,), or (x, p) with parameters. None without
            constraints.

        Raises
        ------
        TypeError
            If `model` is no Model.
        ValueError
            If a `BarLengthCorrection` has bars that share nodes or are pinned in reduced
            coordinates.
        """
        check_model(model)
        return self._build(model) if model.mechanism.constrained else None

    def _build(self, model: Model) -> ca.Function:
        raise NotImplementedError


@dataclass(frozen=True)
class Projection(Correction, kind="Projection"):
    """Projection of a state onto the constraints of bars and joints.

    It is the smallest displacement in the norm of the mass matrix. It conserves linear and angular
    momentum; energy changes slightly. Unlike `BarLengthCorrection`, it handles closed loops of bars
    and string nodes.

    Parameters
    ----------
    every : int
        Number of steps between corrections.
    iterations : int
        Newton's iterations for positions of bars that share nodes. Other bars have a closed form.

    Raises
    ------
    TypeError, ValueError
        If an option is no whole number of 1 or more.

    See Also
    --------
    projection : The same for a single state.

    Notes
    -----
    Newton's method finds positions with ½(bᵀb − l²) = 0 and N P = D. One linear system gives
    velocities with bᵀḃ = 0 and Ṅ P = Ḋ.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.double_pendulum(), gravity=tc.Gravity((0, -9.81, 0))))
    >>> run = tc.simulate(model, 0.5, step=0.01, correction=tc.Projection(), compiled=False)
    >>> bool(run.bar_length_error.max() < 1e-14)
    True
    """

    every: Count = 1
    iterations: Count = 3

    def _build(self, model: Model) -> ca.Function:
        return build_projection(model, self.iterations)


@dataclass(frozen=True)
class BarLengthCorrection(Correction, kind="BarLengthCorrection"):
    """Correction of each bar, then of joints (Appendix C).

    Bars are corrected one by one in length and rate. In closed loops of bars, a joint error of
    about half the bar error remains, because the existence condition (Eq. 143) does not hold. Use
    `Projection` there.

    Parameters
    ----------
    weight : float
        Weight q of positions relative to velocities [1/s²].
    every : int
        Number of steps between corrections.

    Raises
    ------
    TypeError, ValueError
        If `weight` is not positive, or `every` no whole number of 1 or more.

    Notes
    -----
    The changes p of a bar vector and r of its rate minimize q‖p‖² + ‖r‖² (Eq. 119). Newton's method
    finds the largest root of Eq. 121 from q l ‖b‖, also for bars that do not turn. Joints then
    close by movements of centers of mass and string nodes (Eqs. 134-149).

    Examples
    --------
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.prism()))
    >>> run = tc.simulate(model, 0.1, step=0.01, correction=tc.BarLengthCorrection(), compiled=False)
    >>> bool(run.bar_length_error.max() < 1e-14)
    True
    """

    weight: Positive = 1.0
    every: Count = 1

    def _build(self, model: Model) -> ca.Function:
        if model.mechanism.system_size and not model.mechanism.joints:
            other = "" if model.scene.structure.bodies else 'Model(coordinates="full") or '
            raise ValueError(
                "BarLengthCorrection moves bars one by one, these meet or are pinned: "
                f"use {other}Projection"
            )
        return _appendix_c(model, self.weight)


def check_correction(correction: Any, field: str = "correction") -> None:
    """Raise TypeError unless `correction` is a correction or None.

    The message names `field`.
    """
    if correction is not None:
        instance(
            field,
            correction,
            (Projection, BarLengthCorrection),
            "Projection(every), BarLengthCorrection(weight) or None",
        )


def build_projection(model: Model, iterations: int = 3) -> ca.Function:
    """Build the projection of a state onto bars and joints.

    It makes a consistent start for `simulate`.

    Parameters
    ----------
    model : Model
        Model with the bars and joints.
    iterations : int
        Newton's iterations for positions of bars that share nodes.

    Returns
    -------
    casadi.Function
        Function (x) → projected x, both (nx,), or (x, p) with parameters.

    Raises
    ------
    TypeError
        If `model` is no Model.

    See Also
    --------
    Projection : The same after the steps of a run.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.prism()))
    >>> start = tc.build_projection(model)(model.state(1.1 * model.structure.nodes))
    >>> model.bar_length_error(start.full().ravel()) < 1e-14
    True
    """
    check_model(model)
    key = "projection", iterations if model.mechanism.system_size else 1
    return model.keep(key, lambda: _projection(model, key[1]))


def _projection(model: Model, iterations: int) -> ca.Function:
    kind: Any = ca.SX if model.mechanism.unrolled else ca.MX
    x, p = kind.sym("x", model.nx), kind.sym("p", model.np)
    N, _, time = model.unpack(x)
    place, slow = model.keep("projection parts", lambda: _projection_parts(model, kind))
    for _ in range(iterations):  # Newton's method
        N = place(N, x, p)
    result = model.pack(N, slow(N, x, p), model.split(x).internal, time)
    return _correcting("project", x, p, result, "projected")


def _projection_parts(model: Model, kind: Any) -> tuple[ca.Function, ca.Function]:
    """Build the projections (N, x, p) of nodes N and of the velocities in x.

    They are common to all numbers of iterations. Bars without joints are restored in closed form.
    `kind` is the type of CasADi's symbols, SX or MX. N (3×n) are positions of the last iteration, x
    is the state before, and p are the parameters.
    """
    x, p = kind.sym("x", model.nx), kind.sym("p", model.np)
    mech = model.with_masses(ca.vertcat(kind(model.nu, 1), p))
    _, V, time = model.unpack(x)
    D, Dd, _ = model.targets(time)
    N = placed = kind.sym("N", *V.shape)
    if mech.system_size:
        B = mech.bar_vectors(N)
        placed = remove_residuals(mech, N, B, *residuals(mech, N, B, D))
    elif mech.constrained:
        placed = _rescale(mech, N)
    slow = project_velocities(mech, N, V, Dd)
    inputs = [N, x, p]
    return ca.Function("place", inputs, [placed]), ca.Function("slow", inputs, [slow])


def _correcting(name: str, x: Any, p: Any, result: Any, what: str) -> ca.Function:
    """Build the Function x → result, or (x, p) → result with parameters.

    The names of the Function and of its result are `name` and `what`. The symbols are the state x
    and the parameters p, and `result` is the corrected state.
    """
    inputs = {"x": x} | ({"p": p} if p.numel() else {})
    return ca.Function(name, list(inputs.values()), [result], list(inputs), [what])


def build_correction(model: Model, correction: Correction) -> ca.Function | None:
    """Build a correction as a Function (x, w) → x.

    The input w (nw) is the control followed by the parameters. None if there are no constraints.
    """
    project = correction.step(model)
    if project is None:
        return None
    kind = symbol_kind(project)
    x, w = kind.sym("x", model.nx), kind.sym("w", model.nw)
    inputs = [x, w[model.nu :]] if model.np else [x]
    return ca.Function(
        project.name(), [x, w], project.call(inputs, True, False), ["x", "w"], project.name_out()
    )


def correct(model: Model, project: ca.Function, x: Any, w: Any) -> Any:
    """Apply the Function of `Correction.step` to a state.

    `project` is this Function, x the state (nx). The input w (nw) is the control followed by the
    parameters.
    """
    return project(x, w[model.nu :]) if model.np else project(x)


def _rescale(mech: Mechanism, N: Any) -> Any:
    """Restore the lengths of bars that are not joined to others.

    N (3×n) are the node positions, and `mech` has the lengths. Each bar vector is scaled to its
    length, by the smallest displacements of its ends in the norm of the mass matrix. Returns the
    corrected positions (3×n).
    """
    B = mech.bar_vectors(N)
    return stretch_bars(mech, N, B, ca.DM(mech.lengths).T / ca.sqrt(ca.sum1(B * B)) - 1)


def _appendix_c(model: Model, weight: float) -> ca.Function:
    mech = model.mechanism
    kind: Any = ca.MX if mech.large else ca.SX
    x, parameters = kind.sym("x", model.nx), kind.sym("p", model.np)
    N, V, time = model.unpack(x)
    D, Dd, _ = model.targets(time)
    B, Bd = mech.bar_vectors(N), mech.bar_vectors(V)
    direction = _direction(B, Bd, ca.DM(mech.lengths).T, weight)
    p = direction * ca.repmat(ca.DM(mech.lengths).T, 3, 1) - B  # Eq. 120
    r = -direction * ca.repmat(ca.sum1(direction * Bd), 3, 1)
    moved = [
        _close_joints(mech, Z, change, target) for Z, change, target in ((N, p, D), (V, r, Dd))
    ]
    return _correcting(
        "correct",
        x,
        parameters,
        model.pack(moved[0], moved[1], model.split(x).internal, time),
        "corrected",
    )


def _direction(B: Any, Bd: Any, lengths: Any, weight: float) -> Any:
    """Compute the unit vectors v (3×β) of the corrected bars (Eq. 133).

    B and Bd are the bar vectors b and their derivatives ḃ (3×β), `lengths` the exact lengths l, and
    `weight` is the factor q. The vectors belong to the largest root x of Eq. 121. With c = q l and
    t = ‖ḃ‖², the condition vᵀv = 1 reads

        c² (‖b‖² (x + t)² − (bᵀḃ)² (2x + t)) = x² (x + t)².

    Newton's method starts above the root, at c ‖b‖. It converges quadratically and monotonically.
    If t vanishes, the start is the root.
    """
    c, squared, t, mixed = weight * lengths, ca.sum1(B * B), ca.sum1(Bd * Bd), ca.sum1(B * Bd)
    x = c * ca.sqrt(squared)
    for _ in range(6):
        # ‖x (x + t) v‖ − x (x + t) divided by c, well scaled in any unit
        reach = ca.sqrt(ca.fmax(squared * (x + t) ** 2 - mixed**2 * (2 * x + t), 0))
        slope = (squared * (x + t) - mixed**2) / ca.fmax(reach, 1e-300)
        gap, gap_slope = c * reach - x * (x + t), c * slope - (2 * x + t)
        x = x - gap / gap_slope
    v = ca.repmat(x + t, 3, 1) * B - Bd * ca.repmat(mixed, 3, 1)  # Eq. 133 up to its length
    return v / ca.repmat(ca.sqrt(ca.sum1(v * v)), 3, 1)


def _close_joints(mech: Mechanism, Z: Any, change: Any, target: Any) -> Any:
    """Change bar vectors and close the joints.

    Z (3×n) are node positions or velocities, and `mech` has the bars and joints. The bar vectors
    change by `change` (3×β), and the joints satisfy Z P = `target` (3×c). The centers of mass and
    string nodes move as little as possible, Eqs. 134-149. Returns the new Z.
    """
    ends = sp.csr_array(abs(mech.C_b))  # β×n, twice C_r
    Z = Z + ca.mtimes(change, sparse(mech.C_b)) / 2
    if not mech.joints:
        return Z
    strings = np.flatnonzero(np.asarray(ends.sum(axis=0)).ravel() == 0)
    spread = sp.csr_array(
        sp.vstack([ends, sp.csr_array(sp.eye_array(Z.shape[1]))[strings]])
    )  # from centers and string nodes to nodes
    gap = mech.project_onto_constraints(target - ca.mtimes(Z, sparse(mech.P)))
    return Z + ca.mtimes(
        ca.mtimes(gap, ca.DM(np.linalg.pinv((spread @ mech.P).toarray()))), sparse(spread)
    )


def build_effect(model: Model) -> ca.Function:
    """Build the Function that measures the effect of a correction.

    It is (x before, x after, w) → largest displacement of a node [m] and added energy [J].
    """
    energy = model.with_stacked_input(model.energy_function)
    before, after = ca.MX.sym("before", model.nx), ca.MX.sym("after", model.nx)
    w = ca.MX.sym("w", model.nw)
    shift = model.nodes(after) - model.nodes(before)  # (n, 3)
    distance = ca.sqrt(ca.mmax(ca.sum2(shift * shift)))
    return ca.Function(
        "effect", [before, after, w], [ca.vertcat(distance, energy(after, w) - energy(before, w))]
    )
