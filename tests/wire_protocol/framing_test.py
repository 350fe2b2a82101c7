#!/usr/bin/env python3
"""Sections 3, 4 and 8 to 11 of docs/wire-protocol.md: how what crosses is written, proved and bounded, whatever it means.

    framing_test.py BIN_DIR COMPONENTS_LIBRARY [TEST...]
"""
import os
import struct

import zmq
from zmq.utils import monitor

from fiona import wire_pb2
from fiona.test import test_pb2

import real_host
import wire_client
from real_host import BELL, ECHO, LAST, NEWEST, OK, ORDER, REJECTED, Recorded, Unproven, WireProtocolCase
from wire_client import FRAME_COST, PORTION, WINDOW, Link, Refused, record

KIB = 1024
CHUNK = 1040 * KIB
LONGEST_PART = CHUNK + 64 * KIB


def unknown(**frame):
    """A frame of a kind that this version does not have."""
    return wire_pb2.Frame.FromString(wire_pb2.Frame(**frame).SerializeToString() + b"\x9a\x06\x00")


class Handshake(WireProtocolCase):
    def setUp(self):
        super().setUp()
        self.load("answerer", "oracle")
        self.granted = self.control.attach("oracle.echo", "viewer", ECHO)
        self.bare = self.link(self.granted, kind=Unproven)

    def hello(self, **more):
        return wire_pb2.Frame(hello=wire_pb2.Hello(**{"version": 1, "client": self.granted.peer, "nonce": b"n" * 16, **more}))

    def counted(self, messages, unproven):
        """After so many messages so many have been counted as unproven, and nobody has been let in."""
        self.eventually(lambda: self.status().links.received_messages == messages, "it did not arrive")
        self.eventually(lambda: self.status().links.unproven == unproven, "it was not counted")
        self.assertEqual(self.status().links.peers, 0)

    def test_a_challenge_comes_alone_in_one_part_for_the_link_and_without_an_object(self):
        Link.prove(self.bare, 1, self.granted.key, False)
        (part,), = self.bare.socket.messages
        frame_size, object_size = struct.unpack_from("<II", part)
        self.assertEqual((len(part), object_size), (8 + frame_size, 0))
        frame = wire_pb2.Frame.FromString(part[8:])
        self.assertEqual((frame.wire, frame.lane, len(frame.also), frame.size), (0, 0, 0, 0))
        self.assertEqual((len(frame.challenge.nonce), len(frame.challenge.proof)), (16, 32))
        self.bare.open(self.granted)
        self.assertEqual(self.status().links.peers, 1)

    def test_a_handshake_that_has_an_object_a_second_part_a_wire_or_company_is_none(self):
        hello = self.hello()
        self.bare.socket.send(record(hello, b"x"))
        self.bare.socket.send_multipart([record(hello), b""])
        self.bare.socket.send_multipart([record(hello), record(hello)])
        self.bare.socket.send_multipart([record(hello), b"", b""])
        self.counted(4, 4)
        # And one for a wire, and one that is not alone.
        self.bare.send(wire_pb2.Frame(wire=7, hello=hello.hello))
        self.bare.socket.send(record(unknown()) + record(hello))
        self.bare.socket.send(record(hello) + record(unknown()))
        self.counted(7, 7)
        with self.assertRaises(TimeoutError):
            self.bare.receive(0)
        self.bare.send(hello)
        nonce = self.bare.next(0)[0].challenge.nonce
        proof = wire_client.keyed_hash(self.granted.key, b"client", b"n" * 16, nonce)
        proof = wire_pb2.Frame(proof=wire_pb2.Proof(client=self.granted.peer, nonce=b"n" * 16, proof=proof))
        self.bare.socket.send(record(proof, b"x"))
        self.bare.socket.send_multipart([record(proof), b""])
        self.counted(10, 9)
        self.bare.send(proof)
        self.bare.open(self.granted)

    def test_nothing_else_is_read_before_the_proof(self):
        opening = wire_pb2.Frame(wire=self.granted.wire, open=wire_pb2.Open(version=1, token=self.granted.token))
        for frame in (opening, wire_pb2.Frame(credit=wire_pb2.Credit(lane=[1], bytes=[1])), unknown(),
                      wire_pb2.Frame(wire=self.granted.wire, closed=wire_pb2.Closed())):
            self.bare.send(frame)
        self.bare.socket.send(b"no record")
        self.counted(5, 5)
        with self.assertRaises(TimeoutError):
            self.bare.receive(0)

    def test_a_nonce_of_another_length_is_counted_and_not_answered(self):
        for size in (0, 15, 17):
            self.bare.send(self.hello(nonce=b"n" * size))
        self.bare.send(wire_pb2.Frame(proof=wire_pb2.Proof(client=self.granted.peer, nonce=b"n", proof=b"p" * 32)))
        self.counted(4, 4)
        with self.assertRaises(TimeoutError):
            self.bare.receive(0)

    def test_after_a_refused_version_the_client_may_try_the_next_one(self):
        with self.assertRaisesRegex(Refused, "^unknown protocol version: this side speaks 1$"):
            Link.prove(self.bare, 2, self.granted.key, False)
        Link.prove(self.bare, 1, self.granted.key, False)
        self.bare.open(self.granted)
        self.assertEqual(self.status().links.unproven, 0)

    def test_a_handshake_behind_the_proof_is_for_nobody(self):
        Link.prove(self.bare, 1, self.granted.key, False)
        self.bare.send(self.hello())
        self.bare.open(self.granted)
        self.assertEqual((self.status().links.not_granted, self.status().links.unproven), (1, 0))


