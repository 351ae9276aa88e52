"""The live view: a web socket on this machine that shows what the log holds, at its time."""

from __future__ import annotations

import builtins
import json
import socket
import struct
import sys
import threading
import time
from collections import defaultdict
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

import logs
from logs.playback import Playback
from tests.cli_tools import HALL, twin
from tests.logs.good_logs import log_of
from twin.errors import TwinError
from twin.live import HOST, REPEAT_S, Clock, LiveView, Options, play_log

SUBPROTOCOL = "foxglove.sdk.v1"
SECOND = 10**9
PLAYING, PAUSED, ENDED = 0, 1, 3


def needs_server():
    """Skip, with the reason, where the extra or the client is not installed."""
    pytest.importorskip("foxglove", reason="foxglove-sdk is not installed (extra `live`)")
    pytest.importorskip("websockets", reason="websockets is not installed (dev)")


class Client:
    """A viewer that subscribes to everything."""

    def __init__(self, port: int) -> None:
        from websockets.sync.client import connect

        self._connection = connect(
            f"ws://{HOST}:{port}",
            subprotocols=[SUBPROTOCOL],
            max_size=None,
            compression=None,
            close_timeout=0.1,
        )
        self._socket = self._connection.__enter__()
        self.info: dict = {}
        self.channels: dict[int, dict] = {}
        self.messages: list[tuple[str, int, bytes]] = []
        self.states: list[tuple[int, int, float, bool, str]] = []

    def take(self, done, timeout: float = 20.0) -> None:
        """Take what comes until `done()` is true."""
        until = time.monotonic() + timeout
        while not done():
            left = until - time.monotonic()
            assert left > 0, (
                f"nothing more to come: {len(self.messages)} messages, {self.states[-3:]}"
            )
            try:
                self._add(self._socket.recv(timeout=min(left, 0.2)))
            except TimeoutError:
                continue

    def _add(self, data) -> None:
        if isinstance(data, str):
            said = json.loads(data)
            if said["op"] == "serverInfo":
                self.info = said
            elif said["op"] == "advertise":
                new = {channel["id"]: channel for channel in said["channels"]}
                self.channels |= new
                wanted = [{"id": number, "channelId": number} for number in new]
                self._socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
        elif data[0] == 1:
            number, log_time = struct.unpack_from("<IQ", data, 1)
            self.messages.append((self.channels[number]["topic"], log_time, data[13:]))
        elif data[0] == 5:
            status, now, speed, did_seek, length = struct.unpack_from("<BQfBI", data, 1)
            request = data[19 : 19 + length].decode()
            self.states.append((status, now, speed, bool(did_seek), request))

    def ask(self, command: int, speed: float, seek: int | None, request: str) -> None:
        """Play (0) or pause (1), at a speed, from a time."""
        head = struct.pack("<BBfBQI", 3, command, speed, seek is not None, seek or 0, len(request))
        self._socket.send(head + request.encode())

    def last(self, topic: str) -> tuple[int, bytes] | None:
        """The last message of a topic."""
        found = [(time, data) for name, time, data in self.messages if name == topic]
        return found[-1] if found else None

    def ended(self) -> bool:
        """Whether the log is over; that is told on another way than its last message."""
        over = any(state[0] == ENDED for state in self.states)
        return over and self.last("/run/end") is not None

    def answer(self, request: str):
        """The state that answers a request."""
        return next((state for state in self.states if state[4] == request), None)

    def send(self, data: str | bytes) -> None:
        """Send anything."""
        self._socket.send(data)

    def close(self) -> None:
        """Leave."""
        self._connection.__exit__(None, None, None)


@contextmanager
def playing(**options):
    """A log being played in a thread; gives the view, the playback and a viewer."""
    needs_server()
    playback = Playback(log_of())
    chosen = Options(port=0, **options)
    with LiveView(playback.channels, playback.span_ns, chosen, seekable=True) as view:
        stop = threading.Event()

        class End(Exception):  # noqa: N818
            pass

        def idle(plain=view.idle):
            if stop.is_set():
                raise End
            plain()

        view.idle = idle

        def play():
            with suppress(End):
                play_log(playback, view)

        thread = threading.Thread(target=play, daemon=True)
        client = Client(view.port)
        thread.start()
        try:
            yield view, playback, client
        finally:
            stop.set()
            client.close()
            thread.join(5)
            assert not thread.is_alive()


