"""Files of arrays: complete or as they were, and refused with a reason. Pickles in them are never opened."""

from __future__ import annotations

import pickle
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tenscasadi.util import archive


def test_arrays_come_back(tmp_path: Path) -> None:
    path = archive.save(tmp_path / "a.npz", "form 1", {"x": np.arange(3.0), "word": np.asarray("γ")})
    content = archive.load(path, "form 1", "thing", dict)
    assert content["x"].tolist() == [0.0, 1.0, 2.0]
    assert content["word"].item() == "γ"
    assert set(archive.load(path, "form 1", "thing", dict, names={"x"})) == {"x"}
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.npz"]


def test_a_write_that_fails_leaves_the_old_file_and_no_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_what_is_wrong_is_told(tmp_path: Path) -> None:
    path = archive.save(tmp_path / "a.npz", "form 1", {"x": np.ones(2)})
    with pytest.raises(ValueError, match=r"a\.npz is not a thing: its field 'format' is not 'form 2'"):
        archive.load(path, "form 2", "thing", dict)
    with pytest.raises(ValueError, match=r"a\.npz is not a thing: it has no field 'y'"):
        archive.load(path, "form 1", "thing", lambda content: content["y"])
    path.write_bytes(path.read_bytes()[:50])
    with pytest.raises(ValueError, match=r"a\.npz is not a thing: it cannot be read"):
        archive.load(path, "form 1", "thing", dict)
    with pytest.raises(FileNotFoundError):
        archive.load(tmp_path / "none.npz", "form 1", "thing", dict)


def test_what_the_builder_refuses_names_the_file(tmp_path: Path) -> None:
    path = archive.save(tmp_path / "a.npz", "form 1", {"x": np.ones(2), "in.y": np.ones(1), "in.z": np.asarray("γ")})

    def refuse(content: archive.Fields) -> None:
        raise ValueError("x has an even number of entries")

    with pytest.raises(ValueError, match=r"a\.npz is not a thing: x has an even number of entries$"):
        archive.load(path, "form 1", "thing", refuse)
    with pytest.raises(ValueError, match=r"a\.npz is not a thing: field 'x' holds values of type float64, shape \(2,\)$"):
        archive.load(path, "form 1", "thing", lambda content: content.array("x", "i"))
    with pytest.raises(ValueError, match=r"a\.npz is not a thing: field 'z' holds values of type <U1, shape \(\)$"):
        archive.load(path, "form 1", "thing", lambda content: content.within("in.").array("z", "U", 1))
    with pytest.raises(ValueError, match=r"a\.npz is not a thing: it has no field 'x'$"):
        archive.load(path, "form 1", "thing", lambda content: content.within("in.")["x"])
    assert archive.load(path, "form 1", "thing", lambda content: content.array("x", "fi", 1)).tolist() == [1.0, 1.0]
    assert list(archive.load(path, "form 1", "thing", lambda content: content.within("in."))) == ["y", "z"]


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
    "npz whose form is an object": lambda path, whole, harm: np.savez(path, format=np.array([harm]), x=np.ones(3)),
    "zip with a pickle": lambda path, whole, harm: zip_with_a_pickle(path, harm),
    "cut near its start": lambda path, whole, harm: path.write_bytes(whole[:50]),
    "cut near its end": lambda path, whole, harm: path.write_bytes(whole[:-10]),
    "changed": lambda path, whole, harm: path.write_bytes(whole[:200] + bytes(100) + whole[300:]),
}


@pytest.mark.parametrize("way", FOREIGN)
def test_files_that_it_did_not_save_or_that_are_damaged(way: str, tmp_path: Path) -> None:
    path = archive.save(tmp_path / "a.npz", "form 1", {"x": np.sqrt(np.arange(1000.0))})
    FOREIGN[way](path, path.read_bytes(), Harm(tmp_path / "harm"))
    with pytest.raises(ValueError, match=r"a\.npz is not a thing: it cannot be read, as tenscasadi did not save it or it is damaged") as caught:
        archive.load(path, "form 1", "thing", lambda content: content["x"])
    assert "pickle" not in str(caught.value)
    assert not (tmp_path / "harm").exists()
