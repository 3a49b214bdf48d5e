"""Script of pages that reports the pointer's position.

The server then shows the name of the node or member there.
"""

from __future__ import annotations

from typing import Final

# viser tells the server of clicks, and of none of the pointer's moves. Where the pointer rests, the
# page clicks with keys that no person holds together.
MODIFIER: Final = "cmd/ctrl+alt+shift"
_REST = 120  # ms without a move

_SCRIPT = f"""<script>
(function () {{
  var timer = null;
  function click(at) {{
    ["pointerdown", "pointerup"].forEach(function (kind) {{
      at.target.dispatchEvent(new PointerEvent(kind, {{
        bubbles: true, cancelable: true, composed: true, view: window, isPrimary: true,
        clientX: at.clientX, clientY: at.clientY, pointerId: at.pointerId, pointerType: "mouse",
        button: 0, buttons: kind === "pointerdown" ? 1 : 0, ctrlKey: true, altKey: true, shiftKey: true
      }}));
    }});
  }}
  function rest(at) {{
    clearTimeout(timer);
    if (at.isTrusted && !at.buttons && at.pointerType === "mouse" && at.target instanceof HTMLCanvasElement)
      timer = setTimeout(click, {_REST}, at);
  }}
  document.addEventListener("pointermove", rest, true);
  document.addEventListener("pointerdown", function (at) {{ if (at.isTrusted) clearTimeout(timer); }}, true);
}})();
</script>"""


def add_hover(page: str) -> str:
    """Add a script to a page that reports the pointer's position."""
    head = page.index("<head>") + len("<head>")
    return page[:head] + _SCRIPT + page[head:]
