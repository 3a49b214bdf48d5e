"""Trade-off studies: what rows say is so, the front is one, the reference is certified or refused, and files keep all of it."""

from __future__ import annotations

import importlib
import itertools
import zipfile
from dataclasses import replace

import numpy as np
import pytest

import tenscasadi as tc
from tenscasadi.analysis.reference_solution import distance
from tenscasadi.dynamics.instruction_count import count_instructions
from tenscasadi.util.compile import find_compiler

needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="no C compiler")
STEPS = (0.02, 0.01, 0.005, 0.0025)


def spinning(**options):
    """A prism that turns and vibrates: smooth, no string goes slack."""
    prism = tc.shapes.prism(**{"prestress": 50.0, "stiffness": 500.0, **options})
    return tc.Model(tc.Scene(prism))


def start(model):
    nodes = model.structure.nodes
    return model.state(nodes, np.cross((1.0, 2.0, 3.0), nodes))


@pytest.fixture(scope="module")
def table():
    schemes = (tc.RungeKutta4(), tc.DormandPrince54())
    return tc.tradeoff(
        spinning(),
        0.5,
        schemes,
        STEPS,
        state=start,
        corrections=(None, tc.Projection(2)),
        repeats=1,
    )


# --- rows ---


def test_a_row_for_each_cell_of_the_grid(table):
    cells = [(row.scheme, row.correction, row.step) for row in table.rows]
    wanted = [
        (s, c, h)
        for s in (tc.RungeKutta4(), tc.DormandPrince54())
        for c in (None, tc.Projection(2))
        for h in STEPS
    ]
    assert cells == wanted
    assert table.complete
    assert all(row.success for row in table.rows)


def test_rows_say_what_simulate_gives(table):
    model = spinning()
    for row in (table.rows[1], table.rows[5]):
        run = tc.simulate(model, 0.5, row.step, row.scheme, start(model), correction=row.correction)
        fine = tc.simulate(model, 0.5, 1e-4, tc.DormandPrince853(), start(model))
        assert row.position == pytest.approx(distance(run.nodes[-1], fine.nodes[-1]), rel=1e-6)
        assert row.bar == pytest.approx(run.bar_length_error.max(), abs=1e-15)
        assert row.energy == pytest.approx(np.abs(run.energy_error).max(), abs=1e-12)
        assert row.steps == 0.5 / row.step


def test_errors_fall_with_the_schemes_order(table):
    for first in (0, 8):
        rows = table.rows[first : first + 4]
        orders = -np.diff(np.log2([row.position for row in rows]))
        assert orders == pytest.approx(rows[0].scheme.order, abs=0.7)


def test_instructions_are_of_a_step_with_its_share_of_the_correction(table):
    model = spinning()
    step = count_instructions(tc.RungeKutta4().advance(model))
    assert table.rows[0].instructions == step
    assert table.rows[4].instructions == round(
        step + count_instructions(tc.Projection().step(model)) / 2
    )
    assert table.rows[0].work == step * 25


def test_times_are_there_and_set_up_is_apart(table):
    assert all(row.seconds > 0 and row.setup > 0 for row in table.rows)
    # all steps of a way cost the same
    for first in range(0, 16, 4):
        rows = table.rows[first : first + 4]
        assert [row.seconds * row.step for row in rows] == pytest.approx(
            [rows[0].seconds * rows[0].step] * 4
        )


def test_a_run_that_diverges_is_told():
    table = tc.tradeoff(
        spinning(), 2.0, [tc.RungeKutta4()], [0.1, 0.005], state=start, compiled=(False,), repeats=1
    )
    assert [row.success for row in table.rows] == [False, True]
    assert "diverged" in table.rows[0].message
    assert table.pareto() == (table.rows[1],)
    assert "diverged" in table.summary()


