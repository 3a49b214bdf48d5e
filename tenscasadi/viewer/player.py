"""The panel beside the canvas: play, pause, scrub, speed, follow, and what strings are coloured by."""

from __future__ import annotations

import threading
import time as clock
from typing import TYPE_CHECKING, Any

from tenscasadi.viewer.canvas import QUANTITIES, Canvas
from tenscasadi.viewer.charts import charts, cursors
from tenscasadi.viewer.labels import KINDS, Labels
from tenscasadi.viewer.legend import legend

if TYPE_CHECKING:
    import viser

FRAMES_PER_SECOND = 30
SPEEDS = ("0.01", "0.02", "0.05", "0.1", "0.2", "0.5", "1", "2", "5", "10")
_SLIDER_STEPS = 1000
_SLIDER_PERIOD = 0.1  # s between its moves while playing: it need not follow every frame


class Player:
    """Plays a canvas in a thread of its own, steered from the panel of all pages that look at it.

    Attributes
    ----------
    time : float
        Time that is shown, s.
    playing : bool
        Whether it runs.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        canvas: Canvas,
        title: str,
        speed: float = 1.0,
        playing: bool = True,
    ) -> None:
        self.canvas, self.speed = canvas, speed
        self.time = self._first = canvas.exhibit.start
        self._last = canvas.exhibit.end
        self.moves = self._last > self._first
        self.playing = playing and self.moves
        self._server = server
        self.labels = Labels(server, canvas)
        self._changed, self._ended = threading.Event(), threading.Event()
        self._lock = threading.Lock()  # one frame at a time
        gui = server.gui
        gui.set_panel_label(title)
        gui.configure_theme(show_logo=False, show_share_button=False)
        if self.moves:
            self._add_controls(gui)
        self._add_looks(gui)
        self._add_labels(gui)
        self.show(self.time)
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def show(self, time: float) -> None:
        """Show a time, s."""
        with self._lock, self._server.atomic():
            self.time = min(max(time, self._first), self._last)
            self.canvas.show(self.time)
            self.labels.show(self.time)

    def play(self, playing: bool) -> None:
        """Start or stop."""
        self._set_playing(playing)
        self._tell()

    def close(self) -> None:
        """Stop for good."""
        self._ended.set()
        self._changed.set()
        self._thread.join(timeout=2.0)

    def _set_playing(self, playing: bool) -> None:
        self.playing = playing and self.moves
        if self.moves:
            self._button.label = "Pause" if self.playing else "Play"
        self._changed.set()

    def _tell(self) -> None:
        """Move the slider, and the line in the curves, to the time that is shown."""
        if self.moves:
            self._slider.value = self.time
        self._mark()

    def _add_controls(self, gui: viser.GuiApi) -> None:
        first, last = self._first, self._last
        self._button = gui.add_button("Pause" if self.playing else "Play")
        self._button.on_click(lambda _: self.play(not self.playing))
        self._slider: Any = gui.add_slider(
            "Time (s)", first, last, (last - first) / _SLIDER_STEPS, first
        )
        self._slider.on_update(self._scrub)
        speeds = (
            SPEEDS
            if f"{self.speed:g}" in SPEEDS
            else tuple(sorted({*SPEEDS, f"{self.speed:g}"}, key=float))
        )
        chosen = gui.add_dropdown(
            "Speed",
            speeds,
            initial_value=f"{self.speed:g}",
            hint="simulated seconds in each second shown",
        )
        chosen.on_update(lambda _: self._set_speed(chosen.value, speeds))
        self._loop = gui.add_checkbox("Repeat", True)
        follow = gui.add_checkbox(
            "Follow", self.canvas.followed, hint="keep the middle of the structure in view"
        )
        follow.on_update(lambda _: self._change(lambda: self.canvas.follow(bool(follow.value))))

    def _add_looks(self, gui: viser.GuiApi) -> None:
        canvas = self.canvas
        if canvas.scale is not None:
            colour = gui.add_dropdown("Colour", tuple(QUANTITIES), initial_value=canvas.colour)
            colour.on_update(lambda _: self._recolour(colour.value))
        for motion, layer in zip(canvas.exhibit.motions, canvas.layers, strict=True):
            if len(canvas.layers) > 1:
                self._add_switch(gui, motion.name, layer.root)
        self._legend = gui.add_html(legend(canvas))
        self._cursors: Any = None
        if canvas.exhibit.charts:
            gui.add_html(charts(canvas.exhibit, marked=False))
            self._cursors = gui.add_html("")

    def _add_labels(self, gui: viser.GuiApi) -> None:
        """Add boxes that number all nodes or members, and listen to clicks on them."""
        with gui.add_folder("Numbers", expand_by_default=False):
            for kind in KINDS:
                if getattr(self.canvas.layers[0], kind) is not None:
                    self._add_number(gui, kind)
        for k, layer in enumerate(self.canvas.layers):
            for kind in KINDS:
                batch = getattr(layer, kind)
                if batch is not None:
                    batch.on_click(
                        lambda event, k=k, kind=kind: self._click(k, kind, event.instance_index)
                    )

    def _add_number(self, gui: viser.GuiApi, kind: str) -> None:
        box = gui.add_checkbox(f"Numbers of {kind}", False)
        box.on_update(lambda _: self._change(lambda: self.labels.number(kind, bool(box.value))))

    def _click(self, motion: int, kind: str, index: int | None) -> None:
        if isinstance(index, int):
            self._change(lambda: self.labels.toggle((motion, kind, index)))

    def _add_switch(self, gui: viser.GuiApi, name: str, root: Any) -> None:
        box = gui.add_checkbox(name, True)
        box.on_update(lambda _: self._change(lambda: setattr(root, "visible", bool(box.value))))

    def _recolour(self, colour: str) -> None:
        if colour not in QUANTITIES:
            return
        self._change(lambda: self.canvas.choose_colour(colour))
        self._legend.content = legend(self.canvas)

    def _set_speed(self, speed: str, speeds: tuple[str, ...]) -> None:
        if speed in speeds:  # a page can send any text
            self.speed = float(speed)

    def _change(self, act: Any) -> None:
        with self._lock:
            act()
        self.show(self.time)

    def _scrub(self, event: Any) -> None:
        """Go where the slider was dragged; moves that come from `_run` have no client."""
        if event.client is not None and isinstance(self._slider.value, (int, float)):
            self._set_playing(False)  # and leave the slider where it is being dragged
            self.show(float(self._slider.value))
            self._mark()

    def _mark(self) -> None:
        """Move the line in the curves."""
        if self._cursors is not None:
            self._cursors.content = cursors(self.canvas.exhibit, self.time)

    def _run(self) -> None:
        before, moved = clock.perf_counter(), 0.0
        while not self._ended.is_set():
            if not self.playing:
                self._changed.wait()
                self._changed.clear()
                before = clock.perf_counter()
                continue
            now = clock.perf_counter()
            self._advance((now - before) * self.speed)
            before = now
            if self.playing and now - moved > _SLIDER_PERIOD:
                self._tell()
                moved = now
            self._ended.wait(max(0.0, now + 1 / FRAMES_PER_SECOND - clock.perf_counter()))

    def _advance(self, step: float) -> None:
        """Show what comes a while later; from the start again where the end was shown."""
        again = self.time >= self._last
        self.show(self._first if again else self.time + step)
        if self.time >= self._last and not self._loop.value:
            self.play(False)
