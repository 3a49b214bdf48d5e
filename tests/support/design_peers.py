"""The same structures in jax-fdm and tnsgrt."""

from __future__ import annotations

from typing import Any

import numpy as np

import tenscasadi as tc


def load_jax_fdm() -> Any:
    """jax-fdm's data structure and its two solvers, in double precision."""
    import jax

    jax.config.update("jax_enable_x64", True)
    import jax_fdm.equilibrium
    from jax_fdm.datastructures import FDNetwork

    return FDNetwork, jax_fdm.equilibrium.fdm, jax_fdm.equilibrium.constrained_fdm


def network(FDNetwork: Any, net: tc.Structure, density: Any) -> Any:
    """Network of a net with supports at its pinned nodes."""
    made = FDNetwork.from_nodes_and_edges(
        net.nodes.tolist(), [tuple(e) for e in net.strings.tolist()]
    )
    for node in net.pinned:
        made.node_support(node)
    for (a, b), value in zip(
        net.strings.tolist(), np.broadcast_to(density, len(net.strings)), strict=True
    ):
        made.edge_forcedensity((a, b), float(value))
    return made


def positions(found: Any) -> np.ndarray:
    """Nodes of a network (n, 3)."""
    return np.array([found.node_coordinates(node) for node in found.nodes()])


def load_tnsgrt() -> Any:
    """Structures of tnsgrt, which names a type of NumPy 1."""
    vars(np).setdefault("float_", np.float64)
    import tnsgrt.structure

    return tnsgrt.structure.Structure


def peer_structure(Structure: Any, s: tc.Structure) -> Any:
    """Structure of tnsgrt: strings first, then bars."""
    made = Structure(s.nodes.T)
    members = np.concatenate([s.strings, s.bars])
    made.add_members(members.T, number_of_strings=len(s.strings))
    return made
