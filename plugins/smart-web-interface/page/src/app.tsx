import { useEffect, useMemo, useRef, useState } from "preact/hooks";
import { Account } from "./account";
import { Doubt, doubtOf, useSettled } from "./doubt";
import type { BuildingMap, Destination, Instruction, Location, Me, Path, Status } from "./model";
import { Passing, usePassing } from "./passing";
import { Plan } from "./plan";
import { goalOf, pathLength, progressOf, stepsOf } from "./route";
import { WhatIsRunning } from "./running";
import { Search } from "./search";
import { call, follow, open, pause_ms } from "./server";
import { Now, Steps } from "./steps";
import { inert, levelName } from "./text";
import { useRestart, useTrip, type Trip } from "./trip";

const kGuest: Me = { user: null, profile: null, notice: "" };
const kTabs = [["guide", "Guide"], ["running", "What is running"]] as const;
type Tab = (typeof kTabs)[number][0];

/// As the pattern "tabs with automatic activation" of WAI-ARIA has it: one stop for TAB, arrows move.
function Tabs({ tab, choose }: { tab: Tab; choose: (tab: Tab) => void }) {
  const keys = (event: KeyboardEvent) => {
    const ahead: Record<string, number> = { ArrowRight: 1, ArrowLeft: -1 };
    const step = ahead[event.key];
    if (!step) return;
    event.preventDefault();
    const to = kTabs[(kTabs.findIndex(([name]) => name === tab) + step + kTabs.length) % kTabs.length]![0];
    choose(to);
    document.getElementById(`tab-${to}`)?.focus();
  };
  return (
    <div class="tabs" role="tablist" aria-label="Views" onKeyDown={keys}>
      {kTabs.map(([name, title]) => (
        <button
          key={name}
          id={`tab-${name}`}
          type="button"
          role="tab"
          aria-selected={tab === name}
          aria-controls={`view-${name}`}
          tabIndex={tab === name ? 0 : -1}
          onClick={() => choose(name)}
        >
          {title}
        </button>
      ))}
    </div>
  );
}

/// Why there is no plan to be shown; empty: there is one.
function whyNoMap(map: BuildingMap | null, status: Status | null): string {
  if (map) return map.rooms.length ? "" : "The map of the building has no levels with rooms: there is nothing to be shown, and nowhere to be led.";
  if (status?.map === "unwired") return "This system has no map.";
  return status?.mapFault ? `There is no map of the building: ${inert(status.mapFault)}.` : "Waiting for the map…";
}

const nameOf = (to: Destination): string => inert(to.label) || "a place without a name";

function Whither({ said, to, map }: { said: string; to: Destination; map: BuildingMap | null }) {
  return (
    <p class="to">
      <span>{said}</span> <strong>{nameOf(to)}</strong>, {levelName(to.level, map?.levels ?? [])}
    </p>
  );
}

