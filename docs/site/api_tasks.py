"""Tasks of the API reference, and the modules whose public names serve them."""

from __future__ import annotations

from typing import NamedTuple


class Task(NamedTuple):
    """A page of the API: its title, a sentence, and modules with all that is below them.

    A name belongs to the task with the longest module that leads to it.
    """

    title: str
    text: str
    modules: str


TASKS = {
    "structures": Task(
        "Describe a structure",
        "Nodes, bars, strings, cables and rigid bodies.",
        "tenscasadi.structure",
    ),
    "scenes": Task(
        "Add loads, grounds and controls",
        "A scene is a structure with its environment and its actuation.",
        "tenscasadi.scene",
    ),
    "models": Task(
        "Build and analyze equations of motion",
        "A model has the equations of a scene as CasADi Functions.",
        "tenscasadi.dynamics tenscasadi.analysis tenscasadi.simulation.export"
        " tenscasadi.util.compile.CompileError",
    ),
    "simulation": Task(
        "Simulate",
        "Trajectories of a model by integration schemes.",
        "tenscasadi.simulation tenscasadi.integrators tenscasadi.util.compile",
    ),
    "accuracy": Task(
        "Choose a scheme and a step",
        "Costs and errors of schemes on your own model.",
        "tenscasadi.analysis.recommend tenscasadi.analysis.tradeoff"
        " tenscasadi.analysis.tradeoff_table tenscasadi.analysis.reference_solution",
    ),
    "studies": Task(
        "Run many cases",
        "Batches of runs, derivatives, and sweeps over independent cases.",
        "tenscasadi.simulation.rollouts tenscasadi.simulation.motions tenscasadi.simulation.inputs"
        " tenscasadi.simulation.sensitivities tenscasadi.sweeps",
    ),
    "statics": Task(
        "Analyze statics",
        "Equilibria, self-stresses, stability, buckling and load paths.",
        "tenscasadi.statics",
    ),
    "design": Task(
        "Find form, prestress and sections",
        "Forms of nets and structures, prestress designs, and sections of least mass.",
        "tenscasadi.design",
    ),
    "problems": Task(
        "State an optimal control problem",
        "Goals, bounds and costs of a motion.",
        "ocp.problem",
    ),
    "plans": Task(
        "Solve a problem and check the plan",
        "Transcriptions, solvers and initial guesses; plans with replay, report and robustness.",
        "ocp",
    ),
    "feedback": Task(
        "Control in closed loop",
        "Controllers, and simulation under a controller.",
        "ocp.control ocp.sampling.spline_noise ocp.export.export_mpc ocp.acados.export_acados",
    ),
    "files": Task(
        "Read and write files",
        "Scene files, and files of other programs.",
        "tenscasadi.io tenscasadi.schema tenscasadi.simulation.simulation_files"
        " tenscasadi.exchange ocp.io",
    ),
    "pictures": Task(
        "Draw, animate and view",
        "Figures with matplotlib, films, and the viewer in the browser.",
        "tenscasadi.plots tenscasadi.animation tenscasadi.viewer",
    ),
    "learning": Task(
        "Learn policies",
        "Environments of gymnasium, and equations of motion in JAX.",
        "tenscasadi.envs tenscasadi.exchange.jax_function",
    ),
}
