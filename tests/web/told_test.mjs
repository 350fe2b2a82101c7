// What a person is told, by a server that is played: where they are led, whoever chose it; once that the place is in doubt, and once
// that it is not any more; points of attention, once, from one source; and the way on the plan, with the arrows along it.
// usage: node told_test.mjs BIN MARKETPLACE NODE_MODULES SCREENSHOTS
import assert from "node:assert/strict";
import { join, resolve } from "node:path";
import { Claims, browserProgram, browserTools, closeDialog, listenTo, saidBy, skip, until } from "./navigator.mjs";
import { anna, at, instruction, kBuilding, kGuest, kStatus, kToLibrary, kToOffice, play } from "./played_server.mjs";

const modules = resolve(process.argv[4]);
if (!browserProgram) skip("there is no chromium on this machine (apt-get install chromium)");
const browser = await browserTools(modules).chromium.launch({ executablePath: browserProgram, args: ["--no-sandbox"] });
const context = await browser.newContext({ viewport: { width: 390, height: 844 }, reducedMotion: "reduce" });
const claims = new Claims();
const pause = (time_ms) => new Promise((done) => setTimeout(done, time_ms));

const opened = async (server) => {
  const page = await context.newPage();
  await page.goto(`${server.url}/#played`);
  await page.getByRole("heading", { name: "Played House" }).waitFor();
  await page.getByText("Connected", { exact: true }).waitFor();
  return page;
};
const pick = async (page, room) => {
  await page.getByLabel("Where to?").fill(room);
  await page.keyboard.press("Enter");
};
const logIn = async (page) => {
  await page.getByRole("button", { name: "Log in" }).click();
  await page.getByLabel("Name").fill("anna");
  await page.getByLabel("Password").fill("secret");
  await page.locator(".login").getByRole("button", { name: "Log in" }).click();
  await page.getByText("You are logged in.").waitFor();
};
const sent = (server) => server.asked.filter(({ name }) => name === "destination").map(({ body }) => body);
const kNoWay = { valid: false, points: [] };
/// Each place is drawn before the next one is told.
async function walk(page, server, places) {
  for (const [x, y, level] of places) {
    server.tell("location", at(x, y, level));
    const drawn = `translate(${x.toFixed(2)} ${(-y).toFixed(2)})`;
    await page.locator(`.walker > g[transform^="${drawn}"]`).waitFor({ state: "attached" });
  }
}
const along = (from, to, y, level) => Array.from({ length: Math.abs(to - from) + 1 }, (_, i) => [from + i * Math.sign(to - from), y, level]);

async function claim(what, test) {
  const server = await play(join(modules, "../dist"));
  await claims.claim(what, () => test(server));
  for (const page of context.pages()) await page.close();
  await server.close();
}

