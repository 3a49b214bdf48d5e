"""Controls of the viewer: color, visibility, labels and legend.

Playback and interactive simulation share them.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from tenscasadi.drawing.color_scale import QUANTITIES
from tenscasadi.drawing.shapes import FORCES, PARTS
from tenscasadi.viewer.canvas import Canvas
from tenscasadi.viewer.labels import KINDS, Item, Labels
from tenscasadi.viewer.legend import build_legend
from tenscasadi.viewer.pictures import send_screenshot
from tenscasadi.viewer.web.hover import MODIFIER

if TYPE_CHECKING:
    import viser

FRAME_RATE = 30  # pictures per second
SPEEDS = ("0.01", "0.02", "0.05", "0.1", "0.2", "0.5", "1", "2", "5", "10")


class ViewControls:
    """Controls of the picture in the viewer's panel.

    Parameters
    ----------
    server : viser.ViserServer
        Server.
    canvas : Canvas
        Canvas.
    change : callable
        Executes a change of the picture, and redraws it.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        canvas: Canvas,
        change: Callable[[Callable[[], Any]], None],
    ) -> None:
        self.canvas, self._change, self._gui = canvas, change, server.gui
        self.labels = Labels(server, canvas)
        server.gui.configure_theme(show_logo=False, show_share_button=False)
        self._legend: Any = None
        self._under_pointer: Item | None = None
        self._add_hover(server.scene)

    def add_follow(self) -> None:
        """Add the check box that keeps the structure in view."""
        follow = partial(setattr, self.canvas, "followed")
        self._add_box("Follow", self.canvas.followed, follow, "keep the structure in view")

    def add_color(self) -> None:
        """Add the menu of the quantity that colors the strings."""
        choice = self._gui.add_dropdown(
            "Color", tuple(QUANTITIES), initial_value=self.canvas.quantity
        )
        choice.on_update(lambda _: self._change(lambda: self.color_by(choice.value)))

    def add_shadows(self) -> None:
        """Add the check box of shadows on grounds."""
        hint = "shadows on grounds; slow without a graphics card"
        self._add_box("Shadows", self.canvas.shaded, self.canvas.cast_shadows, hint)

    def add_visibility(self) -> None:
        """Add check boxes that show, hide and place several trajectories."""
        if len(self.canvas.layers) > 1:
            hint = "show the motions beside each other"
            self._add_box("Side by side", self.canvas.apart, self._arrange, hint)
        for layer in self.canvas.layers if len(self.canvas.layers) > 1 else ():
            self._add_box(layer.shapes.motion.name, True, partial(setattr, layer.root, "visible"))

    def _arrange(self, apart: bool) -> None:
        """Show the trajectories side by side if `apart`, else superimposed."""
        self.canvas.arrange(apart)
        self.update_legend()

    def add_forces(self) -> None:
        """Add a check box for each kind of forces on nodes."""
        for forces in self.canvas.content.motions[0].forces:
            is_shown = forces.name in self.canvas.kinds
            self._add_box(
                FORCES[forces.name].capitalize(), is_shown, partial(self.show_forces, forces.name)
            )

    def show_forces(self, kind: str, shown: bool) -> None:
        """Show or hide the arrows of a kind of forces.

        An example of a kind is "load".
        """
        self.canvas.kinds = (self.canvas.kinds | {kind}) if shown else (self.canvas.kinds - {kind})
        self.update_legend()

    def add_labels(self) -> None:
        """Add check boxes that number nodes and members.

        Clicked nodes and members get a label, too.
        """
        with self._gui.add_folder("Numbers", expand_by_default=False):
            for kind in KINDS:
                if kind in self.canvas.layers[0].batches:
                    self._add_box(f"Numbers of {kind}", False, partial(self.labels.number, kind))
        for k, layer in enumerate(self.canvas.layers):
            for kind in PARTS:
                if kind in KINDS and kind in layer.batches:
                    layer.batches[kind].on_click(
                        lambda event, k=k, kind=kind: self.click(k, kind, event.instance_index)
                    )

    def add_screenshot(self, name: str) -> None:
        """Add the button that saves the picture in the browser.

        `name` is that of the file.
        """
        hint = "the picture as a PNG file"
        button = self._gui.add_button("Screenshot", hint=hint)
        button.on_click(lambda event: send_screenshot(event.client, name))

    def add_legend(self) -> None:
        """Add the legend."""
        self._legend = self._gui.add_html(build_legend(self.canvas))

    def update_legend(self) -> None:
        """Update the legend."""
        if self._legend is not None:
            self._legend.content = build_legend(self.canvas)

    def color_by(self, quantity: str) -> None:
        """Color strings by a quantity, "tension" or "force density".

        Unknown quantities, which a page can send, are ignored.
        """
        if quantity in QUANTITIES:
            self.canvas.color_by(quantity)
            self.update_legend()

    def click(self, motion: int, kind: str, index: int | None) -> None:
        """Show or remove the label of a clicked node or member.

        `motion` is the number of its trajectory, `kind` is "nodes", "bars" or "strings", and
        `index` its index there.
        """
        if isinstance(index, int):
            self._change(lambda: self.labels.toggle((motion, kind, index)))

    def _add_hover(self, scene: viser.SceneApi) -> None:
        """Show the name of the node or member under the pointer.

        Viser reports a click on an item before the click on the scene. The latter is reported also
        without an item.
        """
        for k, layer in enumerate(self.canvas.layers):
            for kind in KINDS:
                if kind in layer.batches:

                    async def touch(event: Any, k: int = k, kind: str = kind) -> None:
                        if isinstance(event.instance_index, int):
                            self._under_pointer = k, kind, event.instance_index

                    layer.batches[kind].on_click(modifier=MODIFIER)(touch)

        async def rest(_: Any) -> None:
            item, self._under_pointer = self._under_pointer, None
            if item != self.labels.hovered:
                self._change(lambda: self.labels.hover(item))

        register: Any = scene.on_click(modifier=MODIFIER)  # viser's type lacks coroutines
        register(rest)

    def _add_box(
        self, name: str, value: bool, apply: Callable[[bool], Any], hint: str | None = None
    ) -> None:
        """Add a check box that changes the picture.

        It has a name, an initial value and a hint. `apply` is called with each new value.
        """
        box = self._gui.add_checkbox(name, value, hint=hint)
        box.on_update(lambda _: self._change(lambda: apply(bool(box.value))))


def add_speed(gui: viser.GuiApi, speed: float, set_speed: Callable[[float], Any]) -> None:
    """Add the menu of the playback speed.

    It belongs to the controls `gui`. Speeds are in simulated seconds per second. `set_speed` is
    called with each new one.
    """
    current = f"{speed:g}"
    speeds = tuple(sorted({*SPEEDS, current}, key=float))
    hint = "simulated seconds per second"
    choice = gui.add_dropdown("Speed", speeds, initial_value=current, hint=hint)

    def update(_: Any) -> None:
        if choice.value in speeds:  # a page can send any text
            set_speed(float(choice.value))

    choice.on_update(update)
