"""What identifies a case: the same content gives the same key in any process, other content another one; results are plain."""

from __future__ import annotations

import copy
import os
import random
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import tenscasadi as tc
from tenscasadi.sweeps.case_files import CaseFiles, CaseOutcome, check_results
from tenscasadi.sweeps.identity import case_key

PLAIN = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(allow_nan=False), st.text(max_size=5)
)
NAMES = st.text(max_size=3)
CASES = st.recursive(
    PLAIN,
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(NAMES, inner, max_size=3)),
    max_leaves=8,
)


def key(case):
    return case_key("job", case, "case")


def test_a_key_is_the_same_on_every_machine():
    """SHA-256 of ["job", ["dict", [["seed", 3], ["stiffness", 100.5]]]], computed by the shell."""
    assert key({"stiffness": 100.5, "seed": 3}) == "76d0dde84487e2790131c9f56f2f5d9e"


@given(CASES, CASES)
@settings(max_examples=30)
def test_keys_tell_cases_apart(one, other):
    assert key(copy.deepcopy(one)) == key(one)
    if one != other:
        assert key(one) != key(other)


def test_numbers_of_numpy_are_numbers():
    assert key({"a": np.float64(0.1), "b": np.int32(3), "c": np.bool_(True)}) == key(
        {"b": 3, "c": True, "a": 0.1}
    )
    assert key(np.arange(3)) == key(np.arange(3).astype(">i8")) != key(np.arange(3.0))
    assert key(np.zeros((2, 3))) != key(np.zeros((3, 2)))
    assert key(np.arange(6).reshape(2, 3).T) == key(np.arange(6).reshape(2, 3).T.copy())


def test_structures_scenes_models_and_options():
    prism = tc.shapes.prism()
    scene = tc.Scene(prism, gravity=tc.Gravity())
    values = [
        prism,
        prism.replace(stiffness=101.0),
        scene,
        replace(scene, gravity=None),
        tc.Model(scene),
        tc.Model(scene, coordinates="full"),
        tc.RungeKutta4(),
        tc.DormandPrince54(),
        tc.DormandPrince54(rtol=1e-6),
    ]
    keys = [key(value) for value in values]
    assert len(set(keys)) == len(values)
    assert keys == [key(copy.deepcopy(value)) for value in values]


@pytest.mark.parametrize(
    "value",
    [
        object(),
        {1: 2},
        b"bytes",
        ca.MX.sym("x"),
        np.array([None]),
        tc.NodalForce(lambda t: np.zeros((6, 3))),
    ],
    ids=lambda v: type(v).__name__,
)
def test_value_without_identity_is_rejected(value):
    with pytest.raises(
        TypeError,
        match=r"case(\['a'\]\[0\])(\.values)? is .* which cannot identify a case in a folder: give numbers, text",
    ):
        key({"a": [value]})


# --- results ---


def test_results_are_numbers_text_and_arrays():
    given = {"a": np.float32(0.5), "b": [1, 2], "c": "ä", "d": ca.DM([1, 2]), "e": 1j}
    results = check_results(given)
    assert [type(value).__name__ for value in results.values()] == [
        "float",
        "ndarray",
        "str",
        "ndarray",
        "complex",
    ]
    assert check_results(3) == {"result": 3}
    assert check_results(None) == {}


@pytest.mark.parametrize("value", [None, {1: 2}, [[1], [2, 3]], 10**30], ids=str)
def test_invalid_results_are_rejected(value):
    with pytest.raises(
        TypeError,
        match=r"result 'a' is of type .*: return numbers, text, or arrays of them \(NaN for None\)",
    ):
        check_results({"a": value})
    with pytest.raises(TypeError, match="a result named 1: name results by text"):
        check_results({1: 2.0})


