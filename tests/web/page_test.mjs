// The mobile navigator in a real browser: its page is opened by the link, logged in to, and a person is led to a room, while
// the localisation is swapped; what it says when the system dies; what another page can do to it; and that axe-core finds
// nothing, in any state. Screenshots of phone and desk are left in the last folder.
// usage: node page_test.mjs BIN MARKETPLACE NODE_MODULES SCREENSHOTS
import assert from "node:assert/strict";
import { mkdirSync, readFileSync, readdirSync } from "node:fs";
import { createServer } from "node:http";
import { join, resolve } from "node:path";
import { hostile } from "./hostile_page.mjs";
import { Claims, Navigator, accessible as accessibleBy, api, browserProgram, browserTools, closeDialog, listenTo, saidBy, skip, until } from "./navigator.mjs";

const [bin, marketplace, modules, screenshots] = process.argv.slice(2).map((path) => resolve(path));
if (!browserProgram) skip("there is no chromium on this machine (apt-get install chromium)");
const { chromium, axe } = browserTools(modules);
mkdirSync(screenshots, { recursive: true });

const kPassword = "canary-horse-battery";
const kHeld_ms = Number(process.env.FIONA_HELD_MS ?? 3500); // by each localisation, while they are swapped
const kFull = kHeld_ms >= 60000; // who asks for that has the machine for it
const allowed = (bound_ms) => bound_ms * (kFull ? 1 : 3);
const kPolicy =
  "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; base-uri 'none'; form-action 'none'; " +
  "frame-ancestors 'none'; require-trusted-types-for 'script'; trusted-types 'none'";
const system = new Navigator(bin, marketplace);
const fiona = (...words) => system.fiona(...words);
const claims = new Claims();
const claim = (what, test) => claims.claim(what, test);
const accessible = (page, state) => accessibleBy(axe, page, state);
/// In the page's pixels, so that the files stay small.
const picture = (page, name, fullPage = false) => page.screenshot({ path: join(screenshots, `${name}.png`), scale: "css", fullPage });
const fits = async (page) => assert.equal(await page.evaluate(() => document.documentElement.scrollWidth > innerWidth), false, "it scrolls sideways");

/// A stream beside the page's own: when positions come; and how old each is when the page first draws it.
const listen = (page) =>
  page.evaluate(() => {
    window.heard = { times: [], ages: [], stop: new AbortController() };
    const { times, ages, stop } = window.heard;
    let newest = 0;
    const drawn = new MutationObserver(() => {
      const measured = Number(document.querySelector(".walker")?.dataset.measured ?? 0);
      if (measured <= newest) return;
      newest = measured;
      requestAnimationFrame(() => ages.push(performance.timeOrigin + performance.now() - measured));
    });
    drawn.observe(document.querySelector(".plan-view"), { subtree: true, childList: true, attributeFilter: ["data-measured"] });
    stop.signal.addEventListener("abort", () => drawn.disconnect());
    const headers = { "content-type": "application/json", authorization: `Bearer ${sessionStorage.getItem("fiona-session")}` };
    void fetch("/api/events", { method: "POST", headers, body: "{}", signal: stop.signal }).then(async (response) => {
      const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
      for (;;) {
        const { done, value } = await reader.read();
        if (done) return;
        if (value.includes("event: location")) times.push(performance.now());
      }
    }).catch(() => undefined);
  });
const heardBy = (page) =>
  page.evaluate(() => {
    const { times, ages, stop } = window.heard;
    stop.abort();
    const sorted = (all) => all.map(Math.round).sort((a, b) => a - b);
    return { gaps: sorted(times.slice(1).map((time, i) => time - times[i])), ages: sorted(ages) };
  });
const quantile = (sorted, share) => sorted[Math.ceil(sorted.length * share) - 1];
const inWords = (sorted) => `p50 ${quantile(sorted, 0.5)}, p99 ${quantile(sorted, 0.99)}, longest ${sorted.at(-1)} ms`;

system.users(["add", "anna", "--level", "3"], `${kPassword}\n`);

