"""A run on a web socket, as Foxglove's live view takes it: the messages of the log, at their time.

What is sent are the bytes a log holds (`logs.messages`), from a finished log (`play_log`) or from a
run while it is made (`LiveRun`). The server listens on this machine only (127.0.0.1) and takes
nothing from its clients but play, pause, speed and seek: it has no authentication, so it must not
be reachable from elsewhere, and nothing a client sends may change anything here.

The extra `[live]` brings the server (`foxglove-sdk`).
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from twin.errors import TwinError

if TYPE_CHECKING:
    from logs.messages import MessageStream, MessageType
    from logs.playback import Playback
    from logs.records import Record

HOST = "127.0.0.1"
PORT = 8765
"""Where Foxglove looks for a server if it is told nothing else."""
REPEAT_S = 1.5
"""What stands still is sent again this often, for viewers that come late [s of this machine]."""
STATE_S = 0.5
"""Viewers are told the time of the playback this often [s of this machine]."""
BACKLOG = 16_384
"""Messages kept for a viewer that is slower than the run; of more, the oldest are dropped."""

_PATIENCE_S = 0.05
_STILL = ("/scene/", "/radio/", "/run/start")
_STILL_ENDS = "/coverage"
_ONCE = {"/log", "/events", "/disturbances", "/replans"}  # lines of a list: never told twice


class Clock:
    """Simulated time that runs at a speed, can be halted, and can jump.

    Commands come from the server's thread, waiting is done by the one that sends messages.
    """

    def __init__(self, begin_ns: int, speed: float, *, paused: bool = False) -> None:
        self._condition = threading.Condition()
        self._anchor_ns, self._anchor_s = begin_ns, time.monotonic()
        self._speed, self._paused = speed, paused
        self._seek_ns: int | None = None

    @property
    def speed(self) -> float:
        """Simulated seconds per second."""
        return self._speed

    @property
    def paused(self) -> bool:
        """Whether it is halted."""
        return self._paused

    def now_ns(self) -> int:
        """Simulated time, as a log time [ns]."""
        with self._condition:
            return self._now_ns()

    def _now_ns(self) -> int:
        if self._paused:
            return self._anchor_ns
        since_s = time.monotonic() - self._anchor_s
        return self._anchor_ns + round(since_s * self._speed * 1e9)

    def _set(self, t_ns: int) -> None:
        self._anchor_ns, self._anchor_s = t_ns, time.monotonic()

    def control(self, *, paused: bool | None = None, speed: float | None = None) -> None:
        """Halt, go on, or run at another speed."""
        with self._condition:
            self._set(self._now_ns())
            if paused is not None:
                self._paused = paused
            if speed is not None and 0.001 <= speed <= 100_000:
                self._speed = speed
            self._condition.notify_all()

    def ask_seek(self, t_ns: int) -> None:
        """Have the one who waits go on from another time."""
        with self._condition:
            self._seek_ns = t_ns
            self._set(t_ns)
            self._condition.notify_all()

    def jump(self, t_ns: int) -> None:
        """Go on from a later time; who waits for an earlier one waits no more."""
        with self._condition:
            self._set(max(t_ns, self._now_ns()))
            self._condition.notify_all()

    def take_seek(self) -> int | None:
        """The time that was asked for, once."""
        with self._condition:
            asked, self._seek_ns = self._seek_ns, None
            return asked

    def wait_until(self, t_ns: int | None, idle: Callable[[], None]) -> bool:
        """Wait for a time, None: for ever. False if a seek has been asked for meanwhile.

        `idle` is called now and then while waiting.
        """
        while True:
            with self._condition:
                if self._seek_ns is not None:
                    return False
                wait_s = _PATIENCE_S
                if t_ns is not None:
                    left_ns = t_ns - self._now_ns()
                    # What is due at the very instant of a halt waits: viewers may come first.
                    if left_ns < 0 or (left_ns == 0 and not self._paused):
                        return True
                    if not self._paused:
                        wait_s = min(wait_s, left_ns / 1e9 / self._speed)
                self._condition.wait(wait_s)
            idle()


@dataclass(frozen=True)
class Options:
    """How to serve.

    Attributes:
        name: shown to viewers.
        port: 0 for any that is free.
        speed: simulated seconds per second.
        paused: wait for a viewer to press play.
    """

    name: str = "mapp-twin"
    port: int = PORT
    speed: float = 1.0
    paused: bool = False


class LiveView:
    """A server that shows one run; a context manager."""

    def __init__(
        self,
        channels: Mapping[str, MessageType],
        span_ns: tuple[int, int],
        options: Options,
        *,
        seekable: bool,
    ) -> None:
        """Prepare; nothing is open before `with`.

        Args:
            channels: topic → type.
            span_ns: log times of the first and the last message, as far as they are known.
            options: how to serve.
            seekable: whether one may go back.

        Raises:
            TwinError: foxglove-sdk is not installed.
        """
        self._sdk = require_sdk()
        self.clock = Clock(span_ns[0], options.speed, paused=options.paused)
        self._channels, self._span_ns, self._options = channels, span_ns, options
        self._seekable = seekable
        self._ended = False
        self._time_ns = span_ns[0]
        self._last: dict[str, bytes] = {}
        self._joined = threading.Event()
        self._repeated_s = self._told_s = time.monotonic()

    def __enter__(self) -> LiveView:
        """Open the port.

        Raises:
            TwinError: it is in use.
        """
        foxglove = self._sdk
        context = self._context = foxglove.Context()  # channels close when it goes
        self._out = {
            topic: foxglove.Channel(
                topic,
                schema=foxglove.Schema(name=kind.name, encoding="protobuf", data=kind.schema),
                message_encoding="protobuf",
                context=context,
            )
            for topic, kind in self._channels.items()
        }
        try:
            self._server = foxglove.start_server(
                name=self._options.name,
                host=HOST,
                port=self._options.port,
                capabilities=[],  # playback_time_range adds that of playback; there are no others
                server_listener=_Listener(self),
                context=context,
                playback_time_range=self._span_ns,
                message_backlog_size=BACKLOG,
            )
        except (RuntimeError, OSError) as error:
            raise TwinError(
                f"port {self._options.port} of {HOST} cannot be opened: {error}; choose another "
                "one with --port"
            ) from error
        self._tell_state()
        return self

    def __exit__(self, *_: object) -> None:
        """Close it."""
        self._server.stop()
        for channel in self._out.values():
            channel.close()

    @property
    def port(self) -> int:
        """The port that is open."""
        return int(self._server.port)

    @property
    def address(self) -> str:
        """What a viewer is told to open."""
        return f"ws://{HOST}:{self.port}"

    def publish(self, topic: str, time_ns: int, data: bytes) -> None:
        """Send a message now."""
        self._time_ns = max(self._time_ns, time_ns)
        if topic not in _ONCE:
            self._last[topic] = data
        self._out[topic].log(data, log_time=time_ns)
        self.idle()

    def idle(self) -> None:
        """Send again what stands still if it is time, and what was told last if a viewer came."""
        now_s = time.monotonic()
        joined = self._joined.is_set()
        if now_s - self._repeated_s >= REPEAT_S or joined:
            self._joined.clear()
            self._repeated_s = now_s
            for topic, data in self._last.items():
                if joined or topic.startswith(_STILL) or topic.endswith(_STILL_ENDS):
                    self._out[topic].log(data, log_time=self._time_ns)
        if now_s - self._told_s >= STATE_S:
            self._tell_state()

    def restart(self, t_ns: int) -> None:
        """Forget what was sent: a seek goes on from t_ns."""
        self._time_ns = t_ns
        self._last.clear()
        self._ended = False
        self._tell_state(did_seek=True)

    def end(self) -> None:
        """Tell viewers that there is nothing more."""
        self._ended = True
        self._tell_state()

    def joined(self) -> None:
        """A viewer has subscribed to something."""
        self._joined.set()

    def control(self, request: Any) -> Any:
        """What a viewer asks for: play or pause, a speed, a time to go to; the state after it."""
        pause = request.playback_command == self._sdk.websocket.PlaybackCommand.Pause
        self.clock.control(paused=pause, speed=request.playback_speed)
        asked, did_seek = request.seek_time, False
        if asked is not None:
            asked = min(max(asked, self._span_ns[0]), self._span_ns[1])
            if self._seekable:
                self.clock.ask_seek(asked)
                did_seek = True
            else:
                self.clock.jump(asked)  # a run that is being made can only go on
        return self._state(did_seek=did_seek, request_id=request.request_id)

    def _state(self, *, did_seek: bool = False, request_id: str | None = None) -> Any:
        kinds = self._sdk.websocket.PlaybackStatus
        status = kinds.Paused if self.clock.paused else kinds.Playing
        return self._sdk.websocket.PlaybackState(
            kinds.Ended if self._ended and not did_seek else status,
            min(max(self.clock.now_ns(), self._span_ns[0]), self._span_ns[1]),
            self.clock.speed,
            did_seek,
            request_id,
        )

    def _tell_state(self, *, did_seek: bool = False) -> None:
        self._told_s = time.monotonic()
        self._server.broadcast_playback_state(self._state(did_seek=did_seek))


class _Listener:
    """Hears what viewers do; called from the server's threads."""

    def __init__(self, view: LiveView) -> None:
        self._view = view

    def on_subscribe(self, client: Any, channel: Any) -> None:
        """A viewer wants to see a topic."""
        self._view.joined()

    def on_unsubscribe(self, client: Any, channel: Any) -> None:
        """A viewer has seen enough of it."""

    def on_playback_control_request(self, request: Any) -> Any:
        """A viewer plays, pauses, or goes elsewhere."""
        return self._view.control(request)


