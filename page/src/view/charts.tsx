/** The timelines: one plot below the other over the same frames, moved through by clicking and dragging. */

import { type ReadonlySignal, useComputed, useSignalEffect } from "@preact/signals";
import { useRef } from "preact/hooks";
import uPlot from "uplot";
import type { EventRow } from "../data/types";
import type { State } from "../state";
import { Icon } from "./transport";
import { framesOf, panelsOf, type Panel } from "./panels";
import { colour, statusColour } from "./theme";
import { short } from "./words";

const NEAR = 7;

export function Charts({ state }: { state: State }) {
  const track = state.track.value;
  const panels = useComputed(() => {
    void [state.version.value, state.look.value];
    return state.track.value === undefined ? [] : panelsOf(state.run, state.track.value);
  });
  if (track === undefined) return null;
  const [from, to] = state.stretch.value;
  return (
    <section class="charts" aria-label="Timelines">
      <header>
        <h2>Over time{state.run.tracks.size > 1 ? `, target ${track.id}` : ""}</h2>
        <div class="zoom">
          <span>
            frames {from}–{to}
          </span>
          <button type="button" onClick={() => state.zoom(0.5)} aria-label="Shorter stretch" title="shorter stretch (+)">
            <Icon d="M4 10h12M10 4v12" />
          </button>
          <button type="button" onClick={() => state.zoom(2)} aria-label="Longer stretch" title="longer stretch (-)">
            <Icon d="M4 10h12" />
          </button>
          <button type="button" onClick={() => state.zoom(Infinity)} title="the whole run (0)">
            all
          </button>
        </div>
      </header>
      {panels.value.map((panel, index, all) => (
        <Plot
          key={panel.key}
          state={state}
          panel={panel}
          panels={panels}
          hasAxis={index === 0 || index === all.length - 1}
        />
      ))}
    </section>
  );
}

interface PlotProps {
  state: State;
  panel: Panel;
  panels: ReadonlySignal<Panel[]>;
  hasAxis: boolean;
}

function Plot({ state, panel, panels, hasAxis }: PlotProps) {
  const place = useRef<HTMLDivElement>(null);
  const plot = useRef<uPlot | null>(null);
  const head = useRef<HTMLDivElement | null>(null);

  // Made anew when what it shows changes.
  useSignalEffect(() => {
    const latest = panels.value.find((one) => one.key === panel.key);
    const [host, track] = [place.current, state.track.peek()];
    if (host === null || track === undefined || latest === undefined) return;
    const playhead = document.createElement("div");
    playhead.className = "playhead";
    // A plot knows where a frame is only once it is drawn.
    const made = draw(host, state, latest, framesOf(track), hasAxis, (u) => put(u, playhead, state.frame.peek()));
    made.over.append(playhead);
    [plot.current, head.current] = [made, playhead];
    return () => {
      plot.current = null;
      made.destroy();
    };
  });

  useSignalEffect(() => {
    const [from, to] = state.stretch.value;
    plot.current?.setScale("x", { min: from - 0.5, max: to + 0.5 });
  });

  useSignalEffect(() => {
    const frame = state.frame.value;
    if (plot.current !== null && head.current !== null) put(plot.current, head.current, frame);
  });

  return (
    <figure class={`plot plot-${panel.key}`}>
      <figcaption>
        <b title={panel.about}>{panel.name}</b>
        <small>{panel.unit}</small>
        <Readout state={state} panel={panel} />
      </figcaption>
      <div ref={place} class="canvas" role="img" aria-label={`${panel.name}: ${panel.about}`} />
    </figure>
  );
}

function put(plot: uPlot, playhead: HTMLElement, frame: number): void {
  playhead.style.transform = `translateX(${plot.valToPos(frame, "x")}px)`;
}

/** The legend, with the values at the frame. */
function Readout({ state, panel }: { state: State; panel: Panel }) {
  const row = state.row.value;
  return (
    <span class="readout">
      {panel.lines.map((line) => (
        <span key={line.name} title={line.title}>
          <svg width="18" height="8" aria-hidden="true">
            <line
              x1="0"
              y1="4"
              x2="18"
              y2="4"
              stroke={line.colour}
              stroke-width={line.width + 0.4}
              stroke-dasharray={line.dash?.join(" ")}
            />
          </svg>
          {line.name} <output>{short(line.values[row] ?? NaN)}</output>
        </span>
      ))}
    </span>
  );
}

