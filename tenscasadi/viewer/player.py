"""Playback of trajectories: play, pause, time and speed."""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from tenscasadi.drawing.view_content import choose_frame_times
from tenscasadi.viewer.canvas import Canvas
from tenscasadi.viewer.charts import build_charts, mark_time
from tenscasadi.viewer.controls import FRAME_RATE, ViewControls, add_speed
from tenscasadi.viewer.pictures import send_film
from tenscasadi.viewer.runner import Runner

if TYPE_CHECKING:
    import viser


class Player:
    """Playback of a canvas, controlled by the panels of all its pages.

    Attributes
    ----------
    time : float
        Displayed time [s].
    playing : bool
        Whether playback is running.
    speed : float
        Simulated seconds per second.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        canvas: Canvas,
        title: str,
        speed: float = 1.0,
        playing: bool = True,
    ) -> None:
        self.canvas, self.speed, self._server = canvas, speed, server
        self.time = self._first = canvas.content.start
        self._last = canvas.content.end
        self.moves = self._last > self._first
        self.playing, self.repeats = playing and self.moves, True
        self._before = self._told = clock.perf_counter()
        self._runner = Runner(self._advance)
        self.controls = ViewControls(server, canvas, self._change)
        gui = server.gui
        gui.set_panel_label(title)
        if self.moves:
            self._add_controls(gui)
        if canvas.scale is not None:
            self.controls.add_color()
        self.controls.add_shadows()
        self.controls.add_visibility()
        self.controls.add_forces()
        self.controls.add_legend()
        self._mark: Any = None
        if canvas.content.charts:
            gui.add_html(build_charts(canvas.content))
            self._mark = gui.add_html(mark_time(self.time))
        self.controls.add_labels()
        self.controls.add_screenshot(title)
        if self.moves:
            hint = "the motion as an mp4 file, seen by the camera of this page"
            film = gui.add_button("Film", hint=hint)
            film.on_click(lambda event: self.film(event.client, title))
        self._show(self.time)
        self._runner.start()

    def show(self, time: float) -> None:
        """Show the frame of a time [s]."""
        self._runner.call(lambda: self._show(time))

    def play(self, playing: bool) -> None:
        """Play the trajectories if `playing`, else pause."""
        self._runner.call(lambda: self._play(playing))

    def film(self, client: Any, name: str) -> None:
        """Save a film of the playback in the browser.

        `client` is viser's handle of the browser, and `name` is that of the file. The page shows
        the reason if that is impossible.
        """
        self.play(False)
        try:
            times = choose_frame_times(self.canvas.content, self.speed, FRAME_RATE)
            send_film(client, name, times, self.show, FRAME_RATE)
        except (ImportError, ValueError, TimeoutError) as error:
            client.add_notification("No film", str(error))

    def close(self) -> None:
        """End the player."""
        self._runner.close()

    def _change(self, change: Callable[[], Any]) -> None:
        def order() -> None:
            change()
            self._show(self.time)

        self._runner.do(order)

    def _show(self, time: float) -> None:
        self.time = min(max(time, self._first), self._last)
        with self._server.atomic():
            self.canvas.show(self.time)
            self.controls.labels.update()

    def _play(self, playing: bool) -> None:
        self.playing, self._before = playing and self.moves, clock.perf_counter()
        if self.moves:
            self._button.label = "Pause" if self.playing else "Play"
            self._tell()

    def _tell(self) -> None:
        """Move the slider and the charts' lines to the displayed time."""
        self._slider.value = self.time
        if self._mark is not None:
            self._mark.content = mark_time(self.time)

    def _add_controls(self, gui: viser.GuiApi) -> None:
        self._button = gui.add_button("Pause" if self.playing else "Play")
        self._button.on_click(lambda _: self._runner.do(lambda: self._play(not self.playing)))
        step = (self._last - self._first) / 1000
        self._slider: Any = gui.add_slider("Time (s)", self._first, self._last, step, self._first)
        self._slider.on_update(self._scrub)
        add_speed(gui, self.speed, lambda speed: setattr(self, "speed", speed))
        repeat = gui.add_checkbox("Repeat", True)
        repeat.on_update(lambda _: setattr(self, "repeats", bool(repeat.value)))
        self.controls.add_follow()

    def _scrub(self, event: Any) -> None:
        """Show the time of a slider that the user drags.

        `event` is viser's event of the slider. Changes of the slider by `_tell` have no client, and
        are ignored.
        """
        value = self._slider.value
        if event.client is None or not isinstance(value, (int, float)):
            return

        def order() -> None:
            if self.playing:
                self.playing, self._button.label = False, "Play"
            self._show(float(value))
            if self._mark is not None:
                self._mark.content = mark_time(self.time)

        self._runner.do(order)

    def _advance(self) -> float | None:
        """Show the next frame; after the end, the first one again.

        Returns the time until the next call [s]; None while paused.
        """
        now = clock.perf_counter()
        passed, self._before = now - self._before, now
        if not self.playing:
            return None
        ended = self.time >= self._last
        self._show(self._first if ended else self.time + passed * self.speed)
        if self.time >= self._last and not self.repeats:
            self._play(False)
        elif now - self._told > 0.1:  # the slider need not follow every frame
            self._tell()
            self._told = now
        return max(0.0, now + 1 / FRAME_RATE - clock.perf_counter())
