"""Recommendations on scenes that nothing was tuned on: they meet the tolerance, at no more than twice the cost of the best of a fine grid."""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import tenscasadi as tc
from tenscasadi.analysis.recommend import SCHEMES
from tenscasadi.analysis.reference_solution import distance
from tenscasadi.analysis.tradeoff import Case
from tenscasadi.integrators.stabilization import build_projection


def turning(structure, **scene):
    """A model and its start: it turns about the origin as a rigid body."""
    model = tc.Model(tc.Scene(structure, **scene))
    return model, model.state(structure.nodes, np.cross((1.0, 2.0, 3.0), structure.nodes))


def pendulum():
    return turning(tc.shapes.pendulum(angle=2.0), gravity=tc.Gravity())


def five_bars():
    return turning(
        tc.shapes.prism(bars=5, prestress=30.0), control=tc.ForceDensity(), gravity=tc.Gravity()
    )


def t_bar():
    """Goes slack, damped."""
    structure = tc.shapes.t_bar(prestress=30.0, stiffness=300.0, pinned=[4], damping=1.0)
    return turning(structure, gravity=tc.Gravity())


def stiff():
    return turning(tc.shapes.prism(prestress=100.0, stiffness=1e5))


def slack_ball():
    ball = tc.shapes.six_bar_ball(prestress=2.0, stiffness=300.0)
    model = tc.Model(tc.Scene(ball))
    wild = model.state(ball.nodes, 2 * np.random.default_rng(1).normal(size=ball.nodes.shape))
    return model, build_projection(model)(wild).full().ravel()


def damped(segments=1):
    """Stiff and overdamped: explicit steps are bound by the damping of strings, which is over within microseconds."""
    stiffness, damping = (1e7, 1e5) if segments == 1 else (1e7, 1e3)
    structure = tc.shapes.prism(
        stiffness=stiffness, damping=damping, prestress=30.0, string_mass=0.1
    )
    model = tc.Model(tc.Scene(structure, segments=segments, gravity=tc.Gravity()))
    nodes = model.structure.nodes
    return model, model.state(nodes, np.cross((0.5, 0.3, 1.0), nodes - nodes.mean(axis=0)))


SLOW = [
    (pendulum, 2.0, 1e-6),
    (five_bars, 1.0, 1e-4),
    (five_bars, 1.0, 1e-9),
    (t_bar, 1.0, 1e-3),
    (t_bar, 1.0, 1e-6),
    (stiff, 0.3, 1e-3),
    (stiff, 0.3, 1e-7),
    (slack_ball, 1.0, 1e-3),
    (slack_ball, 1.0, 1e-6),
]
CASES = [
    (pendulum, 2.0, 1e-6, (tc.DormandPrince853(), tc.RungeKutta4(), tc.DormandPrince54(rtol=1e-6))),
    *(pytest.param(*case, SCHEMES, marks=pytest.mark.slow) for case in SLOW),
]


@pytest.mark.parametrize(("scene", "t_end", "tolerance", "schemes"), CASES)
def test_meets_the_tolerance_at_no_more_than_twice_the_cost_of_the_best(
    scene, t_end, tolerance, schemes
):
    model, start = scene()
    advice = tc.recommend(model, t_end, tolerance, start, schemes=schemes)
    run = tc.simulate(model, t_end, state=start, **advice.options)
    reference = tc.reference_solution(model, t_end, start)
    error = distance(run.nodes[-1], reference.nodes) + reference.error
    assert error <= tolerance
    assert error == pytest.approx(
        advice.error, abs=0.11 * tolerance
    )  # that of the reference it was measured against

    explicit = [scheme for scheme in schemes if not scheme.implicit]
    fixed = [scheme for scheme in explicit if not scheme.adaptive]
    steps = t_end / np.unique(np.geomspace(4, 4000, 16).astype(int))
    tables = [
        tc.tradeoff(
            model,
            t_end,
            fixed,
            steps,
            reference,
            start,
            corrections=(None, tc.Projection()),
            repeats=1,
        )
    ]
    own = [
        replace(scheme, rtol=float(rtol))
        for scheme in explicit
        if scheme.adaptive
        for rtol in np.geomspace(1e-9, 1e-3, 5)
    ]
    tables.append(
        tc.tradeoff(model, t_end, own, [t_end / 20], reference, start, compiled=(False,), repeats=1)
    )
    rows = [
        row
        for table in tables
        for row in table.rows
        if row.success and row.position + reference.error <= tolerance
    ]
    assert len(rows) >= 3
    assert advice.work <= 2 * min(row.work for row in rows)


