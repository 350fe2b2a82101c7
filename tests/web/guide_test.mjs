// What a person is told on the way, on the page: the lift for who takes no stairs, that the path was left and which one comes
// instead, names that were drawn to do harm, and that a session has ended. The person is led by their true place: what
// localisation can do is asked elsewhere. Screenshots are left in the last folder.
// usage: node guide_test.mjs BIN MARKETPLACE NODE_MODULES SCREENSHOTS
import assert from "node:assert/strict";
import { mkdirSync, readFileSync, writeFileSync } from "node:fs";
import { dirname, join, resolve } from "node:path";
import { fileURLToPath } from "node:url";
import { Claims, Navigator, accessible, browserProgram, browserTools, skip, until } from "./navigator.mjs";

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
    await page.getByRole("button", { name: "Close" }).click();
    await pick("1.09");
    assert.match(await steps(), /Take the lift to/);
    assert.doesNotMatch(await steps(), /stairs/i);
    assert.match(await now.innerText(), /^To Office 1\.09, \d+ m:/);
    await picture(page, "guide-lift");
  });
  await claim("the person rides it, the floor that is shown follows, and so does the arrival", async () => {
    await until("level 1 is shown", async () => (await page.locator('.levels [aria-pressed="true"]').innerText()).startsWith("1"), 180000);
    await arrived();
    fiona("expect", "phone.truth.position.z", "==", "1", "for", "5s");
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
      "load smart-fiona-navigation as astray declination=4deg", "wire astray.location to phone.truth", "wire astray.levels to map.levels",
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
