import { useEffect, useRef, useState } from "preact/hooks";
import type { Instance, Running, Wire } from "./model";
import { Refused, call } from "./server";
import { inert } from "./text";

const kPeriod_ms = 1000;

const since = (age?: number): string => (age === undefined ? "" : age < 1000 ? `${age} ms old` : `${Math.round(age / 1000)} s old`);

function stateOf(wire: Wire): string {
  if (!wire.provider) return wire.optional ? "not wired, optional" : "not wired";
  if (wire.state !== "connected") return `${wire.state}${wire.reason ? `: ${inert(wire.reason)}` : ""}`;
  const facts = [wire.rate === undefined ? "" : `${wire.rate} Hz`, since(wire.age), wire.dropped ? `${wire.dropped} dropped` : ""];
  return facts.filter(Boolean).join(", ") || "connected";
}

function Instances({ all }: { all: Instance[] }) {
  return (
    <section aria-labelledby="instances">
      <h2 id="instances">Instances</h2>
      <ul class="cards">
        {all.map((one) => (
          <li key={one.name} class={one.mode === "failed" || one.silent ? "bad" : ""}>
            <p class="title">
              <strong>{inert(one.name)}</strong> <span class="mode">{one.silent ? `silent for ${one.silent} s` : one.mode}</span>
            </p>
            <p class="hint">
              {inert(one.plugin)} {inert(one.version)}, in {inert(one.group)}
              {one.restarts ? `, started again ${one.restarts === 1 ? "once" : `${one.restarts} times`}` : ""}
            </p>
            {one.reason && <p class="reason">{inert(one.reason)}</p>}
          </li>
        ))}
      </ul>
    </section>
  );
}

interface Change {
  busy: boolean;
  change: (client: string, provider: string) => void;
}

function WireCard({ wire, may, busy, change }: Change & { wire: Wire; may: boolean }) {
  const [picked, setPicked] = useState("");
  const select = useRef<HTMLSelectElement>(null);
  const choice = wire.fits.includes(picked) ? picked : "";
  const bad = wire.provider ? wire.state !== "connected" : !wire.optional;
  return (
    <li class={bad ? "bad" : ""}>
      <p class="title">
        <strong>{inert(wire.client)}</strong> {wire.provider && <>from <strong>{inert(wire.provider)}</strong></>}
      </p>
      <p class="hint">
        {inert(wire.service)}: {stateOf(wire)}
      </p>
      {may && wire.fits.length > 0 && (
        <form
          class="swap"
          onSubmit={(event) => {
            event.preventDefault();
            if (!choice) return;
            // The button has nothing to do once it was used, and what is disabled loses the focus.
            select.current?.focus();
            change(wire.client, choice);
          }}
        >
          <select
            ref={select}
            aria-label={`Another provider for ${inert(wire.client)}`}
            value={choice}
            onChange={(event) => setPicked(event.currentTarget.value)}
          >
            <option value="">Another that fits…</option>
            {wire.fits.map((one) => <option key={one} value={one}>{inert(one)}</option>)}
          </select>
          <button type="submit" aria-label={`Switch ${inert(wire.client)}`} disabled={busy || !choice}>Switch</button>
        </form>
      )}
    </li>
  );
}

/// The running system, live, for those whose level allows to look; with what to switch for those who may.
export function WhatIsRunning({ connected, user, logIn }: { connected: boolean; user: string | null; logIn: (() => void) | null }) {
  const [running, setRunning] = useState<Running | null>(null);
  const [fault, setFault] = useState("");
  const [refused, setRefused] = useState("");
  const [done, setDone] = useState("");
  const [busy, setBusy] = useState(false);
  const look = () =>
    call<Running>("system").then(
      (now) => {
        setRunning(now);
        setFault("");
      },
      (error: Refused) => {
        // What may not be seen any more is not left on the screen; what is only late is.
        if (error.status === 403) setRunning(null);
        setFault(error.message);
      },
    );
  useEffect(() => {
    if (!connected) return;
    let stopped = false;
    let timer: ReturnType<typeof setTimeout>;
    const again = async (): Promise<void> => {
      await look();
      if (!stopped) timer = setTimeout(again, kPeriod_ms);
    };
    void again();
    return () => {
      stopped = true;
      clearTimeout(timer);
    };
  }, [connected, user]);

  const change = async (client: string, provider: string) => {
    setBusy(true);
    setDone("");
    setRefused("");
    try {
      const made = await call<{ note: string; gap: number; lost: number }>("rewire", { client, provider });
      setDone(`${made.note}: gap ${made.gap} ms, lost ${made.lost}`);
      await look();
    } catch (error) {
      setRefused((error as Error).message);
    } finally {
      setBusy(false);
    }
  };
  return (
    <div class="running" id="running" tabIndex={-1}>
      <p role="alert" class="fault">{connected ? refused || fault : "Not connected: what was running is shown."}</p>
      <p role="status" class="done">{done}</p>
      {!running && fault && !user && logIn && <button type="button" class="main" onClick={logIn}>Log in</button>}
      {running && (
        <>
          <Instances all={running.instances} />
          <section aria-labelledby="wires">
            <h2 id="wires">Wires</h2>
            <ul class="cards">
              {running.wires.map((wire) => (
                <WireCard key={wire.client} wire={wire} may={running.mayChange && connected} busy={busy} change={change} />
              ))}
            </ul>
          </section>
        </>
      )}
    </div>
  );
}