@pytest.mark.slow
def test_where_stability_bounds_the_step_implicit_schemes_are_looked_at():
    model, start = damped()
    schemes = (tc.Collocation(2, "radau"), tc.Cvodes(), tc.DormandPrince853())
    advice = tc.recommend(model, 0.02, 1e-5, start, schemes=schemes, compiled=False)
    assert advice.scheme.implicit
    assert np.isnan(advice.work)
    run = tc.simulate(model, 0.02, state=start, compiled=False, **advice.options)
    assert run.success
    assert (
        distance(run.nodes[-1], tc.reference_solution(model, 0.02, start, compiled=False).nodes)
        < 1e-5
    )


def test_where_accuracy_bounds_the_step_implicit_schemes_are_left_out():
    model, start = pendulum()
    advice = tc.recommend(
        model, 0.5, 1e-6, start, schemes=[tc.Idas(), tc.RungeKutta4()], compiled=False
    )
    assert advice.scheme == tc.RungeKutta4()
    assert (
        advice.message.count("Idas left out: stability does not bound the steps of RungeKutta4")
        == 1
    )


@pytest.mark.parametrize("scheme", [tc.Cvodes(), tc.Collocation(2)])
def test_implicit_schemes_serve_alone(scheme):
    model, start = pendulum()
    advice = tc.recommend(model, 0.5, 1e-6, start, schemes=[scheme], compiled=False)
    assert type(advice.scheme) is type(scheme)
    run = tc.simulate(model, 0.5, state=start, compiled=False, **advice.options)
    assert (
        distance(run.nodes[-1], tc.reference_solution(model, 0.5, start, compiled=False).nodes)
        < 1e-6
    )


@pytest.mark.slow
@pytest.mark.parametrize(("segments", "tolerance"), [(1, 1e-4), (5, 1e-6)])
def test_stiff_scenes_are_given_implicit_schemes(segments, tolerance):
    model, start = damped(segments)
    t_end = 0.05
    advice = tc.recommend(
        model, t_end, tolerance, start, time_limit=600.0
    )  # to the end, also beside other work
    assert advice.scheme.implicit
    reference = tc.reference_solution(model, t_end, start)
    run = tc.simulate(model, t_end, state=start, **advice.options)
    assert (
        distance(run.nodes[-1, : len(reference.nodes)], reference.nodes) + reference.error
        <= tolerance
    )


@pytest.mark.slow
def test_single_precision_is_recommended_within_its_floor():
    model, start = pendulum()
    advice = tc.recommend(
        model,
        0.5,
        1e-4,
        start,
        schemes=[tc.RungeKutta4(), tc.DormandPrince54(rtol=1e-6)],
        compiled=tc.Single(),
    )
    run = tc.simulate(model, 0.5, state=start, compiled=tc.Single(), **advice.options)
    assert distance(run.nodes[-1], tc.reference_solution(model, 0.5, start).nodes) < 1e-4
    with pytest.raises(tc.NoSchemeError):
        tc.recommend(
            model, 0.5, 1e-9, start, schemes=[tc.DormandPrince54(rtol=1e-6)], compiled=tc.Single()
        )


@pytest.mark.parametrize("compiled", [False, None])
def test_few_steps_of_high_order_are_recommended(compiled):
    """Few steps of order 8 are less work than more of order 4."""
    model, start = pendulum()
    schemes = (tc.DormandPrince853(), tc.RungeKutta4())
    advice = tc.recommend(
        model, 0.5, 1e-3, start, schemes=schemes, corrections=[None], compiled=compiled
    )
    assert advice.scheme == tc.DormandPrince853()
    assert advice.error <= 1e-3
    assert round(0.5 / advice.step) <= 32


