"""A small web server that shows a watcher's sweep; it only ever reads."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import urlsplit

from panodepth_ros.nodes.watcher import Watcher
from panodepth_ros.pages import page

#: Time between looks at the watcher [s].
_PERIOD = 0.3
#: A silent connection is given a sign of life after so many looks.
_SILENT_LOOKS = 30
_PICTURES = ('left', 'right', 'center', 'depth')


class WatchServer:
    """
    Serves the page, its pictures and a stream of server-sent events until closed.

    Parameters
    ----------
    watcher : Watcher
        What it shows.
    host : str
        Address or name to listen on.
    port : int
        0 for any free one.

    Raises
    ------
    OSError
        If the address cannot be listened on.
    """

    def __init__(self, watcher: Watcher, host: str, port: int) -> None:
        stop = threading.Event()

        class Handler(_Handler):
            def status(self) -> Iterator[str | None]:
                return _changes(watcher, stop)

            def content(self, path: str) -> tuple[str, bytes] | None:
                return _content(watcher, path)

        try:
            self._server = ThreadingHTTPServer((host, port), Handler)
        except OSError as error:
            raise OSError(f'cannot listen on {host}:{port}: {error.strerror}') from error
        self._server.daemon_threads = True
        self._stop = stop
        self.url = f'http://{host}:{self._server.server_port}/'
        # A daemon, so that a signal between here and the first spin cannot leave it behind.
        self._thread = threading.Thread(
            target=self._server.serve_forever, name='watch server', daemon=True
        )
        self._thread.start()

    def close(self) -> None:
        """End all connections and free the port."""
        self._stop.set()
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()


def _changes(watcher: Watcher, stop: threading.Event) -> Iterator[str | None]:
    """Yield each new status as JSON, and now and then None while nothing changes."""
    last, silent = '', 0
    while not stop.wait(_PERIOD if last else 0):
        status = json.dumps(watcher.status())
        silent = 0 if status != last else silent + 1
        if status != last:
            yield status
        elif silent % _SILENT_LOOKS == 0:
            yield None
        last = status


def _content(watcher: Watcher, path: str) -> tuple[str, bytes] | None:
    """Type and bytes of a path, None if there is nothing there, or not yet."""
    if path == '/':
        return 'text/html; charset=utf-8', page('watch.html').encode()
    if path == '/scan.json':
        return 'application/json', json.dumps(watcher.scan()).encode()
    name = path.removeprefix('/').removesuffix('.png')
    picture = watcher.picture(name) if path == f'/{name}.png' and name in _PICTURES else None
    return None if picture is None else ('image/png', picture)


class _Handler(BaseHTTPRequestHandler):
    """One request; what it shows comes from the server."""

    def status(self) -> Iterator[str | None]:
        raise NotImplementedError

    def content(self, path: str) -> tuple[str, bytes] | None:
        raise NotImplementedError

    def do_GET(self) -> None:
        path = urlsplit(self.path).path
        try:
            if path == '/events':
                self._stream()
                return
            found = self.content(path)
            if found is None:
                self.send_error(404, 'nothing to show here, or not yet')
                return
            kind, body = found
            self._head(kind, {'Content-Length': str(len(body))})
            self.wfile.write(body)
        except (BrokenPipeError, ConnectionResetError):
            pass  # the browser has gone

    def _stream(self) -> None:
        self._head('text/event-stream', {})
        for status in self.status():
            self.wfile.write(f'data: {status}\n\n'.encode() if status else b': still here\n\n')
            self.wfile.flush()

    def _head(self, kind: str, headers: dict[str, str]) -> None:
        self.send_response(200)
        for name, value in {'Content-Type': kind, 'Cache-Control': 'no-store', **headers}.items():
            self.send_header(name, value)
        self.end_headers()

    def log_message(self, *_: object) -> None:
        """Keep quiet: every picture is a request."""
