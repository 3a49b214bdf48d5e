"""Panel of an interactive simulation."""

from __future__ import annotations

from collections.abc import Callable
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from tenscasadi.drawing.color_scale import ColorScale
from tenscasadi.drawing.describe import describe_content
from tenscasadi.drawing.style import STYLE, linearize_colors
from tenscasadi.scene.scene import Scene
from tenscasadi.util.tables import MOST_LISTED
from tenscasadi.viewer.canvas import Canvas
from tenscasadi.viewer.controls import ViewControls, add_speed
from tenscasadi.viewer.live_mode.pace import Pace
from tenscasadi.viewer.live_mode.simulation import LiveSimulation
from tenscasadi.viewer.live_mode.sliders import (
    ParameterSlider,
    Slider,
    build_slider,
    choose_parameter_sliders,
)

if TYPE_CHECKING:
    import viser

_POSITIONS = 400  # of a slider
_HINT = "Start runs the time. Drag a node, bar or string to pull it."


class LivePanel:
    """Canvas and controls of an interactive simulation.

    Parameters
    ----------
    server : viser.ViserServer
        Server.
    simulation : LiveSimulation
        Simulation.
    pace : Pace
        Speed of the simulation.
    sliders : list of Slider
        Sliders of the strings.
    do : callable
        Executes an order between two ticks.

    Attributes
    ----------
    running : bool
        Whether the simulation runs.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        simulation: LiveSimulation,
        pace: Pace,
        sliders: list[Slider],
        do: Callable[[Callable[[], Any]], None],
    ) -> None:
        self.simulation, self.pace, self._do = simulation, pace, do
        self.canvas = Canvas(server, describe_content(simulation.model.scene))
        self.canvas.followed = not _is_supported(simulation.model.scene)
        self.canvas.scale = None
        self.controls = ViewControls(server, self.canvas, do)
        self.running, self._said = False, _HINT
        self._inputs: list[tuple[Slider | ParameterSlider, Any]] = []
        radius = 0.6 * self.canvas.content.bar_radius
        self._arrow = server.scene.add_arrows(
            "/shown/pull",
            np.zeros((1, 2, 3)),
            linearize_colors(STYLE.load),
            shaft_radius=radius,
            head_radius=2.5 * radius,
            head_length=6.0 * radius,
            visible=False,
        )
        gui = server.gui
        self._status = gui.add_html("")
        self._play = gui.add_button("Start")
        self._play.on_click(lambda _: do(lambda: self.run(not self.running)))
        hint = "back to the initial state, control and parameters"
        gui.add_button("Reset", hint=hint).on_click(lambda _: do(self.reset))
        add_speed(gui, pace.speed, lambda speed: do(lambda: setattr(pace, "speed", speed)))
        self.controls.add_follow()
        if simulation.model.nu:
            self.controls.add_color()
        self._add_pull(gui)
        self._add_sliders(gui, sliders)
        self._add_parameters(gui)
        self.show()
        self.controls.add_legend()

    def add_saving(
        self,
        gui: viser.GuiApi,
        path: str | None,
        save: Callable[[], None],
        download: Callable[[Any], None],
    ) -> None:
        """Add the buttons that save the recording.

        They belong to the controls `gui`. `save` writes it to `path` on this machine, and
        `download` sends it to the browser. Without a path there is no button for the former.
        """
        if path is not None:
            gui.add_button("Save", hint=f"writes {path}").on_click(lambda _: self._do(save))
        hint = "the recording as a file of tenscasadi.Trajectory"
        button = gui.add_button("Download", hint=hint)
        button.on_click(lambda event: self._do(lambda: download(event.client)))

    # --- actions of a person ---

    def run(self, running: bool) -> None:
        """Continue the simulation if `running`, else pause it."""
        self.running, self._said = running, ""
        self._play.label = "Pause" if running else "Continue"
        self.pace.rest()

    def reset(self) -> None:
        """Return to the initial state, control and parameters."""
        self.simulation.reset()
        self.canvas.scale = None
        self.refresh()
        self.say("")
        self.pace.rest()

    def say(self, text: str) -> None:
        """Display a message until the next one or a reset.

        `text` is the message.
        """
        self._said = text

    def find_node(self, part: str, index: int, seen: Any) -> int:
        """Find the movable node of a clicked part that is nearest to the click.

        The part is number `index` of "nodes", "bars" or "strings" (`part`). `seen` is the position
        of the click in the scene of the viewer.
        """
        structure, pullable = self.simulation.model.structure, self.simulation.pullable
        ends = np.array([index]) if part == "nodes" else np.asarray(getattr(structure, part))[index]
        ends = ends[(ends < len(pullable)) & pullable[np.minimum(ends, len(pullable) - 1)]]
        if not len(ends):
            raise ValueError(f"nothing of {part}[{index}] can be pulled")
        away = self.simulation.nodes[ends] - self.canvas.locate(seen)
        return int(ends[np.argmin(np.einsum("ij,ij->i", away, away))])

    # --- display ---

    def show(self) -> None:
        """Show the present state."""
        frame = self.simulation.frame
        values = np.nan_to_num(np.asarray(frame.values(self.canvas.quantity)))
        scale = self.canvas.scale
        if scale is not None and scale.quantity == self.canvas.quantity:
            self.canvas.scale = scale.widen(values)
        elif np.any(values):
            self.canvas.scale = ColorScale.of(self.canvas.quantity, values)
        if scale != self.canvas.scale:
            self.controls.update_legend()
        self.canvas.draw([frame])
        self.controls.labels.update()
        pull = self.simulation.pull
        self._arrow.visible = pull is not None
        if pull is not None:
            ends = self.canvas.shift([frame.nodes[pull.node], pull.target])
            self._arrow.points = ends.astype(np.float32)[None]

    def tell(self) -> None:
        """Display the time, the speed and messages in the panel."""
        simulation, slowness = self.simulation, self.pace.message if self.running else ""
        stopped = "" if self.running or simulation.fault else ", paused"
        lines = [f"<b>t = {simulation.time:.2f} s</b>{stopped}"]
        if simulation.pull is not None:
            force = np.linalg.norm(simulation.pull_force)
            lines.append(f"pull at node {simulation.pull.node}: {force:.3g} N")
        lines += [escape(text) for text in (slowness, self._said) if text]
        if simulation.fault:
            fault = f"The simulation {escape(simulation.fault)}. Reset starts again."
            lines.append(f'<span style="color:#b71c1c">{fault}</span>')
        style = "font:13px/1.45 system-ui,sans-serif;padding:4px 8px"
        content = f'<div style="{style}" class="live-status">{"<br>".join(lines)}</div>'
        if content != self._status.content:
            self._status.content = content

    def refresh(self, moved: int | None = None) -> None:
        """Move the sliders to the present control values.

        The slider `moved`, which the user drags, is not changed.
        """
        for place, (slider, entry) in enumerate(self._inputs):
            value = slider.read(self.simulation)
            if place != moved and not abs(value - entry.value) <= 0.5 * entry.step:
                entry.value = value

    def drive(self, place: int, value: float) -> None:
        """Apply the value of a slider to the simulation.

        `place` is the index of the slider.
        """
        self._inputs[place][0].apply(self.simulation, value)
        self.refresh(place)

    # --- construction ---

    def _add_pull(self, gui: viser.GuiApi) -> None:
        if not self.simulation.pullable.any():
            style = "font:12px system-ui,sans-serif;padding:4px 8px"
            reason = "No node can be pulled: all are pinned, or nodal forces vary with time."
            gui.add_html(f'<div style="{style}">{reason}</div>')
            return
        usual = self.simulation.pull_stiffness
        most = 5.0 * usual  # a stiffer spring vibrates
        hint = "drag a node, bar or string with the mouse: a spring pulls its nearest node"
        spring = gui.add_slider("Pull (N/m)", 0.0, most, most / _POSITIONS, usual, hint=hint)

        def change(_: Any) -> None:
            stiffness = float(np.clip(np.nan_to_num(spring.value), 0.0, most))
            self._do(lambda: setattr(self.simulation, "pull_stiffness", stiffness))

        spring.on_update(change)
        for part in ("nodes", "bars", "strings"):
            if part in self.canvas.layers[0].batches:
                self.canvas.layers[0].batches[part].on_drag(self._drag(part))

    def _drag(self, part: str) -> Callable[[Any], Any]:
        async def drag(event: Any) -> None:  # in the order in which the pointer moves
            phase, index = event.phase, event.instance_index
            ends = event.start_position, event.end_position
            self._do(lambda: self._pull(part, phase, index, *ends))

        return drag

    def _pull(self, part: str, phase: str, index: int, begin: Any, end: Any) -> None:
        simulation = self.simulation
        if phase == "start":
            node = self.find_node(part, int(index), begin)
            simulation.grab(node, self.canvas.locate(end))
        elif phase == "end":
            simulation.release()
        elif simulation.pull is not None:
            simulation.grab(simulation.pull.node, self.canvas.locate(end))

    def _add_sliders(self, gui: viser.GuiApi, sliders: list[Slider]) -> None:
        if not sliders:
            return
        control = self.simulation.model.scene.control
        title = "" if control is None else f"{control.quantity.capitalize()} ({control.unit})"
        with gui.add_folder(title):
            for slider in sliders:
                self._add_slider(gui, slider)
            if self.simulation.model.nu > MOST_LISTED:
                self._add_choice(gui)

    def _add_parameters(self, gui: viser.GuiApi) -> None:
        sliders = choose_parameter_sliders(self.simulation)
        if sliders:
            with gui.add_folder("Parameters"):
                for slider in sliders:
                    self._add_slider(gui, slider)

    def _add_slider(self, gui: viser.GuiApi, slider: Slider | ParameterSlider) -> Any:
        step = (slider.high - slider.low) / _POSITIONS
        value = slider.read(self.simulation)
        entry = gui.add_slider(slider.name, slider.low, slider.high, step, value)
        place = len(self._inputs)
        self._inputs.append((slider, entry))

        async def change(event: Any) -> None:  # at once and in order, before the next `refresh`
            if event.client is not None:  # a person, not `refresh`
                value = float(entry.value)
                self._do(lambda: self.drive(place, value))

        entry.on_update(change)
        return entry

    def _add_choice(self, gui: viser.GuiApi) -> None:
        """Add an input for the index of a string, and a slider for it.

        Both belong to the controls `gui`.
        """
        count = self.simulation.model.nu
        number = gui.add_number("String", 0, min=0, max=count - 1, step=1)
        entry = self._add_slider(gui, build_slider(self.simulation, 0))
        place = len(self._inputs) - 1

        def choose() -> None:
            slider = build_slider(self.simulation, min(max(int(number.value), 0), count - 1))
            self._inputs[place] = (slider, entry)
            entry.label, entry.min, entry.max = slider.name, slider.low, slider.high
            entry.step = (slider.high - slider.low) / _POSITIONS
            self.refresh()

        number.on_update(lambda _: self._do(choose))


def _is_supported(scene: Scene) -> bool:
    """Return whether the structure cannot fall without end."""
    held = bool(scene.structure.fixed.any()) or bool(scene.structure.rollers)
    falls = scene.gravity is not None and np.any(scene.gravity.acceleration)
    return held or bool(scene.grounds) or not falls