await claim("where one is led is what the path says: a room that another page or the console picked is told on each page", async (server) => {
  const page = (claims.shown = await opened(server));
  await pick(page, "0.2");
  await page.getByText("Asked for Office 0.2, Ground floor").waitFor();
  server.tell("path", kToOffice);
  await page.getByText("To Office 0.2, Ground floor").waitFor();
  await page.locator(".steps li", { hasText: "Arrive at Office 0.2" }).waitFor();
  server.tell("path", kToLibrary);
  const late = await opened(server);
  for (const one of [page, late]) {
    await one.getByText("To Library (1.1), First floor").waitFor();
    await one.locator(".steps li", { hasText: "Arrive at Library (1.1)" }).waitFor();
    assert.doesNotMatch(await one.locator(".panel").innerText(), /Office/);
  }
});
await claim("a direction is told where one is known: not at the start, nor out of a lift, and behind stairs from their last steps", async (server) => {
  const stairwells = kBuilding.rooms.map((room) => (room.kind === "LIFT_SHAFT" ? { ...room, kind: "STAIRWELL" } : room));
  server.answer("map", 200, { ...kBuilding, rooms: stairwells });
  const upstairs = (...then) => ({ valid: true, points: [[2, 1.5, 0], [19, 1.5, 0], [19, 3.1, 0], [19, 4.9, 1], ...then.map(([x, y]) => [x, y, 1])] });
  const page = (claims.shown = await opened(server));
  for (const [to, told] of [[[24, 4.9], "Turn right, then 5 m"], [[13, 4.9], "Turn left, then 6 m"], [[19, 0.9], "Turn around, then 4 m"], [[19, 7.9], "Straight on for 3 m"]]) {
    server.tell("path", upstairs(to));
    await page.locator(".steps li", { hasText: told }).waitFor();
    const steps = await page.locator(".steps li").allInnerTexts();
    assert.deepEqual(steps.slice(0, 4), ["Walk 15 m", "Turn left, then 2 m", "Take the stairs to First floor", told]);
  }
  const ahead = page.locator(".steps li", { hasText: "Walk 15 m" });
  assert.deepEqual([await ahead.locator("svg circle").count(), await ahead.locator("svg path").count()], [1, 0], "an arrow though nobody knows where one looks");
  server.answer("map", 200, kBuilding);
  server.tell("map", { version: "2" });
  server.tell("path", kToLibrary);
  await page.locator(".steps li", { hasText: "Take the lift to First floor" }).waitFor();
  assert.deepEqual((await page.locator(".steps li").allInnerTexts()).slice(2, 5), ["Take the lift to First floor", "Walk 3 m", "Turn right, then 15 m"]);
});
await claim("doors, escalators, ramps and ways outdoors are steps where the path tells its legs, and a bend before a door is told with it", async (server) => {
  const page = (claims.shown = await opened(server));
  const steps = async (legs, points, last) => {
    server.tell("location", at(points[0][0], points[0][1]));
    server.tell("path", { valid: true, points, legs });
    await page.locator(".steps li", { hasText: last }).waitFor();
    return page.locator(".steps li").allInnerTexts();
  };
  assert.deepEqual(
    await steps(
      ["CORRIDOR", "CORRIDOR", "DOOR", "DOOR", "CORRIDOR"],
      [[2, 1.5, 0], [9, 1.5, 0], [9, 2.7, 0], [9, 3, 0], [9, 3.3, 0], [9, 7, 0]],
      "Arrive at Office 0.2",
    ),
    ["Walk 7 m", "Turn left and go through the door", "Straight on for 4 m", "Arrive at Office 0.2"],
  );
  assert.deepEqual(
    await steps(["CORRIDOR", "CORRIDOR", "DOOR", "CORRIDOR"], [[2, 1.5, 0], [7, 1.5, 0], [7, 3.2, 0], [7.5, 3.2, 0], [9.2, 3.2, 0]], "Turn right and go"),
    ["Walk 5 m", "Turn left, then 2 m", "Turn right and go through the door", "Arrive at Office 0.2"],
    "a bend to elsewhere is a step of its own",
  );
  assert.deepEqual(
    await steps(
      ["CORRIDOR", "OUTDOORS", "DOOR", "CORRIDOR", "ESCALATOR", "ESCALATOR", "CORRIDOR", "RAMP", "CORRIDOR"],
      [[-12, 1.5, 0], [-10, 1.5, 0], [0, 1.5, 0], [0.3, 1.5, 0], [5, 1.5, 0], [8, 1.5, 0.5], [11, 1.5, 1], [15, 1.5, 1], [19, 1.5, 0], [19, 0.5, 0]],
      "Arrive",
    ),
    ["Walk 10 m", "Go inside", "Straight on for 5 m", "Take the escalator to First floor", "Straight on for 4 m", "Take the ramp to Ground floor", "Turn right, then 1 m", "Arrive"],
  );
  assert.deepEqual(
    await steps(["CORRIDOR", "DOOR", "OUTDOORS", "STAIRS", "OUTDOORS"], [[5, 1.5, 0], [0.3, 1.5, 0], [0, 1.5, 0], [-4, 1.5, 0], [-4, 6, 0], [-9, 6, 0]], "Arrive"),
    ["Walk 5 m", "Go outdoors", "Straight on for 4 m", "Turn right and take the stairs", "Turn left, then 5 m", "Arrive"],
  );
});
await claim("a room that cannot be reached is asked for no longer", async (server) => {
  const page = (claims.shown = await opened(server));
  await pick(page, "Library");
  await page.getByText("Asked for Library (1.1), First floor").waitFor();
  server.tell("instruction", instruction(1, "NO_PATH", "There is no way to Library from here."));
  await page.locator(".to").waitFor({ state: "detached" });
  await page.locator(".now", { hasText: "There is no way to Library from here." }).waitFor();
});
await claim("a doubt is announced when it begins and when it is over, and not with each number", async (server) => {
  const page = (claims.shown = await opened(server));
  await listenTo(page, "[role=alert]", ".lead > .hidden[role=status]");
  for (let major = 9; major <= 20; ++major) {
    server.tell("location", at(2, 1.5, 0, major));
    await page.getByText(`within ${major} m`).waitFor();
  }
  // At the edge it comes and goes with each position.
  for (const major of [7.9, 8.1, 7.9, 8.1, 7.9, 8.1]) {
    server.tell("location", at(2, 1.5, 0, major));
    await pause(200);
  }
  assert.deepEqual(await saidBy(page, "[role=alert]"), ["Position uncertain"]);
  server.tell("location", at(2, 1.5, 0, 6.4));
  await page.locator(".doubt").waitFor({ state: "detached" });
  for (const major of [7, 5, 3]) {
    server.tell("location", at(2, 1.5, 0, major));
    await page.locator(`.walker .region[rx="${major}"]`).waitFor({ state: "attached" });
  }
  assert.deepEqual(await saidBy(page, ".lead > .hidden[role=status]"), ["Position known again, within 6 m."]);
});
await claim("a place that is told for the first time is not known again", async (server) => {
  server.tell("status", { ...kStatus, location: "waiting" });
  server.tell("location", null);
  const page = (claims.shown = await opened(server));
  await listenTo(page, ".lead > .hidden[role=status]");
  await page.getByText("localisation is not there yet").waitFor();
  const found = async () => {
    server.tell("status", kStatus);
    server.tell("location", at(2, 1.5, 0, 6.4));
    await page.locator(".doubt").waitFor({ state: "detached" });
  };
  await found();
  server.tell("status", { ...kStatus, location: "lost" });
  await page.locator(".doubt").waitFor();
  await found();
  assert.deepEqual((await saidBy(page, ".lead > .hidden[role=status]")).filter(Boolean), ["Position known, within 6 m.", "Position known again, within 6 m."]);
});
await claim("what the guide says again, under another number, is announced again, and a better distance is not", async (server) => {
  const page = (claims.shown = await opened(server));
  await page.evaluate(() => {
    const region = document.querySelector('[aria-label="Now"] [role=status]');
    window.announced = [];
    new MutationObserver(() => window.announced.push(region.textContent)).observe(region, { subtree: true, childList: true, characterData: true });
  });
  const announced = () => page.evaluate(() => window.announced);
  server.tell("instruction", instruction(1, "DOOR", "Go through the door.", { distance: 4 }));
  await page.locator(".now", { hasText: "in 4 m" }).waitFor();
  server.tell("instruction", instruction(1, "DOOR", "Go through the door.", { distance: 2 }));
  await page.locator(".now", { hasText: "in 2 m" }).waitFor();
  assert.deepEqual(await announced(), ["Go through the door."]);
  server.tell("instruction", instruction(2, "DOOR", "Go through the door.", { distance: 2 }));
  await until("it is announced again", async () => (await announced()).length === 2, 5000);
  assert.deepEqual(await announced(), ["Go through the door.", "Go through the door."]);
});
await claim("what a guide has said that is gone is neither shown nor led by once another one is there", async (server) => {
  const page = (claims.shown = await opened(server));
  server.tell("path", kToOffice);
  server.tell("instruction", instruction(1, "CONTINUE", "Go straight on for 7 m."));
  await page.locator(".now", { hasText: "Go straight on" }).waitFor();
  await page.locator(".steps").waitFor();
  server.tell("path", kNoWay);
  server.tell("instruction", null);
  await page.locator(".now").waitFor({ state: "detached" });
  await page.locator(".steps").waitFor({ state: "detached" });
  await page.getByText("Choose a room").waitFor();
});
/// A guide that was started again: it tells that nobody is led, and nothing else.
const startAgain = (server) => {
  server.tell("path", kNoWay);
  server.tell("instruction", null);
};
const kLeft = "Guidance was started again: you are not led any more.";
await claim("who is led when guidance is started again is led on: the page sends what it has sent, once for each pick, and says so", async (server) => {
  const page = (claims.shown = await opened(server));
  await listenTo(page, ".lead");
  await pick(page, "0.2");
  for (let life = 1; life <= 2; ++life) {
    server.tell("path", kToOffice);
    server.tell("instruction", instruction(1, "CONTINUE", `Go straight on, says guide ${life}.`));
    await page.locator(".now", { hasText: `guide ${life}` }).waitFor();
    if (life === 1) await page.reload();
    await page.locator(".now", { hasText: `guide ${life}` }).waitFor();
    startAgain(server);
    if (life === 1) await page.getByText("Guidance was started again.", { exact: true }).waitFor({ timeout: 5000 });
  }
  // That destination may be what has ended the guide.
  await page.getByRole("alert").getByText(kLeft).waitFor({ timeout: 7000 });
  assert.deepEqual(sent(server), Array(2).fill({ x: 9, y: 5.5, level: 0 }));
  await page.getByRole("button", { name: "Lead me on to Office 0.2" }).click();
  await until("it is sent", () => sent(server).length === 3, 5000);
  assert.equal(await page.evaluate(() => document.activeElement.id), "panel");
  server.tell("path", kToOffice);
  await page.getByText(kLeft).waitFor({ state: "detached" });
  startAgain(server);
  await until("it is sent again, for it was picked anew", () => sent(server).length === 4, 5000);
});
await claim("a destination that ends the guide each time is asked for once more only, and one that is refused then, too", async (server) => {
  const page = (claims.shown = await opened(server));
  await pick(page, "0.2");
  server.tell("path", kToOffice);
  await page.getByText("To Office 0.2").waitFor();
  server.answer("destination", 503, { error: "navigation does not answer" });
  startAgain(server);
  await page.getByText(kLeft).waitFor({ timeout: 9000 });
  await page.getByText("Office 0.2: Navigation does not answer.").waitFor();
  await pause(5000);
  assert.equal(sent(server).length, 2);
});
await claim("where another page has sent it the page says that guidance has ended, and leads on when asked to", async (server) => {
  server.tell("path", kToLibrary);
  server.tell("instruction", instruction(7, "CONTINUE", "Go straight on."));
  const page = (claims.shown = await opened(server));
  await page.getByText("To Library (1.1)").waitFor();
  startAgain(server);
  await page.getByRole("alert").getByText(kLeft).waitFor({ timeout: 7000 });
  assert.deepEqual(sent(server), []);
  await page.getByRole("button", { name: "Lead me on to Library (1.1)" }).click();
  await until("it is sent", () => sent(server).length === 1, 5000);
  assert.deepEqual(sent(server), [{ x: 6, y: 5.5, level: 1 }]);
});
await claim("who has arrived, to whom there is no way, or who is led elsewhere by now, is not led there again", async (server) => {
  const page = (claims.shown = await opened(server));
  const ends = {
    ARRIVE: () => (server.tell("instruction", instruction(1, "ARRIVE", "You have arrived.")), server.tell("path", kNoWay)),
    NO_PATH: () => (server.tell("path", kNoWay), server.tell("instruction", instruction(2, "NO_PATH", "There is no way."))),
    lost: () => server.tell("status", { ...kStatus, instructions: "lost" }),
  };
  for (const [index, end] of Object.values(ends).entries()) {
    await pick(page, "0.2");
    await until("it is sent", () => sent(server).length === index + 1, 5000);
    server.tell("path", kToOffice);
    await page.getByText("To Office 0.2").waitFor();
    end();
    await pause(200);
    startAgain(server);
    await pause(4500);
    assert.equal(await page.getByText(kLeft).count(), 0);
  }
  assert.equal(sent(server).length, 3);
  server.tell("status", kStatus);
  await until("a guide that is back is asked again", () => sent(server).length === 4, 5000);
});
await claim("who logs in on the way is led on as who they are, and who logs out is not", async (server) => {
  server.answer("login", 200, anna());
  server.answer("logout", 200, { ...kGuest, notice: "" });
  const page = (claims.shown = await opened(server));
  await pick(page, "0.2");
  server.tell("path", kToOffice);
  server.tell("instruction", instruction(1, "CONTINUE", "Go straight on."));
  await page.getByText("To Office 0.2").waitFor();
  await page.reload();
  await page.getByText("To Office 0.2").waitFor();
  await logIn(page);
  await until("it is sent again", () => sent(server).length === 2, 5000);
  assert.deepEqual(sent(server)[1], { x: 9, y: 5.5, level: 0 });
  const names = server.asked.map(({ name }) => name);
  assert.ok(names.indexOf("login") < names.lastIndexOf("destination"));
  await page.getByRole("button", { name: "Log out" }).click();
  await page.getByText("You are logged out.").waitFor();
  await pause(300);
  // What somebody else has sent is theirs.
  server.tell("path", kToLibrary);
  await page.locator(".to", { hasText: "Library" }).waitFor({ state: "attached" });
  await closeDialog(page);
  await logIn(page);
  await pause(300);
  assert.equal(sent(server).length, 2);
});
await claim("what is to be done, a doubt and points are told on each tab, and in the dialog before which all else is silent", async (server) => {
  server.tell("instruction", instruction(1, "CONTINUE", "Go straight on."));
  const page = (claims.shown = await opened(server));
  await page.getByRole("tab", { name: "What is running" }).click();
  await page.getByRole("status").getByText("Go straight on.").waitFor();
  await page.locator(".who").click();
  const dialog = page.getByRole("dialog");
  await dialog.getByRole("status").getByText("Go straight on.").waitFor();
  server.tell("instruction", instruction(2, "LOST", "Stop.", { uncertain: true }));
  server.tell("attention", [instruction(3, "ATTENTION", "You are passing a kiosk.")]);
  await dialog.getByRole("status").getByText("Stop.").waitFor();
  await dialog.getByRole("status").getByText("You are passing a kiosk.").waitFor();
  await dialog.getByRole("alert").getByText("Position uncertain").waitFor();
});
await claim("while the place is not known the steps stay where it was last, and a place of which nobody says how sure it is is in doubt", async (server) => {
  server.tell("path", kToOffice);
  const page = (claims.shown = await opened(server));
  await walk(page, server, along(3, 9, 1.5).concat([[9, 3]]));
  const current = () => page.locator(".steps [aria-current=step]").innerText();
  await page.locator(".steps [aria-current=step]", { hasText: "Turn left" }).waitFor();
  server.tell("location", { x: 0, y: 0, measured: Date.now(), valid: false });
  await page.getByText("Position uncertain").waitFor();
  assert.match(await current(), /Turn left/);
  server.tell("location", at(9, 3, 1));
  const upstairs = page.getByRole("button", { name: "1, First floor, where you are", pressed: true });
  await upstairs.waitFor();
  server.tell("location", { x: 0, y: 0, measured: Date.now(), valid: false });
  await page.locator('.plan-view[aria-label*="Your position is not known"]').waitFor();
  await upstairs.waitFor();
  server.tell("location", at(9, 3));
  await page.locator(".doubt").waitFor({ state: "detached" });
  const { ellipse, ...unsure } = at(9, 3.5);
  server.tell("location", unsure);
  await page.getByText("Position uncertain").waitFor();
});

