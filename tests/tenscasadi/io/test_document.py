"""Documents: includes, declared numbers, and errors that tell file, line and key."""

from __future__ import annotations

import math
import os
import pickle
from pathlib import Path

import pytest

from tenscasadi.io import document
from tenscasadi.io.document import read_document
from tenscasadi.schema.reading import SceneFileError

HEAD = 'format = 1\nunits = "SI"\n'


@pytest.fixture
def write(tmp_path):
    def write(text: str, name: str = "scene.toml", head: str = HEAD) -> Path:
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(head + text, encoding="utf-8")
        return path

    return write


def fault(path: Path) -> SceneFileError:
    with pytest.raises(SceneFileError) as caught:
        read_document(path)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(caught.value.file)
    return caught.value


def test_numbers_are_computed_in_any_order(write):
    read = read_document(
        write('[numbers]\nheight = "2 * radius"\nradius = 0.25\nangle = "30 deg"\n')
    )
    assert read.numbers == {"height": 0.5, "radius": 0.25, "angle": math.radians(30.0)}


def test_file_overrides_its_includes(write):
    write(
        '[numbers]\nheight = 1\nradius = "height / 4"\n[scene]\ngravity = {kind = "A", x = 1}\nends = "lumped"\n',
        "parts/base.toml",
    )
    read = read_document(
        write(
            'include = ["parts/base.toml"]\n[numbers]\nheight = 2\n[scene]\ngravity = {kind = "B", y = 2}\n'
        )
    )
    assert read.numbers == {"height": 2.0, "radius": 0.5}  # formulas follow
    assert read.data["scene"] == {
        "gravity": {"kind": "B", "y": 2},
        "ends": "lumped",
    }  # another kind takes the whole place
    assert read.root.child("scene").child("ends").error("is wrong").file == "parts/base.toml"
    assert read.root.child("scene").child("ends").error("is wrong").line == 8


@pytest.mark.parametrize(
    "name",
    [
        *(
            "/etc/passwd",
            "../scene.toml",
            "parts/../../x.toml",
            "..",
            "",
            "a\\b.toml",
            "C:/x.toml",
            "parts/./a.toml",
            "//x.toml",
            "x.txt",
            "a\0.toml",
        ),
        *("missing.toml", "~/x.toml", "folder.toml", "http://host/x.toml"),
    ],
)
def test_includes_cannot_leave_the_folder(name, write, tmp_path):
    (tmp_path / "inner/folder.toml").mkdir(parents=True)
    write("", "scene.toml")
    write("", "x.txt")
    text = name.replace("\\", "\\\\").replace("\0", "\\u0000")
    found = fault(write(f'include = ["{text}"]\n', "inner/main.toml"))
    assert (found.line, found.key) in {(3, "include[0]"), (None, "")}


def test_links_out_of_the_folder_are_rejected(write, tmp_path):
    write("", "outside.toml")
    (tmp_path / "inner").mkdir()
    os.symlink(tmp_path / "outside.toml", tmp_path / "inner/link.toml")
    os.symlink(tmp_path / "inner/loop.toml", tmp_path / "inner/loop.toml")
    assert "a link out of" in str(fault(write('include = ["link.toml"]\n', "inner/main.toml")))
    assert "a link out of" in str(fault(write('include = ["loop.toml"]\n', "inner/main.toml")))
    os.symlink(tmp_path, tmp_path / "inner/up")
    assert "a link out of" in str(
        fault(write('include = ["up/outside.toml"]\n', "inner/main.toml"))
    )


def test_circular_and_too_many_includes_are_rejected(write, monkeypatch):
    write('include = ["b.toml"]\n', "a.toml")
    found = fault(write('include = ["a.toml"]\n', "b.toml"))
    assert (found.file, found.line) == ("a.toml", 3)
    for k in range(12):  # each includes the next twice: 4096 files
        write(f'include = ["c{k + 1}.toml", "c{k + 1}.toml"]\n', f"c{k}.toml")
    write("", "c12.toml")
    assert "100 files" in str(fault(write('include = ["c0.toml"]\n')))
    monkeypatch.setattr(document, "LARGEST_FILE", 1000)
    assert "MB" in str(fault(write("#" * 1000)))
    write("#" * 600, "half.toml")
    assert "MB" in str(fault(write('include = ["half.toml"]\n#' + "#" * 600)))


def test_too_many_entries_are_rejected_also_over_includes(write, monkeypatch):
    monkeypatch.setattr(document, "MAX_ENTRIES", 100)
    write("x = [" + "1," * 60 + "]", "half.toml")
    assert "more than" in str(fault(write("x = [" + "1," * 100 + "]")))
    assert fault(write('include = ["half.toml"]\nx = [' + "1," * 60 + "]")).file == "half.toml"


def test_pipes_and_folders_are_rejected(tmp_path):
    os.mkfifo(tmp_path / "pipe.toml")
    assert "no regular file" in str(fault(tmp_path / "pipe.toml"))
    assert "no regular file" in str(fault(tmp_path))
    with pytest.raises(FileNotFoundError):
        read_document(tmp_path / "none.toml")


@pytest.mark.parametrize(
    ("text", "line", "key", "words"),
    [
        ("[numbers]\na = 'b'\nb = 'a'\n", None, "numbers.", "depends on itself"),
        ("[numbers]\na = 'missing + 1'\n", 4, "numbers.a", "'missing' is not declared"),
        ("[numbers]\nsin = 1\n", 4, "numbers.sin", "cannot be the name"),
        ("[numbers]\n'a b' = 1\n", 4, "numbers.a b", "cannot be the name"),
        ("[numbers]\na = true\n", 4, "numbers.a", "give a number"),
        ("[numbers]\na = nan\n", 4, "numbers.a", "finite"),
        ("[numbers]\na = '1 +'\n", 4, "numbers.a", "is no formula"),
        ("[sturcture]\n", 3, "sturcture", "did you mean 'structure'?"),
        ("numbers = 3\n", 3, "numbers", "give a table"),
        ("x = [1,\n 2\n", 5, "", "no TOML"),
        ("[a]\n[a]\n", 4, "", "no TOML"),
        ("x = " + "9" * 5000, None, "", "no TOML"),
        ("x = " + "[" * 100, 3, "", "inside each other"),
        ("include = 'a.toml'", 3, "include", "give a list"),
        ("include = [1]", 3, "include[0]", "give the name"),
    ],
)
def test_faults_tell_line_and_key(text, line, key, words, write):
    found = fault(write(text))
    assert found.line == line or line is None
    assert found.key.startswith(key)
    assert words in str(found)


@pytest.mark.parametrize(("head", "words"), [("", "begin with format = 1"), ('format = 2\nunits = "SI"', "is 2: give 1"), ("format = 1", "units"),
                                             ('format = true\nunits = "SI"', "is True"), ('format = 1\nunits = "mm"', 'is "mm"')])  # fmt: skip
def test_format_and_units_are_stated(head, words, write):
    assert words.replace("'", '"') in str(fault(write("", head=head))).replace("'", '"')


def test_invalid_text_is_rejected(tmp_path):
    (tmp_path / "x.toml").write_bytes(b"format = 1\n\xff")
    found = fault(tmp_path / "x.toml")
    assert found.line == 2


def test_errors_survive_copies(write):
    found = fault(write("numbers = 3\n"))
    copy = pickle.loads(pickle.dumps(found))  # noqa: S301  made above
    assert (str(copy), copy.file, copy.line, copy.key) == (
        str(found),
        found.file,
        found.line,
        found.key,
    )