def test_a_scene_will_do():
    advice = tc.recommend(
        tc.Scene(tc.shapes.pendulum(), gravity=tc.Gravity()),
        0.5,
        1e-4,
        schemes=[tc.RungeKutta4()],
        compiled=False,
    )
    assert advice.scheme == tc.RungeKutta4()
    assert 0 < advice.error <= 1e-4
    assert advice.seconds > 0
    assert "compared with RungeKutta4; reference: DormandPrince853" in advice.message


def bouncing_string():
    """A mass that is thrown about at the end of a string, which goes slack and taut again and again."""
    structure = tc.Structure(
        [(0, 0, 0), (0.1, 0, -1)],
        [],
        [(0, 1)],
        node_mass=[0, 1.0],
        pinned=[0],
        stiffness=500.0,
        rest_length=[1.0],
    )
    model = tc.Model(tc.Scene(structure, gravity=tc.Gravity()))
    return model, model.state(structure.nodes, [(0, 0, 0), (0.3, 0.2, 3.0)])


def bouncing_mass():
    """A mass that slides and bounces on the ground."""
    structure = tc.Structure([(0, 0, 0.3)], [], [], node_mass=[1.0])
    model = tc.Model(
        tc.Scene(
            structure,
            gravity=tc.Gravity(),
            ground=tc.Ground(stiffness=1e3, damping=1.0, friction=0.3),
        )
    )
    return model, model.state(structure.nodes, [(0.5, 0, 0)])


@pytest.mark.parametrize(("scene", "tolerance"), [(bouncing_string, 1e-9), (bouncing_mass, 1e-4)])
def test_events_are_left_to_schemes_that_locate_them(scene, tolerance, monkeypatch):
    """Steps that miss events must be so short that a run takes millions of them: such runs are not made."""
    model, start = scene()
    taken = []
    run = Case.run

    def note(case, step, **options):
        trajectory = run(case, step, **options)
        taken.append(trajectory.attempts)
        return trajectory

    monkeypatch.setattr(Case, "run", note)
    schemes = (tc.DormandPrince853(), tc.RungeKutta4(), tc.DormandPrince853(rtol=1e-6))
    advice = tc.recommend(model, 1.0, tolerance, start, schemes=schemes, compiled=False)
    assert advice.error <= tolerance
    assert sum(taken) < 50_000
    monkeypatch.undo()
    end = tc.simulate(model, 1.0, state=start, compiled=False, **advice.options)
    assert (
        distance(end.nodes[-1], tc.reference_solution(model, 1.0, start, compiled=False).nodes)
        <= tolerance
    )


def test_the_search_ends_in_time():
    model, start = bouncing_mass()
    began = time.perf_counter()
    with pytest.raises(
        (tc.NoSchemeError, tc.NoReferenceError), match=r"the time limit of (1|0\.5) s expired"
    ):  # the reference may take half of it
        tc.recommend(
            model, 3.0, 1e-9, start, schemes=[tc.RungeKutta4()], compiled=False, time_limit=1.0
        )
    assert time.perf_counter() - began < 10  # a search to the end takes minutes


def test_out_of_time_the_best_so_far_is_returned(monkeypatch):
    """The clock jumps ahead at the first run of the second scheme."""
    model, start = pendulum()
    run = Case.run

    def late(case, step, **options):
        if case.scheme == tc.Rattle():
            monkeypatch.setattr(
                sys.modules["tenscasadi.analysis.option_search"],
                "time",
                SimpleNamespace(perf_counter=lambda: np.inf),
            )
        return run(case, step, **options)

    monkeypatch.setattr(Case, "run", late)
    schemes = [tc.RungeKutta4(), tc.Rattle(), tc.DormandPrince54()]
    advice = tc.recommend(
        model, 0.5, 1e-5, start, schemes=schemes, corrections=[None], compiled=False
    )
    assert advice.scheme == tc.RungeKutta4()
    assert advice.error <= 1e-5
    assert (
        "the time limit of 60 s expired before Rattle, DormandPrince54 were tested"
        in advice.message
    )


