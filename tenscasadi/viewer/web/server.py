"""Web server of the viewer.

It serves only this machine by default, and ignores all messages that a page has no reason to send.
"""

from __future__ import annotations

import contextlib
import ipaddress
import math
import socket
import threading
import warnings
from collections.abc import Callable, Iterator
from typing import Any
from urllib.parse import urlsplit

from tenscasadi.util.troubleshooting import add_address, append_address
from tenscasadi.util.validate import format_value, instance, whole_number
from tenscasadi.viewer.web.frames import adapt_quality
from tenscasadi.viewer.web.hover import add_hover

LOOPBACK = "127.0.0.1"
_PORTS = range(8080, 9080)
# Messages that a page may send: its camera, clicks, drags and values of inputs.
_ACCEPTED = {
    "ViewerCameraMessage",
    "SceneNodeClickMessage",
    "SceneNodeDragMessage",
    "ScenePointerMessage",
    "GuiUpdateMessage",
}
MOST_BYTES = 2**22  # of a message of a page, such as a picture of 4 million pixels as JPEG
_starting = threading.Lock()


class OpenToNetwork(UserWarning):
    """Warning that other machines can see the viewer and use its controls."""


def import_viser() -> Any:
    """Import and return viser, or raise ImportError with the cure."""
    try:
        import viser
        import viser.infra
    except ImportError as error:
        raise add_address(
            ImportError(f"the viewer needs viser ({error}): pip install 'tenscasadi[view]'")
        ) from error
    return viser


def start_server(host: str = LOOPBACK, port: int | None = None) -> Any:
    """Start a web server of viser.

    It rejects pages of other sites, and foreign names that resolve to this machine. From a page it
    accepts the camera, clicks, drags and values of inputs. Uploads, publishing and all that would
    read or write a file are ignored.

    Parameters
    ----------
    host : str
        Address to listen on. 127.0.0.1 is accessible from this machine alone. Other addresses are
        accessible from elsewhere, without a password.
    port : int, optional
        Port. Default: the first free one from 8080 on.

    Returns
    -------
    viser.ViserServer
        The server, which runs in its own thread until `stop` is called.

    Raises
    ------
    ImportError
        viser is not installed.
    OSError
        There is no such address, or the port is taken.
    TypeError, ValueError
        The host or the port is invalid.

    Warns
    -----
    OpenToNetwork
        Other machines can reach the host.
    """
    viser = import_viser()
    instance("host", host, str, f"an address such as {LOOPBACK}")
    if port is not None and whole_number("port", port, 1) > 65535:
        raise ValueError(f"port is {port}: give one from 1 to 65535, or None for a free one")
    local = _is_local(host)
    with _starting:
        free = _find_port(host, port)
        if not local:
            warnings.warn(
                append_address(
                    f"host is {host}: other machines can see this viewer and use its controls, "
                    f"without a password; {LOOPBACK} is for this machine alone"
                ),
                OpenToNetwork,
                stacklevel=2,
            )
        with _guard_server(local) as guarded, silence_viser():
            server = viser.ViserServer(host=host, port=free, verbose=False)
    connection = server._websock_server
    if not guarded or (port is not None and server.get_port() != port):
        server.stop()
        raise OSError(
            f"port {port} was taken in between: give another one, or None for a free one"
            if guarded
            else f"viser {viser.__version__} starts its server in a way that cannot be guarded: install 1.1"
        )
    _restrict(connection)
    # The server and the connection of each page have handlers of their own.
    connection.on_client_connect(_restrict)
    connection.disconnect_all_clients()  # pages that were faster connect again
    return server


@contextlib.contextmanager
def silence_viser() -> Iterator[None]:
    """Suppress the console output of viser."""
    import rich

    console = rich.get_console()
    before, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = before


def address(server: Any) -> str:
    """Return the address of a server, such as http://127.0.0.1:8080."""
    host = server.get_host()
    if host in ("0.0.0.0", "::", ""):
        host = LOOPBACK
    return (
        f"http://[{host}]:{server.get_port()}"
        if ":" in host
        else f"http://{host}:{server.get_port()}"
    )


def _find_addresses(host: str) -> list[tuple[Any, ...]]:
    """Find the families and socket addresses of a host.

    Raises OSError.
    """
    kind, flags = socket.SOCK_STREAM, socket.AI_PASSIVE
    try:
        found = socket.getaddrinfo(host or None, 0, type=kind, flags=flags)
    except (OSError, UnicodeError) as error:
        raise OSError(
            f"host is {format_value(host)}: there is no such address on this machine ({error}), give {LOOPBACK}"
        ) from None
    return [(family, place) for family, _, _, _, place in found]


