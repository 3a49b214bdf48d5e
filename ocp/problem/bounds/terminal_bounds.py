"""Bounds at the end of a plan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from ocp.problem.bounds.string_bounds import TensionBound


@dataclass(frozen=True, eq=False)
class TerminalTensions(TensionBound, kind="TerminalTensions"):
    """Limits of string tensions at the end of the plan.

    The tensions are those under the control of the last interval. Equal lower and upper limits
    prescribe them.

    Parameters
    ----------
    lower : float or array_like, shape (nu,), optional
        Smallest tension [N], ≥ 0: one number, or one for each cable and each string in no cable.
        None for no limit.
    upper : float or array_like, shape (nu,), optional
        Largest tension [N]: one number, or one for each cable and each string in no cable. None or
        inf for no limit.

    Raises
    ------
    TypeError, ValueError
        If both are None, or if a limit is negative or not a number. In a `Problem`: if the number
        of limits differs from nu, or if ``lower`` is above ``upper``.

    See Also
    --------
    TensionLimits : Limits along the whole plan.

    Examples
    --------
    >>> import ocp
    >>> ocp.TerminalTensions(lower=8.0, upper=12.0).ends
    ('last',)
    """

    ends: ClassVar[tuple[str, ...]] = ("last",)
