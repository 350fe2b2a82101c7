#!/usr/bin/env python3
"""docs/wire-protocol.md, held against a real host by a client that shares no code with it.

    wire_protocol_test.py BIN_DIR COMPONENTS_LIBRARY [TEST...]
"""
import os
import time
import unittest

from fiona import control_pb2, wire_pb2
from fiona.test import test_pb2

import real_host
import wire_client
from real_host import BELL, ECHO, LAST, LEASED, NEWEST, NOT_ACTIVE, OK, ORDER, REJECTED, TIMED, WireProtocolCase

SPECIFICATION = os.path.join(os.path.dirname(os.path.abspath(__file__)), "../../docs/wire-protocol.md")


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
        frame, _ = self.next_of(link, wire, "lease")
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
        self.set("pourer", count=7, payload=1000)
        for mode in ("neutral", "active"):
            self.state("pourer", mode)
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

    def test_a_push_timed_tells_how_often_it_produces(self):
        self.load("source", "src")
        granted = self.control.attach("src.timed", "viewer", TIMED)
        link = self.link(granted)
        link.send(wire_pb2.Frame(wire=granted.wire, open=wire_pb2.Open(version=1, token=granted.token)))
        self.assertEqual(link.next(granted.wire)[0].opened.cycle_ns, 20_000_000)

    def test_a_push_is_stamped_with_unix_time(self):
        self.load("source", "src", period_ms=1.0)
        link, wire, _ = self.attach("src.newest", NEWEST)
        origins = [link.next(wire)[0].object.origin_ns for _ in range(20)]
        self.assertEqual(origins, sorted(origins))
        self.assertLess(abs(origins[0] - time.time_ns()), 3600 * 10**9)  # which clocks may be set by meanwhile

    def test_the_last_value_takes_part_in_the_prescale(self):
        self.load("source", "src", period_ms=1.0, count=5)
        self.eventually(lambda: self.port("src.last").messages == 5, "the source has not put five samples")
        link, wire, start = self.attach("src.last", LAST, prescale=3)
        self.set("src", count=0)
        for mode in ("neutral", "active"):
            self.state("src", mode)
        self.assertEqual([start, *(self.next_object(link, wire)[0] for _ in range(3))], [5, 5, 8, 11])

    def test_a_lost_message_stands_for_as_many_as_the_prescale_says(self):
        self.load("source", "src", period_ms=0.2, payload=100_000)
        granted = self.control.attach("src.newest", "viewer", NEWEST, prescale=3)
        link = self.link(granted)
        link.pays = False
        last = link.open(granted) - 2  # the first one after it comes
        self.eventually(lambda: self.port("src.newest").dropped > 0, "the provider never ran out of credit")
        link.pays = True
        lost_in_all = 0
        for _ in range(3 * wire_client.WINDOW // 100_000):
            sequence, _, lost = self.next_object(link, granted.wire)
            self.assertEqual(sequence, last + 3 * (lost + 1))
            last, lost_in_all = sequence, lost_in_all + lost
        self.assertGreater(lost_in_all, 0)

    def test_an_object_above_64_mib_is_a_step_that_nothing_tells(self):
        self.load("pourer", "src", "far", count=3)
        self.eventually(lambda: self.port("src.samples").messages == 3, "the source has not put three samples")
        link, wire, start = self.attach("src.samples", NEWEST)
        self.assertEqual(start, 3)
        for count, payload in ((4, wire_client.LARGEST + 1), (6, 0)):
            self.set("src", count=count, payload=payload)
            for mode in ("neutral", "active"):
                self.state("src", mode)
            self.eventually(lambda: self.port("src.outcome").messages == count, "the source has not put them")
        self.assertEqual([self.next_object(link, wire)[0::2] for _ in range(2)], [(5, 0), (6, 0)])
        self.assertEqual((self.port("src.samples").refused, self.status("far").links.too_large), (1, 1))

    def test_a_silent_provider_speaks_again_and_one_that_is_not_active_says_so(self):
        self.load("source", "src", period_ms=1.0, count=3)
        link, wire, _ = self.attach("src.leased", LEASED)
        self.assertFalse(self.next_of(link, wire, "lease")[0].lease.held)
        late, other, start = self.attach("src.leased", LEASED, client="late")
        self.assertEqual(late.next(other)[0].WhichOneof("what"), "lease")  # and no last value, though there is one
        self.set("src", count=0)
        for mode in ("neutral", "active"):
            self.state("src", mode)
        while not (frame := self.next_of(link, wire, "lease")[0]).lease.held:
            self.assertIn(frame.lease.reason, ("is not active", "has been silent for 100 ms"))
        self.assertEqual(self.next_object(link, wire)[0], start + 1)
        self.state("src", "neutral")
        self.assertEqual(self.next_of(link, wire, "lease")[0].lease.reason, "is not active")

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
        self.state("oracle", "neutral")
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

    def ring(self, link, wire, number, continuous=True, **threshold):
        frame = wire_pb2.Frame(wire=wire, request=wire_pb2.Request(id=number, continuous=continuous))
        link.send(frame, test_pb2.Threshold(**threshold).SerializeToString())

    def test_an_activation_that_ends_for_its_providers_sake_ends_with_an_answer(self):
        self.load("source", "src", "far", period_ms=1.0, count=10)
        link, wire, _ = self.attach("src.bell", BELL)
        self.eventually(lambda: self.port("src.bell").messages == 10, "the source has not put ten states")
        self.ring(link, wire, 1, every=1, throw_at=13)
        self.assertEqual(link.next(wire)[0].fired.sequence, 0)
        self.set("src", count=15)
        for mode in ("neutral", "active"):
            self.state("src", mode)
        self.assertEqual([link.next(wire)[0].fired.sequence for _ in range(2)], [1, 2])
        answer, _ = self.answer(link, wire)
        self.assertEqual((answer.id, answer.outcome), (1, REJECTED))
        self.assertIn("asked to throw", answer.reason)
        self.state("src", "neutral")
        self.ring(link, wire, 2, every=1)
        answer, _ = self.answer(link, wire)
        self.assertEqual((answer.id, answer.outcome, answer.reason), (2, NOT_ACTIVE, "mode neutral"))

    def test_an_event_port_has_1024_activations_and_no_more(self):
        self.load("source", "src", period_ms=1e4)
        link, wire, _ = self.attach("src.bell", BELL)
        for number in range(1, 1026):
            self.ring(link, wire, number, every=1_000_000)
        for number in range(1, 1025):
            fired = link.next(wire)[0].fired
            self.assertEqual((fired.id, fired.sequence), (number, 0))
        answer, _ = self.answer(link, wire)
        self.assertEqual((answer.id, answer.outcome), (1025, REJECTED))
        self.assertEqual(answer.reason, "the port has all the activations that it can hold")

    def test_a_send_that_is_not_acknowledged_and_not_taken_is_counted_and_told_to_nobody(self):
        self.load("sink", "sink")
        link, wire, _ = self.attach("sink.orders", ORDER)
        link.send(wire_pb2.Frame(wire=wire, object=wire_pb2.Object(sequence=1)), b"\xff\xff")
        self.eventually(lambda: self.port("sink.orders").refused == 1, "it was not counted")
        with self.assertRaises(TimeoutError):
            link.receive(0)

    def test_requests_that_are_open_at_a_provider_that_ends_end_with_its_wires(self):
        self.load("answerer", "oracle", "far")
        self.load("source", "src", "far")
        self.load("source", "stays", "far")  # with its process the link would end, and nothing be told over it
        granted = [self.control.attach(port, "viewer", service) for port, service in (
            ("oracle.echo", ECHO), ("src.bell", BELL), ("stays.last", LAST))]
        link = self.link(granted[0])
        for one in granted:
            link.open(one)
        echo, bell = granted[0].wire, granted[1].wire
        self.ask(link, echo, 1, manner="never")
        self.ring(link, bell, 1, every=1_000_000)
        self.assertEqual(link.next(bell)[0].fired.sequence, 0)
        for name in ("oracle", "src"):
            self.change(unload=control_pb2.Unload(instance=name))
        self.assertEqual([link.next(wire)[0].closed.reason for wire in (echo, bell)], ["'oracle' has ended", "'src' has ended"])
        self.assertFalse(link.frames[echo] or link.frames[bell])


if __name__ == "__main__":
    real_host.run()
