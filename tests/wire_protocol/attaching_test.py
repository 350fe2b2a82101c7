#!/usr/bin/env python3
"""Sections 1, 2 and 5 of docs/wire-protocol.md: how a client is given wires, and how they end.

    attaching_test.py BIN_DIR COMPONENTS_LIBRARY [TEST...]
"""
import os
import signal
import stat
import struct

from google.protobuf import descriptor_pool, message_factory

from fiona import control_pb2, wire_pb2

import real_host
from real_host import BELL, ECHO, LAST, LIBRARY, NEWEST, OK, ORDER, Host, WireProtocolCase
from wire_client import Control, Refused

LONGEST = 16 * 1024 * 1024
UNKNOWN = b"\x9a\x06\x00"  # field 99, empty


class ControlSocket(WireProtocolCase):
    """What goes over it, whatever is asked for."""

    def test_it_is_where_the_name_of_the_host_says_in_a_directory_for_its_user_alone(self):
        directory = os.path.dirname(self.host.socket)
        self.assertEqual(stat.S_IMODE(os.stat(directory).st_mode), 0o700)
        self.assertTrue(stat.S_ISSOCK(os.stat(self.host.socket).st_mode))

    def test_a_client_without_descriptors_builds_its_messages_of_what_describe_tells(self):
        self.load("answerer", "oracle", "far")
        self.load("source", "src", period_ms=1.0)
        described = {}
        for name in ("fiona.test.Echo", "SampleNewest"):  # in full, or its last part
            description = self.control.call(describe=control_pb2.Describe(name=name)).description
            self.assertTrue(description.is_service)
            pool = descriptor_pool.DescriptorPool()
            for file in description.files.file:  # each behind those that it imports
                pool.Add(file)
            described[description.name] = description.contract, pool.FindServiceByName(description.name), pool
        make = lambda service: message_factory.MessageFactory(described[service][2]).GetPrototype

        contract, service, _ = described[ECHO]
        method = service.methods_by_name["Query"]
        question, reply = make(ECHO)(method.input_type)(number=7, payload=b"x"), make(ECHO)(method.output_type)
        granted = self.control.attach("oracle.echo", "viewer", ECHO, major=contract.major, minor=contract.minor)
        self.assertEqual(granted.contract, contract)
        link = self.link(granted)
        link.open(granted)
        link.send(wire_pb2.Frame(wire=granted.wire, request=wire_pb2.Request(id=1)), question.SerializeToString())
        answer, data = self.answer(link, granted.wire)
        self.assertEqual((answer.outcome, reply.FromString(data)), (OK, reply(number=7, payload=b"x")))

        sample = make(NEWEST)(described[NEWEST][1].methods_by_name["Object"].output_type)
        link, wire, start = self.attach("src.newest", NEWEST, client="other", major=described[NEWEST][0].major)
        for number in range(start + 1, start + 10):
            self.assertEqual(sample.FromString(link.next(wire)[1]).number, number)

    def test_what_describe_does_not_know_is_refused_with_the_names_that_are_near(self):
        self.load("answerer", "oracle")
        self.control.send(1, describe=control_pb2.Describe(name="Ecco"))
        failure = self.control.reply_to(1).failure
        self.assertEqual(failure.what, "there is no service or object 'Ecco'")
        self.assertIn("Echo", failure.near)

    def test_a_failure_comes_in_the_place_of_a_reply_that_would_be_too_long(self):
        for number in range(3):
            load = control_pb2.Load(plugin=LIBRARY + "/answerer", instance="oracle-%d" % number, comment="x" * (LONGEST // 3))
            self.change(load=load)
        self.control.send(100, snapshot=control_pb2.Snapshot())
        failure = self.control.reply_to(100).failure
        self.assertEqual(failure.what, "what there is to tell is too large")
        self.assertEqual(failure.expected, "%d bytes at most" % LONGEST)
        self.change(unload=control_pb2.Unload(instance="oracle-0"))
        self.assertEqual(len(self.snapshot().instances), 2)

    def test_what_is_no_request_is_told_so_without_an_id_and_ends_the_connection_with_its_wires(self):
        self.load("source", "src")
        for what, found in ((struct.pack("<I", 3) + b"\xff\xff\xff", "3 bytes that are no fiona.control.Request"),
                            (struct.pack("<I", LONGEST + 1), "a message of 16777217 bytes, where at most 16777216 are taken")):
            other = Control(self.host.socket)
            other.attach("src.newest", "viewer", NEWEST)
            self.assertEqual(len(self.port("src.newest").attached), 1)
            other.socket.sendall(what)
            self.assertEqual(other.reply_to(0).failure.found, found)
            with self.assertRaisesRegex(Refused, "the host has closed the connection"):
                other.reply_to(1)
            other.close()
            self.eventually(lambda: not self.port("src.newest").attached, "the wire outlived its connection")

    def test_a_request_may_be_16_mib_long(self):
        request = control_pb2.Request(id=1, snapshot=control_pb2.Snapshot()).SerializeToString()
        padding = LONGEST - len(request) - 6
        request += b"\x9a\x06" + struct.pack("BBBB", *(padding >> 7 * i & 127 | (128 if i < 3 else 0) for i in range(4)))
        request += bytes(padding)
        self.assertEqual(len(request), LONGEST)
        self.control.socket.settimeout(None)
        self.control.socket.sendall(struct.pack("<I", LONGEST) + request)
        self.assertTrue(self.control.reply_to(1).HasField("system"))

    def test_a_request_that_the_host_does_not_know_is_refused_and_the_connection_goes_on(self):
        request = control_pb2.Request(id=7).SerializeToString() + UNKNOWN
        self.control.socket.sendall(struct.pack("<I", len(request)) + request)
        self.assertIn("empty or newer than this host", self.control.reply_to(7).failure.what)
        self.assertTrue(self.control.call(snapshot=control_pb2.Snapshot()).HasField("system"))

    def test_a_request_with_the_id_of_one_that_is_open_is_refused(self):
        self.control.send(7, sleep=control_pb2.Sleep(duration_ms=1e6))
        self.control.send(7, snapshot=control_pb2.Snapshot())
        self.assertEqual(self.control.reply_to(7).failure.what, "a request of this number is open already, and goes on")

    def test_who_would_be_a_connection_too_many_is_told_so_without_an_id(self):
        others = []
        for _ in range(96 - 2):  # the control and the observer are there too
            others.append(Control(self.host.socket))
            self.assertTrue(others[-1].call(snapshot=control_pb2.Snapshot()).HasField("system"))
        others.append(Control(self.host.socket))
        self.assertEqual(others[-1].reply_to(0).failure.what, "96 consoles are connected to this host, and no more may be")
        with self.assertRaisesRegex(Refused, "the host has closed the connection"):
            others[-1].reply_to(1)
        for other in others:
            other.close()


class Attaching(WireProtocolCase):
    """Who is given a wire, and who is not."""

    def test_the_wires_of_a_connection_and_a_name_are_one_peers_with_a_key_for_each_endpoint(self):
        self.load("source", "src")
        self.load("source", "other", "far")
        first, second = (self.control.attach("src.newest", "viewer", NEWEST) for _ in range(2))
        far = self.control.attach("other.newest", "viewer", NEWEST)
        named = self.control.attach("src.newest", "lens", NEWEST)
        elsewhere = self.observer.attach("src.newest", "viewer", NEWEST)
        self.assertEqual((second.peer, second.key, second.endpoint), (first.peer, first.key, first.endpoint))
        self.assertEqual(far.peer, first.peer)
        self.assertEqual(len({first.peer, named.peer, elsewhere.peer}), 3)
        self.assertEqual(len({first.key, far.key, named.key, elsewhere.key}), 4)
        self.assertTrue(all(one.startswith("ipc://") for one in (first.endpoint, far.endpoint)))
        self.assertNotEqual(far.endpoint, first.endpoint)
        self.assertEqual([(len(one.key), len(one.token)) for one in (first, far)], [(32, 16)] * 2)

    def test_the_number_of_a_wire_is_not_used_again(self):
        self.load("source", "src")
        numbers = set()
        for _ in range(20):
            numbers.add(wire := self.control.attach("src.newest", "viewer", NEWEST).wire)
            self.control.detach(wire)
        self.assertEqual(len(numbers), 20)
        self.assertNotIn(0, numbers)

    def test_a_wire_is_detached_by_the_connection_that_holds_it_and_by_no_other(self):
        self.load("source", "src")
        granted = self.control.attach("src.newest", "viewer", NEWEST)
        with self.assertRaisesRegex(Refused, "this connection holds no wire %d" % granted.wire):
            self.observer.detach(granted.wire)
        self.control.detach(granted.wire)
        with self.assertRaisesRegex(Refused, "this connection holds no wire %d" % granted.wire):
            self.control.detach(granted.wire)
        self.control.call(snapshot=control_pb2.Snapshot())
        self.assertFalse(any(self.control.others.values()))  # nothing is told of a wire that its holder has let go of

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
        self.assertEqual(self.next_of(link, first.wire, "closed")[0].closed.reason, "detached")
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
        self.next_of(link, wire, "closed")
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
        self.set("host", clock="virtual")
        self.load("source", "src")
        with self.assertRaisesRegex(Refused, "a virtual clock waits for its own processes only"):
            self.control.attach("src.newest", "viewer", NEWEST)

    def test_a_connection_holds_so_many_wires_and_no_more(self):
        self.load("source", "src")
        for _ in range(64):
            self.control.attach("src.newest", "viewer", NEWEST)
        with self.assertRaisesRegex(Refused, "this connection holds 64 wires already"):
            self.control.attach("src.newest", "viewer", NEWEST)

    def test_an_instance_whose_process_is_gone_is_refused_until_it_is_there_again(self):
        self.load("source", "mortal", "far")

        def is_refused():
            try:
                if (process := self.status("far").process) > 0:
                    os.kill(process, signal.SIGKILL)
            except (ProcessLookupError, StopIteration):
                pass
            try:
                self.control.detach(self.control.attach("mortal.newest", "viewer", NEWEST).wire)
            except Refused as refused:
                return str(refused).startswith("'mortal' is lost: ")
            return False
        self.eventually(is_refused, "it was there whenever it was asked for")

    def test_an_instance_on_another_host_is_refused_by_both(self):
        self.host.command("keys", "make", "-q")
        key = self.host.command("keys", "show").strip()
        self.host.command("keys", "allow", "head", key)
        body = Host("--listen", "tcp://127.0.0.1:0", "--plugins", os.path.dirname(LIBRARY), name="body", beside=self.host)
        self.addCleanup(body.process.kill)
        there = Control(body.socket)
        address = there.call(snapshot=control_pb2.Snapshot()).system.listens.removeprefix("tcp://")
        head = Host("--peer", "body=%s=%s" % (address, key), name="head", beside=self.host)
        self.addCleanup(head.process.kill)
        here = Control(head.socket)
        load = control_pb2.Load(plugin=LIBRARY + "/source", instance="src", group="body")
        here.call(transact=control_pb2.Transact(changes=[control_pb2.Change(load=load)]))
        for asked, sentence in ((here, "src.newest is on host 'body'"),
                                (there, "'src' belongs to the system of host 'head', which leads this one")):
            with self.assertRaisesRegex(Refused, "^%s$" % sentence):
                asked.attach("src.newest", "viewer", NEWEST)
        self.assertEqual((head.close(here), body.close(there)), (0, 0))


class FewDescriptors(WireProtocolCase):
    descriptors = 100

    def test_a_client_for_whose_link_a_process_may_lack_descriptors_is_refused(self):
        self.load("source", "src")
        with self.assertRaisesRegex(Refused, "another client would bring the host to the end of its descriptors"):
            for number in range(64):
                self.attach("src.newest", NEWEST, client="viewer-%d" % number)
        self.assertGreater(self.status().links.peers, 0)


class Ends(WireProtocolCase):
    """Of wires and links, and who is told."""

    def test_a_client_that_closes_its_wire_has_the_providers_answer_and_the_failure(self):
        self.load("source", "src", "far", period_ms=1.0)
        link, wire, _ = self.attach("src.newest", NEWEST)
        asked = self.control.asked
        link.send(wire_pb2.Frame(wire=wire, closed=wire_pb2.Closed(reason="\u00fc" * 3000)))
        reason = self.next_of(link, wire, "closed")[0].closed.reason
        self.assertEqual(reason, "\u00fc" * 2048)  # what fits into 4096 bytes
        self.assertTrue(self.control.reply_to(asked).failure.what.startswith("the wire has ended: \u00fc"))
        with self.assertRaisesRegex(Refused, "holds no wire"):
            self.control.detach(wire)
        self.eventually(lambda: self.status("far").links.peers == 0, "the link outlived its last wire")

    def test_a_client_that_replaces_a_provider_under_load_misses_nothing(self):
        """It opens the next wire, asks for the end of the last one, and reads on until that comes."""
        for group in ("main", "far"):
            self.load("source", "src-" + group, group, period_ms=0.2, payload=2000)
            port = "src-%s.newest" % group
            granted = self.control.attach(port, "viewer", NEWEST)
            link = self.link(granted)
            first = last = link.open(granted)
            for _ in range(50):
                for _ in range(20):
                    last = self.follow(link, granted.wire, last)
                following = self.control.attach(port, "viewer", NEWEST)
                start = link.open(following)
                link.send(wire_pb2.Frame(wire=granted.wire, closed=wire_pb2.Closed(reason="replaced")))
                while (at := self.follow(link, granted.wire, last)) is not None:
                    last = at
                self.assertGreaterEqual(last, start)  # nothing is between the two
                self.assertFalse(link.frames[granted.wire])
                granted = following
                for at in range(start, last):  # what both have brought
                    self.follow(link, granted.wire, at)
            self.assertGreater(last, first + 1000)

    def follow(self, link, wire, last):
        """The sequence of the next object, which is the one behind the last; None: the wire has ended."""
        frame, _ = link.next(wire)
        if frame.HasField("closed"):
            return None
        self.assertEqual((frame.WhichOneof("what"), frame.object.sequence), ("object", last + 1))
        return last + 1

    def test_what_waits_for_credit_comes_before_the_end_that_the_client_has_asked_for(self):
        self.load("source", "src", "far", period_ms=0.2, payload=100_000)
        granted = self.control.attach("src.newest", "viewer", NEWEST)
        other = self.control.attach("src.bell", "viewer", BELL)
        link = self.link(granted)
        link.open(other)  # with its last wire the link would end
        link.pays = False
        last = link.open(granted)
        self.eventually(lambda: self.port("src.newest").dropped > 0, "the provider never ran out of credit")
        before = self.port("src.newest").messages - 1  # the last of them may be on its way to the lane
        link.send(wire_pb2.Frame(wire=granted.wire, closed=wire_pb2.Closed(reason="done")))
        self.eventually(lambda: not self.port("src.newest").attached, "the wire did not end")
        put = self.port("src.newest").messages
        link.pays = True
        link.pay()
        while True:
            frame, _ = link.next(granted.wire)
            if frame.HasField("closed"):
                break
            if frame.HasField("lost"):
                last += frame.lost.messages
            else:
                self.assertEqual(frame.object.sequence, last + 1)
                last += 1
        self.assertTrue(before <= last <= put, (before, last, put))
        self.assertEqual(frame.closed.reason, "done")

    def test_what_waits_for_credit_when_the_last_wire_of_a_peer_ends_is_lost_with_its_links(self):
        self.load("source", "src", "far", period_ms=0.2, payload=100_000)
        granted = self.control.attach("src.newest", "viewer", NEWEST)
        asked = self.control.asked
        link = self.link(granted)
        link.pays = False
        link.open(granted)
        self.eventually(lambda: self.port("src.newest").dropped > 0, "the provider never ran out of credit")
        link.send(wire_pb2.Frame(wire=granted.wire, closed=wire_pb2.Closed(reason="done")))
        self.assertEqual(self.control.reply_to(asked).failure.what, "the wire has ended: done")
        self.eventually(lambda: self.status("far").links.peers == 0, "the link outlived its last wire")
        unproven = self.status("far").links.unproven
        while link.socket.poll(0):
            link.receive(0)
        link.pays = True
        link.pay()
        self.eventually(lambda: self.status("far").links.unproven > unproven, "the credit was taken")
        while link.socket.poll(0):
            link.receive(0)
        self.assertFalse(any(frame.HasField("closed") for frame, _ in link.frames[granted.wire]))

    def test_frames_of_a_wire_that_has_just_ended_are_passed_over_and_not_counted(self):
        self.load("answerer", "oracle")
        first, second = (self.control.attach("oracle.echo", "viewer", ECHO) for _ in range(2))
        link = self.link(first)
        link.open(first)
        link.open(second)
        self.control.detach(first.wire)
        self.ask(link, first.wire, 1)
        self.ask(link, second.wire, 1)
        self.assertEqual(self.answer(link, second.wire)[0].outcome, OK)
        self.assertEqual(self.status().links.not_granted, 0)

    def test_a_wire_that_has_ended_is_not_opened_again(self):
        self.load("source", "src")
        first, second = (self.control.attach("src.newest", "viewer", NEWEST) for _ in range(2))
        link = self.link(first)
        link.open(second)
        self.control.detach(first.wire)
        with self.assertRaisesRegex(Refused, "^the wire was not granted$"):
            link.open(first)

    def test_a_wire_of_a_connection_that_has_ended_needs_another_grant(self):
        self.load("source", "src", period_ms=1.0)
        opened, unopened = (self.control.attach("src.newest", "viewer", NEWEST) for _ in range(2))
        link = self.link(opened)
        link.open(opened)
        self.next_object(link, opened.wire)
        link.close()
        again = self.link(opened)  # the key is as good as it was
        with self.assertRaisesRegex(Refused, "^the wire was not granted$"):
            again.open(opened)
        again.open(unopened)
        self.next_object(again, unopened.wire)
        self.assertEqual(len(self.port("src.newest").attached), 2)
        following = self.control.attach("src.newest", "viewer", NEWEST)
        start = again.open(following)
        self.control.detach(opened.wire)
        self.assertEqual(self.next_object(again, following.wire)[0], start + 1)
        self.assertEqual(self.status().links.peers, 1)

    def test_of_two_connections_that_prove_one_name_the_older_is_heard_no_more(self):
        self.load("answerer", "oracle")
        granted = self.control.attach("oracle.echo", "viewer", ECHO)
        older = self.link(granted)
        older.open(granted)
        self.ask(older, granted.wire, 1)
        self.assertEqual(self.answer(older, granted.wire)[0].outcome, OK)
        self.link(granted)
        self.eventually(lambda: self.status().links.received_messages >= 5, "the proof did not arrive")
        self.ask(older, granted.wire, 2)
        self.eventually(lambda: self.status().links.unproven == 1, "the older one was heard")
        self.assertEqual(self.status().links.peers, 1)
        with self.assertRaises(TimeoutError):
            older.receive(0)


if __name__ == "__main__":
    real_host.run()
