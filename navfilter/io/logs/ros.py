"""ROS 1 bags and ROS 2 bags (SQLite and MCAP, single files and folders), read with rosbags.

Message definitions come from the bag; those of a bag that has none (older .db3) from the definitions of ROS itself, and
from files ``PACKAGE/msg/TYPE.msg`` beside the bag. The time of a record is that of its reception by the recorder;
instruments' own stamps are ``header.stamp``. What a message says is absent (a covariance that begins with -1) is NaN.
"""

import dataclasses
import io
import math
from bz2 import open as bz2_open
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from operator import attrgetter
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from lz4.frame import open as lz4_open
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import reader as bag1
from rosbags.rosbag2 import reader as bag2
from rosbags.rosbag2 import storage_mcap as mcap
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from navfilter.io.logs.lines import bar
from navfilter.io.logs.topic_names import Wanted
from navfilter.io.trust import Allowance
from navfilter.models.mission import MissionError

_REPAIR = {
    ".bag": '"rosbag reindex" mends it',
    ".mcap": '"mcap recover" mends it',
    ".db3": '"sqlite3 FILE .recover" mends it',
}
#: Message types without a reading that navigates; decoding them would cost minutes.
_HEAVY = ("Image", "CompressedImage", "PointCloud2", "LaserScan", "OccupancyGrid", "TFMessage", "MarkerArray", "Log")


def records(path: Path, wanted: Wanted, tally: Counter[str]) -> Iterator[tuple[str, float, Any]]:
    """See `navfilter.io.logs`."""
    with _bounded(path, wanted.allowance), _opened(path) as reader:
        chosen = []
        for connection in reader.connections:
            if not wanted(connection.topic):
                continue
            if connection.msgtype in reader.typestore.fielddefs and not connection.msgtype.endswith(_HEAVY):
                chosen.append(connection)
            else:
                package, _, kind = connection.msgtype.partition("/msg/")
                undefined = connection.msgtype not in reader.typestore.fielddefs
                cure = f": not defined in this bag; put {package}/msg/{kind}.msg beside it" if undefined else ""
                tally[f"messages of {connection.topic} left out ({connection.msgtype}{cure})"] += connection.msgcount
        if not chosen:
            return
        typestore, is2 = reader.typestore, reader.is2
        decode = typestore.deserialize_cdr if is2 else typestore.deserialize_ros1
        total = sum(connection.msgcount for connection in chosen)
        with_covariance: dict[str, list[tuple[Callable[[Any], Any], str, str]]] = {}
        for connection, nanoseconds, raw in bar(_until_damage(reader, chosen, tally), path, total, "messages"):
            try:
                message = decode(raw, connection.msgtype)
            except Exception:  # the decoders are generated code: whatever a damaged message makes them raise
                tally[f"messages of {connection.topic} cannot be decoded"] += 1
                continue
            if connection.msgtype not in with_covariance:
                with_covariance[connection.msgtype] = _with_covariance(message)
            for covariance, holder, part in with_covariance[connection.msgtype]:
                if covariance(message).item(0) == -1.0:
                    whole = getattr(message, holder) if holder else message
                    setattr(whole, part, _nothing(getattr(whole, part)))
                    tally[f"messages of {connection.topic} without {part}, as they say (covariance -1)"] += 1
            yield connection.topic, nanoseconds * 1e-9, message


def _with_covariance(message: Any) -> list[tuple[Callable[[Any], Any], str, str]]:
    """What gives a covariance, what holds the part that it belongs to (empty: the message), and the part's name: its
    first element is -1 where the part is absent.
    """
    names = _fields(message)
    own = [(attrgetter(f"{name}_covariance"), "", name) for name in names if f"{name}_covariance" in names]
    both = [name for name in names if {name, "covariance"} <= {*_fields(getattr(message, name))}]
    return own + [(attrgetter(f"{name}.covariance"), name, name) for name in both]


def _fields(part: Any) -> list[str]:
    return list(getattr(part, "__dataclass_fields__", ()))


