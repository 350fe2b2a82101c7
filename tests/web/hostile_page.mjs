// What a page of another origin can try at the server of the page: 25 ways, each by itself, in a real browser. Each tells
// what it saw: "blocked", "empty" (an answer of which nothing can be read), a status of refusal, or else what it got.

const kCalls = ["session", "events", "map", "me", "login", "logout", "profile", "points", "destination", "system", "rewire"];
const kBody = JSON.stringify({ x: 1, y: 1, level: 0, client: "web.location", provider: "phone.truth", points: [], token: "0", number: "0" });

/// In the foreign page: every call of the server, one after the other; the worst that was seen.
const fetches = (page, origin, options) =>
  page.evaluate(
    async ({ origin, calls, options }) => {
      let worst = "blocked";
      for (const call of calls) {
        try {
          const response = await fetch(`${origin}/api/${call}`, options);
          const text = response.type === "opaque" ? await response.text() : `${response.status} ${await response.text()}`;
          worst = response.type === "opaque" && text === "" ? "empty" : `${call}: ${text}`;
        } catch {
          // As it should be.
        }
      }
      return worst;
    },
    { origin, calls: kCalls, options },
  );

/// In the foreign page: an element that loads something of the server.
const embed = (page, tag, attributes) =>
  page.evaluate(
    ({ tag, attributes }) =>
      new Promise((done) => {
        const element = Object.assign(document.createElement(tag), attributes);
        element.onload = () => done(element.contentDocument?.body?.innerText === "" || tag === "object" ? "empty" : "loaded");
        element.onerror = () => done("blocked");
        document.body.append(element);
        setTimeout(() => done("blocked"), 2000);
      }),
    { tag, attributes },
  );

/// A form that goes into a frame of the foreign page: what of the server's page is in that frame.
async function form(page, origin, enctype, name, value) {
  await page.evaluate(
    ({ origin, enctype, name, value }) => {
      const frame = Object.assign(document.createElement("iframe"), { name: `f${enctype}` });
      const form = Object.assign(document.createElement("form"), { action: `${origin}/api/destination`, method: "POST", enctype, target: frame.name });
      form.append(Object.assign(document.createElement("input"), { name, value }));
      document.body.append(frame, form);
      form.submit();
    },
    { origin, enctype, name, value },
  );
  await page.waitForTimeout(400);
  return framed(page, origin);
}

async function framed(page, origin) {
  for (const frame of page.frames()) {
    if (frame === page.mainFrame() || !frame.url().startsWith(origin)) continue;
    if ((await frame.locator("#page").count()) > 0) return "framed";
    const text = await frame.locator("body").innerText().catch(() => "");
    if (text && !text.includes("error")) return text;
  }
  return "blocked";
}

const navigate = async (context, url) => {
  const page = await context.newPage();
  try {
    const response = await page.goto(url, { timeout: 5000 });
    return response.status() >= 400 ? `status ${response.status()}` : `got ${response.status()}`;
  } catch {
    return "blocked";
  } finally {
    await page.close();
  }
};

/// Tries all of them from a page at `home` against the server at `origin`; `stolen` is a session that is good there.
export async function hostile(context, home, origin, stolen) {
  const page = await context.newPage();
  await page.goto(home);
  const port = new URL(origin).port;
  const post = (type, mode, more = {}) => fetches(page, origin, { method: "POST", mode, headers: { "content-type": type, ...more }, body: kBody });
  const connect = (script) => page.evaluate(script, origin);
  const ways = [
    ["fetch, cors, text/plain", () => post("text/plain", "cors")],
    ["fetch, cors, form", () => post("application/x-www-form-urlencoded", "cors")],
    ["fetch, cors, JSON", () => post("application/json", "cors")],
    ["fetch, no-cors, text/plain", () => post("text/plain", "no-cors")],
    ["fetch, no-cors, form", () => post("application/x-www-form-urlencoded", "no-cors")],
    ["fetch, no-cors, JSON", () => post("application/json", "no-cors")],
    ["fetch with a stolen session", () => post("application/json", "cors", { authorization: `Bearer ${stolen}` })],
    ["fetch with credentials", () => fetches(page, origin, { method: "POST", mode: "cors", credentials: "include", headers: { "content-type": "text/plain" }, body: kBody })],
    ["fetch of the page itself", () => connect((origin) => fetch(origin).then((r) => r.text(), () => "blocked"))],
    ["preflight of an unusual method", () => fetches(page, origin, { method: "PUT", mode: "cors", body: kBody })],
    ["beacon", () => connect((origin) => (navigator.sendBeacon(`${origin}/api/destination`, "{}"), "empty"))],
    ["script include", () => embed(page, "script", { src: `${origin}/page.js` })],
    ["style include", () => embed(page, "link", { rel: "stylesheet", href: `${origin}/page.css` })],
    ["image include", () => embed(page, "img", { src: `${origin}/icon.svg` })],
    ["object", () => embed(page, "object", { data: `${origin}/icon.svg`, type: "image/svg+xml" })],
    ["form, urlencoded", () => form(page, origin, "application/x-www-form-urlencoded", "x", "1")],
    ["form, multipart", () => form(page, origin, "multipart/form-data", "x", "1")],
    ["form, text/plain that is JSON", () => form(page, origin, "text/plain", '{"x":1,"y":1,"level":0,"a":"', '"}')],
    ["frame", async () => {
      await page.evaluate((origin) => document.body.append(Object.assign(document.createElement("iframe"), { src: `${origin}/` })), origin);
      await page.waitForTimeout(500);
      return framed(page, origin);
    }],
    ["null origin, of a sandboxed frame", async () => {
      const told = page.evaluate(() => new Promise((done) => addEventListener("message", (event) => done(event.data), { once: true })));
      await page.evaluate(
        ({ origin, stolen }) => {
          const script = `fetch("${origin}/api/me",{method:"POST",headers:{"content-type":"application/json",authorization:"Bearer ${stolen}"},body:"{}"})` +
            `.then((r)=>r.text(),()=>"blocked").then((t)=>parent.postMessage(t,"*"))`;
          const frame = Object.assign(document.createElement("iframe"), { srcdoc: `<script>${script}</${"script"}>` });
          frame.sandbox = "allow-scripts";
          document.body.append(frame);
        },
        { origin, stolen },
      );
      return told;
    }],
    ["WebSocket", () => connect((origin) => new Promise((done) => {
      const socket = new WebSocket(origin.replace("http", "ws") + "/api/events");
      socket.onopen = () => done("open");
      socket.onerror = () => done("blocked");
    }))],
    ["EventSource", () => connect((origin) => new Promise((done) => {
      const source = new EventSource(`${origin}/api/events`);
      source.onopen = () => done("open");
      source.onerror = () => (source.close(), done("blocked"));
    }))],
    ["another name that leads here (DNS rebinding)", () => navigate(context, `http://evil.test:${port}/`)],
    ["0.0.0.0", () => navigate(context, `http://0.0.0.0:${port}/`)],
    ["IPv6", () => navigate(context, `http://[::1]:${port}/`)],
  ];
  const results = [];
  for (const [way, attempt] of ways) results.push({ way, seen: String(await attempt()).slice(0, 200) });
  await page.close();
  return results;
}
