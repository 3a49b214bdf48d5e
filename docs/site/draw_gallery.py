"""Draws docs/gallery/: pictures as the examples draw them, made small.

All of them take ten minutes; some: python docs/site/draw_gallery.py plan_prism paper_dbar
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
GALLERY = ROOT / "docs" / "gallery"
WIDTH, COLOURS = 900, 96

# pictures by the example that draws them
PICTURES = {
    "paper_prism": ("paper_prism", "paper_prism_convergence"),
    "paper_dbar": ("paper_dbar", "paper_dbar_figure_7"),
    "paper_membrane": ("paper_membrane_24_13", "paper_membrane"),
    "paper_lander": ("paper_lander", "paper_lander_height"),
    "simulate_ball": ("simulate_ball",),
    "double_pendulum": ("double_pendulum",),
    "ball_on_terrain": ("ball_on_terrain",),
    "sweep_stiffness": ("sweep_stiffness",),
    "tradeoff_prism": ("tradeoff_prism_schemes",),
    "plan_prism": ("plan_prism", "plan_prism_forces"),
    "plate_on_strings": ("plate_on_strings",),
    "dbar_folds": ("dbar_folds",),
    "two_motors": ("two_motors",),
    "bars_touch": ("bars_touch",),
    "arm_reaches": ("arm_reaches",),
    "swing_up": ("swing_up",),
    "standing_balance": ("standing_balance",),
    "catch_prism": ("catch_prism",),
    "ball_rolls": ("ball_rolls",),
    "plan_landing": ("plan_landing",),
    "prism_gait": ("prism_gait",),
    "contact_problems": ("contact_problems",),
    "ball_travels": ("ball_travels",),
    "learn_to_travel": ("learn_to_travel",),
}


def draw(example: str) -> None:
    """Run an example and keep its pictures, small."""
    with TemporaryDirectory() as folder:
        __import__(example).main(folder=Path(folder))
        for picture in PICTURES[example]:
            shrink(Path(folder, f"{picture}.png"), GALLERY / f"{picture}.png")


def shrink(large: Path, small: Path) -> None:
    """Write a picture with fewer pixels and a palette of few colours."""
    with Image.open(large) as image:
        picture = image.convert("RGB")
        picture.thumbnail((WIDTH, WIDTH))
        picture.quantize(COLOURS, dither=Image.Dither.NONE).save(small, optimize=True)


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT / "examples"))
    GALLERY.mkdir(exist_ok=True)
    for name in sys.argv[1:] or PICTURES:
        draw(name)
