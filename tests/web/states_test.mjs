// Every state that the page can be in, one after the other, by a server that is played: in each the page says what it is, axe-core
// finds nothing, light or dark, and at 320 pixels nothing is cut or scrolls sideways. Screenshots are left in the last folder.
// usage: node states_test.mjs BIN MARKETPLACE NODE_MODULES SCREENSHOTS
import assert from "node:assert/strict";
import { mkdirSync } from "node:fs";
import { join, resolve } from "node:path";
import { Claims, accessible, browserProgram, browserTools, skip, uncut } from "./navigator.mjs";
import { anna, at, instruction, kBuilding, kRunning, kStatus, kToLibrary, kToOffice, play } from "./played_server.mjs";

const [modules, screenshots] = process.argv.slice(4).map((path) => resolve(path));
if (!browserProgram) skip("there is no chromium on this machine (apt-get install chromium)");
const { chromium, axe } = browserTools(modules);
mkdirSync(screenshots, { recursive: true });

const button = (page, name) => page.getByRole("button", { name, exact: true });
const search = (typed) => (page) => page.getByLabel("Where to?").fill(typed);
const running = (page) => page.getByRole("tab", { name: "What is running" }).click();
const account = (page, name = "Log in") => button(page, name).click();
const logIn = async (page) => {
  await account(page);
  await page.getByLabel("Name").fill("anna");
  await page.getByLabel("Password").fill("correct-horse");
  await page.keyboard.press("Enter");
};
const pick = (room) => async (page) => {
  await search(room)(page);
  await page.keyboard.press("Enter");
};
const told = (topic, value) => (server) => server.tell(topic, value);
const port = (states) => told("status", { ...kStatus, ...states });
const says = (kind, text, more) => told("instruction", instruction(1, kind, text, more));
const answers = (name, status, value) => (server) => server.answer(name, status, value);
const logged = (...points) => answers("me", 200, anna(...points));
const both = (...all) => (server) => all.forEach((each) => each(server));
const refused = (name, status, error) => answers(name, status, { error });
const kPlant = { x: 2, y: 1.5, level: 0, name: "the big plant in its pot of Ulm sandstone, a present of 1977" };

const kLed = both(told("path", kToLibrary), says("TURN", "Turn left, then take the lift.", { hour: 9, distance: 12, uncertain: true }), told("attention", [instruction(2, "ATTENTION", `You are passing ${kPlant.name}.`)]));

