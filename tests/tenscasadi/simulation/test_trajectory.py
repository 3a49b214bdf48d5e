"""Trajectories: saved and loaded unchanged, and no file can do harm."""

from __future__ import annotations

import dataclasses
import io
import pickle
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from runs import moving

from tenscasadi.dynamics.model import Model
from tenscasadi.scene.loads import Gravity
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import RestLength
from tenscasadi.schema.stored import array_fields
from tenscasadi.simulation.trajectory import Trajectory, observe_states
from tenscasadi.structure import shapes


def example(rows: int = 4, **changes: Any) -> Trajectory:
    random = np.random.default_rng(0)
    fields: dict[str, Any] = {
        "time": np.linspace(0, 1, rows), "nodes": random.normal(size=(rows, 3, 3)), "velocities": random.normal(size=(rows, 3, 3)),
        "force_density": random.normal(size=(rows, 2)), "tension": random.normal(size=(rows, 2)), "energy": random.normal(size=rows),
        "energy_parts": random.normal(size=(rows, 3)), "energy_error": np.full(rows, np.nan), "bar_length_error": np.zeros(rows),
        "joint_error": np.zeros(rows), "correction_shift": np.zeros(rows), "correction_energy": np.zeros(rows),
        "states": random.normal(size=(rows, 18)), "control": np.zeros((rows, 0)),
        "bars": np.array([[0, 1]]), "strings": np.array([[1, 2], [2, 0]]), "pinned": np.array([0]),
        "success": True, "message": "finished: γ → 0", "step": 0.1, "seconds": 0.01, "compiled": False,
        "attempts": 12, "interrupted": True,
    }  # fmt: skip
    return Trajectory(**(fields | changes))


def content(trajectory: Trajectory) -> dict[str, Any]:
    return {name: getattr(trajectory, name) for name in array_fields(Trajectory)}


def test_saved_and_loaded_unchanged(tmp_path: Path) -> None:
    for name in ("run.npz", "run"):  # the name is kept as it is
        path = example().save(tmp_path / name)
        assert path == tmp_path / name
        loaded = content(Trajectory.load(str(path)))
        for field, value in content(example()).items():
            assert type(loaded[field]) is type(value), field
            assert np.array_equal(loaded[field], value, equal_nan=not isinstance(value, str)), field
            if isinstance(value, np.ndarray):
                assert loaded[field].dtype == value.dtype, field


def test_arrays_are_read_only_and_the_callers_stay_writable() -> None:
    own = np.zeros(4)
    trajectory = example(energy=own)
    with pytest.raises(ValueError, match="read-only"):
        trajectory.energy[0] = 1
    own[0] = 1
    with pytest.raises(dataclasses.FrozenInstanceError):
        trajectory.step = 1.0  # type: ignore[misc]


def test_the_file_holds_no_objects(tmp_path: Path) -> None:
    example().save(tmp_path / "run.npz")
    with np.load(tmp_path / "run.npz", allow_pickle=False) as archive:
        assert {archive[name].dtype.kind for name in archive.files} <= set("fibU")


@pytest.mark.parametrize("field", ["time", "nodes", "pinned", "success"])
def test_fields_without_a_value_are_named(field: str) -> None:
    with pytest.raises(ValueError, match=f"field '{field}' is None: give its value"):
        example(**{field: None})


