// The page in a real browser: opened by its link, logged in, led to a room; what it says when the server dies; what another
// page can do to it; and that axe-core finds nothing, in any state. Screenshots of phone and desk are left in the last folder.
// usage: node page_test.mjs BIN MARKETPLACE GUIDE NODE_MODULES SCREENSHOTS
import assert from "node:assert/strict";
import { execFileSync, spawn } from "node:child_process";
import { existsSync, mkdirSync, mkdtempSync, readFileSync, readdirSync, rmSync, writeFileSync } from "node:fs";
import { createServer } from "node:http";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { join, resolve } from "node:path";

const [bin, marketplace, guide, modules, screenshots] = process.argv.slice(2).map((path) => resolve(path));
const browserProgram = ["/usr/bin/chromium", "/usr/bin/chromium-browser"].find(existsSync);
if (!browserProgram) {
  console.log("skipped: there is no chromium on this machine (apt-get install chromium)");
  process.exit(77);
}
const require = createRequire(join(modules, "x.js"));
const { chromium } = require("playwright-core");
const axe = readFileSync(require.resolve("axe-core/axe.min.js"), "utf8");
mkdirSync(screenshots, { recursive: true });

const home = mkdtempSync(join(tmpdir(), "fiona-web-"));
const env = {
  ...process.env,
  XDG_STATE_HOME: join(home, "state"),
  XDG_RUNTIME_DIR: join(home, "run"),
  FIONA_STORE: join(home, "store"),
  FIONA_MARKET: marketplace,
};
for (const folder of ["state", "run", "store"]) mkdirSync(join(home, folder), { mode: 0o700 });
const kPassword = "canary-horse-battery";
const fiona = (...words) => execFileSync(join(bin, "fiona"), words, { env, encoding: "utf8", timeout: 60000, stdio: "pipe" });
const until = async (what, test, limit_ms = 30000) => {
  for (const end = Date.now() + limit_ms; Date.now() < end; ) {
    if (await test()) return;
    await new Promise((done) => setTimeout(done, 100));
  }
  assert.fail(`not within ${limit_ms / 1000} s: ${what}`);
};

let host = null;
let said = "";
const system = `
load map-server as map map_name=house
load authenticator as auth in users
load user-profiles as profiles in users
load ${guide}/guide as guide
load smart-web-interface as web in web
wire profiles.sessions to auth.sessions
wire profiles.levels to map.levels
wire map.profile to profiles.profile
wire guide.levels to map.levels
wire web.location to guide.location
wire web.path to guide.path
wire web.instructions to guide.instructions
wire web.destination to guide.destination
wire web.levels to map.levels
wire web.map_change to map.change
wire web.login to auth.login
wire web.sessions to auth.sessions
wire web.logout to auth.logout
wire web.profile to profiles.profile
wire web.update to profiles.update
wire web.points to profiles.points
`;
async function start() {
  writeFileSync(join(home, "web.fiona"), system);
  host = spawn(join(bin, "fiona"), ["run", join(home, "web.fiona"), "--headless"], { env, detached: true });
  for (const stream of [host.stdout, host.stderr]) stream.on("data", (bytes) => (said += bytes));
  await until("the page is served", () => {
    assert.equal(host.exitCode, null, `the system has ended: ${said}`);
    try {
      return fiona("show", "web").includes("active");
    } catch {
      return false;
    }
  }, 60000);
}
const link = () => /url="([^"]+)"/.exec(fiona("call", "web.link"))[1];
/// What it started, groups and all: they are one process group.
function stop(signal = "SIGKILL") {
  if (host?.exitCode === null) process.kill(-host.pid, signal);
  host = null;
}

const failures = [];
async function claim(what, test) {
  try {
    await test();
    console.log(`ok      ${what}`);
  } catch (error) {
    failures.push(what);
    console.log(`FAILED  ${what}\n        ${String(error.message ?? error).split("\n").slice(0, 12).join("\n        ")}`);
  }
}

