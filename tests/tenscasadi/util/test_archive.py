"""Files of arrays: complete or as they were, and refused with a reason. Pickles in them are never opened."""

from __future__ import annotations

import os
import pickle
import stat
import subprocess
import sys
import time
import zipfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from tenscasadi.util import archive

posix = pytest.mark.skipif(sys.platform == "win32", reason="POSIX files and signals")


def test_arrays_come_back(tmp_path: Path) -> None:
    path = archive.save(
        tmp_path / "a.npz", "form 1", {"x": np.arange(3.0), "word": np.asarray("γ")}
    )
    content = archive.load(path, "form 1", "thing", dict)
    assert content["x"].tolist() == [0.0, 1.0, 2.0]
    assert content["word"].item() == "γ"
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.npz"]


def test_files_say_what_they_are(tmp_path: Path) -> None:
    archive.save(tmp_path / "a.npz", "form 1", {"x": np.zeros(2)})
    np.savez(tmp_path / "b.npz", x=np.zeros(2))
    (tmp_path / "c.npz").write_text("no archive")
    assert [archive.read_format(tmp_path / name) for name in ("a.npz", "b.npz", "c.npz")] == [
        "form 1",
        "",
        "",
    ]
    with pytest.raises(FileNotFoundError):
        archive.read_format(tmp_path / "d.npz")


def test_a_write_that_fails_leaves_the_old_file_and_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = archive.save(tmp_path / "a.npz", "form 1", {"x": np.ones(2)})

    def full(file: object, **_: object) -> None:
        file.write(b"half")  # type: ignore[attr-defined]
        raise OSError("no space left on device")

    monkeypatch.setattr(np, "savez_compressed", full)
    with pytest.raises(OSError, match="no space"):
        archive.save(path, "form 1", {"x": np.zeros(2)})
    assert archive.load(path, "form 1", "thing", dict)["x"].tolist() == [1.0, 1.0]
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.npz"]


def test_a_link_stays_one(tmp_path: Path) -> None:
    archive.save(tmp_path / "real.npz", "form 1", {"x": np.ones(2)})
    (tmp_path / "link.npz").symlink_to(tmp_path / "real.npz")
    archive.save(tmp_path / "link.npz", "form 1", {"x": np.zeros(2)})
    assert (tmp_path / "link.npz").is_symlink()
    assert archive.load(tmp_path / "real.npz", "form 1", "thing", dict)["x"].tolist() == [0.0, 0.0]


def test_where_nothing_can_be_written_it_is_an_os_error(tmp_path: Path) -> None:
    path = tmp_path / "nowhere" / "a.npz"
    with pytest.raises(FileNotFoundError) as caught:
        archive.save(path, "form 1", {})
    assert caught.value.filename == str(path)  # not that of the unfinished file
    with pytest.raises(OSError, match=str(tmp_path)):
        archive.save(tmp_path, "form 1", {})


@posix
def test_what_is_no_regular_file_is_neither_replaced_nor_read(tmp_path: Path) -> None:
    fifo, link, loop = (tmp_path / name for name in ("fifo", "link", "loop"))
    os.mkfifo(fifo)
    link.symlink_to(fifo)
    loop.symlink_to(loop)
    for path in (fifo, link, loop):
        with pytest.raises(OSError, match="Not a regular file: give another name") as caught:
            archive.save(path, "form 1", {"x": np.ones(2)})
        assert caught.value.filename == str(path)
    assert fifo.is_fifo()
    assert link.is_symlink()
    assert loop.is_symlink()
    assert len(list(tmp_path.iterdir())) == 3
    for path in (fifo, link):  # opening them would wait for ever
        with pytest.raises(
            ValueError,
            match=rf"{path.name} is not a thing: it cannot be read \(it is not a regular file\)(\nSee |$)",
        ):
            archive.load(path, "form 1", "thing", dict)


