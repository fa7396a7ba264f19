"""Where the lines come from: a file, or one client at a time on a TCP socket; and the signals that end a run."""

import contextlib
import ipaddress
import os
import select
import signal
import socket
import time
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any
from urllib.parse import urlsplit

BLOCK = 65536


class Stopped(BaseException):
    """A signal asked for the end while nothing was at stake yet (see `StopSignal.at_once`)."""


class StopSignal:
    """SIGTERM and SIGINT as a flag, and as something that wakes a `select`.

    SIGHUP is only noted: that somebody's terminal or connection has gone is no reason to stop navigating.
    """

    def __init__(self) -> None:
        self.received = self.hung_up = self._at_once = False
        self._wake, self._send = socket.socketpair()
        self._wake.setblocking(False)
        self._send.setblocking(False)
        signal.set_wakeup_fd(self._send.fileno(), warn_on_full_buffer=False)
        self._before = {
            number: signal.signal(number, self._take) for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
        }

    def _take(self, number: int, frame: FrameType | None) -> None:
        if number == signal.SIGHUP:
            self.hung_up = True
            return
        self.received = True
        if self._at_once:
            self._at_once = False  # what is closed on the way out is not interrupted
            raise Stopped

    @contextlib.contextmanager
    def at_once(self) -> Iterator[None]:
        """Within, a signal raises `Stopped` wherever the program is: nobody waits for a compilation."""
        self._at_once = True
        try:
            if self.received:
                raise Stopped
            yield
        finally:
            self._at_once = False

    def ready(self, watched: list[Any], timeout_s: float) -> list[Any]:
        """Those of the descriptors that can be read; returns early for a signal."""
        ready, _, _ = select.select([*watched, self._wake], [], [], timeout_s)
        if self._wake in ready:
            ready.remove(self._wake)
            with contextlib.suppress(BlockingIOError):
                self._wake.recv(BLOCK)
        return ready

    def wake(self) -> None:
        """Let `ready` return early; for other threads."""
        with contextlib.suppress(OSError):  # full: it will wake all the same
            self._send.send(b"\0")

    def restore(self) -> None:
        """Leave the process's signals as they were."""
        signal.set_wakeup_fd(-1)
        for number, handler in self._before.items():
            signal.signal(number, handler)
        self._wake.close()
        self._send.close()


class NoSource:
    """No input but that of instruments.

    Parameters
    ----------
    stop : StopSignal
    """

    def __init__(self, stop: StopSignal) -> None:
        self._stop = stop

    def read(self, timeout_s: float) -> bytes | None:
        """Nothing, after some time or when somebody wakes it."""
        self._stop.ready([], timeout_s)
        return b""

    def heard(self) -> None:
        """There was a reading: nothing follows from that here."""

    def close(self) -> None:
        """Nothing is open."""


class FileSource:
    """Bytes of a file descriptor.

    Parameters
    ----------
    handle : int
    stop : StopSignal
    """

    def __init__(self, handle: int, stop: StopSignal) -> None:
        self._handle, self._stop = handle, stop

    def read(self, timeout_s: float) -> bytes | None:
        """The next block; nothing when none came in time or a signal did; None at the end."""
        if not self._stop.ready([self._handle], timeout_s):
            return b""
        try:
            return os.read(self._handle, BLOCK) or None
        except BlockingIOError:
            return b""

    def heard(self) -> None:
        """There was a reading: nothing follows from that here."""

    def close(self) -> None:
        """Nothing is open that was not open before."""


def listen_address(url: str, *, allow_remote: bool) -> tuple[str, int]:
    """Host and port of ``tcp://127.0.0.1:4600``.

    Raises
    ------
    ValueError
        When it is no such address, or not on the loopback and that was not asked for.
    """
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError as error:
        raise ValueError(f"--listen {url}: {error}.") from None
    if parts.scheme != "tcp" or host is None or port is None or parts.path not in ("", "/"):
        raise ValueError(f"--listen must look like tcp://127.0.0.1:4600, found {url!r}.")
    host = "127.0.0.1" if host == "localhost" else host
    try:
        local = ipaddress.ip_address(host).is_loopback
    except ValueError:
        raise ValueError(f'--listen needs the address of an interface such as 127.0.0.1, found "{host}".') from None
    if not local and not allow_remote:
        raise ValueError(
            f"{host} can be reached from other computers: whoever reaches it can steer the navigation, for there is no"
            " password. Use 127.0.0.1, or add --allow-remote if that is meant."
        )
    return host, port