class Messages(WireProtocolCase):
    """Records, parts and chunks."""

    def setUp(self):
        super().setUp()
        self.load("answerer", "oracle")
        self.oracle, self.wire, _ = self.attach("oracle.echo", ECHO)

    def question(self, number, **more):
        """The frame and the object of a question."""
        frame = wire_pb2.Frame(wire=self.wire, lane=1, request=wire_pb2.Request(id=number))
        return frame, test_pb2.Question(number=number, **more).SerializeToString()

    def answered(self, *numbers):
        for number in numbers:
            self.assertEqual(self.answer(self.oracle, self.wire)[0].id, number)

    def garbled(self):
        return self.status().links.garbled

    def test_a_message_has_several_records_and_the_last_ones_object_goes_on_in_any_division(self):
        questions = [self.question(number, payload=b"x" * 100) for number in range(1, 6)]
        self.oracle.socket.send(b"".join(record(*one) for one in questions))
        self.answered(1, 2, 3, 4, 5)
        frame, text = self.question(6, payload=b"y" * 100)
        for number, split in enumerate((0, 1, 50, len(text) - 1, len(text)), 6):
            frame.request.id = number
            self.oracle.socket.send_multipart([record(frame, text[:split]), text[split:]])
        self.answered(6, 7, 8, 9, 10)
        self.oracle.socket.send_multipart([record(*self.question(11)) + record(*self.question(12)[:1]), self.question(12)[1]])
        self.answered(11, 12)
        self.assertEqual(self.garbled(), 0)

    def test_records_before_a_fault_are_taken(self):
        self.oracle.socket.send(record(*self.question(1)) + b"nonsense")
        self.answered(1)
        self.assertEqual(self.garbled(), 1)

    def test_a_host_sends_small_objects_in_their_records_and_of_larger_ones_most_beside(self):
        self.oracle.socket = Recorded(self.oracle.socket)
        for number, size in enumerate((0, 1000, 16 * KIB - 100, 16 * KIB + 100, 100 * KIB, 1500 * KIB), 1):
            self.oracle.socket.messages.clear()
            self.ask(self.oracle, self.wire, number, payload=bytes(size))
            _, text = self.answer(self.oracle, self.wire)
            for parts in self.oracle.socket.messages:
                if wire_pb2.Frame.FromString(parts[0][8:8 + struct.unpack_from("<I", parts[0])[0]]).HasField("credit"):
                    continue
                self.assertEqual(len(parts), 1 if len(text) <= 16 * KIB else 2)
                self.assertLessEqual(max(map(len, parts)), LONGEST_PART)
                self.assertLessEqual(len(parts[0]), 16 * KIB + 256)
                if len(parts) == 2:
                    self.assertGreater(len(parts[1]), len(parts[0]))

    def test_chunks_of_any_size_make_up_an_object_between_frames_of_other_wires(self):
        other = self.control.attach("oracle.echo", "viewer", ECHO)
        self.oracle.open(other)
        frame, text = self.question(1, payload=os.urandom(7000))
        frame.wire, frame.size = other.wire, len(text)
        pieces = [text[:1], text[1:2], *(text[at:at + 1500] for at in range(2, len(text), 1500))]
        self.assertEqual(len(pieces), 7)
        for number, piece in enumerate(pieces):
            more = frame if number == 0 else wire_pb2.Frame(wire=other.wire, more=wire_pb2.More())
            split = number % 3 * len(piece) // 2  # inside, beside, or both
            self.oracle.socket.send_multipart([record(more, piece[:split]), piece[split:]])
            self.ask(self.oracle, self.wire, number + 1)
        self.answered(*range(1, 8))
        self.assertEqual(test_pb2.Reply.FromString(self.answer(self.oracle, other.wire)[1]).payload,
                         test_pb2.Question.FromString(text).payload)
        self.assertEqual(self.garbled(), 0)

    def test_what_is_cut_in_another_way_is_garbled_and_of_no_harm(self):
        def chunked(pieces, size=None, first=None):
            frame, _ = self.question(1)
            frame.size = sum(map(len, pieces)) if size is None else size
            self.oracle.put(frame, pieces[0])
            for piece in pieces[1:]:
                self.oracle.put(first or wire_pb2.Frame(wire=self.wire, more=wire_pb2.More()), piece)
        _, text = self.question(1, payload=bytes(2000))
        cases = {
            "a chunk is empty": lambda: chunked([text[:9], b""], len(text)),
            "it begins with nothing": lambda: chunked([b""], len(text)),
            "there are more bytes than it has": lambda: chunked([text[:-1], b"xx"], len(text)),
            "there are more messages than it may come in": lambda: chunked([text[at:at + 1] for at in range(9)], len(text)),
            "it is above 64 MiB": lambda: chunked([text], 64 * KIB * KIB + 1),
            "its size is not that of what is there": lambda: chunked([text], len(text) - 1),
            "another one begins before it has ended": lambda: chunked([text[:9], text[:9]], len(text), wire_pb2.Frame(
                wire=self.wire, lane=1, size=len(text), request=wire_pb2.Request(id=2))),
            "it is for too many wires": lambda: self.oracle.put(wire_pb2.Frame(
                wire=self.wire, also=range(4097), lane=1, request=wire_pb2.Request(id=1)), text),
        }
        for count, (fault, send) in enumerate(cases.items(), 1):
            with self.subTest(fault):
                send()
                self.ask(self.oracle, self.wire, 100 + count)
                self.answered(100 + count)
                self.assertEqual(self.garbled(), count)
        chunked([text], len(text))  # a size that says no more than is there
        self.answered(1)
        chunked([text[at:at + 300] for at in range(0, len(text), 300)])
        self.answered(1)
        self.assertEqual(self.garbled(), len(cases))

    def test_who_sends_a_longer_part_than_there_may_be_has_lost_the_connection(self):
        events = self.oracle.socket.get_monitor_socket(zmq.EVENT_DISCONNECTED)
        self.oracle.socket.send(b"\xff" * LONGEST_PART)
        self.ask(self.oracle, self.wire, 1)
        self.answered(1)
        self.assertEqual(self.garbled(), 1)
        self.oracle.socket.send(b"\xff" * (LONGEST_PART + 1))
        self.assertTrue(events.poll(1000 * wire_client.PATIENCE_S), "the connection goes on")
        self.assertEqual(monitor.recv_monitor_message(events)["event"], zmq.EVENT_DISCONNECTED)
        self.oracle.socket.disable_monitor()


