"""Interactive simulation in a browser."""

from __future__ import annotations

import os
import threading
import time as clock
from collections.abc import Callable
from typing import Any

from tenscasadi.dynamics.model import Model
from tenscasadi.scene.scene import Scene
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.util.renamed import rename_keywords
from tenscasadi.util.validate import FilePath, file_path, positive_number, text
from tenscasadi.viewer.controls import FRAME_RATE
from tenscasadi.viewer.live_mode.options import LiveOptions
from tenscasadi.viewer.live_mode.pace import Pace
from tenscasadi.viewer.live_mode.panel import LivePanel
from tenscasadi.viewer.live_mode.simulation import LiveSimulation
from tenscasadi.viewer.live_mode.sliders import Groups, choose_sliders
from tenscasadi.viewer.runner import Runner
from tenscasadi.viewer.web.server import LOOPBACK, address, start_server
from tenscasadi.viewer.web.serving import Served, check_serving, open_and_wait


class Live(Served):
    """Interactive simulation in the browser.

    `live` returns it. `trajectory` returns the recording at any time.

    Parameters
    ----------
    simulation : LiveSimulation
        Simulation.
    server : viser.ViserServer
        Server, as from `start_server`.
    groups : mapping of str to sequence of int or str, or None
        Strings that share a slider, as for `live`.
    save : path-like or None
        File that the button "Save" writes.
    title : str
        Title.
    speed : float
        Simulated seconds per second.

    Attributes
    ----------
    simulation : LiveSimulation
        Simulation. It belongs to its own thread: change it by `do`.
    url : str
        Address of the viewer.

    See Also
    --------
    live : Start one.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> from tenscasadi.viewer import LiveOptions, live
    >>> motion = live(tc.Scene(tc.shapes.prism()), options=LiveOptions(compiled=False), browser=False, wait=False)
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
        self._pace = Pace(simulation.tick, speed)
        self._runner = Runner(self._advance)
        server.gui.set_panel_label(title)
        sliders = choose_sliders(simulation, groups)
        self.panel = LivePanel(server, simulation, self._pace, sliders, self.do)
        path = None if save is None else os.fspath(save)
        self.panel.add_saving(server.gui, path, self._save, self._download)
        self._shown = self._told = -1.0
        self._changed = True
        self._runner.start()

    def do(self, order: Callable[[], Any]) -> None:
        """Execute a function in the simulation's thread between two ticks.

        A tick is an interval of constant inputs.

        Parameters
        ----------
        order : callable
            Function. Its errors due to invalid values are ignored, as a browser may send any value.
        """

        def change() -> None:
            self._changed = True
            order()

        self._runner.do(change)

    def run(self, running: bool = True) -> None:
        """Start or pause the simulation, as the page's button does.

        Parameters
        ----------
        running : bool
            Whether the time runs.
        """
        self._runner.call(lambda: self.panel.run(running))

    def trajectory(self) -> Trajectory:
        """Return the recorded trajectory since the start or the last reset.

        Returns
        -------
        Trajectory
            See `LiveSimulation.trajectory`.
        """
        return self._runner.call(self.simulation.trajectory)

    def wait(self) -> None:
        """Wait for Ctrl-C, and close the viewer."""
        try:
            threading.Event().wait()
        except KeyboardInterrupt:
            self.close()

    def close(self) -> None:
        """Stop the simulation and the server; the recording remains."""
        self._runner.close()
        super().close()

    def _repr_html_(self) -> str:
        """Build the viewer for a notebook."""
        return f'<iframe src="{self.url}" width="100%" height="560" style="border:1px solid #ddd"></iframe>'

    def __repr__(self) -> str:
        return f"Live(at {self.url})"

    def _advance(self) -> float | None:
        """Simulate the ticks that are due, and show the present state.

        Returns the time until the next call [s]; None if none is due.
        """
        failed = bool(self.simulation.fault)
        ticks = self._simulate() if self.panel.running and not failed else 0
        now = clock.perf_counter()
        changed, self._changed = self._changed, False
        changed |= failed != bool(self.simulation.fault)
        if changed or (ticks and now - self._shown >= 1 / FRAME_RATE):
            with self._server.atomic():
                self.panel.show()
            self._shown = now
        if changed or now - self._told >= 0.2:  # words change less often than pictures
            self.panel.tell()
            self._told = now
        if self.panel.running and not self.simulation.fault:
            return self._pace.wait(clock.perf_counter())
        return 0.2 if changed else None

    def _simulate(self) -> int:
        """Simulate the ticks that are due by the wall clock.

        It takes at most the time of one picture.
        """
        began = clock.perf_counter()
        count = 0
        for _ in range(self._pace.due(began)):
            if not self.simulation.advance():
                break
            count += 1
            now = clock.perf_counter()
            self._pace.done(1, now)
            if now - began > 1 / FRAME_RATE or self._runner.is_busy:
                break
        return count

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
            content = self.simulation.trajectory().to_bytes()
            client.send_file_download("live.npz", content, save_immediately=True)
        self._pace.rest()


@rename_keywords(stepping="options")
def live(  # noqa: PLR0913  the options of a run, and of a page
    model: Model | Scene,
    *,
    state: Any = None,
    control: Any = None,
    groups: Groups = None,
    options: LiveOptions = LiveOptions(),
    save: FilePath | None = None,
    host: str = LOOPBACK,
    port: int | None = None,
    title: str = "",
    speed: float = 1.0,
    browser: bool | None = None,
    wait: bool | None = None,
    parameters: Any = None,
) -> Live:
    """Simulate in real time in a browser.

    It is paused at the start. Sliders control the strings, and the mouse pulls nodes. Buttons start,
    pause, reset and save.

    Parameters
    ----------
    model : Model or Scene
        Model. Strings without control are controlled by their rest lengths.
    state : array_like, shape (nx,), optional
        Initial state. Default: that of the model.
    control : array_like, shape (nu,), optional
        Initial control. Default: that of the model.
    groups : mapping of str to sequence of int or str, optional
        Strings that share a slider, by its name. Default: each its own, or equal ones share one if
        there are many.
    options : LiveOptions
        Step, scheme and correction.
    save : path-like, optional
        File that the button "Save" writes, as `Trajectory.save` does. Default: there is no such
        button; the browser can download the trajectory.
    host : str
        Address to listen on. Addresses other than 127.0.0.1 let other machines see and control the
        simulation, and cause a warning.
    port : int, optional
        Port. Default: a free one.
    title : str
        Title.
    speed : float
        Simulated seconds per second.
    browser, wait : bool, optional
        Whether to open the browser, and to wait for Ctrl-C; see `View.show`.
    parameters : array_like, shape (np,), or mapping of str to array_like, optional
        Values of the model's parameters, see `tenscasadi.ParameterLayout.values`; nominal if None.

    Returns
    -------
    Live
        The simulation, which runs in its own thread.

    Raises
    ------
    CompileError
        Machine code was requested and cannot be made.
    ImportError
        viser is not installed.
    OSError
        The port is taken, or there is no such address.
    TypeError, ValueError
        An argument is wrong.

    Notes
    -----
    If the machine is too slow for real time, the simulation runs slower and the panel reports its
    speed. A simulation that fails stops, and the panel explains why.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> from tenscasadi.viewer import LiveOptions, live
    >>> scene = tc.Scene(tc.shapes.prism(prestress=50.0), gravity=tc.Gravity((0, 0, -1.0)))
    >>> with live(scene, options=LiveOptions(compiled=False), browser=False, wait=False) as motion:
    ...     motion.run()  # as the button Start does
    ...     run = motion.trajectory()
    >>> run.nodes.shape[1:]
    (6, 3)
    """
    name = text("title", title) or "live"
    positive_number("speed", speed)
    check_serving(browser, wait)
    if save is not None:
        file_path("save", save)
    simulation = LiveSimulation(model, state, control, options, parameters)
    choose_sliders(simulation, groups)  # wrong groups are reported before there is a server
    found = Live(simulation, start_server(host, port), groups, save, name, float(speed))
    open_and_wait(found.url, found.wait, browser, wait)
    return found
