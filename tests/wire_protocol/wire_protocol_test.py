#!/usr/bin/env python3
"""docs/wire-protocol.md, held against a real host by a client that shares no code with it.

    wire_protocol_test.py BIN_DIR COMPONENTS_LIBRARY [TEST...]
"""
import os
import resource
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import time
import unittest

from fiona import control_pb2, wire_pb2
from fiona.test import test_pb2

import wire_client
from wire_client import Control, Link, Refused

SPECIFICATION = os.path.join(os.path.dirname(os.path.abspath(__file__)), "../../docs/wire-protocol.md")
BINARIES = ""
LIBRARY = ""
OK, DISCONNECTED, NOT_ACTIVE, REJECTED = 0, 4, 6, 8
NEWEST, LAST, LEASED, ECHO, ORDER, BELL = ("fiona.test." + name for name in (
    "SampleNewest", "SampleLast", "SampleLeased", "Echo", "Order", "Bell"))


class Host:
    """A real one, in a directory of its own."""

    def __init__(self, descriptors=None):
        self.directory = tempfile.mkdtemp(prefix="fiona-wire-")
        os.mkdir(self.directory + "/fiona", 0o700)
        self.socket = self.directory + "/fiona/far.sock"
        ready, theirs = os.pipe()
        self.process = subprocess.Popen(
            [BINARIES + "/fiona-host", "--name", "far", "--socket", self.socket, "--store", self.directory + "/store",
             "--threads", "2", "--ready-fd", str(theirs)], pass_fds=[theirs],
            preexec_fn=descriptors and (lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (descriptors, descriptors))))
        os.close(theirs)
        with os.fdopen(ready) as said:
            if not said.read().startswith("READY"):
                raise RuntimeError("the host did not start")

    def console(self, line):
        environment = dict(os.environ, XDG_RUNTIME_DIR=self.directory, FIONA_STORE=self.directory + "/store", LC_ALL="C.UTF-8")
        return subprocess.run([BINARIES + "/fiona", "--host", "far", line], env=environment, capture_output=True,
                              text=True, timeout=60, check=True).stdout

    def close(self, control):
        try:
            control.call(quit=control_pb2.Quit())
            control.close()
            return self.process.wait(timeout=60)
        finally:
            self.process.kill()
            self.process.wait()
            shutil.rmtree(self.directory, ignore_errors=True)


class Specification(unittest.TestCase):
    def test_its_examples_are_what_this_client_computes(self):
        with open(SPECIFICATION, encoding="utf-8") as file:
            text = file.read()
        key = wire_client.keyed_hash(bytes(range(32)), b"fiona link", b"viewer")
        nonces = b"c" * 16, b"p" * 16
        frame = wire_pb2.Frame(wire=7, lane=7, object=wire_pb2.Object(sequence=1, origin_ns=2))
        for example in (key.hex(), wire_client.keyed_hash(key, b"provider", *nonces).hex(),
                        wire_client.keyed_hash(key, b"client", *nonces).hex()):
            self.assertIn(example, text)
        self.assertIn(wire_client.record(frame, b"\x08\x01").hex(), text.replace(" ", ""))


class WireProtocolCase(unittest.TestCase):
    descriptors = None  # at most, of the host

    def setUp(self):
        self.host = Host(self.descriptors)
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

    def link(self, granted, **more):
        self.links.append(Link(granted, **more))
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


