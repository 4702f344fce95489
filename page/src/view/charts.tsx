/** The timelines: one plot below the other over the same frames, moved through by clicking and dragging. */

import { type ReadonlySignal, useComputed, useSignalEffect } from "@preact/signals";
import { useRef } from "preact/hooks";
import uPlot from "uplot";
import type { EventRow } from "../data/types";
import type { State } from "../state";
import { Icon } from "./transport";
import { framesOf, panelsOf } from "./panels";
import type { Panel } from "./series";
import { lanes, marks, people, shade, stack, stems } from "./plot_ink";
import { colour } from "./theme";
import { nameOf, short } from "./words";

const NEAR = 7;

export function Charts({ state }: { state: State }) {
  const track = state.track.value;
  const panels = useComputed(() => {
    void [state.settled.value, state.look.value];
    return state.track.value === undefined ? [] : panelsOf(state.run, state.track.value);
  });
  if (track === undefined) return null;
  const [from, to] = state.stretch.value;
  return (
    <section class="charts" aria-label="Timelines">
      <header>
        <h2>Over time{state.run.tracks.size > 1 ? `, ${nameOf(track)}` : ""}</h2>
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
    // While it is made anew, what lies below stays where it is.
    host.style.minHeight = `${made.height}px`;
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
    void state.node.value;
    if (panel.lanes !== undefined) plot.current?.redraw(false);
  });

  useSignalEffect(() => {
    const frame = state.frame.value;
    if (plot.current !== null && head.current !== null) put(plot.current, head.current, frame);
  });

  const node = state.node.value;
  const isChosen = node !== null && panel.key === bandOf(state, node);
  return (
    <figure class={`plot plot-${panel.key}${isChosen ? " chosen" : ""}`}>
      <figcaption>
        <b title={panel.about}>{panel.name}</b>
        <small>{panel.unit}</small>
        <Readout state={state} panel={panel} />
      </figcaption>
      <div ref={place} class="canvas" role="img" aria-label={`${panel.name}: ${panel.about}`} />
    </figure>
  );
}

/** The plot with the band of a node: an agent's, or the uncertainty of the root. */
function bandOf(state: State, name: string): string | null {
  const plate = state.run.plates[state.track.value?.plate ?? ""];
  const node = plate?.net.nodes.find((one) => one.name === name);
  return node?.agent ? "agents" : name === plate?.root ? "ud" : null;
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
        show: panel.stacked !== true,
        stroke: line.colour,
        width: line.width,
        ...(line.dash ? { dash: line.dash } : {}),
        ...(line.steps ? { paths: uPlot.paths.stepped!({ align: 1 }) } : {}),
        points: { show: false },
      })),
    ],
    ...(panel.band ? { bands: [{ series: [panel.band[0] + 1, panel.band[1] + 1], fill: colour("wash") }] } : {}),
    hooks: {
      drawClear: [(u) => panel.targets ?? shade(u, state)],
      draw: [
        (u) => {
          if (panel.targets !== undefined) people(u, panel.targets, state);
          if (panel.stacked === true) stack(u, panel, frames);
          if (panel.lanes !== undefined) lanes(u, panel, frames, state.run.thinned?.step ?? 1, state.node.peek());
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
