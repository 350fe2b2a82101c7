// The mobile navigator as tests of its page start it: from the marketplace, with a state of its own, and a browser.
import assert from "node:assert/strict";
import { execFileSync, spawn } from "node:child_process";
import { existsSync, mkdirSync, mkdtempSync, readFileSync, rmSync } from "node:fs";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { dirname, join, resolve } from "node:path";
import { fileURLToPath } from "node:url";

const kPackages = [
  "guided-walk-simulator", "step-heading", "map-server", "smart-bluetooth-localization", "radio-localisation", "smart-symbolic-planner",
  "smart-fiona-navigation", "authenticator", "user-profiles", "smart-web-interface",
];
const sources = resolve(dirname(fileURLToPath(import.meta.url)), "../..");

export const browserProgram = ["/usr/bin/chromium", "/usr/bin/chromium-browser"].find(existsSync);
export function skip(why) {
  console.log(`skipped: ${why}`);
  process.exit(77);
}

export const until = async (what, test, limit_ms = 30000) => {
  for (const end = Date.now() + limit_ms; Date.now() < end; ) {
    if (await test()) return;
    await new Promise((done) => setTimeout(done, 100));
  }
  assert.fail(`not within ${limit_ms / 1000} s: ${what}`);
};

export class Navigator {
  /// `around`: a command in which the system is run, as words ("ip netns exec …").
  constructor(bin, marketplace, around = []) {
    this.bin = bin;
    this.around = around;
    this.home = mkdtempSync(join(tmpdir(), "fiona-web-"));
    this.said = "";
    this.host = null;
    this.env = {
      ...process.env,
      XDG_STATE_HOME: join(this.home, "state"),
      XDG_RUNTIME_DIR: join(this.home, "run"),
      FIONA_STORE: join(this.home, "store"),
      FIONA_MARKET: marketplace,
    };
    for (const folder of ["state", "run", "store"]) mkdirSync(join(this.home, folder), { mode: 0o700 });
    execFileSync(join(bin, "fiona"), ["market", "install", "-q", "-y", ...kPackages], { env: this.env });
  }

  fiona(...words) {
    return execFileSync(join(this.bin, "fiona"), words, { env: this.env, encoding: "utf8", timeout: 60000, stdio: "pipe" });
  }
  /// The process of a group.
  processOf(group) {
    return Number(execFileSync("pgrep", ["-f", `fiona-group --name ${group} .*${this.home}/`], { encoding: "utf8" }));
  }
  users(words, input) {
    return execFileSync(join(this.bin, "fiona-users"), words, { env: this.env, input });
  }
  link() {
    return /url="([^"]+)"/.exec(this.fiona("call", "web.link"))[1];
  }

  /// `settings`: as "web.port=8080".
  async start(...settings) {
    const files = ["one-process", "page"].map((name) => `systems/mobile-navigator/${name}.fiona`);
    const demo = resolve(this.bin, "../demo");
    const set = [`bluetooth.beacons=${demo}/institute.beacons`, `wifi.map=${demo}/institute.radiomap`, ...settings];
    const line = [...this.around, join(this.bin, "fiona"), "run", ...files, ...set.flatMap((one) => ["--set", one]), "--headless", "--timeout", "60s"];
    this.host = spawn(line[0], line.slice(1), { env: this.env, cwd: sources, detached: true });
    for (const stream of [this.host.stdout, this.host.stderr]) stream.on("data", (bytes) => (this.said += bytes));
    await until("the page is served", () => {
      assert.equal(this.host.exitCode, null, `the system has ended: ${this.said}`);
      try {
        return this.fiona("show", "web").includes("active");
      } catch {
        return false;
      }
    }, 60000);
  }
  /// Ends what it started, groups and all: they are one process group.
  async stop(signal = "SIGKILL") {
    const group = this.host?.pid;
    this.host = null;
    if (!group) return;
    const tell = (what) => {
      try {
        return process.kill(-group, what);
      } catch {
        return false;
      }
    };
    tell(signal);
    await until("the system has ended", () => !tell(0));
  }
  async close() {
    await this.stop();
    rmSync(this.home, { recursive: true, force: true });
  }
}

/// Claims one after the other; one that does not hold is told with what the page shows, and the next one is tried.
export class Claims {
  failures = [];
  shown = null;

  async claim(what, test) {
    try {
      await test();
      console.log(`ok      ${what}`);
    } catch (error) {
      this.failures.push(what);
      console.log(`FAILED  ${what}\n        ${String(error.message ?? error).split("\n").slice(0, 12).join("\n        ")}`);
      console.log(`        ${await this.#whatIsShown()}`);
    }
  }
  async #whatIsShown() {
    const text = await this.shown?.locator("body").innerText({ timeout: 2000 }).catch((error) => String(error));
    return `the page shows:\n${text ?? "nothing"}`.split("\n").slice(0, 60).join("\n        | ");
  }
}