def _is_local(host: str) -> bool:
    return all(_is_loopback(place[0].partition("%")[0]) for _, place in _find_addresses(host))


def _find_port(host: str, port: int | None) -> int:
    """Check the port, or find the first free one.

    `host` is the address to serve. Without a `port`, a free one is found. Raises OSError.

    viser itself would search without end if there is no such address.
    """
    places = _find_addresses(host)
    reason: OSError | None = None
    for candidate in _PORTS if port is None else [port]:
        try:
            for family, place in places:
                with socket.socket(family, socket.SOCK_STREAM) as test:
                    test.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # as the server does
                    test.bind((place[0], candidate, *place[2:]))
                    test.listen()
            return candidate
        except OSError as error:
            reason = error
    if port is not None:
        raise add_address(
            OSError(
                f"port {port} of {host} is not available ({reason}): give another one, or None for a free one"
            )
        )
    raise OSError(
        f"host is {format_value(host)}: none of its ports {_PORTS[0]} to {_PORTS[-1]} is available ({reason})"
    )


@contextlib.contextmanager
def _guard_server(local: bool) -> Iterator[list[bool]]:
    """Start viser's server with a check of each request.

    If the server is `local`, pages must address it by a name of this machine. Viser has no option
    for the check. Yields a list that is not empty once the server has started with it.
    """
    import websockets.asyncio.server as module

    original, used = module.serve, []

    def serve(*arguments: Any, process_request: Any = None, **options: Any) -> Any:
        used.append(True)

        def check(connection: Any, request: Any) -> Any:
            refusal = refuse_request(request.path, request.headers, local)
            if refusal:
                return connection.respond(403, refusal + "\n")
            is_page = request.path.partition("?")[0] in ("/", "/index.html")
            if is_page:  # it is compressed within itself
                request.headers.pop("Accept-Encoding", None)
            response = process_request(connection, request)
            return response if response is None or not is_page else _extend_page(response)

        # a message of a page has some hundred bytes, and a picture that was asked for more
        return original(*arguments, process_request=check, **{**options, "max_size": MOST_BYTES})

    module.serve = serve  # type: ignore[assignment, misc]
    try:
        yield used
    finally:
        module.serve = original  # type: ignore[misc]


def _extend_page(response: Any) -> Any:
    """Add the scripts for frame rate and hover names to a response."""
    response.body = add_hover(adapt_quality(response.body.decode())).encode()
    del response.headers["Content-Length"]
    response.headers["Content-Length"] = str(len(response.body))
    return response


def refuse_request(path: str, headers: Any, local: bool) -> str:
    """Explain why a request for a path is rejected.

    Returns "" if it is accepted. `headers` are those of the HTTP request. If the server is `local`,
    the page must address it by a name of this machine.
    """
    host, origin = headers.get("Host") or "", headers.get("Origin")
    try:
        name = urlsplit(f"//{host}").hostname or ""
        site = None if origin is None else urlsplit(origin).netloc
    except ValueError:
        return "no such host"
    if local and name != "localhost" and not _is_loopback(name):  # a name that resolves to here
        return f"this viewer is for the machine that it runs on, not for {format_value(name)}"
    if site is not None and site.lower() != host.lower():  # browsers let any site connect
        return "pages of other sites are refused"
    if ":" in path.lower().replace("%3a", ":").partition("?")[0]:  # a drive of Windows
        return "no such file"
    return ""


def _is_loopback(name: str) -> bool:
    try:
        return ipaddress.ip_address(name).is_loopback
    except ValueError:
        return False


def _restrict(connection: Any) -> None:
    """Remove the handlers of all messages that are not accepted.

    They are those of a connection to a page.
    """
    handlers = connection._incoming_handlers
    for kind in list(handlers):
        if kind.__name__ not in _ACCEPTED:
            connection.unregister_handler(kind)
        elif kind.__name__ == "GuiUpdateMessage":
            handlers[kind] = [_check_values(handler) for handler in handlers[kind]]


def _check_values(handler: Callable[..., Any]) -> Callable[..., Any]:
    async def check(client: Any, message: Any) -> None:
        # viser sets any attribute of an input that a page names
        if set(message.updates) == {"value"} and is_plain(message.updates["value"]):
            await handler(client, message)

    return check


def is_plain(value: Any) -> bool:
    """Return whether a page may send a value as input.

    It may be a Boolean, a finite number, a short text, or a few of them.
    """
    if isinstance(value, (list, tuple)):
        return len(value) <= 64 and all(
            not isinstance(entry, (list, tuple)) and is_plain(entry) for entry in value
        )
    if isinstance(value, str):
        return len(value) <= 4096
    return isinstance(value, (bool, int, float)) and math.isfinite(value) and abs(value) < 1e300