class Watching(Link):
    """Keeps what credit it was given."""

    def __init__(self, granted):
        self.credits = []
        super().__init__(granted)

    def deliver(self, frame, data):
        if frame.HasField("credit"):
            self.credits.append(dict(zip(frame.credit.lane, frame.credit.bytes)))
        super().deliver(frame, data)


class Credit(WireProtocolCase):
    def open(self, provider, service):
        granted = self.control.attach(provider, "viewer", service)
        link = self.link(granted, kind=Watching)
        link.open(granted)
        return link, granted.wire

    def refused(self, link, wire, number, lane, cost):
        """A question of this cost in this lane, whose answer has no object."""
        question = test_pb2.Question(number=1, manner="error")
        question.payload = bytes(max(0, cost - FRAME_COST - question.ByteSize() - 4))
        text = question.SerializeToString()
        link.put(wire_pb2.Frame(wire=wire, lane=lane, request=wire_pb2.Request(id=number)), text)
        self.assertEqual(self.answer(link, wire)[0].outcome, REJECTED)
        return len(text) + FRAME_COST

    def credited(self, link, lane):
        while not any(lane in one for one in link.credits):
            link.receive(wire_client.PATIENCE_S)
        return sum(one.get(lane, 0) for one in link.credits)

    def test_it_is_paid_once_something_is_owed_on_17_lanes(self):
        self.load("answerer", "oracle", "far")
        link, wire = self.open("oracle.echo", ECHO)
        costs = {lane: self.refused(link, wire, lane, lane, 0) for lane in range(100, 117)}
        self.credited(link, 100)
        self.assertEqual(link.credits, [costs])

    def test_it_is_paid_once_512_kib_are_owed(self):
        self.load("answerer", "oracle", "far")
        link, wire = self.open("oracle.echo", ECHO)
        for number in range(1, 9):
            self.assertEqual(self.refused(link, wire, number, 5, PORTION // 8), PORTION // 8)
        self.credited(link, 5)
        self.assertEqual(link.credits, [{5: PORTION}])

    def test_it_is_paid_for_the_objects_of_unknown_frames_all_the_same(self):
        self.load("answerer", "oracle")
        link, wire = self.open("oracle.echo", ECHO)
        data = bytes(PORTION - FRAME_COST)
        for lane, (number, pieces) in enumerate(((wire, 1), (wire + 1, 1), (0, 1), (wire, 3), (wire + 1, 3)), 1):
            length = -(-len(data) // pieces)
            link.put(unknown(wire=number, lane=lane, size=len(data)), data[:length])
            for at in range(length, len(data), length):
                link.put(wire_pb2.Frame(wire=number, more=wire_pb2.More()), data[at:at + length])
            self.assertEqual(self.credited(link, lane), PORTION)
        self.refused(link, wire, 1, 1, 0)
        self.assertEqual((self.status().links.garbled, self.status().links.not_granted), (0, 3))

    def test_it_is_paid_for_an_object_whose_wire_has_ended_before_its_last_chunk_came(self):
        self.load("answerer", "oracle")
        link, wire = self.open("oracle.echo", ECHO)
        other = self.control.attach("oracle.echo", "viewer", ECHO)
        link.open(other)
        size = PORTION + 1000
        link.put(wire_pb2.Frame(wire=wire, lane=1, size=size, request=wire_pb2.Request(id=1)), bytes(1000))
        self.control.detach(wire)
        link.put(wire_pb2.Frame(wire=other.wire, lane=2, size=size, request=wire_pb2.Request(id=1)), bytes(1000))
        self.assertEqual(self.credited(link, 1), size + FRAME_COST)
        self.assertEqual(self.status().links.not_granted, 0)

    def order(self, link, wire, number):
        frame = wire_pb2.Frame(wire=wire, lane=1, object=wire_pb2.Object(sequence=number))
        link.put(frame, (text := test_pb2.Sample(number=number, payload=bytes(100_000)).SerializeToString()))
        return len(text) + FRAME_COST

    def test_sends_that_wait_for_room_are_paid_for_once_they_have_found_it(self):
        self.load("sink", "sink", "far", order_ms=50.0)
        link, wire = self.open("sink.orders", ORDER)
        before = self.status("far").links.received_messages
        cost = sum(self.order(link, wire, number) for number in range(1, 61)) // 60
        self.eventually(lambda: self.status("far").links.received_messages == before + 60, "they did not arrive")
        while link.socket.poll(0):
            link.receive(0)
        handled = self.port("sink.orders").messages
        self.assertLessEqual(sum(one[1] for one in link.credits), (handled + WINDOW // 100_000 + 1) * cost)
        while sum(one[1] for one in link.credits) <= 60 * cost - PORTION:
            link.receive(wire_client.PATIENCE_S)

    def test_who_sends_more_than_the_credit_is_heard_as_far_as_there_is_room(self):
        self.load("sink", "sink", "far", order_ms=20.0)
        link, wire = self.open("sink.orders", ORDER)
        for number in range(1, 301):
            self.order(link, wire, number)
        self.eventually(lambda: self.port("sink.orders").messages + self.port("sink.orders").refused == 300, "some are missing")
        sink = self.port("sink.orders")
        self.assertGreater(sink.refused, 0)
        self.assertGreaterEqual(sink.messages, (2 * WINDOW + WINDOW) // 100_300)  # what waits, and the queue
        self.assertEqual(self.status("far").links.peers, 1)

    def test_an_answer_for_which_there_is_no_room_behind_the_credit_is_rejected(self):
        self.load("answerer", "oracle", "far")
        link, wire = self.open("oracle.echo", ECHO)
        link.pays = False
        for number in range(1, 101):
            self.ask(link, wire, number, payload=bytes(100_000))
            if number % 20 == 0:  # no more at once than its queue has room for
                self.eventually(lambda: self.port("oracle.echo").messages == number, "they did not arrive")
        link.pays = True
        link.pay()
        outcomes = {}
        for _ in range(100):
            answer, _ = self.answer(link, wire)
            outcomes[answer.id] = (answer.outcome, answer.reason)
        fit = WINDOW // 100_000
        self.assertEqual(set(outcomes.values()), {(OK, ""), (REJECTED, "the answers before it have not been taken yet")})
        self.assertEqual({outcomes[number][0] for number in range(1, 2 * fit - 2)}, {OK})

    def test_an_event_for_which_there_is_no_room_is_a_gap_in_their_numbers(self):
        self.load("source", "src", "far", period_ms=1.0)
        link, wire = self.open("src.bell", BELL)
        link.pays = False
        threshold = test_pb2.Threshold(every=1, payload=bytes(100_000)).SerializeToString()
        link.send(wire_pb2.Frame(wire=wire, request=wire_pb2.Request(id=1, continuous=True)), threshold)
        first = self.port("src.bell").messages
        self.eventually(lambda: self.port("src.bell").messages > first + 3 * WINDOW // 100_000, "it does not ring")
        link.pays = True
        link.pay()
        sequences = [link.next(wire)[0].fired.sequence for _ in range(3 * WINDOW // 100_000)]
        self.assertEqual(sequences, sorted(set(sequences)))
        self.assertGreater(sequences[-1], len(sequences) - 1)

    def test_each_wire_has_a_lane_and_those_to_one_push_port_have_one_together(self):
        self.load("source", "src", period_ms=1.0)
        self.load("answerer", "oracle")
        granted = [self.control.attach(port, "viewer", service) for port, service in (
            ("src.newest", NEWEST), ("src.newest", NEWEST), ("src.last", LAST), ("oracle.echo", ECHO), ("oracle.echo", ECHO))]
        link = self.link(granted[0])
        for one in granted:
            link.open(one)
        for one in granted[3:]:
            self.ask(link, one.wire, 1)
        lanes = []
        for one in granted:
            while not (frame := link.next(one.wire)[0]).lane:
                pass
            lanes.append(frame.lane)
        self.assertEqual(lanes[0], lanes[1])
        self.assertEqual(len(set(lanes)), 4)

    def test_who_leaves_16_mib_unread_of_what_costs_no_credit_is_not_heard_any_more(self):
        self.load("answerer", "oracle")
        granted = self.control.attach("oracle.echo", "viewer", ECHO)
        deaf = self.link(granted, kind=Unproven)
        deaf.socket.disconnect(granted.endpoint)
        deaf.socket.socket.rcvhwm = 1  # of the next connection
        deaf.socket.connect(granted.endpoint)
        Link.prove(deaf, 1, granted.key, False)
        deaf.open(granted)
        question = test_pb2.Question(manner="long").SerializeToString()
        for number in range(6000):  # each is refused in 4 KiB
            deaf.put(wire_pb2.Frame(wire=granted.wire, lane=1, request=wire_pb2.Request(id=number)), question)
        self.eventually(lambda: self.status().links.overrun == 1, "it is still there")
        self.assertEqual(self.status().links.peers, 0)
        unproven = self.status().links.unproven
        deaf.put(wire_pb2.Frame(wire=granted.wire, cancel=wire_pb2.Cancel(id=1)), b"")
        self.eventually(lambda: self.status().links.unproven > unproven, "it is still heard")


class WhoMaySpeak(WireProtocolCase):
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
        frame, _ = self.next_of(link, granted.wire, "refused")
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
        link.socket.send_multipart([record(wire_pb2.Frame(wire=wire)), b"", struct.pack("<II", 0, 1)])
        link.send(wire_pb2.Frame(memory=wire_pb2.Memory(process=os.getpid(), file_descriptor=2)))  # as a host's process might
        link.send(unknown(wire=wire))
        link.send(wire_pb2.Frame(wire=wire + 1, cancel=wire_pb2.Cancel(id=1)))
        self.ask(link, wire, 1)
        self.assertEqual(self.answer(link, wire)[0].outcome, OK)
        links = self.status().links
        self.assertEqual((links.garbled, links.not_granted), (3, 2))


if __name__ == "__main__":
    real_host.run()