def test_summary_and_repr() -> None:
    text = example(
        energy_error=np.array([0, 1e-9, np.nan, -2e-9]), bar_length_error=np.array([0, 3e-7, 0, 0])
    ).summary()
    for part in (
        "finished: γ → 0",
        "10 steps of 0.1 s by 12 attempts",
        "1,000 steps/s",
        "not compiled, interrupted",
        "2e-09 J",
        "3e-07",
    ):
        assert part in text
    assert "not computed" in example().summary()
    assert "correction" not in example().summary()
    assert (
        "correction    moves a node by 2e-08 m"
        in example(correction_shift=np.array([0, 2e-8, 0, 0])).summary()
    )
    assert (
        "correction    effect not measured"
        in example(correction_shift=np.full(4, np.nan)).summary()
    )
    assert repr(example()) == "Trajectory(4 rows, 3 nodes, t = 0 … 1 s, success=True)"


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("nodes", np.zeros((4, 3, 2))), ("nodes", np.zeros((3, 3, 3))), ("velocities", np.zeros((4, 2, 3))), ("tension", np.zeros((4, 1))),
        ("control", np.zeros((3, 1))), ("energy", np.zeros(4, dtype=int)), ("bars", np.array([[0, 3]])), ("strings", np.array([[-1, 0], [0, 1]])),
        ("pinned", np.array([0.0])), ("pinned", np.array([7])), ("success", 1), ("message", 3), ("step", "0.1"), ("time", np.array([None] * 4)),
        ("attempts", 1.5), ("interrupted", 1), ("time", np.zeros(0)),
    ],
)  # fmt: skip
def test_fields_that_do_not_fit_are_named(field: str, value: Any, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=f"field '(time|nodes|{field})'"):
        example(**{field: value})
    saved = {name: np.asarray(own) for name, own in content(example()).items()} | {
        field: np.asarray(value)
    }
    if saved[field].dtype.kind != "O":
        np.savez(tmp_path / "run.npz", format="tenscasadi trajectory 1", **saved)
        with pytest.raises(
            ValueError, match=rf"run\.npz is not a trajectory: field '(time|nodes|{field})'"
        ):
            Trajectory.load(tmp_path / "run.npz")


def one_wrong(value: Any, place: tuple[int, ...], number: float) -> np.ndarray[Any, Any]:
    array = np.array(value, dtype=float)
    array[place] = number
    return array


FINITE = [
    "nodes",
    "velocities",
    "force_density",
    "tension",
    "energy",
    "energy_parts",
    "bar_length_error",
    "joint_error",
    "states",
]


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("time", np.linspace(1, 0, 4)), ("time", np.array([0.0, 0.5, 0.5, 1.0])), ("time", np.array([0.0, 0.5, np.nan, 1.0])),
        ("time", np.array([0.0, 0.5, 0.7, np.inf])), ("step", 0.0), ("step", -0.1), ("step", np.nan), ("seconds", -1.0), ("attempts", -1),
        *((name, number) for name in FINITE for number in (np.nan, -np.inf)),
    ],
)  # fmt: skip
def test_numbers_that_no_run_can_have_are_refused_by_name(
    field: str, value: Any, tmp_path: Path
) -> None:
    own = content(example())[field]
    value = one_wrong(own, (-1,) * own.ndim, value) if field in FINITE else value
    saved = {name: np.asarray(own) for name, own in content(example()).items()} | {
        field: np.asarray(value)
    }
    np.savez(tmp_path / "run.npz", format="tenscasadi trajectory 1", **saved)
    with pytest.raises(ValueError, match=rf"run\.npz is not a trajectory: field '{field}' is "):
        Trajectory.load(tmp_path / "run.npz")


def test_a_run_that_failed_is_loaded_with_what_is_not_finite(tmp_path: Path) -> None:
    failed = example(
        success=False, nodes=np.full((4, 3, 3), np.nan), energy=np.array([0.0, 1.0, np.inf, np.nan])
    )
    loaded = Trajectory.load(failed.save(tmp_path / "run.npz"))
    assert np.array_equal(loaded.nodes, failed.nodes, equal_nan=True)
    assert not loaded.success


def test_missing_fields_and_foreign_files_are_named(tmp_path: Path) -> None:
    fields = content(example())
    for field in set(fields) - {
        "attempts",
        "interrupted",
        "parameters",
        "error_estimate",
    }:  # which older files lack
        np.savez(
            tmp_path / "run.npz",
            format="tenscasadi trajectory 1",
            **{name: value for name, value in fields.items() if name != field},
        )
        with pytest.raises(
            ValueError, match=rf"run\.npz is not a trajectory: it has no field '{field}'"
        ):
            Trajectory.load(tmp_path / "run.npz")
    np.savez(tmp_path / "run.npz", **fields)
    with pytest.raises(ValueError, match="'format'"):
        Trajectory.load(tmp_path / "run.npz")
    np.save(tmp_path / "one.npy", np.zeros(3))
    for name, data in {"text.npz": b"once upon a time", "empty.npz": b"", "one.npy": None}.items():
        if data is not None:
            (tmp_path / name).write_bytes(data)
        with pytest.raises(ValueError, match=name):
            Trajectory.load(tmp_path / name)
    with pytest.raises(ValueError, match="cannot be read"):
        Trajectory.load(tmp_path)
    with pytest.raises(FileNotFoundError, match="nowhere"):
        Trajectory.load(tmp_path / "nowhere.npz")