await claim("a link whose exchange was cut off is told, and opens the page all the same; then its token leaves the address", async (server) => {
  const page = (claims.shown = await context.newPage());
  let attempts = 0;
  const troubles = [
    (route) => route.abort(),
    (route) => route.fulfill({ status: 503, json: { error: "the system does not answer" } }),
    async (route) => (await route.fetch(), route.abort()), // the server has answered, and the page does not know
  ];
  let seen = 0; // of the troubles: each before the next attempt is answered
  await page.route("**/api/session", async (route) => {
    const attempt = attempts++;
    await until("the trouble before was seen", () => seen >= Math.min(attempt, troubles.length));
    await (troubles[attempt] ?? ((one) => one.continue()))(route);
  });
  await page.goto(`${server.url}/#played`);
  await page.getByText("The system cannot be reached. Trying again…").waitFor();
  assert.equal(page.url(), `${server.url}/#played`, "who reloads now has lost the link");
  seen = 1;
  await page.getByText("The system does not answer. Trying again…").waitFor();
  seen = 2;
  await page.getByText("The system cannot be reached. Trying again…").waitFor();
  seen = 3;
  await page.reload();
  await page.getByText("Connected", { exact: true }).waitFor({ timeout: 10000 });
  const [first, ...again] = server.asked.filter(({ name }) => name === "session").map(({ body }) => body);
  assert.equal(first.token, "played");
  assert.match(first.number, /^[0-9a-f]{32}$/);
  assert.ok(again.length > 0, "it was not asked again");
  for (const one of again) assert.deepEqual(one, first, "by another number the server knows another page");
  assert.equal(page.url(), `${server.url}/`);
  assert.deepEqual(await page.evaluate(() => Object.keys(sessionStorage)), ["fiona-session"]);
});
await claim("a map that could not be had is asked for again, while the connection holds", async (server) => {
  server.answer("map", 503, { error: "played" });
  const page = (claims.shown = await context.newPage());
  await page.goto(`${server.url}/#played`);
  await until("it was asked for twice", () => server.asked.filter(({ name }) => name === "map").length > 1, 5000);
  server.answer("map", 200, kBuilding);
  await page.getByRole("heading", { name: "Played House" }).waitFor({ timeout: 10000 });
  assert.equal(server.asked.filter(({ name }) => name === "events").length, 1);
});
await claim("a map that comes late does not take the place of a newer one", async (server) => {
  let answer;
  server.answer("map", 200, () => new Promise((done) => (answer = done)));
  const page = (claims.shown = await context.newPage());
  await page.goto(`${server.url}/#played`);
  await until("the old one was asked for", () => answer);
  server.answer("map", 200, { ...kBuilding, title: "Rebuilt House" });
  server.tell("map", { version: "2" });
  await page.getByRole("heading", { name: "Rebuilt House" }).waitFor();
  const late = page.waitForResponse("**/api/map");
  answer(kBuilding);
  await (await late).finished();
  await pause(200);
  await page.getByRole("heading", { name: "Rebuilt House" }).waitFor({ timeout: 1000 });
});

