"""Viewer of structures, scenes, trajectories and plans in a browser."""

from __future__ import annotations

import os
import threading
from html import escape
from pathlib import Path
from typing import Any

from tenscasadi.drawing.color_scale import QUANTITIES
from tenscasadi.drawing.describe import describe_content
from tenscasadi.drawing.view_content import ViewContent
from tenscasadi.scene.ground import Grounds
from tenscasadi.util.renamed import rename_keywords
from tenscasadi.util.validate import FilePath, choice, file_path, flag, positive_number, text
from tenscasadi.util.viewable import in_notebook
from tenscasadi.util.whole_file import whole_file
from tenscasadi.viewer.canvas import Canvas
from tenscasadi.viewer.player import Player
from tenscasadi.viewer.web.page import add_panel, record_page
from tenscasadi.viewer.web.server import LOOPBACK, address, start_server
from tenscasadi.viewer.web.serving import Served, check_serving, open_and_wait, stop


class View(Served):
    """Viewer of trajectories: in the browser by `show`, as a file by `save`.

    In a notebook it displays itself. `view` returns it.

    Parameters
    ----------
    content : ViewContent
        Motions and their surroundings.
    title : str
        Title.
    color : {"tension", "force density"}
        Quantity that colors the strings.
    speed : float
        Simulated seconds per second.
    follow : bool
        Whether the middle of the first motion stays in view.
    side_by_side : bool
        Whether several motions stand beside each other.

    Attributes
    ----------
    url : str or None
        Address of the viewer while it is shown.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> with tc.shapes.prism().view(browser=False, wait=False) as shown:
    ...     print(shown.url.rpartition(":")[0])
    http://127.0.0.1
    """

    def __init__(
        self,
        content: ViewContent,
        title: str,
        color: str,
        speed: float,
        follow: bool,
        side_by_side: bool = False,
    ) -> None:
        self.content, self.title = content, title
        self._color, self._speed, self._follow = color, speed, follow
        self._apart = side_by_side
        self._server: Any = None
        self.player: Player | None = None
        self.url: str | None = None

    def __repr__(self) -> str:
        names = ", ".join(motion.name for motion in self.content.motions)
        return f"View({names}{'' if self.url is None else f', at {self.url}'})"

    def show(
        self,
        host: str = LOOPBACK,
        port: int | None = None,
        browser: bool | None = None,
        wait: bool | None = None,
    ) -> View:
        """Serve the viewer, and open it in the browser.

        Parameters
        ----------
        host : str
            Address to listen on. Addresses other than 127.0.0.1 let other machines see and control
            the viewer, and cause a warning.
        port : int, optional
            Port. Default: a free one.
        browser : bool, optional
            Whether to open the browser. Default: if there is a display.
        wait : bool, optional
            Whether to wait for Ctrl-C. Default: in scripts, but not in interactive sessions.

        Returns
        -------
        View
            This view, with its `url`.

        Raises
        ------
        ImportError
            viser is not installed.
        OSError
            The port is taken, or there is no such address.
        TypeError, ValueError
            An argument is wrong.
        """
        check_serving(browser, wait)
        self.close()
        self._server = start_server(host, port)
        self.player = Player(self._server, self._canvas(self._server), self.title, self._speed)
        self.url = address(self._server)
        open_and_wait(self.url, self.wait, browser, wait)
        return self

    def wait(self) -> None:
        """Wait for Ctrl-C, and close the viewer."""
        try:
            threading.Event().wait()
        except KeyboardInterrupt:
            self.close()

    def close(self) -> None:
        """Stop the server of the viewer."""
        if self.player is not None:
            self.player.close()
        if self._server is not None:
            stop(self._server)
        self._server = self.player = self.url = None

    def save(self, path: FilePath) -> Path:
        """Write a self-contained HTML page with playback.

        Parameters
        ----------
        path : path-like
            File to write; its name ends in .html.

        Returns
        -------
        pathlib.Path
            The file.

        Raises
        ------
        ImportError
            viser is not installed.
        OSError
            The file cannot be written.
        TypeError, ValueError
            `path` is invalid, or the page would have more than 3000 frames.
        """
        target = _html_path("path", path)
        page = self.page().encode(errors="replace")  # a title may hold half of a character
        with whole_file(target) as file:
            file.write(page)
        return target

    def page(self) -> str:
        """Build the HTML page that `save` writes.

        Returns
        -------
        str
            HTML.

        Raises
        ------
        ImportError
            viser is not installed.
        ValueError
            It would have more than 3000 frames.
        """
        server = start_server()
        try:
            canvas = self._canvas(server)
            page = record_page(server, canvas, self._speed)
            return add_panel(page, canvas, self.title, self._speed)
        finally:
            stop(server)

    def _canvas(self, server: Any) -> Canvas:
        canvas = Canvas(server, self.content, self._color, self._apart)
        canvas.followed = self._follow
        return canvas

    def _repr_html_(self) -> str:
        """Build the HTML page for a notebook."""
        return f'<iframe srcdoc="{escape(self.page(), quote=True)}" width="100%" height="560" style="border:1px solid #ddd"></iframe>'


