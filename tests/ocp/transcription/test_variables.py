"""Variables of a plan: their order, and which of them something depends on."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from ocp.transcription.sparse_nlp import Block
from ocp.transcription.variables import Entries


def test_entries_are_ordered_interval_by_interval_with_constants_last():
    entries = Entries()
    later = entries.unknowns(["late", "later"], [1.0, 2.0], 0.5, interval=[1, 2])
    constants = entries.constants([[7.0], [8.0]])
    unused = entries.unknowns(["unused"], [3.0], 1.0)
    early = entries.unknowns(["early"], [4.0], 2.0, lower=-1.0, interval=0)
    entries.leave_out(unused)
    unknowns, place = entries.order()
    assert unknowns.names == ("early", "late", "later")
    assert unknowns.first == pytest.approx([4.0, 1.0, 2.0])
    assert unknowns.scale == pytest.approx([2.0, 0.5, 0.5])
    assert unknowns.lower == pytest.approx([-1.0, -np.inf, -np.inf])
    y = np.asarray(unknowns.entries(ca.DM(unknowns.first / unknowns.scale)).full()).ravel()
    assert y[place[np.concatenate([later, constants.ravel(), early])]] == pytest.approx(
        [1.0, 2.0, 7.0, 8.0, 4.0]
    )
    assert np.isnan(y[place[unused]]).all()  # whoever depends on it would see


def test_what_depends_on_an_entry_is_known():
    entries = Entries()
    index = entries.unknowns(["a", "b", "c"], [0.0, 0.0, 0.0], 1.0)
    z = ca.SX.sym("z", 2)
    block = Block(ca.Function("second", [z], [z[1] ** 2]), index[None, :2], ("row",))
    assert entries.find_used([block]).tolist() == [False, True, False]