def test_a_way_that_cannot_serve_is_told():
    model = tc.Model(tc.Scene(tc.shapes.double_pendulum(), gravity=tc.Gravity()))
    corrections = (tc.BarLengthCorrection(), None)
    table = tc.tradeoff(
        model,
        0.1,
        [tc.RungeKutta4()],
        [0.01],
        corrections=corrections,
        compiled=(False,),
        repeats=1,
    )
    assert [row.success for row in table.rows] == [False, True]
    assert "BarLengthCorrection moves bars one by one" in table.rows[0].message


def test_implicit_schemes_are_timed_over_the_whole_run():
    """Newton's method takes the longer the larger the step: steps that hardly move are no measure."""
    table = tc.tradeoff(
        spinning(), 0.5, [tc.Collocation(2)], [0.1, 0.01], state=start, compiled=(False,), repeats=1
    )
    coarse, fine = table.rows
    assert np.isnan(coarse.work)
    assert coarse.instructions == 0
    assert coarse.seconds * coarse.step != pytest.approx(fine.seconds * fine.step, rel=1e-9)


# --- front and choice ---


def test_no_row_beats_one_of_the_front(table):
    for cost in ("seconds", "work"):
        front = table.pareto(cost)
        value = (lambda row: row.seconds) if cost == "seconds" else (lambda row: row.work)
        for row in table.rows:
            beaten = any(value(f) <= value(row) and f.position <= row.position for f in front)
            assert beaten  # at least by itself
        assert [value(row) for row in front] == sorted(value(row) for row in front)
        assert all(a.position > b.position for a, b in itertools.pairwise(front))


def test_cheapest_is_the_cheapest_that_serves(table):
    row = table.cheapest(1e-6, "work")
    assert row.position + table.reference_error <= 1e-6
    assert row.work == min(other.work for other in table.rows if other.position <= 1e-6)


def test_cheapest_counts_the_references_own_error(table):
    row = table.cheapest(1e-6)
    doubtful = replace(table, reference_error=0.9999e-6)
    with pytest.raises(ValueError, match="add smaller steps"):
        doubtful.cheapest(1e-6)
    assert row.success
    with pytest.raises(ValueError, match=r"reference has an error of up to 1e-06 m"):
        doubtful.cheapest(1e-7)


def test_errors_below_that_of_the_reference_are_not_told_apart(table):
    doubtful = replace(table, reference_error=sorted(row.position for row in table.rows)[5])
    front = doubtful.pareto("work")
    assert sum(row.position <= doubtful.reference_error for row in front) == 1
    assert front[-1].work == min(
        row.work for row in table.rows if row.position <= doubtful.reference_error
    )
    assert f"< {doubtful.reference_error:.2g}" in doubtful.summary()


def test_a_study_without_good_runs_is_told(table):
    failed = replace(table, rows=tuple(replace(row, success=False) for row in table.rows))
    with pytest.raises(ValueError, match="all 16 runs failed"):
        failed.cheapest(1e-3)
    with pytest.raises(ValueError, match="there is no run"):
        replace(table, rows=(), reference_error=np.inf).cheapest(1e-3)


@pytest.mark.parametrize("tolerance", [0, -1.0, np.nan, "small"])
def test_a_tolerance_is_a_positive_number(table, tolerance):
    with pytest.raises((TypeError, ValueError), match="tolerance"):
        table.cheapest(tolerance)


def test_costs_have_two_names(table):
    with pytest.raises(ValueError, match='"seconds" or "work"'):
        table.pareto("money")


# --- reference ---


def test_the_reference_knows_its_error():
    model = spinning()
    reference = tc.reference_solution(model, 0.5, start(model))
    assert reference.error < 1e-11
    fine = tc.simulate(model, 0.5, 1e-4, tc.RungeKutta4(), start(model))
    assert distance(fine.nodes[-1], reference.nodes) < 1e-10
    assert not reference.nodes.flags.writeable


def test_chaos_has_no_reference():
    model = tc.Model(tc.Scene(tc.shapes.double_pendulum(angles=(2.5, 3.0)), gravity=tc.Gravity()))
    with pytest.raises(tc.NoReferenceError, match=r"end .* m apart.*smaller t_end"):
        tc.reference_solution(model, 60.0, max_instructions=1e8)