# --- the clock ------------------------------------------------------------------------------------


def test_a_clock_runs_at_its_speed_and_can_be_halted():
    """Simulated time passes as fast as asked; not at all while halted."""
    clock = Clock(5 * SECOND, 100.0)
    begun = time.monotonic()
    assert clock.wait_until(15 * SECOND, lambda: None)
    assert 0.09 <= time.monotonic() - begun < 2.0
    clock.control(paused=True)
    held = clock.now_ns()
    time.sleep(0.02)
    assert clock.now_ns() == held
    clock.control(paused=False, speed=1000.0)
    assert clock.wait_until(held + 10 * SECOND, lambda: None)


def test_a_seek_ends_the_wait():
    """Whoever waits is told, and time goes on from there."""
    clock = Clock(0, 1.0, paused=True)
    clock.ask_seek(7 * SECOND)
    assert clock.wait_until(SECOND, lambda: None) is False
    assert clock.take_seek() == 7 * SECOND
    assert clock.take_seek() is None
    assert clock.now_ns() == 7 * SECOND


def test_a_speed_that_makes_no_sense_is_passed_over():
    """A viewer that asks for speed 0, a negative one or NaN changes nothing."""
    clock = Clock(0, 2.0)
    for speed in (0.0, -1.0, float("nan"), float("inf")):
        clock.control(speed=speed)
        assert clock.speed == 2.0


# --- playback of a log ----------------------------------------------------------------------------


def test_playback_finds_every_topic_at_any_time():
    """What was told last on each topic is what going through the whole log finds."""
    playback = Playback(log_of())
    everything = list(logs.read(log_of()).iter_messages())
    assert list(playback.since(0)) == everything
    for t_ns in sorted({m.log_time_ns for m in everything})[::7]:
        expected = {m.topic: m for m in everything if m.log_time_ns < t_ns}
        assert {m.topic: m for m in playback.last_before(t_ns)} == expected
        assert list(playback.since(t_ns)) == [m for m in everything if m.log_time_ns >= t_ns]


def test_a_viewer_is_sent_the_bytes_of_the_log():
    """Every topic with its schema; every message of it, in order, at its time (page 6)."""
    with playing(speed=200.0, paused=True) as (view, playback, client):
        client.take(lambda: len(client.channels) == len(playback.channels))
        client.take(lambda: bool(client.states))
        client.ask(0, 200.0, None, "play")
        client.take(client.ended)
        (*_, line) = (m for m in playback.since(0) if m.topic == "/log")
        client.take(lambda: (client.last("/log") or (0, b""))[1] == line.data)
        schemas = {c["topic"]: c["schemaName"] for c in client.channels.values()}
        assert schemas == {topic: kind.name for topic, kind in playback.channels.items()}
        sent = defaultdict(list)
        for topic, _, data in client.messages:
            if not sent[topic] or sent[topic][-1] != data:  # statics are repeated
                sent[topic].append(data)
        told = defaultdict(list)
        for message in playback.since(0):
            if not told[message.topic] or told[message.topic][-1] != message.data:
                told[message.topic].append(message.data)
        assert {t: d for t, d in sent.items() if d} == dict(told)
        assert view.address.startswith(f"ws://{HOST}:")


def test_it_offers_playback_and_nothing_else():
    """No publishing, no parameters, no services: nothing a client sends changes anything."""
    with playing(paused=True) as (_, _, client):
        client.take(lambda: bool(client.info))
        assert client.info["capabilities"] == ["playbackControl"]


def test_it_listens_on_this_machine_only():
    """The port is open at 127.0.0.1 and at no other address of this machine."""
    table = Path("/proc/net/tcp")
    with playing(paused=True) as (view, _, _):
        if not table.exists():
            pytest.skip("only Linux lists its open ports in /proc/net")
        rows = [line.split() for line in table.read_text().splitlines()[1:]]
        six = Path("/proc/net/tcp6")
        rows += [line.split() for line in six.read_text().splitlines()[1:]] if six.exists() else []
        listening = {row[1] for row in rows if row[3] == "0A"}
        assert {place for place in listening if place.endswith(f":{view.port:04X}")} == {
            f"0100007F:{view.port:04X}"
        }


