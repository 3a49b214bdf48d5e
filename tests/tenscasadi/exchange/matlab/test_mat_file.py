"""Files of MATLAB, damaged files, and files that claim too much memory."""

from __future__ import annotations

import os
import random
import struct
import sys
import tracemalloc
import zlib
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from scipy.io import loadmat, savemat
from scipy.sparse import csc_array, issparse

import tenscasadi as tc
from tenscasadi.exchange.matlab.mat_file import read_mat, write_mat
from tenscasadi.exchange.source import Source

MATLAB = (
    Path(scipy.io.__file__).parent / "matlab" / "tests" / "data"
)  # files that MATLAB itself has written
CROSS = {
    "N": np.eye(3, 4),
    "C_b": np.array([[-1.0, 0, 1, 0], [0, -1, 0, 1]]),
    "C_s": np.array([[-1.0, 1, 0, 0]]),
    "s_0": 1.0,
}


ZEROS = 100_000_000  # bytes, which a file of 400 kB unpacks to


def read(path):
    return read_mat(Source(path))


def element(kind: int, content: bytes) -> bytes:
    return struct.pack("<II", kind, len(content)) + content + b"\0" * (-len(content) % 8)


def matrix(form: int, dimensions: tuple[int, ...], *parts: bytes, name: bytes = b"x") -> bytes:
    head = (
        element(6, struct.pack("<II", form, 0))
        + element(5, struct.pack(f"<{len(dimensions)}i", *dimensions))
        + element(1, name)
    )
    return element(14, head + b"".join(parts))


def mat(*elements: bytes) -> bytes:
    return b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + b"".join(elements)


def test_variables_come_back(tmp_path):
    content = {
        "a": np.arange(6.0).reshape(2, 3),
        "text": "γ",
        "s": {"inner": {"x": 2.0}},
        "sparse": csc_array(np.eye(3)),
    }
    found = read(write_mat(tmp_path / "x", content))  # no ending is added
    assert np.array_equal(found["a"], content["a"])
    assert found["text"] == "γ"
    assert found["s"]["inner"]["x"] == [[2.0]]
    assert np.array_equal(found["sparse"].toarray(), np.eye(3))


def agree(ours, theirs) -> bool:
    """The same value as SciPy reads it."""
    if ours is None:  # cells, objects, complex numbers
        return True
    if isinstance(ours, dict):
        return all(agree(value, theirs[0, 0][name]) for name, value in ours.items())
    if isinstance(ours, str):
        return ours == (str(theirs.flat[0]) if theirs.size else "")
    return (
        np.array_equal(ours.toarray(), theirs.toarray())
        if issparse(ours)
        else np.array_equal(ours, theirs)
    )


@pytest.mark.skipif(not MATLAB.exists(), reason="this SciPy came without its test files")
def test_files_of_matlab_on_several_machines_are_read_as_scipy_reads_them():
    compared = 0
    for path in sorted(MATLAB.glob("test*_[67].*.mat")):  # 7.4 also wrote one as HDF5
        if "hdf5" not in path.name:
            theirs = loadmat(path, spmatrix=False)
            for name, value in read(path).items():
                assert agree(value, theirs[name]), (path.name, name)
                compared += 1
    assert compared > 30
    for name in (
        "big_endian",
        "little_endian",
        "logical_sparse",
        "miuint32_for_miint32",
        "one_by_zero_char",
    ):
        theirs = loadmat(MATLAB / f"{name}.mat", spmatrix=False)
        assert all(
            agree(value, theirs[key]) for key, value in read(MATLAB / f"{name}.mat").items()
        ), name