def test_two_that_diverge_are_no_reference():
    model = tc.Model(
        tc.Scene(tc.shapes.prism(prestress=50.0), control=tc.ForceDensity())
    )  # no events to locate
    fast = model.state(
        model.structure.nodes, 1e4 * np.cross((1.0, 2.0, 3.0), model.structure.nodes)
    )
    with pytest.raises(tc.NoReferenceError, match="the solutions diverge, the last: diverged"):
        tc.reference_solution(model, 0.1, fast, max_instructions=1e6)


def test_a_given_reference_is_used():
    model = spinning()
    elsewhere = tc.ReferenceSolution(model.structure.nodes + 1.0, 0.25, 0.1)
    table = tc.tradeoff(
        model, 0.1, [tc.RungeKutta4()], [0.01], elsewhere, compiled=(False,), repeats=1
    )
    assert table.reference_error == 0.25
    assert table.rows[0].position == pytest.approx(np.sqrt(3.0), rel=0.1)


# --- fidelities ---


def test_fidelities_are_measured_on_the_parents_nodes():
    prism = tc.shapes.prism(prestress=50.0, stiffness=500.0, string_mass=0.2)
    lumped = tc.Model(tc.Scene(prism, segments=2, ends="lumped"))
    models = {
        "2 segments": tc.Model(tc.Scene(prism, segments=2)),
        "lumped": lumped,
        "1": tc.Model(tc.Scene(prism)),
    }
    table = tc.tradeoff(
        models, 0.05, [tc.DormandPrince853()], [1e-3], state=start, compiled=(False,), repeats=1
    )
    finest, middle, coarse = (row.position for row in table.rows)
    assert finest < 1e-7
    assert middle > 1e-5
    assert coarse > 1e-5
    assert [row.fidelity for row in table.rows] == list(models)
    backwards = tc.tradeoff(
        models, 0.05, [tc.DormandPrince853()], [1e-3], "1", start, compiled=(False,), repeats=1
    )
    assert backwards.rows[2].position < 1e-9
    assert backwards.rows[0].position == pytest.approx(coarse, rel=1e-3)


def test_stiff_elastic_bars_approach_rigid_ones():
    stiffness = (1e4, 1e5)
    models = {"rigid": spinning(), **{f"{k:g}": spinning(bar_stiffness=k) for k in stiffness}}
    found = tc.tradeoff(
        models, 0.2, [tc.RungeKutta4()], [5e-4], state=start, compiled=[False], repeats=1
    )
    assert all(row.success for row in found.rows)
    rigid, soft, stiff = (row.position for row in found.rows)
    assert rigid < 1e-9
    assert soft / stiff == pytest.approx(10.0, rel=0.15)
    soft, stiff = (tc.stable_step(models[f"{k:g}"]) for k in stiffness)
    assert soft / stiff == pytest.approx(10**0.5, rel=0.1)


def test_compiled_and_not_are_told_apart():
    table = tc.tradeoff(
        spinning(), 0.1, [tc.RungeKutta4()], [0.01], compiled=(True, False), repeats=1
    )
    fast, slow = table.rows
    assert (fast.compiled, slow.compiled) == (True, False)
    assert fast.position == pytest.approx(slow.position, rel=1e-6)
    assert "virtual machine" in slow.name


