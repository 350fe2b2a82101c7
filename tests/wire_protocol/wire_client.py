"""A client of the wire protocol as docs/wire-protocol.md has it, which shares no code with the host.

    control = Control("/run/user/1000/fiona/main.sock")
    granted = control.attach("phone.truth", "viewer", "fiona.localisation.LocationProvider")
    link = Link(granted)
    link.open(granted)
    frame, data = link.next(granted.wire)
"""
import collections
import hashlib
import os
import socket
import struct

import zmq

from fiona import control_pb2, wire_pb2

VERSION = 1
NONCE = 16
CHUNK = 256 * 1024
INLINE = 16 * 1024
LARGEST = 64 * 1024 * 1024
WINDOW = 4 * 1024 * 1024
PORTION = WINDOW // 8
LANES_OWED = 16
FRAME_COST = 64
PATIENCE_S = 10


class Refused(Exception):
    """The other side has said no, and why."""


def keyed_hash(key, *pieces):
    """BLAKE2b-256 of three pieces, each behind its length and a colon; one that is not there is empty."""
    listed = (pieces + (b"", b""))[:3]
    text = b"".join(b"%d:%s" % (len(piece), piece) for piece in listed)
    return hashlib.blake2b(text, digest_size=32, key=key).digest()


def record(frame, inside=b""):
    text = frame.SerializeToString()
    return struct.pack("<II", len(text), len(inside)) + text + inside


def port_name(text):
    instance, port = text.split(".", 1)
    return control_pb2.PortName(instance=instance, port=port)


class Control:
    """The connection that holds what has been attached."""

    def __init__(self, path):
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.socket.settimeout(PATIENCE_S)
        self.socket.connect(path)
        self.read = b""
        self.asked = 0
        self.others = collections.defaultdict(collections.deque)  # replies that nobody has asked for yet, by id

    def call(self, **what):
        """Makes a request and returns its reply; raises Refused with the failure's sentence."""
        self.asked += 1
        self.send(self.asked, **what)
        reply = self.reply_to(self.asked)
        if reply.HasField("failure"):
            raise Refused(reply.failure.what)
        return reply

    def send(self, number, **what):
        request = control_pb2.Request(id=number, author="wire client", **what).SerializeToString()
        self.socket.sendall(struct.pack("<I", len(request)) + request)

    def reply_to(self, asked):
        while not self.others[asked]:
            reply = control_pb2.Reply.FromString(self.take(struct.unpack("<I", self.take(4))[0]))
            self.others[reply.id].append(reply)
        return self.others[asked].popleft()

    def take(self, size):
        while len(self.read) < size:
            more = self.socket.recv(1 << 16)
            if not more:
                raise Refused("the host has closed the connection")
            self.read += more
        taken, self.read = self.read[:size], self.read[size:]
        return taken

    def attach(self, provider, client, service, **more):
        asked = control_pb2.Attach(provider=port_name(provider), client=client, service=service, **more)
        return self.call(attach=asked).attached

    def detach(self, wire):
        self.call(detach=control_pb2.Detach(wire=wire))

    def close(self):
        self.socket.close()


