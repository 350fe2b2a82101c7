import type { ComponentChildren } from "preact";
import { useEffect, useLayoutEffect, useRef, useState } from "preact/hooks";
import type { BuildingMap, Location, Me, Point } from "./model";
import { shownLevel } from "./plan";
import { call } from "./server";
import { inert, levelName } from "./text";

interface Props {
  me: Me;
  map: BuildingMap | null;
  location: Location | null;
  close: () => void;
  changed: (me: Me) => void;
  children: ComponentChildren; // what is told meanwhile
}

const kChoices = [
  ["use_elevator", "Lifts", "I take lifts", "I take no lifts"],
  ["use_stairs", "Stairs", "I take stairs", "I take no stairs"],
  ["use_outdoor_navigation", "Outdoors", "I also go outdoors", "I stay indoors"],
] as const;

export function Account({ me, map, location, close, changed, children }: Props) {
  const dialog = useRef<HTMLDialogElement>(null);
  const heading = useRef<HTMLHeadingElement>(null);
  const used = useRef<Element | null>(null);
  const [fault, setFault] = useState("");
  const [done, setDone] = useState(me.notice);
  const [busy, setBusy] = useState(false);
  useEffect(() => dialog.current?.showModal(), []);
  // What was used is disabled meanwhile, and may be gone by now: the focus is not to be lost with it, not for one frame.
  useLayoutEffect(() => {
    if (busy || !used.current || document.activeElement !== document.body) return;
    (used.current.isConnected ? (used.current as HTMLElement) : heading.current)?.focus();
  }, [busy]);

  const ask = async (name: string, body: unknown, said: string) => {
    used.current = document.activeElement;
    setBusy(true);
    setFault("");
    setDone("");
    try {
      const answer = await call<Me>(name, body);
      changed(answer);
      setDone(answer.notice || said);
    } catch (error) {
      setFault((error as Error).message);
    } finally {
      setBusy(false);
    }
  };
  return (
    <dialog ref={dialog} class="account" aria-labelledby="account" onClose={close}>
      <header>
        <h2 id="account" ref={heading} tabIndex={-1}>{me.user ? inert(me.user) : "Log in"}</h2>
        <button type="button" class="close" aria-label="Close" onClick={() => dialog.current?.close()}>
          <svg viewBox="0 0 24 24" aria-hidden="true"><path d="M6 6l12 12M18 6 6 18" /></svg>
        </button>
      </header>
      {children}
      <p role="alert" class="fault">{fault}</p>
      <p role="status" class="done">{done}</p>
      {me.user ? <Profile me={me} map={map} location={location} busy={busy} ask={ask} /> : <LogIn busy={busy} ask={ask} />}
    </dialog>
  );
}

interface Ask {
  busy: boolean;
  ask: (name: string, body: unknown, said: string) => Promise<void>;
}

function LogIn({ busy, ask }: Ask) {
  const form = useRef<HTMLFormElement>(null);
  return (
    <form
      ref={form}
      class="login"
      onSubmit={(event) => {
        event.preventDefault();
        const fields = new FormData(form.current!);
        const body = { name: fields.get("name"), password: fields.get("password") };
        (form.current!.elements.namedItem("password") as HTMLInputElement).value = "";
        void ask("login", body, "You are logged in.");
      }}
    >
      <label for="name">Name</label>
      <input id="name" name="name" autocomplete="username" autocapitalize="none" spellcheck={false} required maxLength={64} />
      <label for="password">Password</label>
      <input id="password" name="password" type="password" autocomplete="current-password" required maxLength={1024} />
      <button type="submit" class="main" disabled={busy}>{busy ? "Checking…" : "Log in"}</button>
      <p class="hint">Without logging in you are a guest: you are guided, and nothing is kept.</p>
    </form>
  );
}

function Profile({ me, map, location, busy, ask }: Ask & { me: Me; map: BuildingMap | null; location: Location | null }) {
  const profile = me.profile;
  const [name, setName] = useState("");
  if (!profile) {
    return (
      <>
        <p>Your profile cannot be read now.</p>
        <button type="button" disabled={busy} onClick={() => ask("logout", {}, "You are logged out.")}>Log out</button>
      </>
    );
  }
  const set = (field: string, value: string) => {
    const { use_elevator, use_stairs, use_outdoor_navigation } = profile;
    const said = value === "" ? null : value === "yes";
    void ask("profile", { use_elevator, use_stairs, use_outdoor_navigation, [field]: said }, "Saved.");
  };
  const keep = (points: Point[], said: string) => ask("points", { points }, said);
  const here = location?.valid && map ? { x: location.x, y: location.y, level: shownLevel(location.level, map) } : null;
  return (
    <>
      <p class="hint">Access level {profile.level}</p>
      <fieldset disabled={busy}>
        <legend>On the way</legend>
        {kChoices.map(([field, title, yes, no]) => (
          <p key={field} class="choice">
            <label for={field}>{title}</label>
            <select
              id={field}
              value={profile[field] === null ? "" : profile[field] ? "yes" : "no"}
              onChange={(event) => set(field, event.currentTarget.value)}
            >
              <option value="">Not said</option>
              <option value="yes">{yes}</option>
              <option value="no">{no}</option>
            </select>
          </p>
        ))}
      </fieldset>
      <h3>Points of attention</h3>
      <p class="hint">You are told when you pass one.</p>
      <ul class="points">
        {profile.points.map((point, i) => (
          <li key={`${point.x} ${point.y} ${point.level}`}>
            <span>
              {inert(point.name) || "Without a name"} <small>{levelName(point.level, map?.levels ?? [])}</small>
            </span>
            <button
              type="button"
              disabled={busy}
              aria-label={`Remove ${inert(point.name) || "the point without a name"}`}
              onClick={() => keep(profile.points.filter((_, k) => k !== i), "Removed.")}
            >
              Remove
            </button>
          </li>
        ))}
      </ul>
      <form
        class="add"
        onSubmit={(event) => {
          event.preventDefault();
          if (!here) return;
          void keep([...profile.points, { ...here, name: inert(name) }], "Added.");
          setName("");
        }}
      >
        <label for="point">Name of the place where you are</label>
        <input id="point" value={name} maxLength={80} required onInput={(event) => setName(event.currentTarget.value)} />
        <button type="submit" disabled={busy || !here}>Add this place</button>
      </form>
      <button type="button" class="logout" disabled={busy} onClick={() => ask("logout", {}, "You are logged out.")}>Log out</button>
    </>
  );
}
