// Planning problems of a building, for tests: rooms on floors, a lift that costs, stairs, doors with access levels.
#pragma once

namespace fiona::testing {

inline constexpr const char* kBuildingDomain = R"(
; A person finds the way through a building.
(define (domain building)
  (:requirements :strips :typing :negative-preconditions :equality :action-costs)
  (:types place level - object
          room landing cabin - place
          access-level key - object)
  (:constants lift - cabin)
  (:predicates
    (at ?p - place)
    (door ?a ?b - place)
    (needs-access ?a ?b - place ?l - access-level)
    (may ?l - access-level)
    (locked ?a ?b - place)
    (opens ?k - key ?a ?b - place)
    (lies ?k - key ?p - place)
    (has ?k - key)
    (lift-at ?l - landing)
    (serves ?l - landing)
    (stairs ?a ?b - landing)
    (blocked ?p - place))
  (:functions (total-cost) - number
              (metres ?a ?b - place) - number
              (lift-time ?a ?b - landing) - number)
  (:action walk
    :parameters (?from ?to - (either room landing))
    :precondition (and (at ?from) (door ?from ?to) (not (locked ?from ?to)) (not (blocked ?to)))
    :effect (and (not (at ?from)) (at ?to) (increase (total-cost) (metres ?from ?to))))
  (:action unlock
    :parameters (?k - key ?from ?to - place)
    :precondition (and (at ?from) (has ?k) (opens ?k ?from ?to) (locked ?from ?to))
    :effect (and (not (locked ?from ?to)) (not (locked ?to ?from)) (increase (total-cost) 5)))
  (:action swipe
    :parameters (?l - access-level ?from ?to - place)
    :precondition (and (at ?from) (may ?l) (needs-access ?from ?to ?l) (locked ?from ?to))
    :effect (and (not (locked ?from ?to)) (increase (total-cost) 2)))
  (:action take
    :parameters (?k - key ?p - place)
    :precondition (and (at ?p) (lies ?k ?p))
    :effect (and (has ?k) (not (lies ?k ?p)) (increase (total-cost) 1)))
  (:action climb
    :parameters (?from ?to - landing)
    :precondition (and (at ?from) (stairs ?from ?to))
    :effect (and (not (at ?from)) (at ?to) (increase (total-cost) 30)))
  (:action call-lift
    :parameters (?from ?here - landing)
    :precondition (and (at ?here) (serves ?here) (lift-at ?from) (not (= ?from ?here)))
    :effect (and (not (lift-at ?from)) (lift-at ?here) (increase (total-cost) (lift-time ?from ?here))))
  (:action enter
    :parameters (?here - landing)
    :precondition (and (at ?here) (lift-at ?here))
    :effect (and (not (at ?here)) (at lift) (increase (total-cost) 1.5)))
  (:action ride
    :parameters (?from ?to - landing)
    :precondition (and (at lift) (lift-at ?from) (serves ?to) (not (= ?from ?to)))
    :effect (and (not (lift-at ?from)) (lift-at ?to) (increase (total-cost) (lift-time ?from ?to))))
  (:action leave
    :parameters (?here - landing)
    :precondition (and (at lift) (lift-at ?here))
    :effect (and (not (at lift)) (at ?here) (increase (total-cost) 1.5)))
))";

/// From the foyer on level 0 to the laboratory on level 2, which is locked.
inline constexpr const char* kBuildingProblem = R"(
(define (problem to-the-laboratory)
  (:domain building)
  (:objects foyer office laboratory store - room
            landing-0 landing-1 landing-2 - landing
            key-7 - key staff - access-level)
  (:init (at foyer) (= (total-cost) 0)
    (door foyer landing-0) (door landing-0 foyer) (= (metres foyer landing-0) 8) (= (metres landing-0 foyer) 8)
    (door landing-1 office) (door office landing-1) (= (metres landing-1 office) 4.5) (= (metres office landing-1) 4.5)
    (door landing-2 laboratory) (door laboratory landing-2)
    (= (metres landing-2 laboratory) 6) (= (metres laboratory landing-2) 6)
    (door landing-1 store) (door store landing-1) (= (metres landing-1 store) 3) (= (metres store landing-1) 3)
    (locked landing-2 laboratory) (locked laboratory landing-2)
    (opens key-7 landing-2 laboratory) (lies key-7 office)
    (needs-access landing-2 laboratory staff)
    (stairs landing-0 landing-1) (stairs landing-1 landing-0)
    (stairs landing-1 landing-2) (stairs landing-2 landing-1)
    (lift-at landing-2) (serves landing-0) (serves landing-2)
    (= (lift-time landing-0 landing-2) 20) (= (lift-time landing-2 landing-0) 20))
  (:goal (and (at laboratory) (not (lies key-7 office))))
  (:metric minimize (total-cost))))";

}  // namespace fiona::testing