@pytest.mark.skipif(not MATLAB.exists(), reason="this SciPy came without its test files")
@pytest.mark.parametrize(
    "name",
    [
        "testfunc_7.4_GLNX86",
        "testobject_7.1_GLNX86",
        "testcell_7.1_GLNX86",
        "parabola",
        "some_functions",
    ],
)
def test_function_handles_and_objects_beside_a_structure_are_left_out(name, tmp_path):
    savemat(tmp_path / "x.mat", CROSS)
    with open(tmp_path / "x.mat", "ab") as file:
        file.write((MATLAB / f"{name}.mat").read_bytes()[128:])
    assert len(tc.load_mat(tmp_path / "x.mat").bars) == 2
    found = read(tmp_path / "x.mat")
    others = {"parabola", "sqr", "testfunc", "testobject", "testcell"} & set(found)
    assert not any(found[key] for key in others)


@pytest.mark.parametrize(
    ("content", "cure"),
    [
        (
            b"\x89HDF\r\n\x1a\n" + bytes(600),
            r"has MATLAB's format v7\.3 \(HDF5\): save it in MATLAB with save\('x\.mat', \.\.\., '-v7'\)",
        ),
        (
            b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + b"\x89HDF\r\n\x1a\n",
            r"format v7\.3 \(HDF5\)",
        ),
        (
            b"# Created by Octave 7.3\n# name: N",
            "no .mat file of version 5, 6 or 7: save it .*in Octave with '-mat7-binary'",
        ),
        (
            struct.pack("<5i", 0, 1, 1, 0, 2) + b"N\0" + bytes(200),
            "no .mat file of version 5, 6 or 7",
        ),
        (b"", "no .mat file of version 5, 6 or 7"),
    ],
    ids=["HDF5", "v7.3", "text", "v4", "empty"],
)
def test_other_versions_are_refused_with_the_cure(content, cure, tmp_path):
    (tmp_path / "x.mat").write_bytes(content)
    with pytest.raises(ValueError, match=f"(?s){cure}") as caught:
        read(tmp_path / "x.mat")
    assert len(str(caught.value).splitlines()) == 1


def nested(depth: int) -> bytes:
    inside = matrix(6, (1, 1), element(9, struct.pack("<d", 1.0)), name=b"")
    for _ in range(depth):
        inside = matrix(2, (1, 1), element(5, struct.pack("<i", 2)), element(1, b"a\0"), inside)
    return inside


@pytest.mark.parametrize(
    ("content", "named"),
    [
        (
            matrix(2, (1, 1), element(5, struct.pack("<i", 2)), element(1, b"a\0b\0")),
            "a struct has 4 characters of names, each 2 long, and 0 values",
        ),
        (
            matrix(2, (1, 1), element(5, struct.pack("<i", 0)), element(1, b"")),
            "a struct has 0 characters of names, each 0 long",
        ),
        (matrix(4, (-1, -9), element(16, b"")), r"x has shape \(-1, -9\)"),
        (
            matrix(6, (10**5, 10**5), element(9, bytes(8))),
            r"x of shape \(100000, 100000\) holds 1 numbers",
        ),
        (matrix(6, (1, 1), element(99, bytes(8))), "numbers are of the unknown type 99"),
        (
            matrix(
                5, (10**9, 10**9), element(5, bytes(4)), element(5, bytes(8)), element(9, bytes(8))
            ),
            "a sparse matrix of shape .* is inconsistent",
        ),
        (
            matrix(6, (1, 1), struct.pack("<II", 9, 2**32 - 8)),
            "an element of 4294967288 bytes is cut off",
        ),
        (struct.pack("<II", 14, 2**31), "an element of 2147483648 bytes is cut off"),
        (nested(2_000), "nested deeper than 100 times"),
        (
            element(15, zlib.compress(bytes(ZEROS), 1)),
            "a compressed variable is cut off, or longer than it says",
        ),
        (
            element(15, zlib.compress(struct.pack("<II", 14, ZEROS) + bytes(ZEROS), 1)),
            "it unpacks to more than",
        ),
        (
            element(15, zlib.compress(matrix(6, (1, 1), element(9, bytes(8))))[:-9]),
            "a compressed variable is cut off",
        ),
    ],
    ids=[
        "struct",
        "names",
        "negative",
        "numbers",
        "type",
        "sparse",
        "long",
        "longer",
        "deep",
        "zeros",
        "honest",
        "cut",
    ],
)
def test_what_claims_more_than_it_holds_takes_no_memory(content, named, tmp_path, monkeypatch):
    monkeypatch.setattr("tenscasadi.util.archive.MAX_BYTES", 1_000_000)
    (tmp_path / "x.mat").write_bytes(mat(content))
    tracemalloc.start()
    try:
        with pytest.raises(
            ValueError, match=rf"x\.mat: it is no \.mat file that can be read: .*({named})"
        ):
            read(tmp_path / "x.mat")
        assert tracemalloc.get_traced_memory()[1] < 60_000_000
    finally:
        tracemalloc.stop()


