"""What accuracy costs: schemes and steps on a prism that vibrates and goes slack, how it is run, and how much the modelling of its strings
matters beside them.

Run it with a folder for the pictures: python examples/tradeoff_prism.py pictures
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

import tenscasadi as tc

TOLERANCES = (1e-3, 1e-6, 1e-9)  # m


def main(
    folder: Path = Path(), quick: bool = False
) -> tuple[tc.Tradeoff, tc.Tradeoff, tc.Recommendation]:
    """Prints the tables and a recommendation, saves the pictures and returns the first, the last and the advice. `quick`: a short run, few steps and
    schemes, nothing compiled."""
    folder.mkdir(parents=True, exist_ok=True)
    prism = tc.shapes.prism(prestress=5.0, stiffness=500.0, string_mass=0.1)
    steps = np.geomspace(2e-2, 2e-3 if quick else 2e-4, 3 if quick else 7).tolist()

    t_end = 0.1 if quick else 1.0
    common: dict[str, Any] = {
        "state": turning,
        "repeats": 1 if quick else 3,
        "compiled": (False if quick else None,),
    }

    model = tc.Model(tc.Scene(prism))
    schemes: list[tc.RungeKutta4 | tc.DormandPrince54 | tc.DormandPrince853 | tc.Rattle] = [
        tc.RungeKutta4(),
        tc.DormandPrince853(),
        tc.Rattle(),
    ]
    if not quick:
        schemes += [tc.DormandPrince853(rtol=rtol) for rtol in (1e-4, 1e-6, 1e-8, 1e-10)]
    numerics = tc.tradeoff(model, t_end, schemes, steps, **common)
    print(f"schemes: {prism!r}, {t_end:g} s\n{numerics.summary()}\n")
    for tolerance in TOLERANCES[: 1 if quick else 3]:
        row = numerics.cheapest(tolerance)
        print(
            f"fastest within {tolerance:g} m: {row.name}"
            + ("" if np.isnan(row.step) else f", step {row.step:.2g} s")
        )
    numerics.plot(folder / "tradeoff_prism_schemes.png", title="a prism that goes slack: schemes")

    ways = (False,) if quick else (True, tc.Single(), False)
    running = tc.tradeoff(
        model,
        t_end,
        schemes[:1],
        steps,
        state=turning,
        corrections=(tc.Projection(),),
        compiled=ways,
        repeats=common["repeats"],
    )
    print(f"\nways to run:\n{running.summary()}")
    running.plot(folder / "tradeoff_prism_ways.png", title="a prism that goes slack: ways to run")

    finest = 3 if quick else 6
    models = {f"{finest} segments, lumped": strings(prism, finest, lumped=True)}
    models |= {
        f"{k} segments{', lumped' * lumped}": strings(prism, k, lumped)
        for k in (2, finest - 1)
        for lumped in (False, True)
    }
    models |= {
        "massless strings": model,
        "massless, slack smooth over 1 mm": tc.Model(tc.Scene(prism, slack=tc.Smooth(1e-3))),
    }
    modelling = tc.tradeoff(models, t_end, [tc.DormandPrince853()], [1e-3], **common)
    print(f"\nmodelling, against {finest} lumped segments a string:\n{modelling.summary()}")
    modelling.plot(
        folder / "tradeoff_prism_modelling.png", title="a prism that goes slack: modelling"
    )

    wanted, choices = (1e-3, schemes[:1]) if quick else (1e-6, [*schemes[:2], schemes[-1]])
    advice = tc.recommend(
        model, t_end, wanted, turning(model), schemes=choices, compiled=False if quick else None
    )
    print(f"\nrecommended: {advice.message}")
    return numerics, modelling, advice


def strings(structure: tc.Structure, segments: int, lumped: bool) -> tc.Model:
    """The model with strings in segments."""
    return tc.Model(tc.Scene(structure, segments=segments, ends="lumped" if lumped else "interior"))


def turning(model: tc.Model) -> np.ndarray:
    """The start: top and bottom turn against each other, strings' nodes with them; bars keep their length."""
    nodes = model.structure.nodes
    velocities = np.cross((0.0, 0.0, 5.0), nodes) * np.sign(nodes[:, 2:] - 0.5) + np.cross(
        (2.0, 0.0, 0.0), nodes
    )
    state = tc.Projection().step(model)
    assert state is not None
    return np.asarray(state(model.state(nodes, velocities)).full()).ravel()


if __name__ == "__main__":
    main(Path(*sys.argv[1:2]))