function draw(
  host: HTMLElement,
  state: State,
  panel: Panel,
  frames: number[],
  hasAxis: boolean,
  drawn: (plot: uPlot) => void,
): uPlot {
  const wide = host.clientWidth;
  const gutter = wide < 560 ? 46 : 96;
  const [ink, grid] = [colour("soft"), colour("line")];
  const font = "11px system-ui, sans-serif";
  const [from, to] = state.stretch.peek();
  const axis = { stroke: ink, font, grid: { stroke: grid, width: 1 }, ticks: { show: false } };
  const events = state.events.peek();
  const hasScale = panel.lanes === undefined && panel.targets === undefined;
  const options: uPlot.Options = {
    width: wide,
    height: panel.height + (hasAxis ? 22 : 0),
    legend: { show: false },
    padding: [6, 10, hasAxis ? 0 : 6, 0],
    cursor: { y: false, drag: { x: false, y: false }, points: { show: false }, sync: { key: "run", scales: ["x", null] } },
    scales: {
      x: { time: false, min: from - 0.5, max: to + 0.5, auto: false },
      y: { distr: panel.log ? 3 : 1, auto: false, min: panel.range[0], max: panel.range[1] },
    },
    axes: [
      { ...axis, show: hasAxis, size: 22, space: 60, values: (_, marks) => marks.map((v) => (Number.isInteger(v) ? String(v) : "")) },
      {
        ...axis,
        show: hasScale,
        size: gutter,
        space: panel.log ? 26 : 24,
        values: (_, marks) => marks.map((v) => (v === null ? "" : short(v))),
        ...(panel.log ? { splits: () => decades(panel.range[0], panel.range[1]) } : {}),
      },
    ],
    series: [
      {},
      ...panel.lines.map((line) => ({
        stroke: line.colour,
        width: line.width,
        ...(line.dash ? { dash: line.dash } : {}),
        ...(line.steps ? { paths: uPlot.paths.stepped!({ align: 1 }) } : {}),
        points: { show: false },
      })),
    ],
    hooks: {
      drawClear: [(u) => panel.targets ?? shade(u, state)],
      draw: [
        (u) => {
          if (panel.targets !== undefined) people(u, panel.targets, state);
          if (panel.lanes !== undefined) lanes(u, panel, frames);
          if (panel.key === "ud") marks(u, panel, frames, events);
          if (panel.key === "agents") stems(u, events);
          drawn(u);
        },
      ],
    },
  };
  if (!hasScale) options.padding = [2, 10, 2, gutter];
  const plot = new uPlot(options, [frames, ...panel.lines.map((line) => line.values)] as uPlot.AlignedData, host);
  scrub(plot, state, events, panel);
  return plot;
}

/** 1, 2, 5 times powers of ten, or powers of ten alone where those would be too many. */
function decades(low: number, high: number): number[] {
  const steps = Math.log10(high / low) > 2.6 ? [1] : [1, 2, 5];
  const found: number[] = [];
  for (let e = Math.floor(Math.log10(low)); e <= Math.log10(high); e += 1) {
    found.push(...steps.map((step) => step * 10 ** e).filter((mark) => mark >= low && mark <= high));
  }
  return found;
}

/** Frames in which the target was lost or uncertain, behind everything. */
function shade(u: uPlot, state: State): void {
  const track = state.track.peek();
  if (track === undefined) return;
  const { left, top, width, height } = u.bbox;
  const g = u.ctx;
  g.save();
  g.beginPath();
  g.rect(left, top, width, height);
  g.clip();
  for (let row = 0, from = 0; row < track.length; row += 1) {
    const status = track.status(row);
    if (row + 1 < track.length && track.status(row + 1) === status) continue;
    if (status !== "tracking") {
      const x = u.valToPos(track.value("frame", from) - 0.5, "x", true);
      const end = u.valToPos(track.value("frame", row) + 0.5, "x", true);
      g.fillStyle = colour(status === "lost" ? "lost-veil" : "uncertain-veil");
      g.fillRect(x, top, end - x, height);
    }
    from = row + 1;
  }
  g.restore();
}

