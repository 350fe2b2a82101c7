import type { BuildingMap, Destination, Location, Path, Waypoint } from "./model";
import { levelName, metres, roomName, turnOf } from "./text";

export interface Step {
  text: string;
  hour?: number;
  kind: "walk" | "turn" | "door" | "lift" | "stairs" | "level" | "arrive";
  at: number; // metres along the path
}

export interface Progress {
  along: number; // metres of the path behind the walker
  heading: number | null; // radians counter-clockwise from east: where the path goes from here
  off: number; // metres from the path
}

const kShortest_m = 2.2;
const kShortestStretch_m = 0.1; // that has a direction

const length = (a: Waypoint, b: Waypoint): number => Math.hypot(b[0] - a[0], b[1] - a[1]);
const sameLevel = (a?: number, b?: number): boolean => (a ?? 0) === (b ?? 0);

/// Where on the path the walker is: the nearest point of what is on the walker's level.
export function progressOf(path: Path, location: Location | null): Progress | null {
  if (!path.valid || path.points.length < 2 || !location) return null;
  const level = Math.round((location.level ?? 0) * 2) / 2;
  let best: Progress | null = null;
  let behind = 0;
  path.points.slice(1).forEach((to, i) => {
    const from = path.points[i]!;
    const long = length(from, to);
    const near = Math.min(Math.abs((from[2] ?? 0) - level), Math.abs((to[2] ?? 0) - level)) < 0.51;
    if (near && long > 0) {
      const share = ((location.x - from[0]) * (to[0] - from[0]) + (location.y - from[1]) * (to[1] - from[1])) / long ** 2;
      const t = Math.min(1, Math.max(0, share));
      const off = Math.hypot(from[0] + t * (to[0] - from[0]) - location.x, from[1] + t * (to[1] - from[1]) - location.y);
      if (!best || off < best.off) {
        best = { along: behind + t * long, heading: Math.atan2(to[1] - from[1], to[0] - from[0]), off };
      }
    }
    behind += long;
  });
  return best;
}

/// Bends of less than half a metre are how a path hugs corners, not turns.
function simplified(points: Waypoint[]): Waypoint[] {
  if (points.length < 3) return points;
  const first = points[0]!;
  const last = points[points.length - 1]!;
  const long = length(first, last) || 1;
  let worst = 0;
  let at = 0;
  points.forEach((point, i) => {
    const off = Math.abs((last[0] - first[0]) * (point[1] - first[1]) - (last[1] - first[1]) * (point[0] - first[0])) / long;
    if (i > 0 && i < points.length - 1 && off > worst) [worst, at] = [off, i];
  });
  if (worst < 0.5) return [first, last];
  return [...simplified(points.slice(0, at + 1)).slice(0, -1), ...simplified(points.slice(at))];
}

/// Two bends close to each other, as before and behind a door, are one to who walks.
function withoutJogs(points: Waypoint[]): Waypoint[] {
  const kept = [...points];
  for (let i = 1; i + 2 < kept.length; ) {
    const a = kept[i]!;
    const b = kept[i + 1]!;
    if (length(a, b) < kShortest_m) kept.splice(i, 2, [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2, a[2]]);
    else i += 1;
  }
  return simplified(kept);
}

/// A lift or stairs: what the map has where the path leaves its level.
function connectorAt(point: Waypoint, map: BuildingMap | null): "lift" | "stairs" | "level" {
  const inside = (map?.rooms ?? []).find(
    (room) =>
      (room.kind === "LIFT_SHAFT" || room.kind === "STAIRWELL") &&
      sameLevel(room.level, Math.round(point[2] ?? 0)) &&
      contains(room.outline, point),
  );
  return inside ? (inside.kind === "LIFT_SHAFT" ? "lift" : "stairs") : "level";
}

function contains(ring: [number, number][], [x, y]: Waypoint): boolean {
  let inside = false;
  ring.forEach(([x1, y1], i) => {
    const [x2, y2] = ring[(i + 1) % ring.length]!;
    if (y1 > y !== y2 > y && x < ((x2 - x1) * (y - y1)) / (y2 - y1) + x1) inside = !inside;
  });
  return inside;
}

const area = (ring: [number, number][]): number =>
  Math.abs(ring.reduce((sum, [x, y], i) => sum + x * ring[(i + 1) % ring.length]![1] - y * ring[(i + 1) % ring.length]![0], 0)) / 2;

/// Where a path leads, with the name of the smallest room there.
export function goalOf(path: Path | null, map: BuildingMap | null): Destination | null {
  const end = path?.valid ? path.points[path.points.length - 1] : undefined;
  if (!end) return null;
  const [room] = (map?.rooms ?? [])
    .filter((one) => sameLevel(one.level, end[2]) && contains(one.outline, end) && !one.holes.some((hole) => contains(hole, end)))
    .sort((one, other) => area(one.outline) - area(other.outline));
  return { x: end[0], y: end[1], level: end[2] ?? 0, label: room ? roomName(room) : "" };
}

interface Piece {
  points: Waypoint[];
  first: number; // of the points, in the path
  begin: number; // metres along the path
  before?: Waypoint; // where the path comes from
}

/// The pieces of a path between changes of level.
function pieces(path: Path): Piece[] {
  const all: Piece[] = [];
  let behind = 0;
  path.points.forEach((point, i) => {
    const before = path.points[i - 1];
    if (before) behind += length(before, point);
    const piece = all[all.length - 1];
    if (before && piece && sameLevel(before[2], point[2])) piece.points.push(point);
    else all.push({ points: [point], first: i, begin: behind, before });
  });
  return all;
}

