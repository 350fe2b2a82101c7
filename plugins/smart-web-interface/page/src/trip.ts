import { useEffect, useRef, useState } from "preact/hooks";
import type { Destination, Instruction } from "./model";

/// Where one is led, as far as the page knows.
export interface Trip {
  to: Destination;
  mine: boolean; // this page has sent it, as `user`, and nobody sent another one since
  user: string | null;
  begun: boolean; // there was a way to it
  again: boolean; // it was sent once more since it was picked
  over: boolean; // one has arrived, or was logged out
}

const kTrip = "fiona-trip";
const kNear_m = 1;
const kGone_ms = 2000;
const kTold_ms = 8000;

const isSame = (a: Destination, b: Destination): boolean => a.level === b.level && Math.hypot(a.x - b.x, a.y - b.y) < kNear_m;

/// Kept for who reloads. A way that leads elsewhere is another trip: somebody else has sent it.
export function useTrip(goal: Destination | null, guide: Instruction | null): [Trip | null, (sent: Trip | null) => void] {
  const [trip, setTrip] = useState<Trip | null>(() => JSON.parse(sessionStorage.getItem(kTrip) ?? "null"));
  // What is still told of the trip before this one tells nothing of this one.
  const before = useRef<{ goal: Destination | null; number?: number }>({ goal: null });
  useEffect(() => {
    if (trip) sessionStorage.setItem(kTrip, JSON.stringify(trip));
    else sessionStorage.removeItem(kTrip);
  }, [trip]);
  useEffect(() => {
    if (goal && goal === before.current.goal) return;
    before.current.goal = null;
    if (!goal) return;
    if (!trip || !isSame(trip.to, goal)) setTrip({ to: goal, mine: false, user: null, begun: true, again: false, over: false });
    else if (!trip.begun || trip.to.label !== (goal.label || trip.to.label)) setTrip({ ...trip, begun: true, to: goal.label ? goal : trip.to });
  }, [goal, trip]);
  useEffect(() => {
    if (guide && guide.number === before.current.number) return;
    before.current.number = undefined;
    if (guide?.kind === "ARRIVE") setTrip((one) => one && { ...one, over: true });
    if (guide?.kind === "NO_PATH") setTrip((one) => one && { ...one, begun: false });
  }, [guide]);
  const send = (sent: Trip | null) => {
    before.current = { goal, number: guide?.number };
    setTrip(sent);
  };
  return [trip, send];
}

/// A guide that was started again knows of no trip, and tells nothing. The page that has sent it sends it again, once for each
/// pick, for a destination may be what ends the guide; others wait whether that page does.
export function useRestart(gone: boolean, trip: Trip | null, sendAgain: () => void): "" | "led again" | "not led" {
  const [told, setTold] = useState<"" | "led again" | "not led">("");
  const sends = !!trip?.mine && !trip.again;
  useEffect(() => {
    if (!gone) return;
    const timer = setTimeout(() => {
      setTold(sends ? "led again" : "not led");
      if (sends) sendAgain();
    }, sends ? kGone_ms : 2 * kGone_ms);
    return () => clearTimeout(timer);
  }, [gone, sends]);
  useEffect(() => {
    if (told === "not led" && !gone) setTold("");
    if (told !== "led again") return;
    const timer = setTimeout(() => setTold(""), kTold_ms);
    return () => clearTimeout(timer);
  }, [told, gone]);
  return told;
}
