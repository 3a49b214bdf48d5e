"""The error of goals that cannot be met."""

from __future__ import annotations


class UnreachableGoal(ValueError):
    """The goals contradict each other, the bars' lengths, what the motion keeps whatever the strings do, or the time there is."""