def test_what_is_left_out_is_not_believed_either(tmp_path):
    cells, structs = (
        matrix(1, (10**5, 10**5)),
        matrix(2, (10**5, 10**4), element(5, struct.pack("<i", 2)), element(1, b"a\0")),
    )
    (tmp_path / "x.mat").write_bytes(
        mat(
            cells,
            structs,
            matrix(4, (1, 10**9), element(16, b"")),
            matrix(6, (1, 1), element(9, bytes(8)), name=b"y"),
        )
    )
    found = read(tmp_path / "x.mat")
    assert found.keys() == {"x", "y"}
    assert not found["x"]


def test_what_unpacks_to_too_much_is_not_unpacked(tmp_path, monkeypatch):
    monkeypatch.setattr("tenscasadi.util.archive.MAX_BYTES", 1_000_000)
    savemat(tmp_path / "x.mat", {"a": np.zeros(10**6)}, do_compression=True)
    with pytest.raises(
        ValueError,
        match=r"x\.mat: it is no .*: it unpacks to more than 0.001 GB, the limit for a file of its size",
    ):
        read(tmp_path / "x.mat")


def test_sparse_matrices_whose_indices_lead_elsewhere_are_refused(tmp_path):
    wrong = csc_array(np.eye(3))
    wrong.indices[1] = 10**6
    savemat(tmp_path / "x.mat", {"a": wrong})
    with pytest.raises(ValueError, match=r"no \.mat file that can be read"):
        read(tmp_path / "x.mat")


def test_damaged_files_are_refused_with_a_reason_or_read(tmp_path):
    savemat(
        tmp_path / "whole.mat",
        {
            "task": CROSS,
            "text": "x",
            "sparse": csc_array(np.eye(3)),
            "cell": np.array([1, "a"], dtype=object),
        },
    )
    run = tc.simulate(tc.Model(tc.Scene(tc.shapes.prism())), 0.02, 0.01, compiled=False)
    packed = tc.save_mat(run, tmp_path / "run.mat")
    draw, refused = random.Random(0), 0
    for attempt in range(400):
        load, source = ((tc.load_mat, tmp_path / "whole.mat"), (tc.load_mat_trajectory, packed))[
            attempt % 2
        ]
        content = bytearray(source.read_bytes())
        if attempt % 5 == 0:
            content = content[: draw.randrange(len(content))]
        for _ in range(draw.choice([1, 3, 20]) if attempt % 5 else 0):
            content[draw.randrange(len(content))] ^= 1 << draw.randrange(8)
        (tmp_path / "damaged.mat").write_bytes(content)
        try:
            repr(load(tmp_path / "damaged.mat"))
        except (TypeError, ValueError) as error:
            refused += 1
            assert "damaged.mat" in str(error)  # noqa: PT017  some damages load
            assert len(str(error).splitlines()) == 1  # noqa: PT017
    assert refused > 100


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX files")
def test_what_is_no_file_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "x.mat")
    with pytest.raises(ValueError, match="no regular file"):
        read(tmp_path / "x.mat")
    with pytest.raises(FileNotFoundError):
        read(tmp_path / "missing.mat")
    with pytest.raises(TypeError, match="path is 3"):
        read(3)
