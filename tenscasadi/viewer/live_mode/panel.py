"""The panel of a live motion: pause, reset, speed, save, sliders, and what there is to say."""

from __future__ import annotations

from collections.abc import Callable
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from tenscasadi.scene.strings import RestLength
from tenscasadi.viewer.canvas import QUANTITIES
from tenscasadi.viewer.live_mode.pace import Pace
from tenscasadi.viewer.live_mode.sliders import MOST, Slider, single
from tenscasadi.viewer.live_mode.stage import Stage

if TYPE_CHECKING:
    import viser

SPEEDS = ("0.05", "0.1", "0.2", "0.5", "1", "2", "5")
_POSITIONS = 400  # of a slider
_STIFFER = 5.0  # than the usual spring at the pointer: more would shake


class Panel:
    """Inputs of the panel. What is done with them is handed to `do`, which runs it between two ticks.

    Attributes
    ----------
    running : bool
        Whether time goes on.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        stage: Stage,
        pace: Pace,
        sliders: list[Slider],
        do: Callable[[Callable[[], Any]], None],
    ) -> None:
        self.stage, self.simulation, self.pace, self._do = stage, stage.simulation, pace, do
        self.running = True
        self._said = ""
        self._inputs: list[tuple[Slider, Any]] = []
        gui = server.gui
        gui.configure_theme(show_logo=False, show_share_button=False)
        self._status = gui.add_html("")
        self._play = gui.add_button("Pause")
        self._play.on_click(lambda _: do(lambda: self.run(not self.running)))
        gui.add_button("Reset", hint="back to the start, with the control of the start").on_click(
            lambda _: do(self.reset)
        )
        self._add_speed(gui)
        self._add_looks(gui)
        self._add_pull(gui)
        self._add_sliders(gui, sliders)
        self._legend = gui.add_html(stage.legend())

    def add_saving(
        self,
        gui: viser.GuiApi,
        path: str | None,
        save: Callable[[], None],
        download: Callable[[Any], None],
    ) -> None:
        """Add the buttons that save what is recorded: to the path that was given, and by the browser."""
        if path is not None:
            gui.add_button("Save", hint=f"writes {path}").on_click(lambda _: self._do(save))
        button = gui.add_button(
            "Download", hint="the recorded motion as a file of tenscasadi.Trajectory"
        )
        button.on_click(lambda event: self._do(lambda: download(event.client)))

    # --- what a person does ---

    def run(self, running: bool) -> None:
        """Go on, or pause."""
        self.running = running
        self._play.label = "Pause" if running else "Go on"
        self.pace.rest()

    def reset(self) -> None:
        """Go back to the start."""
        self.simulation.reset()
        self.stage.recolour(self.stage.colour)
        self.refresh()
        self.say("")
        self.pace.rest()

    def say(self, text: str) -> None:
        """Say something until the next reset, or until something else is said."""
        self._said = text

    # --- what is shown ---

    def show(self) -> None:
        """Bring the scene to the present state."""
        if self.stage.show():
            self._legend.content = self.stage.legend()

    def tell(self) -> None:
        """Bring the words to the present state."""
        simulation, words = self.simulation, self.pace.words if self.running else ""
        lines = [
            f"<b>t = {simulation.time:.2f} s</b>"
            + ("" if self.running or simulation.fault else ", paused")
        ]
        if simulation.pull is not None:
            lines.append(
                f"pull at node {simulation.pull.node}: {np.linalg.norm(simulation.pull_force):.3g} N"
            )
        lines += [escape(text) for text in (words, self._said) if text]
        if simulation.fault:
            lines.append(
                f'<span style="color:#b71c1c">The motion has {escape(simulation.fault)}. Reset starts again.</span>'
            )
        content = f'<div style="font:13px/1.45 system-ui,sans-serif;padding:4px 8px" class="live-status">{"<br>".join(lines)}</div>'
        if content != self._status.content:
            self._status.content = content

    def refresh(self, moved: int | None = None) -> None:
        """Bring the sliders to the present control, but for the one that somebody moves: it is further by now."""
        for place, (slider, entry) in enumerate(self._inputs):
            value = slider.read(self.simulation)
            if place != moved and not abs(value - entry.value) <= 0.5 * entry.step:
                entry.value = value

    # --- building ---

    def _add_speed(self, gui: viser.GuiApi) -> None:
        asked = f"{self.pace.speed:g}"
        speeds = SPEEDS if asked in SPEEDS else tuple(sorted({*SPEEDS, asked}, key=float))
        chosen = gui.add_dropdown(
            "Speed", speeds, initial_value=asked, hint="simulated seconds in each second"
        )

        def change(_: Any) -> None:
            if chosen.value in speeds:  # whatever a page sends
                self._do(lambda: setattr(self.pace, "speed", float(chosen.value)))

        chosen.on_update(change)

    def _add_looks(self, gui: viser.GuiApi) -> None:
        follow = gui.add_checkbox(
            "Follow", self.stage.followed, hint="keep the middle of the structure in view"
        )
        follow.on_update(
            lambda _: self._do(lambda: setattr(self.stage, "followed", bool(follow.value)))
        )
        if self.simulation.model.nu:
            colour = gui.add_dropdown("Colour", tuple(QUANTITIES), initial_value=self.stage.colour)

            def change(_: Any) -> None:
                if colour.value in QUANTITIES:
                    self._do(lambda: self.stage.recolour(colour.value))

            colour.on_update(change)

    def _add_pull(self, gui: viser.GuiApi) -> None:
        if not self.simulation.pullable.any():
            gui.add_html(
                '<div style="font:12px system-ui,sans-serif;padding:4px 8px">Nothing can be pulled: the forces change over time.</div>'
            )
            return
        usual = self.simulation.pull_stiffness
        hint = "drag a node, bar or string with the mouse: a spring pulls its nearest node to the pointer"
        spring = gui.add_slider(
            "Pull (N/m)", 0.0, _STIFFER * usual, _STIFFER * usual / _POSITIONS, usual, hint=hint
        )

        def change(_: Any) -> None:
            value = float(spring.value)
            if np.isfinite(value):
                self._do(
                    lambda: setattr(
                        self.simulation, "pull_stiffness", min(max(value, 0.0), _STIFFER * usual)
                    )
                )

        spring.on_update(change)

    def _add_sliders(self, gui: viser.GuiApi, sliders: list[Slider]) -> None:
        if not sliders:
            return
        kind = (
            "Rest lengths (m)"
            if isinstance(self.simulation.model.scene.control, RestLength)
            else "Force densities (N/m)"
        )
        with gui.add_folder(kind):
            for slider in sliders:
                self._add_slider(gui, slider)
            if self.simulation.model.nu > MOST:
                self._add_choice(gui)

    def _add_slider(self, gui: viser.GuiApi, slider: Slider) -> Any:
        step = (slider.high - slider.low) / _POSITIONS
        entry = gui.add_slider(
            slider.name, slider.low, slider.high, step, slider.read(self.simulation)
        )
        place = len(self._inputs)
        self._inputs.append((slider, entry))

        async def change(
            event: Any,
        ) -> None:  # at once and in order: `refresh` must not come in between
            if event.client is not None:  # a person, not `refresh`
                value = float(entry.value)
                self._do(lambda: self._drive(place, value))

        entry.on_update(change)
        return entry

    def _add_choice(self, gui: viser.GuiApi) -> None:
        """Add a number of a string, and the slider of that string."""
        count = self.simulation.model.nu
        number = gui.add_number("String", 0, min=0, max=count - 1, step=1)
        entry = self._add_slider(gui, single(self.simulation, 0))
        place = len(self._inputs) - 1

        def choose() -> None:
            slider = single(self.simulation, min(max(int(number.value), 0), count - 1))
            self._inputs[place] = (slider, entry)
            entry.label, entry.min, entry.max = slider.name, slider.low, slider.high
            entry.step = (slider.high - slider.low) / _POSITIONS
            self.refresh()

        number.on_update(lambda _: self._do(choose))

    def _drive(self, place: int, value: float) -> None:
        self._inputs[place][0].apply(self.simulation, value)
        self.refresh(place)
