"""Base class of scene features that exert forces on nodes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import casadi as ca

if TYPE_CHECKING:
    from tenscasadi.dynamics.mechanism import Mechanism


class NodeMotion(NamedTuple):
    """Motion of the nodes at an instant.

    N and V (3×n) are positions [m] and velocities [m/s], and `time` is in s.
    """

    N: Any  # 3×n [m]
    V: Any  # 3×n [m/s]
    time: Any  # [s]


class ForceElement:
    """Base class of scene features that exert forces on nodes.

    Attributes
    ----------
    name : str
        Name of its term in `Model.describe`.
    switch_count : int
        Number k of its switches, which are slack strings and contacts. In a mode, a row (1×k) of 1
        and 0, the forces are smooth. Without a mode they follow from the motion.
    """

    name: ClassVar[str]
    switch_count: int = 0

    def forces(self, at: NodeMotion) -> Any:
        """Compute the forces (3×n) [N].

        `at` has the positions and velocities of the nodes, and the time.
        """
        raise NotImplementedError

    def energy(self, N: Any) -> Any:
        """Compute the potential energy [J] at node positions N (3×n)."""
        return ca.DM(0)

    def power(self, at: NodeMotion, stored: bool) -> Any:
        """Compute the power of the forces [W].

        `at` is that of `forces`. If `stored`, the rate of change of `energy` is excluded.
        """
        power = ca.sum2(ca.sum1(self.forces(at) * at.V))
        if not stored:
            return power
        n: Any = type(at.N).sym("n", at.N.shape)
        return power + ca.substitute(ca.jtimes(self.energy(n), n, at.V), n, at.N)

    def switches(self, at: NodeMotion) -> Any:
        """Compute functions (1×k) [m] that are positive in mode 1.

        A mode is 1 for a taut string or a contact, else 0. `at` is that of `forces`.
        """
        return ca.DM(1, 0)

    def margins(self, at: NodeMotion) -> Any:
        """Compute the elongations (1×m) [m] of members until they break.

        There is one for each of the m breakable members. `at` is that of `forces`.
        """
        return ca.DM(1, 0)

    def internal_rates(self, at: NodeMotion) -> Any:
        """Compute time derivatives of the element's internal states.

        They form a column. Internal states are, for example, rest lengths of winches. `at` is that
        of `forces`.
        """
        return ca.DM(0, 1)

    def internal_kinetic_energy(self) -> Any:
        """Compute the kinetic energy of the internal states [J]."""
        return ca.DM(0)


def spread(mech: Mechanism, W: Any, columns: list[int]) -> Any:
    """Assign forces on some nodes to all nodes.

    W (3×m) are forces on m nodes; the result is (3×n). Forces on the same node are added. `columns`
    are the m nodes as columns of N, which may repeat, and `mech` has the number n of columns.
    """
    count, n = len(columns), mech.N.shape[1]
    if columns == list(range(n)):
        return W
    return ca.mtimes(W, ca.DM.triplet(list(range(count)), columns, ca.DM.ones(count), count, n))
