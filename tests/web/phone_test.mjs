// A phone and the machine that leads its bearer, each in a network of its own with a cable between: what is open to the phone,
// how it is paired, and the way to a room on its page, also with the cable pulled. Screenshots are left in the last folder.
// usage: node phone_test.mjs BIN MARKETPLACE NODE_MODULES SCREENSHOTS
import assert from "node:assert/strict";
import { execFileSync, spawn, spawnSync } from "node:child_process";
import { mkdirSync, readdirSync, statSync, writeFileSync } from "node:fs";
import { dirname, join, resolve } from "node:path";
import { fileURLToPath } from "node:url";
import { Claims, Navigator, browserProgram, browserTools, skip, until } from "./navigator.mjs";

const [bin, marketplace, modules, screenshots] = process.argv.slice(2).map((path) => resolve(path));
if (!browserProgram) skip("there is no chromium on this machine (apt-get install chromium)");
for (const [program, asked, name] of [["certutil", "-H", "libnss3-tools"], ["ip", "-V", "iproute2"], ["curl", "-V", "curl"], ["openssl", "version", "openssl"]]) {
  if (spawnSync(program, [asked]).error) skip(`there is no ${program} on this machine (apt-get install ${name})`);
}
mkdirSync(screenshots, { recursive: true });

const machine = `fionam${process.pid}`;
const phone = `fionap${process.pid}`;
const kMachine = "10.231.7.1";
const kPhone = "10.231.7.2";
const here = dirname(fileURLToPath(import.meta.url));
const ip = (line) => execFileSync("ip", line.split(" "), { stdio: "pipe", encoding: "utf8" });
const inside = (network, ...words) => spawnSync("ip", ["netns", "exec", network, ...words], { encoding: "utf8", timeout: 120000 });
const cut = () => [machine, phone].forEach((name) => spawnSync("ip", ["netns", "del", name]));
try {
  for (const name of [machine, phone]) {
    ip(`netns add ${name}`);
    ip(`-n ${name} link set lo up`);
  }
  ip(`-n ${machine} link add cable type veth peer name cable netns ${phone}`);
  for (const [name, address] of [[machine, kMachine], [phone, kPhone]]) {
    ip(`-n ${name} addr add ${address}/30 dev cable`);
    ip(`-n ${name} link set cable up`);
  }
} catch (error) {
  cut();
  skip(`network namespaces with a pair of virtual network devices (veth), which need root, cannot be made: ${String(error.stderr || error.message).trim()}`);
}

const { chromium } = browserTools(modules);
const system = new Navigator(bin, marketplace, ["ip", "netns", "exec", machine]);
const claims = new Claims();
const claim = (what, test) => claims.claim(what, test);
const openPorts = () => JSON.parse(inside(phone, process.execPath, join(here, "scan_ports.mjs"), kMachine).stdout);
/// Addresses at which the machine listens to tcp (state 0A), or takes what comes over udp (07): in hexadecimal digits, each
/// word as the processor has it.
const listeners = () =>
  [["tcp", "0A"], ["tcp6", "0A"], ["udp", "07"], ["udp6", "07"]].flatMap(([file, state]) =>
    inside(machine, "cat", `/proc/net/${file}`).stdout.split("\n").slice(1).map((line) => line.trim().split(/\s+/))
      .filter((fields) => fields[3] === state).map((fields) => fields[1].split(":")[0]));
const isLoopback = (hex) => hex === "0100007F" || hex === "00000000000000000000000001000000";
const sockets = (folder) =>
  readdirSync(folder, { withFileTypes: true }).flatMap((entry) => {
    const path = join(folder, entry.name);
    return entry.isDirectory() ? sockets(path) : entry.isSocket() ? [path] : [];
  });

/// Chromium of the phone: in its network, and with its store of certificates.
const home = join(system.home, "phone");
const certificates = `sql:${home}/.pki/nssdb`;
const program = join(system.home, "phone-chromium");
mkdirSync(join(home, ".pki/nssdb"), { recursive: true });
writeFileSync(program, `#!/bin/sh\nexec ip netns exec ${phone} ${browserProgram} "$@"\n`, { mode: 0o700 });
execFileSync("certutil", ["-N", "-d", certificates, "--empty-password"]);
let browser = null;
const startBrowser = async () =>
  (browser = await chromium.launch({ executablePath: program, args: ["--no-sandbox"], env: { ...process.env, HOME: home } }));
const picture = (page, name) => page.screenshot({ path: join(screenshots, `${name}.png`), scale: "css" });

/// Opens so many connections from the phone, says nothing on them, and holds those that it may.
async function crowd(port, count) {
  const script =
    `let open=0,closed=0;for(let i=0;i<${count};i++){const one=require("net").connect(${port},"${kMachine}");` +
    `one.on("connect",()=>open++).on("close",()=>closed++).on("error",()=>0)}setTimeout(()=>console.log(JSON.stringify({open,closed})),2000)`;
  const holding = spawn("ip", ["netns", "exec", phone, process.execPath, "-e", script]);
  let said = "";
  holding.stdout.on("data", (bytes) => (said += bytes));
  await until("they are opened", () => said.includes("\n"));
  return { ...JSON.parse(said), end: () => holding.kill() };
}

