/** Panels of what the graph's queries ask: probabilities together, each number with its interval. */

import type { RunData, Track } from "../data/run";
import type { Query } from "../data/types";
import { column, known, type Line, type Panel } from "./series";
import { AGENTS, agentColour, colour } from "./theme";
import { short } from "./words";

const BOUNDS = ["_low", "_high", "_sd"];
const MOST_LINES = AGENTS;

/** The panels of a target: none where nothing was asked of it. */
export function answers(run: RunData, track: Track): Panel[] {
  const panels: Panel[] = [];
  const chances: Line[] = [];
  for (const [name, query] of Object.entries(run.queries)) {
    const columns = track.queries.filter((one) => one === name || one.startsWith(`${name}/`));
    if (query.kind === "value") panels.push(...columns.map((one) => number(track, one, one.slice(name.length), query)));
    else chances.push(...columns.map((one) => chance(track, one, query, chances.length)));
    if (track.queries.includes(`${name}_count`)) panels.push(number(track, `${name}_count`, "", query));
  }
  return chances.length > 0 ? [probabilities(run, chances), ...panels] : panels;
}

function chance(track: Track, name: string, query: Query, place: number): Line {
  const title = `${query.of.join(", ")}: ${query.asks}`;
  return { name, title, colour: agentColour(place), width: 1.8, values: column(track, `queries/${name}`) };
}

function probabilities(run: RunData, lines: Line[]): Panel {
  const drawn = lines.slice(0, MOST_LINES);
  const more = lines.length > drawn.length ? `, the first ${drawn.length} of ${lines.length}` : "";
  const levels = new Map(Object.entries(run.queries).flatMap(([name, query]) => (query.level === null ? [] : [[query.level, name]])));
  const marks = [...levels].map(([level, name]) => ({
    name: `${name} ≥ ${short(level)}`,
    title: "level at which an event is written",
    colour: colour("on"),
    width: 1.3,
    dash: [7, 4],
    values: drawn[0]!.values.map(() => level),
  }));
  const about = "Answers of the belief to conditions of the graph's queries.";
  const all = [...drawn, ...marks];
  return { key: "queries", name: "Asked", unit: `probability${more}`, about, height: 100, lines: all, range: [0, 1.04] };
}

/** Mean and interval; `second` is the other target of a pair, as `/ID`. */
function number(track: Track, name: string, second: string, query: Query): Panel {
  const base = name.slice(0, name.length - second.length);
  const [low, high] = BOUNDS.map((end) => column(track, `queries/${base}${end}${second}`)) as [Line["values"], Line["values"]];
  const counts = query.kind !== "value";
  const mean: Line = { name: counts ? "number" : "mean", colour: colour("ud"), width: 1.8, steps: counts, values: column(track, `queries/${name}`) };
  const edge = { colour: colour("soft"), width: 0.8, dash: [2, 3], steps: counts };
  // The mean is the last to be drawn, over the band.
  const lines: Line[] = [{ ...edge, name: "low", values: low }, { ...edge, name: "high", values: high }, mean];
  const found = known(lines.flatMap((line) => line.values));
  const [least, most] = found.reduce(([a, b], v) => [Math.min(a, v), Math.max(b, v)], [Infinity, -Infinity]);
  const room = Math.max((most - least) * 0.06, 1e-9 + Math.abs(most) * 0.01);
  const range: [number, number] = found.length > 0 ? [counts ? 0 : least - room, most + room] : [0, 1];
  const percent = `${short(100 * query.interval)} %`;
  const about = `${query.asks}; the band holds ${percent} of the belief.${counts ? " All targets together." : ""}`;
  const unit = [query.unit || (counts ? "targets" : ""), `with ${percent} interval`].filter((word) => word !== "").join(", ");
  return { key: `query-${base.replaceAll(/[^\w-]/g, "_")}`, name, unit, about, height: 90, lines, range, band: [1, 0] };
}
