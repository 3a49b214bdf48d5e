"""`live`: a simulation in a browser, which people drive and pull at while it goes on."""

from __future__ import annotations

import contextlib
import os
import queue
import threading
import time as clock
from collections.abc import Callable
from types import TracebackType
from typing import Any

from tenscasadi.dynamics.model import Model
from tenscasadi.scene.scene import Scene
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.util.validate import file_path, positive_number, text
from tenscasadi.viewer.live_mode.pace import Pace
from tenscasadi.viewer.live_mode.panel import Panel
from tenscasadi.viewer.live_mode.simulation import LiveSimulation, Stepping
from tenscasadi.viewer.live_mode.sliders import Groups, sliders_of
from tenscasadi.viewer.live_mode.stage import Stage
from tenscasadi.viewer.web.server import LOOPBACK, address, start_server
from tenscasadi.viewer.web.serving import check_serving, open_and_wait, stop

FilePath = str | os.PathLike[str]

_FRAME = 1 / 30  # s between two pictures
_WORDS = 0.2  # s between two times that the words change


class Live:
    """A live motion: in the browser while it is served, and as a trajectory at any time. `live` returns one.

    Parameters
    ----------
    simulation : LiveSimulation
        What goes on.
    server : viser.ViserServer
        Server, as `start_server` gives it.
    groups : mapping of str to sequence of int, or None
        Strings that share a slider, as for `live`.
    save : path-like or None
        File that the button "Save" writes.
    title : str
        Title.
    speed : float
        Simulated seconds in each second.

    Attributes
    ----------
    simulation : LiveSimulation
        What goes on. It belongs to a thread of its own: hand what changes it to `do`.
    url : str
        Where the viewer is.

    See Also
    --------
    live : Start one.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> from tenscasadi.viewer import Stepping, live
    >>> motion = live(tc.Scene(tc.shapes.prism()), stepping=Stepping(compiled=False), browser=False, wait=False)
    >>> motion.close()
    """

    def __init__(
        self,
        simulation: LiveSimulation,
        server: Any,
        groups: Groups,
        save: FilePath | None,
        title: str,
        speed: float,
    ) -> None:
        self.simulation, self._server, self._save_to = simulation, server, save
        self.url = address(server)
        self._orders: queue.SimpleQueue[Callable[[], Any]] = queue.SimpleQueue()
        self._ordered, self._ended = threading.Event(), False
        self._pace = Pace(simulation.tick, speed)
        server.gui.set_panel_label(title)
        self._stage = Stage(server, simulation)
        self.panel = Panel(server, self._stage, self._pace, sliders_of(simulation, groups), self.do)
        self.panel.add_saving(
            server.gui, None if save is None else str(save), self._save, self._download
        )
        self._add_dragging()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def do(self, order: Callable[[], Any]) -> None:
        """Run a function between two ticks, in the thread that computes them.

        Parameters
        ----------
        order : callable
            What to do; what it raises as TypeError, ValueError, IndexError or OverflowError is
            dropped: it came from a page.
        """
        self._orders.put(order)
        self._ordered.set()

    def trajectory(self) -> Trajectory:
        """Return what has been recorded since the start or the last reset.

        Returns
        -------
        Trajectory
            See `LiveSimulation.trajectory`.
        """
        answer: queue.SimpleQueue[Trajectory] = queue.SimpleQueue()
        self.do(lambda: answer.put(self.simulation.trajectory()))
        while self._thread.is_alive():
            with contextlib.suppress(queue.Empty):
                return answer.get(timeout=0.1)  # it may end before it gets there
        return self.simulation.trajectory()

    def wait(self) -> None:
        """Return when Ctrl-C is pressed, and close the viewer."""
        try:
            threading.Event().wait()
        except KeyboardInterrupt:
            self.close()

    def close(self) -> None:
        """Stop the motion and the server; what is recorded stays."""
        self._ended = True
        self._ordered.set()
        self._thread.join(timeout=10.0)
        stop(self._server)

    def _repr_html_(self) -> str:
        """Return the viewer within a notebook."""
        return f'<iframe src="{self.url}" width="100%" height="560" style="border:1px solid #ddd"></iframe>'

    def __repr__(self) -> str:
        return f"Live(at {self.url})"

    def __enter__(self) -> Live:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    # --- the thread ---

    def _run(self) -> None:
        shown = told = -1.0
        while not self._ended:
            obeyed = self._obey()
            stopped = bool(self.simulation.fault)
            ticked = self._tick() if self.panel.running and not stopped else 0
            now = clock.perf_counter()
            if (
                obeyed
                or (ticked and now - shown >= _FRAME)
                or stopped != bool(self.simulation.fault)
            ):
                with self._server.atomic():
                    self.panel.show()
                shown = now
            if obeyed or now - told >= _WORDS or stopped != bool(self.simulation.fault):
                self.panel.tell()
                told = now
            moving = self.panel.running and not self.simulation.fault
            self._ordered.wait(
                self._pace.wait(clock.perf_counter()) if moving else None if not obeyed else _WORDS
            )

    def _obey(self) -> bool:
        self._ordered.clear()
        obeyed = False
        while not self._ended:
            try:
                order = self._orders.get_nowait()
            except queue.Empty:
                break
            obeyed = True
            with contextlib.suppress(
                TypeError, ValueError, IndexError, OverflowError
            ):  # whatever a page has sent
                order()
        return obeyed

    def _tick(self) -> int:
        """Compute the ticks that are due, as long as they take no longer than a picture."""
        began = clock.perf_counter()
        count = 0
        for _ in range(self._pace.due(began)):
            if not self.simulation.advance():
                break
            count += 1
            now = clock.perf_counter()
            self._pace.done(1, now)
            if now - began > _FRAME or not self._orders.empty():
                break
        return count

    # --- what a person does ---

    def _add_dragging(self) -> None:
        layer = self._stage.layer
        for part, batch in (
            ("nodes", layer.nodes),
            ("bars", layer.bars),
            ("strings", layer.strings),
        ):
            if batch is not None and self.simulation.pullable.any():
                batch.on_drag(self._dragged(part))

    def _dragged(self, part: str) -> Callable[[Any], Any]:
        async def drag(event: Any) -> None:  # in the order in which the pointer moves
            phase, index, begin, end = (
                event.phase,
                event.instance_index,
                event.start_position,
                event.end_position,
            )
            self.do(lambda: self._pull(part, phase, index, begin, end))

        return drag

    def _pull(self, part: str, phase: str, index: int, begin: Any, end: Any) -> None:
        simulation = self.simulation
        if phase == "start":
            simulation.grab(self._stage.node_at(part, int(index), begin), self._stage.place(end))
        elif phase == "end":
            simulation.release()
        elif simulation.pull is not None:
            simulation.grab(simulation.pull.node, self._stage.place(end))

    def _save(self) -> None:
        if self._save_to is None:
            return
        trajectory = self.simulation.trajectory()
        try:
            written = trajectory.save(self._save_to)
        except OSError as error:
            self.panel.say(f"not saved: {error}")
        else:
            self.panel.say(f"saved {trajectory.time[-1]:.2f} s to {written}")
        self._pace.rest()

    def _download(self, client: Any) -> None:
        if client is not None:
            client.send_file_download(
                "live.npz", self.simulation.trajectory().to_bytes(), save_immediately=True
            )
        self._pace.rest()


