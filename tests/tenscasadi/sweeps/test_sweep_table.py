"""Tables of sweeps: columns as NumPy arrays, whatever is missing, and as comma-separated values."""

from __future__ import annotations

import csv
import io

import numpy as np
import pytest

import tenscasadi as tc


def table(cases, results, errors=None):
    count = len(cases)
    return tc.Sweep(
        tuple(cases),
        tuple(results),
        tuple(errors or [""] * count),
        np.full(count, 0.5),
        f"{count} cases",
    )


def test_columns_are_arrays_of_their_kind():
    made = table(
        [{"k": 1, "name": "a"}, {"k": 2.5, "name": "b"}],
        [
            {"whole": 1, "flag": True, "path": np.zeros((2, 3)), "z": 1j},
            {"whole": 2, "flag": False, "path": np.ones((2, 3)), "z": 2},
        ],
    )
    assert {name: (column.dtype.kind, column.shape) for name, column in made.columns.items()} == {
        "k": ("f", (2,)),
        "name": ("U", (2,)),
        "whole": ("i", (2,)),
        "flag": ("b", (2,)),
        "path": ("f", (2, 2, 3)),
        "z": ("c", (2,)),
    }
    assert made["path"][1].tolist() == np.ones((2, 3)).tolist()


def test_missing_results_are_nan_or_empty():
    made = table(
        [{"k": 1}, {"m": "x"}, {}],
        [{"whole": 3, "text": "t", "row": [1, 2]}, {}, {}],
        ["", "Traceback\n  …\nValueError: no\n", ""],
    )
    np.testing.assert_array_equal(made["k"], [1.0, np.nan, np.nan])
    np.testing.assert_array_equal(made["row"], [[1, 2], [np.nan] * 2, [np.nan] * 2])
    assert made["m"].tolist() == ["", "x", ""]
    assert made["text"].tolist() == ["t", "", ""]
    assert made.success.tolist() == [True, False, True]
    assert [row["case_error"] for row in csv.DictReader(made.to_csv().splitlines())] == [
        "",
        "ValueError: no",
        "",
    ]


def test_odd_values_give_columns_of_objects():
    prism = tc.shapes.prism()
    made = table(
        [{"s": prism, "v": [1]}, {"s": None, "v": [1, 2]}, {"s": prism, "v": "a"}],
        [{"m": [[1], [2, 3]]}, {}, {"m": 1}],
    )
    assert made["s"].tolist() == [prism, None, prism]
    assert made["v"].tolist() == [[1], [1, 2], "a"]
    assert made["m"].tolist() == [[[1], [2, 3]], None, 1]


def test_cases_that_are_no_dicts_and_names_that_clash():
    made = table([1.5, "b"], [{"case": 2}, {"case": 3}])
    assert made["case"].tolist() == [1.5, "b"]
    assert made["result.case"].tolist() == [2, 3]
    with pytest.raises(KeyError, match=r"no column 'k': give one of case, result\.case"):
        made["k"]


def test_csv_is_read_by_others(tmp_path):
    made = table(
        [{"k": 0.1, "note": 'a "b", c'}, {"k": np.nan, "note": "two\nlines"}],
        [{"p": np.array([[1.0, 2.0], [3.0, 1e-17]])}, {}],
    )
    text = made.to_csv(tmp_path / "table.csv")
    assert (tmp_path / "table.csv").read_text(encoding="utf-8") == text
    rows = list(csv.DictReader(io.StringIO(text, newline="")))
    assert list(rows[0]) == [
        "k",
        "note",
        "p[0,0]",
        "p[0,1]",
        "p[1,0]",
        "p[1,1]",
        "case_seconds",
        "case_error",
    ]
    assert float(rows[0]["p[1,1]"]) == 1e-17
    assert [row["note"] for row in rows] == ['a "b", c', "two\nlines"]
    assert rows[1]["k"] == rows[1]["p[0,0]"] == ""


def test_tables_do_not_change():
    made = table([1], [{}])
    with pytest.raises(ValueError, match="read-only"):
        made.seconds[0] = 1.0
    with pytest.raises(AttributeError):
        made.message = ""


@pytest.mark.parametrize(
    ("field", "value"),
    [("results", ()), ("errors", ("", "")), ("seconds", [1.0, 2.0]), ("success", [])],
)
def test_columns_are_as_long_as_the_table(field, value):
    given = {
        "cases": (1,),
        "results": ({},),
        "errors": ("",),
        "seconds": [0.1],
        "message": "",
        field: value,
    }
    with pytest.raises(ValueError, match=rf"Sweep\.{field} has"):
        tc.Sweep(**given)