def test_files_from_before_attempts_were_counted(tmp_path: Path) -> None:
    older = {
        name: value
        for name, value in content(example()).items()
        if name not in ("attempts", "interrupted")
    }
    np.savez(tmp_path / "old.npz", format="tenscasadi trajectory 1", **older)
    loaded = Trajectory.load(tmp_path / "old.npz")
    assert (loaded.attempts, loaded.interrupted) == (0, False)
    assert "attempts" not in loaded.summary()
    assert np.array_equal(loaded.nodes, example().nodes)


class Harm:
    """Writes a file when unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return Path.touch, (self.path,)


@pytest.mark.parametrize("field", ["format", "message", "nodes", "other"])
def test_pickles_are_never_opened(field: str, tmp_path: Path) -> None:
    harm = np.empty(1, dtype=object)
    harm[0] = Harm(tmp_path / "harm")
    saved = {"format": np.asarray("tenscasadi trajectory 1")} | content(example()) | {field: harm}
    np.savez(tmp_path / "run.npz", allow_pickle=True, **saved)
    with pytest.raises(ValueError, match=r"run\.npz"):
        Trajectory.load(tmp_path / "run.npz")
    (tmp_path / "bare.npz").write_bytes(pickle.dumps(Harm(tmp_path / "harm")))
    with pytest.raises(ValueError, match=r"bare\.npz"):
        Trajectory.load(tmp_path / "bare.npz")
    assert not (tmp_path / "harm").exists()


def test_an_array_that_lies_about_its_size_is_refused(tmp_path: Path) -> None:
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        header, {"descr": "<f8", "fortran_order": False, "shape": (10**12, 3, 3)}
    )
    example().save(tmp_path / "run.npz")
    with (
        zipfile.ZipFile(tmp_path / "run.npz") as old,
        zipfile.ZipFile(tmp_path / "lie.npz", "w") as new,
    ):
        for name in old.namelist():
            new.writestr(name, header.getvalue() if name == "nodes.npy" else old.read(name))
    with pytest.raises(ValueError, match=r"lie\.npz"):
        Trajectory.load(tmp_path / "lie.npz")


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_damaged_files_give_a_trajectory_or_a_value_error(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    folder = tmp_path_factory.getbasetemp()
    whole = bytearray((example().save(folder / "whole.npz")).read_bytes())
    for _ in range(data.draw(st.integers(1, 8))):
        whole[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))
    (folder / "damaged.npz").write_bytes(
        whole[: data.draw(st.integers(0, len(whole)))] if data.draw(st.booleans()) else whole
    )
    message = ""
    try:
        assert Trajectory.load(folder / "damaged.npz").nodes.shape == (4, 3, 3)
    except ValueError as error:
        message = str(error)
    assert not message or "damaged.npz" in message


def test_observed_is_what_the_model_says_row_by_row() -> None:
    model = Model(
        Scene(
            shapes.d_bar(pinned=(0,), prestress=10.0),
            control=RestLength(),
            gravity=Gravity((0, 0, -9.81)),
        ),
        "full",
    )
    states = moving(model) + 1e-3 * np.random.default_rng(0).normal(size=(5, model.nx))
    observed = observe_states(model, states, np.tile(model.initial_control, (5, 1)))
    for row, x in enumerate(states):
        assert observed["nodes"][row].reshape(-1, 3) == pytest.approx(model.nodes(x))
        assert observed["velocities"][row].reshape(-1, 3) == pytest.approx(model.velocities(x))
        assert observed["tension"][row] == pytest.approx(model.tension(x))
        assert observed["energy"][row] == pytest.approx(np.array(model.energy(x)))
        assert observed["bar_length_error"][row, 0] == pytest.approx(model.bar_length_error(x))
        assert observed["joint_error"][row, 0] == pytest.approx(model.joint_error(x))
