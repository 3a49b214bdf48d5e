"""Method `view` of values that the viewer shows."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tenscasadi.viewer.view import View


class Viewable:
    """Base of values that `tenscasadi.viewer.view` shows."""

    def view(self, **options: Any) -> View:
        """Show the value in a browser, or write it as a page.

        Parameters
        ----------
        **options
            Keywords of `tenscasadi.viewer.view`, such as ``html="page.html"``, ``ground=`` and
            ``color=``.

        Returns
        -------
        tenscasadi.viewer.View
            The view. In a notebook it displays itself, and no server is started.

        Raises
        ------
        ImportError
            viser is not installed.
        OSError
            The port is taken, there is no such address, or the page cannot be written.
        TypeError, ValueError
            An argument is wrong.
        """
        from tenscasadi.viewer.view import view  # requires viser, and knows all viewable values

        return view(self, **options)
