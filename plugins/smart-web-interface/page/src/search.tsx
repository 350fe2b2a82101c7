import { useEffect, useMemo, useState } from "preact/hooks";
import type { BuildingMap, Destination, Room } from "./model";
import { levelName, roomName } from "./text";

const kMostShown = 40;
const folded = (text: string): string => text.normalize("NFKD").replace(/\p{M}/gu, "").toLowerCase();

interface Props {
  map: BuildingMap;
  access: number;
  busy: boolean;
  pick: (to: Destination) => void;
}

/// How well a room is what is typed: its name or number, or all of the words in any order; a level's name tells little.
function rankOf(typed: string, room: Room, name: string, level: string): number {
  if (typed && [room.ref, room.name, name].some((one) => folded(one).trim() === typed)) return 0;
  const holds = (text: string) => typed.split(/\s+/).every((word) => folded(text).includes(word));
  const own = `${name} ${room.use.replace(/_/g, " ")}`;
  return holds(own) ? 1 : holds(`${own} ${level}`) ? 2 : 3;
}

/// Rooms that have a name, a number or a use, by what is typed.
export function Search({ map, access, busy, pick }: Props) {
  const [typed, setTyped] = useState("");
  const [open, setOpen] = useState(false);
  const [closed, setClosed] = useState(""); // who asked for that room may not go there
  useEffect(() => setClosed(""), [access]);
  const rooms = useMemo(
    () =>
      map.rooms
        .filter((room) => roomName(room) && room.kind !== "STAIRWELL" && room.kind !== "LIFT_SHAFT" && (room.kind !== "CORRIDOR" || room.name))
        .map((room) => ({ room, name: roomName(room), level: levelName(room.level, map.levels) }))
        .sort((a, b) => a.room.level - b.room.level || a.name.localeCompare(b.name, undefined, { numeric: true })),
    [map],
  );
  const wanted = folded(typed).trim();
  const found = rooms
    .map((one) => ({ ...one, rank: rankOf(wanted, one.room, one.name, one.level) }))
    .filter(({ rank }) => rank < 3)
    .sort((a, b) => a.rank - b.rank);
  const choose = (room: Room, name: string) => {
    if (room.access > access) {
      setClosed(`${name} is not open to you. `);
      return setOpen(true);
    }
    if (busy) return;
    pick({ x: room.x, y: room.y, level: room.level, label: name });
    setOpen(false);
    setTyped("");
    setClosed("");
  };
  return (
    <section class="search" aria-label="Destination">
      <form
        role="search"
        onSubmit={(event) => {
          event.preventDefault();
          const first = found[0];
          if (first && wanted) choose(first.room, first.name);
        }}
      >
        <label for="where">Where to?</label>
        <input
          id="where"
          type="search"
          autocomplete="off"
          enterkeyhint="go"
          placeholder="Room, number or use"
          value={typed}
          onFocus={() => setOpen(true)}
          onInput={(event) => {
            setTyped(event.currentTarget.value);
            setClosed("");
            setOpen(true);
          }}
          onKeyDown={(event) => event.key === "Escape" && setOpen(false)}
        />
      </form>
      {open && (
        <>
          <p class="count" role="status">
            {closed}
            {found.length === 0 ? "No room is called that." : found.length === 1 ? "1 room" : `${found.length} rooms`}
            {found.length > kMostShown ? `, the first ${kMostShown} shown` : ""}
          </p>
          <ul class="rooms" hidden={found.length === 0}>
            {found.slice(0, kMostShown).map(({ room, name, level }) => (
              <li key={`${room.id} ${room.level}`}>
                <button type="button" disabled={room.access > access || busy} onClick={() => choose(room, name)}>
                  <span class="name">{name}</span>
                  <span class="where">{room.access > access ? `${level}, not open to you` : level}</span>
                </button>
              </li>
            ))}
          </ul>
        </>
      )}
    </section>
  );
}