class WireProtocol(WireProtocolCase):
    # ---- push

    def test_a_push_sends_everything_after_the_sequence_that_opened_names(self):
        for group in ("main", "far"):
            self.load("source", "src-" + group, group, period_ms=0.5)
            link, wire, start = self.attach("src-%s.newest" % group, NEWEST)
            for sequence in range(start + 1, start + 501):
                self.assertEqual(self.next_object(link, wire)[0::2], (sequence, 0))

    def test_two_wires_of_a_link_to_one_port_share_what_crosses(self):
        self.load("source", "src", period_ms=1.0)
        granted = [self.control.attach("src.newest", "viewer", NEWEST) for _ in range(2)]
        self.assertEqual(granted[0].key, granted[1].key)
        link = self.link(granted[0])
        for one in granted:
            link.open(one)
        frame = next(frame for frame in iter(lambda: link.next(granted[0].wire)[0], None) if frame.also)
        self.assertCountEqual([frame.wire, *frame.also], [one.wire for one in granted])
        self.assertIs(next(f for f in iter(lambda: link.next(granted[1].wire)[0], None) if f.also), frame)

    def test_every_third_message_comes_where_that_was_asked_for(self):
        self.load("source", "src", period_ms=0.5)
        link, wire, start = self.attach("src.newest", NEWEST, prescale=3)
        for sequence in range(start + 1, start + 300, 3):
            self.assertEqual(self.next_object(link, wire)[0], sequence)

    def test_a_new_subscriber_gets_the_last_value_where_the_service_keeps_one(self):
        self.load("source", "src", period_ms=1.0, count=5)
        self.eventually(lambda: self.port("src.last").messages == 5, "the source has not put five samples")
        link, wire, start = self.attach("src.last", LAST)
        self.assertEqual(start, 5)
        sequence, sample, _ = self.next_object(link, wire)
        self.assertEqual((sequence, sample.number), (5, 5))

    def test_a_client_is_told_when_a_provider_has_been_silent_for_longer_than_its_lease(self):
        self.load("source", "src", period_ms=1.0, count=3)
        link, wire, _ = self.attach("src.leased", LEASED)
        while not (frame := link.next(wire)[0]).HasField("lease"):
            pass
        self.assertFalse(frame.lease.held)
        self.assertEqual(frame.lease.reason, "has been silent for 100 ms")

    def test_a_stream_of_large_objects_goes_on_while_credit_is_given(self):
        size = 1_500_000  # two chunks
        count = 3 * wire_client.WINDOW // size
        self.load("source", "src", "far", period_ms=40.0, payload=size)
        link, wire, last = self.attach("src.newest", NEWEST)
        for _ in range(count):
            sequence, sample, lost = self.next_object(link, wire)
            # Where this program has stood still for some of its periods the provider has not waited, and says so.
            self.assertEqual((sequence, len(sample.payload)), (last + lost + 1, size))
            last = sequence
        self.assertGreaterEqual(link.messages, 2 * count)

    def test_without_credit_one_window_comes_and_what_is_lost_then_is_told_exactly(self):
        self.load("source", "src", period_ms=0.2, payload=100_000)
        granted = self.control.attach("src.newest", "viewer", NEWEST)
        link = self.link(granted)
        link.pays = False
        last = link.open(granted)
        frame, data = link.next(granted.wire)
        most = wire_client.WINDOW // (len(data) + wire_client.FRAME_COST)
        self.eventually(lambda: self.port("src.newest").dropped > 0, "the provider never ran out of credit")
        for last in range(last + 2, last + most + 1):
            self.assertEqual(self.next_object(link, granted.wire)[0], last)
        with self.assertRaises(TimeoutError):
            link.receive(0.05)
        link.pays = True
        link.pay()
        lost_in_all = 0
        for _ in range(3 * most):
            sequence, _, lost = self.next_object(link, granted.wire)
            self.assertEqual(sequence, last + lost + 1)
            last = sequence
            lost_in_all += lost
        self.assertGreater(lost_in_all, 0)

    def test_a_provider_that_waits_asks_each_client_that_answers_for_room_and_puts_what_fits(self):
        self.load("pourer", "pourer")
        granted = self.control.attach("pourer.samples", "viewer", NEWEST)
        link = self.link(granted)
        link.open(granted, each=True)
        other, others, _ = self.attach("pourer.samples", NEWEST, client="other")  # which does not say that it answers
        count = control_pb2.Set(instance="pourer")
        count.parameters.add(name="count", value=self.value(7))
        count.parameters.add(name="payload", value=self.value(1000))
        self.change(set=count)
        for mode in ("neutral", "active"):
            self.change(state=control_pb2.State(instance="pourer", mode=mode))
        come, cost = 0, 0
        for room in (1, 3, 3):  # messages
            frame, _ = link.next(granted.wire)
            self.assertEqual(frame.WhichOneof("what"), "room")
            self.assertGreater(frame.room.bytes, 1000 + 256)
            self.assertIn(cost, (0, frame.room.bytes))
            cost = frame.room.bytes
            with self.assertRaises(TimeoutError):
                link.receive(0.05)
            link.send(wire_pb2.Frame(wire=granted.wire, room=wire_pb2.Room(bytes=room * cost)))
            for come in range(come + 1, come + room + 1):
                frame, data = link.next(granted.wire)
                self.assertEqual((frame.object.sequence, len(data) + 256), (come, cost))
        for sequence in range(1, come + 1):
            self.assertEqual(other.next(others)[0].object.sequence, sequence)

    # ---- query, send, event

    def test_an_id_that_is_open_already_is_not_taken_for_another_request(self):
        self.load("answerer", "oracle")
        link, wire, _ = self.attach("oracle.echo", ECHO)
        self.ask(link, wire, 1, manner="later", payload=b"first")
        self.ask(link, wire, 1, payload=b"second")
        answer, data = self.answer(link, wire)
        self.assertEqual((answer.id, test_pb2.Reply.FromString(data).payload), (1, b"first"))
        self.assertEqual(self.port("oracle.echo").refused, 1)
        self.ask(link, wire, 2)
        self.assertEqual(self.answer(link, wire)[0].id, 2)

    def test_each_question_has_one_outcome(self):
        self.load("answerer", "oracle", "far")
        link, wire, start = self.attach("oracle.echo", ECHO)
        self.assertEqual(start, 0)
        manners = ["", "later", "drop", "error", "", "later"]
        for number, manner in enumerate(manners, 1):
            self.ask(link, wire, number, manner=manner)
        outcomes = {}
        for _ in manners:
            answer, data = self.answer(link, wire)
            self.assertNotIn(answer.id, outcomes)
            outcomes[answer.id] = answer.outcome
            if answer.outcome == OK:
                self.assertEqual(test_pb2.Reply.FromString(data).number, answer.id)
            else:
                self.assertTrue(answer.reason)
        self.assertEqual(outcomes, {1: OK, 2: OK, 3: REJECTED, 4: REJECTED, 5: OK, 6: OK})
        with self.assertRaises(TimeoutError):
            link.receive(0.1)

    def test_large_questions_and_answers_cross_in_chunks_within_the_credit_of_both_sides(self):
        self.load("answerer", "oracle", "far")
        link, wire, _ = self.attach("oracle.echo", ECHO)
        payload = os.urandom(3_000_000)
        for number in range(1, 6):
            self.ask(link, wire, number, payload=payload)
            answer, data = self.answer(link, wire)
            self.assertEqual((answer.id, answer.outcome), (number, OK))
            self.assertEqual(test_pb2.Reply.FromString(data).payload, payload)
        largest = os.urandom(wire_client.LARGEST - 100)
        self.ask(link, wire, 6, payload=largest)
        self.assertEqual(test_pb2.Reply.FromString(self.answer(link, wire)[1]).payload, largest)

    def test_a_cancelled_question_is_not_answered(self):
        self.load("answerer", "oracle")
        link, wire, _ = self.attach("oracle.echo", ECHO)
        self.ask(link, wire, 1, manner="never")
        link.send(wire_pb2.Frame(wire=wire, cancel=wire_pb2.Cancel(id=1)))
        self.ask(link, wire, 2)
        self.assertEqual(self.answer(link, wire)[0].id, 2)

    def test_a_provider_that_is_not_active_and_one_that_is_asked_nonsense_say_so(self):
        self.load("answerer", "oracle")
        link, wire, _ = self.attach("oracle.echo", ECHO)
        link.send(wire_pb2.Frame(wire=wire, request=wire_pb2.Request(id=1)), b"\xff\xff")
        answer, _ = self.answer(link, wire)
        self.assertEqual((answer.outcome, answer.reason), (REJECTED, "the object does not parse"))
        self.change(state=control_pb2.State(instance="oracle", mode="neutral"))
        self.ask(link, wire, 2)
        answer, _ = self.answer(link, wire)
        self.assertEqual((answer.outcome, answer.reason), (NOT_ACTIVE, "mode neutral"))

    def test_what_is_sent_and_acknowledged_arrives_and_what_is_refused_does_not(self):
        self.load("sink", "sink", "far")
        link, wire, _ = self.attach("sink.orders", ORDER)
        seen, report, _ = self.attach("sink.report", LAST, client="witness")
        payload = bytes(100_000)
        for number in range(1, 101):  # more than two windows, at the pace of the credit
            frame = wire_pb2.Frame(wire=wire, request=wire_pb2.Request(id=number))
            sample = test_pb2.Sample(number=number, value=1e10 if number % 10 == 0 else 0.0, payload=payload)
            link.send(frame, sample.SerializeToString())
        taken = []
        for number in range(1, 101):
            answer, _ = self.answer(link, wire)
            self.assertEqual(answer.id, number)
            if answer.outcome == OK:
                taken.append(number)
            elif number % 10 == 0:
                self.assertEqual(answer.outcome, REJECTED)
                self.assertIn("value", answer.reason)
            else:
                self.assertEqual((answer.outcome, answer.reason), (REJECTED, "the provider's queue is full"))
        self.assertGreater(len(taken), 20)
        self.assertFalse([number for number in taken if number % 10 == 0])
        while (sample := self.next_object(seen, report)[1]).number < len(taken):
            pass
        self.assertEqual((sample.number, sample.value), (len(taken), sum(taken)))

    def test_a_send_that_is_not_acknowledged_arrives_in_its_order(self):
        self.load("sink", "sink")
        link, wire, _ = self.attach("sink.orders", ORDER)
        seen, report, _ = self.attach("sink.report", LAST, client="witness")
        for number in range(1, 1001):
            frame = wire_pb2.Frame(wire=wire, object=wire_pb2.Object(sequence=number))
            link.send(frame, test_pb2.Sample(number=number).SerializeToString())
        sums = {}
        while len(sums) < 1000:
            _, sample, lost = self.next_object(seen, report)
            self.assertEqual(lost, 0)
            sums[sample.number] = sample.value
            self.assertEqual(sample.value, sample.number * (sample.number + 1) / 2)

    def test_a_send_that_is_acknowledged_waits_behind_those_that_are_not(self):
        link, wire, seen, report = self.fill(60)
        for handled in range(1, 62):
            sample = self.next_object(seen, report)[1]
            self.assertEqual((sample.number, sample.value), (handled, handled * (handled + 1) / 2))
            if handled == 10:  # there is room for it, and not for those that wait
                frame = wire_pb2.Frame(wire=wire, request=wire_pb2.Request(id=1))
                link.send(frame, test_pb2.Sample(number=61).SerializeToString())
        self.assertEqual((self.answer(link, wire)[0].outcome, self.port("sink.orders").refused), (OK, 0))

    def test_sends_that_wait_for_room_are_taken_though_their_wire_has_ended(self):
        link, wire, seen, report = self.fill(60)
        link.send(wire_pb2.Frame(wire=wire, closed=wire_pb2.Closed(reason="done")))
        link.next(wire)
        while (sample := self.next_object(seen, report)[1]).number < 60:
            pass
        self.assertEqual((sample.value, self.port("sink.orders").refused), (60 * 61 / 2, 0))

    def test_times_that_no_clock_shows_are_taken_as_the_nearest_that_one_could(self):
        self.load("sink", "sink")
        link, wire, _ = self.attach("sink.orders", ORDER)
        seen, report, _ = self.attach("sink.report", LAST, client="witness")
        times = [-(2**63), -1, 0, 1, 2**62, 2**63 - 1]
        for number, origin in enumerate(times, 1):
            frame = wire_pb2.Frame(wire=wire, object=wire_pb2.Object(sequence=number, origin_ns=origin))
            link.send(frame, test_pb2.Sample(number=number).SerializeToString())
        while self.next_object(seen, report)[1].number < len(times):
            pass
        self.eventually(lambda: self.port("sink.orders").messages == len(times), "all have been counted")
        self.assertGreater(self.port("sink.orders").latency_p99_ms, 0)

    def test_an_activation_is_taken_then_fires_until_it_is_cancelled_or_once(self):
        self.load("source", "src", "far", period_ms=1.0)
        link, wire, _ = self.attach("src.bell", BELL)
        threshold = test_pb2.Threshold(every=2).SerializeToString()
        link.send(wire_pb2.Frame(wire=wire, request=wire_pb2.Request(id=1, continuous=True)), threshold)
        for sequence in range(6):  # 0: taken
            frame, data = link.next(wire)
            self.assertEqual((frame.fired.id, frame.fired.sequence), (1, sequence))
            self.assertEqual(test_pb2.Crossing.FromString(data).seen, 2 * sequence)
        link.send(wire_pb2.Frame(wire=wire, cancel=wire_pb2.Cancel(id=1)))
        link.send(wire_pb2.Frame(wire=wire, request=wire_pb2.Request(id=2)), threshold)
        while (frame := link.next(wire)[0]).fired.id == 1:
            pass
        self.assertEqual(frame.fired.sequence, 0)
        self.assertEqual(link.next(wire)[0].fired.sequence, 1)
        with self.assertRaises(TimeoutError):
            link.receive(0.05)

    # ---- who may speak

    def test_a_wrong_key_is_noticed_by_the_client_and_a_wrong_proof_by_the_provider(self):
        self.load("source", "src")
        granted = self.control.attach("src.newest", "viewer", NEWEST)
        with self.assertRaisesRegex(Refused, "does not know the key"):
            self.link(granted, key=bytes(32))
        before = self.status().links.unproven
        link = self.link(granted, key=bytes(32), trusting=True)
        link.send(wire_pb2.Frame(wire=granted.wire, open=wire_pb2.Open(version=1, token=granted.token)))
        self.eventually(lambda: self.status().links.unproven == before + 2, "the proof and the frame behind it were not counted")
        self.assertEqual(self.status().links.peers, 0)
        with self.assertRaises(TimeoutError):
            link.receive(0)

    def test_a_wire_opens_once_with_its_token_for_the_client_it_was_given_to(self):
        self.load("source", "src")
        granted, other = (self.control.attach("src.newest", name, NEWEST) for name in ("viewer", "other"))
        link, stranger = self.link(granted), self.link(other)
        for who, token in ((link, bytes(16)), (stranger, None)):
            with self.assertRaisesRegex(Refused, "^the wire was not granted$"):
                who.open(granted, token=token)
        link.open(granted)
        self.assertEqual(self.status().links.not_granted, 2)
        second = wire_pb2.Frame(wire=granted.wire, open=wire_pb2.Open(version=1, token=granted.token))
        link.send(second)
        while not (frame := link.next(granted.wire)[0]).HasField("refused"):
            pass
        self.assertEqual(frame.refused.reason, "the wire was not granted")

    def test_an_unknown_version_is_refused_with_the_one_that_is_spoken(self):
        self.load("source", "src")
        granted = self.control.attach("src.newest", "viewer", NEWEST)
        with self.assertRaisesRegex(Refused, "^unknown protocol version: this side speaks 1$"):
            self.link(granted, version=2)
        link = self.link(granted)
        with self.assertRaisesRegex(Refused, "^unknown protocol version: this side speaks 1$"):
            link.open(granted, version=2)
        link.open(granted)

    def test_what_is_garbled_or_unknown_is_dropped_and_the_link_lives_on(self):
        self.load("answerer", "oracle")
        link, wire, _ = self.attach("oracle.echo", ECHO)
        link.socket.send(b"nonsense that is no record")
        link.socket.send_multipart([b"one", b"two", b"three"])
        link.socket.send_multipart([wire_client.record(wire_pb2.Frame(wire=wire)), b"", struct.pack("<II", 0, 1)])
        link.send(wire_pb2.Frame(memory=wire_pb2.Memory(process=os.getpid(), file_descriptor=2)))  # as a host's process might
        link.send(wire_pb2.Frame(wire=wire))              # of a kind that this version does not have
        link.send(wire_pb2.Frame(wire=wire + 1, cancel=wire_pb2.Cancel(id=1)))
        self.ask(link, wire, 1)
        self.assertEqual(self.answer(link, wire)[0].outcome, OK)
        links = self.status().links
        self.assertEqual((links.garbled, links.not_granted), (3, 2))

    # ---- attaching

    def test_the_host_shows_who_is_attached_and_forgets_them_with_their_connection(self):
        self.load("source", "src", "far")
        link, wire, _ = self.attach("src.newest", NEWEST, prescale=2)
        self.assertRegex(self.host.console("ls wires"), r"viewer +src\.newest +SampleNewest +attached +2")
        self.assertRegex(self.host.console("show src.newest"), r"clients +viewer \(attached\)")
        self.assertEqual(self.status("far").links.peers, 1)
        self.control.close()
        self.eventually(lambda: not self.port("src.newest").attached, "the wire outlived its connection")
        self.eventually(lambda: self.status("far").links.peers == 0, "the link outlived its connection")

    def test_detaching_closes_the_wire_and_the_last_one_the_link(self):
        self.load("source", "src", period_ms=1.0)
        first, second = (self.control.attach("src.newest", "viewer", NEWEST) for _ in range(2))
        link = self.link(first)
        link.open(first)
        link.open(second)
        self.control.detach(first.wire)
        while not (frame := link.next(first.wire)[0]).HasField("closed"):
            pass
        self.assertEqual(frame.closed.reason, "detached")
        self.next_object(link, second.wire)
        self.control.detach(second.wire)
        self.assertEqual(self.status().links.peers, 0)
        with self.assertRaisesRegex(Refused, "holds no wire"):
            self.control.detach(second.wire)
        link.prove(1, first.key, False)  # the same socket may begin anew
        third = self.control.attach("src.newest", "viewer", NEWEST)
        link.open(third)
        self.next_object(link, third.wire)

    def test_the_holder_is_told_when_the_provider_goes_or_dies(self):
        self.load("source", "src")
        self.load("source", "mortal", "far")
        link, wire, _ = self.attach("src.newest", NEWEST)
        asked = self.control.asked
        self.change(unload=control_pb2.Unload(instance="src"))
        self.assertEqual(self.control.reply_to(asked).failure.what, "the wire has ended: 'src' has ended")
        while not (frame := link.next(wire)[0]).HasField("closed"):
            pass
        self.attach("mortal.newest", NEWEST)
        asked = self.control.asked
        os.kill(self.status("far").process, signal.SIGKILL)
        self.assertEqual(self.control.reply_to(asked).failure.what,
                         "the wire has ended: group 'far' killed by signal 9 (Killed)")

    def test_an_attachment_that_cannot_be_is_refused_in_a_sentence(self):
        self.load("source", "src")
        for provider, service, more, sentence in (
                ("nobody.newest", NEWEST, {}, "there is no instance 'nobody'"),
                ("src.nothing", NEWEST, {}, "nothing"),
                ("src.orders", ORDER, {}, "orders"),
                ("src.newest", LAST, {}, "the client speaks another service than src.newest"),
                ("src.newest", NEWEST, {"major": 2}, "the client speaks another service than src.newest"),
                ("src.newest", NEWEST, {"minor": 1}, "the client speaks another service than src.newest"),
                ("src.newest", NEWEST, {"client": "a b"}, "'a b' is no name for a client")):
            with self.assertRaisesRegex(Refused, sentence):
                self.control.attach(provider, more.pop("client", "viewer"), service, **more)
        self.change(unload=control_pb2.Unload(instance="src"))
        clock = control_pb2.Set(instance="host")
        clock.parameters.add(name="clock", value=self.value("virtual"))
        self.change(set=clock)
        self.load("source", "src")
        with self.assertRaisesRegex(Refused, "a virtual clock waits for its own processes only"):
            self.control.attach("src.newest", "viewer", NEWEST)

    def test_a_connection_holds_so_many_wires_and_no_more(self):
        self.load("source", "src")
        for _ in range(64):
            self.control.attach("src.newest", "viewer", NEWEST)
        with self.assertRaisesRegex(Refused, "this connection holds 64 wires already"):
            self.control.attach("src.newest", "viewer", NEWEST)


class FewDescriptors(WireProtocolCase):
    descriptors = 100

    def test_a_client_for_whose_link_a_process_may_lack_descriptors_is_refused(self):
        self.load("source", "src")
        with self.assertRaisesRegex(Refused, "another client would bring the host to the end of its descriptors"):
            for number in range(64):
                self.attach("src.newest", NEWEST, client="viewer-%d" % number)
        self.assertGreater(self.status().links.peers, 0)


if __name__ == "__main__":
    BINARIES, LIBRARY = sys.argv[1:3]
    unittest.main(argv=sys.argv[:1] + sys.argv[3:], verbosity=2)
