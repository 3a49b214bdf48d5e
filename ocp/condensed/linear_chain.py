"""The linearised motion: steps of places and bars that follow from those of the force densities, and the transpose of that."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ocp.condensed.chain import Chain, Motion, Rows
from tenscasadi.util.validate import Array


class Costate(NamedTuple):
    """Multipliers of the rows of the motion, for r functions: of the impulses (K + X, 3n, r), of the bars (K + X, β, r)."""

    impulses: Array
    lengths: Array


class LinearChain:
    """The rows of a chain linearised at a motion.

    A block triangular system: one β×β matrix is inverted for each station, b₊ᵀ-weighted G of the
    bars' next and present directions. Steps are columns: (…, 3n, r).
    """

    def __init__(self, chain: Chain, strings: Array, motion: Motion) -> None:
        self.chain, self.strings, self.motion = chain, strings, motion
        n, count = chain.nodes, chain.count
        at = motion.places[chain.at]
        self.S = chain.across(chain.C_s, at)
        stiffness = chain.stiffness(strings, motion.bars)
        if chain.alike:
            self.pull = np.matmul(chain.inverse, stiffness)
        else:
            self.pull = np.matmul(chain.inverse, np.kron(stiffness, np.eye(3)))
        self.directions = bar_directions(chain, motion.places)
        self.push = chain.by_inverse(self.directions)  # M⁻ times these
        self.turned = bar_directions(chain, motion.rates)
        ahead = np.concatenate([np.arange(1, count + 1), chain.taps])
        forward = np.ascontiguousarray(self.directions[ahead].transpose(0, 2, 1))
        inverse = np.linalg.inv(np.matmul(forward, self.push[chain.at]))
        self.inverse = inverse
        self.close = np.matmul(inverse, forward)  # bars from what the rest leaves of their lengths
        own = np.ascontiguousarray(self.directions[chain.at].transpose(0, 2, 1))
        self.close_back = np.matmul(inverse.transpose(0, 2, 1), own)
        self.rows_of_pull = n if chain.alike else 3 * n

    def solve(self, rows: Rows, columns: int = 1) -> Motion:
        """Return the step (of r columns) that takes away the rows: impulses (K + X, 3n, r), lengths (K + X, β, r)."""
        chain = self.chain
        n3, count, shares = 3 * chain.nodes, chain.count, chain.shares
        impulses, lengths = rows
        places, rates = np.zeros((count + 1, n3, columns)), np.empty((count + 1, n3, columns))
        bars = np.empty((len(chain.at), chain.bars, columns))
        slack = np.matmul(self.inverse, lengths)
        d = p = rates[0] = np.zeros((n3, columns))
        size = self.rows_of_pull
        for k in range(count):
            s = shares[k]
            t = p - (self.pull[k] @ d.reshape(size, -1)).reshape(n3, columns) - impulses[k]
            lam = (self.close[k] @ (d + s * t) + slack[k]) / s
            p = t - self.push[k] @ lam
            d = d + s * p
            bars[k], rates[k + 1], places[k + 1] = lam, p, d
        taps = chain.taps
        D, A = places[taps], self.pull[count:]
        t = (
            rates[taps]
            - np.matmul(A, D.reshape(len(taps), size, -1)).reshape(D.shape)
            - impulses[count:]
        )
        lam = (
            np.matmul(self.close[count:], t)
            + np.matmul(self.inverse[count:], np.matmul(self.turned.transpose(0, 2, 1), D))
            + slack[count:]
        )
        bars[count:] = lam
        return Motion(places, t - np.matmul(self.push[taps], lam), bars)

    def solve_back(self, slopes: Motion) -> Costate:
        """Return the multipliers under which functions of these slopes (places (K + 1, 3n, r), …) do not change with the motion."""
        chain = self.chain
        n3, count, shares, taps = 3 * chain.nodes, chain.count, chain.shares, chain.taps
        columns, size = slopes.places.shape[2], self.rows_of_pull
        mus = np.empty((len(chain.at), n3, columns))
        nus = np.empty((len(chain.at), chain.bars, columns))
        slack = np.matmul(self.inverse.transpose(0, 2, 1), slopes.bars)
        t = -chain.by_inverse(slopes.rates)
        nu = np.matmul(self.close_back[count:], t) + slack[count:]
        mu = t - np.matmul(self.push[taps], nu)
        mus[count:], nus[count:] = mu, nu
        force = chain.by_inverse(slopes.places)
        at_taps = np.matmul(self.pull[count:], mu.reshape(len(taps), size, -1)).reshape(mu.shape)
        at_taps += chain.by_inverse(np.matmul(self.turned, nu))
        for x, k in enumerate(taps):
            back = mu[x] / shares[k - 1]
            force[k] += at_taps[x] - back
            force[k - 1] += back
        pi = np.zeros((n3, columns))
        mu = np.zeros((n3, columns))
        for k in range(count, 0, -1):
            s = shares[k - 1]
            t = pi + force[k]
            if k < count:
                t += (self.pull[k] @ mu.reshape(size, -1)).reshape(n3, columns)
            nu = (self.close_back[k - 1] @ (mu - s * t) + slack[k - 1]) / s
            pi = t + self.push[k] @ nu
            mu = mu - s * pi
            mus[k - 1], nus[k - 1] = mu, nu
        return Costate(mus, nus)

    def along(self, step: Motion) -> Rows:
        """Return how pushes (K + X, 3n) and lengths of bars (K + X, β) change with places and rates of one column."""
        chain, taps = self.chain, self.chain.taps
        shaped = Motion(
            step.places.reshape(-1, chain.nodes, 3),
            step.rates.reshape(-1, chain.nodes, 3),
            self.motion.bars,
        )
        push = chain.pushes(self.strings, np.zeros((chain.nodes, 3)), shaped)
        own = self.directions.transpose(0, 2, 1)
        turning = np.matmul(own[taps], step.rates) + np.matmul(
            self.turned.transpose(0, 2, 1), step.places[taps]
        )
        return Rows(push, np.concatenate([np.matmul(own[1:], step.places[1:]), turning])[:, :, 0])

    # --- second derivatives, and those by the force densities ---

    def by_strings(self, impulses: Array) -> Array:
        """Return the derivatives (K + X, α, r) of Σ μᵀ rows by T²σγ at the stations, of multipliers μ (K + X, 3n, r)."""
        chain = self.chain
        count, columns = len(impulses), impulses.shape[2]
        if columns == 1:
            return np.asarray(
                (chain.across(chain.C_s, impulses.reshape(count, -1, 3)) * self.S).sum(axis=2)[
                    :, :, None
                ]
            )
        return np.asarray(
            np.matmul(member_directions(chain.C_sT, self.S).transpose(0, 2, 1), impulses)
        )

    def of_strings(self, strings: Array) -> Array:
        """Return what changes (K + X, α) of T²σγ push: M⁻ times impulses (K + X, 3n)."""
        chain = self.chain
        pushes = chain.across(chain.C_sT, strings[:, :, None] * self.S)
        return np.asarray(chain.by_inverse(pushes.reshape(len(pushes), -1, 1))[:, :, 0])

    def curvature(self, costate: Costate, strings: Array, step: Motion) -> tuple[Motion, Array]:
        """Return how the derivatives of Σ μᵀ rows change with a step of one column: those by the motion, and those by T²σγ (K + X, α)."""
        chain = self.chain
        count, n = chain.count, chain.nodes
        mu, nu = costate.impulses.reshape(-1, n, 3), costate.lengths[:, :, 0]
        places, rates = step.places.reshape(-1, n, 3), step.rates.reshape(-1, n, 3)
        S_mu, B_mu = chain.across(chain.C_s, mu), chain.across(chain.C_b, mu)
        dS, dB = chain.across(chain.C_s, places[chain.at]), chain.across(chain.C_b, places)
        own = chain.across(chain.C_sT, strings[:, :, None] * S_mu) + chain.across(
            chain.C_bT, step.bars * B_mu
        )
        at_nodes = np.zeros((count + 1, n, 3))
        at_nodes[:count] = own[:count]
        at_nodes[1:] += chain.across(chain.C_bT, nu[:count, :, None] * dB[1:])
        by_rates = chain.across(chain.C_bT, nu[count:, :, None] * dB[chain.taps])
        at_nodes[chain.taps] += own[count:] + chain.across(
            chain.C_bT, nu[count:, :, None] * chain.across(chain.C_b, rates)
        )
        by_bars = (B_mu * dB[chain.at]).sum(axis=2)
        slopes = Motion(
            at_nodes.reshape(count + 1, -1, 1),
            by_rates.reshape(len(chain.taps), -1, 1),
            by_bars[:, :, None],
        )
        return slopes, (S_mu * dS).sum(axis=2)


def bar_directions(chain: Chain, places: Array) -> Array:
    """Return C_bᵀ ∘ b (P, 3n, β) of places (P, n, 3): where each bar pushes the nodes."""
    return member_directions(chain.C_bT, chain.across(chain.C_b, places))


def member_directions(C_T: Any, vectors: Array) -> Array:
    """Return Cᵀ ∘ s (P, 3n, m) of members' vectors (P, m, 3)."""
    dense: Any = C_T if isinstance(C_T, np.ndarray) else C_T.toarray()
    product = dense[None, :, None, :] * vectors.transpose(0, 2, 1)[:, None]
    return np.asarray(product.reshape(len(vectors), -1, C_T.shape[1]))