@pytest.mark.parametrize(("press", "found"), [(1, tc.RungeKutta4()), (0, None)])
def test_after_ctrl_c_the_best_so_far_is_returned(monkeypatch, press, found):
    """Ctrl-C is pressed at the first run of a scheme, by its place."""
    model, start = pendulum()
    schemes = [tc.RungeKutta4(), tc.Rattle(), tc.DormandPrince54()]
    run = Case.run

    def interrupted(case, step, **options):
        if case.scheme == [tc.RungeKutta4(), tc.DormandPrince54()][press]:
            raise KeyboardInterrupt
        return run(case, step, **options)

    monkeypatch.setattr(Case, "run", interrupted)
    options = {"schemes": schemes, "corrections": [None], "compiled": False}
    if found is None:
        with pytest.raises(KeyboardInterrupt):
            tc.recommend(model, 0.5, 1e-5, start, **options)
        return
    advice = tc.recommend(model, 0.5, 1e-5, start, **options)
    assert advice.scheme in (tc.RungeKutta4(), tc.Rattle())
    assert advice.error <= 1e-5
    assert "interrupted from the keyboard before DormandPrince54 were tested" in advice.message


def is_energy_run(options):
    return "save_every" not in options and "energy_balance" not in options


def is_time_loop(options):
    return "save_every" not in options and not options.get("energy_balance", True)


@pytest.mark.parametrize("pressed", [is_energy_run, is_time_loop])
def test_options_stay_after_ctrl_c_in_a_later_run(monkeypatch, pressed):
    """Ctrl-C is pressed in the second search run with energy, or in the timed runs."""
    bar = tc.Structure([(0, 0, 0), (1, 0, 0)], bars=[(0, 1)], pinned=[0])
    model = tc.Model(tc.Scene(bar, gravity=tc.Gravity()))
    start = model.initial_state
    run = Case.run
    met = []

    def interrupted(case, step, **options):
        if pressed(options):
            met.append(step)
        if len(met) == (2 if pressed is is_energy_run else 1):
            raise KeyboardInterrupt
        return run(case, step, **options)

    monkeypatch.setattr(Case, "run", interrupted)
    advice = tc.recommend(
        model, 0.5, 1e-5, start, schemes=[tc.RungeKutta4()], corrections=[None], compiled=False
    )
    assert advice.error <= 1e-5
    assert advice.seconds > 0
    assert "interrupted from the keyboard before" in advice.message


@pytest.mark.parametrize("count", [1, 2])
def test_options_stay_after_ctrl_c_in_machine_code(monkeypatch, count):
    """Ctrl-C is pressed in the compiled runs of an implicit scheme after its search."""
    model, start = pendulum()
    run = Case.run
    met = []

    def interrupted(case, step, **options):
        if case.compiled is not False:
            met.append(step)
            if len(met) >= count:
                raise KeyboardInterrupt
            case = replace(case, compiled=False)
        return run(case, step, **options)

    monkeypatch.setattr(Case, "run", interrupted)
    advice = tc.recommend(model, 0.5, 1e-5, start, schemes=[tc.Collocation()], corrections=[None])
    assert advice.error <= 1e-5
    assert advice.seconds > 0
    assert "interrupted from the keyboard before Collocation were tested" in advice.message


@pytest.mark.slow  # the bar appears after two seconds
@pytest.mark.parametrize("progress", [True, False])
def test_progress_is_shown_after_two_seconds(monkeypatch, capsys, progress):
    model, start = pendulum()
    run = Case.run
    waits = [2.1]

    def slow(case, step, **options):
        time.sleep(waits.pop() if waits else 0.0)
        return run(case, step, **options)

    options = {"schemes": [tc.RungeKutta4()], "compiled": False, "progress": progress}
    tc.recommend(model, 0.5, 1e-5, start, **options)
    assert not capsys.readouterr().err
    monkeypatch.setattr(Case, "run", slow)
    tc.recommend(model, 0.5, 1e-5, start, **options)
    assert ("schemes" in capsys.readouterr().err) == progress


