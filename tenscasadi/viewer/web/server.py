"""The web server of the viewer: for this machine alone, and deaf to all that a page has no business to ask."""

from __future__ import annotations

import contextlib
import gzip
import ipaddress
import math
import socket
import threading
import warnings
from collections.abc import Callable, Iterator
from typing import Any
from urllib.parse import urlsplit

from tenscasadi.util.validate import instance, shown, whole_number
from tenscasadi.viewer.web.frames import with_frames

LOOPBACK = "127.0.0.1"
_FIRST_PORT, _PORTS = 8080, 1000
_LARGEST_MESSAGE = (
    2**20
)  # bytes of what a page may send at once: a pointer's place takes some hundred
_LARGEST_TEXT, _MOST_VALUES = 4096, 64
# All that a page may say: where its camera is, what was clicked or dragged, the value of an input.
_HEARD = {
    "ViewerCameraMessage",
    "SceneNodeClickMessage",
    "SceneNodeDragMessage",
    "ScenePointerMessage",
    "GuiUpdateMessage",
}
_PAGE = ("/", "/index.html")
_starting = threading.Lock()


class OpenToNetwork(UserWarning):
    """Warns that other machines can see the viewer and use its controls."""


def import_viser() -> Any:
    """Return the module viser. Raises ImportError that says how to install it."""
    try:
        import viser
        import viser.infra
    except ImportError as error:
        raise ImportError(
            f"the viewer needs viser ({error}): pip install 'tenscasadi[view]'"
        ) from error
    return viser


