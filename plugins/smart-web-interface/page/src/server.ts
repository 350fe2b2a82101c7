// The one way to the server: calls, and the stream of what is new.

const kSession = "fiona-session";
const kNumber = "fiona-number";
const kSilence_ms = 1600; // three beats of the server
const kCall_ms = 12000;

export class Refused extends Error {
  constructor(
    readonly status: number,
    text: string,
  ) {
    super(text);
  }
}

const session = (): string | null => sessionStorage.getItem(kSession);

/// Before it is tried again: many pages that lose one server come back one after the other.
export const pause_ms = (tries: number): number => Math.min(5000, 250 * 2 ** Math.min(tries, 5)) * (0.5 + Math.random());

async function post(name: string, body: unknown, signal: AbortSignal): Promise<Response> {
  const headers: Record<string, string> = { "Content-Type": "application/json" };
  const bearer = session();
  if (bearer) headers["Authorization"] = `Bearer ${bearer}`;
  return fetch(`/api/${name}`, { method: "POST", headers, body: JSON.stringify(body), signal, cache: "no-store" });
}

export async function call<T>(name: string, body: unknown = {}): Promise<T> {
  const give_up = new AbortController();
  const timer = setTimeout(() => give_up.abort(), kCall_ms);
  let response: Response;
  let answer: { error?: string };
  try {
    response = await post(name, body, give_up.signal);
    answer = await response.json();
  } catch {
    throw new Refused(0, "The system cannot be reached.");
  } finally {
    clearTimeout(timer);
  }
  if (!response.ok) throw new Refused(response.status, sentence(answer.error ?? "The system refused that."));
  return answer as T;
}

export const sentence = (text: string): string => {
  const whole = text.charAt(0).toUpperCase() + text.slice(1);
  return /[.!?]$/.test(whole) ? whole : `${whole}.`;
};

/// The page's own number: with it a link gives the same session again, for the first answer may have been lost. Kept while
/// the link is in the address, for who reloads.
function ownNumber(): string {
  const kept = sessionStorage.getItem(kNumber);
  if (kept) return kept;
  const number = Array.from(crypto.getRandomValues(new Uint8Array(16)), (byte) => byte.toString(16).padStart(2, "0")).join("");
  sessionStorage.setItem(kNumber, number);
  return number;
}

/// Exchanges the token behind '#' for a session, and takes it out of the address and the history once the server has said
/// whether it opens: who reloads a page that was not answered still has the link. `held`: why it is not open yet, and is
/// tried again. Why the page cannot be used, or nothing.
export async function open(held: (why: string) => void): Promise<string | null> {
  const token = location.hash.slice(1);
  let refusal = "This page is opened with a link.";
  for (let tries = 0; token; ++tries) {
    try {
      const opened = await call<{ session: string }>("session", { token, number: ownNumber() });
      sessionStorage.setItem(kSession, opened.session);
      break;
    } catch (error) {
      const { status, message } = error as Refused;
      refusal = message;
      if (status !== 0 && status !== 503) break;
      held(refusal);
      await new Promise((resolve) => setTimeout(resolve, pause_ms(tries)));
    }
  }
  history.replaceState(null, "", "/");
  sessionStorage.removeItem(kNumber);
  return session() ? null : refusal;
}

export type News = (topic: string, value: unknown) => void;

export interface Link {
  stop(): void;
}

/// Follows what is new until stopped; connects again by itself. `told`: connected or not; `ended`: for good, the session
/// is over.
export function follow(news: News, told: (connected: boolean) => void, ended: (why: string) => void): Link {
  let stopped = false;
  let current: AbortController | null = null;
  let tries = 0;

  const once = async (): Promise<void> => {
    const give_up = new AbortController();
    current = give_up;
    let watchdog = setTimeout(() => give_up.abort(), kSilence_ms * 2);
    try {
      const response = await post("events", {}, give_up.signal);
      if (response.status === 401) {
        sessionStorage.removeItem(kSession);
        stopped = true;
        ended(sentence((await response.json()).error));
        return;
      }
      if (!response.ok || !response.body) return;
      tries = 0;
      const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
      let text = "";
      for (;;) {
        const { done, value } = await reader.read();
        if (done) return;
        clearTimeout(watchdog);
        watchdog = setTimeout(() => give_up.abort(), kSilence_ms);
        told(true);
        text += value;
        for (let end = text.indexOf("\n\n"); end >= 0; end = text.indexOf("\n\n")) {
          const event = /^event: (.*)\ndata: (.*)$/.exec(text.slice(0, end));
          text = text.slice(end + 2);
          if (event) news(event[1]!, JSON.parse(event[2]!));
        }
      }
    } catch {
      // Lost: told below, and tried again.
    } finally {
      clearTimeout(watchdog);
    }
  };

  const run = async (): Promise<void> => {
    while (!stopped) {
      await once();
      if (stopped) return;
      told(false);
      await new Promise((resolve) => setTimeout(resolve, pause_ms(tries++)));
    }
  };
  void run();
  return {
    stop() {
      stopped = true;
      current?.abort();
    },
  };
}
