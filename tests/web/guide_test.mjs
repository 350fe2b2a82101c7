// What a person is told on the way, on the page: the lift for who takes no stairs, that the path was left and which one comes
// instead, names that were drawn to do harm, and that a session has ended. The person is led by their true place: what
// localisation can do is asked elsewhere. Screenshots are left in the last folder.
// usage: node guide_test.mjs BIN MARKETPLACE NODE_MODULES SCREENSHOTS
import assert from "node:assert/strict";
import { mkdirSync, readFileSync, writeFileSync } from "node:fs";
import { dirname, join, resolve } from "node:path";
import { fileURLToPath } from "node:url";
import { Claims, Navigator, accessible, api, browserProgram, browserTools, closeDialog, listenTo, newest, saidBy, skip, until } from "./navigator.mjs";

const [bin, marketplace, modules, screenshots] = process.argv.slice(2).map((path) => resolve(path));
if (!browserProgram) skip("there is no chromium on this machine (apt-get install chromium)");
const { chromium, axe } = browserTools(modules);
mkdirSync(screenshots, { recursive: true });
const kPassword = "correct-horse";
const kDrawn = `<img src=x onerror="document.title='harmed'"><script>document.title='harmed'</script>\u202eevil\u200b\u0085Office 1.01`;
const kTold = `<img src=x onerror="document.title='harmed'"><script>document.title='harmed'</script> evil Office 1.01`;

const system = new Navigator(bin, marketplace);
const fiona = (...words) => system.fiona(...words);
const claims = new Claims();
const claim = (what, test) => claims.claim(what, test);

