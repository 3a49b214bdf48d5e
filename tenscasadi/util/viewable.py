"""Display of structures and results in the viewer and in notebooks."""

from __future__ import annotations

import sys
from base64 import b64encode
from io import BytesIO
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tenscasadi.viewer.view import View


class Viewable:
    """Base class of objects that `tenscasadi.viewer.view` shows."""

    def view(self, **options: Any) -> View:
        """Show the object in a browser, or write a page.

        Parameters
        ----------
        **options
            Keywords of `tenscasadi.viewer.view`, such as ``html="page.html"``, ``ground=`` and
            ``color=``.

        Returns
        -------
        tenscasadi.viewer.View
            View. A notebook displays it without a server.

        Raises
        ------
        ImportError
            If viser is not installed.
        OSError
            If the port is taken, the address does not exist, or the page cannot be written.
        TypeError, ValueError
            If an argument is wrong.
        """
        from tenscasadi.viewer.view import view  # requires viser, and knows all viewable values

        return view(self, **options)

    def _repr_html_(self) -> str:
        """Draw a small captioned picture for a notebook."""
        from html import escape  # loads the names of 2000 characters

        from tenscasadi.plots.figures import structure  # matplotlib is slow to import

        file = BytesIO()
        structure(self, title=" ").savefig(file, format="png", dpi=60)
        source = f"data:image/png;base64,{b64encode(file.getvalue()).decode()}"
        caption = escape(repr(self))
        return f'<figure><img src="{source}" alt=""><figcaption>{caption}</figcaption></figure>'


def in_notebook() -> bool:
    """Return whether the code runs in a notebook."""
    python = sys.modules.get("IPython")
    shell = python.get_ipython() if python is not None else None
    return shell is not None and hasattr(shell, "kernel")
