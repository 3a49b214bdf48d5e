"""Pictures of values in notebooks."""

from __future__ import annotations

from base64 import b64decode
from io import BytesIO

import numpy as np
import pytest
from PIL import Image

import tenscasadi as tc

PRISM = tc.shapes.prism(prestress=50.0)
MODEL = tc.Model(tc.Scene(PRISM))


def build_values():
    """Build a value of each class that notebooks draw."""
    yield PRISM
    yield MODEL.scene
    yield tc.simulate(MODEL, 0.02, 0.01, compiled=False)
    yield tc.rollouts(MODEL, 0.02, 0.01, states=[MODEL.initial_state] * 2)


@pytest.mark.parametrize("value", list(build_values()), ids=lambda value: type(value).__name__)
def test_notebooks_show_a_picture_with_a_caption(value):
    html = value._repr_html_()
    picture = html.partition("base64,")[2].partition('"')[0]
    pixels = np.asarray(Image.open(BytesIO(b64decode(picture))).convert("L"))
    assert (pixels < 128).mean() > 0.005
    assert f"<figcaption>{type(value).__name__}(" in html
    assert len(html) < 1e5
