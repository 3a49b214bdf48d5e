"""Tables of motions and plans: what other programs read from them is what was computed, to the last bit."""

from __future__ import annotations

import csv
import sys
from dataclasses import replace

import numpy as np
import pytest
from public_calls import plan

import tenscasadi as tc

STRINGS = tc.shapes.prism().string_names


@pytest.fixture(scope="module")
def run():
    model = tc.Model(
        tc.Scene(
            tc.shapes.prism(stiffness=1000.0, prestress=30.0),
            control=tc.ForceDensity(),
            gravity=tc.Gravity(),
        )
    )
    return tc.simulate(model, 0.05, 0.01, compiled=False)


def read(path):
    with open(path, encoding="utf-8", newline="") as file:
        names, *rows = csv.reader(file)
    return names, np.array(rows, dtype=float)


def test_a_trajectory_comes_back_to_the_last_bit(run, tmp_path):
    names, table = read(run.to_csv(tmp_path / "run.csv"))
    assert names[:4] == ["time (s)", *(f"node bottom[0] {axis} (m)" for axis in "xyz")]
    assert len(set(names)) == len(names) == table.shape[1]
    assert np.array_equal(table[:, 0], run.time)
    assert np.array_equal(table[:, 1:19].reshape(-1, 6, 3), run.nodes)
    assert np.array_equal(
        table[:, names.index("node top[2] velocity z (m/s)")], run.velocities[:, 5, 2]
    )
    assert np.array_equal(
        table[:, names.index("string vertical[2] tension (N)")], run.tension[:, 8]
    )
    assert np.array_equal(
        table[:, names.index("string bottom[0] force density (N/m)")], run.force_density[:, 0]
    )
    assert np.array_equal(table[:, names.index("gravitational energy (J)")], run.energy_parts[:, 2])
    assert np.array_equal(table[:, names.index("control 8")], run.control[:, 8])


def test_what_is_not_known_is_nan(run, tmp_path):
    names, table = read(replace(run, energy_error=np.full(6, np.nan)).to_csv(tmp_path / "run.csv"))
    assert np.isnan(table[:, names.index("energy error (J)")]).all()


def test_pandas_reads_the_file_as_it_is_given_the_table(run, tmp_path):
    pd = pytest.importorskip("pandas", reason="tenscasadi[exchange] is not installed")
    table = run.to_pandas()
    assert table.index.name == "time (s)"
    assert table.shape == (6, 18 + 18 + 9 + 9 + 7 + 9)
    assert table.loc[run.time[3], "node bottom[1] y (m)"] == run.nodes[3, 1, 1]
    again = pd.read_csv(run.to_csv(tmp_path / "run.csv"), index_col=0)
    pd.testing.assert_frame_equal(again, table, rtol=1e-14)  # its own reader may be one bit off
    table.iloc[:] = 0.0  # a copy
    assert run.nodes.any()


def test_without_pandas_it_says_what_to_install(run, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(
        ImportError, match=r"to_pandas requires pandas: pip install 'tenscasadi\[exchange\]'"
    ):
        run.to_pandas()


def test_a_table_that_cannot_be_written_leaves_no_file(run, tmp_path):
    with pytest.raises(FileNotFoundError):
        run.to_csv(tmp_path / "missing" / "run.csv")
    with pytest.raises(TypeError, match="path"):
        run.to_csv(3)
    assert not list(tmp_path.iterdir())


def test_a_plan_tells_what_is_held_from_each_node_of_the_mesh_on(tmp_path):
    found = plan()
    names, table = read(found.to_csv(tmp_path / "plan.csv"))
    held = [names.index(f"string {name} force density (N/m)") for name in STRINGS]
    assert np.array_equal(table[:, 0], found.time)
    assert np.array_equal(table[:-1, held], found.force_density)
    assert np.array_equal(table[-1, held], found.force_density[-1])
    assert np.array_equal(
        table[:, names.index("node top[1] x (m)")], found.trajectory.nodes[:, 4, 0]
    )
    assert np.array_equal(
        table[:-1, names.index("string bottom[2] tension (N)")], found.tension()[:, 2]
    )
    assert np.array_equal(
        table[:-1, names.index("string bottom[2] rest length (m)")], found.rest_lengths()[:, 2]
    )


def test_a_plan_whose_strings_are_too_soft_has_no_rest_lengths():
    pytest.importorskip("pandas", reason="tenscasadi[exchange] is not installed")
    found = plan()
    soft = replace(found, structure=found.structure.replace(stiffness=1.0))
    assert not [name for name in soft.to_pandas() if "rest length" in name]
    linear = replace(found, force_density=np.vstack([found.force_density, found.force_density[:1]]))
    assert (
        linear.to_pandas()["string top[0] force density (N/m)"].iloc[-1]
        == found.force_density[0, 3]
    )


def test_xarray_has_dimensions_names_and_units(run):
    pytest.importorskip("xarray", reason="tenscasadi[exchange] is not installed")
    data = run.to_xarray()
    assert dict(data.sizes) == {"time": 6, "node": 6, "axis": 3, "string": 9, "input": 9}
    assert np.array_equal(data.position.sel(axis="z"), run.nodes[:, :, 2])
    assert np.array_equal(data.tension.sel(string="vertical[0]"), run.tension[:, 6])
    assert data.velocity.attrs["units"] == "m/s"
    assert data.time.attrs["units"] == "s"
    assert data.node.values.tolist()[:2] == ["bottom[0]", "bottom[1]"]
    assert replace(run, scene=None).to_xarray().node.values.tolist() == list(range(6))
    data.tension[:] = 0.0  # a copy
    assert run.tension.max() > 0


def test_plan_converts_to_xarray():
    pytest.importorskip("xarray", reason="tenscasadi[exchange] is not installed")
    found = plan()
    data = found.to_xarray()
    assert np.array_equal(data.time, found.time)
    assert np.array_equal(data.position, found.trajectory.nodes)
    assert np.array_equal(data.force_density[:-1], found.force_density)


def test_missing_xarray_is_named_with_its_install_command(run, monkeypatch):
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(
        ImportError, match=r"to_xarray requires xarray: pip install 'tenscasadi\[exchange\]'"
    ):
        run.to_xarray()


def test_columns_have_the_names_of_nodes_and_strings(tmp_path):
    mast = tc.Structure(
        [[0, 0, 0], [0, 0, 1], [1, 0, 0], [-1, 0, 0]],
        bars=[[0, 1]],
        strings=[[1, 2], [1, 3]],
        pinned=[0, 2, 3],
        stiffness=100.0,
        node_names=["foot", "top", "", "west"],
        string_names=["left", "right"],
    )
    run = tc.simulate(tc.Model(tc.Scene(mast)), 0.01, 1e-3, compiled=False)
    path = run.to_csv(tmp_path / "run.csv")
    names = path.read_text(encoding="utf-8").partition("\n")[0].split(",")
    assert names[:4] == ["time (s)", "node foot x (m)", "node foot y (m)", "node foot z (m)"]
    for name in ("node top velocity z (m/s)", "node 2 x (m)", "string right tension (N)"):
        assert name in names
    assert len(set(names)) == len(names)
    pandas = pytest.importorskip("pandas")
    table = run.to_pandas()
    assert isinstance(table, pandas.DataFrame)
    assert table["node top z (m)"].tolist() == run.nodes[:, 1, 2].tolist()
