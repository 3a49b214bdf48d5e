"""Links from messages to the troubleshooting page."""

from __future__ import annotations

from typing import TypeVar

PAGE = "docs/troubleshooting.md"
Error = TypeVar("Error", bound=BaseException)

# Anchors of the page, and the words by which their messages are recognized; the first match counts.
_WORDS = {
    "step-above-stability-limit": "is above the stability limit",
    "accuracy-lost": "so accuracy was lost elsewhere",
    "bar-lengths-off": "bars are off by up to",
    "energy-off": "energy is off by",
    "step-too-large": "s is too large (position error",
    "events-within-steps": "which ends its steps there",
    "tolerance-too-large": "is too large (position error",
    "start-off-constraints": "start from tenscasadi.build_projection(model)(state)",
    "singular-motion": "the error of each step was kept",
    "stopped-early": "stopped after t =",
    "redundant-constraints": "depend on each other in the initial shape",
    "no-reference": "no reference up to t_end",
    "no-scheme": "give a larger tolerance or other schemes",
    "function-of-time": "write it with NumPy's or CasADi's mathematics",
    "support-jumps": "which bars and joints cannot follow",
    "undeclared-breakpoint": "s more than their stages see",
    "member-without-length": "move one or remove the",
    "node-without-mass": "and no bar ends there:",
    "segments-without-mass": "which the nodes between segments need",
    "no-equilibrium": "stay unbalanced at best",
    "force-density-above-stiffness": "it must be below its stiffness",
    "nodes-of-joints-differ": "move nodes of N or correct D",
    "immutable-structure": "a Structure is immutable",
    "no-compiler": "no C compiler found",
    "compiler-too-slow": "to wait longer, CC to another compiler",
    "cache-not-private": "can be written by other users",
    "infeasible-goal": "misses its goal by",
    "contradicting-goals": "the goals contradict each other",
    "contradicting-bounds": "Problem.bounds leave no controls at the start",
    "no-control": "Problem.model has the control",
    "infeasible-point": "the constraint violation does not decrease near",
    "narrow-limits": "it suffices to",
    "solver-failed": "the solver could not go on",
    "contact-derivatives": "through contact with a ground derivatives mislead",
    "vibration-too-fast": "are too long for the fastest vibration",
    "iteration-limit": "stopped at the iteration limit",
    "time-limit": "stopped at the time limit",
    "cost-not-settled": "but the cost is not settled",
    "mesh-too-coarse": "too coarse: corrections end",
    "motion-beyond-limits": "the motion violates",
    "refinement-missed": "iterations; the tolerance of",
    "unstable-motion": "the motion is so unstable that",
    "tracking-too-slow": "grow too fast for LQR gains",
    "no-noise": "noise is None",
    "robustness-with-parameters": "robustness varies the values of the scene",
    "large-archive": "it unpacks to",
    "unreadable-file": "it cannot be read",
    "plan-without-model": "give Plan.load(path, problem=...)",
    "older-sweep": "results are of an older text of",
    "no-format": ": begin with",
    "syntax-error": ": correct it there",
    "unknown-field": "is no field of",
    "undeclared-number": "is not declared: give it in [numbers]",
    "no-formula": "give arithmetic such as",
    "include-elsewhere": "give a .toml or .json file in this file's folder",
    "unknown-name": ", which is not there: ",
    "no-plan-section": "it has no [plan]",
    "python-function-in-file": "a function of time in Python",
    "no-viser": "the viewer needs viser",
    "public-viewer": "other machines can see this viewer",
    "port-taken": "is not available (",
    "too-many-frames": "frames, give a speed of at least",
    "matlab-v7-3": "it has MATLAB's format v7.3",
    "no-structure-in-file": "it holds no structure",
    "no-mjcf-counterpart": "has no counterpart in MJCF",
    "velocities-stretch-bar": "velocities stretch bar",
}


def find_address(message: str) -> str:
    """Find the address of the page section that explains a message.

    Returns "" if the troubleshooting page does not explain it.
    """
    anchor = next((anchor for anchor, words in _WORDS.items() if words in message), "")
    return f"{PAGE}#{anchor}" if anchor else ""


def describe_address(message: str) -> list[str]:
    """Return a summary line with the address that explains a message.

    The list is empty if there is none.
    """
    address = find_address(message)
    return [f"see           {address}"] if address else []


def append_address(message: str) -> str:
    """Append the address that explains a message to it, if there is one."""
    address = find_address(message)
    return f"{message} (see {address})" if address else message


def add_address(error: Error) -> Error:
    """Add a note with the address that explains an error.

    Python 3.11 and later print notes below the message.
    """
    if address := find_address(str(error)):
        # BaseException.add_note() is of Python 3.11
        notes = [*getattr(error, "__notes__", []), f"See {address}"]
        error.__notes__ = notes
    return error