def _nothing(part: Any) -> Any:
    """The same part without a value."""
    if not dataclasses.is_dataclass(part) or isinstance(part, type):
        return math.nan
    values = {field.name: _nothing(getattr(part, field.name)) for field in dataclasses.fields(part) if field.init}
    return dataclasses.replace(part, **values)


def kinds(path: Path) -> dict[str, str]:
    """Topic -> type of its messages, such as ``"sensor_msgs/msg/Imu"``."""
    with _opened(path) as reader:
        return {connection.topic: connection.msgtype for connection in reader.connections}


@contextmanager
def _opened(path: Path) -> Iterator[AnyReader]:
    try:
        reader = AnyReader([path], default_typestore=_definitions(path))
        reader.open()
    except MissionError:
        raise
    except Exception as error:  # rosbags raises its own errors, those of sqlite3, of struct and of lz4
        advice = f" If the recording was cut short, {_REPAIR[path.suffix]}." if path.suffix in _REPAIR else ""
        raise MissionError(f"{path} cannot be read as a ROS bag: {_one_line(error)}.{advice}") from None
    try:
        yield reader
    finally:
        reader.close()


def _definitions(path: Path) -> Typestore:
    """The message types of ROS, and those that stand beside the bag."""
    store = get_typestore(Stores.LATEST)
    found: dict[str, Any] = {}
    for file in sorted(path.parent.glob("*/msg/*.msg")):
        name = f"{file.parent.parent.name}/msg/{file.stem}"
        found.update(get_types_from_msg(file.read_text(encoding="utf-8"), name))
    store.register(found)
    return store


@contextmanager
def _bounded(path: Path, allowance: Allowance) -> Iterator[None]:
    """Within, no piece that rosbags unpacks is larger than what is allowed.

    It unpacks a chunk whole, whatever that comes to, so the functions by which it does are exchanged meanwhile. A chunk
    is forgotten before the next one: each has to fit in, not all together.
    """

    def by(opener: Callable[..., Any]) -> Callable[..., bytes]:
        return lambda data, *size: _Piece(opener(io.BytesIO(data)), path, allowance).read()

    zstd, lz4 = bag2.zstd, by(lz4_open)
    tables: list[dict[str, Any]] = [bag1.decompressors, mcap.DECOMPRESSORS]
    before = [dict(table) for table in tables]
    bounded = {"decompress": by(zstd.open), "open": lambda file, mode: _Piece(zstd.open(file, mode), path, allowance)}
    try:
        bag2.zstd = SimpleNamespace(**bounded)  # type: ignore[assignment]
        bag1.decompressors.update(lz4=lz4, bz2=by(bz2_open))
        mcap.DECOMPRESSORS.update(lz4=lz4, zstd=by(zstd.open))
        yield
    finally:
        bag2.zstd = zstd
        for table, old in zip(tables, before, strict=True):
            table.update(old)


class _Piece:
    """A file that is unpacked as it is read, up to what is allowed."""

    def __init__(self, file: Any, path: Path, allowance: Allowance) -> None:
        self._file, self._path, self._allowance, self._size = file, path, allowance, 0

    def __enter__(self) -> "_Piece":
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def read(self, size: int = -1) -> bytes:
        """The next bytes; all that are left by default."""
        most = self._allowance.left - self._size + 1
        data: bytes = self._file.read(most if size < 0 else min(size, most))
        self._size += len(data)
        try:
            self._allowance.has(self._size)
        except MissionError as error:
            raise MissionError(f"{self._path}: {error}") from None
        return data


def _until_damage(reader: AnyReader, chosen: list[Any], tally: Counter[str]) -> Iterator[tuple[Any, int, bytes]]:
    """The messages up to the first place that cannot be read: what was recorded before it is worth having."""
    missing = sum(connection.msgcount for connection in chosen)
    try:
        for found in reader.messages(connections=chosen):
            missing -= 1
            yield found
    except MissionError:
        raise
    except Exception as error:  # as above
        tally[f"place where the bag is damaged, nothing read behind it ({_one_line(error)})"] += 1
    if missing > 0:
        tally["messages missing that the bag's index counts"] += missing


def _one_line(error: BaseException) -> str:
    return (str(error) or type(error).__name__).splitlines()[0].rstrip(".")