def start_server(host: str = LOOPBACK, port: int | None = None) -> Any:
    """Start a web server of viser's.

    Pages of other sites, and names that resolve to this machine, are refused. Of what a page sends
    the server hears the place of its camera, clicks, drags and values of inputs: no uploads, no
    request to be published, nothing that would read or write a file.

    Parameters
    ----------
    host : str
        Address to listen on: 127.0.0.1 is reached from this machine alone. Other ones are reached
        from elsewhere, without a password.
    port : int, optional
        Port. Default: the first free one from 8080 on.

    Returns
    -------
    viser.ViserServer
        The server, which runs in a thread of its own until its `stop` is called.

    Raises
    ------
    ImportError
        viser is not installed.
    OSError
        There is no such address, or the port is taken.
    TypeError, ValueError
        The host or the port is none.

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
        free = _free_port(host, port)
        if not local:
            warnings.warn(
                f"host is {host}: other machines can see this viewer and use its controls, without a password; {LOOPBACK} is for this machine alone",
                OpenToNetwork,
                stacklevel=2,
            )
        with _guarded_serve(local) as guarded, silent():
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
    connection.on_client_connect(
        _restrict
    )  # what a page says is heard twice: by the server, and by its own connection
    connection.disconnect_all_clients()  # who came before that comes again
    return server


@contextlib.contextmanager
def silent() -> Iterator[None]:
    """Keep to itself what viser prints when it starts and ends, on the terminal and in notebooks: rich, by which it does, has one console."""
    import rich

    console = rich.get_console()
    before, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = before


def address(server: Any) -> str:
    """Return the address of a server's page, for a browser on this machine.

    Parameters
    ----------
    server : viser.ViserServer
        The server.

    Returns
    -------
    str
        Such as http://127.0.0.1:8080.
    """
    host = server.get_host()
    if host in ("0.0.0.0", "::", ""):
        host = LOOPBACK
    return (
        f"http://[{host}]:{server.get_port()}"
        if ":" in host
        else f"http://{host}:{server.get_port()}"
    )


def _addresses(host: str) -> list[tuple[Any, ...]]:
    try:
        return [
            (family, place)
            for family, _, _, _, place in socket.getaddrinfo(
                host or None, 0, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
            )
        ]
    except (OSError, UnicodeError) as error:
        raise OSError(
            f"host is {shown(host)}: there is no such address on this machine ({error}), give {LOOPBACK}"
        ) from None


def _is_local(host: str) -> bool:
    return all(
        ipaddress.ip_address(place[0].partition("%")[0]).is_loopback
        for _, place in _addresses(host)
    )


def _free_port(host: str, port: int | None) -> int:
    """Return the port, or the first free one. Raises OSError: viser would try on for ever where there is no such address."""
    places = _addresses(host)
    reason: OSError | None = None
    for candidate in range(_FIRST_PORT, _FIRST_PORT + _PORTS) if port is None else [port]:
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
        raise OSError(
            f"port {port} of {host} cannot be had ({reason}): give another one, or None for a free one"
        )
    raise OSError(
        f"host is {shown(host)}: none of its ports {_FIRST_PORT} to {_FIRST_PORT + _PORTS - 1} can be had ({reason})"
    )


@contextlib.contextmanager
def _guarded_serve(local: bool) -> Iterator[list[bool]]:
    """Let viser start a server that checks each request: viser has no option for it. Yields a list that is not empty once it has."""
    import websockets.asyncio.server as module

    original, used = module.serve, []

    def serve(*arguments: Any, process_request: Any = None, **options: Any) -> Any:
        used.append(True)

        def checked(connection: Any, request: Any) -> Any:
            refusal = refuse(request.path, request.headers, local)
            if refusal:
                return connection.respond(403, refusal + "\n")
            response = process_request(connection, request)
            return (
                response
                if response is None or request.path.partition("?")[0] not in _PAGE
                else _with_frames(response)
            )

        return original(
            *arguments, process_request=checked, **{**options, "max_size": _LARGEST_MESSAGE}
        )

    module.serve = serve  # type: ignore[assignment, misc]
    try:
        yield used
    finally:
        module.serve = original  # type: ignore[misc]


def _with_frames(response: Any) -> Any:
    """Return the answer that holds the page with what `with_frames` adds to it."""
    packed = response.headers.get("Content-Encoding") == "gzip"
    body = with_frames(
        (gzip.decompress(response.body) if packed else response.body).decode()
    ).encode()
    response.body = gzip.compress(body, 1) if packed else body
    del response.headers["Content-Length"]
    response.headers["Content-Length"] = str(len(response.body))
    return response


def refuse(path: str, headers: Any, local: bool) -> str:
    """Say why a request is refused, "" if it is not.

    Parameters
    ----------
    path : str
        What is asked for.
    headers : mapping
        Headers of the request.
    local : bool
        Whether the server is for this machine alone: the name that the page knows it by must then
        be this machine's own.

    Returns
    -------
    str
        The reason.
    """
    host, origin = headers.get("Host") or "", headers.get("Origin")
    try:
        name = urlsplit(f"//{host}").hostname or ""
        site = None if origin is None else urlsplit(origin).netloc
    except ValueError:
        return "no such host"
    if (
        local and name != "localhost" and not _is_loopback(name)
    ):  # a site whose name resolves to this machine
        return f"this viewer is for the machine that it runs on, not for {shown(name)}"
    if (
        site is not None and site.lower() != host.lower()
    ):  # browsers let any site connect, and tell which one
        return "pages of other sites are refused"
    if ":" in path.replace("%3a", ":").replace("%3A", ":").partition("?")[0]:  # a drive of Windows
        return "no such file"
    return ""


def _is_loopback(name: str) -> bool:
    try:
        return ipaddress.ip_address(name).is_loopback
    except ValueError:
        return False


def _restrict(connection: Any) -> None:
    """Let a server or connection of viser's hear nothing but `_HEARD`; of inputs nothing but plain values."""
    handlers = connection._incoming_handlers
    for kind in list(handlers):
        if kind.__name__ not in _HEARD:
            connection.unregister_handler(kind)
        elif kind.__name__ == "GuiUpdateMessage":
            handlers[kind] = [_plain_values(handler) for handler in handlers[kind]]


def _plain_values(handler: Callable[..., Any]) -> Callable[..., Any]:
    async def checked(client: Any, message: Any) -> None:
        # viser sets any attribute of an input that a page names
        if set(message.updates) == {"value"} and is_plain(message.updates["value"]):
            await handler(client, message)

    return checked


def is_plain(value: Any) -> bool:
    """Tell whether a page may send this as the value of an input: a truth value, finite number, short text, or a few of them.

    Parameters
    ----------
    value : Any
        What was sent.

    Returns
    -------
    bool
        Whether it is.
    """
    if isinstance(value, (list, tuple)):
        return len(value) <= _MOST_VALUES and all(
            not isinstance(entry, (list, tuple)) and is_plain(entry) for entry in value
        )
    if isinstance(value, str):
        return len(value) <= _LARGEST_TEXT
    return isinstance(value, bool) or (
        isinstance(value, (int, float)) and math.isfinite(value) and abs(value) < 1e300
    )