/// A call as the page makes it, with the page's own session.
export const api = (page, name, body) =>
  page.evaluate(
    async ({ name, body }) => {
      const headers = { "content-type": "application/json", authorization: `Bearer ${sessionStorage.getItem("fiona-session")}` };
      const response = await fetch(`/api/${name}`, { method: "POST", headers, body: JSON.stringify(body) });
      return { status: response.status, ...(await response.json()) };
    },
    { name, body },
  );
/// The newest of a topic that pages are told.
export const newest = (page, topic) =>
  page.evaluate(async (topic) => {
    const stop = new AbortController();
    const headers = { "content-type": "application/json", authorization: `Bearer ${sessionStorage.getItem("fiona-session")}` };
    const response = await fetch("/api/events", { method: "POST", headers, body: "{}", signal: stop.signal });
    const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
    for (let text = ""; ; ) {
      const { done, value } = await reader.read();
      if (done) throw new Error(`the stream has ended without ${topic}`);
      text += value;
      const found = text.split("\n\n").slice(0, -1).find((one) => one.startsWith(`event: ${topic}\n`));
      if (!found) continue;
      stop.abort();
      return JSON.parse(found.split("data: ")[1]);
    }
  }, topic);

/// What is told stands twice while a dialog is open; the page hears of its end a little after the click.
export async function closeDialog(page) {
  await page.getByRole("button", { name: "Close" }).click();
  await page.locator("dialog").waitFor({ state: "detached" });
}

/// Keeps what parts of the page say, each text when it comes: `saidBy` gives those of one, by its selector.
export const listenTo = (page, ...selectors) =>
  page.evaluate((selectors) => {
    const said = (window.said = Object.fromEntries(selectors.map((one) => [one, []])));
    const look = () => {
      for (const one of selectors) {
        const text = [...document.querySelectorAll(one)].map((part) => part.textContent).join(" ").trim();
        if (text !== (said[one].at(-1) ?? "")) said[one].push(text);
      }
    };
    look();
    new MutationObserver(look).observe(document.body, { subtree: true, childList: true, characterData: true });
  }, selectors);
export const saidBy = async (page, selector) => (await page.evaluate((one) => window.said[one], selector)).filter(Boolean);

/// playwright-core and axe-core, which are installed with what the page is built with.
export function browserTools(modules) {
  const require = createRequire(join(modules, "x.js"));
  return { chromium: require("playwright-core").chromium, axe: readFileSync(require.resolve("axe-core/axe.min.js"), "utf8") };
}

/// That axe-core, whose text this is, finds nothing.
export async function accessible(axe, page, state) {
  // A context of its own: the page's policy lets no script in, and is right to.
  if (!(await page.evaluate(() => "axe" in window))) await page.evaluate(`${axe};undefined`);
  const found = await page.evaluate(async () => {
    const rules = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"];
    const { violations } = await window.axe.run(document, { runOnly: rules, resultTypes: ["violations"] });
    return violations.map((one) => `${one.id}: ${one.nodes.map((node) => node.html.slice(0, 120)).join(" | ")}`);
  });
  assert.deepEqual(found, [], state);
}

/// That nothing scrolls sideways, reaches beyond the window's sides, or is cut by the box that it is in. What is for screen
/// readers alone is cut by intent, and so is the plan, which is moved.
export async function uncut(page, state) {
  const found = await page.evaluate(() => {
    const told = (one, how) => `${how}: ${one.outerHTML.slice(0, 100)}`;
    const faults = document.documentElement.scrollWidth > innerWidth ? ["the page scrolls sideways"] : [];
    const seen = [...document.querySelectorAll("body *")].filter((one) => one.checkVisibility() && !one.closest(".hidden, .skip, .plan-view, svg"));
    for (const one of seen) {
      const box = one.getBoundingClientRect();
      const { overflowX, overflowY } = getComputedStyle(one);
      if (box.width > 0 && (box.left < -0.5 || box.right > innerWidth + 0.5)) faults.push(told(one, "beyond the window"));
      if (overflowX !== "visible" && one.scrollWidth > one.clientWidth + 1) faults.push(told(one, "cut, or scrolls sideways"));
      if (/hidden|clip/.test(overflowY) && one.scrollHeight > one.clientHeight + 1) faults.push(told(one, "cut below"));
    }
    return faults;
  });
  assert.deepEqual(found, [], state);
}