await claim("who has logged in stays so though what was asked before is answered after it", async (server) => {
  let answer;
  server.answer("me", 200, () => new Promise((done) => (answer = done)));
  server.answer("login", 200, anna());
  const page = (claims.shown = await opened(server));
  await until("it was asked who uses the page", () => answer);
  await page.getByRole("button", { name: "Log in" }).click();
  await page.getByLabel("Name").fill("anna");
  await page.getByLabel("Password").fill("secret");
  await page.locator(".login").getByRole("button", { name: "Log in" }).click();
  await page.getByText("You are logged in.").waitFor();
  await listenTo(page, ".who");
  server.answer("me", 200, anna());
  answer(kGuest);
  await until("it is asked anew", () => server.asked.filter(({ name }) => name === "me").length > 1, 5000);
  assert.deepEqual(await saidBy(page, ".who"), ["Profile of anna"]);
});

const kFountain = { x: 9, y: 1.5, level: 0, name: "the fountain" };
const kBell = { x: 9, y: 1.5, level: 1, name: "the bell" };
const kStatue = { x: 14, y: 3.5, level: 0, name: "the statue" };
await claim("without a guide a point is told once in passing, on its level and on this side of a wall, and again the next time", async (server) => {
  server.answer("me", 200, anna(kFountain, kBell, kStatue));
  server.tell("status", { ...kStatus, instructions: "unwired" });
  const page = (claims.shown = await opened(server));
  await page.getByRole("button", { name: "Profile of anna" }).waitFor();
  await listenTo(page, ".passing");
  await walk(page, server, along(2, 17, 1.5));
  assert.deepEqual(await saidBy(page, ".passing"), ["You are passing the fountain."]);
  await page.locator(".passing").getByText("the fountain").waitFor({ state: "detached", timeout: 12000 });
  await walk(page, server, along(17, 2, 1.5));
  assert.deepEqual(await saidBy(page, ".passing"), ["You are passing the fountain.", "You are passing the fountain."]);
});
await claim("a guide that leads is the one that tells points, once, beside what is to be done", async (server) => {
  server.answer("me", 200, anna(kFountain));
  const page = (claims.shown = await opened(server));
  await page.getByRole("button", { name: "Profile of anna" }).waitFor();
  await pick(page, "0.2");
  server.tell("path", kToOffice);
  server.tell("instruction", instruction(1, "TURN", "Turn left.", { hour: 9, distance: 8 }));
  await page.locator(".now", { hasText: "Turn left." }).waitFor();
  await listenTo(page, ".passing", ".now .text");
  await walk(page, server, along(2, 6, 1.5));
  const passing = instruction(2, "ATTENTION", "You are passing the fountain.");
  server.tell("attention", [passing]);
  await walk(page, server, along(7, 12, 1.5));
  server.tell("attention", [passing, instruction(3, "ATTENTION", "You are passing a kiosk.")]);
  await page.getByText("You are passing a kiosk.").waitFor();
  server.tell("attention", []);
  await page.locator(".passing p").first().waitFor({ state: "detached" });
  assert.deepEqual(await saidBy(page, ".passing"), ["You are passing the fountain.", "You are passing the fountain.You are passing a kiosk."]);
  assert.deepEqual(await saidBy(page, ".now .text"), ["Turn left."]);
  assert.equal(await page.locator(".passing").getAttribute("aria-atomic"), "false", "what was told would be read again");
});

