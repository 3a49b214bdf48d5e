"""The viewer's server: who may connect, what a page may ask for, and what it cannot do."""

from __future__ import annotations

import http.client
import socket
import sys

import pytest
from visitor import CAMERA, connect, say, wait_for

from tenscasadi.viewer.web.server import (
    MOST_BYTES,
    OpenToNetwork,
    address,
    is_plain,
    refuse_request,
    start_server,
)

viser = pytest.importorskip(
    "viser", reason="viser is not installed: pip install 'tenscasadi[view]'"
)
refusals = pytest.importorskip("websockets.exceptions")


@pytest.fixture(scope="module")
def server():
    started = start_server()
    yield started
    started.stop()


def answer(server, path, headers=None):
    connection = http.client.HTTPConnection("127.0.0.1", server.get_port(), timeout=10)
    connection.putrequest("GET", path, skip_host=bool(headers and "Host" in headers))
    for name, value in (headers or {}).items():
        connection.putheader(name, value)
    connection.endheaders()
    response = connection.getresponse()
    body = response.read()
    connection.close()
    return response.status, body


def test_serves_its_page_to_this_machine_alone(server):
    status, body = answer(server, "/")
    assert status == 200
    assert b"<html" in body
    assert address(server) == f"http://127.0.0.1:{server.get_port()}"
    own = {
        entry[4][0] for entry in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)
    } - {"127.0.0.1"}
    for other in [
        place for place in own if not place.startswith("127.")
    ]:  # by its other addresses it is not reached
        with pytest.raises(OSError, match=r"refused|timed out"):
            socket.create_connection((other, server.get_port()), timeout=2)


@pytest.mark.parametrize(
    "path",
    [
        "/../server.py",
        "/..%2f..%2f_viser.py",
        "/%2e%2e/%2e%2e/_viser.py",
        "/..\\..\\_viser.py",
        "//etc/passwd",
        "/%2fetc/passwd",
        "/etc/passwd%00.png",
        "/assets/../../../_viser.py",
        "/C:/Windows/win.ini",
        "/C%3a/Windows/win.ini",
    ],
)
def test_no_file_but_the_page_is_read(server, path):
    status, body = answer(server, path)
    assert status in (403, 404)
    assert b"root:" not in body
    assert b"class ViserServer" not in body


def test_names_that_resolve_to_this_machine_are_refused(server):
    assert answer(server, "/", {"Host": "rebound.example:8080"})[0] == 403
    assert answer(server, "/", {"Host": f"localhost:{server.get_port()}"})[0] == 200
    assert answer(server, "/", {"Host": "localhost:9000"})[0] == 200  # a port that is forwarded


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "http://127.0.0.1:1", "http://127.0.0.1:[", "file://"]
)
def test_pages_of_other_sites_cannot_connect(server, origin):
    with pytest.raises(refusals.InvalidStatus, match="403"):
        connect(server, origin=origin)


def test_its_own_page_connects_and_its_inputs_are_heard(server):
    heard = []
    slider = server.gui.add_slider("x", 0.0, 10.0, 0.1, 1.0)
    slider.on_update(lambda event: heard.append(event.target.value))
    with connect(server, origin=address(server)) as page:
        say(page, **CAMERA)
        wait_for(server.get_clients, "the page is known")
        say(page, type="GuiUpdateMessage", uuid=slider._impl.uuid, updates={"value": 3.0})
        wait_for(lambda: heard == [3.0], "the input is heard")
    slider.remove()


def test_a_page_cannot_upload_nor_publish_nor_change_inner_values(server, monkeypatch):
    asked = []
    monkeypatch.setattr(type(server), "request_share_url", lambda self: asked.append("published"))
    slider = server.gui.add_slider("x", 0.0, 10.0, 0.1, 1.0)
    state, uuid = slider._impl, slider._impl.uuid
    before = state.update_cb, state.sync_cb, state.removed
    with connect(server) as page:
        say(page, **CAMERA)
        wait_for(server.get_clients, "the page is known")
        say(page, type="ShareUrlRequest")
        upload = {"source_component_uuid": uuid, "transfer_uuid": "t"}
        say(
            page,
            type="FileTransferStartUpload",
            **upload,
            filename="../x",
            mime_type="a/b",
            part_count=2,
            size_bytes=9,
        )
        say(page, type="FileTransferPart", **upload, part_index=0, content=b"12345")
        for updates in (
            {"update_cb": ["x"]},
            {"removed": True},
            {"value": 2.0, "sync_cb": "x"},
            {"value": float("nan")},
            {"value": {"a": 1}},
        ):
            say(page, type="GuiUpdateMessage", uuid=uuid, updates=updates)
        say(
            page, type="GuiUpdateMessage", uuid=uuid, updates={"value": 4.0}
        )  # heard after all others
        wait_for(lambda: slider.value == 4.0, "what is right is heard")
    assert asked == []
    assert server.gui._current_file_upload_states == {}
    assert (state.update_cb, state.sync_cb, state.removed) == before
    slider.remove()


def test_a_page_cannot_fill_the_memory(server):
    with connect(server) as page:
        page.send(b"\0" * (MOST_BYTES + 1))
        with pytest.raises(refusals.ConnectionClosed):
            list(page)


def test_what_is_plain():
    assert all(map(is_plain, (True, 1, 2.5, "text", (1.0, 2.0), [])))
    assert not any(
        map(is_plain, (float("nan"), float("inf"), "x" * 5000, {}, None, b"x", [[1]], [0.0] * 100))
    )


def test_a_server_for_others_knows_itself_by_any_name():
    headers = {"Host": "lab.example:8080", "Origin": "http://lab.example:8080"}
    assert refuse_request("/", headers, local=False) == ""
    assert "for the machine" in refuse_request("/", headers, local=True)
    assert "other sites" in refuse_request(
        "/", headers | {"Origin": "http://evil.example"}, local=False
    )


def test_ports():
    first = start_server()
    second = start_server()
    try:
        assert first.get_port() != second.get_port()
        with pytest.raises(OSError, match=rf"port {first.get_port()} .*give another one, or None"):
            start_server(port=first.get_port())
    finally:
        first.stop()
        second.stop()
    for port in (0, 65536, True, "8080"):
        with pytest.raises((TypeError, ValueError), match="port is"):
            start_server(port=port)


def test_hosts():
    with pytest.raises(OSError, match=r"no such address.*127\.0\.0\.1"):
        start_server("no.such.host.invalid")
    with pytest.raises(OSError, match=r"host is '203\.0\.113\.7'"):
        start_server("203.0.113.7")
    with pytest.warns(
        OpenToNetwork, match=r"host is 0\.0\.0\.0: other machines can see .* without a password"
    ):
        wide = start_server("0.0.0.0")
    try:
        assert address(wide) == f"http://127.0.0.1:{wide.get_port()}"
    finally:
        wide.stop()


def test_without_viser_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(ImportError, match=r"pip install 'tenscasadi\[view\]'"):
        start_server()