def live(  # noqa: PLR0913  the options of a run, and of a page
    model: Model | Scene,
    *,
    state: Any = None,
    control: Any = None,
    groups: Groups = None,
    stepping: Stepping = Stepping(),
    save: FilePath | None = None,
    host: str = LOOPBACK,
    port: int | None = None,
    title: str = "",
    speed: float = 1.0,
    browser: bool | None = None,
    wait: bool | None = None,
    parameters: Any = None,
) -> Live:
    """Simulate in real time in a browser: drive the strings by sliders, pull at nodes with the mouse, pause, reset, save.

    Parameters
    ----------
    model : Model or Scene
        What moves. Strings without control are driven by their rest lengths.
    state : array_like, shape (nx,), optional
        State at the start. Default: the model's initial state.
    control : array_like, shape (nu,), optional
        Control at the start. Default: the model's initial control.
    groups : mapping of str to sequence of int, optional
        Strings that share a slider, by its name. Default: each its own, or where there are many,
        those that are alike.
    stepping : Stepping
        Step, scheme and correction.
    save : path-like, optional
        File that the button "Save" writes, as `Trajectory.save` does. Default: there is no such
        button; the browser can download the motion.
    host : str
        Address to listen on; others than 127.0.0.1 let other machines see and drive the motion, of
        which it warns.
    port : int, optional
        Port. Default: one that is free.
    title : str
        Title.
    speed : float
        Simulated seconds in each second.
    browser, wait : bool, optional
        Whether to open the browser, and to return only when Ctrl-C is pressed; see `View.show`.
    parameters : array_like, shape (np,), or mapping of str to array_like, optional
        Values of the model's parameters, see `tenscasadi.ParameterLayout.values`; nominal if None.

    Returns
    -------
    Live
        The live motion, which goes on in a thread of its own.

    Raises
    ------
    CompileError
        Machine code was asked for and cannot be made.
    ImportError
        viser is not installed.
    OSError
        The port is taken, or there is no such address.
    TypeError, ValueError
        An argument is wrong.

    Notes
    -----
    A motion that this machine cannot compute in real time goes slower, and says by how much. One
    that breaks down stops and says why.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> from tenscasadi.viewer import Stepping, live
    >>> scene = tc.Scene(tc.shapes.prism(prestress=50.0), gravity=tc.Gravity((0, 0, -1.0)))
    >>> with live(scene, stepping=Stepping(compiled=False), browser=False, wait=False) as motion:
    ...     run = motion.trajectory()
    >>> run.nodes.shape[1:]
    (6, 3)
    """
    name = text("title", title) or "live"
    positive_number("speed", speed)
    check_serving(browser, wait)
    if save is not None:
        file_path("save", save)
    simulation = LiveSimulation(model, state, control, stepping, parameters)
    sliders_of(simulation, groups)  # what is wrong with them shows before there is a server
    found = Live(simulation, start_server(host, port), groups, save, name, float(speed))
    open_and_wait(found.url, found.wait, browser, wait)
    return found
