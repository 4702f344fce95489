/** The page. */

import type { Thinned } from "../data/types";
import type { State } from "../state";
import { KEYS, LIVE_KEYS } from "../keys";
import { Cameras } from "./cameras";
import { Charts } from "./charts";
import { Events } from "./events";
import { LiveBar } from "./live_bar";
import { Moment } from "./moment";
import { Agents, Net } from "./net";
import { Stage } from "./stage";
import { Headline, TotalsTable } from "./totals";
import { Transport } from "./transport";
import { inkOfTarget } from "./paint";
import { nameOf } from "./words";

export function App({ state }: { state: State }) {
  const { about } = state.run;
  const ended = about.ended;
  return (
    <>
      <header class="top">
        <div>
          <h1>
            {about.name || about.graph}
            {state.live === null && !ended?.complete && <span class="partial"> partial run</span>}
            {about.smoothed === true && <span class="smoothed"> smoothed</span>}
          </h1>
          <p>
            {about.name && about.name !== about.graph && `${about.graph} `}on <span class="source">{about.source}</span> · {hasCameras(state) ? `${state.run.cameras.length} cameras` : `${about.width} × ${about.height} px`} · seed {about.seed}
            {ended === null && state.live === null && " · the run has no end: it was stopped, or goes on"}
            {ended !== null && state.live === null && !ended.complete && ` · ended early: ${ended.reason.replaceAll("_", " ")}`}
          </p>
          {state.run.thinned !== null && <p class="thinned">{thinnedText(state.run.thinned)}</p>}
          {about.smoothed === true && (
            <p>
              Boxes, regions, UD and hypotheses are given the whole sequence. Status, score and all that is said of agents are the
              tracker's, given the frames before.
            </p>
          )}
        </div>
        <Headline state={state} />
      </header>
      {state.live !== null && <LiveBar state={state} live={state.live} />}
      {state.count.value === 0 ? (
        <p class="nothing">No target was tracked in this run.</p>
      ) : (
        <main>
          <Targets state={state} />
          <div class="desk">
            <div class="left">
              {hasCameras(state) ? <Cameras state={state} /> : <Stage state={state} />}
              <Transport state={state} />
            </div>
            <div class="right">
              <Moment state={state} />
              <Net state={state} />
              <Agents state={state} />
            </div>
          </div>
          <Charts state={state} />
          <div class="foot">
            <Events state={state} />
            <TotalsTable state={state} />
          </div>
        </main>
      )}
      <footer>
        bayesnet_track · graph {about.graph_sha256.slice(0, 12)} ·{" "}
        {Object.entries(about.versions).map(([name, version]) => `${name} ${version}`).join(", ")}
      </footer>
      {state.help.value && <Help state={state} />}
    </>
  );
}

/** Of a run in progress the page knows the first camera alone. */
function hasCameras(state: State): boolean {
  return state.run.cameras.length > 0 && state.live === null;
}

/** What the page of a long run holds, and what it leaves out. */
function thinnedText({ step, rows, of, frames, decisions }: Thinned): string {
  const [held, all, count] = [rows, of, frames].map((n) => n.toLocaleString("en"));
  return (
    `This page holds ${held} of ${all} measurements, of ${count} frames: one frame in ${step}, and between two of them each ` +
    `target's frame with the largest UD and ${decisions === 1 ? "those" : `one in ${decisions} of those`} with a decision. ` +
    "Other frames show the measurement before. Counts of frames are of all frames; `export` writes every measurement."
  );
}

function Targets({ state }: { state: State }) {
  void state.version.value;
  const tracks = [...state.run.tracks.values()];
  if (tracks.length < 2) return null;
  if (tracks.length > 30) {
    return (
      <label class="targets">
        Target{" "}
        <select value={state.target.value} onChange={(e) => (state.target.value = e.currentTarget.value)}>
          {tracks.map((track) => (
            <option key={track.id} value={track.id}>
              {nameOf(track)}
            </option>
          ))}
        </select>
      </label>
    );
  }
  return (
    <nav class="targets" aria-label="Targets">
      {tracks.map((track) => {
        const row = track.rowOf(state.frame.value);
        const status = row < 0 ? "not-there" : track.status(row);
        return (
          <button
            key={track.id}
            type="button"
            aria-pressed={track.id === state.target.value}
            title={`${nameOf(track)}: ${status.replace("-", " ")}`}
            onClick={() => (state.target.value = track.id)}
          >
            <i class={`dot ${status}`} aria-hidden="true" />
            {hasCameras(state) && <i class="swatch" style={{ background: inkOfTarget(track) }} aria-hidden="true" />}
            {track.plate && <small>{track.plate} </small>}
            {track.id}
          </button>
        );
      })}
    </nav>
  );
}

function Help({ state }: { state: State }) {
  return (
    <div class="veil" onClick={() => (state.help.value = false)}>
      <div
        class="help"
        role="dialog"
        aria-modal="true"
        aria-label="Help"
        onClick={(event) => event.stopPropagation()}
      >
        <h2>Keys</h2>
        <dl>
          {[...(state.live === null ? [] : LIVE_KEYS), ...KEYS.slice(state.live === null ? 0 : 1)].map(([key, what]) => (
            <div key={key}>
              <dt>{key.split(" ").map((one) => <kbd key={one}>{one}</kbd>)}</dt>
              <dd>{what}</dd>
            </div>
          ))}
        </dl>
        <h2>On the frame</h2>
        <p>
          The box is the estimate: a solid line while it is tracked, dashed while uncertain, dotted while lost. Dots are
          hypotheses drawn from the belief; the two rounded frames hold its centre with 50&nbsp;% and 90&nbsp;%; the cross is the
          most probable centre.
        </p>
        {hasCameras(state) && (
          <p>
            Of several cameras each shows the targets' boxes in its image; press its name to enlarge it. On the ground, in metres,
            ellipses hold a target with 90&nbsp;%, and a trail shows its last three seconds.
          </p>
        )}
        <h2>On the timelines</h2>
        <p>
          ▲ an agent was switched on, ▼ off, ◆ the status changed{hasCameras(state) && ", ■ a camera was knocked or its clock learnt"}. Click one to see why. Shaded: the target was lost or
          uncertain.
        </p>
        <button type="button" autofocus ref={(button) => button?.focus()} onClick={() => (state.help.value = false)}>
          Close
        </button>
      </div>
    </div>
  );
}