async function accessible(page, state) {
  // A context of its own: the page's policy lets no script in, and is right to.
  await page.evaluate(axe);
  const { violations } = await page.evaluate(() =>
    window.axe.run(document, { runOnly: ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"] }),
  );
  assert.deepEqual(
    violations.map((one) => `${state}: ${one.id}: ${one.nodes.map((node) => node.html.slice(0, 120)).join(" | ")}`),
    [],
  );
}
const fits = async (page) => assert.equal(await page.evaluate(() => document.documentElement.scrollWidth > innerWidth), false, "it scrolls sideways");

execFileSync(join(bin, "fiona"), ["market", "install", "-q", "-y", "smart-web-interface", "map-server", "authenticator", "user-profiles"], { env });
execFileSync(join(bin, "fiona-users"), ["add", "anna", "--level", "3"], { env, input: `${kPassword}\n` });

const browser = await chromium.launch({ executablePath: browserProgram, args: ["--no-sandbox", "--host-resolver-rules=MAP evil.test 127.0.0.1"] });
try {
  await start();
  const url = link();
  const origin = new URL(url).origin;
  const context = await browser.newContext({ viewport: { width: 390, height: 844 }, deviceScaleFactor: 2, hasTouch: true });
  const page = await context.newPage();
  const troubles = [];
  page.on("pageerror", (error) => troubles.push(String(error)));
  page.on("console", (message) => message.type() === "error" && troubles.push(message.text()));
  const asked = [];
  page.on("request", (request) => asked.push(request.url()));

  await claim("without a link the page says how to get one", async () => {
    const other = await (await browser.newContext()).newPage();
    await other.goto(origin);
    await other.getByText("This page is opened with a link.").waitFor();
    await accessible(other, "closed");
    await other.close();
  });
  await claim("a link opens the page, and its token leaves the address", async () => {
    await page.goto(url);
    await page.getByText("Connected", { exact: true }).waitFor();
    await page.getByRole("heading", { name: "Blautal House" }).waitFor();
    assert.equal(page.url(), `${origin}/`);
  });
  await claim("a link opens one page only", async () => {
    const other = await (await browser.newContext()).newPage();
    await other.goto(url);
    await other.getByText("This link has been used, or is too old: ask for a new one.").waitFor();
    await other.close();
  });
  await claim("the plan shows the walker with the region around", async () => {
    await page.locator(".walker .region").waitFor({ state: "attached" });
    await accessible(page, "open");
    await page.screenshot({ path: join(screenshots, "phone-open.png") });
  });

  await claim("a wrong password is refused in words", async () => {
    await page.getByRole("button", { name: "Log in" }).click();
    await page.getByLabel("Name").fill("anna");
    await page.getByLabel("Password").fill("wrong horse");
    await page.locator(".login button.main").click();
    await page.getByText("Name and password do not fit.").waitFor();
    await accessible(page, "log-in refused");
    await page.screenshot({ path: join(screenshots, "phone-login.png") });
  });
  await claim("the right one shows the profile", async () => {
    await page.getByLabel("Password").fill(kPassword);
    await page.keyboard.press("Enter");
    await page.getByText("Access level 3").waitFor();
    await page.getByLabel("Stairs").selectOption("no");
    await page.getByText("Saved.").waitFor();
    await page.getByLabel("Name of the place where you are").fill("the big plant");
    await page.getByRole("button", { name: "Add this place" }).click();
    await page.getByText("Added.").waitFor();
    await accessible(page, "profile");
    await page.screenshot({ path: join(screenshots, "phone-profile.png") });
    await page.getByRole("button", { name: "Close" }).click();
  });
  await claim("a point of attention is told where the walker is", async () => {
    await page.getByText("Passing the big plant").waitFor();
  });

  await claim("a room is found by a part of its name, with the keyboard alone", async () => {
    await page.getByLabel("Where to?").focus();
    await page.keyboard.type("1.16");
    await page.locator(".rooms li").first().waitFor();
    await accessible(page, "search");
    await page.screenshot({ path: join(screenshots, "phone-search.png") });
    await page.keyboard.press("Enter");
    await page.locator(".steps li").first().waitFor();
    assert.match(await page.locator(".to").innerText(), /^To .*1\.16/);
  });
  await claim("position and steps move along the way", async () => {
    const place = () => page.locator(".walker > g").getAttribute("transform");
    const before = await place();
    const step = await page.locator('.steps [aria-current="step"]').innerText();
    await until("the walker moves", async () => (await place()) !== before);
    await accessible(page, "on the way");
    await page.screenshot({ path: join(screenshots, "phone-way.png") });
    await until("the step changes", async () => (await page.locator('.steps [aria-current="step"]').innerText()) !== step);
  });
  await claim("nothing scrolls sideways at 320 pixels", async () => {
    await page.setViewportSize({ width: 320, height: 640 });
    await fits(page);
    await page.screenshot({ path: join(screenshots, "narrow-way.png"), fullPage: true });
    await accessible(page, "narrow");
    await page.setViewportSize({ width: 390, height: 844 });
  });
  await claim("on a desk plan and steps are side by side", async () => {
    await page.setViewportSize({ width: 1280, height: 800 });
    await fits(page);
    await accessible(page, "desk");
    await page.screenshot({ path: join(screenshots, "desk-way.png") });
    await page.emulateMedia({ colorScheme: "dark" });
    await accessible(page, "dark");
    await page.screenshot({ path: join(screenshots, "desk-dark.png") });
    await page.emulateMedia({ colorScheme: "light" });
    await page.setViewportSize({ width: 390, height: 844 });
  });
  await claim("the plan is moved by keys", async () => {
    const view = () => page.locator(".plan-view svg").getAttribute("viewBox");
    await page.locator(".plan-view").focus();
    const before = await view();
    await page.keyboard.press("ArrowRight");
    await until("the plan moves", async () => (await view()) !== before);
  });
  await claim("the floor follows the walker to the destination's level", async () => {
    await until("level 1 is shown", async () => (await page.locator('.levels [aria-pressed="true"]').innerText()).startsWith("1"), 120000);
    await page.getByText("You have arrived").waitFor({ timeout: 60000 });
    await page.screenshot({ path: join(screenshots, "phone-arrived.png") });
  });
  await claim("localisation that ends is told as uncertain", async () => {
    fiona("unwire", "web.location");
    await page.getByText("No localisation in this system").waitFor({ timeout: 5000 });
    await accessible(page, "uncertain");
    fiona("wire", "web.location", "to", "guide.location");
    await page.getByText("No localisation in this system").waitFor({ state: "detached", timeout: 5000 });
  });

  await claim("what another page sends changes nothing and reads nothing", async () => {
    const evil = createServer((_, response) => response.writeHead(200, { "content-type": "text/html" }).end("<!doctype html><p>evil"));
    await new Promise((done) => evil.listen(0, "127.0.0.1", done));
    const foreign = await (await browser.newContext()).newPage();
    await foreign.goto(`http://127.0.0.1:${evil.address().port}/`);
    const calls = ["session", "events", "map", "me", "login", "logout", "profile", "points", "destination"];
    const outcomes = await foreign.evaluate(
      async ({ origin, calls }) => {
        const seen = [];
        for (const call of calls) {
          for (const type of ["text/plain", "application/x-www-form-urlencoded", "application/json"]) {
            for (const mode of ["cors", "no-cors"]) {
              try {
                const response = await fetch(`${origin}/api/${call}`, { method: "POST", mode, headers: { "content-type": type }, body: "{}" });
                seen.push(`${call} ${type} ${mode}: ${response.type} ${(await response.text()).length}`);
              } catch {
                seen.push("blocked");
              }
            }
          }
        }
        const loads = (element) =>
          new Promise((done) => {
            element.onload = () => done("loaded");
            element.onerror = () => done("blocked");
            document.body.append(element);
            setTimeout(() => done("nothing"), 3000);
          });
        const script = Object.assign(document.createElement("script"), { src: `${origin}/page.js` });
        seen.push(`script ${await loads(script)}`);
        const image = Object.assign(document.createElement("img"), { src: `${origin}/icon.svg` });
        seen.push(`image ${await loads(image)}`);
        const socket = await new Promise((done) => {
          const one = new WebSocket(origin.replace("http", "ws"));
          one.onopen = () => done("socket open");
          one.onerror = () => done("socket blocked");
        });
        return [...seen, socket];
      },
      { origin, calls },
    );
    // An opaque answer has no bytes; a blocked one does not arrive.
    const bad = outcomes.filter((one) => !["blocked", "script blocked", "image blocked", "socket blocked"].includes(one) && !/no-cors: opaque 0$/.test(one));
    assert.deepEqual(bad, []);
    await foreign.setContent(`<iframe src="${origin}/"></iframe>`);
    await foreign.waitForTimeout(500);
    const frame = foreign.frames().find((one) => one !== foreign.mainFrame());
    assert.equal(await frame?.locator("#page").count(), 0, "it is framed");
    evil.close();
    await foreign.context().close();
  });
  await claim("another name for this machine gets nothing (DNS rebinding)", async () => {
    const foreign = await (await browser.newContext()).newPage();
    const response = await foreign.goto(`http://evil.test:${new URL(origin).port}/`);
    assert.equal(response.status(), 421);
    await foreign.context().close();
  });

  await claim("the page holds no password and no session of the authenticator, and asked nobody else", async () => {
    const kept = await page.evaluate(() => JSON.stringify([{ ...sessionStorage }, { ...localStorage }, document.cookie]));
    assert.equal(kept.includes(kPassword), false);
    assert.deepEqual(asked.filter((one) => !one.startsWith(`${origin}/`)), []);
  });
  await claim("a killed system is told within two seconds, and the same page goes on with the next", async () => {
    stop();
    await page.getByText("Connection lost, connecting again…").waitFor({ timeout: 2500 });
    await accessible(page, "lost");
    await page.screenshot({ path: join(screenshots, "phone-lost.png") });
    await start();
    await page.getByText("Connected", { exact: true }).waitFor({ timeout: 30000 });
    await page.getByRole("button", { name: "Profile of anna" }).waitFor();
    assert.equal(new URL(link()).origin, origin, "another port");
  });
  await claim("a log-out makes a guest of the page, and of no one else", async () => {
    await page.getByRole("button", { name: "Profile of anna" }).click();
    await page.getByRole("button", { name: "Log out" }).click();
    await page.getByText("You are logged out.").waitFor();
    await page.getByRole("button", { name: "Close" }).click();
    await page.getByRole("button", { name: "Log in" }).waitFor();
  });
  await claim("the password is nowhere on the disk and in nothing that was said", async () => {
    assert.equal(said.includes(kPassword), false, "in the output");
    const search = (folder) => {
      for (const entry of readdirSync(folder, { withFileTypes: true })) {
        const path = join(folder, entry.name);
        if (entry.isDirectory()) search(path);
        else if (entry.isFile()) assert.equal(readFileSync(path).includes(kPassword), false, path);
      }
    };
    search(home);
  });
  await claim("the browser found nothing wrong", async () => {
    // A server that was killed, and a password that was refused, are told by the browser too.
    const expected = /Failed to load resource: (net::ERR_CONNECTION|net::ERR_INCOMPLETE|net::ERR_EMPTY|the server responded with a status of (403|503))/;
    assert.deepEqual(troubles.filter((one) => !expected.test(one)), []);
  });
} finally {
  await browser.close();
  stop();
  if (failures.length) console.log(said);
  rmSync(home, { recursive: true, force: true });
}
process.exit(failures.length ? 1 : 0);