def test_what_a_killed_process_left_is_removed_by_the_next_save(tmp_path: Path) -> None:
    left, busy, other = (tmp_path / name for name in (".tenscasadi-0", ".tenscasadi-1", ".mine"))
    for path, age in ((left, 7200), (busy, 60), (other, 7200)):
        path.write_bytes(b"half")
        os.utime(path, (time.time() - age,) * 2)
    archive.save(tmp_path / "a.npz", "form 1", {"x": np.ones(2)})
    assert sorted(path.name for path in tmp_path.iterdir()) == [".mine", ".tenscasadi-1", "a.npz"]


@posix
def test_who_may_read_a_file_stays_the_same(tmp_path: Path) -> None:
    path = archive.save(tmp_path / "a.npz", "form 1", {"x": np.ones(2)})
    path.chmod(0o600)
    archive.save(path, "form 1", {"x": np.ones(3)})
    assert stat.S_IMODE(path.stat().st_mode) == 0o600


def test_threads_may_save_to_one_name(tmp_path: Path) -> None:
    def save(value: int) -> None:
        for _ in range(20):
            archive.save(tmp_path / "a.npz", "form 1", {"x": np.full(1000, value)})

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(save, range(4)))
    assert len(set(archive.load(tmp_path / "a.npz", "form 1", "thing", dict)["x"])) == 1
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.npz"]


# Imports once; each fault then befalls a child of its own. A child is killed before the n-th line
# of Python that a save runs.
FAULTS = """
import os, resource, signal, sys
import numpy as np
from tenscasadi.util import archive

path, folder = sys.argv[1], os.path.dirname(sys.argv[1])
old, new = np.random.default_rng(0).normal(size=3000), np.random.default_rng(1).normal(size=3000)

def child(action):
    pid = os.fork()
    if pid == 0:
        code = 9
        try:
            code = action()
        finally:
            os._exit(code)
    return os.waitpid(pid, 0)[1]

def content():
    return archive.load(path, "form 1", "thing", dict)["x"]

def save(last=None):
    lines = 0
    def count(frame, event, argument):
        nonlocal lines
        lines += event == "line"
        if lines == last:
            os.kill(os.getpid(), signal.SIGKILL)
        return count
    sys.settrace(count)
    archive.save(path, "form 1", {"x": new})
    sys.settrace(None)
    return lines

save()  # imports what it needs
total = save()
seen = set()
for last in [*np.linspace(1, total - 20, 35).astype(int).tolist(), *range(total - 16, total - 1)]:
    archive.save(path, "form 1", {"x": old})
    assert os.listdir(folder) == [os.path.basename(path)], last  # what the last one left is gone
    status = child(lambda: save(last) * 0)
    assert os.WTERMSIG(status) == signal.SIGKILL, (last, status)
    found = content()
    assert np.array_equal(found, old) or np.array_equal(found, new), last
    seen.add(bool(np.array_equal(found, new)))
    for left in os.listdir(folder):
        os.utime(os.path.join(folder, left), (0, 0))
assert seen == {False, True}

def cut(size):
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
    try:
        archive.save(path, "form 1", {"x": new})
    except OSError as error:
        return 0 if error.filename == path else 1
    return 2

archive.save(path, "form 1", {"x": old})
for size in np.linspace(0, os.path.getsize(path) - 1000, 20).astype(int).tolist():
    assert child(lambda: cut(size)) == 0, size
    assert np.array_equal(content(), old)
assert os.listdir(os.path.dirname(path)) == [os.path.basename(path)]
"""


