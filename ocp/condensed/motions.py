"""From states to the motion that the method starts from, and from the motion that it finds to states."""

from __future__ import annotations

import numpy as np

from ocp.condensed.chain import Chain, Motion
from ocp.condensed.linear_chain import bar_directions
from tenscasadi.util.validate import Array


def first_motion(chain: Chain, strings: Array, duration: float, states: Array) -> Motion:
    """Return the motion through states (K + 1, nx), with the bars that fit it best under T²σγ at the stations (K + X, α)."""
    places, velocities = chain.unpack(states)
    motion = Motion(
        places, velocities[chain.taps] * duration, np.zeros((len(chain.at), chain.bars))
    )
    if not chain.bars:
        return motion
    directions = bar_directions(chain, places)[chain.at]
    left = chain.rows(strings, duration, motion).impulses[:, :, None]
    return motion._replace(bars=-_along_bars(chain, directions, left))


def states_of(chain: Chain, c: Array, duration: float, motion: Motion) -> Array:
    """Return the states (K + 1, nx) of a motion that is met under force densities c (Kc, m).

    Velocities are those of the discrete momenta just before each node, along the bars.
    """
    places, late = motion.places, duration**2 * chain.controls.before_nodes(c)
    clock = (chain.clock + duration * chain.time[:, None])[:, : chain.model.nx - 2 * chain.model.nq]
    before = (places[1:] - places[:-1]) / chain.shares[:, None, None]
    pull = chain.across(chain.C_sT, late[:, :, None] * chain.across(chain.C_s, places[1:])).reshape(
        chain.count, -1
    )
    pull = pull - chain.loads_at(duration, chain.time[1:], chain.shares / 2)[0]
    if (
        chain.moved
    ):  # these nodes have speeds of their own, and with them the mass that they share with others
        at_rest = np.column_stack([np.zeros((chain.count, chain.model.nx - 1)), clock[1:]])
        faster = np.zeros(before.shape)
        faster[:, chain.moved] = (duration * chain.unpack(at_rest)[1] - before)[:, chain.moved]
        before, pull = (
            before + faster,
            pull + np.matmul(chain.mass, faster).reshape(chain.count, -1),
        )
    rates = before.reshape(chain.count, -1)[:, :, None] - chain.by_inverse(pull[:, :, None])
    directions = bar_directions(chain, places)[1:]
    rates = without_bars(chain, directions, rates)
    velocities = np.concatenate(
        [chain.first_rate[None], rates.reshape(-1, chain.nodes, 3) / duration]
    )
    velocities[chain.taps] = motion.rates / duration
    free = chain.mech.free_index
    flat = (
        chain.mech.local(values.reshape(chain.count + 1, -1))[:, free]
        for values in (places, velocities)
    )
    return np.column_stack([*flat, clock])


def without_bars(chain: Chain, directions: Array, vectors: Array) -> Array:
    """Return vectors (P, 3n, 1) of speeds without the parts that bars in directions (P, 3n, β) take away, by impulses along them."""
    if not chain.bars:
        return vectors
    along = np.matmul(
        chain.by_inverse(directions), _along_bars(chain, directions, vectors)[:, :, None]
    )
    return np.asarray(vectors - along)


def _along_bars(chain: Chain, directions: Array, vectors: Array) -> Array:
    """Return what of M⁻ C_bᵀ∘b takes away the parts along the bars of vectors (P, 3n, 1): (P, β)."""
    across = directions.transpose(0, 2, 1)
    return np.linalg.solve(
        np.matmul(across, chain.by_inverse(directions)), np.matmul(across, vectors)
    )[:, :, 0]
