#!/usr/bin/env python3
"""Promise R23: what is malformed does no harm, on each kind of socket that others reach: the consoles' socket, the links of
the host and of a group, before and after the handshake, and the port for other hosts, without a key and with one.

    malformed_frames_test.py BIN_DIR COMPONENTS_LIBRARY [--sanitized]

FIONA_FRAMES sets how many frames each socket gets, FIONA_SEED which. Meanwhile a group's messages go to the host as before.
"""
import os
import random
import re
import select
import socket
import struct
import sys
import time
import warnings

os.environ["PROTOCOL_BUFFERS_PYTHON_IMPLEMENTATION"] = "python"  # which says nothing of what it cannot parse
warnings.simplefilter("ignore")

import zmq
from google.protobuf.message import DecodeError
from zmq.utils import z85

from fiona import control_pb2, wire_pb2

import wire_client
from wire_client import Control, Link
from whole_system import WholeSystem, descriptors, resident_kib

VARIANTS = 2000
BATCH = 200
PIECES = 20         # of a handshake, on a connection
BROKEN_EVERY = 500   # of the frames, one connection breaks ZeroMQ's own protocol
MOST_KIB = 8 * 1024
MOST_LINES_A_S = 10
MORE_MS = 5          # of the p99 of a peer that is well
HELD_UP_MS = 250     # the same in short runs, which other tests run beside
FULL = 1_000_000
HARMLESS = {None, "journal", "snapshot", "describe", "read", "detach", "unwatch"}


# ---- what is sent

