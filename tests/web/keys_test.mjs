// The page by keys alone, by a server that is played: what the keyboard reaches shows that it has the focus, and whatever can be
// done with a pointer is done without one, and leaves the focus where one goes on.
// usage: node keys_test.mjs BIN MARKETPLACE NODE_MODULES SCREENSHOTS
import assert from "node:assert/strict";
import { join, resolve } from "node:path";
import { Claims, browserProgram, browserTools, skip, until } from "./navigator.mjs";
import { anna, kBuilding, kRunning, kToOffice, play } from "./played_server.mjs";

const modules = resolve(process.argv[4]);
if (!browserProgram) skip("there is no chromium on this machine (apt-get install chromium)");
const browser = await browserTools(modules).chromium.launch({ executablePath: browserProgram, args: ["--no-sandbox"] });
const context = await browser.newContext({ viewport: { width: 390, height: 844 } });
const claims = new Claims();

const kMostStops = 60;
/// What has the focus: its name, as far as the page tells it, and whether one sees that it has.
const focused = (page) =>
  page.evaluate(() => {
    const one = document.activeElement;
    if (!one || one === document.body) return { name: "nothing", seen: false };
    const style = getComputedStyle(one);
    const box = one.getBoundingClientRect();
    const ring = style.outlineStyle !== "none" && parseFloat(style.outlineWidth) >= 2 && !/, 0\)$/.test(style.outlineColor);
    const name = one.getAttribute("aria-label") ?? one.labels?.[0]?.textContent ?? one.textContent;
    return { name, seen: ring && box.width > 0 && box.right > 0 && box.bottom > 0 };
  });
/// Goes on with TAB until that has the focus.
async function reach(page, name) {
  for (let stop = 0; stop < kMostStops; ++stop) {
    await page.keyboard.press("Tab");
    const now = await focused(page);
    if (!now.name.startsWith(name)) continue;
    assert.ok(now.seen, `${name} does not show that it has the focus`);
    return;
  }
  assert.fail(`TAB does not reach ${name}`);
}
/// All that TAB comes to until it leaves the page, or begins anew.
async function stops(page) {
  const found = [];
  await page.evaluate(() => document.activeElement?.blur());
  for (;;) {
    await page.keyboard.press("Tab");
    const now = await focused(page);
    if (now.name === "nothing" || found.some((one) => one.name === now.name)) return found;
    found.push(now);
    assert.ok(found.length < kMostStops, "TAB does not come to an end");
  }
}
const has = async (page, name) => assert.match((await focused(page)).name, name);
const asked = (server, name) => server.asked.filter((one) => one.name === name).map((one) => one.body);

async function claim(what, test) {
  const server = await play(join(modules, "../dist"));
  const page = (claims.shown = await context.newPage());
  await claims.claim(what, async () => {
    await test(page, server, async () => {
      await page.goto(`${server.url}/#played`);
      await page.getByRole("heading", { name: "Played House" }).waitFor();
      await page.getByText("Connected", { exact: true }).waitFor();
    });
  });
  await page.close();
  await server.close();
}

