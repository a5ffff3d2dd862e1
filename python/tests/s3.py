"""An S3 server of moto on the loopback, which counts what it is asked for."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import pytest


@dataclass
class Server:
    """A server, and what was asked of it."""

    url: str = ""
    #: Method, and bytes of the response's body.
    requests: list[tuple[str, int]] = field(default_factory=list)

    def filesystem(self):
        """Its S3, for fsspec; none that is shared."""
        s3fs = pytest.importorskip("s3fs")
        return s3fs.S3FileSystem(**self.options, skip_instance_cache=True)

    @property
    def options(self) -> dict:
        """What fsspec must know of it."""
        return {
            "key": "key",
            "secret": "secret",
            "client_kwargs": {"endpoint_url": self.url},
        }


class Counted:
    """An application whose responses are counted."""

    def __init__(self, application, server: Server) -> None:
        self.application = application
        self.server = server

    def __call__(self, environ, start_response):
        body = b"".join(self.application(environ, start_response))
        self.server.requests.append((environ["REQUEST_METHOD"], len(body)))
        return [body]


@contextmanager
def running() -> Iterator[Server]:
    """A server, while it runs."""
    moto = pytest.importorskip("moto.server")
    serving = pytest.importorskip("werkzeug.serving")
    server = Server()
    application = Counted(moto.DomainDispatcherApplication(moto.create_backend_app), server)
    listener = serving.make_server("127.0.0.1", 0, application, threaded=True)
    server.url = f"http://127.0.0.1:{listener.server_port}"
    thread = threading.Thread(target=listener.serve_forever, daemon=True)
    thread.start()
    try:
        yield server
    finally:
        listener.shutdown()
        thread.join()