function lanes(u: uPlot, panel: Panel, frames: number[]): void {
  const g = u.ctx;
  const ratio = uPlot.pxRatio;
  const { left, top, width, height } = u.bbox;
  const tall = height / Math.max(1, panel.lanes!.length);
  const narrow = width / ratio < 480;
  const [ink, ground] = [colour("ink"), colour("lane")];
  g.save();
  panel.lanes!.forEach((lane, index) => {
    const y = top + index * tall + 3 * ratio;
    const h = tall - 6 * ratio;
    g.fillStyle = ground;
    g.fillRect(left, y, width, h);
    g.save();
    g.beginPath();
    g.rect(left, y, width, h);
    g.clip();
    const x = (frame: number) => u.valToPos(frame, "x", true);
    for (let k = 0, from = 0; k < frames.length; k += 1) {
      if (k + 1 < frames.length && lane.on[k + 1] === lane.on[k] && frames[k + 1] === frames[k]! + 1) continue;
      if (lane.on[k]) {
        const [a, b] = [x(frames[from]! - 0.5), x(frames[k]! + 0.5)];
        g.fillStyle = lane.colour;
        g.globalAlpha = 0.3;
        g.fillRect(a, y, b - a, h);
        g.globalAlpha = 0.95;
        g.beginPath();
        g.moveTo(a, y + h);
        for (let j = from; j <= k; j += 1) {
          const share = Math.min(1, Math.max(0, (lane.kl[j] || 0) / panel.range[1]));
          g.lineTo(x(frames[j]! - 0.5), y + h - share * h);
          g.lineTo(x(frames[j]! + 0.5), y + h - share * h);
        }
        g.lineTo(b, y + h);
        g.fill();
        g.fillRect(a, y + h - 1.5 * ratio, b - a, 1.5 * ratio);
        g.globalAlpha = 1;
      }
      from = k + 1;
    }
    g.restore();
    g.font = `600 ${11.5 * ratio}px system-ui, sans-serif`;
    g.fillStyle = ink;
    g.textBaseline = "middle";
    g.textAlign = narrow ? "left" : "right";
    if (narrow) {
      g.lineWidth = 3 * ratio;
      g.strokeStyle = colour("paper");
      g.strokeText(lane.agent, left + 4 * ratio, y + h / 2);
    }
    const room = narrow ? width : left - 12 * ratio;
    g.fillText(cut(g, lane.agent, room), narrow ? left + 4 * ratio : left - 8 * ratio, y + h / 2);
  });
  g.restore();
}

function cut(g: CanvasRenderingContext2D, text: string, room: number): string {
  let kept = text;
  while (kept.length > 1 && g.measureText(kept === text ? text : `${kept}…`).width > room) kept = kept.slice(0, -1);
  return kept === text ? text : `${kept}…`;
}

/** Every target's status over time. */
function people(u: uPlot, targets: NonNullable<Panel["targets"]>, state: State): void {
  const g = u.ctx;
  const ratio = uPlot.pxRatio;
  const { left, top, width, height } = u.bbox;
  const tall = height / targets.length;
  g.save();
  g.textBaseline = "middle";
  g.textAlign = "right";
  targets.forEach(({ track, chosen }, index) => {
    const middle = top + (index + 0.5) * tall;
    g.font = `${chosen ? 700 : 450} ${Math.min(11.5, (tall / ratio) * 0.95) * ratio}px system-ui, sans-serif`;
    g.fillStyle = colour(chosen ? "ink" : "soft");
    g.fillText(cut(g, track.id, left - 12 * ratio), left - 8 * ratio, middle);
    g.save();
    g.beginPath();
    g.rect(left, top, width, height);
    g.clip();
    const x = (frame: number) => u.valToPos(frame, "x", true);
    for (let row = 0, from = 0; row < track.length; row += 1) {
      const status = track.status(row);
      const lasts = row + 1 < track.length && track.value("frame", row + 1) === track.value("frame", row) + 1;
      if (lasts && track.status(row + 1) === status) continue;
      const [a, b] = [x(track.value("frame", from) - 0.5), x(track.value("frame", row) + 0.5)];
      const high = tall * (status === "lost" ? 0.9 : status === "uncertain" ? 0.7 : chosen ? 0.45 : 0.25);
      g.fillStyle = statusColour(status);
      g.fillRect(a, middle - high / 2, Math.max(b - a, ratio), high);
      from = row + 1;
    }
    for (const event of state.run.events) {
      if (event.sort !== "switch" || event.target !== track.id) continue;
      g.fillStyle = colour(event.on ? "on" : "off");
      g.fillRect(x(event.frame) - ratio, middle - tall * 0.38, 2 * ratio, tall * 0.76);
    }
    g.restore();
  });
  g.restore();
}