export function App() {
  const [closed, setClosed] = useState<string | null>(null);
  const [opened, setOpened] = useState(false);
  const [held, setHeld] = useState("");
  const [connected, setConnected] = useState(false);
  const [everConnected, setEverConnected] = useState(false);
  const [status, setStatus] = useState<Status | null>(null);
  const [location, setLocation] = useState<Location | null>(null);
  const [toldPath, setPath] = useState<Path | null>(null);
  const [instruction, setInstruction] = useState<Instruction | null>(null);
  const [version, setVersion] = useState<string | null>(null);
  const [map, setMap] = useState<BuildingMap | null>(null);
  const [me, setMe] = useState<Me>(kGuest);
  const [account, setAccount] = useState(false);
  const [attention, setAttention] = useState<Instruction[]>([]);
  const [wanted, setWanted] = useState<Destination | null>(null); // picked here, and not answered yet
  const [fault, setFault] = useState("");
  const [tab, setTab] = useState<Tab>("guide");
  const [busy, setBusy] = useState(false);

  useEffect(() => {
    let link: { stop(): void } | null = null;
    void open(setHeld).then((why) => {
      setClosed(why);
      setOpened(true);
      if (why) return;
      const topics: Record<string, (value: never) => void> = {
        status: setStatus,
        location: setLocation,
        path: setPath,
        instruction: setInstruction,
        attention: setAttention,
        map: (value: { version: string }) => setVersion(value.version),
      };
      link = follow(
        (topic, value) => topics[topic]?.(value as never),
        (now) => {
          setConnected(now);
          if (now) setEverConnected(true);
        },
        (reason) => {
          setConnected(false);
          setClosed(reason);
        },
      );
    });
    return () => link?.stop();
  }, []);

  // Asked again after each loss: another server, or another login, may be behind the same address. What was asked before a
  // log-in, or another change, was answered tells how it was: it is asked anew.
  const changes = useRef(0);
  const changed = (now: Me) => {
    changes.current += 1;
    setMe(now);
  };
  useEffect(() => {
    if (!connected) return;
    let over = false;
    const ask = async (): Promise<void> => {
      const before = changes.current;
      const now = await call<Me>("me").catch(() => null);
      if (over || !now) return;
      if (changes.current === before) setMe(now);
      else void ask();
    };
    void ask();
    const timer = setInterval(ask, 30000);
    return () => {
      over = true;
      clearInterval(timer);
    };
  }, [connected]);
  useEffect(() => {
    if (!connected || !version) return;
    let over = false; // another version is there, whose answer counts
    let timer: ReturnType<typeof setTimeout>;
    const ask = async (tries: number): Promise<void> => {
      const asked = await call<BuildingMap>("map").catch(() => null);
      if (over) return;
      if (asked) setMap(asked);
      else timer = setTimeout(() => void ask(tries + 1), pause_ms(tries));
    };
    void ask(0);
    return () => {
      over = true;
      clearTimeout(timer);
    };
  }, [connected, version]);
  useEffect(() => {
    if (map) document.title = `${inert(map.title)} · FIONA`;
  }, [map]);

  const points = me.profile?.points ?? [];
  const path = status?.path === "connected" ? toldPath : null;
  const guide = status?.instructions === "connected" && connected ? instruction : null;
  const uncertain = useSettled(doubtOf(connected, status, location, guide));
  const certain = connected && uncertain === "";
  // Where nothing is known of the place, the steps stay where it was last.
  const placed = useRef<Location | null>(null);
  if (location?.valid) placed.current = location;
  const place = placed.current;
  const progress = useMemo(() => (path ? progressOf(path, place) : null), [path, place]);
  // Another page, or the console, may have chosen another room: where one is led is what the path says.
  const goal = useMemo(() => goalOf(path, map), [path, map]);
  const steps = useMemo(() => (path ? stepsOf(path, map, goal?.label ?? "") : []), [path, map, goal]);
  const [trip, setTrip] = useTrip(goal, guide);
  const passing = usePassing(points, location, map, guide !== null && !!trip?.mine && trip.user === me.user);
  const along = progress?.along ?? 0;
  const current = Math.max(0, steps.map((step) => step.at <= along + 0.5).lastIndexOf(true));
  const next = steps[current + 1] ?? steps[current] ?? null;

  useEffect(() => {
    if (goal) setWanted(null);
  }, [goal]);
  useEffect(() => {
    if (guide?.kind === "NO_PATH" || guide?.kind === "ARRIVE") setWanted(null);
  }, [guide]);

  const send = async (to: Destination, more: Partial<Trip> = {}) => {
    setBusy(true);
    setFault("");
    setWanted(to);
    setTrip({ to, mine: true, user: me.user, begun: false, again: false, over: false, ...more });
    try {
      await call("destination", { x: to.x, y: to.y, level: to.level });
    } catch (error) {
      setWanted(null);
      setTrip(trip && { ...trip, again: trip.again || !!more.again });
      setFault(`${to.label}: ${(error as Error).message}`);
    } finally {
      setBusy(false);
    }
  };
  const pick = (to: Destination) => {
    // The list of rooms closes, or the button goes, and what had the focus may have been in it.
    document.getElementById(account ? "account" : tab === "guide" ? "panel" : "running")?.focus();
    void send(to);
  };
  // Who logs in on the way is led on as who they are. Who logs out is not led on, by the guide.
  useEffect(() => {
    if (me === kGuest || !trip?.mine || trip.over || trip.user === me.user) return;
    if (me.user) void send(trip.to, { begun: trip.begun, again: trip.again });
    else setTrip({ ...trip, over: true });
  }, [me === kGuest, me.user]);
  const follows = connected && status?.path === "connected" && status.instructions === "connected";
  const gone = follows && !!trip?.begun && !trip.over && !goal && !guide;
  const restart = useRestart(gone, trip, () => void send(trip!.to, { begun: true, again: true }));
  useEffect(() => {
    if (restart === "not led") setWanted(null);
  }, [restart]);

  if (!opened) return <main class="closed"><h1>FIONA</h1><p role="status">{held ? `${held} Trying again…` : "Opening…"}</p></main>;
  if (closed) {
    return (
      <main class="closed">
        <h1>FIONA</h1>
        <p role="alert">{closed}</p>
        <p>Whoever runs the system gets one with <code>call web.link</code> in the console. It opens one page, once.</p>
      </main>
    );
  }
  const connection = connected ? "Connected" : everConnected ? "Connection lost, connecting again…" : "Connecting…";
  const lost = status?.instructions === "lost" || (status?.instructions === "unwired" && status.path === "lost");
  const unmapped = whyNoMap(map, status);
  const unguided = !connected ? "No guidance without a connection" : lost ? "No guidance: navigation was lost" : "";
  const lead = (
    <div class="lead">
      <Doubt told={uncertain} connected={connected} location={location} />
      <p role="alert" class="fault">{fault}</p>
      <p role="status" class="notice">{restart === "led again" ? "Guidance was started again." : ""}</p>
      <div class={restart === "not led" ? "fault" : "hidden"}>
        <p role="alert">{restart === "not led" ? "Guidance was started again: you are not led any more." : ""}</p>
        {restart === "not led" && trip && <button type="button" disabled={busy} onClick={() => pick(trip.to)}>Lead me on to {nameOf(trip.to)}</button>}
      </div>
      <Passing told={new Map([...passing.map((text) => ({ text, language: "" })), ...(guide ? attention : [])].map((one) => [inert(one.text), one.language]))} />
      {!account && me.notice && <p role="status" class="notice">{me.notice}</p>}
      <Now unknown={unguided} instruction={guide} next={next} ahead={next && progress ? next.at - along : null} />
    </div>
  );
  return (
    <div class={connected ? "app" : "app offline"}>
      <a class="skip" href="#panel" onClick={(event) => (event.preventDefault(), document.getElementById(tab === "guide" ? "panel" : "running")?.focus())}>
        {tab === "guide" ? "Skip to destination and steps" : "Skip to what is running"}
      </a>
      <header class="top">
        <h1>{map ? inert(map.title) : "FIONA"}</h1>
        {status?.login !== "unwired" && (
          <button type="button" class="who" onClick={() => setAccount(true)}>
            {me.user ? <><span class="hidden">Profile of </span>{inert(me.user)}</> : "Log in"}
          </button>
        )}
        <p class={connected ? "connection" : "connection lost"} role="status">
          <span class="sign" aria-hidden="true" />
          {connection}
        </p>
        <Tabs tab={tab} choose={setTab} />
      </header>
      <main class={tab === "guide" ? "guide" : ""}>
        {lead}
        <div class="view" role="tabpanel" id="view-running" aria-labelledby="tab-running" hidden={tab !== "running"}>
          {tab === "running" && (
            <WhatIsRunning connected={connected} user={me.user} logIn={status?.login === "unwired" ? null : () => setAccount(true)} />
          )}
        </div>
        <div class="view guide" role="tabpanel" id="view-guide" aria-labelledby="tab-guide" hidden={tab !== "guide"}>
          {map && !unmapped ? (
            <Plan map={map} location={location} place={place} certain={certain} path={path} progress={progress} destination={goal ?? wanted} chosen={wanted} points={points} />
          ) : (
            <p class="no-map" role="status">{unmapped}</p>
          )}
          <div class="panel" id="panel" tabIndex={-1}>
            {map && !unmapped ? <Search map={map} access={me.profile?.level ?? 0} busy={busy || !connected} pick={pick} /> : null}
            {goal ? <Whither said="To" to={goal} map={map} /> : wanted && <Whither said="Asked for" to={wanted} map={map} />}
            {steps.length > 1 && <Steps steps={steps} current={current} total={Math.max(0, pathLength(path!) - along)} />}
            {!steps.length && !wanted && map && !unmapped && <p class="hint">Choose a room, and the way to it is shown here step by step.</p>}
          </div>
        </div>
      </main>
      {account && (
        <Account me={me} map={map} location={location} close={() => setAccount(false)} changed={changed}>
          {/* All behind a dialog is silent. */}
          {lead}
        </Account>
      )}
    </div>
  );
}