await claim("TAB reaches all that can be used, and each shows that it has the focus", async (page, server, open) => {
  server.answer("me", 200, anna());
  server.tell("path", kToOffice);
  await open();
  const found = await stops(page);
  assert.deepEqual(found.filter((one) => !one.seen).map((one) => one.name), []);
  assert.deepEqual(
    found.map((one) => one.name.replace(/Floor plan of .*/, "plan")),
    ["Skip to destination and steps", "Profile of anna", "Guide", "plan", "1, First floor", "0, Ground floor, where you are", "Zoom in", "Zoom out", "Show the whole level", "Follow me", "Where to?",
      "Office 0.1Ground floor", "Office 0.2Ground floor", "Library (1.1)First floor"],
  );
});
await claim("the first stop leads past the plan", async (page, _, open) => {
  await open();
  await page.keyboard.press("Tab");
  await page.keyboard.press("Enter");
  await page.keyboard.press("Tab");
  await has(page, /^Where to\?/);
});
await claim("a room is searched, and picked from the list; the focus is then at the steps", async (page, server, open) => {
  await open();
  await reach(page, "Where to?");
  await page.keyboard.type("0.2");
  await reach(page, "Office 0.2");
  await page.keyboard.press("Enter");
  await until("it is asked for", () => asked(server, "destination").length === 1);
  assert.deepEqual(asked(server, "destination"), [{ x: 9, y: 5.5, level: 0 }]);
  assert.equal(await page.evaluate(() => document.activeElement.id), "panel");
});
await claim("ENTER takes the room that is typed, by number, name or use, and no other where that one is closed", async (page, server, open) => {
  const use = { "0.1": "first_aid", "0.2": "break_room", "1.1": "library" };
  // In the order of names these come before: their number, or their level's name, has what is typed.
  const more = [{ ...kBuilding.rooms[1], id: "20", ref: "10.2", name: "Archive 10.2" }, { ...kBuilding.rooms[1], id: "21", ref: "", name: "Attic" }];
  server.answer("map", 200, {
    ...kBuilding,
    levels: [{ level: 0, name: "Library floor" }, { level: 1, name: "First floor" }],
    rooms: [...kBuilding.rooms.map((room) => ({ ...room, use: use[room.ref] ?? "" })), ...more],
  });
  await open();
  const enter = async (typed) => {
    await page.getByLabel("Where to?").fill(typed);
    await page.keyboard.press("Enter");
  };
  await enter("0.3");
  await page.getByRole("status").getByText("Donaudampfschifffahrtsgesellschaftsversammlungsraum of the whole institute (0.3) is not open to you.").waitFor();
  await page.getByLabel("Where to?").fill("0.");
  await page.getByText("is not open to you.").waitFor({ state: "detached" });
  assert.deepEqual(asked(server, "destination"), []);
  for (const [index, [typed, at]] of [["0.2", { x: 9, y: 5.5, level: 0 }], ["break room", { x: 9, y: 5.5, level: 0 }], ["library", { x: 6, y: 5.5, level: 1 }], ["first aid", { x: 3, y: 5.5, level: 0 }]].entries()) {
    await enter(typed);
    await until(`${typed} is asked for`, () => asked(server, "destination").length === index + 1, 5000);
    assert.deepEqual(asked(server, "destination").at(-1), at, typed);
  }
});
await claim("ESCAPE closes the list of rooms", async (page, _, open) => {
  await open();
  await reach(page, "Where to?");
  await page.locator(".rooms li").first().waitFor();
  await page.keyboard.press("Escape");
  await page.locator(".rooms").waitFor({ state: "detached" });
  await has(page, /^Where to\?/);
});
await claim("the plan is moved by arrows and zoomed by plus and minus", async (page, _, open) => {
  await open();
  await reach(page, "Floor plan of");
  const view = async () => (await page.locator(".plan-view svg").getAttribute("viewBox")).split(" ").map(Number);
  for (const [key, which, sign] of [["ArrowRight", 0, 1], ["ArrowLeft", 0, -1], ["ArrowDown", 1, 1], ["ArrowUp", 1, -1], ["+", 2, -1], ["-", 2, 1]]) {
    const before = await view();
    await page.keyboard.press(key);
    await until(`${key} changes the view`, async () => ((await view())[which] - before[which]) * sign > 0.1, 3000);
  }
});
await claim("the plan's buttons zoom, show all and follow", async (page, _, open) => {
  await open();
  const span = async () => Number((await page.locator(".plan-view svg").getAttribute("viewBox")).split(" ")[2]);
  const whole = await span();
  await reach(page, "Zoom in");
  await page.keyboard.press("Enter");
  await until("it is nearer", async () => (await span()) < whole, 3000);
  await reach(page, "Zoom out");
  await page.keyboard.press("Space");
  await reach(page, "Show the whole level");
  await page.keyboard.press("Enter");
  await until("the whole level is shown", async () => (await span()) === whole, 3000);
  await reach(page, "Follow me");
  await page.keyboard.press("Enter");
  await page.locator('[aria-label="Follow me"][aria-pressed="true"]').waitFor();
});
await claim("another level is shown", async (page, _, open) => {
  await open();
  await reach(page, "1, First floor");
  await page.keyboard.press("Space");
  await page.locator('.plan-view[aria-label^="Floor plan of First floor"]').waitFor();
  await page.locator(".room-name", { hasText: "Library" }).waitFor({ state: "attached" });
});
await claim("arrows go from tab to tab", async (page, server, open) => {
  server.answer("system", 200, kRunning);
  await open();
  await reach(page, "Guide");
  await page.keyboard.press("ArrowRight");
  await page.locator("#view-running").waitFor();
  await has(page, /^What is running/);
  assert.ok((await focused(page)).seen);
  await page.keyboard.press("ArrowRight");
  await page.locator("#view-guide").waitFor();
  await has(page, /^Guide/);
});
await claim("a provider is switched, and the focus stays with it", async (page, server, open) => {
  server.answer("me", 200, anna());
  server.answer("system", 200, kRunning);
  server.answer("rewire", 200, { note: "nav.location to wifi.location", gap: 12, lost: 0 });
  await open();
  await reach(page, "Guide");
  await page.keyboard.press("ArrowRight");
  await reach(page, "Another provider for nav.location");
  await page.keyboard.press("w");
  await reach(page, "Switch nav.location");
  await page.keyboard.press("Enter");
  await page.getByText("nav.location to wifi.location: gap 12 ms, lost 0").waitFor();
  assert.deepEqual(asked(server, "rewire"), [{ client: "nav.location", provider: "wifi.location" }]);
  await has(page, /^Another provider for nav\.location/);
});
await claim("one logs in; the focus goes to the profile, and back to where one came from", async (page, server, open) => {
  server.answer("login", 200, anna());
  await open();
  await reach(page, "Log in");
  await page.keyboard.press("Enter");
  await page.getByRole("dialog").waitFor();
  await reach(page, "Name");
  await page.keyboard.type("anna");
  await reach(page, "Password");
  await page.keyboard.type("correct-horse");
  await reach(page, "Log in");
  await page.keyboard.press("Enter");
  await page.getByText("Access level 3").waitFor();
  assert.deepEqual(asked(server, "login"), [{ name: "anna", password: "correct-horse" }]);
  await has(page, /^anna/);
  await page.keyboard.press("Escape");
  await page.getByRole("dialog").waitFor({ state: "detached" });
  await has(page, /^Profile of anna/);
});
await claim("the profile is changed, a point added and removed, and one logs out; the focus is never lost", async (page, server, open) => {
  const plant = { x: 2, y: 1.5, level: 0, name: "the plant" };
  server.answer("me", 200, anna());
  server.answer("profile", 200, anna());
  server.answer("points", 200, ({ points }) => anna(...points));
  server.answer("logout", 200, { user: null, profile: null, notice: "" });
  await open();
  await reach(page, "Profile of anna");
  await page.keyboard.press("Enter");
  await reach(page, "Stairs");
  await page.keyboard.press("End");  // "I take no stairs"
  await page.getByText("Saved.").waitFor();
  assert.equal(asked(server, "profile").at(-1).use_stairs, false);
  await has(page, /^Stairs/);
  await reach(page, "Name of the place where you are");
  await page.keyboard.type("the plant");
  await page.keyboard.press("Enter");
  await page.getByText("Added.").waitFor();
  assert.deepEqual(asked(server, "points").at(-1), { points: [plant] });
  await has(page, /^Name of the place/);
  await reach(page, "Remove the plant");
  await page.keyboard.press("Enter");
  await page.getByText("Removed.").waitFor();
  assert.deepEqual(asked(server, "points").at(-1), { points: [] });
  assert.notEqual((await focused(page)).name, "nothing");
  await reach(page, "Log out");
  await page.keyboard.press("Enter");
  await page.getByText("You are logged out.").waitFor();
  await has(page, /^Log in/);
});
await browser.close();
process.exit(claims.failures.length ? 1 : 0);