await claim("a guide that leads somebody else tells their points, and the page those of its user", async (server) => {
  server.answer("login", 200, anna(kFountain));
  server.answer("destination", 503, { error: "navigation does not answer" });
  server.tell("path", kToOffice);
  server.tell("instruction", instruction(1, "CONTINUE", "Go straight on."));
  const page = (claims.shown = await opened(server));
  await logIn(page);
  await closeDialog(page);
  await listenTo(page, ".passing");
  server.tell("attention", [instruction(2, "ATTENTION", "You are passing a kiosk.")]);
  await page.getByText("You are passing a kiosk.").waitFor();
  await walk(page, server, along(2, 7, 1.5));
  await page.getByText("You are passing the fountain.").waitFor();
  server.tell("attention", [2, 3].map((number) => instruction(number, "ATTENTION", number === 2 ? "You are passing a kiosk." : "You are passing the fountain.")));
  await pause(300);
  assert.deepEqual((await saidBy(page, ".passing")).map((text) => text.length), [24, 53], "what both tell is told once");
});

/// The colour at a place of the plan, in metres, as it is on the screen.
async function colours(page, places) {
  const picture = (await page.screenshot()).toString("base64");
  return page.evaluate(
    async ({ picture, places }) => {
      const image = await createImageBitmap(await (await fetch(`data:image/png;base64,${picture}`)).blob());
      const canvas = new OffscreenCanvas(image.width, image.height).getContext("2d");
      canvas.drawImage(image, 0, 0);
      const matrix = document.querySelector(".plan-view svg").getScreenCTM();
      return places.map(([x, y]) => {
        const at = new DOMPoint(x, -y).matrixTransform(matrix);
        return [...canvas.getImageData(Math.round(at.x), Math.round(at.y), 1, 1).data].slice(0, 3).join(" ");
      });
    },
    { picture, places },
  );
}
/// Where the arrows are in metres, and where they point to: degrees counter-clockwise from east, on the screen.
const arrows = (page, selector, tip, tail) =>
  page.locator(selector).evaluateAll(
    (all, { tip, tail }) => {
      const back = document.querySelector(".plan-view svg").getScreenCTM().inverse();
      return all.map((one) => {
        const [a, b] = [tail, tip].map(([x, y]) => new DOMPoint(x, y).matrixTransform(one.getScreenCTM()));
        const at = b.matrixTransform(back);
        return { x: at.x, y: -at.y, degrees: Math.round((Math.atan2(a.y - b.y, b.x - a.x) * 180) / Math.PI) };
      });
    },
    { tip, tail },
  );
