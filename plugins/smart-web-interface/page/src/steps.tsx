import { useRef } from "preact/hooks";

import type { Instruction } from "./model";
import type { Step } from "./route";
import { inert, metres, turnOf } from "./text";

const kArrow = "M12 3 19 11H15V21H9V11H5Z";
const kIcons: Record<string, string> = {
  lift: "M5 3h14v18H5zM12 3v18M8.5 10 7 12h3zM15.5 14 17 12h-3z",
  stairs: "M4 20h4v-4h4v-4h4V8h4V4",
  arrive: "M12 21C7 15 6 12 6 9.500a6 6 0 0 1 12 0C18 12 17 15 12 21ZM12 7.500v4",
  level: "M12 20V4M6 10l6-6 6 6",
  lost: "M9 9a3 3 0 1 1 4 3c-1 .500-1 1-1 2M12 18v.100",
  door: "M6 21V3h12v18M14 12h.100",
};

function Icon({ kind, hour }: { kind: string; hour?: number }) {
  const path = kIcons[kind];
  if (path) return <svg class="icon line" viewBox="0 0 24 24" aria-hidden="true"><path d={path} /></svg>;
  if (hour === undefined) return <svg class="icon" viewBox="0 0 24 24" aria-hidden="true"><circle cx="12" cy="12" r="4" /></svg>;
  return (
    <svg class="icon" viewBox="0 0 24 24" aria-hidden="true">
      <path d={kArrow} transform={`rotate(${(hour % 12) * 30} 12 12)`} />
    </svg>
  );
}

const kKinds: Record<string, string> = {
  LIFT: "lift", STAIRS: "stairs", ESCALATOR: "stairs", RAMP: "level", ARRIVE: "arrive", DOOR: "door", ENTER: "door", LEAVE: "door",
  NO_PATH: "lost", LOST: "lost", REROUTE: "lost", KIND_UNSPECIFIED: "lost",
};

const wordsOf = (instruction: Instruction): string =>
  inert(instruction.text) || (instruction.hour ? turnOf(instruction.hour) : "No direction is known");

/// What is to be done now: what the guide says, else what the way itself says; or why nothing is known of it (`unknown`), which
/// is never shown as "straight on". The arrow is that of the words: who has turned as they say would else read "turn right"
/// beside one that points ahead. The map shows which way one looks.
///
/// What is announced stays in the page, for a screen reader hears of what changes in it alone; and the guide repeats itself
/// under another number, which puts the same words into it anew.
export function Now({ unknown, instruction, next, ahead }: { unknown: string; instruction: Instruction | null; next: Step | null; ahead: number | null }) {
  const told = useRef<{ text?: string; hour?: number }>({});
  const guide = unknown ? null : instruction;
  const step = unknown || guide ? null : next;
  const text = unknown || (guide ? wordsOf(guide) : (step?.text ?? ""));
  if (told.current.text !== text) told.current = { text, hour: guide?.hour ?? step?.hour };
  const kind = unknown ? "lost" : guide ? (kKinds[guide.kind] ?? "walk") : (step?.kind ?? "walk");
  const distance = guide ? guide.distance : step ? (ahead ?? undefined) : undefined;
  return (
    <section class={unknown ? "now unknown" : text ? "now" : "hidden"} aria-label="Now">
      {text ? <Icon kind={kind} hour={told.current.hour} /> : null}
      <div>
        <p class="text" lang={guide?.language || undefined} role="status">
          <span key={guide ? guide.number : text}>{text}</span>
        </p>
        {distance !== undefined && distance >= 1 && <p class="distance">in {metres(distance)}</p>}
      </div>
    </section>
  );
}

/// Those that are still to be done, the current one first.
export function Steps({ steps, current, total }: { steps: Step[]; current: number; total: number }) {
  return (
    <section class="steps" aria-labelledby="steps">
      <h2 id="steps">Steps <small>{metres(total)} to go</small></h2>
      <ol>
        {steps.slice(current).map((step, i) => (
          <li key={current + i} aria-current={i === 0 ? "step" : undefined}>
            <Icon kind={step.kind} hour={step.hour} />
            <span>{step.text}</span>
          </li>
        ))}
      </ol>
    </section>
  );
}
