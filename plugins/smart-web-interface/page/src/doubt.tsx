import { useEffect, useRef, useState } from "preact/hooks";
import type { Ellipse, Instruction, Location, Status } from "./model";

const kUncertain_m = 8; // semi-axis of the 95 % region above which doors are guesses
const kSettled_ms = 1500;

/// Why the position must not be trusted; empty: it may.
export function doubtOf(connected: boolean, status: Status | null, location: Location | null, guide: Instruction | null): string {
  if (!connected) return "";
  if (!status) return "Position not known yet";
  const reasons: Record<string, string> = {
    lost: "Position uncertain: localisation was lost",
    waiting: "Position uncertain: localisation is not there yet",
    unwired: "No localisation in this system",
  };
  const reason = reasons[status.location];
  if (reason) return reason;
  if (!location?.valid) return "Position uncertain";
  // Who guides knows more: that the place has just jumped, say.
  const unsure = guide?.uncertain || !location.ellipse || location.ellipse.major > kUncertain_m;
  return unsure ? "Position uncertain" : "";
}

/// A doubt is over once it has been gone for a while: at its edge it would come and go with each position.
export function useSettled(doubt: string): string {
  const [settled, setSettled] = useState(doubt);
  useEffect(() => {
    if (doubt) return setSettled(doubt);
    const timer = setTimeout(() => setSettled(""), kSettled_ms);
    return () => clearTimeout(timer);
  }, [doubt]);
  return doubt || settled;
}

const within = (region: Ellipse): string => `within ${Math.max(1, Math.round(region.major))} m`;

/// The doubt is announced when it begins, and that it is over, with how far the place may be off then: "again" where the
/// place was known before. How far it may be off changes with each position, and is therefore beside what is announced.
export function Doubt({ told, connected, location }: { told: string; connected: boolean; location: Location | null }) {
  const doubted = useRef(false);
  const known = useRef(false);
  const over = useRef("");
  if (told) doubted.current = true;
  if (told || !connected) {
    over.current = "";
  } else if (location?.ellipse) {
    if (doubted.current) over.current = `Position known${known.current ? " again" : ""}, ${within(location.ellipse)}.`;
    doubted.current = false;
    known.current = true;
  }
  const region = told === "Position uncertain" && location?.valid ? location.ellipse : undefined;
  return (
    <>
      <div class={told ? "doubt" : "hidden"}>
        <p role="alert" class="uncertain">{told}</p>
        {region && <p class="within">{within(region)}</p>}
      </div>
      <p role="status" class="hidden">{over.current}</p>
    </>
  );
}
