"""Values that can be looked at: in a browser, or as a page."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tenscasadi.viewer.view import View


class Viewable:
    """Base of values that `tenscasadi.viewer.view` shows."""

    def view(
        self,
        *,
        html: str | os.PathLike[str] | None = None,
        host: str = "127.0.0.1",
        port: int | None = None,
        title: str = "",
        ground: Any = None,
        colour: str = "tension",
        speed: float = 1.0,
        follow: bool = False,
        browser: bool | None = None,
        wait: bool | None = None,
    ) -> View:
        """Look at it in a browser, or write it as a page; see `tenscasadi.viewer.view`.

        Parameters
        ----------
        html : path-like, optional
            Page to write in place of starting the viewer; its name ends in .html.
        host : str
            Address to listen on; others than 127.0.0.1 let other machines see and steer the viewer,
            of which it warns.
        port : int, optional
            Port. Default: one that is free.
        title : str
            Title.
        ground : Ground or Terrain or a sequence of them, optional
            Grounds to draw besides those of a scene, such as ``scene.ground``.
        colour : {"tension", "force density"}
            What the colour of strings tells.
        speed : float
            Simulated seconds in each second shown.
        follow : bool
            Whether the middle of the structure stays in view.
        browser : bool, optional
            Whether to open the browser. Default: where there is a display.
        wait : bool, optional
            Whether to return only when Ctrl-C is pressed. Default: in scripts, not where one types.

        Returns
        -------
        tenscasadi.viewer.View
            The view. In a notebook it shows itself, and no server is started.

        Raises
        ------
        ImportError
            viser is not installed.
        OSError
            The port is taken, there is no such address, or the page cannot be written.
        TypeError, ValueError
            An argument is wrong.
        """
        from tenscasadi.viewer.view import (
            view,
        )  # it knows all that can be viewed, and needs what not everybody has

        return view(
            self,
            html=html,
            host=host,
            port=port,
            title=title,
            ground=ground,
            colour=colour,
            speed=speed,
            follow=follow,
            browser=browser,
            wait=wait,
        )