@posix
def test_the_old_file_or_the_new_one_is_whole_after_a_kill_and_on_a_full_disk(
    tmp_path: Path,
) -> None:
    root = str(Path(archive.__file__).parents[2])
    command = [sys.executable, "-c", FAULTS, str(tmp_path / "a.npz")]
    done = subprocess.run(
        command,
        env={**os.environ, "PYTHONPATH": root},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr


# --- sizes ---


def with_header(path: Path, shape: tuple[int, ...], data: bytes) -> None:
    """A file whose field x tells this shape, of floats, and holds these bytes."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name, told, content in (
            ("format", (), np.asarray("form 1").tobytes()),
            ("x", shape, data),
        ):
            with file.open(f"{name}.npy", "w") as member:
                np.lib.format.write_array_header_1_0(
                    member,
                    {
                        "shape": told,
                        "fortran_order": False,
                        "descr": "<f8" if name == "x" else "<U6",
                    },
                )
                member.write(content)


@pytest.mark.parametrize("shape", [(10**12,), (3, 10**9), (2**40, 2**40), (5,), (1,)])
def test_shapes_that_do_not_fit_the_file_are_refused(
    shape: tuple[int, ...], tmp_path: Path
) -> None:
    with_header(tmp_path / "a.npz", (2,), bytes(16))
    assert archive.load(tmp_path / "a.npz", "form 1", "thing", dict)["x"].tolist() == [0.0, 0.0]
    with_header(tmp_path / "a.npz", shape, bytes(16))
    with pytest.raises(
        ValueError,
        match=r"a\.npz is not a thing: it cannot be read \(its field 'x' of shape \(.*\) requires .* bytes[^\n]*(\nSee |$)",
    ):
        archive.load(tmp_path / "a.npz", "form 1", "thing", dict)


def test_what_unpacks_to_too_much_is_not_unpacked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.npz"
    np.savez_compressed(path, format="form 1", x=np.zeros(200_000), y=np.zeros(200_000))
    assert archive.load(path, "form 1", "thing", dict)["x"].size == 200_000
    monkeypatch.setattr(archive, "MAX_BYTES", 2_000_000)
    monkeypatch.setattr(np.lib.format, "read_array", lambda *_, **__: pytest.fail("read"))
    with pytest.raises(
        ValueError,
        match=r"a\.npz is not a thing: it cannot be read \(it unpacks to 0\.0032 GB, above the limit of 0\.002 GB",
    ):
        archive.load(path, "form 1", "thing", dict)


def test_what_was_saved_is_never_too_large_to_be_loaded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(archive, "MAX_BYTES", 100_000)
    path = archive.save(
        tmp_path / "a.npz", "form 1", {"x": np.zeros(200_000)}
    )  # of zeros, a compressed file would be a thousandth
    assert archive.load(path, "form 1", "thing", dict)["x"].size == 200_000


def test_what_is_wrong_is_told(tmp_path: Path) -> None:
    path = archive.save(tmp_path / "a.npz", "form 1", {"x": np.ones(2)})
    with pytest.raises(
        ValueError, match=r"a\.npz is not a thing: its field 'format' is not 'form 2'"
    ):
        archive.load(path, "form 2", "thing", dict)
    with pytest.raises(ValueError, match=r"a\.npz is not a thing: it has no field 'y'"):
        archive.load(path, "form 1", "thing", lambda content: content["y"])
    path.write_bytes(path.read_bytes()[:50])
    with pytest.raises(ValueError, match=r"a\.npz is not a thing: it cannot be read"):
        archive.load(path, "form 1", "thing", dict)
    with pytest.raises(FileNotFoundError):
        archive.load(tmp_path / "none.npz", "form 1", "thing", dict)


def test_what_the_builder_refuses_names_the_file(tmp_path: Path) -> None:
    path = archive.save(
        tmp_path / "a.npz", "form 1", {"x": np.ones(2), "in.y": np.ones(1), "in.z": np.asarray("γ")}
    )

    def refuse(content: archive.Fields) -> None:
        raise ValueError("x has an even number of entries")

    with pytest.raises(
        ValueError, match=r"a\.npz is not a thing: x has an even number of entries$"
    ):
        archive.load(path, "form 1", "thing", refuse)
    with pytest.raises(
        ValueError,
        match=r"a\.npz is not a thing: field 'x' holds values of type float64, shape \(2,\)$",
    ):
        archive.load(path, "form 1", "thing", lambda content: content.array("x", "i"))
    with pytest.raises(
        ValueError, match=r"a\.npz is not a thing: field 'z' holds values of type <U1, shape \(\)$"
    ):
        archive.load(
            path, "form 1", "thing", lambda content: content.within("in.").array("z", "U", 1)
        )
    with pytest.raises(ValueError, match=r"a\.npz is not a thing: it has no field 'x'$"):
        archive.load(path, "form 1", "thing", lambda content: content.within("in.")["x"])
    assert archive.load(
        path, "form 1", "thing", lambda content: content.array("x", "fi", 1)
    ).tolist() == [1.0, 1.0]
    assert list(archive.load(path, "form 1", "thing", lambda content: content.within("in."))) == [
        "y",
        "z",
    ]


BUGS: dict[str, Callable[[dict[str, np.ndarray]], object]] = {
    "TypeError": lambda content: len(3),  # type: ignore[arg-type]
    "KeyError": lambda content: {}["x"],
    "AttributeError": lambda content: content["x"].colour,  # type: ignore[attr-defined]
    "IndexError": lambda content: [][0],
}


@pytest.mark.parametrize("name", BUGS)
def test_a_bug_of_the_builder_is_no_fault_of_the_file(name: str, tmp_path: Path) -> None:
    path = archive.save(tmp_path / "a.npz", "form 1", {"x": np.ones(2)})
    with pytest.raises(Exception, match=r"^(?!.*a\.npz)") as caught:
        archive.load(path, "form 1", "thing", BUGS[name])
    assert caught.type.__name__ == name


class Harm:
    """Makes a folder when unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Callable[[Path], None], tuple[Path]]:
        return Path.mkdir, (self.path,)


