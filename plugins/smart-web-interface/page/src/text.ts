import type { Level, Room } from "./model";

// Names come from whoever drew the map or made an account: what would turn, hide or imitate text is taken out.
const unsafe = /[\u0000-\u001f\u007f-\u009f\u00ad\u061c\u180e\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb]|[\u{e0000}-\u{e007f}]/gu;

export const inert = (text: string): string => text.replace(unsafe, " ").replace(/\s+/g, " ").trim();

export function metres(distance: number): string {
  if (distance < 10) return `${Math.max(1, Math.round(distance))} m`;
  if (distance < 1000) return `${Math.round(distance / 5) * 5} m`;
  return `${(distance / 1000).toFixed(1)} km`;
}

export function levelName(level: number, levels: Level[]): string {
  const known = levels.find((one) => one.level === level);
  return (known && inert(known.name)) || `Level ${level}`;
}

/// What a person calls the room, without its level.
export function roomName(room: Room): string {
  const name = inert(room.name);
  const ref = inert(room.ref);
  if (name && ref && !name.includes(ref)) return `${name} (${ref})`;
  return name || (ref && `Room ${ref}`) || inert(room.use).replace(/_/g, " ");
}

export function turnOf(hour: number): string {
  if (hour === 12) return "Go straight on";
  if (hour === 6) return "Turn around";
  if (hour < 6) return hour === 1 ? "Turn slightly right" : hour < 4 ? "Turn right" : "Turn sharp right";
  return hour === 11 ? "Turn slightly left" : hour > 8 ? "Turn left" : "Turn sharp left";
}
