// A server that says what a test wants, with the page's own files: the states that a system is seldom in, at once.
import { readFileSync } from "node:fs";
import { createServer } from "node:http";
import { join } from "node:path";

const kTypes = { html: "text/html; charset=utf-8", js: "text/javascript; charset=utf-8", css: "text/css; charset=utf-8", svg: "image/svg+xml" };
const kBeat_ms = 500;

export class PlayedServer {
  /// What the page has asked for, in this order: {name, body}.
  asked = [];
  #files;
  #news = new Map();
  #streams = new Set();
  #answers = new Map();
  #server = createServer((request, response) => this.#serve(request, response));
  #beat = setInterval(() => this.#toAll(": \n\n"), kBeat_ms);

  constructor(files) {
    this.#files = files;
    this.answer("session", 200, { session: "played" });
  }
  async start() {
    await new Promise((done) => this.#server.listen(0, "127.0.0.1", done));
    this.url = `http://127.0.0.1:${this.#server.address().port}`;
    return this;
  }
  /// What all pages are told, and those that come later.
  tell(topic, value) {
    const text = `event: ${topic}\ndata: ${JSON.stringify(value)}\n\n`;
    this.#news.set(topic, text);
    this.#toAll(text);
  }
  /// What a call is answered from now on; a function gets what the page sent, and may be asynchronous.
  answer(name, status, value) {
    this.#answers.set(name, { status, value });
  }
  /// No stream goes on, and none is opened any more.
  lose() {
    this.answer("events", 503, { error: "played" });
    for (const stream of this.#streams) stream.destroy();
  }
  async close() {
    clearInterval(this.#beat);
    this.#server.closeAllConnections();
    await new Promise((done) => this.#server.close(done));
  }

  #toAll(text) {
    for (const stream of this.#streams) stream.write(text);
  }
  #serve(request, response) {
    if (request.method === "GET") return this.#file(request.url === "/" ? "index.html" : request.url.slice(1), response);
    let body = "";
    request.on("data", (bytes) => (body += bytes));
    request.on("end", () => this.#call(request.url.slice("/api/".length), JSON.parse(body), response));
  }
  #file(name, response) {
    try {
      response.writeHead(200, { "content-type": kTypes[name.split(".").pop()] }).end(readFileSync(join(this.#files, name)));
    } catch {
      response.writeHead(404).end();
    }
  }
  async #call(name, body, response) {
    this.asked.push({ name, body });
    const { status, value } = this.#answers.get(name) ?? { status: name === "events" ? 200 : 503, value: { error: "nothing is played" } };
    if (name === "events" && status === 200) return this.#follow(response);
    const text = JSON.stringify(typeof value === "function" ? await value(body) : value);
    response.writeHead(status, { "content-type": "application/json" }).end(text);
  }
  #follow(response) {
    response.writeHead(200, { "content-type": "text/event-stream; charset=utf-8" });
    response.write([": \n\n", ...this.#news.values()].join(""));
    this.#streams.add(response);
    response.on("close", () => this.#streams.delete(response));
  }
}

const ring = (x1, y1, x2, y2) => [[x1, y1], [x2, y1], [x2, y2], [x1, y2]];
const room = (id, kind, level, name, ref, box, more = {}) => ({
  id, kind, level, name, ref, use: "", access: 0, x: (box[0] + box[2]) / 2, y: (box[1] + box[3]) / 2, outline: ring(...box), holes: [], ...more,
});
const sides = (x1, y1, x2, y2, level) => [[x1, y1, x2, y1], [x2, y1, x2, y2], [x2, y2, x1, y2], [x1, y2, x1, y1]].map((side) => [...side, level, 0]);

/// Two levels: a corridor along the south, rooms north of it, a lift at its eastern end.
export const kBuilding = {
  title: "Played House",
  levels: [{ level: 0, name: "Ground floor" }, { level: 1, name: "First floor" }],
  rooms: [
    room("1", "CORRIDOR", 0, "", "", [0, 0, 20, 3]),
    room("2", "ROOM", 0, "Office 0.1", "0.1", [0, 3, 6, 8]),
    room("3", "ROOM", 0, "Office 0.2", "0.2", [6, 3, 12, 8]),
    room("4", "ROOM", 0, "Donaudampfschifffahrtsgesellschaftsversammlungsraum of the whole institute", "0.3", [12, 3, 18, 8], { access: 5 }),
    room("5", "LIFT_SHAFT", 0, "", "", [18, 3, 20, 5]),
    room("6", "CORRIDOR", 1, "", "", [0, 0, 20, 3]),
    room("7", "ROOM", 1, "Library", "1.1", [0, 3, 12, 8]),
    room("8", "LIFT_SHAFT", 1, "", "", [18, 3, 20, 5]),
  ],
  walls: [...sides(0, 0, 20, 8, 0), [0, 3, 8.5, 3, 0, 0], [9.5, 3, 18, 3, 0, 0], [6, 3, 6, 8, 0, 0], [12, 3, 12, 8, 0, 0], ...sides(0, 0, 20, 8, 1)],
  entrances: [{ x: 0, y: 1.5, level: 0 }],
};
export const kStatus = {
  location: "connected", path: "connected", instructions: "connected", destination: "connected", map: "connected", mapFault: "",
  login: "connected", profile: "connected", points: "connected",
};
const kNothingSaid = { use_elevator: null, use_stairs: null, use_outdoor_navigation: null };
export const kGuest = { user: null, profile: { level: 0, ...kNothingSaid, points: [] }, notice: "" };
export const anna = (...points) => ({ user: "anna", profile: { level: 3, ...kNothingSaid, points }, notice: "" });
export const at = (x, y, level = 0, major = 1.2) => ({ x, y, level, measured: Date.now(), valid: true, ellipse: { major, minor: major / 2, angle: 0.3 } });
export const kToOffice = { valid: true, points: [[2, 1.5, 0], [9, 1.5, 0], [9, 5.5, 0]] };
export const kToLibrary = { valid: true, points: [[2, 1.5, 0], [19, 1.5, 0], [19, 4, 0], [19, 4, 1], [19, 1.5, 1], [6, 1.5, 1], [6, 5.5, 1]] };
export const instruction = (number, kind, text, more = {}) => ({ number, kind, text, language: "en", uncertain: false, ...more });

/// A person stands in the corridor, and nothing was chosen yet.
export async function play(files) {
  const server = await new PlayedServer(files).start();
  server.tell("status", kStatus);
  server.tell("location", at(2, 1.5));
  server.tell("attention", []);
  server.tell("map", { version: "1" });
  server.answer("map", 200, kBuilding);
  server.answer("me", 200, kGuest);
  server.answer("destination", 200, {});
  return server;
}

const instance = (name, more = {}) => ({ name, plugin: `fiona/${name}`, version: "0.1.0", group: "main", mode: "active", reason: "", restarts: 0, ...more });
const wire = (client, provider, more = {}) => ({
  client, service: "LocationProvider", provider, optional: false, state: "connected", reason: "", messages: 9, dropped: 0, rate: 5, age: 120, fits: [], ...more,
});
/// With an instance that has failed and one that is silent, and a wire that may be switched.
export const kRunning = {
  host: "main",
  clock: "real",
  mayChange: true,
  instances: [
    instance("nav"),
    instance("bluetooth", { restarts: 2 }),
    instance("map", { mode: "failed", reason: "the building file /home/anna/buildings/the-institute-as-it-was-drawn-by-the-surveyors.osm has nothing on a level" }),
    instance("wifi", { silent: 4 }),
  ],
  wires: [
    wire("nav.location", "bluetooth.location", { fits: ["wifi.location", "phone.truth"] }),
    wire("nav.levels", "map.levels", { state: "lost", reason: "map has failed" }),
    wire("nav.profile", null, { optional: true }),
  ],
};