def hinged_twice():
    """A mass on a string below a bar that is pinned at both ends: IDAS cannot tell its constraints apart."""
    structure = tc.Structure(
        [(0, 0, 0), (1, 0, 0), (0, 0, -1)], [(0, 1)], [(0, 2)], node_mass=[0, 0, 1.0], pinned=[0, 1]
    )
    return tc.Model(tc.Scene(structure, gravity=tc.Gravity()))


def test_what_cannot_serve_is_left_out_and_told():
    scene = tc.Scene(tc.shapes.double_pendulum(), gravity=tc.Gravity())
    options = {"schemes": [tc.RungeKutta4()], "compiled": False}
    advice = tc.recommend(scene, 0.2, 1e-4, corrections=(tc.BarLengthCorrection(), None), **options)
    assert advice.correction is None
    assert "RungeKutta4 left out: BarLengthCorrection moves bars one by one" in advice.message
    with pytest.raises(
        tc.NoSchemeError, match=r"none of RungeKutta4 meets it.*BarLengthCorrection moves bars"
    ):
        tc.recommend(scene, 0.2, 1e-4, corrections=[tc.BarLengthCorrection()], **options)


def test_a_tolerance_beyond_rounding_has_no_reference():
    with pytest.raises(tc.NoReferenceError, match=r"wanted 1e-21 m"):
        tc.recommend(
            tc.Scene(tc.shapes.pendulum(), gravity=tc.Gravity()), 0.5, 1e-20, compiled=False
        )


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"model": 3}, "model"),
        ({"t_end": 0}, "t_end"),
        ({"tolerance": -1}, "tolerance"),
        ({"schemes": [tc.RungeKutta4]}, "scheme"),
        ({"schemes": []}, "schemes"),
        ({"time_limit": 0}, "time_limit"),
        ({"corrections": []}, "corrections"),
        ({"corrections": ["yes"]}, "corrections"),
        ({"state": np.zeros(2)}, "state"),
    ],
)
def test_wrong_input_is_named(change, named):
    arguments = {
        "model": tc.Scene(tc.shapes.pendulum(), gravity=tc.Gravity()),
        "t_end": 0.1,
        "tolerance": 1e-3,
        "compiled": False,
        **change,
    }
    with pytest.raises((TypeError, ValueError), match=named):
        tc.recommend(**arguments)


@pytest.mark.slow
def test_long_chains_are_told_to_take_full_coordinates() -> None:
    bars, ends = [(k, k + 1) for k in range(60)], np.array([(k, 0, k % 2) for k in range(61)])
    chain = tc.Scene(tc.Structure(ends, bars, pinned=[0]), gravity=tc.Gravity())
    advice = tc.recommend(
        tc.Model(chain, "reduced"),
        0.01,
        1e-3,
        schemes=[tc.RungeKutta4()],
        corrections=[None],
        compiled=False,
    )
    assert 'Model(scene, coordinates="full") is faster' in advice.message


def test_what_is_recommended_runs_with_success() -> None:
    """Damped in a moment: steps that get the places right at the end may have lost all energy on the way."""
    model = tc.Model(tc.Scene(tc.shapes.prism(stiffness=1000.0, damping=200.0, prestress=30.0)))
    velocities = 0.5 * np.sin(7.0 * np.arange(18)).reshape(6, 3)
    start = np.asarray(
        build_projection(model)(model.state(model.structure.nodes, velocities)).full()
    ).ravel()
    advice = tc.recommend(
        model, 0.3, 1e-3, state=start, schemes=[tc.DormandPrince853()], compiled=False
    )
    run = tc.simulate(model, 0.3, state=start, **advice.options, compiled=False)
    assert run.success, run.message
    truth = tc.simulate(model, 0.3, scheme=tc.Cvodes(1e-11), state=start)
    assert abs(run.nodes[-1] - truth.nodes[-1]).max() < 1e-3