/** A triangle on the curve per switch (up: on, down: off), a diamond per change of status. */
function marks(u: uPlot, panel: Panel, frames: number[], events: EventRow[]): void {
  const g = u.ctx;
  const ratio = uPlot.pxRatio;
  const { left, top, width, height } = u.bbox;
  const rows = new Map(frames.map((frame, row) => [frame, row]));
  for (const event of events) {
    if (event.sort === "note") continue;
    const x = u.valToPos(event.frame, "x", true);
    if (x < left - 1 || x > left + width + 1) continue;
    const value = panel.lines[0]!.values[rows.get(event.frame) ?? -1] ?? panel.range[0];
    const y = Math.min(u.valToPos(value, "y", true), top + height - 6 * ratio);
    const ink = event.sort === "switch" ? (event.on ? "on" : "off") : event.status === "lost" ? "lost" : "ink";
    g.fillStyle = g.strokeStyle = colour(ink);
    g.lineWidth = ratio;
    g.globalAlpha = 0.35;
    g.beginPath();
    g.moveTo(x, y);
    g.lineTo(x, top + height);
    g.stroke();
    g.globalAlpha = 1;
    const s = 5 * ratio;
    g.beginPath();
    if (event.sort !== "switch") {
      g.moveTo(x, y - s);
      g.lineTo(x + s, y);
      g.lineTo(x, y + s);
      g.lineTo(x - s, y);
    } else {
      const up = event.on ? -1 : 1;
      g.moveTo(x - s, y);
      g.lineTo(x + s, y);
      g.lineTo(x, y + up * 1.7 * s);
    }
    g.closePath();
    g.fill();
    g.strokeStyle = colour("paper");
    g.lineWidth = 0.8 * ratio;
    g.stroke();
  }
}

function stems(u: uPlot, events: EventRow[]): void {
  const { left, top, width, height } = u.bbox;
  u.ctx.lineWidth = uPlot.pxRatio;
  for (const event of events) {
    const x = u.valToPos(event.frame, "x", true);
    if (event.sort !== "switch" || x < left || x > left + width) continue;
    u.ctx.strokeStyle = colour(event.on ? "on" : "off");
    u.ctx.globalAlpha = 0.4;
    u.ctx.beginPath();
    u.ctx.moveTo(x, top);
    u.ctx.lineTo(x, top + height);
    u.ctx.stroke();
    u.ctx.globalAlpha = 1;
  }
}

/** Click and drag set the frame; a click close to an event takes its frame. */
function scrub(plot: uPlot, state: State, events: EventRow[], panel: Panel): void {
  const over = plot.over;
  const snaps = panel.key === "ud" || panel.key === "agents";
  const at = (event: PointerEvent) => {
    const x = event.clientX - over.getBoundingClientRect().left;
    const close = events.filter((one) => one.sort !== "note" && Math.abs(plot.valToPos(one.frame, "x") - x) < NEAR);
    const first = close.sort((a, b) => Math.abs(plot.valToPos(a.frame, "x") - x) - Math.abs(plot.valToPos(b.frame, "x") - x))[0];
    if (snaps && event.type === "pointerdown" && first !== undefined) state.show(first);
    else state.go(plot.posToVal(x, "x"));
  };
  over.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    state.playing.value = false;
    over.setPointerCapture(event.pointerId);
    if (panel.targets !== undefined) {
      const { top, height } = over.getBoundingClientRect();
      const index = Math.floor(((event.clientY - top) / height) * panel.targets.length);
      state.target.value = panel.targets[index]?.track.id ?? state.target.value;
    }
    at(event);
  });
  over.addEventListener("pointermove", (event) => {
    if (over.hasPointerCapture(event.pointerId)) at(event);
  });
}