try {
  await claim("after a fresh start nothing listens but to its own machine, and a phone finds no open port of 65535", async () => {
    await system.start();
    system.link();
    assert.ok(listeners().length > 0, "not even the page is served");
    assert.deepEqual(listeners().filter((one) => !isLoopback(one)), []);
    assert.deepEqual(openPorts(), []);
    const all = sockets(join(system.env.XDG_RUNTIME_DIR, "fiona"));
    assert.ok(all.length > 0, "no socket was found");
    assert.equal(statSync(join(system.env.XDG_RUNTIME_DIR, "fiona")).mode & 0o777, 0o700, "others reach what is in it");
  });
  await claim("an address that stands for all of them is refused", () => {
    assert.throws(() => system.fiona("load", "smart-web-interface", "as", "wide", "in", "wide", "address=0.0.0.0"), /the page is not served at such an address/);
  });
  await system.stop();

  await system.start(`web.address=${kMachine}`);
  const told = system.fiona("call", "web.link");
  const value = (name) => new RegExp(`${name}="([^"]+)"`).exec(told)[1];
  const [url, authority, fingerprint] = ["url", "authority", "fingerprint"].map(value);
  const { origin, port, protocol } = new URL(url);
  const certificate = join(system.home, "authority.crt");
  const curl = (network, ...words) => inside(network, "curl", "--silent", "--max-time", "10", ...words);

  await claim("beyond its machine the page is the one open port, and is served over TLS alone", () => {
    assert.equal(protocol, "https:");
    assert.deepEqual(openPorts(), [Number(port)]);
    assert.equal(curl(phone, origin.replace("https", "http")).stdout, "");
  });
  await claim("a phone that was not paired does not take the server for good", async () => {
    const kUntrusted = 60;
    assert.equal(curl(phone, origin).status, kUntrusted);
    await startBrowser();
    const page = await browser.newPage();
    await assert.rejects(page.goto(url), /ERR_CERT_AUTHORITY_INVALID/);
    await browser.close();
  });
  await claim("pairing: the authority's fingerprint is the one that the console shows", () => {
    assert.equal(curl(phone, "--insecure", "--output", certificate, authority).status, 0);
    assert.match(execFileSync("openssl", ["x509", "-in", certificate, "-noout", "-fingerprint", "-sha256"], { encoding: "utf8" }), new RegExp(`=${fingerprint}\\s`));
    execFileSync("certutil", ["-A", "-d", certificates, "-n", "fiona", "-t", "C,,", "-i", certificate]);
    assert.equal(curl(phone, "--cacert", certificate, "--output", "/dev/null", "--write-out", "%{http_code}", origin).stdout, "200");
  });

  await startBrowser();
  const context = await browser.newContext({ viewport: { width: 390, height: 844 }, deviceScaleFactor: 2, hasTouch: true });
  const page = await context.newPage();
  claims.shown = page;
  const connected = () => page.getByText("Connected", { exact: true }).waitFor();
  const lost = () => page.getByText("Connection lost, connecting again…").waitFor({ timeout: 5000 });
  await claim("a paired phone opens the page with the link", async () => {
    await page.goto(url);
    await connected();
    await page.getByRole("heading", { name: "Michelsberg Institute" }).waitFor();
    await page.locator(".walker .region").waitFor({ state: "attached" });
    assert.equal(page.url(), `${origin}/`);
    await picture(page, "tls-open");
  });
  await claim("a room is picked on it, and its bearer walks", async () => {
    // What localisation can do is asked elsewhere.
    system.fiona("wire", "nav.location", "to", "phone.truth");
    await page.getByLabel("Where to?").fill("0.01");
    await page.locator(".rooms li").first().waitFor();
    await page.keyboard.press("Enter");
    await page.locator(".steps li").first().waitFor();
    const place = () => page.locator(".walker > g").getAttribute("transform");
    const before = await place();
    await until("the walker moves", async () => (await place()) !== before);
    await picture(page, "tls-way");
  });
  await claim("a cable that is pulled is told, and the same page goes on when it is back", async () => {
    ip(`-n ${phone} link set cable down`);
    await lost();
    await picture(page, "tls-lost");
    ip(`-n ${phone} link set cable up`);
    await connected();
  });
  await claim("its bearer arrives", async () => {
    await page.getByText(/^You have arrived|^You are at/).waitFor({ timeout: 180000 });
    await picture(page, "tls-arrived");
  });
  await claim("one device that opens connections and says nothing keeps no other out", async () => {
    const held = await crowd(port, 40);
    try {
      assert.ok(held.open - held.closed <= 16, `${held.open} were opened, and ${held.closed} of them let go`);
      assert.ok(held.open - held.closed > 0, "none is held: this shows nothing");
      assert.equal(curl(machine, "--cacert", certificate, "--output", "/dev/null", "--write-out", "%{http_code}", origin).stdout, "200");
      await connected();
    } finally {
      held.end();
    }
  });
  await claim("a system that is killed comes back at the same address, with the same authority, for the same page", async () => {
    await system.stop();
    await lost();
    await system.start(`web.address=${kMachine}`);
    await connected();
    assert.equal(/fingerprint="([^"]+)"/.exec(system.fiona("call", "web.link"))[1], fingerprint);
  });
} finally {
  await browser?.close();
  if (claims.failures.length) console.log(system.said);
  await system.close();
  cut();
}
process.exit(claims.failures.length ? 1 : 0);