@needs_compiler
def test_single_precision_has_a_floor_where_double_goes_on():
    """The same scheme, steps and instructions; the errors are those of the motion computed in float."""
    schemes, ways = [tc.RungeKutta4(), tc.DormandPrince853(rtol=1e-9)], (tc.Single(), False)
    table = tc.tradeoff(
        spinning(), 0.5, schemes, (4e-3, 2e-3, 1e-3, 2.5e-4), state=start, compiled=ways, repeats=1
    )
    single, double = table.rows[:4], table.rows[4:8]
    assert all(row.single and row.compiled and row.success for row in single)
    assert not any(row.single for row in double)
    assert single[0].name == "RungeKutta4, single precision"
    assert all(2e-7 < row.position < 5e-6 for row in single)
    assert all(1e-7 < row.bar < 5e-6 for row in single)
    assert double[-1].position < 5e-11
    assert [row.instructions for row in single] == [row.instructions for row in double]
    assert "single precision" in table.rows[8].message  # so fine an rtol is refused there
    assert table.rows[9].success


def test_error_control_is_one_curve_and_runs_once():
    schemes = [tc.DormandPrince54(rtol=rtol) for rtol in (1e-4, 1e-6)]
    table = tc.tradeoff(
        spinning(), 0.2, schemes, [0.1, 0.05], state=start, compiled=(False,), repeats=1
    )
    coarse, fine = table.rows
    assert np.isnan(coarse.step)
    assert coarse.steps < fine.steps
    assert coarse.position > fine.position
    assert coarse.seconds > 0
    assert coarse.curve == fine.curve == "DormandPrince54 with rtol, virtual machine"
    assert coarse.name != fine.name


def test_schemes_without_code_are_measured_too():
    table = tc.tradeoff(spinning(), 0.05, [tc.Cvodes(rtol=1e-8)], [0.05], state=start, repeats=1)
    (row,) = table.rows
    assert row.position < 1e-5
    assert not row.compiled
    assert np.isnan(row.work)
    assert table.pareto("work") == ()
    assert table.pareto() == (row,)
    (refused,) = tc.tradeoff(
        spinning(), 0.05, [tc.Cvodes()], [0.05], state=start, compiled=(True,), repeats=1
    ).rows
    assert not refused.success
    assert "C code" in refused.message


# --- interruption ---


def test_ctrl_c_keeps_the_rows_so_far(monkeypatch, tmp_path):
    module = importlib.import_module("tenscasadi.analysis.tradeoff")
    original, calls = module.simulate, []

    def some_time(*args, **options):
        calls.append(options)
        if len(calls) == 6:
            raise KeyboardInterrupt
        return original(*args, **options)

    monkeypatch.setattr(module, "simulate", some_time)
    table = tc.tradeoff(spinning(), 0.1, [tc.RungeKutta4()], STEPS, compiled=(False,), repeats=1)
    assert not table.complete
    assert 0 < len(table.rows) < len(STEPS)
    assert f"after {len(table.rows)} of 4" in table.message
    assert "interrupted" in table.summary()
    assert not tc.Tradeoff.load(table.save(tmp_path / "some.npz")).complete


def test_ctrl_c_inside_the_loop_counts_too(monkeypatch):
    module = importlib.import_module("tenscasadi.analysis.reference_solution")

    def ended(*args, **options):
        return replace(original(*args, **options), success=False, interrupted=True)

    original = module.simulate
    monkeypatch.setattr(module, "simulate", ended)
    table = tc.tradeoff(spinning(), 0.1, [tc.RungeKutta4()], STEPS, compiled=(False,), repeats=1)
    assert (table.rows, table.complete, table.reference_error) == ((), False, np.inf)


# --- files and pictures ---


def test_saved_and_loaded(table, tmp_path):
    path = table.save(tmp_path / "study.npz")
    assert repr(tc.Tradeoff.load(path)) == repr(table)  # NaN is not equal to itself
    assert tc.Tradeoff.load(path).rows[4].correction == tc.Projection(2)


def damaged(table, folder, **changes):
    path = table.save(folder / "study.npz")
    with np.load(path) as archive:
        content = {name: archive[name] for name in archive.files}
    content.update(changes)
    np.savez(path, **{name: value for name, value in content.items() if value is not None})
    return path