/// The building of the demonstration, with one room whose name was drawn to do harm.
const drawn = join(system.home, "drawn.osm");
const building = readFileSync(join(dirname(fileURLToPath(import.meta.url)), "../../plugins/building-simulator/institute.osm"), "utf8");
const xml = (text) => text.replace(/[&<>"]|[^\0-\x7f]/g, (one) => `&#${one.charCodeAt(0)};`);
writeFileSync(drawn, building.replace('"Office 1.01"', `"${xml(kDrawn)}"`));
system.users(["add", "anna", "--level", "3"], `${kPassword}\n`);

const browser = await chromium.launch({ executablePath: browserProgram, args: ["--no-sandbox"] });
const picture = (page, name) => page.screenshot({ path: join(screenshots, `${name}.png`), scale: "css" });
async function open() {
  const page = await (await browser.newContext({ viewport: { width: 390, height: 844 }, deviceScaleFactor: 2, hasTouch: true })).newPage();
  await page.goto(system.link());
  await page.getByText("Connected", { exact: true }).waitFor();
  return page;
}

try {
  await system.start(`map.building=${drawn}`);
  fiona("wire", "nav.location", "to", "phone.truth");
  // A session of the least time, on a page of its own; what becomes of it is asked a minute later.
  fiona("set", "web", "session_time=60s");
  const brief = await open();
  fiona("set", "web", "session_time=604800s");
  const page = await open();
  claims.shown = page;
  const steps = () => page.locator(".steps ol").innerText();
  const now = page.locator(".now .text");
  const arrived = () => until("the person arrives", async () => /^You have arrived|^You are at/.test(await now.innerText()), 180000);
  const pick = async (room) => {
    await page.getByLabel("Where to?").fill(room);
    await page.locator(".rooms li").first().waitFor();
    await page.keyboard.press("Enter");
    await until(`the way to ${room}`, async () => (await page.locator(".to").innerText()).includes(room) && (await page.locator(".steps li").count()) > 1);
  };

  await claim("who takes no stairs is led to the lift", async () => {
    await page.getByRole("button", { name: "Log in" }).click();
    await page.getByLabel("Name").fill("anna");
    await page.getByLabel("Password").fill(kPassword);
    await page.keyboard.press("Enter");
    await page.getByText("Access level 3").waitFor();
    await page.getByLabel("Stairs").selectOption("no");
    await page.getByText("Saved.").waitFor();
    await closeDialog(page);
    await pick("1.09");
    assert.match(await steps(), /Take the lift to/);
    assert.doesNotMatch(await steps(), /stairs/i);
    assert.match(await now.innerText(), /^To Office 1\.09, \d+ m:/);
    await picture(page, "guide-lift");
  });
  // On the path behind some corners, above that place, and where the path ends.
  const points = [];
  await claim("points of attention are set on the way", async () => {
    const path = (await newest(page, "path")).points;
    const corner = path.find(([x, y, level]) => level === 0 && Math.hypot(x - path[0][0], y - path[0][1]) > 10);
    const end = path.at(-1);
    points.push({ x: corner[0], y: corner[1], level: 0, name: "the fountain" }, { x: corner[0], y: corner[1], level: 2, name: "the bell" });
    points.push({ x: end[0], y: end[1], level: 1, name: "the sofa" });
    assert.equal((await api(page, "points", { points })).status, 200);
    await listenTo(page, ".passing", ".now .text");
  });
  await claim("the person rides it, the floor that is shown follows, and so does the arrival", async () => {
    await until("level 1 is shown", async () => (await page.locator('.levels [aria-pressed="true"]').innerText()).startsWith("1"), 180000);
    await arrived();
    fiona("expect", "phone.truth.position.z", "==", "1", "for", "5s");
  });
  await claim("a point that was passed was announced once, one on another level never, and neither was what is to be done", async () => {
    assert.deepEqual(await saidBy(page, ".passing"), ["You are passing the fountain.", "You are passing the sofa."]);
    const toldToDo = await saidBy(page, ".now .text");
    assert.ok(toldToDo.length > 3, "too little was heard");
    assert.deepEqual(toldToDo.filter((text) => /passing/.test(text)), []);
  });
  await claim("what is passed after the arrival does not stand in its place, nor for who opens the page later", async () => {
    assert.equal((await api(page, "points", { points: [...points, { ...points.at(-1), name: "the lamp" }] })).status, 200);
    // Who is led to where they are has arrived by the time that they pass it.
    await page.getByLabel("Where to?").fill("1.09");
    await page.keyboard.press("Enter");
    await until("it is passed", async () => (await saidBy(page, ".passing")).some((text) => text.includes("the lamp")));
    const late = await open();
    for (const one of [page, late]) await one.locator(".now .text", { hasText: /^You have arrived|^You are at/ }).waitFor();
    await accessible(axe, late, "arrived");
    await late.close();
  });
  await claim("a room to which there is no way is told, and which wish of the profile is in the way", async () => {
    const lifts = async (what) => {
      await page.getByRole("button", { name: "Profile of anna" }).click();
      await page.getByLabel("Lifts").selectOption(what);
      await page.getByText("Saved.").waitFor();
      await closeDialog(page);
    };
    await lifts("no");
    await page.getByLabel("Where to?").fill("2.01");
    await page.keyboard.press("Enter");
    await page.getByText("There is no way to Studio (2.01) without stairs, and your profile leaves stairs out.").waitFor();
    await page.locator(".to").waitFor({ state: "detached" });
    await accessible(axe, page, "no way");
    await picture(page, "guide-no-way");
    await lifts("");
  });
  await claim("a room that is sent from the console is the one that the page tells", async () => {
    await pick("1.03");
    const { rooms } = await api(page, "map", {});
    const { x, y } = rooms.find((room) => room.ref === "1.14");
    fiona("send", "nav.destination", `{destination: {x: ${x} y: ${y} z: 1 is_valid: true}}`);
    await page.locator(".to", { hasText: "To Office 1.14" }).waitFor();
    await page.locator(".steps li", { hasText: "Arrive at Office 1.14" }).waitFor();
    assert.doesNotMatch(await page.locator(".panel").innerText(), /1\.03/);
  });

  await claim("a name that was drawn to do harm is a text like others", async () => {
    await pick("1.01");
    assert.ok((await page.locator(".to").innerText()).includes(kTold), "as the destination");
    await picture(page, "guide-harm");
    assert.equal(await page.locator("main img, main script, svg script, svg image").count(), 0);
    assert.doesNotMatch(await page.title(), /harmed/);
    const unsafe = await page.evaluate(() => {
      const harm = /[\u0000-\u0008\u000b-\u001f\u007f-\u009f\u200b-\u200f\u202a-\u202e\u2060-\u206f]/;
      const texts = [...document.querySelectorAll("*")].flatMap((one) => [...one.getAttributeNames().map((name) => one.getAttribute(name)), one.textContent]);
      return texts.filter((text) => harm.test(text)).length;
    });
    assert.equal(unsafe, 0, "texts and attributes with control characters");
    await accessible(axe, page, "a drawn name");
  });
  await claim("who leaves the path is told so, and gets another one, which leads to the room", async () => {
    const planned = await steps();
    await page.evaluate(() => {
      window.told = [];
      new MutationObserver(() => window.told.push(document.querySelector(".now .text")?.textContent)).observe(document.body, { subtree: true, childList: true, characterData: true });
    });
    // Another guide leads the same person elsewhere.
    for (const line of [
      "load smart-fiona-navigation as astray", "wire astray.location to phone.truth", "wire astray.levels to map.levels",
      "wire astray.planner to planner.plan", "wire phone.instructions to astray.instructions",
      "send astray.destination {destination: {x: 47 y: 10.5 z: 1 is_valid: true}}",
    ]) fiona(line);
    const left = "You have left the path. Stop: another one is being planned.";
    await until("it is told", () => page.evaluate((text) => window.told.includes(text), left), 90000);
    fiona("wire", "phone.instructions", "to", "nav.instructions");
    fiona("unload", "astray");
    await until("there is another way", async () => (await page.locator(".steps li").count()) > 1 && (await steps()) !== planned);
    await until("it is told no more", async () => (await now.innerText()) !== left);
    await accessible(axe, page, "another way");
    await picture(page, "guide-another-way");
    await arrived();
  });
  await claim("a guide without a map says so on the page", async () => {
    for (const line of [
      "load smart-fiona-navigation as mapless", "wire mapless.location to phone.truth", "wire mapless.planner to planner.plan",
      "wire web.instructions to mapless.instructions", "wire web.destination to mapless.destination",
    ]) fiona(line);
    await page.getByLabel("Where to?").fill("1.02");
    await page.keyboard.press("Enter");
    await page.locator(".now .text", { hasText: "The way cannot be planned: there is no map of the building: " }).waitFor();
    await picture(page, "guide-no-map");
    for (const port of ["instructions", "destination"]) fiona("wire", `web.${port}`, "to", `nav.${port}`);
    fiona("unload", "mapless");
  });
  await claim("a building without levels is refused, and a page that has no other is told that there is no map", async () => {
    const flat = join(system.home, "flat.osm");
    const corners = [[48.4, 9.9], [48.401, 9.9], [48.401, 9.901]].map(([lat, lon], i) => `<node id="${i + 1}" lat="${lat}" lon="${lon}"/>`);
    const outline = `<way id="9"><nd ref="1"/><nd ref="2"/><nd ref="3"/><nd ref="1"/><tag k="building" v="yes"/></way>`;
    writeFileSync(flat, `<osm version="0.6">${corners.join("")}${outline}</osm>`);
    assert.throws(() => fiona("load", "map-server", "as", "flat", `building=${flat}`), /has nothing on a level/);
    fiona("load", "smart-web-interface", "as", "bare", "in", "bare", `database=${join(system.home, "bare.db")}`);
    fiona("wire", "bare.levels", "to", "flat.levels");
    const bare = await (await browser.newContext({ viewport: { width: 390, height: 844 } })).newPage();
    await bare.goto(/url="([^"]+)"/.exec(fiona("call", "bare.link"))[1]);
    await bare.getByText("There is no map of the building: there is no instance 'flat' yet.").waitFor();
    await picture(bare, "guide-no-levels");
    await bare.close();
  });
  await claim("a page whose session is over says so, and how to get another", async () => {
    await brief.getByText("The page's session has ended: open it with a new link.").waitFor({ timeout: 90000 });
    await accessible(axe, brief, "session over");
    await picture(brief, "guide-session-over");
    assert.equal(await brief.evaluate(() => sessionStorage.getItem("fiona-session")), null);
    await page.getByText("Connected", { exact: true }).waitFor();
  });
} finally {
  await browser.close();
  if (claims.failures.length) console.log(system.said);
  await system.close();
}
process.exit(claims.failures.length ? 1 : 0);