class Malformed:
    """Variants of what a peer or console says, each broken in one of the ways that the promise lists."""

    def __init__(self, seed):
        self.random = random.Random(seed)

    def mutated(self, data):
        data = bytearray(data)
        for _ in range(self.random.randint(1, 4)):
            kind, at = self.random.randrange(5), self.random.randrange(len(data) + 1)
            if kind == 0 and at < len(data):
                data[at] ^= 1 << self.random.randrange(8)
            elif kind == 1:
                del data[at:]
            elif kind == 2:
                data[at:at] = self.random.randbytes(self.random.randrange(1, 9))
            elif kind == 3:
                data[at:at + 8] = struct.pack("<Q", self.random.choice((2**63, 2**64 - 1, 2**31, 2**32 - 1)))
            else:
                data[at:at] = data[at // 2:at]
        return bytes(data)

    def nested(self):
        """An object within itself, a hundred deep and more."""
        inside = b""
        for _ in range(self.random.choice((50, 101, 2000))):
            inside = b"\x52" + wire_varint(len(inside)) + inside
        return inside

    def record(self, wire=0, token=b""):
        """One for a link, behind the two lengths that a record has."""
        choose = self.random.choice
        wire = choose((0, wire, wire + 1, 2**63, 2**64 - 1))
        data = self.random.randbytes(self.random.randrange(40))
        frame = choose((
            wire_pb2.Frame(hello=wire_pb2.Hello(version=choose((1, 0, 7)), client="viewer", nonce=data)),
            wire_pb2.Frame(proof=wire_pb2.Proof(client="viewer", nonce=b"n" * 16, proof=data)),  # replayed
            wire_pb2.Frame(wire=wire, open=wire_pb2.Open(version=1, token=choose((token, data)))),
            wire_pb2.Frame(wire=wire, object=wire_pb2.Object(sequence=2**64 - 1, origin_ns=-2**63)),
            wire_pb2.Frame(wire=wire, also=[wire] * 50, size=choose((1, 2**40, 2**64 - 1)), lane=2**63, object=wire_pb2.Object()),
            wire_pb2.Frame(wire=wire, request=wire_pb2.Request(id=2**64 - 1)),
            wire_pb2.Frame(wire=wire, more=wire_pb2.More()),
            wire_pb2.Frame(credit=wire_pb2.Credit(lane=[1, 2, 3], bytes=[2**64 - 1])),
            wire_pb2.Frame(wire=wire, cancel=wire_pb2.Cancel(id=5)), wire_pb2.Frame(wire=wire, fired=wire_pb2.Fired(id=5)),
            wire_pb2.Frame(challenge=wire_pb2.Challenge(nonce=data, proof=data)), wire_pb2.Frame(wire=wire, room=wire_pb2.Room(bytes=2**63)),
            wire_pb2.Frame(host=wire_pb2.HostFrame())))
        whole = wire_client.record(frame, data)
        kind = self.random.randrange(4)
        if kind == 0:
            return whole
        if kind == 1:
            return struct.pack("<II", *(choose((0, 9, 2**31, 2**32 - 1)) for _ in range(2))) + whole[8:]
        if kind == 2:
            return struct.pack("<II", len(nest := self.nested()), 0) + nest
        return self.mutated(whole)

    def request(self):
        """One for the consoles' socket, that no host takes for a change of its system."""
        while True:
            text = self.mutated(control_pb2.Request(id=7, author="storm", snapshot=control_pb2.Snapshot()).SerializeToString())
            if self.random.randrange(4) == 0:
                text = self.nested()
            known = False
            try:
                known = control_pb2.Request.FromString(text).WhichOneof("what") in HARMLESS
            except (DecodeError, RecursionError, UnicodeDecodeError):
                known = True
            if known:
                break
        length = self.random.choice((len(text), len(text), len(text), 2**31, 2**32 - 1, 0, len(text) // 2))
        return struct.pack("<I", length) + text


def wire_varint(number):
    out = bytearray()
    while number > 127:
        out.append(number & 127 | 128)
        number >>= 7
    return bytes(out) + bytes([number])


def zmtp_frame(body, more=False):
    return struct.pack(">BQ", 2 | more, len(body)) + body if len(body) > 255 else struct.pack(">BB", int(more), len(body)) + body


GREETING = b"\xff" + bytes(8) + b"\x7f\x03\x00" + b"NULL".ljust(20, b"\0") + bytes(32)
READY = b"\x05READY\x0bSocket-Type" + struct.pack(">I", 6) + b"DEALER"
BROKEN = (b"GET / HTTP/1.1\r\n\r\n", b"\x01\x00old", b"\xff" + bytes(7) + b"\x01\x7f\x01", bytes(500), b"\xff" * 500,
          GREETING.replace(b"NULL", b"PLAIN"), GREETING + b"\x06" + b"\xff" * 8, GREETING + struct.pack(">BQ", 2, 2**63),
          GREETING + b"\x04" + bytes([len(READY)]) + READY + struct.pack(">BQ", 2, 2**63),
          GREETING + b"\x04" + bytes([len(READY)]) + READY + b"\xf8\x01x")


# ---- how it is sent

class Stream:
    """A connection by hand, whose answers are read away; opened anew when the other side has closed it."""

    def __init__(self, connect):
        self.connect, self.socket, self.opened = connect, None, 0

    def send(self, data):
        if self.socket is None:
            self.socket, self.opened = self.connect(), self.opened + 1
            self.socket.setblocking(False)
        view, limit = memoryview(data), time.monotonic() + 30
        while view:
            readable, writable, _ = select.select([self.socket], [self.socket], [], 1)
            if time.monotonic() > limit:
                raise AssertionError("the host does not read for 30 s")
            try:
                if readable and not self.socket.recv(1 << 16):
                    return self.close()
                if writable:
                    view = view[self.socket.send(view):]
            except (BrokenPipeError, ConnectionResetError):
                return self.close()

    def close(self):
        if self.socket:
            self.socket.close()
        self.socket = None


def unix(path):
    def connect():
        one = socket.socket(socket.AF_UNIX)
        one.connect(path)  # waits while many do
        return one
    return connect


def tcp(port):
    return lambda: socket.create_connection(("127.0.0.1", port), 10)


def shaken(connect):
    """Behind ZeroMQ's own handshake."""
    def begun():
        one = connect()
        one.settimeout(30)
        one.sendall(GREETING + b"\x04" + bytes([len(READY)]) + READY)
        come = 0
        while come <= len(GREETING):  # its READY is behind its greeting
            come += len(one.recv(4096)) or sys.exit("the host has closed the connection amid the handshake")
        return one
    return begun


def storm_console(path, count, broken):
    stream, variants = Stream(unix(path)), [broken.request() for _ in range(VARIANTS)]
    for number in range(count):
        stream.send(variants[number % VARIANTS])
        if number % 50 == 49:
            stream.close()  # one whose length is above what follows waits for the rest
    stream.close()
    return stream.opened


def storm_link(connect, count, broken):
    """Of who has no key: ZeroMQ's handshake alone is done."""
    stream = Stream(shaken(connect))
    variants = [zmtp_frame(broken.record()) for _ in range(VARIANTS)]
    variants[7] = b"".join(zmtp_frame(b"part", more=True) for _ in range(999)) + zmtp_frame(b"last")
    for number in range(0, count, BATCH):
        stream.send(b"".join(broken.random.choices(variants, k=BATCH)))
        if number % BROKEN_EVERY < BATCH:
            other = Stream(connect)
            other.send(broken.random.choice(BROKEN))
            other.close()
    stream.close()


def storm_port(connect, count, broken):
    """Of who has no key, where one is asked for: pieces of the handshake that shows it, until the other side has enough."""
    hello = b"\x05HELLO\x01\x00" + bytes(72) + broken.random.randbytes(32) + bytes(8) + broken.random.randbytes(80)
    curve = GREETING.replace(b"NULL\0", b"CURVE")
    variants = [b"\x04" + bytes([len(one)]) + one for one in ((hello if n % 9 == 0 else broken.mutated(hello))[:255] for n in range(VARIANTS))]
    for number in range(0, count, PIECES):
        one = Stream(connect)
        start = (curve, curve, GREETING, broken.random.choice(BROKEN))[number // PIECES % 4]
        one.send(start + b"".join(broken.random.choices(variants, k=PIECES)))
        one.close()


def storm_socket(zmq_socket, count, broken, wire=0, token=b""):
    """Of who is let in."""
    variants = [broken.record(wire, token) for _ in range(VARIANTS)]
    for number in range(count):
        one = variants[number % VARIANTS]
        parts = [one] if number % 7 else [one, b"x"] if number % 1001 else [b"part"] * 1000
        if not zmq_socket.poll(30_000, zmq.POLLOUT):
            raise AssertionError("the host does not read for 30 s")
        zmq_socket.send_multipart(parts)
        while zmq_socket.poll(0):
            zmq_socket.recv_multipart()


# ---- what must hold meanwhile

class Sight:
    """A system, and what a storm does to it."""

    def __init__(self, system, sanitized, full):
        self.system, self.sanitized = system, sanitized
        self.more_ms = MORE_MS if full else HELD_UP_MS
        self.observer = Control(system.directory + "/run/fiona/main.sock")
        self.host = system.host()
        self.group = self.status("there").process
        self.system.eventually("messages come", lambda: self.heard().messages > 200)
        self.calm_ms = self.heard().latency_p99_ms

    def status(self, group):
        snapshot = self.observer.call(snapshot=control_pb2.Snapshot()).system
        return next(one for one in snapshot.groups if one.name == group)

    def heard(self):
        snapshot = self.observer.call(snapshot=control_pb2.Snapshot()).system
        return next(port for one in snapshot.instances if one.name == "listener" for port in one.ports if port.name == "samples")

    def refused(self):
        links = [self.status(group).links for group in ("main", "there")]
        return sum(one.garbled + one.unproven + one.not_granted for one in links)

    def through(self, name, count, storm):
        before, refused, lines, heard = self.held(), self.refused(), len(self.system.words().split("\n")), self.heard()
        began = time.monotonic()
        storm()
        took_s = time.monotonic() - began
        self.system.eventually("all that it has opened is closed", lambda: self.held()[1] <= before[1] + 2)
        after, now = self.held(), self.heard()
        said = len(self.system.words().split("\n")) - lines
        grown = after[0] - before[0]
        print("%-34s %8d frames, %7.0f a second; refused %8d; lines %3d; memory %+5d KiB; a peer's messages p99 %.1f ms" % (
            name, count, count / took_s, self.refused() - refused, said, grown, now.latency_p99_ms), flush=True)
        assert self.system.host() == self.host and self.status("there").process == self.group, self.system.words()
        assert now.messages > heard.messages and now.dropped == heard.dropped, "the peer that is well has lost something"
        assert now.connection == heard.connection
        assert now.latency_p99_ms <= self.calm_ms + self.more_ms, "%.1f ms, in calm %.1f" % (now.latency_p99_ms, self.calm_ms)
        assert said <= MOST_LINES_A_S * max(took_s, 1) + 1, self.system.words()
        assert self.sanitized or grown <= MOST_KIB, "memory has grown by %d KiB" % grown
        return self.refused() - refused

    def held(self):
        processes = self.host, self.group
        return sum(map(resident_kib, processes)), sum(map(descriptors, processes))


def main():
    binaries, library = sys.argv[1:3]
    count = int(os.environ.get("FIONA_FRAMES", "6000"))
    seed = int(os.environ.get("FIONA_SEED", time.time_ns() % 1_000_000))
    print("%d frames a socket, FIONA_SEED=%d" % (count, seed))
    broken = Malformed(seed)
    with WholeSystem(binaries) as system:
        system.run("fiona", "keys", "make", "-q")
        key = system.run("fiona", "keys", "show").strip()
        system.run("fiona", "keys", "allow", "stranger", key)
        system.stop()
        system.start("--listen", "127.0.0.1:0")
        for line in ('load "%s/source" as source in there period_ms=5' % library, 'load "%s/listener" as listener' % library,
                     'load "%s/source" as near' % library, "wire listener.samples to source.newest"):
            system.line(line)
        sight = Sight(system, "--sanitized" in sys.argv, count >= FULL)
        socket_path = system.directory + "/run/fiona/main.sock"
        port = int(re.search(r"tcp://127\.0\.0\.1:(\d+)", system.words()).group(1))
        console = Control(socket_path)

        console_storm = console_refusal(socket_path)
        assert "is no request" in console_storm.what and console_storm.next and console_storm.found, console_storm
        sight.through("consoles' socket", count, lambda: storm_console(socket_path, count, broken))
        assert "a console was refused" in system.words(), system.words()
        for provider, name in (("near.newest", "link of the host"), ("source.newest", "link of a group")):
            granted = console.attach(provider, "viewer", "fiona.test.SampleNewest")
            path = granted.endpoint.removeprefix("ipc://")
            refused = sight.through(name + ", unknown", count, lambda: storm_link(unix(path), count, broken))
            assert refused > count / 4, "refused and not counted"
            link = Link(granted)
            refused = sight.through(name + ", proven", count,
                                    lambda: storm_socket(link.socket, count, broken, granted.wire, granted.token))
            assert refused > count / 4, "refused and not counted"
            link.close()
        sight.through("tcp port, without a key", count, lambda: storm_port(tcp(port), count, broken))
        let_in = with_key(system, port, key)
        sight.through("tcp port, with a key", count, lambda: storm_socket(let_in, count, broken))
        let_in.close()
        assert system.line("ls")


def console_refusal(path):
    """What is said to who sends no request."""
    one = Control(path)
    one.socket.sendall(struct.pack("<I", 3) + b"\xff\xff\xff")
    reply = control_pb2.Reply.FromString(one.take(struct.unpack("<I", one.take(4))[0]))
    one.close()
    return reply.failure


def with_key(system, port, key):
    """A socket whose key is in the host's list: that of the user's own pair."""
    with open(system.directory + "/home/.config/fiona/host.key", encoding="ascii") as file:
        secret = file.read().split()[-1]
    one = zmq.Context.instance().socket(zmq.DEALER)
    one.linger = 0
    one.curve_publickey, one.curve_secretkey, one.curve_serverkey = (z85.encode(bytes.fromhex(text)) for text in (key, secret, key))
    one.connect("tcp://127.0.0.1:%d" % port)
    return one


if __name__ == "__main__":
    main()