/// name; what the server is made to say first; what is done on the page then; what the page shows for it.
const kStates = [
  { name: "opened without a link", link: "", shows: "This page is opened with a link." },
  { name: "a link that was used", given: refused("session", 403, "this link has been used, or is too old: ask for a new one"), shows: "This link has been used, or is too old: ask for a new one." },
  { name: "a session that is over", given: refused("events", 401, "the page's session has ended: open it with a new link"), shows: "The page's session has ended: open it with a new link." },
  { name: "never connected", given: refused("events", 503, "played"), shows: "Connecting…" },
  { name: "connection lost", then: (_, server) => server.lose(), shows: "No guidance without a connection" },
  { name: "open", shows: "Choose a room, and the way to it is shown here step by step." },
  { name: "asked for a room", then: pick("0.2"), shows: /Asked for Office 0\.2, Ground floor/ },
  { name: "on the way", given: both(told("path", kToLibrary), says("TURN", "Turn left, then take the lift.", { hour: 9, distance: 12 })), shows: /To Library \(1\.1\), First floor/ },
  { name: "to a place without a name", given: told("path", { valid: true, points: [[2, 1.5, 0], [16, 1.5, 0]] }), shows: /To a place without a name, Ground floor/ },
  { name: "arrived", given: both(told("path", { valid: false, points: [] }), says("ARRIVE", "You have arrived at Office 0.2.", { distance: 0 })), shows: "You have arrived at Office 0.2." },
  { name: "no way", given: says("NO_PATH", "There is no way to Library without a lift, and your profile leaves lifts out."), shows: "There is no way to Library without a lift, and your profile leaves lifts out." },
  { name: "the guide has no map", given: says("NO_PATH", "The way cannot be planned: there is no map of the building: it does not answer."), shows: "The way cannot be planned: there is no map of the building: it does not answer." },
  { name: "a destination that is refused", given: refused("destination", 409, "the session has ended"), then: pick("0.2"), shows: "Office 0.2: The session has ended." },
  { name: "nobody who would lead there", given: refused("destination", 503, "navigation is not part of this system"), then: pick("0.2"), shows: "Office 0.2: Navigation is not part of this system." },
  { name: "guidance lost", given: both(port({ instructions: "lost" }), says("TURN", "Turn left.", { hour: 9 })), shows: "No guidance: navigation was lost" },
  { name: "guidance started again, and one is not led", given: kLed, then: async (page, server) => (await page.locator(".to", { hasText: "Library" }).waitFor(), server.tell("path", { valid: false, points: [] }), server.tell("instruction", null)), shows: "Guidance was started again: you are not led any more.", picture: "state-not-led" },
  { name: "no guide, and the way alone", given: both(port({ instructions: "unwired" }), told("path", kToOffice)), shows: "Turn left, then 4 m" },
  { name: "no map in the system", given: both(port({ map: "unwired", mapFault: "not wired" }), refused("map", 503, "there is no map yet"), told("map", { version: "" })), shows: "This system has no map." },
  { name: "a map that is waited for", given: told("map", { version: "" }), shows: "Waiting for the map…" },
  { name: "a map that cannot be had", given: both(port({ map: "waiting", mapFault: "there is no instance 'map' yet" }), told("map", { version: "" })), shows: "There is no map of the building: there is no instance 'map' yet.", picture: "state-no-map" },
  { name: "a map without levels", given: answers("map", 200, { ...kBuilding, levels: [], rooms: [], walls: [], entrances: [] }), shows: "The map of the building has no levels with rooms: there is nothing to be shown, and nowhere to be led." },
  { name: "position uncertain", given: told("location", at(2, 1.5, 0, 12)), shows: "within 12 m", picture: "state-uncertain" },
  { name: "localisation lost", given: port({ location: "lost" }), shows: "Position uncertain: localisation was lost" },
  { name: "no localisation", given: port({ location: "unwired" }), shows: "No localisation in this system" },
  { name: "passing a point of attention", given: both(told("path", kToOffice), says("CONTINUE", "Go straight on.", { hour: 12 }), told("attention", [instruction(2, "ATTENTION", `You are passing ${kPlant.name}.`)])), shows: `You are passing ${kPlant.name}.`, picture: "state-passing" },
  { name: "search", then: search(""), shows: "4 rooms" },
  { name: "a room that is not open to who asks", then: pick("0.3"), shows: /institute \(0\.3\) is not open to you\./, picture: "state-not-open" },
  { name: "a search without a result", then: search("swimming bath"), shows: "No room is called that." },
  { name: "log-in", then: (page) => account(page), shows: "Without logging in you are a guest: you are guided, and nothing is kept." },
  { name: "log-in on the way", given: kLed, then: (page) => account(page), shows: "Without logging in you are a guest: you are guided, and nothing is kept.", picture: "state-login-led" },
  { name: "log-in refused", given: refused("login", 403, "name and password do not fit"), then: logIn, shows: "Name and password do not fit." },
  { name: "log-in too often", given: refused("login", 409, "too many attempts: wait 6 s before the next one"), then: logIn, shows: "Too many attempts: wait 6 s before the next one." },
  { name: "profile", given: logged(kPlant), then: (page) => account(page, "Profile of anna"), shows: "Access level 3", picture: "state-profile" },
  { name: "a profile that cannot be read", given: answers("me", 200, { ...anna(), profile: null }), then: (page) => account(page, "Profile of anna"), shows: "Your profile cannot be read now." },
  { name: "logged out", given: both(logged(), answers("logout", 200, { user: null, profile: null, notice: "You are logged out here; the session itself could not be ended." })), then: async (page) => (await account(page, "Profile of anna"), await button(page, "Log out").click()), shows: "You are logged out here; the session itself could not be ended." },
  { name: "a log-in that has ended", given: answers("me", 200, { user: null, profile: null, notice: "Your session has ended: log in again." }), shows: "Your session has ended: log in again." },
  { name: "what is running, for a guest", given: refused("system", 403, "this takes the access level 1, and you have 0"), then: running, shows: "This takes the access level 1, and you have 0." },
  { name: "what is running, on the way", given: both(kLed, logged(), answers("system", 200, kRunning)), then: running, shows: /has nothing on a level/, picture: "state-running-led" },
  { name: "what is running, where nobody can log in", given: both(port({ login: "unwired" }), refused("system", 403, "this takes the access level 1, and you have 0")), then: running, shows: "This takes the access level 1, and you have 0." },
  { name: "what is running, with what has failed", given: both(logged(), answers("system", 200, kRunning)), then: running, shows: /has nothing on a level/, picture: "state-failed" },
  { name: "a switch that is refused", given: both(logged(), answers("system", 200, kRunning), refused("rewire", 409, "nav.location stays with bluetooth.location: wifi.location has another contract")), then: async (page) => {
    await running(page);
    await page.getByLabel("Another provider for nav.location").selectOption("wifi.location");
    await button(page, "Switch nav.location").click();
  }, shows: "Nav.location stays with bluetooth.location: wifi.location has another contract." },
];

const claims = new Claims();
const browser = await chromium.launch({ executablePath: browserProgram, args: ["--no-sandbox"] });
// One after the other on one page: each server has an origin of its own, for which nothing is kept.
const kPhone = { width: 390, height: 844 };
const page = await (await browser.newContext({ viewport: kPhone, hasTouch: true })).newPage();
claims.shown = page;
let troubles = [];
page.on("pageerror", (error) => troubles.push(String(error)));

await claims.claim("what is amiss in a state is found", async () => {
  const server = await play(join(modules, "../dist"));
  await page.goto(server.url);
  await page.locator(".closed").evaluate((one) => (one.innerHTML += '<img src="/icon.svg"><p style="width: 30em">wide</p>'));
  await assert.rejects(accessible(axe, page, "spoilt"), /image-alt/);
  await assert.rejects(uncut(page, "spoilt"), /beyond the window: <p style/);
  await server.close();
});
for (const { name, link = "#played", given, then, shows, picture } of kStates) {
  const server = await play(join(modules, "../dist"));
  troubles = [];
  await claims.claim(`${name}: told, no violation light or dark, nothing cut at 320 pixels`, async () => {
    await page.setViewportSize(kPhone);
    await page.emulateMedia({ colorScheme: "light" });
    given?.(server);
    await page.goto(`${server.url}/${link}`);
    if (then) {
      await page.getByText("Connected", { exact: true }).waitFor();
      await then(page, server);
    }
    await page.getByText(shows).first().waitFor({ timeout: 10000 });
    await accessible(axe, page, "light");
    await page.emulateMedia({ colorScheme: "dark" });
    await accessible(axe, page, "dark");
    if (picture) await page.screenshot({ path: join(screenshots, `${picture}.png`), fullPage: true });
    await page.setViewportSize({ width: 320, height: 640 });
    await uncut(page, "320 pixels");
    assert.deepEqual(troubles, []);
  });
  await server.close();
}
await browser.close();
process.exit(claims.failures.length ? 1 : 0);