def test_files_restore_written_values(tmp_path):
    values = {
        "number": 0.1,
        "whole": 3,
        "flag": True,
        "text": "ä\n",
        "empty": "",
        "complex": 1j,
        "matrix": np.arange(6.0).reshape(2, 3),
        "a/b": 1,
    }
    values |= {"texts": np.array(["a", "bcd"]), "none": np.zeros((0, 3))}
    files = CaseFiles(tmp_path / "new" / "folder", check_results)
    name = files.key({"x": 1}, "case")
    files.write(name, {"x": 1}, CaseOutcome(values, "", 0.25))
    again = files.read([name, "0" * 32])[name]
    assert (again.error, again.seconds, list(again.values)) == ("", 0.25, list(values))
    for field, value in values.items():
        assert type(again.values[field]) is type(value), field
        np.testing.assert_array_equal(again.values[field], value)
    files.write(name, {"x": 1}, CaseOutcome({}, "ValueError: no", 0.25))
    assert files.read([name]) == {}
    assert files.found == 1


# --- files that others have made ---


class Trap:
    """What runs when a pickle is read."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


def doubled(case):
    return {"double": 2 * case, "text": "ä"}


def sweep_of(folder):
    with ThreadPoolExecutor(1) as executor:
        return tc.sweep(doubled, [1.5, 2.5], executor, folder)


def test_damaged_files_are_never_taken_for_results(tmp_path):
    sweep_of(tmp_path)
    file = sorted(tmp_path.glob("*.npz"))[0]
    whole, draw = file.read_bytes(), random.Random(0)
    for _ in range(100):
        content = bytearray(whole)
        if draw.random() < 0.3:
            content = content[: draw.randrange(len(content))]
        else:
            for _ in range(draw.choice([1, 3, 20])):
                content[draw.randrange(len(content))] ^= 1 << draw.randrange(8)
        file.write_bytes(content)
        table = sweep_of(tmp_path)
        assert table["double"].tolist() == [3.0, 5.0]
        assert table["text"].tolist() == ["ä", "ä"]


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("case", "3.5"),
        ("case", 1.5),
        ("case", None),
        ("error", 3),
        ("seconds", "1"),
        ("source", None),
        ("home", 1.0),
        ("format", "tenscasadi plan 1"),
    ],
)
def test_files_of_other_content_are_computed_again(tmp_path, field, value):
    sweep_of(tmp_path)
    for file in tmp_path.glob("*.npz"):
        with np.load(file) as stored:
            fields = {name: stored[name] for name in stored.files if name != field}
        np.savez(file, **fields, **({} if value is None else {field: np.asarray(value)}))
    table = sweep_of(tmp_path)
    assert table["double"].tolist() == [3.0, 5.0]
    assert table.message.endswith("2 files could not be read, their cases were computed again")


def test_a_file_of_another_case_is_not_taken_for_this_one(tmp_path):
    sweep_of(tmp_path)
    first, second = sorted(tmp_path.glob("*.npz"))
    first.write_bytes(second.read_bytes())
    table = sweep_of(tmp_path)
    assert table["double"].tolist() == [3.0, 5.0]
    assert "1 computed, 1 read" in table.message


def test_no_code_in_files_is_run(tmp_path):
    sweep_of(tmp_path / "results")
    for file in (tmp_path / "results").glob("*.npz"):
        with np.load(file) as stored:
            fields = dict(stored)
        np.savez(
            file,
            **{**fields, "value.double": np.array(Trap(tmp_path / "ran"), dtype=object)},
            allow_pickle=True,
        )
    with np.load(file, allow_pickle=True) as stored:
        stored["value.double"]
    (tmp_path / "ran").unlink()  # the trap works
    assert sweep_of(tmp_path / "results")["double"].tolist() == [3.0, 5.0]
    assert not (tmp_path / "ran").exists()


def test_a_folder_or_a_pipe_in_the_place_of_a_file_is_not_read(tmp_path):
    sweep_of(tmp_path)
    first, second = sorted(tmp_path.glob("*.npz"))
    files = CaseFiles(tmp_path, doubled)
    first.unlink()
    first.mkdir()
    second.unlink()
    if hasattr(os, "mkfifo"):
        os.mkfifo(second)
    assert files.read([first.stem, second.stem]) == {}
