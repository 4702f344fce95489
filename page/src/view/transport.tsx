/** Playing, stepping, and the scrubber with the run's status and events on it. */

import { useSignalEffect } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import type { State } from "../state";
import { colour, statusColour } from "./theme";

const SPEEDS = [0.25, 0.5, 1, 2, 4, 8];

export function Transport({ state }: { state: State }) {
  const { run } = state;
  const track = state.track.value;
  const row = state.row.value;
  void state.version.value;
  const status = track !== undefined && row >= 0 ? track.status(row) : "not there";
  useEffect(() => play(state), [state]);
  return (
    <section class="transport" aria-label="Time">
      <div class="buttons">
        <button type="button" onClick={() => state.stop(-1)} aria-label="Previous event" title="previous event (p)">
          <Icon d="M5 4v12M16 4 8 10l8 6z" />
        </button>
        <button
          type="button"
          class="play"
          disabled={state.live?.isOn.value && state.following.value}
          onClick={() => (state.playing.value = !state.playing.value)}
          aria-label={state.playing.value ? "Pause" : "Play"}
          title={state.live?.isOn.value && state.following.value ? "plays what was, once you look back" : "play or pause (space)"}
        >
          <Icon d={state.playing.value ? "M6 4h3v12H6zM11 4h3v12h-3z" : "M6 3.5 16 10 6 16.5z"} />
        </button>
        <button type="button" onClick={() => state.stop(1)} aria-label="Next event" title="next event (n)">
          <Icon d="M15 4v12M4 4l8 6-8 6z" />
        </button>
        <label class="speed" title="speed">
          <span class="hidden">Speed</span>
          <select
            value={String(state.speed.value)}
            onChange={(e) => (state.speed.value = Number(e.currentTarget.value))}
          >
            {SPEEDS.map((speed) => (
              <option key={speed} value={String(speed)}>
                {speed}×
              </option>
            ))}
          </select>
        </label>
        <output class="now">
          frame <b>{state.frame.value}</b> <small>of {run.last}</small>
        </output>
        <button
          type="button"
          class="ask"
          onClick={() => (state.help.value = true)}
          aria-label="Help: keyboard and colours"
          title="help (?)"
        >
          ?
        </button>
      </div>
      <div class="scrubber">
        <Ribbon state={state} />
        <input
          type="range"
          min={run.first}
          max={run.last}
          step={1}
          value={state.frame.value}
          aria-label="Frame"
          aria-valuetext={`frame ${state.frame.value} of ${run.last}, ${status}`}
          onInput={(e) => {
            state.playing.value = false;
            state.go(Number(e.currentTarget.value));
          }}
        />
      </div>
    </section>
  );
}

export function Icon({ d }: { d: string }) {
  return (
    <svg viewBox="0 0 20 20" width="18" height="18" aria-hidden="true">
      <path d={d} fill="currentColor" stroke="currentColor" stroke-width="1.5" stroke-linejoin="round" />
    </svg>
  );
}

/** The whole run as a strip: status as colour and height, a tick per event. */
function Ribbon({ state }: { state: State }) {
  const canvas = useRef<HTMLCanvasElement>(null);
  useSignalEffect(() => {
    void [state.look.value, state.version.value];
    const [track, events] = [state.track.value, state.stops.value];
    const strip = canvas.current;
    if (strip === null || track === undefined) return;
    const ratio = window.devicePixelRatio || 1;
    const [w, h] = [strip.clientWidth, strip.clientHeight];
    [strip.width, strip.height] = [Math.round(w * ratio), Math.round(h * ratio)];
    const g = strip.getContext("2d")!;
    g.scale(ratio, ratio);
    const { first, last } = state.run;
    // The range's thumb is 16 px wide and stays inside.
    const x = (frame: number) => 8 + ((frame - first) / Math.max(1, last - first)) * (w - 16);
    const middle = h / 2;
    g.fillStyle = colour("line");
    g.fillRect(8, middle - 1, w - 16, 2);
    const half = Math.max(0.5, (w - 16) / Math.max(1, last - first) / 2);
    for (let row = 0, from = 0; row < track.length; row += 1) {
      const status = track.status(row);
      const ends = row + 1 === track.length || track.status(row + 1) !== status || track.value("frame", row + 1) > track.value("frame", row) + 1;
      if (!ends) continue;
      const tall = status === "lost" || status === "hidden" ? 14 : status === "uncertain" ? 10 : 6;
      g.fillStyle = statusColour(track, status);
      const left = x(track.value("frame", from)) - half;
      g.fillRect(left, middle - tall / 2, x(track.value("frame", row)) + half - left, tall);
      from = row + 1;
    }
    for (const event of events) {
      const at = x(event.frame);
      g.fillStyle = colour(event.sort === "switch" ? (event.on ? "on" : "off") : event.sort === "camera" ? "camera" : "ink");
      if (event.sort === "switch") {
        const up = event.on === true;
        g.beginPath();
        g.moveTo(at - 3.5, up ? 7 : h - 7);
        g.lineTo(at + 3.5, up ? 7 : h - 7);
        g.lineTo(at, up ? 1 : h - 1);
        g.fill();
      } else {
        const wide = event.sort === "camera" ? 5 : 1.5;
        g.fillRect(at - wide / 2, 2, wide, 6);
      }
    }
  });
  return <canvas ref={canvas} class="ribbon" aria-hidden="true" />;
}

/** Moves the frame on while playing; gives what stops it. */
function play(state: State): () => void {
  let [from, asked, running] = [0, 0, true];
  let carried = 0;
  const tick = (now: number) => {
    if (!running) return;
    const passed = Math.min(now - from, 250);
    from = now;
    if (state.playing.peek()) {
      carried += (passed * state.speed.peek()) / (1000 * (state.run.about.frame_interval_s || 0.04));
      const whole = Math.floor(carried);
      carried -= whole;
      if (whole > 0) {
        state.go(state.frame.peek() + whole);
        if (state.frame.peek() >= state.run.last) state.playing.value = false;
      }
      asked = requestAnimationFrame(tick);
    }
  };
  const stop = state.playing.subscribe((on) => {
    if (!on) return;
    if (state.frame.peek() >= state.run.last) state.go(state.run.first);
    [from, carried] = [performance.now(), 0];
    asked = requestAnimationFrame(tick);
  });
  return () => {
    running = false;
    cancelAnimationFrame(asked);
    stop();
  };
}
