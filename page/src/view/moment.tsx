/** The frame in words and numbers: what was decided, why, what would have prevented it, and what came of it. */

import type { Track } from "../data/run";
import type { EventRow } from "../data/types";
import type { State } from "../state";
import { plural, short } from "./words";

const AFTER = 10;

export function Moment({ state }: { state: State }) {
  const [track, row, frame] = [state.track.value, state.row.value, state.frame.value];
  const here = state.events.value.filter((event) => event.frame === frame);
  const told = here.filter((event) => event.sort !== "note" || state.notes.value);
  const rest = here.filter((event) => !told.includes(event));
  return (
    <section class="moment" aria-label="This frame" aria-live={state.playing.value || (state.live !== null && state.following.value) ? "off" : "polite"}>
      <Status state={state} />
      {row >= 0 && <Doubts state={state} />}
      {told.map((event, index) => (
        <Told key={index} state={state} event={event} />
      ))}
      {told.every((event) => event.sort !== "status") && <Since state={state} />}
      {told.length === 0 && <Last state={state} />}
      {rest.map((event, index) => (
        <p key={index} class="aside">
          {event.why !== "" && `${event.why} → `}
          {event.what}
        </p>
      ))}
      {track !== undefined && row >= 0 && <Numbers state={state} track={track} row={row} />}
    </section>
  );
}

function Status({ state }: { state: State }) {
  const [track, row] = [state.track.value, state.row.value];
  const seconds = track?.value("time_s", row) ?? NaN;
  const status = track !== undefined && row >= 0 ? track.status(row) : "not there";
  const score = track?.value("score", row) ?? NaN;
  // Without a fitted score nothing says that a box which is followed is on the target.
  const judged = track?.calibrated === true || status !== "tracking";
  return (
    <p class="status">
      <b>Frame {state.frame.value}</b>
      {Number.isFinite(seconds) && <span class="time">{seconds.toFixed(2)} s</span>}
      <span class={`chip ${judged ? status.replace(" ", "-") : "not-judged"}`}>{status}</span>
      {Number.isFinite(score) && (
        <span title={track?.calibrated ? "probability of being on target" : "index of certainty, not calibrated"}>
          {track?.calibrated ? "on target" : "score"} <b>{score.toFixed(2)}</b>
          {!track?.calibrated && <small> index, not fitted: it cannot tell whether the box is right</small>}
        </span>
      )}
    </p>
  );
}

function Told({ state, event }: { state: State; event: EventRow }) {
  return (
    <article class={`told ${lookOf(event)}`}>
      <h3>
        <Mark event={event} /> <What text={event.what} />
        {(event.sort === "switch" || event.sort === "status") && <small> from frame {event.frame + 1} on</small>}
      </h3>
      <dl>
        {event.why !== "" && (
          <>
            <dt>Why</dt>
            <dd>{event.why}</dd>
          </>
        )}
        {event.unless !== "" && (
          <>
            <dt>Unless</dt>
            <dd>{event.unless}</dd>
          </>
        )}
        <Afterwards state={state} event={event} />
      </dl>
    </article>
  );
}

/** How UD, and the overlap with the truth, went on. */
function Afterwards({ state, event }: { state: State; event: EventRow }) {
  const track = state.track.value;
  if (track === undefined || (event.sort !== "switch" && event.sort !== "status")) return null;
  const row = track.rowOf(event.frame);
  const end = Math.min(row + AFTER, track.length - 1);
  if (row < 0 || end <= row) return null;
  const [before, after] = [track.value("ud_px2", row), track.value("ud_px2", end)];
  const [was, is] = [state.run.overlap(track, row), state.run.overlap(track, end)];
  return (
    <>
      <dt>Then</dt>
      <dd>
        UD {short(before)} → {short(after)} {state.run.udUnit(track)} in {plural(end - row, "frame")}
        {Number.isFinite(was + is) && `; overlap with the truth ${was.toFixed(2)} → ${is.toFixed(2)}`}
      </dd>
    </>
  );
}

/** Whom the target may be instead, and what decided it: as links to the other one, and to where they met. */
function Doubts({ state }: { state: State }) {
  const [frame, target] = [state.frame.value, state.target.value];
  void state.version.value;
  return (
    <>
      {state.run.doubtsOf(target, frame).map((doubt, index) => (
        <p key={index} class="since doubt">
          could be {doubt.mutual && "swapped with "}
          <button type="button" disabled={!state.run.tracks.has(doubt.other)} onClick={() => (state.target.value = doubt.other)}>
            {doubt.other}
          </button>{" "}
          since{" "}
          <button type="button" onClick={() => state.step(doubt.since - frame)}>
            frame {doubt.since}
          </button>
          : <b>{doubt.probability.toFixed(2)}</b>; {doubt.reason}
        </p>
      ))}
    </>
  );
}

