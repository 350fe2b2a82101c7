import { useEffect, useMemo, useRef, useState } from "preact/hooks";
import type { BuildingMap, Destination, Location, Path, Point, Room } from "./model";
import type { Progress } from "./route";
import { inert, levelName } from "./text";

interface View {
  x: number;
  y: number;
  span: number; // metres from left to right of what is meant to be seen
}

interface Props {
  map: BuildingMap;
  location: Location | null;
  place: Location | null; // the last one that was valid
  certain: boolean;
  path: Path | null;
  progress: Progress | null;
  destination: Destination | null;
  chosen: Destination | null; // just now, on this page
  points: Point[];
}

/// The first two pointers on the plan count: where they are, and where they and the view were when their number changed last.
interface Drag {
  from: Map<number, Place>;
  to: Map<number, Place>;
  view: View;
  tap: boolean; // one pointer alone, which has not moved
}

interface Place {
  x: number;
  y: number;
}

/// What lies between them, and how far they are apart.
function spanned([a, b]: Place[]): Place & { apart: number } {
  return b ? { x: (a!.x + b.x) / 2, y: (a!.y + b.y) / 2, apart: Math.hypot(a!.x - b.x, a!.y - b.y) } : { ...a!, apart: 0 };
}

const kClosest = 8;
const kTap_px = 4;
const kFollowSpan = 34;
const kMargin_m = 2;

const at = (x: number, y: number): string => `${x.toFixed(2)} ${(-y).toFixed(2)}`;
const ring = (points: [number, number][]): string => (points.length ? `M${points.map(([x, y]) => at(x, y)).join("L")}Z` : "");

function extent(map: BuildingMap): View & { ratio: number } {
  const points = map.rooms.flatMap((room) => room.outline).concat(map.walls.flatMap((w) => [[w[0], w[1]], [w[2], w[3]]] as [number, number][]));
  const xs = points.map(([x]) => x);
  const ys = points.map(([, y]) => y);
  const low = (v: number[]): number => v.reduce((a, b) => Math.min(a, b), Infinity);
  const high = (v: number[]): number => v.reduce((a, b) => Math.max(a, b), -Infinity);
  if (!points.length) return { x: 0, y: 0, span: 30, ratio: 1 };
  const width = high(xs) - low(xs) + 2 * kMargin_m;
  const height = high(ys) - low(ys) + 2 * kMargin_m;
  return { x: (high(xs) + low(xs)) / 2, y: (high(ys) + low(ys)) / 2, span: width, ratio: height / width };
}

/// The level of the map that shows a place: a landing belongs to the level below it.
export function shownLevel(level: number | undefined, map: BuildingMap): number {
  const wanted = level ?? 0;
  const floors = map.levels.map((one) => one.level).filter((one) => map.rooms.some((room) => room.level === one));
  return floors.reduce((best, one) => (Math.abs(one - wanted) < Math.abs(best - wanted) ? one : best), floors[0] ?? 0);
}

/// The name in as many lines as fit, else the number on the door, else nothing.
function labelOf(room: Room, size: number): string[] {
  const span = (values: number[]) => Math.max(...values) - Math.min(...values);
  const width = span(room.outline.map(([x]) => x)) - 0.4;
  const height = span(room.outline.map(([, y]) => y)) - 0.3;
  const fits = (lines: string[]) => lines.length * size * 1.15 <= height && lines.every((line) => line.length * size * 0.58 <= width);
  const name = inert(room.name);
  const ref = name.includes(inert(room.ref)) ? "" : inert(room.ref);
  const words = name.split(" ");
  const two = words.map((_, i) => [words.slice(0, i).join(" "), words.slice(i).join(" ")]).slice(1);
  const inTwo = two.sort((one, other) => Math.max(...one.map((l) => l.length)) - Math.max(...other.map((l) => l.length)))[0];
  const tries = [[name, ref], [name], ...(inTwo ? [inTwo] : []), words, [inert(room.ref)]].map((lines) => lines.filter(Boolean));
  return tries.find((lines) => lines.length > 0 && fits(lines)) ?? [];
}

