"""The same forms, forces and least masses as jax-fdm and tnsgrt find."""

from __future__ import annotations

import warnings
from importlib.util import find_spec

import numpy as np
import pytest
from design_peers import load_jax_fdm, load_tnsgrt, network, peer_structure, positions

import tenscasadi as tc

pytestmark = [
    pytest.mark.slow,  # jax takes ten seconds to load and to compile
    pytest.mark.filterwarnings("ignore"),
]
jax_fdm = pytest.mark.skipif(find_spec("jax_fdm") is None, reason="needs jax-fdm")
tnsgrt = pytest.mark.skipif(find_spec("tnsgrt") is None, reason="needs tnsgrt")


@jax_fdm
def test_net_has_the_form_of_jax_fdm() -> None:
    FDNetwork, fdm, _ = load_jax_fdm()
    net = tc.shapes.hyperbolic_paraboloid(8)
    density = np.random.default_rng(0).uniform(0.5, 3.0, len(net.strings))
    form = tc.form_find(net, density)
    peer = positions(fdm(network(FDNetwork, net, density)))
    np.testing.assert_allclose(form.structure.nodes, peer, atol=1e-12)


@jax_fdm
def test_prescribed_lengths_are_met_better_than_by_jax_fdm() -> None:
    FDNetwork, _, constrained_fdm = load_jax_fdm()
    from jax_fdm.goals import EdgeLengthGoal
    from jax_fdm.losses import Loss, SquaredError
    from jax_fdm.optimization import LBFGSB

    net = tc.shapes.hyperbolic_paraboloid(5)
    lengths = {k: 1.1 * net.string_lengths[k] for k in range(0, 40, 9)}
    goals = [EdgeLengthGoal(tuple(net.strings[k].tolist()), target=v) for k, v in lengths.items()]
    loss = Loss(SquaredError(goals))
    peer = positions(constrained_fdm(network(FDNetwork, net, 1.0), LBFGSB(), loss, maxiter=500))
    form = tc.form_find(net, lengths=lengths)
    assert form.success, form.message

    def miss(nodes: np.ndarray) -> float:
        ends = nodes[net.strings]
        found = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        return max(abs(found[k] - length) for k, length in lengths.items())

    assert miss(form.structure.nodes) < 1e-9 < miss(peer) < 1e-2


@tnsgrt
@pytest.mark.parametrize("shape", ["prism", "six_bar_ball", "truncated_tetrahedron"])
def test_self_stress_is_that_of_tnsgrt(shape: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        peer = peer_structure(load_tnsgrt(), tc.shapes.ShapeFamily.members[shape]())
        peer.equilibrium()
    s = tc.shapes.ShapeFamily.members[shape]()
    pre = tc.find_prestress(s, tc.Least(), minimum=1.0)
    assert pre.success, pre.message
    density = np.concatenate([pre.force_density, -pre.bar_force / s.bar_lengths])
    found = peer.member_properties["lambda_"].to_numpy()
    strings = len(s.strings)
    expected = np.concatenate([found[:strings], -found[strings:]])
    np.testing.assert_allclose(density / density[0], expected / expected[0], rtol=1e-6)


@tnsgrt
@pytest.mark.parametrize("shape", ["prism", "six_bar_ball"])
def test_stiffness_of_elastic_members_is_that_of_tnsgrt(shape: str) -> None:
    s = tc.shapes.ShapeFamily.members[shape]()
    s = s.replace(stiffness=1e3, bar_stiffness=5e3)
    density = tc.self_stress(s)[0] * 20.0
    density = density * np.sign(density[0])
    found = tc.stability(s, density)
    strings = len(s.strings)
    tension = np.concatenate([density[:strings], -density[strings:]])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        peer = peer_structure(load_tnsgrt(), s)
        peer.member_properties["lambda_"] = tension
        peer.member_properties["stiffness"] = np.repeat([1e3, 5e3], [strings, len(s.bars)])
        K = np.asarray(peer.stiffness(storage="dense")[0].K)
    values = np.linalg.eigvalsh(K)
    np.testing.assert_allclose(values[:6], 0.0, atol=1e-8)
    np.testing.assert_allclose(found.eigenvalues, values[6:], rtol=1e-6)
