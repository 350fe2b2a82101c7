"""What the tests of the wire protocol are made of: a host of their own, clients that are at its control socket, and links."""
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
import unittest

from fiona import control_pb2, wire_pb2
from fiona.test import test_pb2

import wire_client
from wire_client import Control, Link

BINARIES, LIBRARY = sys.argv[1:3]
OK, NOT_ACTIVE, REJECTED = 0, 6, 8
NEWEST, LAST, TIMED, LEASED, ECHO, ORDER, BELL = ("fiona.test." + name for name in (
    "SampleNewest", "SampleLast", "SampleTimed", "SampleLeased", "Echo", "Order", "Bell"))


class Host:
    """A real one, in a run-time directory of its own, or in that of another one."""

    def __init__(self, *arguments, name="far", beside=None, descriptors=None):
        self.directory = beside.directory if beside else tempfile.mkdtemp(prefix="fiona-wire-")
        self.is_guest = beside is not None
        self.name = name
        self.socket = "%s/fiona/%s.sock" % (self.directory, name)
        self.environment = dict(os.environ, XDG_RUNTIME_DIR=self.directory, FIONA_STORE=self.directory + "/store",
                                FIONA_KEYS=self.directory + "/keys", LC_ALL="C.UTF-8")
        ready, theirs = os.pipe()
        self.process = subprocess.Popen(
            [BINARIES + "/fiona-host", "--name", name, "--threads", "2", "--ready-fd", str(theirs), *arguments],
            pass_fds=[theirs], env=self.environment,
            preexec_fn=descriptors and (lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (descriptors, descriptors))))
        os.close(theirs)
        with os.fdopen(ready) as said:
            if not said.read().startswith("READY"):
                raise RuntimeError("the host did not start")

    def command(self, *arguments):
        return subprocess.run([BINARIES + "/fiona", *arguments], env=self.environment, capture_output=True, text=True,
                              timeout=60, check=True).stdout

    def console(self, line):
        return self.command("--host", self.name, line)

    def close(self, control):
        try:
            control.call(quit=control_pb2.Quit())
            control.close()
            return self.process.wait(timeout=60)
        finally:
            self.process.kill()
            self.process.wait()
            if not self.is_guest:
                shutil.rmtree(self.directory, ignore_errors=True)


class Recorded:
    """A link's socket that keeps the parts of what comes."""

    def __init__(self, socket):
        self.socket, self.messages = socket, []

    def __getattr__(self, name):
        return getattr(self.socket, name)

    def recv_multipart(self):
        self.messages.append(self.socket.recv_multipart())
        return self.messages[-1]


class Unproven(Link):
    """A connection on which nothing has been said yet."""

    def prove(self, *_):
        self.socket = Recorded(self.socket)


class WireProtocolCase(unittest.TestCase):
    descriptors = None  # at most, of the host

    def setUp(self):
        self.host = Host(descriptors=self.descriptors)
        self.addCleanup(self.stop)
        self.control, self.observer = (Control(self.host.socket) for _ in range(2))
        self.links = []

    def stop(self):
        for link in self.links:
            link.close()
        self.control.close()
        self.assertEqual(self.host.close(self.observer), 0)

    # ---- what the tests are made of

    def load(self, component, name, group="main", **parameters):
        load = control_pb2.Load(plugin=LIBRARY + "/" + component, instance=name, group=group)
        for key, value in parameters.items():
            load.parameters.add(name=key, value=self.value(value))
        self.change(load=load)

    @staticmethod
    def value(of):
        kind = "flag" if isinstance(of, bool) else "integer" if isinstance(of, int) else "number" if isinstance(of, float) else "text"
        return control_pb2.Value(**{kind: of})

    def change(self, **what):
        self.control.call(transact=control_pb2.Transact(changes=[control_pb2.Change(**what)]))

    def set(self, instance, **parameters):
        change = control_pb2.Set(instance=instance)
        for key, value in parameters.items():
            change.parameters.add(name=key, value=self.value(value))
        self.change(set=change)

    def state(self, instance, mode):
        self.change(state=control_pb2.State(instance=instance, mode=mode))

    def link(self, granted, kind=Link, **more):
        self.links.append(kind(granted, **more))
        return self.links[-1]

    def attach(self, provider, service, client="viewer", **more):
        """A wire on a link of its own, opened: (link, wire, from sequence)."""
        granted = self.control.attach(provider, client, service, **more)
        link = self.link(granted)
        return link, granted.wire, link.open(granted)

    def snapshot(self):
        return self.observer.call(snapshot=control_pb2.Snapshot()).system

    def port(self, name):
        instance, port = name.split(".")
        found = next(one for one in self.snapshot().instances if one.name == instance)
        return next(one for one in found.ports if one.name == port)

    def status(self, group="main"):
        return next(one for one in self.snapshot().groups if one.name == group)

    def eventually(self, fits, why):
        end = time.monotonic() + wire_client.PATIENCE_S
        while time.monotonic() < end:
            if fits():
                return
        self.fail(why)

    def next_object(self, link, wire):
        """The next object of a push: (sequence, sample, messages that were lost right before it)."""
        lost = 0
        while True:
            frame, data = link.next(wire)
            lost += frame.lost.messages
            if frame.HasField("object"):
                return frame.object.sequence, test_pb2.Sample.FromString(data), lost

    def next_of(self, link, wire, what):
        """The next frame of this kind, with its object's bytes; those before it are passed over."""
        while not (come := link.next(wire))[0].HasField(what):
            pass
        return come

    def ask(self, link, wire, number, **question):
        frame = wire_pb2.Frame(wire=wire, request=wire_pb2.Request(id=number))
        link.send(frame, test_pb2.Question(number=number, **question).SerializeToString())

    def answer(self, link, wire):
        frame, data = link.next(wire)
        self.assertEqual(frame.WhichOneof("what"), "answer")
        return frame.answer, data

    def fill(self, count):
        """A sink that works, with more orders sent than its queue holds: (link, wire, the sink's report, its wire)."""
        self.load("sink", "sink", "far", order_ms=20.0)
        link, wire, _ = self.attach("sink.orders", ORDER)
        seen, report, _ = self.attach("sink.report", LAST, client="witness")
        for number in range(1, count + 1):
            frame = wire_pb2.Frame(wire=wire, object=wire_pb2.Object(sequence=number))
            link.send(frame, test_pb2.Sample(number=number, payload=bytes(100_000)).SerializeToString())
        return link, wire, seen, report


def run():
    unittest.main(argv=sys.argv[:1] + sys.argv[3:], verbosity=2)
