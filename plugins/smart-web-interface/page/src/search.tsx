import { useMemo, useState } from "preact/hooks";
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

/// Rooms that have a name or a number, by what is typed: all of its words, in any order.
export function Search({ map, access, busy, pick }: Props) {
  const [typed, setTyped] = useState("");
  const [open, setOpen] = useState(false);
  const rooms = useMemo(
    () =>
      map.rooms
        .filter((room) => roomName(room) && room.kind !== "STAIRWELL" && room.kind !== "LIFT_SHAFT" && (room.kind !== "CORRIDOR" || room.name))
        .map((room) => ({ room, name: roomName(room), level: levelName(room.level, map.levels) }))
        .sort((a, b) => a.room.level - b.room.level || a.name.localeCompare(b.name, undefined, { numeric: true })),
    [map],
  );
  const words = folded(typed).split(/\s+/).filter(Boolean);
  const found = rooms.filter(({ name, level }) => words.every((word) => folded(`${name} ${level}`).includes(word)));
  const choose = (room: Room, name: string) => {
    if (room.access > access || busy) return;
    pick({ x: room.x, y: room.y, level: room.level, label: name });
    setOpen(false);
    setTyped("");
  };
  return (
    <section class="search" aria-label="Destination">
      <form
        role="search"
        onSubmit={(event) => {
          event.preventDefault();
          const first = found.find(({ room }) => room.access <= access);
          if (first && typed) choose(first.room, first.name);
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
            setOpen(true);
          }}
          onKeyDown={(event) => event.key === "Escape" && setOpen(false)}
        />
      </form>
      {open && (
        <>
          <p class="count" role="status">
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