const kPassages: Record<string, [action: string, kind: Step["kind"]]> = {
  DOOR: ["go through the door", "door"], STAIRS: ["take the stairs", "stairs"], ESCALATOR: ["take the escalator", "stairs"],
};
const kClimbs: Record<string, [action: string, kind: Step["kind"]]> = {
  LIFT: ["Take the lift", "lift"], ESCALATOR: ["Take the escalator", "stairs"], STAIRS: ["Take the stairs", "stairs"], RAMP: ["Take the ramp", "level"],
};

/// How one gets from level to level: as the path tells it, else by what the map has at its ends.
function climbOf(legs: string[], from: Waypoint, to: Waypoint, map: BuildingMap | null): [action: string, kind: Step["kind"]] {
  const told = legs.find((leg) => kClimbs[leg]);
  if (told) return kClimbs[told]!;
  const kind = connectorAt(from, map) === "level" ? connectorAt(to, map) : connectorAt(from, map);
  return kind === "lift" ? kClimbs["LIFT"]! : kind === "stairs" ? kClimbs["STAIRS"]! : ["Go", "level"];
}

/// The parts of a piece that one walks, and between them the doors and stairs that one passes.
function parts(piece: Piece, legs: string[]): { passage?: string; points: Waypoint[] }[] {
  const all: { passage?: string; points: Waypoint[] }[] = [];
  piece.points.slice(1).forEach((to, i) => {
    const leg = legs[piece.first + i] ?? "";
    const passage = kPassages[leg] && leg;
    const part = all[all.length - 1];
    if (part && part.passage === passage) part.points.push(to);
    else all.push({ passage, points: [piece.points[i]!, to] });
  });
  return all;
}

const sumOf = (points: Waypoint[]): number => points.reduce((sum, point, i) => (i ? sum + length(points[i - 1]!, point) : 0), 0);

/// What one does on a level, where one comes from `came`.
function walked(piece: Piece, legs: string[], came: Waypoint | undefined): Step[] {
  const steps: Step[] = [];
  let at = piece.begin;
  let leg = piece.first;
  const all = parts(piece, legs);
  all.forEach(({ passage, points }, part) => {
    const behind = legs[leg + points.length - 1] === "OUTDOORS";
    const before = legs[leg - 1] === "OUTDOORS";
    if (passage) {
      const [action, kind] = kPassages[passage]!;
      const turn = came && hourBetween(came, points[0]!, points[points.length - 1]!);
      const told = passage !== "DOOR" || behind === before ? action : behind ? "go outdoors" : "go inside";
      const text = turn && turn !== 12 ? `${turnOf(turn)} and ${told}` : told.charAt(0).toUpperCase() + told.slice(1);
      steps.push({ text, kind, at });
      came = points[points.length - 2];
    } else {
      const bends = withoutJogs(simplified(points));
      let end = at;
      const passed = all[part + 1]?.points;
      bends.slice(1).forEach((to, k) => {
        const from = bends[k]!;
        const ahead = length(from, to);
        const begin = end;
        end += ahead;
        const turn = came && hourBetween(came, from, to);
        // Some steps straight to a door or straight behind one are told with it.
        const leads = k === bends.length - 2 && passed && [11, 12, 1].includes(hourBetween(from, to, passed[passed.length - 1]!));
        const goesOn = k === 0 && part > 0 && turn === 12;
        if (turn && (leads || goesOn) && ahead < kShortest_m) return;
        const walk = metres(ahead);
        if (!turn) steps.push({ text: `Walk ${walk}`, kind: "walk", at: begin });
        else if (turn !== 12) steps.push({ text: `${turnOf(turn)}, then ${walk}`, hour: turn, kind: "turn", at: begin });
        else steps.push({ text: `Straight on for ${walk}`, hour: 12, kind: "walk", at: begin });
        if (ahead > kShortestStretch_m) came = from;
      });
    }
    at += sumOf(points);
    leg += points.length - 1;
  });
  return steps;
}

/// The whole way in words, for who does not see the plan.
export function stepsOf(path: Path, map: BuildingMap | null, destination: string): Step[] {
  const steps: Step[] = [];
  if (!path.valid || path.points.length < 2) return steps;
  const legs = path.legs ?? [];
  // Landings are levels of their own on the way, and no place to stay: no room is on them.
  const isFloor = (level?: number) => !map || map.rooms.some((room) => sameLevel(room.level, level));
  const all = pieces(path);
  const stays = all.filter(
    (piece, i) => i === 0 || i === all.length - 1 || (piece.points.length > 1 && isFloor(piece.points[0]![2])),
  );
  let end = 0;
  stays.forEach((piece, i) => {
    const before = stays[i - 1];
    let cameFrom: Waypoint | undefined;
    if (before) {
      const from = before.points[before.points.length - 1]!;
      const to = piece.points[0]!;
      const [action, kind] = climbOf(legs.slice(before.first + before.points.length - 1, piece.first), from, to, map);
      steps.push({ text: `${action} to ${levelName(to[2] ?? 0, map?.levels ?? [])}`, kind, at: end });
      // In a lift one turns around as one likes.
      if (kind !== "lift" && piece.before && length(piece.before, to) > kShortestStretch_m) cameFrom = piece.before;
    }
    steps.push(...walked(piece, legs, cameFrom));
    end = piece.begin + sumOf(piece.points);
  });
  steps.push({ text: `Arrive${destination ? ` at ${destination}` : ""}`, kind: "arrive", at: end });
  return steps;
}

function hourBetween(a: Waypoint, b: Waypoint, c: Waypoint): number {
  const left = Math.atan2(c[1] - b[1], c[0] - b[0]) - Math.atan2(b[1] - a[1], b[0] - a[0]);
  const hour = Math.round((-left * 6) / Math.PI);
  return ((hour % 12) + 12) % 12 || 12;
}

export const pathLength = (path: Path): number => sumOf(path.points);