const wayArrows = (page) => arrows(page, ".way-arrow", [0.1, 0], [-0.35, 0]);
const heading = async (page) => (await arrows(page, ".heading", [2.1, 0], [0.9, 0]))[0].degrees;
const kWay = "11 92 173";
const kBehind = "143 165 186";

await claim("the way is drawn where it leads, what lies behind is faint, and nothing of it on another level", async (server) => {
  server.tell("path", kToOffice);
  const page = (claims.shown = await opened(server));
  await page.locator(".way").first().waitFor({ state: "attached" });
  // Between the arrows: some places along it have the way's colour, and none beside it.
  const on = [...along(4, 8, 1.5), [9, 2.2], [9, 2.5], [9, 4.4]];
  const shown = await colours(page, on);
  assert.ok(shown.filter((one) => one === kWay).length >= 5, `along the way: ${shown}`);
  const beside = await colours(page, [...along(10, 16, 1.5), [3, 5], [15, 5]]);
  assert.ok(!beside.includes(kWay), `beside it: ${beside}`);
  await walk(page, server, along(3, 8, 1.5));
  const passed = await colours(page, along(3, 6, 1.5));
  assert.deepEqual(passed, [kBehind, kBehind, kBehind, kBehind], "what lies behind");
  await page.getByRole("button", { name: "First floor" }).click();
  await page.locator(".way, .way-arrow").first().waitFor({ state: "detached" });
});
await claim("arrows lie on the way and point along it, and so does the walker's", async (server) => {
  server.tell("path", kToOffice);
  const page = (claims.shown = await opened(server));
  await page.locator(".way-arrow").first().waitFor({ state: "attached" });
  const all = await wayArrows(page);
  const [east, north] = [all.filter((one) => one.degrees === 0), all.filter((one) => one.degrees === 90)];
  assert.ok(east.length > 0 && north.length > 0, `too few arrows: ${JSON.stringify(all)}`);
  assert.equal(east.length + north.length, all.length, `arrows that point elsewhere: ${JSON.stringify(all)}`);
  for (const { x, y } of east) assert.ok(Math.abs(y - 1.5) < 0.1 && x > 2 && x < 9.3, `${x} ${y} is not in the corridor's part of the way`);
  for (const { x, y } of north) assert.ok(Math.abs(x - 9) < 0.1 && y > 1.5 && y < 5.8, `${x} ${y} is not in the room's part of the way`);
  assert.equal(await heading(page), 0);
  await walk(page, server, [[6, 1.5], [9, 1.5], [9, 4]]);
  await until("the walker's arrow points into the room", async () => (await heading(page)) === 90, 5000);
  const [box, plan] = await Promise.all([page.locator(".heading").boundingBox(), page.locator(".plan-view").boundingBox()]);
  assert.ok(box.width > 3 && box.x > plan.x && box.x + box.width < plan.x + plan.width && box.y > plan.y && box.y + box.height < plan.y + plan.height, "on the screen");
});
await claim("on another level the way goes on from the lift", async (server) => {
  server.tell("path", kToLibrary);
  server.tell("location", at(19, 4, 1));
  const page = (claims.shown = await opened(server));
  await page.locator('.levels [aria-pressed="true"][aria-label^="1, First floor"]').waitFor();
  const shown = await colours(page, [...along(7, 17, 1.5), [6, 3], [6, 4]]);
  assert.ok(shown.filter((one) => one === kWay).length >= 6, `along the way: ${shown}`);
  for (const { degrees } of await wayArrows(page)) assert.ok([-90, 180, 90].includes(degrees), `${degrees} degrees`);
});
/// Where the middle of the plan is in metres, and how many a pixel has.
const seen = (page) =>
  page.locator(".plan-view svg").evaluate((svg) => {
    const [x, y, width, height] = svg.getAttribute("viewBox").split(" ").map(Number);
    return { x: x + width / 2, y: -y - height / 2, pixel: 1 / svg.getScreenCTM().a };
  });
