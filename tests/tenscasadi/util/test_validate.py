"""Bad input: each mistake raises the right exception, with the field's name in its message."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.sparse import coo_matrix, csr_array

from tenscasadi.statics.force_density import equilibrium_force_density
from tenscasadi.statics.self_stress import self_stress
from tenscasadi.structure import shapes
from tenscasadi.structure.structure import Structure
from tenscasadi.util import validate

NODES = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
BARS = [(0, 1), (2, 3)]
STRINGS = [(0, 2), (1, 3)]
NAN, INF = float("nan"), float("inf")


class Broken:
    """NumPy cannot read it."""

    def __array__(self, *_: Any, **__: Any) -> Any:
        raise RuntimeError("broken")


def build(**changes: Any) -> Structure:
    return Structure(**{"nodes": NODES, "bars": BARS, "strings": STRINGS, **changes})


N = np.array(NODES, dtype=float).T
C_B = [[-1, 1, 0, 0], [0, 0, -1, 1]]
C_S = [[-1, 0, 1, 0], [0, -1, 0, 1]]
TIE = [[1.0], [0], [-1], [0]]
PIN = [[0.0], [1], [0], [0]]


def matrices(**changes: Any) -> Structure:
    return Structure.from_matrices(**{"N": N, "C_b": C_B, "C_s": C_S, **changes})


def test_what_the_table_starts_from_is_right() -> None:
    assert len(build().nodes) == len(matrices().nodes) == 4
    assert dict(matrices(P=PIN, D=[[1.0], [0], [0]]).pinned) == {1: "xyz"}
    assert len(matrices(N=N[:, [0, 1, 0, 3]], C_s=[[-1, 0, 0, 1]], P=TIE).nodes) == 3


MISTAKES: list[tuple[str, type[Exception], str, Callable[[], Any]]] = [
    # nodes
    ("nodes as text", TypeError, "nodes", lambda: build(nodes="abc")),
    ("nodes None", TypeError, "nodes", lambda: build(nodes=None)),
    ("nodes with text in them", TypeError, "nodes", lambda: build(nodes=[("0", "0", "0")] * 4)),
    ("nodes ragged", TypeError, "nodes", lambda: build(nodes=[(0, 0, 0), (1, 0)])),
    ("nodes complex", TypeError, "nodes", lambda: build(nodes=np.array(NODES) * 1j)),
    ("nodes boolean", TypeError, "nodes", lambda: build(nodes=np.ones((4, 3), dtype=bool))),
    ("nodes symbolic", TypeError, "nodes", lambda: build(nodes=ca.SX.sym("n", 4, 3))),
    ("nodes beyond floats", TypeError, "nodes", lambda: build(nodes=[(10**400, 0, 0)])),
    ("nodes transposed", ValueError, "nodes", lambda: build(nodes=N)),
    ("nodes empty", ValueError, "nodes", lambda: Structure(np.zeros((0, 3)))),
    ("nodes in a plane only", ValueError, "nodes", lambda: build(nodes=[(0, 0), (1, 0), (0, 1), (1, 1)])),
    ("a node not a number", ValueError, r"nodes\[3, 2\]", lambda: build(nodes=[*NODES[:3], (0, 0, NAN)])),
    ("a node at infinity", ValueError, r"nodes\[0, 1\]", lambda: build(nodes=[(0, -INF, 0), *NODES[1:]])),
    ("a node too far to square", ValueError, r"nodes\[0, 0\]", lambda: build(nodes=[(1e200, 0, 0), *NODES[1:]])),
    ("nodes that NumPy cannot read", TypeError, "nodes", lambda: build(nodes=Broken())),
    ("nodes sparse", TypeError, "nodes", lambda: build(nodes=csr_array(np.array(NODES)))),
    ("nodes under a mask", ValueError, "nodes has masked entries", lambda: build(nodes=np.ma.array(NODES, mask=np.eye(4, 3)))),
    # members
    ("bars a number", TypeError, "bars", lambda: build(bars=3)),
    ("bars None", TypeError, "bars", lambda: build(bars=None)),
    ("a bar of floats", TypeError, r"bars\[0\]", lambda: build(bars=[(0.0, 1.0)])),
    ("a bar of booleans", TypeError, r"bars\[0\]", lambda: build(bars=[(False, True)])),
    ("a bar of three nodes", ValueError, r"bars\[1\]", lambda: build(bars=[(0, 1), (0, 2, 3)])),
    ("one-based bars", ValueError, r"bars\[1\] is 4", lambda: build(bars=[(1, 2), (3, 4)])),
    ("a negative index", ValueError, r"strings\[0\] is -1", lambda: build(strings=[(0, -1)])),
    ("a bar from a node to itself", ValueError, "bars: bar 1", lambda: build(bars=[(0, 1), (2, 2)])),
    ("a bar twice, turned", ValueError, "bars: bars 0 and 1 join", lambda: build(bars=[(0, 1), (1, 0)])),
    ("a bar without length", ValueError, "bars: bar 0", lambda: build(nodes=[(0, 0, 0), (0, 0, 0), (0, 1, 0), (0, 0, 1)])),
    ("a string as short as rounding", ValueError, "strings: string 0", lambda: build(nodes=[(0.3, 0, 0), (1, 0, 0), (0.1 + 0.2, 0, 0), (0, 0, 1)])),
    ("bars sparse", TypeError, "bars", lambda: build(bars=coo_matrix(np.eye(2)))),
    ("bars of CasADi", TypeError, "bars", lambda: build(bars=ca.DM.eye(2))),
    # their properties
    ("massless bar", ValueError, "bar_mass of bar 1", lambda: build(bar_mass=[1, 0])),
    ("negative bar mass", ValueError, "bar_mass of bar 0", lambda: build(bar_mass=-1.0)),
    ("bar mass too small to divide by", ValueError, "bar_mass of bar 0", lambda: build(bar_mass=1e-320)),
    ("bar masses too few", ValueError, "bar_mass", lambda: build(bar_mass=[1.0])),
    ("bar mass of a column", ValueError, "bar_mass", lambda: build(bar_mass=[[1.0], [2.0]])),
    ("bar mass None", TypeError, "bar_mass", lambda: build(bar_mass=None)),
    ("bar mass True", TypeError, "bar_mass", lambda: build(bar_mass=True)),
    ("bar mass symbolic", TypeError, "bar_mass", lambda: build(bar_mass=ca.MX.sym("m"))),
    ("negative radius", ValueError, "bar_radius of bar 0", lambda: build(bar_radius=-0.1)),
    ("a bar that is a plate", ValueError, "bar_radius of bar 0", lambda: build(bar_radius=1e4)),
    ("negative node mass", ValueError, "node_mass of node 2", lambda: build(node_mass=[0, 0, -1, 0])),
    ("node mass not a number", ValueError, r"node_mass\[2\]", lambda: build(node_mass=[0, 0, NAN, 0])),
    ("massless string node", ValueError, "node_mass of node 2", lambda: build(bars=[(0, 1)], pinned=[3])),
    ("massless string node pinned in part", ValueError, "node_mass of node 3", lambda: build(bars=[(0, 1)], pinned={2: "zyx", 3: "xy"})),
    ("massless node of no member", ValueError, "node_mass of node 4", lambda: build(nodes=[*NODES, (5, 5, 5)])),
    ("negative stiffness", ValueError, "stiffness of string 1", lambda: build(stiffness=[1, -1])),
    ("infinite stiffness", ValueError, "stiffness", lambda: build(stiffness=INF)),
    ("negative damping", ValueError, "damping of string 0", lambda: build(damping=-0.1)),
    ("no rest length", ValueError, "rest_length of string 0", lambda: build(rest_length=0.0)),
    ("rest lengths too many", ValueError, "rest_length", lambda: build(rest_length=[1, 1, 1])),
    ("negative string mass", ValueError, "string_mass of string 0", lambda: build(string_mass=-1)),
    ("unknown keyword", TypeError, "young", lambda: build(young=1.0)),
    ("bar masses under a mask", ValueError, "bar_mass has masked entries", lambda: build(bar_mass=np.ma.array([1.0, 2.0], mask=[True, False]))),
    ("bar mass that NumPy cannot read", TypeError, "bar_mass", lambda: build(bar_mass=Broken())),
    # pins
    ("pinned a number", TypeError, "pinned", lambda: build(pinned=0)),
    ("pinned out of range", ValueError, "pinned", lambda: build(pinned=[4])),
    ("pinned twice", ValueError, "pinned: node 1", lambda: build(pinned=[1, 1])),
    ("pinned by name", TypeError, "pinned", lambda: build(pinned="xyz")),
    ("pinned along w", ValueError, "pinned of node 0", lambda: build(pinned={0: "xw"})),
    ("pinned along nothing", ValueError, "pinned of node 0", lambda: build(pinned={0: ""})),
    ("pinned twice along x", ValueError, "pinned of node 0", lambda: build(pinned={0: "xx"})),
    ("pinned by a flag", TypeError, "pinned of node 0", lambda: build(pinned={0: True})),
    ("pinned sparse", TypeError, "pinned", lambda: build(pinned=coo_matrix(np.eye(2)))),
    # what it can do
    ("replace by an unknown keyword", TypeError, "colour", lambda: build().replace(colour="red")),
    ("replace by a wrong value", ValueError, "stiffness", lambda: build().replace(stiffness=-1)),
    ("force density above the stiffness", ValueError, "force_density of string 0", lambda: build().prestressed([100.0, 1.0])),
    ("force density of a string that cannot stretch", ValueError, "force_density of string 0", lambda: build(stiffness=0.0).prestressed(1.0)),
    ("negative force density", ValueError, "force_density of string 1", lambda: build().prestressed([1.0, -1.0])),
    ("force densities too many", ValueError, "force_density", lambda: build().prestressed([1.0, 1.0, 1.0])),
    ("no segments", ValueError, "segments", lambda: build().subdivide(0)),
    ("segments by halves", TypeError, "segments", lambda: build().subdivide(2.5)),
    ("segments of three strings", ValueError, "segments", lambda: build().subdivide([1, 2, 3])),
    ("segments of one string wrong", ValueError, r"segments\[1\]", lambda: build().subdivide([1, -2])),
    ("segments without mass", ValueError, "string_mass of string 0", lambda: build().subdivide(2)),
    ("segments of an array without dimension", TypeError, "segments", lambda: build().subdivide(np.array(3))),
    ("segments sparse", TypeError, "segments", lambda: build().subdivide(csr_array(np.ones((1, 2))))),  # type: ignore[arg-type]
    ("segments beyond memory", ValueError, "segments", lambda: build().subdivide(10**400)),
    ("ends of an array", ValueError, "ends", lambda: build().subdivide(1, ends=np.array([]))),  # type: ignore[arg-type]
    ("a flag that is none", TypeError, "sparse", lambda: build().class_one(sparse=ca.MX.sym("x"))),
    ("values text", TypeError, "values", lambda: build().parent_mean("x")),
    ("values beyond floats", TypeError, "values", lambda: build().parent_mean(10**400)),
    ("values of other strings", ValueError, "values", lambda: build().parent_mean([1.0])),
    ("ends unknown", ValueError, "ends", lambda: build(string_mass=1.0).subdivide(2, ends="middle")),
    ("fractions that miss the end", ValueError, "fractions", lambda: build(string_mass=1.0).subdivide(2, fractions=[0.5, 0.4])),
    ("fractions too many", ValueError, "fractions", lambda: build(string_mass=1.0).subdivide(2, fractions=[0.5, 0.25, 0.25])),
    ("fractions of nothing", ValueError, "fractions of segment 1", lambda: build(string_mass=1.0).subdivide(2, fractions=[1.0, 0.0])),
    # the paper's matrices
    ("N transposed", ValueError, "N has shape", lambda: matrices(N=N.T)),
    ("N without columns", ValueError, "N has no columns", lambda: matrices(N=np.zeros((3, 0)))),
    ("C_b of another structure", ValueError, "C_b has shape", lambda: matrices(C_b=[[-1, 1, 0]])),
    ("C_b with two heads", ValueError, "C_b: row 1", lambda: matrices(C_b=[[-1, 1, 0, 0], [0, 0, 1, 1]])),
    ("C_s with a number in it", ValueError, "C_s: row 0", lambda: matrices(C_s=[[-1, 0.5, 1, 0]])),
    ("C_s ragged", TypeError, "C_s", lambda: matrices(C_s=[[-1, 1, 0, 0], [0]])),
    ("C_b text", TypeError, "C_b", lambda: matrices(C_b="bars")),
    ("P of another structure", ValueError, "P has shape", lambda: matrices(P=[[1.0], [-1.0]])),
    ("D without P", ValueError, "D has shape", lambda: matrices(D=np.zeros((3, 1)))),
    ("D too short", ValueError, "D has shape", lambda: matrices(P=PIN, D=np.zeros((2, 1)))),
    ("P that averages", ValueError, "P: column 0", lambda: matrices(P=[[0.5], [0.5], [-1], [0]])),
    ("P empty column", ValueError, "P: column 0", lambda: matrices(P=np.zeros((4, 1)))),
    ("P ties at a distance", ValueError, "D: column 0", lambda: matrices(P=TIE, D=[[0], [-1], [0]])),
    ("P ties what lies apart", ValueError, r"P: N P differs from D by 1 in column 0", lambda: matrices(P=TIE)),
    ("pin elsewhere", ValueError, r"P: N P differs from D by 0\.5 in column 0", lambda: matrices(P=PIN, D=[[0.5], [0], [0]])),
    ("P says it twice", ValueError, "P: column 1", lambda: matrices(P=np.hstack([PIN, PIN]), D=[[1, 1], [0, 0], [0, 0]])),
    ("string column without mass", ValueError, "node_mass of column 4",
     lambda: matrices(N=N[:, [0, 1, 2, 3, 0]], C_b=np.pad(C_B, ((0, 0), (0, 1))), C_s=[[0, 0, 1, 0, -1]], P=[[1], [0], [0], [0], [-1]])),
    ("node mass of columns", ValueError, "node_mass", lambda: matrices(node_mass=[1.0])),
    ("tied ends of a bar", ValueError, "bars: bar 0", lambda: matrices(N=N[:, [0, 0, 2, 3]], P=[[1], [-1], [0], [0]])),
    # shapes
    ("prism of two bars", ValueError, "bars", lambda: shapes.prism(2)),
    ("prism of three and a half bars", TypeError, "bars", lambda: shapes.prism(3.5)),  # type: ignore[arg-type]
    ("prism beyond memory", ValueError, "bars", lambda: shapes.prism(10**400)),
    ("membrane beyond memory", ValueError, "q", lambda: shapes.membrane(q=10**400)),
    ("prism without radius", ValueError, "radius", lambda: shapes.prism(radius=0.0)),
    ("prism upside down", ValueError, "height", lambda: shapes.prism(height=-1.0)),
    ("prism twisted by nothing", ValueError, "twist", lambda: shapes.prism(twist=NAN)),
    ("prism prestressed at another twist", ValueError, "prestress", lambda: shapes.prism(twist=2.0, prestress=1.0)),
    ("prism prestressed beyond its stiffness", ValueError, "force_density", lambda: shapes.prism(prestress=99.0)),
    ("ball pushed", ValueError, "prestress", lambda: shapes.six_bar_ball(prestress=-1.0)),
    ("ball of no size", ValueError, "bar_length", lambda: shapes.six_bar_ball(0.0)),
    ("ball with its own bars", TypeError, "bars", lambda: shapes.six_bar_ball(bars=[(0, 1)])),
    ("prestress and rest lengths", ValueError, "rest_length", lambda: shapes.d_bar(prestress=1.0, rest_length=0.5)),
    ("folded D-bar", ValueError, "angle", lambda: shapes.d_bar(angle=np.pi / 2)),
    ("T-bar without width", ValueError, "width", lambda: shapes.t_bar(width=0.0)),
    ("pendulum of text", TypeError, "length", lambda: shapes.pendulum("long")),  # type: ignore[arg-type]
    ("double pendulum of three", ValueError, "lengths", lambda: shapes.double_pendulum(lengths=(1, 1, 1))),
    ("membrane of one ring", ValueError, "q", lambda: shapes.membrane(q=1)),
    ("membrane without mass", ValueError, "node_mass", lambda: shapes.membrane(node_mass=0.0)),
    # statics
    ("self-stress of nothing", TypeError, "structure", lambda: self_stress(None)),  # type: ignore[arg-type]
    ("equilibrium of nothing", TypeError, "structure", lambda: equilibrium_force_density("x")),  # type: ignore[arg-type]
    ("loads of some nodes", ValueError, "loads", lambda: equilibrium_force_density(build(), loads=np.zeros((2, 3)))),
    ("loads not numbers", ValueError, "loads", lambda: equilibrium_force_density(build(), loads=np.full((4, 3), NAN))),
    ("pushing strings", ValueError, "minimum of string 0", lambda: equilibrium_force_density(build(), minimum=-1.0)),
    ("minima of other strings", ValueError, "minimum", lambda: equilibrium_force_density(build(), minimum=[1.0])),
]  # fmt: skip


@pytest.mark.parametrize(
    ("kind", "field", "make"), [m[1:] for m in MISTAKES], ids=[m[0] for m in MISTAKES]
)
def test_mistakes_are_named(kind: type[Exception], field: str, make: Callable[[], Any]) -> None:
    with pytest.raises((TypeError, ValueError), match=rf"(^|\W){field}(?!\w)") as caught:
        make()
    assert caught.type is kind


def test_messages_name_the_value_and_the_cure() -> None:
    with pytest.raises(ValueError, match=r"^bar_mass of bar 1 is -2: it must be greater than 0$"):
        build(bar_mass=[1, -2])
    with pytest.raises(ValueError, match=r"^bars\[1\] is 4: node indices run from 0 to 3$"):
        build(bars=[(1, 2), (3, 4)])
    with pytest.raises(
        ValueError,
        match=r"node_mass of node 2 is 0 and no bar ends there: give it a mass, pin it .* string_mass",
    ):
        build(bars=[(0, 1)], pinned=[3])
    with pytest.raises(
        ValueError, match=r"^nodes has shape \(3, 4\): give an array of shape \(any, 3\)$"
    ):
        build(nodes=N)
    with pytest.raises(
        TypeError,
        match=r"^nodes is not an array of real numbers \(got str of <U3\): give an array of shape \(any, 3\)$",
    ):
        build(nodes="abc")
    with pytest.raises(
        TypeError, match=r"^length is not a real number \(got str of <U4\): give one number$"
    ):
        shapes.pendulum("long")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"^length has shape \(2,\): give one number$"):
        shapes.pendulum([1.0, 2.0])  # type: ignore[arg-type]


def test_numbers_of_any_kind_are_read() -> None:
    for value in (2, 2.0, np.float32(2), np.int8(2), Fraction(2), np.array(2.0)):
        assert validate.per_item("mass", value, 3).tolist() == [2.0, 2.0, 2.0]
        assert validate.positive_number("mass", value) == 2.0
    assert validate.per_item("mass", (1, Fraction(1, 2)), 2).tolist() == [1.0, 0.5]
    assert validate.finite_array("state", ca.DM([1, 2]), (2,)).tolist() == [1.0, 2.0]
    assert validate.finite_array("nodes", ca.DM([1, 2]), (2, 1)).tolist() == [[1.0], [2.0]]
    pairs = validate.node_pairs(
        "bars", (pair for pair in np.array([(0, 1), (1, 2)], dtype=np.uint8)), 3, "bar"
    )
    assert pairs.tolist() == [[0, 1], [1, 2]]
    assert validate.node_pairs("bars", [], 3, "bar").shape == (0, 2)
    assert validate.whole_number("count", np.int64(3), 1) == 3
    assert validate.positive_number("step", 0, zero=True) == 0.0


def test_results_are_read_only_copies() -> None:
    source = np.ones((2, 3))
    array = validate.finite_array("nodes", source, (None, 3))
    source[0, 0] = 7.0
    assert array[0, 0] == 1.0
    for result in (
        array,
        validate.per_item("mass", 1.0, 3),
        validate.node_pairs("bars", [(0, 1)], 2, "bar"),
    ):
        assert not result.flags.writeable


def test_coordinates_are_three_numbers_or_none() -> None:
    assert validate.coordinates("place", (1, None, Fraction(1, 2)), "a free axis") == (
        1.0,
        None,
        0.5,
    )
    assert validate.coordinates("place", ca.DM([1, 2, 3]), "a free axis", some=True) == (
        1.0,
        2.0,
        3.0,
    )
    assert validate.coordinates("place", [None] * 3, "a free axis") == (None, None, None)
    for kind, place in (
        (TypeError, 1.0),
        (TypeError, "abc"),
        (ValueError, (1, 2)),
        (ValueError, (1, 2, NAN)),
    ):
        with pytest.raises(kind, match=r"^place is "):
            validate.coordinates("place", place, "a free axis")
    with pytest.raises(
        ValueError,
        match=r"^place is \(None, None, None\): give three coordinates, None for a free axis$",
    ):
        validate.coordinates("place", (None, None, None), "a free axis", some=True)


def test_one_number_or_one_for_each() -> None:
    assert validate.number_or_vector("level", 2).shape == ()
    assert validate.number_or_vector("level", (2, 3)).tolist() == [2.0, 3.0]
    with pytest.raises(
        TypeError,
        match=r"^level is not an array of real numbers .*: give an array of shape \(any,\)$",
    ):
        validate.number_or_vector("level", [(1, 2), 3])
    with pytest.raises(
        ValueError, match=r"^level has shape \(1, 2\): give an array of shape \(any,\)$"
    ):
        validate.number_or_vector("level", [(1, 2)])


def test_faults_of_a_user_function_are_told_by_name() -> None:
    assert validate.call_user_function("law", abs, -1, "") == 1
    with pytest.raises(ValueError, match=r"^law fails with ZeroDivisionError: .*: give a speed$"):
        validate.call_user_function("law", lambda x: 1 / x, 0, "give a speed")
    with pytest.raises(ValueError, match=r"^law fails with \w+: .*: replace .* by casadi\.if_else"):
        validate.call_user_function("law", lambda x: max(x, 0), ca.SX.sym("x"), "")


class Mute:
    """Its repr fails."""

    def __repr__(self) -> str:
        raise RuntimeError("mute")


SHOWN = [
    (3, "3"),
    ("x", "'x'"),
    (-(10**5000), "a value of type int"),
    (Mute(), "a value of type Mute"),
    ("x" * 500, f"'{'x' * 299} …"),
]


@pytest.mark.parametrize(
    ("value", "words"), SHOWN, ids=["number", "text", "many digits", "no repr", "long"]
)
def test_messages_show_any_value(value: Any, words: str) -> None:
    assert validate.format_value(value) == words
    with pytest.raises(TypeError, match=rf"^field is {words}: give what is right$"):
        validate.instance("field", value, (), "what is right")