@pytest.mark.parametrize(
    "changes",
    [
        {"format": np.array("something else")},
        {"row_step": None},
        {"row_step": np.zeros(3)},
        {"row_scheme": np.array(["__import__('os').getcwd()"] * 16)},
        {"row_scheme": np.array(["RungeKutta4(speed=3)"] * 16)},
        {"row_scheme": np.array(["RungeKutta4("] * 16)},
        {"row_scheme": np.array(["Path()"] * 16)},
        {"t_end": np.zeros(2)},
        {"more": np.zeros(2)},
    ],
)
def test_foreign_files_are_refused(table, tmp_path, changes):
    with pytest.raises(ValueError, match=r"study\.npz is not a trade-off: "):
        tc.Tradeoff.load(damaged(table, tmp_path, **changes))


def with_one(values, number):
    changed = np.array(values)
    changed[0] = number
    return changed


@pytest.mark.parametrize(
    ("field", "number"),
    [
        *(
            (f"row_{name}", number)
            for name in ("position", "bar", "joint")
            for number in (np.nan, np.inf, -1.0)
        ),
        *(("row_step", number) for number in (0.0, -0.1, np.inf)),
        *(("row_seconds", number) for number in (-1.0, np.inf)),
        *((f"row_{name}", -1) for name in ("energy", "instructions", "steps")),
        *(("t_end", number) for number in (0.0, np.nan, np.inf, -1.0)),
        *(("reference_error", number) for number in (np.nan, -1.0)),
    ],
)
def test_numbers_that_no_study_can_have_are_refused_by_name(table, tmp_path, field, number):
    assert table.rows[0].success
    value = (
        with_one([getattr(row, field[4:]) for row in table.rows], number)
        if field.startswith("row_")
        else np.asarray(number)
    )
    with pytest.raises(ValueError, match=rf"study\.npz is not a trade-off: field '{field}' is "):
        tc.Tradeoff.load(damaged(table, tmp_path, **{field: value}))


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("row_success", 1.0),
        ("row_message", 3),
        ("row_position", "0"),
        ("row_steps", 1.5),
        ("t_end", "x"),
    ],
)
def test_values_of_another_kind_are_refused_by_name(table, tmp_path, field, value):
    with pytest.raises(
        ValueError, match=rf"study\.npz is not a trade-off: field '{field}' holds values of type"
    ):
        tc.Tradeoff.load(
            damaged(
                table,
                tmp_path,
                **{
                    field: np.full(len(table.rows), value)
                    if field.startswith("row_")
                    else np.asarray(value)
                },
            )
        )


def test_a_study_without_rows_is_loaded(table, tmp_path):
    empty = replace(table, rows=(), complete=False, reference_error=np.inf)
    assert tc.Tradeoff.load(empty.save(tmp_path / "study.npz")) == empty


def test_files_that_are_none(tmp_path):
    with pytest.raises(FileNotFoundError):
        tc.Tradeoff.load(tmp_path / "none.npz")
    for name, content in {"empty.npz": b"", "text.npz": b"hello"}.items():
        (tmp_path / name).write_bytes(content)
        with pytest.raises(ValueError, match=name):
            tc.Tradeoff.load(tmp_path / name)
    with zipfile.ZipFile(tmp_path / "zip.npz", "w") as archive:
        archive.writestr("a.txt", "hello")
    with pytest.raises(ValueError, match=r"zip\.npz"):
        tc.Tradeoff.load(tmp_path / "zip.npz")


def test_plot(table, tmp_path):
    figure = table.plot(tmp_path / "study.png", title="a prism")
    assert (tmp_path / "study.png").stat().st_size > 10_000
    (axes,) = figure.axes
    assert axes.get_xscale() == axes.get_yscale() == "log"
    names = {text.get_text() for text in figure.legends[0].get_texts()}
    assert names == {row.curve for row in table.rows}
    line = next(line for line in axes.lines if line.get_label() == "RungeKutta4")
    assert sorted(line.get_xdata()) == pytest.approx(sorted(row.position for row in table.rows[:4]))