def play_log(playback: Playback, view: LiveView, *, once: bool = False) -> None:
    """Play a log, from its beginning and from wherever a viewer goes.

    Args:
        playback: the log.
        view: open, with `playback`'s channels.
        once: return at the end of the log; else wait there for viewers to go back.
    """
    begin = playback.span_ns[0]
    while True:
        asked: int | None = None
        for message in playback.since(begin):
            if not view.clock.wait_until(message.log_time_ns, view.idle):
                asked = view.clock.take_seek()
                break
            view.publish(message.topic, message.log_time_ns, message.data)
        if asked is None:
            view.end()
            if once:
                return
            view.clock.wait_until(None, view.idle)
            asked = view.clock.take_seek() or playback.span_ns[0]
        view.restart(asked)
        for message in playback.last_before(asked):
            # Viewers have forgotten all; what held at that time is told as of then.
            view.publish(message.topic, asked, message.data)
        begin = asked


class LiveRun:
    """Takes the records of a run that is being made, and sends them at their time.

    `emit` comes back when a record's time has come, so a run that calls it goes at that pace.
    """

    def __init__(self, stream: MessageStream, view: LiveView) -> None:
        self._stream, self._view = stream, view

    def emit(self, record: Record) -> None:
        """The next record of the run."""
        for topic, time_ns, data in self._stream.of(record):
            while not self._view.clock.wait_until(time_ns, self._view.idle):
                self._view.clock.take_seek()
            self._view.publish(topic, time_ns, data)


def serve_on(view: LiveView) -> None:
    """Keep the last picture for viewers that come late, until Ctrl-C."""
    view.end()
    while True:
        view.clock.wait_until(None, view.idle)
        view.clock.take_seek()


def require_sdk() -> Any:
    """The foxglove package.

    Raises:
        TwinError: it is not installed, or too old to control playback.
    """
    try:
        import foxglove
        import foxglove.websocket

        foxglove.websocket.PlaybackState  # noqa: B018
    except (ImportError, AttributeError) as error:
        raise TwinError(
            "the live view needs foxglove-sdk 0.30 or newer; install it with "
            "`pip install 'mapp-twin[live]'`"
        ) from error
    return foxglove
