"""Page that shows the convergence of a plan's solver."""

from __future__ import annotations

import time
from io import StringIO
from typing import Any

from tenscasadi.util.renamed import lazy_module
from tenscasadi.viewer.web.server import LOOPBACK, address, start_server
from tenscasadi.viewer.web.serving import Served, check_serving, open_and_wait

plots = lazy_module("tenscasadi.plots")  # a lazy submodule would import the package
mpl = lazy_module("matplotlib")


class ConvergencePage(Served):
    """Browser page with objective and constraint violation of a solver.

    Give it to `ocp.solve`: ``ocp.solve(problem, progress=page)``. The button "Stop" ends the search
    with the best plan so far. The page stays until it is closed.

    Parameters
    ----------
    browser : bool, optional
        Whether to open the browser. Default: if there is a display.
    host : str
        Address to listen on; see `view`.
    port : int, optional
        Port. Default: a free one.

    Attributes
    ----------
    url : str
        Address of the page.

    Raises
    ------
    ImportError
        viser is not installed.
    OSError
        The port is taken, or there is no such address.
    TypeError, ValueError
        An argument is wrong.

    See Also
    --------
    tenscasadi.plots.Convergence : The same chart in a notebook or a file.

    Examples
    --------
    >>> import ocp
    >>> from tenscasadi.viewer import ConvergencePage
    >>> with ConvergencePage(browser=False) as page:
    ...     page(ocp.Progress(iteration=0, objective=2.5, infeasibility=1e-3))
    True
    """

    def __init__(
        self, browser: bool | None = None, host: str = LOOPBACK, port: int | None = None
    ) -> None:
        check_serving(browser, None)
        self._server, self._stopped = start_server(host, port), False
        self._convergence, self._next = plots.diagrams.Convergence(), 0.0
        self.url = address(self._server)
        gui = self._server.gui
        gui.set_panel_label("plan")
        self._chart = gui.add_html("no iteration yet")
        hint = "ends the search with the best plan so far"
        gui.add_button("Stop", hint=hint).on_click(lambda _: self._stop())
        open_and_wait(self.url, lambda: None, browser, wait=False)

    def __call__(self, now: Any) -> bool:
        """Show an iteration; see `ocp.Progress`.

        Returns
        -------
        bool
            Whether the solver goes on.
        """
        self._convergence(now)
        if time.monotonic() >= self._next:
            self.draw()
            self._next = time.monotonic() + 0.5
        return not self._stopped

    def draw(self) -> None:
        """Draw all iterations so far."""
        text = StringIO()
        with mpl.rc_context({"svg.fonttype": "none"}):
            self._convergence.figure().savefig(text, format="svg")
        svg = text.getvalue()
        svg = svg[svg.index("<svg ") :]
        self._chart.content = svg.replace("<svg ", '<svg style="width:100%;height:auto" ', 1)

    def _stop(self) -> None:
        self._stopped = True

    def __repr__(self) -> str:
        return f"ConvergencePage(at {self.url})"