function Rooms({ map, level, pixel }: { map: BuildingMap; level: number; pixel: number }) {
  const rooms = useMemo(() => map.rooms.filter((room) => room.level === level), [map, level]);
  const size = Math.min(12.5 * pixel, 1.3);
  const label = (room: Room) => {
    const lines = labelOf(room, size);
    return (
      <text key={room.id} class="room-name" font-size={size}>
        {lines.map((line, i) => (
          <tspan key={i} x={room.x} y={-room.y + (i - (lines.length - 1) / 2) * size * 1.15}>
            {line}
          </tspan>
        ))}
      </text>
    );
  };
  return (
    <>
      {rooms.map((room) => (
        <path key={room.id} class={`room ${room.kind.toLowerCase()}`} d={ring(room.outline) + room.holes.map(ring).join("")} fill-rule="evenodd" />
      ))}
      {map.walls
        .filter((wall) => wall[4] === level)
        .map((wall, i) => (
          <path key={i} class={wall[5] ? "wall exterior" : "wall"} d={`M${at(wall[0], wall[1])}L${at(wall[2], wall[3])}`} />
        ))}
      {map.entrances
        .filter((entrance) => entrance.level === level)
        .map((entrance, i) => (
          <circle key={i} class="entrance" cx={entrance.x} cy={-entrance.y} r={5 * pixel} />
        ))}
      {rooms.map(label)}
    </>
  );
}

/// The way on this level: what lies behind is faint, arrows show where it goes.
function Way({ path, level, map, progress, pixel }: { path: Path; level: number; map: BuildingMap; progress: Progress | null; pixel: number }) {
  const lines: { done: boolean; d: string }[] = [];
  const arrows: { x: number; y: number; angle: number }[] = [];
  let behind = 0;
  let next = 24 * pixel;
  path.points.slice(1).forEach((to, i) => {
    const from = path.points[i]!;
    const long = Math.hypot(to[0] - from[0], to[1] - from[1]);
    const here = shownLevel(from[2], map) === level && shownLevel(to[2], map) === level;
    if (here) {
      const done = progress ? Math.min(1, Math.max(0, (progress.along - behind) / (long || 1))) : 0;
      const middle: [number, number] = [from[0] + done * (to[0] - from[0]), from[1] + done * (to[1] - from[1])];
      if (done > 0) lines.push({ done: true, d: `M${at(from[0], from[1])}L${at(middle[0], middle[1])}` });
      if (done < 1) lines.push({ done: false, d: `M${at(middle[0], middle[1])}L${at(to[0], to[1])}` });
    }
    for (; next < behind + long; next += 34 * pixel) {
      const share = (next - behind) / long;
      if (!here || (progress && next < progress.along + 1)) continue;
      arrows.push({
        x: from[0] + share * (to[0] - from[0]),
        y: from[1] + share * (to[1] - from[1]),
        angle: (-Math.atan2(to[1] - from[1], to[0] - from[0]) * 180) / Math.PI,
      });
    }
    behind += long;
  });
  const width = 8 * pixel;
  return (
    <>
      {lines.map((line, i) => (
        <path key={`c${i}`} class="way-casing" d={line.d} stroke-width={width * 1.5} />
      ))}
      {lines.map((line, i) => (
        <path key={`w${i}`} class={line.done ? "way done" : "way"} d={line.d} stroke-width={width} />
      ))}
      {arrows.map((arrow, i) => (
        <path
          key={`a${i}`}
          class="way-arrow"
          d="M-0.35 -0.35 0.1 0 -0.35 0.35"
          transform={`translate(${at(arrow.x, arrow.y)}) rotate(${arrow.angle}) scale(${width * 0.8})`}
        />
      ))}
    </>
  );
}

function Walker({ location, certain, progress, pixel }: { location: Location; certain: boolean; progress: Progress | null; pixel: number }) {
  const size = 10 * pixel;
  const ellipse = location.ellipse;
  const heading = progress && progress.off < 5 ? progress.heading : null;
  return (
    <g class={certain ? "walker" : "walker uncertain"} data-measured={location.measured}>
      {ellipse && (
        <ellipse
          class="region"
          rx={Math.max(ellipse.major, 0.1)}
          ry={Math.max(ellipse.minor, 0.1)}
          transform={`translate(${at(location.x, location.y)}) rotate(${(-ellipse.angle * 180) / Math.PI})`}
        />
      )}
      <g transform={`translate(${at(location.x, location.y)}) scale(${size})`}>
        {heading !== null && (
          <path class="heading" d="M0.9 -0.75 2.1 0 0.9 0.75Z" transform={`rotate(${(-heading * 180) / Math.PI})`} />
        )}
        <circle class="dot" r={0.85} />
      </g>
    </g>
  );
}