class Client:
    """The client of the moment, what it is known by, and when it last sent a reading [s, monotonic]."""

    def __init__(self, connection: socket.socket, name: str) -> None:
        self.connection, self.name, self.heard_s = connection, name, time.monotonic()


class TcpSource:
    """Bytes of one client at a time; when it goes, or has been silent for too long, the next one may come.

    Parameters
    ----------
    address : (str, int)
    stop : StopSignal
    changed : callable
        Is told of each client that comes or, with None, goes: ``changed(client, text)``.
    silent_s : float
        A client without a reading for so long [s] loses its place to one that comes.

    Raises
    ------
    OSError
        When the address cannot be listened on.
    """

    def __init__(
        self,
        address: tuple[str, int],
        stop: StopSignal,
        changed: Callable[[Client | None, str], Any],
        silent_s: float = 10.0,
    ) -> None:
        self._stop, self._changed, self._silent_s = stop, changed, silent_s
        family = socket.AF_INET6 if ":" in address[0] else socket.AF_INET
        self._server = socket.create_server(address, family=family, backlog=4)
        self._server.setblocking(False)
        self._client: Client | None = None

    @property
    def url(self) -> str:
        """Where it listens, with the port that was found when none was asked for."""
        host, port = self._server.getsockname()[:2]
        return f"tcp://[{host}]:{port}" if ":" in host else f"tcp://{host}:{port}"

    def read(self, timeout_s: float) -> bytes | None:
        """The next block; nothing when none came in time. A client that goes ends its last line."""
        watched: list[Any] = [self._server]
        if self._client is not None:
            watched.append(self._client.connection)
        ready = self._stop.ready(watched, timeout_s)
        data = b""
        if self._client is not None and self._client.connection in ready:
            try:
                data = self._client.connection.recv(BLOCK)
            except OSError:
                data = b""
            if not data:
                self._drop("gone")
                data = b"\n"
        if self._server in ready:
            data += self._accept()
        return data

    def heard(self) -> None:
        """What was read last held a reading: the client is not silent."""
        if self._client is not None:
            self._client.heard_s = time.monotonic()

    def _accept(self) -> bytes:
        """Let a new client in, or refuse it; a client that lost its place to it ends its last line."""
        try:
            connection, address = self._server.accept()
        except OSError:
            return b""
        name, end = f"{address[0]}:{address[1]}", b""
        if self._client is not None:
            silent_s = time.monotonic() - self._client.heard_s
            if silent_s < self._silent_s:
                self._changed(self._client, f"{name} refused: {self._client.name} is connected")
                connection.close()
                return b""
            self._drop(f"put out: no reading for {silent_s:.1f} s, and {name} has come")
            end = b"\n"
        with contextlib.suppress(OSError):  # it may have gone already
            keep_alive(connection)
        self._client = Client(connection, name)
        self._changed(self._client, f"{name} connected")
        return end

    def _drop(self, why: str) -> None:
        if self._client is None:
            return
        client, self._client = self._client, None
        self._changed(None, f"{client.name} {why}")
        with contextlib.suppress(OSError):
            client.connection.shutdown(socket.SHUT_RDWR)
        client.connection.close()

    def close(self) -> None:
        """Close the client and the server."""
        self._drop("gone")
        self._server.close()


def keep_alive(connection: socket.socket) -> None:
    """A peer whose power failed must not hold the place for hours."""
    for option, value in (("TCP_KEEPIDLE", 5), ("TCP_KEEPINTVL", 2), ("TCP_KEEPCNT", 3)):
        if hasattr(socket, option):
            connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, option), value)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
