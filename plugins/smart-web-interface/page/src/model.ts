// What the server tells, as it tells it. Lengths in metres, x east and y north of the building's reference.

export interface Ellipse {
  major: number; // semi-axes of the region that holds the walker with 95 %
  minor: number;
  angle: number; // of the major one, radians counter-clockwise from east
}

export interface Location {
  x: number;
  y: number;
  level?: number; // absent: not known
  measured: number; // when the walker was there, in milliseconds of Unix time
  valid: boolean;
  ellipse?: Ellipse;
}

export type Waypoint = [x: number, y: number, level?: number];

export interface Path {
  valid: boolean;
  points: Waypoint[];
  legs?: string[]; // how one gets from each point to the next, as MapEdge.Kind has it; none: not told
}

export interface Instruction {
  number: number;
  kind: string;
  text: string;
  language: string;
  uncertain: boolean; // the place that it was made from is a guess
  distance?: number;
  hour?: number; // of a clock face; 12 is straight on
}

export type PortState = "connected" | "waiting" | "lost" | "unwired";

export interface Status {
  location: PortState;
  path: PortState;
  instructions: PortState;
  destination: PortState;
  map: PortState;
  mapFault: string; // why none can be had; empty: nothing is wrong with it
  login: PortState;
  profile: PortState;
  points: PortState;
}

export interface Level {
  level: number;
  name: string;
}

export interface Room {
  id: string;
  kind: string;
  level: number;
  name: string;
  ref: string;
  use: string;
  access: number;
  x: number;
  y: number;
  outline: [number, number][];
  holes: [number, number][][];
}

export interface Entrance {
  x: number;
  y: number;
  level: number;
}

export type Wall = [x1: number, y1: number, x2: number, y2: number, level: number, exterior: number];

export interface BuildingMap {
  title: string;
  levels: Level[];
  rooms: Room[];
  walls: Wall[];
  entrances: Entrance[];
}

export interface Point {
  x: number;
  y: number;
  level: number;
  name: string;
}

export interface Profile {
  level: number;
  use_elevator: boolean | null;
  use_stairs: boolean | null;
  use_outdoor_navigation: boolean | null;
  points: Point[];
}

export interface Me {
  user: string | null;
  profile: Profile | null;
  notice: string;
}

export interface Instance {
  name: string;
  plugin: string;
  version: string;
  group: string;
  mode: string;
  reason: string;
  restarts: number;
  silent?: number; // seconds
}

export interface Wire {
  client: string;
  service: string;
  provider: string | null;
  optional: boolean;
  state: PortState;
  reason: string;
  messages: number;
  dropped: number;
  rate?: number; // Hz
  age?: number; // ms
  fits: string[]; // who could serve instead
}

export interface Running {
  host: string;
  clock: string;
  mayChange: boolean;
  instances: Instance[];
  wires: Wire[];
}

export interface Destination {
  x: number;
  y: number;
  level: number;
  label: string;
}
