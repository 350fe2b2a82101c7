import { useEffect, useRef, useState } from "preact/hooks";
import type { BuildingMap, Location, Point, Wall } from "./model";
import { shownLevel } from "./plan";
import { inert } from "./text";

const kPassing_m = 3;
const kPassed_m = 6;
const kTold_ms = 8000;

interface Place {
  x: number;
  y: number;
}

const side = (a: Place, b: Place, x: number, y: number): number => (b.x - a.x) * (y - a.y) - (b.y - a.y) * (x - a.x);

function crosses(a: Place, b: Place, [x1, y1, x2, y2]: Wall): boolean {
  const [from, to] = [{ x: x1, y: y1 }, { x: x2, y: y2 }];
  return side(a, b, x1, y1) * side(a, b, x2, y2) <= 0 && side(from, to, a.x, a.y) * side(from, to, b.x, b.y) < 0;
}

const walled = (a: Place, b: Point, map: BuildingMap): boolean => map.walls.some((wall) => wall[4] === b.level && crosses(a, b, wall));

/// The points that are passed are told once, on their own level and on this side of a wall, and again after the walker has
/// been away. A guide that leads tells them itself: `led`.
export function usePassing(points: Point[], location: Location | null, map: BuildingMap | null, led: boolean): string[] {
  const near = useRef(new Set<string>());
  const [told, setTold] = useState<string[]>([]);
  useEffect(() => {
    if (!location?.valid || !map) return;
    const passed = points.filter((point) => {
      const key = `${point.x},${point.y},${point.level}`;
      const away = Math.hypot(point.x - location.x, point.y - location.y);
      const same = shownLevel(location.level, map) === point.level;
      if (!same || away > kPassed_m) near.current.delete(key);
      if (!same || away > kPassing_m || near.current.has(key) || walled(location, point, map)) return false;
      near.current.add(key);
      return true;
    });
    if (passed.length && !led) setTold(passed.map((point) => `You are passing ${inert(point.name) || "a point of attention"}.`));
  }, [points, location, map, led]);
  useEffect(() => {
    if (!told.length) return;
    const timer = setTimeout(() => setTold([]), kTold_ms);
    return () => clearTimeout(timer);
  }, [told]);
  return led ? [] : told;
}

/// Texts with their languages. Each is announced by itself: those that are still shown are not read again, nor are those that a
/// guide tells, too, whom another page of the same user has sent the destination.
export function Passing({ told }: { told: Map<string, string> }) {
  return (
    <div role="status" aria-atomic={false} class="passing">
      {[...told].map(([text, language]) => <p key={text} lang={language || undefined}>{text}</p>)}
    </div>
  );
}
