import { useEffect, useMemo, useRef, useState } from "preact/hooks";
import { Account } from "./account";
import type { BuildingMap, Destination, Instruction, Location, Me, Path, Point, Status } from "./model";
import { Plan, shownLevel } from "./plan";
import { pathLength, progressOf, stepsOf } from "./route";
import { WhatIsRunning } from "./running";
import { Search } from "./search";
import { call, follow, open } from "./server";
import { NoGuidance, Now, Steps } from "./steps";
import { inert, levelName } from "./text";

const kUncertain_m = 8; // semi-axis of the 95 % region above which doors are guesses
const kPassing_m = 3;
const kPassed_m = 6;
const kGuest: Me = { user: null, profile: null, notice: "" };
const kDestination = "fiona-destination";
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

/// Points are told once when they are passed, on their own level, and again after the walker has been away.
function usePassing(points: Point[], location: Location | null, map: BuildingMap | null): string {
  const near = useRef(new Set<string>());
  const [said, setSaid] = useState("");
  useEffect(() => {
    if (!location?.valid || !map) return;
    for (const point of points) {
      const key = `${point.x},${point.y},${point.level}`;
      const away = Math.hypot(point.x - location.x, point.y - location.y);
      const same = shownLevel(location.level, map) === point.level;
      if (same && away < kPassing_m && !near.current.has(key)) {
        near.current.add(key);
        setSaid(`Passing ${inert(point.name) || "a point of attention"}`);
      } else if (!same || away > kPassed_m) {
        near.current.delete(key);
      }
    }
  }, [points, location, map]);
  useEffect(() => {
    if (!said) return;
    const timer = setTimeout(() => setSaid(""), 8000);
    return () => clearTimeout(timer);
  }, [said]);
  return said;
}

function keptDestination(): Destination | null {
  try {
    return JSON.parse(sessionStorage.getItem(kDestination) ?? "null");
  } catch {
    return null;
  }
}

/// Why the position must not be trusted; empty: it may.
function doubt(connected: boolean, status: Status | null, location: Location | null, guide: Instruction | null): string {
  if (!connected) return "";
  if (!status) return "Position not known yet";
  const reasons: Record<string, string> = {
    lost: "Position uncertain: localisation was lost",
    silent: "Position uncertain: nothing is heard of localisation",
    waiting: "Position uncertain: localisation is not there yet",
    unwired: "No localisation in this system",
  };
  const reason = reasons[status.location];
  if (reason) return reason;
  if (!location?.valid) return "Position uncertain";
  const within = location.ellipse ? `, within ${Math.max(1, Math.round(location.ellipse.major))} m` : "";
  // Who guides knows more: that the place has just jumped, say.
  return guide?.uncertain || (location.ellipse?.major ?? 0) > kUncertain_m ? `Position uncertain${within}` : "";
}

export function App() {
  const [closed, setClosed] = useState<string | null>(null);
  const [opened, setOpened] = useState(false);
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
  const [destination, setDestination] = useState<Destination | null>(keptDestination);
  const [fault, setFault] = useState("");
  const [tab, setTab] = useState<Tab>("guide");
  const [busy, setBusy] = useState(false);

  useEffect(() => {
    let link: { stop(): void } | null = null;
    void open().then((why) => {
      setClosed(why);
      setOpened(true);
      if (why) return;
      const topics: Record<string, (value: never) => void> = {
        status: setStatus,
        location: setLocation,
        path: setPath,
        instruction: setInstruction,
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

  // Asked again after each loss: another server, or another login, may be behind the same address.
  useEffect(() => {
    if (!connected) return;
    const ask = () => call<Me>("me").then(setMe, () => undefined);
    void ask();
    const timer = setInterval(ask, 30000);
    return () => clearInterval(timer);
  }, [connected]);
  useEffect(() => {
    if (connected && version) call<BuildingMap>("map").then(setMap, () => undefined);
  }, [connected, version]);
  useEffect(() => {
    if (map) document.title = `${inert(map.title)} · FIONA`;
  }, [map]);

  const points = me.profile?.points ?? [];
  const path = status?.path === "connected" ? toldPath : null;
  const passing = usePassing(points, location, map);
  const guide = status?.instructions === "connected" && connected ? instruction : null;
  const uncertain = doubt(connected, status, location, guide);
  const certain = connected && uncertain === "";
  const progress = useMemo(() => (path ? progressOf(path, location) : null), [path, location]);
  const steps = useMemo(() => (path ? stepsOf(path, map, destination ? inert(destination.label) : "") : []), [path, map, destination]);
  const along = progress?.along ?? 0;
  const current = Math.max(0, steps.map((step) => step.at <= along + 0.5).lastIndexOf(true));
  const next = steps[current + 1] ?? steps[current] ?? null;

  const pick = async (to: Destination) => {
    setBusy(true);
    setFault("");
    try {
      await call("destination", { x: to.x, y: to.y, level: to.level });
      setDestination(to);
      sessionStorage.setItem(kDestination, JSON.stringify(to));
    } catch (error) {
      setFault(`${to.label}: ${(error as Error).message}`);
    } finally {
      setBusy(false);
    }
  };

  if (!opened) return <main class="closed"><h1>FIONA</h1><p role="status">Opening…</p></main>;
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
  const unguided = !connected ? "No guidance without a connection" : lost ? "No guidance: navigation was lost" : "";
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
      <main>
        <div class="view" role="tabpanel" id="view-running" aria-labelledby="tab-running" hidden={tab !== "running"}>
          {tab === "running" && (
            <WhatIsRunning connected={connected} user={me.user} logIn={status?.login === "unwired" ? null : () => setAccount(true)} />
          )}
        </div>
        <div class="view guide" role="tabpanel" id="view-guide" aria-labelledby="tab-guide" hidden={tab !== "guide"}>
          <div class="lead">
            <p role="alert" class="uncertain">{uncertain}</p>
            <p role="alert" class="fault">{fault}</p>
            <p role="status" class="passing">{passing}</p>
            {!account && me.notice && <p role="status" class="notice">{me.notice}</p>}
            {unguided ? (
              <NoGuidance why={unguided} />
            ) : (
              <Now instruction={guide} next={next} ahead={next && progress ? next.at - along : null} />
            )}
          </div>
          {map ? (
            <Plan map={map} location={location} certain={certain} path={path} progress={progress} destination={destination} points={points} />
          ) : (
            <p class="no-map" role="status">{status?.map === "unwired" ? "This system has no map." : "Waiting for the map…"}</p>
          )}
          <div class="panel" id="panel" tabIndex={-1}>
            {map ? <Search map={map} access={me.profile?.level ?? 0} busy={busy || !connected} pick={pick} /> : null}
            {destination && (
              <p class="to">
                <span>To</span> <strong>{inert(destination.label)}</strong>, {levelName(destination.level, map?.levels ?? [])}
              </p>
            )}
            {steps.length > 1 && <Steps steps={steps} current={current} total={Math.max(0, pathLength(path!) - along)} />}
            {!steps.length && map && <p class="hint">Choose a room, and the way to it is shown here step by step.</p>}
          </div>
        </div>
      </main>
      {account && <Account me={me} map={map} location={location} close={() => setAccount(false)} changed={setMe} />}
    </div>
  );
}
