"""`view`: structures, scenes, motions and plans in a browser, or as a page that anybody can open."""

from __future__ import annotations

import os
import threading
from html import escape
from pathlib import Path
from types import TracebackType
from typing import Any

from tenscasadi.scene.ground import Grounds, checked_grounds
from tenscasadi.util.validate import choice, file_path, flag, positive_number, text
from tenscasadi.util.whole_file import whole_file
from tenscasadi.viewer.canvas import QUANTITIES, Canvas
from tenscasadi.viewer.exhibit import Exhibit, exhibit_of, standing_on
from tenscasadi.viewer.player import Player
from tenscasadi.viewer.web.page import frame_times, record, with_panel
from tenscasadi.viewer.web.server import LOOPBACK, address, start_server
from tenscasadi.viewer.web.serving import check_serving, in_notebook, open_and_wait, stop

FilePath = str | os.PathLike[str]


class View:
    """Something to look at: in the browser by `show`, as a file by `save`, in a notebook by itself.

    `view` returns one.

    Parameters
    ----------
    exhibit : Exhibit
        Motions and what stands beside them, as `exhibit_of` gives them.
    title : str
        Title.
    colour : {"tension", "force density"}
        What the colour of strings tells.
    speed : float
        Simulated seconds in each second shown.
    follow : bool
        Whether the middle of the first motion stays in view.

    Attributes
    ----------
    url : str or None
        Where the viewer is, while it is shown.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> with tc.shapes.prism().view(browser=False, wait=False) as shown:
    ...     print(shown.url.rpartition(":")[0])
    http://127.0.0.1
    """

    def __init__(
        self, exhibit: Exhibit, title: str, colour: str, speed: float, follow: bool
    ) -> None:
        self.exhibit, self.title = exhibit, title
        self._colour, self._speed, self._follow = colour, speed, follow
        self._server: Any = None
        self.player: Player | None = None
        self.url: str | None = None

    def __repr__(self) -> str:
        told = ", ".join(motion.name for motion in self.exhibit.motions)
        return f"View({told}{'' if self.url is None else f', at {self.url}'})"

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
            Address to listen on; others than 127.0.0.1 let other machines see and steer the viewer,
            of which it warns.
        port : int, optional
            Port. Default: one that is free.
        browser : bool, optional
            Whether to open the browser. Default: where there is a display.
        wait : bool, optional
            Whether to return only when Ctrl-C is pressed. Default: in scripts, not where one types.

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
        """Return when Ctrl-C is pressed, and close the viewer."""
        try:
            threading.Event().wait()
        except KeyboardInterrupt:
            self.close()

    def close(self) -> None:
        """Stop serving."""
        if self.player is not None:
            self.player.close()
        if self._server is not None:
            stop(self._server)
        self._server = self.player = self.url = None

    def save(self, path: FilePath) -> Path:
        """Write one self-contained page, which plays in any browser without a network or anything installed.

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
            `path` is none, or the page would have more than 3000 frames.
        """
        target = _html_path("path", path)
        page = self.page().encode(errors="replace")  # a title may hold half of a character
        with whole_file(target) as file:
            file.write(page)
        return target

    def page(self) -> str:
        """Return the page that `save` writes.

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
        frame_times(self.exhibit.start, self.exhibit.end, self._speed, 30)
        server = start_server()
        try:
            canvas = self._canvas(server)
            return with_panel(record(server, canvas, self._speed), canvas, self.title, self._speed)
        finally:
            stop(server)

    def _canvas(self, server: Any) -> Canvas:
        canvas = Canvas(server, self.exhibit, self._colour)
        canvas.follow(self._follow)
        return canvas

    def _repr_html_(self) -> str:
        """Return the page within a notebook."""
        return f'<iframe srcdoc="{escape(self.page(), quote=True)}" width="100%" height="560" style="border:1px solid #ddd"></iframe>'

    def __enter__(self) -> View:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def view(
    things: Any,
    *,
    html: FilePath | None = None,
    host: str = LOOPBACK,
    port: int | None = None,
    title: str = "",
    ground: Grounds = None,
    colour: str = "tension",
    speed: float = 1.0,
    follow: bool = False,
    browser: bool | None = None,
    wait: bool | None = None,
) -> View:
    """Look at structures, scenes, motions and plans in a browser, over each other.

    Parameters
    ----------
    things : Structure, Scene, Model, Trajectory, Rollouts or ocp.Plan, or a list, or a mapping of
    names to them
        What to show. The first motion is solid, and its strings tell what they bear by their
        colour; others are seen through.
    html : path-like, optional
        Page to write in place of starting the viewer; its name ends in .html.
    host : str
        Address to listen on; others than 127.0.0.1 let other machines see and steer the viewer, of
        which it warns.
    port : int, optional
        Port. Default: one that is free.
    title : str
        Title. Default: the names of the motions.
    ground : Ground or Terrain or a sequence of them, optional
        Grounds to draw besides those of the scenes, such as ``scene.ground``.
    colour : {"tension", "force density"}
        What the colour of strings tells.
    speed : float
        Simulated seconds in each second shown.
    follow : bool
        Whether the middle of the first motion stays in view.
    browser, wait : bool, optional
        Whether to open the browser, and to return only when Ctrl-C is pressed; see `View.show`.

    Returns
    -------
    View
        The view. In a notebook it shows itself, and no server is started.

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
    A page holds what is seen at 30 frames a second, with its own player: play, pause, scrub, speed,
    and which parts are visible. Labels on click, following, and other colours need the viewer
    itself.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> from tenscasadi.viewer import view
    >>> motion = tc.simulate(tc.Model(tc.Scene(tc.shapes.prism(prestress=50.0))), t_end=0.1, step=0.01, compiled=False)
    >>> view({"prism": motion}, html="prism.html")
    View(prism)
    """
    target = None if html is None else _html_path("html", html)
    choice("colour", colour, *QUANTITIES)
    positive_number("speed", speed)
    flag("follow", follow)
    exhibit = standing_on(exhibit_of(things), checked_grounds(ground, "ground"))
    name = text("title", title) or ", ".join(motion.name for motion in exhibit.motions)
    found = View(exhibit, name, colour, float(speed), follow)
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