const browser = await chromium.launch({ executablePath: browserProgram, args: ["--no-sandbox", "--host-resolver-rules=MAP evil.test 127.0.0.1"] });
try {
  await system.start();
  // What is claimed here is the page's: how well beacons lead people is measured elsewhere, by hundreds of walks.
  fiona("wire", "nav.location", "to", "phone.truth");
  const url = system.link();
  const origin = new URL(url).origin;
  const context = await browser.newContext({ viewport: { width: 390, height: 844 }, deviceScaleFactor: 2, hasTouch: true });
  const page = await context.newPage();
  claims.shown = page;
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
    await page.getByRole("heading", { name: "Michelsberg Institute" }).waitFor();
    assert.equal(page.url(), `${origin}/`);
  });
  await claim("the policy of every answer lets nothing in but the page's own files", async () => {
    for (const path of ["/", "/page.js", "/page.css", "/icon.svg", "/none", "/api/me"]) {
      assert.equal((await fetch(origin + path)).headers.get("content-security-policy"), kPolicy, path);
    }
  });
  await claim("a script that came into the page is not run", async () => {
    const other = await (await browser.newContext()).newPage();
    const script = '<script>document.title = "harmed"</script><img src="/icon.svg" onload="document.title = \'harmed\'">';
    await other.addInitScript(() => {
      window.refused = [];
      document.addEventListener("securitypolicyviolation", (event) => window.refused.push(`${event.effectiveDirective} ${event.blockedURI}`));
    });
    await other.route(`${origin}/`, async (route) => {
      const answer = await route.fetch();
      await route.fulfill({ response: answer, body: (await answer.text()).replace("</body>", `${script}</body>`) });
    });
    await other.goto(origin);
    await other.getByText("This page is opened with a link.").waitFor();
    await until("both are refused", async () => (await other.evaluate(() => window.refused.length)) === 2);
    assert.deepEqual(await other.evaluate(() => window.refused.sort()), ["script-src-attr inline", "script-src-elem inline"]);
    assert.equal(await other.title(), "FIONA");
    await other.close();
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
    await picture(page, "phone-open");
  });

  await claim("a wrong password is refused in words", async () => {
    await page.getByRole("button", { name: "Log in" }).click();
    await page.getByLabel("Name").fill("anna");
    await page.getByLabel("Password").fill("wrong horse");
    await page.locator(".login button.main").click();
    await page.getByText("Name and password do not fit.").waitFor();
    await accessible(page, "log-in refused");
    await picture(page, "phone-login");
  });
  await claim("who tries too often is told how long to wait", async () => {
    fiona("set", "auth", "attempts=1", "attempt_period=60s");
    const tooMany = page.getByText(/^Too many attempts: wait \d+ s before the next one\.$/);
    await until("it is told", async () => {
      await page.getByLabel("Password").fill("wrong horse");
      await page.keyboard.press("Enter");
      await page.getByText(/Name and password do not fit\.|Too many attempts/).waitFor();
      return (await tooMany.count()) > 0;
    });
    await accessible(page, "log-in too often");
    fiona("set", "auth", "attempts=10", "attempt_period=0.1s");
    await new Promise((passed) => setTimeout(passed, 200));  // until there is one more
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
    await picture(page, "phone-profile");
    await closeDialog(page);
  });
  await claim("no process shows the password in its words or its environment", () => {
    const searched = readdirSync("/proc").filter((name) => /^\d+$/.test(name)).flatMap((pid) =>
      ["cmdline", "environ"].map((file) => {
        try {
          return [`${file} of ${pid}`, readFileSync(`/proc/${pid}/${file}`, "utf8")];
        } catch {
          return [pid, ""];  // it has ended, or is another user's
        }
      }));
    assert.ok(searched.some(([, text]) => text.includes("fiona-host")) && searched.some(([, text]) => text.includes(system.home)), "the system was not searched");
    assert.deepEqual(searched.filter(([, text]) => text.includes(kPassword)).map(([where]) => where), []);
  });
  await claim("a point of attention is told where the walker is", async () => {
    await page.getByText("You are passing the big plant.").waitFor();
  });

  await claim("a room is found by a part of its name, with the keyboard alone", async () => {
    await page.getByLabel("Where to?").focus();
    await page.keyboard.type("1.09");
    await page.locator(".rooms li").first().waitFor();
    await accessible(page, "search");
    await picture(page, "phone-search");
    await page.keyboard.press("Enter");
    await page.locator(".steps li").first().waitFor();
    assert.match(await page.locator(".to").innerText(), /^To .*1\.09/);
  });
  await claim("position and steps move along the way", async () => {
    const place = () => page.locator(".walker > g").getAttribute("transform");
    const before = await place();
    const step = await page.locator('.steps [aria-current="step"]').innerText();
    await until("the walker moves", async () => (await place()) !== before);
    await accessible(page, "on the way");
    await picture(page, "phone-way");
    await until("the step changes", async () => (await page.locator('.steps [aria-current="step"]').innerText()) !== step, 60000);
  });
  await claim("nothing scrolls sideways at 320 pixels", async () => {
    await page.setViewportSize({ width: 320, height: 640 });
    await fits(page);
    await picture(page, "narrow-way", true);
    await accessible(page, "narrow");
    await page.setViewportSize({ width: 390, height: 844 });
  });
  await claim("on a desk plan and steps are side by side", async () => {
    await page.setViewportSize({ width: 1280, height: 800 });
    await fits(page);
    await accessible(page, "desk");
    await picture(page, "desk-way");
    await page.emulateMedia({ colorScheme: "dark" });
    await accessible(page, "dark");
    await picture(page, "desk-dark");
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
  await claim("the localisation is swapped while the person walks, and the page goes on", async () => {
    await listen(page);
    for (const provider of ["wifi.location", "bluetooth.location", "phone.truth"]) {
      fiona("wire", "nav.location", "to", provider);
      await page.waitForTimeout(kHeld_ms);
    }
    const { gaps, ages } = await heardBy(page);
    console.log(`        ${gaps.length} positions through 3 swaps: gap ${inWords(gaps)}; from sensor to page ${inWords(ages)}`);
    assert.ok(gaps.length > 30 && ages.length > 30, "too few positions");
    // The bounds are 300 and 600 ms, and 150 ms, on a machine of its own; this one may be shared.
    assert.ok(quantile(gaps, 0.99) <= allowed(300) && gaps.at(-1) <= allowed(600), `gap ${inWords(gaps)}`);
    assert.ok(quantile(ages, kFull ? 0.99 : 0.9) <= allowed(150), `from sensor to page ${inWords(ages)}`);
  });
  await claim("an instruction that is made from a guess is told as uncertain", async () => {
    fiona("wire", "nav.location", "to", "bluetooth.location");
    fiona("set", "nav", "uncertain_radius=1m");
    await page.getByText("Position uncertain", { exact: true }).waitFor({ timeout: 10000 });
    await page.getByText(/^within \d+ m$/).waitFor();
    await accessible(page, "guess");
    await picture(page, "phone-uncertain");
    fiona("wire", "nav.location", "to", "phone.truth");
    fiona("set", "nav", "uncertain_radius=8m");
    await page.getByText("Position uncertain", { exact: true }).waitFor({ state: "detached", timeout: 10000 });
  });
  await claim("what is running is shown to a user of level 1 and more, live", async () => {
    await page.getByRole("tab", { name: "What is running" }).click();
    await page.locator(".cards li", { hasText: "smart-fiona-navigation" }).waitFor();
    await until("the rate of the location is shown", async () =>
      /LocationProvider: .* Hz/.test(await page.locator(".cards li", { hasText: "nav.location from phone.truth" }).innerText()));
    assert.equal(await page.locator(".swap").count(), 0, "level 3 may not switch");
    await accessible(page, "running");
  });
  await claim("a provider is swapped on the page among those that fit, by a user of level 6", async () => {
    system.users(["level", "anna", "6"]);
    const wire = page.locator(".cards li", { hasText: "nav.location from" });
    const others = wire.getByLabel("Another provider for nav.location");
    await others.waitFor();
    assert.deepEqual((await others.locator("option").allInnerTexts()).slice(1), ["bluetooth.location", "wifi.location"]);
    await others.selectOption("wifi.location");
    await wire.getByRole("button", { name: "Switch nav.location" }).click();
    await page.getByText(/nav\.location to wifi\.location: gap \d+ ms, lost 0/).waitFor();
    await page.locator(".cards li", { hasText: "nav.location from wifi.location" }).waitFor();
    assert.match(fiona("show", "nav.location"), /wifi\.location/);
    await accessible(page, "switched");
    await picture(page, "phone-running");
    await page.setViewportSize({ width: 320, height: 640 });
    await fits(page);
    await page.setViewportSize({ width: 1280, height: 800 });
    await fits(page);
    await accessible(page, "running, desk");
    await picture(page, "desk-running");
    await page.setViewportSize({ width: 390, height: 844 });
    fiona("undo");
    await page.locator(".cards li", { hasText: "nav.location from phone.truth" }).waitFor();
  });
  await claim("who has lost the level switches nothing any more, and is told", async () => {
    system.users(["level", "anna", "3"]);
    await page.locator(".swap").first().waitFor({ state: "detached", timeout: 5000 });
    assert.deepEqual(await api(page, "rewire", { client: "nav.location", provider: "wifi.location" }), {
      status: 403,
      error: "this takes the access level 6, and you have 3",
    });
    assert.match(fiona("show", "nav.location"), /phone\.truth/);
    await page.getByRole("tab", { name: "What is running" }).focus();
    await page.keyboard.press("ArrowLeft");
    await page.locator("#view-guide").waitFor();
  });
  await claim("the floor follows the walker to the destination's level", async () => {
    await until("level 1 is shown", async () => (await page.locator('.levels [aria-pressed="true"]').innerText()).startsWith("1"), 180000);
    await page.getByText(/^You have arrived|^You are at/).waitFor({ timeout: 120000 });
    await picture(page, "phone-arrived");
  });
  await claim("localisation that ends is told as uncertain", async () => {
    fiona("unwire", "web.location");
    await page.getByText("No localisation in this system").waitFor({ timeout: 5000 });
    await accessible(page, "uncertain");
    fiona("wire", "web.location", "to", "nav.shown");
    await page.getByText("No localisation in this system").waitFor({ state: "detached", timeout: 5000 });
  });

  await claim("a wire that passes each fifth place leaves the page sure of it", async () => {
    const doubt = page.locator(".uncertain");
    const sure = async () => (await doubt.allInnerTexts()).join("") === "";
    fiona("wire", "web.location", "to", "phone.truth", "every", "5");
    await until("the place is sure", sure);
    await listenTo(page, ".uncertain");
    await page.waitForTimeout(3000);
    assert.deepEqual(await saidBy(page, ".uncertain"), []);
    fiona("wire", "web.location", "to", "nav.shown");
    await until("the place is sure", sure);
  });
  await claim("a provider of the place that dies, or hangs, is told within half a second of when that is known", async () => {
    const kBuilding = "plugins/building-simulator/institute.osm";
    fiona("load", "guided-walk-simulator", "as", "spare", "in", "spare", `building=${kBuilding}`, "start_room=0.12");
    fiona("wire", "web.location", "to", "spare.truth");
    const doubt = page.locator(".uncertain");
    const sure = () => until("the place is sure", async () => (await doubt.allInnerTexts()).join("") === "");
    await page.evaluate(() => {
      const told = () => document.querySelector(".uncertain[role=alert]")?.textContent && (window.doubtful_ms ??= Date.now());
      new MutationObserver(told).observe(document.body, { childList: true, characterData: true, subtree: true });
    });
    // Of death it is known after 0.3 s, of a hang after 1 s; for a machine that is shared, three times as much. One that is
    // back before the page has drawn its death is killed again, until it is left.
    for (const [signal, known_ms] of [["SIGSTOP", 1000], ["SIGSTOP", 1000], ["SIGKILL", 300]]) {
      await until("the group is there", () => fiona("show", "spare").includes("active"));
      await sure();
      await page.evaluate(() => void (window.doubtful_ms = undefined));
      let begun_ms = 0;
      await until("the page is in doubt", async () => {
        if (await page.evaluate(() => window.doubtful_ms !== undefined)) return true;
        if (begun_ms && (signal === "SIGSTOP" || Date.now() - begun_ms < 3000)) return false;
        process.kill(system.processOf("spare"), signal);
        begun_ms = Date.now();
        return false;
      });
      const took_ms = (await page.evaluate(() => window.doubtful_ms)) - begun_ms;
      console.log(`        ${signal}: in doubt after ${took_ms} ms (bound ${known_ms + 500})`);
      assert.ok(took_ms <= 3 * (known_ms + 500), `${took_ms} ms after ${signal}`);
    }
    fiona("wire", "web.location", "to", "nav.shown");
    fiona("unload", "spare");
    await sure();
  });

  await claim("25 ways of a hostile page change nothing, read nothing, open no socket and no frame", async () => {
    const state = async () => [fiona("journal"), fiona("show", "nav.destination").match(/messages +\d+/)?.[0], JSON.stringify(await api(page, "me", {}))];
    const before = await state();
    const evil = createServer((_, response) => response.writeHead(200, { "content-type": "text/html" }).end("<!doctype html><p>evil"));
    await new Promise((done) => evil.listen(0, "127.0.0.1", done));
    const context = await browser.newContext();
    const stolen = await page.evaluate(() => sessionStorage.getItem("fiona-session"));
    const results = await hostile(context, `http://127.0.0.1:${evil.address().port}/`, origin, stolen);
    for (const { way, seen } of results) console.log(`        ${way}: ${seen}`);
    assert.equal(results.length, 25);
    assert.deepEqual(results.filter(({ seen }) => !/^(blocked|empty|status 4\d\d)$/.test(seen)), []);
    assert.deepEqual(await state(), before);
    evil.close();
    await context.close();
  });

  await claim("the page holds no password and no session of the authenticator, and asked nobody else", async () => {
    const kept = await page.evaluate(() => JSON.stringify([{ ...sessionStorage }, { ...localStorage }, document.cookie]));
    assert.equal(kept.includes(kPassword), false);
    assert.deepEqual(asked.filter((one) => !one.startsWith(`${origin}/`)), []);
  });
  await claim("a killed system is told within two seconds, and the same page goes on with the next", async () => {
    await system.stop();
    await page.getByText("Connection lost, connecting again…").waitFor({ timeout: 2500 });
    await accessible(page, "lost");
    await picture(page, "phone-lost");
    await system.start();
    await page.getByText("Connected", { exact: true }).waitFor({ timeout: 30000 });
    await page.getByRole("button", { name: "Profile of anna" }).waitFor();
    await page.locator(".now").waitFor({ state: "detached", timeout: 5000 }); // what the guide had said has gone with it
    assert.equal(new URL(system.link()).origin, origin, "another port");
    await page.waitForTimeout(4500);
    assert.equal(await page.locator(".lead").getByText("Guidance was started again").count(), 0, "who has arrived is not led there again");
  });
  await claim("who is led when guidance is swapped, or the whole system killed, is led on, and told so", async () => {
    fiona("wire", "nav.location", "to", "phone.truth");
    await page.getByLabel("Where to?").fill("1.09");
    await page.keyboard.press("Enter");
    const led = () => page.locator(".steps li", { hasText: "Arrive at Office 1.09" }).waitFor({ timeout: 30000 });
    await led();
    // Another guide is swapped in, and knows of no trip.
    for (const line of [
      "load smart-fiona-navigation as spare", "wire spare.location to phone.truth", "wire spare.levels to map.levels", "wire spare.planner to planner.plan",
      "wire spare.profile to profiles.profile", "wire web.path to spare.path", "wire web.destination to spare.destination", "wire web.instructions to spare.instructions",
    ]) fiona(line);
    await page.getByText("Guidance was started again.", { exact: true }).waitFor({ timeout: 10000 });
    await led();
    await picture(page, "phone-led-again");
    await system.stop();
    await page.getByText("Connection lost, connecting again…").waitFor({ timeout: 2500 });
    await system.start();
    fiona("wire", "nav.location", "to", "phone.truth");
    // Once for each pick.
    await page.getByText("Guidance was started again: you are not led any more.").waitFor({ timeout: 30000 });
    await accessible(page, "not led any more");
    await page.getByRole("button", { name: "Lead me on to Office 1.09" }).click();
    await led();
  });
  await claim("a log-out makes a guest of the page, and of no one else", async () => {
    await page.getByRole("button", { name: "Profile of anna" }).click();
    await page.getByRole("button", { name: "Log out" }).click();
    await page.getByText("You are logged out.").waitFor();
    await closeDialog(page);
    await page.getByRole("button", { name: "Log in" }).waitFor();
  });
  await claim("the password is nowhere on the disk and in nothing that was said", async () => {
    assert.equal(system.said.includes(kPassword), false, "in the output");
    const search = (folder) => {
      for (const entry of readdirSync(folder, { withFileTypes: true })) {
        const path = join(folder, entry.name);
        if (entry.isDirectory()) search(path);
        else if (entry.isFile()) assert.equal(readFileSync(path).includes(kPassword), false, path);
      }
    };
    search(system.home);
  });
  await claim("the browser found nothing wrong", async () => {
    // A server that was killed, and a password that was refused, are told by the browser too.
    const expected = /Failed to load resource: (net::ERR_CONNECTION|net::ERR_INCOMPLETE|net::ERR_EMPTY|the server responded with a status of (403|409|503))/;
    assert.deepEqual(troubles.filter((one) => !expected.test(one)), []);
  });
} finally {
  await browser.close();
  if (claims.failures.length) console.log(system.said);
  await system.close();
}
process.exit(claims.failures.length ? 1 : 0);