export function Plan({ map, location, place, certain, path, progress, destination, chosen, points }: Props) {
  const whole = useMemo(() => extent(map), [map]);
  const walkersLevel = place ? shownLevel(place.level, map) : null;
  const [picked, setPicked] = useState<number | null>(null);
  const [following, setFollowing] = useState(true);
  const [view, setView] = useState<View>(whole);
  const [box, setBox] = useState({ width: 400, height: 400 });
  const [near, setNear] = useState(false);
  const drag = useRef<Drag>({ from: new Map(), to: new Map(), view: whole, tap: false });
  const svg = useRef<SVGSVGElement>(null);
  useEffect(() => setView(whole), [whole]);
  useEffect(() => {
    const observer = new ResizeObserver(([entry]) => entry && setBox({ width: entry.contentRect.width, height: entry.contentRect.height }));
    observer.observe(svg.current!);
    return () => observer.disconnect();
  }, []);

  // Who has just chosen where to go wants to see the way from close by.
  useEffect(() => {
    if (chosen) follow();
  }, [chosen]);

  const level = picked ?? walkersLevel ?? shownLevel(0, map);
  const centre = following && near && location?.valid ? { ...view, x: location.x, y: location.y } : view;
  const shown = useRef(centre); // also of a frame that is not drawn yet
  shown.current = centre;
  const levels = [...map.levels].filter((one) => map.rooms.some((room) => room.level === one.level)).reverse();

  const bounded = (span: number) => Math.min(whole.span * 1.5, Math.max(kClosest, span));
  const zoom = (factor: number) => {
    setView({ ...centre, span: bounded(centre.span * factor) });
    setNear(true);
  };
  const move = (dx: number, dy: number) => {
    setFollowing(false);
    setView({ ...centre, x: centre.x + dx, y: centre.y + dy });
  };
  const follow = () => {
    setPicked(null);
    setFollowing(true);
    setNear(true);
    setView({ ...centre, span: Math.min(centre.span, kFollowSpan) });
  };
  const showAll = () => {
    setNear(false);
    setView(whole);
  };
  const keys = (event: KeyboardEvent) => {
    const step = centre.span / 8;
    const actions: Record<string, () => void> = {
      ArrowLeft: () => move(-step, 0),
      ArrowRight: () => move(step, 0),
      ArrowUp: () => move(0, step),
      ArrowDown: () => move(0, -step),
      "+": () => zoom(0.75),
      "-": () => zoom(1.33),
    };
    const action = actions[event.key];
    if (!action) return;
    event.preventDefault();
    action();
  };
  const here = location?.valid ? `You are on ${levelName(walkersLevel ?? 0, map.levels)}.` : "Your position is not known.";
  const width = centre.span;
  const height = centre.span * whole.ratio;
  // Metres of a pixel: what is marked on the plan keeps its size on the screen.
  const pixelOf = (span: number) => Math.max(span / (box.width || 1), (span * whole.ratio) / (box.height || 1));
  const pixel = pixelOf(width);

  const middle = () => {
    const { left, top, width, height } = svg.current!.getBoundingClientRect();
    return { x: left + width / 2, y: top + height / 2 };
  };
  const look = (there: View) => {
    setFollowing(false);
    setView((shown.current = there));
  };
  /// A finger more, or less, goes on from what is shown.
  const regrip = () => {
    drag.current.from = new Map(drag.current.to);
    drag.current.view = shown.current;
  };
  const press = (event: PointerEvent) => {
    if (drag.current.to.size > 1) return;
    svg.current!.setPointerCapture(event.pointerId);
    drag.current.to.set(event.pointerId, { x: event.clientX, y: event.clientY });
    drag.current.tap = drag.current.to.size === 1;
    regrip();
  };
  const dragOn = (event: PointerEvent) => {
    const { from, to, view } = drag.current;
    if (!to.has(event.pointerId)) return;
    to.set(event.pointerId, { x: event.clientX, y: event.clientY });
    const [was, is, mid] = [spanned([...from.values()]), spanned([...to.values()]), middle()];
    if (drag.current.tap && Math.hypot(is.x - was.x, is.y - was.y) < kTap_px) return;
    drag.current.tap = false;
    const span = bounded(view.span * (was.apart && is.apart ? was.apart / is.apart : 1));
    const [before, after] = [pixelOf(view.span), pixelOf(span)];
    look({ x: view.x + (was.x - mid.x) * before - (is.x - mid.x) * after, y: view.y - (was.y - mid.y) * before + (is.y - mid.y) * after, span });
  };
  /// A tap centres the plan there: for who cannot drag.
  const lift = (event: PointerEvent) => {
    if (!drag.current.to.delete(event.pointerId)) return;
    const mid = middle();
    if (drag.current.tap && event.type === "pointerup") {
      look({ ...centre, x: centre.x + (event.clientX - mid.x) * pixel, y: centre.y - (event.clientY - mid.y) * pixel });
    }
    drag.current.tap = false;
    regrip();
  };
  return (
    <section class="plan" aria-label="Floor plan">
      {/* Panned by keys as by pointer, so it takes the focus; what it shows is in the steps as text. */}
      <div
        class="plan-view"
        role="application"
        tabIndex={0}
        aria-label={`Floor plan of ${levelName(level, map.levels)}. ${here} Arrow keys move the plan, plus and minus zoom.`}
        onKeyDown={keys}
      >
        <svg
          ref={svg}
          aria-hidden="true"
          focusable="false"
          viewBox={`${centre.x - width / 2} ${-centre.y - height / 2} ${width} ${height}`}
          onWheel={(event) => {
            event.preventDefault();
            zoom(event.deltaY > 0 ? 1.15 : 0.87);
          }}
          onPointerDown={press}
          onPointerMove={dragOn}
          onPointerUp={lift}
          onPointerCancel={lift}
        >
          <Rooms map={map} level={level} pixel={pixel} />
          {path?.valid && <Way path={path} level={level} map={map} progress={progress} pixel={pixel} />}
          {points
            .filter((point) => point.level === level)
            .map((point, i) => (
              <path key={i} class="point" transform={`translate(${at(point.x, point.y)}) scale(${9 * pixel})`} d="M0 -1 1 0 0 1 -1 0Z" />
            ))}
          {destination && destination.level === level && (
            <g class="destination" transform={`translate(${at(destination.x, destination.y)}) scale(${11 * pixel})`}>
              <path d="M0 0C-1.2 -1.3 -1.3 -1.8 -1.3 -2.3A1.3 1.3 0 0 1 1.3 -2.3C1.3 -1.8 1.2 -1.3 0 0Z" />
              <circle cx="0" cy="-2.3" r="0.5" />
            </g>
          )}
          {location?.valid && walkersLevel === level && <Walker location={location} certain={certain} progress={progress} pixel={pixel} />}
        </svg>
      </div>
      <div class="levels" role="group" aria-label="Level shown">
        {levels.map((one) => (
          <button
            key={one.level}
            type="button"
            aria-pressed={one.level === level}
            class={one.level === walkersLevel ? "here" : ""}
            aria-label={`${one.level}, ${levelName(one.level, map.levels)}${one.level === walkersLevel ? ", where you are" : ""}`}
            onClick={() => setPicked(one.level === walkersLevel ? null : one.level)}
          >
            {one.level}
          </button>
        ))}
      </div>
      <div class="zoom" role="group" aria-label="Plan">
        <button type="button" aria-label="Zoom in" onClick={() => zoom(0.75)}>
          <svg viewBox="0 0 24 24" aria-hidden="true"><path d="M12 5v14M5 12h14" /></svg>
        </button>
        <button type="button" aria-label="Zoom out" onClick={() => zoom(1.33)}>
          <svg viewBox="0 0 24 24" aria-hidden="true"><path d="M5 12h14" /></svg>
        </button>
        <button type="button" aria-label="Show the whole level" onClick={showAll}>
          <svg viewBox="0 0 24 24" aria-hidden="true"><path d="M4 9V4h5M20 9V4h-5M4 15v5h5M20 15v5h-5" /></svg>
        </button>
        <button type="button" aria-label="Follow me" aria-pressed={following && near && picked === null} onClick={follow}>
          <svg viewBox="0 0 24 24" aria-hidden="true"><path d="M12 2v4M12 18v4M2 12h4M18 12h4" /><circle cx="12" cy="12" r="5" /></svg>
        </button>
      </div>
      <p class="level-shown" aria-hidden="true">{levelName(level, map.levels)}</p>
    </section>
  );
}