def one_array(path: Path, value: np.ndarray) -> None:
    with path.open("wb") as file:
        np.save(file, value)


def zip_with_a_pickle(path: Path, harm: Harm) -> None:
    with zipfile.ZipFile(path, "w") as file:
        with file.open("format.npy", "w") as member:
            np.lib.format.write_array(member, np.asarray("form 1"))
        file.writestr("x.npy", pickle.dumps(harm))


FOREIGN: dict[str, Callable[[Path, bytes, Harm], object]] = {
    "empty": lambda path, whole, harm: path.write_bytes(b""),
    "text": lambda path, whole, harm: path.write_text("once upon a time\n"),
    "pickle": lambda path, whole, harm: path.write_bytes(pickle.dumps(harm)),
    "npy": lambda path, whole, harm: one_array(path, np.ones(3)),
    "npy of objects": lambda path, whole, harm: one_array(path, np.array([harm])),
    "npz of objects": lambda path, whole, harm: np.savez(path, format="form 1", x=np.array([harm])),
    "npz whose form is an object": lambda path, whole, harm: np.savez(
        path, format=np.array([harm]), x=np.ones(3)
    ),
    "zip with a pickle": lambda path, whole, harm: zip_with_a_pickle(path, harm),
    "cut near its start": lambda path, whole, harm: path.write_bytes(whole[:50]),
    "cut near its end": lambda path, whole, harm: path.write_bytes(whole[:-10]),
    "changed": lambda path, whole, harm: path.write_bytes(whole[:200] + bytes(100) + whole[300:]),
}


@pytest.mark.parametrize("way", FOREIGN)
def test_files_that_it_did_not_save_or_that_are_damaged(way: str, tmp_path: Path) -> None:
    path = archive.save(tmp_path / "a.npz", "form 1", {"x": np.sqrt(np.arange(1000.0))})
    FOREIGN[way](path, path.read_bytes(), Harm(tmp_path / "harm"))
    with pytest.raises(
        ValueError,
        match=r"a\.npz is not a thing: it cannot be read, it is damaged, or tenscasadi did not save it",
    ) as caught:
        archive.load(path, "form 1", "thing", lambda content: content["x"])
    assert "pickle" not in str(caught.value)
    assert not (tmp_path / "harm").exists()


@pytest.mark.parametrize("path", [None, b"x", 3, "a\0b"], ids=repr)
def test_what_is_no_name_of_a_file_is_named(path: object) -> None:
    for call in (
        lambda: archive.save(path, "form", {}),
        lambda: archive.load(path, "form", "thing", dict),
    ):
        with pytest.raises((TypeError, ValueError), match=r"^path is .*: give"):
            call()