def test_a_viewer_that_comes_late_sees_the_hall():
    """What stands still is sent again, without anything moving."""
    with playing(speed=1000.0) as (view, _, first):
        first.take(first.ended)
        late = Client(view.port)
        try:
            scenes = {"/scene/static", "/radio/coverage", "/aps/west/coverage", "/run/start"}
            begun = time.monotonic()
            late.take(lambda: scenes <= {topic for topic, _, _ in late.messages})
            assert time.monotonic() - begun < REPEAT_S + 3.0
        finally:
            late.close()


def test_pause_speed_and_seek():
    """A viewer halts the playback, goes to a time, sees what held then, and goes on from there."""
    with playing(speed=0.5) as (_, playback, client):
        client.take(lambda: client.last("/tf") is not None)
        client.ask(1, 0.5, None, "pause")
        client.take(lambda: client.answer("pause") is not None)
        status, held, speed, did_seek, _ = client.answer("pause")
        assert (status, speed, did_seek) == (PAUSED, 0.5, False)

        to = playback.span_ns[0] + 9 * SECOND
        expected = {m.topic: m.data for m in playback.last_before(to)}
        before = len(client.messages)
        client.ask(1, 2.0, to, "seek")
        client.take(lambda: client.answer("seek") is not None)
        assert client.answer("seek")[:4] == (PAUSED, to, 2.0, True)
        assert held < to
        client.take(lambda: {t for t, _, _ in client.messages[before:]} >= set(expected))
        for topic, data in expected.items():
            assert client.last(topic) == (to, data), topic

        client.ask(0, 50.0, None, "on")
        client.take(client.ended)
        times = [t for topic, t, _ in client.messages if topic == "/tf"]
        after = times[times.index(to) :]
        assert after == sorted(after)
        assert after[-1] == playback.span_ns[1]

        client.ask(0, 1.0, playback.span_ns[0], "again")  # back to the beginning, after the end
        client.take(lambda: client.answer("again") is not None)
        client.take(lambda: client.last("/tf")[0] < to)


def test_nonsense_from_a_client_is_passed_over():
    """Bytes and texts of no meaning do not stop the playback, and change nothing."""
    with playing(speed=20.0) as (_, _, client):
        client.take(lambda: bool(client.channels))
        for junk in (b"", b"\xff" * 40, b"\x03", b"\x01" + bytes(200), "{", '{"op":"advertise"}'):
            client.send(junk)
        client.take(client.ended)


# --- the command ----------------------------------------------------------------------------------


def test_a_run_is_shown_while_it_is_made_and_logged_alike(tmp_path):
    """`twin live -o` writes the log that `twin run` writes, byte for byte in its messages."""
    needs_server()
    (tmp_path / "hall.toml").write_text(HALL)
    plain = twin("run", tmp_path / "hall.toml", "-o", tmp_path / "out", "--json")
    assert plain.code == 0, plain.err
    told = twin(
        *("live", tmp_path / "hall.toml", "-o", tmp_path / "live.mcap"),
        *("--port", "0", "--speed", "2000", "--once"),
    )
    assert told.code == 0, told.err
    assert f"ws://{HOST}:" in told.err
    one, other = (logs.read(tmp_path / name) for name in ("out/run.mcap", "live.mcap"))
    assert list(one.iter_messages()) == list(other.iter_messages())


def test_a_log_is_replayed_to_its_end():
    """`--once` ends with the log; a port that is taken is refused with the remedy."""
    needs_server()
    assert twin("replay", log_of(), "--live", "--port", "0", "--speed", "2000", "--once").code == 0
    with socket.create_server((HOST, 0)) as taken:
        port = str(taken.getsockname()[1])
        told = twin("replay", log_of(), "--live", "--port", port, "--once")
        assert (told.code, "--port" in told.err) == (2, True)
    assert twin("replay", log_of()).code == 2


def test_without_the_extra_it_says_what_to_install(monkeypatch, tmp_path):
    """One sentence, before anything is computed."""
    real = builtins.__import__

    def without(name, *args, **kwargs):
        if name.split(".")[0] == "foxglove":
            raise ImportError(name)
        return real(name, *args, **kwargs)

    for name in [n for n in sys.modules if n.split(".")[0] == "foxglove"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(builtins, "__import__", without)
    told = twin("replay", log_of(), "--live")
    assert (told.code, "pip install 'mapp-twin[live]'" in told.err) == (2, True)
    with pytest.raises(TwinError, match="foxglove-sdk"):
        LiveView({}, (0, 1), Options(), seekable=False)