class Link:
    """The link to one provider's process, for all wires that `granted` the same peer and endpoint."""

    def __init__(self, granted, version=VERSION, key=None, trusting=False):
        self.socket = zmq.Context.instance().socket(zmq.DEALER)
        self.socket.linger = 0
        self.socket.reconnect_ivl = -1  # a new connection would have to begin with Hello
        self.socket.rcvhwm = 0          # what comes is bounded by the credit that is given for it
        self.socket.connect(granted.endpoint)
        self.peer = granted.peer
        self.frames = collections.defaultdict(collections.deque)  # by wire: (frame, data)
        self.in_flight = collections.Counter()                    # by lane of ours: sent and not credited
        self.owed = collections.Counter()                         # by lane of theirs: come and not credited
        self.pays = True
        self.assemblies = {}
        self.messages = 0
        self.prove(version, key or granted.key, trusting)

    def close(self):
        self.socket.close()

    def prove(self, version, key, trusting):
        nonce = os.urandom(NONCE)
        self.send(wire_pb2.Frame(hello=wire_pb2.Hello(version=version, client=self.peer, nonce=nonce)))
        frame, _ = self.next(0)
        if frame.HasField("refused"):
            raise Refused(frame.refused.reason)
        challenge = frame.challenge
        if challenge.proof != keyed_hash(key, b"provider", nonce, challenge.nonce) and not trusting:
            raise Refused("the provider does not know the key")
        proof = keyed_hash(key, b"client", nonce, challenge.nonce)
        self.send(wire_pb2.Frame(proof=wire_pb2.Proof(client=self.peer, nonce=nonce, proof=proof)))

    def open(self, granted, version=VERSION, token=None, each=False):
        """Opens a wire, with `each` as one that answers `Room`; returns the sequence number after which everything comes."""
        opening = wire_pb2.Open(version=version, token=token or granted.token, each=each)
        self.send(wire_pb2.Frame(wire=granted.wire, open=opening))
        frame, _ = self.next(granted.wire)
        if frame.HasField("refused"):
            raise Refused(frame.refused.reason)
        if not frame.HasField("opened"):
            raise Refused("not opened, but: %s" % frame)
        return frame.opened.from_sequence

    # ---- sending

    def send(self, frame, data=None):
        """A frame, and the object behind it; waits for credit. Each wire sends in one lane, of its own number."""
        if data is None:
            return self.put(frame, b"")
        if len(data) > LARGEST:
            raise ValueError("larger than a link carries")
        cost = len(data) + FRAME_COST
        frame.lane = frame.wire
        while self.in_flight[frame.lane] >= PORTION and self.in_flight[frame.lane] + cost > WINDOW:
            self.receive(PATIENCE_S)
        self.in_flight[frame.lane] += cost
        if len(data) > CHUNK:
            frame.size = len(data)
        self.put(frame, data[:CHUNK])
        for begin in range(CHUNK, len(data), CHUNK):
            self.put(wire_pb2.Frame(wire=frame.wire, more=wire_pb2.More()), data[begin:begin + CHUNK])

    def put(self, frame, data):
        inside = len(data) <= INLINE
        self.socket.send_multipart([record(frame, data)] if inside else [record(frame), data])

    # ---- receiving

    def next(self, wire, within_s=PATIENCE_S):
        """The next frame of a wire (0: of the link), with the object's bytes."""
        while not self.frames[wire]:
            self.receive(within_s)
        return self.frames[wire].popleft()

    def receive(self, within_s):
        """One message of ZeroMQ; raises TimeoutError when none comes."""
        if not self.socket.poll(int(1000 * within_s)):
            raise TimeoutError("nothing has come for %g s" % within_s)
        parts = self.socket.recv_multipart()
        self.messages += 1
        rest = parts[0]
        while rest:
            frame_size, inside_size = struct.unpack_from("<II", rest)
            frame = wire_pb2.Frame.FromString(rest[8:8 + frame_size])
            inside = rest[8 + frame_size:8 + frame_size + inside_size]
            rest = rest[8 + frame_size + inside_size:]
            self.take(frame, inside + (parts[1] if not rest and len(parts) == 2 else b""))

    def take(self, frame, piece):
        if frame.HasField("more"):
            if frame.wire not in self.assemblies:
                return
            frame, pieces = self.assemblies[frame.wire]
            pieces.append(piece)
        elif frame.size > len(piece):
            pieces = [piece]
            self.assemblies[frame.wire] = (frame, pieces)
        else:
            return self.deliver(frame, piece)
        if sum(map(len, pieces)) == frame.size:
            del self.assemblies[frame.wire]
            self.deliver(frame, b"".join(pieces))

    def deliver(self, frame, data):
        if frame.HasField("credit"):
            for lane, size in zip(frame.credit.lane, frame.credit.bytes):
                self.in_flight[lane] -= size
            return
        for wire in [frame.wire, *frame.also]:
            self.frames[wire].append((frame, data))
        if frame.lane:
            self.owed[frame.lane] += len(data) + FRAME_COST
            self.pay()

    def pay(self):
        """Gives credit, in portions."""
        if not self.pays or (sum(self.owed.values()) < PORTION and len(self.owed) <= LANES_OWED):
            return
        self.send(wire_pb2.Frame(credit=wire_pb2.Credit(lane=self.owed.keys(), bytes=self.owed.values())))
        self.owed.clear()