@rename_keywords(colour="color")
def view(
    things: Any,
    *,
    html: FilePath | None = None,
    host: str = LOOPBACK,
    port: int | None = None,
    title: str = "",
    ground: Grounds = None,
    color: str = "tension",
    speed: float = 1.0,
    follow: bool = False,
    side_by_side: bool = False,
    browser: bool | None = None,
    wait: bool | None = None,
) -> View:
    """Show structures, scenes, trajectories and plans in a browser.

    Several of them are superimposed, or side by side.

    Parameters
    ----------
    things : Structure, Scene, Model, Trajectory, Rollouts or ocp.Plan, or a list, or a mapping of
    names to them
        Things to show. The first motion is opaque, with strings colored by their forces. Others are
        transparent.
    html : path-like, optional
        Page to write instead of starting the viewer; its name ends in .html.
    host : str
        Address to listen on. Addresses other than 127.0.0.1 let other machines see and control the
        viewer, and cause a warning.
    port : int, optional
        Port. Default: a free one.
    title : str
        Title. Default: the names of the motions.
    ground : Ground or Terrain or a sequence of them, optional
        Grounds besides those of the scenes.
    color : {"tension", "force density"}
        Quantity that colors the strings.
    speed : float
        Simulated seconds per second.
    follow : bool
        Whether the middle of the first motion stays in view.
    side_by_side : bool
        Whether several things stand beside each other, instead of being superimposed.
    browser, wait : bool, optional
        Whether to open the browser, and to wait for Ctrl-C; see `View.show`.

    Returns
    -------
    View
        The view. In a notebook it displays itself, and no server is started.

    Raises
    ------
    ImportError
        viser is not installed.
    OSError
        The port is taken, there is no such address, or the page cannot be written.
    TypeError, ValueError
        An argument is wrong.

    Notes
    -----
    A page contains 30 frames per second and its own player: play, pause, time, speed, and
    visibility. Labels on click, following, and other colors need the viewer.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> from tenscasadi.viewer import view
    >>> motion = tc.simulate(tc.Model(tc.Scene(tc.shapes.prism(prestress=50.0))), t_end=0.1, step=0.01, compiled=False)
    >>> view({"prism": motion}, html="prism.html")
    View(prism)
    """
    target = None if html is None else _html_path("html", html)
    choice("color", color, *QUANTITIES)
    positive_number("speed", speed)
    flag("follow", follow)
    flag("side_by_side", side_by_side)
    content = describe_content(things, "things", ground)
    name = text("title", title) or ", ".join(motion.name for motion in content.motions)
    found = View(content, name, color, float(speed), follow, side_by_side)
    if target is not None:
        found.save(target)
    elif not in_notebook():
        found.show(host, port, browser, wait)
    return found


def _html_path(field: str, path: FilePath) -> Path:
    target = file_path(field, path)
    if target.suffix.lower() not in (".html", ".htm"):
        raise ValueError(f"{field} is {os.fspath(path)!r}: give a file name that ends in .html")
    return target