def test_summary_has_a_line_for_each_row(table):
    lines = table.summary().splitlines()
    assert len(lines) == 1 + len(table.rows) + 2
    assert sum(line.startswith("*") for line in lines) == len(table.pareto())


# --- input ---


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"models": {}}, "models"),
        ({"models": "prism"}, "models"),
        ({"models": {"a": 3}}, r"models\['a'\]"),
        ({"t_end": 0}, "t_end"),
        ({"schemes": []}, "schemes"),
        ({"schemes": tc.RungeKutta4()}, "schemes"),
        ({"schemes": [tc.RungeKutta4]}, r"schemes\[0\]"),
        ({"progress": np.ones(2)}, "progress"),
        ({"reference": [1.0]}, "reference"),
        ({"state": lambda model: model.nothing}, "state fails with AttributeError"),
        ({"steps": []}, "steps"),
        ({"steps": [0.1, -1]}, r"steps\[1\]"),
        ({"steps": 0.1}, "steps"),
        ({"corrections": tc.Projection()}, "corrections"),
        ({"corrections": ["yes"]}, "corrections"),
        ({"reference": "finest"}, "reference"),
        ({"reference": tc.ReferenceSolution(np.zeros((2, 3)), 0.0, 0.1)}, "2 nodes"),
        ({"reference": tc.ReferenceSolution(np.zeros((6, 3)), 0.0, 0.2)}, "t_end"),
        ({"repeats": 0}, "repeats"),
        ({"compiled": True}, "compiled"),
        ({"compiled": np.array(True)}, "compiled is"),
        ({"compiled": ["yes"]}, r"Single\(\)"),
        ({"state": np.zeros(3)}, "state"),
    ],
)
def test_wrong_input_is_named(change, named):
    arguments = {
        "models": spinning(),
        "t_end": 0.1,
        "schemes": [tc.RungeKutta4()],
        "steps": [0.01],
        "compiled": (False,),
        **change,
    }
    with pytest.raises((TypeError, ValueError), match=named):
        tc.tradeoff(**arguments)


ROW = {
    "scheme": tc.RungeKutta4(),
    "step": 0.1,
    "correction": None,
    "fidelity": "",
    "compiled": True,
    "single": False,
}


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("scheme", "RungeKutta4"),
        ("step", "0.1"),
        ("seconds", 10**400),
        ("bar", [1.0]),
        ("steps", 1.5),
        ("compiled", np.ones(2)),
        ("message", 3),
    ],
)
def test_rows_are_checked(field, value):
    with pytest.raises((TypeError, ValueError), match=rf"^TradeoffRow\.{field} is"):
        tc.TradeoffRow(**{**ROW, field: value})


@pytest.mark.parametrize(
    ("field", "value"),
    [("rows", 3), ("rows", (3,)), ("t_end", "1"), ("reference_error", None), ("complete", 1.0)],
)
def test_studies_are_checked(field, value):
    with pytest.raises(TypeError, match=rf"^Tradeoff\.{field}(\[0\])? is"):
        tc.Tradeoff(
            **{
                "rows": (),
                "t_end": 1.0,
                "reference_error": 0.0,
                "reference_message": "",
                field: value,
            }
        )
    with pytest.raises(ValueError, match=r"^cost is"):
        tc.Tradeoff((), 1.0, 0.0, "").pareto(np.ones(2))


def test_models_of_other_structures_are_refused():
    with pytest.raises(ValueError, match="nodes"):
        tc.tradeoff({"a": spinning(), "b": spinning(bars=4)}, 0.1, [tc.RungeKutta4()], [0.01])


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ((np.zeros((2, 2)), 0.0, 1.0), "nodes"),
        ((np.zeros((2, 3)), -1.0, 1.0), "error"),
        ((np.zeros((2, 3)), 0.0, 0.0), "t_end"),
    ],
)
def test_references_are_checked(arguments, named):
    with pytest.raises(ValueError, match=f"ReferenceSolution.{named}"):
        tc.ReferenceSolution(*arguments)