const touch = (session, type, points) =>
  session.send("Input.dispatchTouchEvent", { type, touchPoints: points.map(([x, y, id], index) => ({ x, y, id: id ?? index })) });
await claim("the plan is centred by a tap, without dragging; a drag moves it and does not", async (server) => {
  const page = (claims.shown = await opened(server));
  const box = await page.locator(".plan-view").boundingBox();
  const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
  const first = await seen(page);
  await page.mouse.move(x - 60, y + 20);
  await page.mouse.down();
  await page.mouse.move(x - 58, y + 20);
  await page.mouse.up();
  await until("it is centred there", async () => Math.hypot((await seen(page)).x - first.x + 58 * first.pixel, (await seen(page)).y - first.y + 20 * first.pixel) < 0.1, 3000);
  const tapped = await seen(page);
  await page.mouse.move(x, y);
  await page.mouse.down();
  await page.mouse.move(x + 30, y, { steps: 3 });
  await page.mouse.move(x, y, { steps: 3 });
  await page.mouse.up();
  await pause(200);
  assert.deepEqual(await seen(page), tapped, "who has dragged to and fro has not tapped");
});
await claim("two fingers zoom the plan about what lies between them, and it does not jump when one of them goes or comes", async (server) => {
  const page = (claims.shown = await opened(server));
  const session = await context.newCDPSession(page);
  const box = await page.locator(".plan-view").boundingBox();
  const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
  const first = await seen(page);
  await touch(session, "touchStart", [[x - 50, y]]);
  await touch(session, "touchStart", [[x - 50, y], [x + 30, y]]);
  await pause(100);
  assert.deepEqual(await seen(page), first, "the second finger makes it jump");
  await touch(session, "touchMove", [[x - 90, y], [x + 70, y]]);
  await until("it is twice as near", async () => Math.abs((await seen(page)).pixel / first.pixel - 0.5) < 0.01, 3000);
  const near = await seen(page);
  assert.ok(Math.abs(near.x - 10 * near.pixel - (first.x - 10 * first.pixel)) < 0.05, "what lies between the fingers stays there");
  await touch(session, "touchEnd", [[x + 70, y, 1]]);
  await pause(100);
  assert.deepEqual(await seen(page), near, "it jumps when a finger goes");
  await touch(session, "touchMove", [[x - 60, y]]);
  await until("the other finger drags it on", async () => Math.abs((await seen(page)).x - near.x + 30 * near.pixel) < 0.05, 3000);
  await touch(session, "touchEnd", []);
});
await claim("on a phone that lies on its side something is left to scroll by", async (server) => {
  const page = (claims.shown = await opened(server));
  await page.setViewportSize({ width: 640, height: 320 });
  const box = await page.locator(".plan-view").boundingBox();
  assert.ok(box.height > 100 && box.height < 220, `${box.height} of 320 pixels`);
});
await browser.close();
process.exit(claims.failures.length ? 1 : 0);