/** Why the target has been lost or uncertain until now. */
function Since({ state }: { state: State }) {
  const [track, row, frame] = [state.track.value, state.row.value, state.frame.value];
  const status = track !== undefined && row >= 0 ? track.status(row) : "tracking";
  const changed = state.events.value.filter((event) => event.sort === "status" && event.frame < frame).at(-1);
  if (changed === undefined || changed.status !== status || status === "tracking" || changed.why === "") return null;
  return (
    <p class="since">
      {status} since frame {changed.frame + 1}: {changed.why}
      {changed.unless !== "" && <small>; {changed.unless}</small>}
    </p>
  );
}

function Last({ state }: { state: State }) {
  const frame = state.frame.value;
  const events = state.events.value.filter((event) => event.sort !== "note");
  const last = events.filter((event) => event.frame < frame).at(-1);
  const next = events.find((event) => event.frame > frame);
  return (
    <p class="between">
      {last !== undefined && (
        <button type="button" onClick={() => state.show(last)}>
          <Mark event={last} /> {plural(frame - last.frame, "frame")} after <b>{brief(last)}</b>
        </button>
      )}
      {next !== undefined && (
        <button type="button" onClick={() => state.show(next)}>
          <Mark event={next} /> {plural(next.frame - frame, "frame")} before <b>{brief(next)}</b>
        </button>
      )}
    </p>
  );
}

function Numbers({ state, track, row }: { state: State; track: Track; row: number }) {
  const value = (name: string, place = 0) => short(track.value(name, row, place));
  const overlap = state.run.overlap(track, row);
  const ofFilter = state.run.about.smoothed === true ? ", filter" : "";
  const items: [string, string, string][] = [
    ["UD", `${value("ud_px2")} ${state.run.udUnit(track)}`, "uncertainty deviation"],
    ["baseline", `${value("quiet_px2")} ${state.run.udUnit(track)}`, "UD where nothing is wrong, as measured"],
    ["sd of centre", `${value("sd", 0)}, ${value("sd", 1)} px`, "posterior standard deviation of x and y"],
    ["box", `${value("box", 2)} × ${value("box", 3)} px`, "size of the estimate"],
    [`log evidence${ofFilter}`, value("log_evidence"), "how well the frame was foreseen"],
    [`surprise${ofFilter}`, `${value("surprise")} nats`, "KL(posterior ‖ prior): how far the frame moved the belief"],
    [`effective${ofFilter}`, `${value("ess")} of ${value("particles")}`, "hypotheses: as how many they count, and how many there are"],
    ["learning rate", value("learn_rate"), "0 while UD is above the level"],
    ["time", `${short(state.run.ms("ms", state.frame.value))} ms`, "of the whole step"],
  ];
  if (state.run.cameras.length > 0 && Number.isFinite(track.value("ground", row))) {
    const [x, y, sdX, sdY] = track.values("ground", row) as [number, number, number, number];
    items.splice(2, 2, ["place", `${x.toFixed(2)}, ${y.toFixed(2)} m`, "x and y on the ground"], ["sd of place", `${short(sdX)}, ${short(sdY)} m`, "posterior standard deviation of x and y"]);
  }
  const shares = track.shares(row).slice(0, 2).map(([name, share]) => `${name} ${share.toFixed(2)}`);
  if (shares.length > 0) items.push(["identity", shares.join(", "), "whose identity the target has, the two most probable ones"]);
  const hidden = state.run.hidden(track, row);
  if (Number.isFinite(hidden)) items.splice(2, 0, ["hidden", hidden.toFixed(2), "probability that the target cannot be seen"]);
  if (Number.isFinite(overlap)) items.splice(2, 0, ["true overlap", overlap.toFixed(2), "IoU with the true box"]);
  return (
    <dl class="numbers">
      {items.map(([name, text, title]) => (
        <div key={name} title={title}>
          <dt>{name}</dt>
          <dd>{text}</dd>
        </div>
      ))}
    </dl>
  );
}

function lookOf(event: EventRow): string {
  if (event.sort === "switch") return event.on ? "on" : "off";
  return event.sort === "status" ? (event.status ?? "tracking") : event.sort;
}

export function Mark({ event }: { event: EventRow }) {
  const look = lookOf(event);
  const on = look === "on";
  const other = event.sort === "camera" ? "M2 2h8v8H2z" : "M6 1l5 5-5 5-5-5z";
  const d = event.sort === "switch" ? (on ? "M1 9h10L6 1z" : "M1 3h10L6 11z") : other;
  return (
    <svg class={`mark ${look}`} viewBox="0 0 12 12" width="12" height="12" aria-hidden="true">
      <path d={d} />
    </svg>
  );
}

/** What happened; how it was chosen stands behind it in brackets, and is said more quietly with what follows. */
export function What({ text }: { text: string }) {
  const [, what, choice, rest] = /^(.+?) \((.*)\)(?:(, but .*)|)$/.exec(text) ?? [];
  if (what === undefined) return <b>{text}</b>;
  return (
    <>
      <b>{what}</b>{" "}
      <span class="choice">
        {choice}
        {rest}
      </span>
    </>
  );
}

export function brief(event: EventRow): string {
  return event.what.split(/ \(| \u2192 |, centre/)[0]!;
}
