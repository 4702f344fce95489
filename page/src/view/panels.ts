/** What the timelines show of one target: panels of lines over frames. */

import type { RunData, Track } from "../data/run";
import { agentsOf } from "../data/totals";
import type { Rule } from "../data/types";
import { answers } from "./answers";
import { column, finite, greatest, known, rows, type Line, type Panel } from "./series";
import { AGENTS, agentColour, colour } from "./theme";
import { RULES, UNITS, short } from "./words";

export function framesOf(track: Track): number[] {
  return Array.from({ length: track.length }, (_, row) => track.value("frame", row));
}

export function panelsOf(run: RunData, track: Track): Panel[] {
  const shares = track.modes.length > 0 ? [modes(run, track)] : [];
  const panels = [uncertainty(run, track), ...shares, ...answers(run, track), lanes(run, track), belief(run, track), evidence(track), sample(track)];
  const clock = times(run, track);
  if (clock !== null) panels.push(clock);
  return run.tracks.size > 1 ? [everyone(run, track), ...panels] : panels;
}

const MOST_TARGETS = 60;

/** Those that are drawn of many, in their order: the chosen one, and those that live longest. */
export function drawnOf(all: Track[], chosen: Track, most: number): Track[] {
  if (all.length <= most) return all;
  const others = all.filter((one) => one !== chosen).sort((a, b) => b.length - a.length);
  const drawn = new Set([chosen, ...others.slice(0, most - 1)]);
  return all.filter((one) => drawn.has(one));
}

function everyone(run: RunData, track: Track): Panel {
  const all = drawnOf([...run.tracks.values()], track, MOST_TARGETS);
  const some = all.length < run.tracks.size ? `; the ${all.length} longest of ${run.tracks.size}` : "";
  const about = "A row per target, from its first to its last frame. Tall and red: lost; amber: uncertain. Click one to choose it.";
  const targets = all.map((one) => ({ track: one, chosen: one === track }));
  const height = 8 + all.length * (all.length > 16 ? 9 : 14);
  return { key: "targets", name: "All targets", unit: `status, and switches of agents${some}`, about, height, lines: [], range: [0, 1], targets };
}

/** A level in the unit of UD, frame by frame. */
export function levelAt(track: Track, rule: Rule, row: number): number {
  if (rule.unit === "ud_box") return rule.level * track.value("box", row, 2) * track.value("box", row, 3);
  return rule.unit === "ud_baseline" ? rule.level * track.value("quiet_px2", row) : rule.level;
}

const LEVELS: Record<string, { ink: string; dash: number[] }> = {
  activate: { ink: "on", dash: [7, 4] },
  deactivate: { ink: "off", dash: [7, 4] },
  on_call: { ink: "on", dash: [7, 4] },
  learn: { ink: "soft", dash: [2, 3] },
  lost: { ink: "lost", dash: [2, 4] },
};

function uncertainty(run: RunData, track: Track): Panel {
  const plate = run.plates[track.plate];
  const lines: Line[] = [
    { name: "UD", title: "uncertainty of the root", colour: colour("ud"), width: 2, values: column(track, "ud_px2") },
  ];
  for (const node of track.nodes.filter((name) => name !== plate?.root && !(plate?.ud_unit === "m²" && plate.views?.includes(name))).slice(0, 4)) {
    lines.push({ name: `UD ${node}`, colour: colour("soft"), width: 1, values: column(track, `nodes/${node}/ud_px2`) });
  }
  for (const rule of plate?.rules ?? []) {
    const look = LEVELS[rule.rule];
    if (look === undefined || rule.unit === "score") continue;
    const values = rows(track).map((row) => finite(levelAt(track, rule, row)));
    const name = `${rule.node === plate?.root ? "" : `${rule.node}: `}${RULES[rule.rule]}`;
    const title = `${rule.rule} ${short(rule.level)}${UNITS[rule.unit] ?? ` ${run.udUnit(track)}`}, ${rule.frames} frame${rule.frames === 1 ? "" : "s"}`;
    lines.push({ name, title, colour: colour(look.ink), width: 1.4, dash: look.dash, values });
  }
  const quiet = column(track, "quiet_px2");
  if (quiet.some((value) => value !== null)) {
    lines.push({ name: "baseline", title: "measured where nothing is wrong", colour: colour("quiet"), width: 1.2, dash: [2, 3], values: quiet });
  }
  const sorted = lines[0]!.values.filter((v): v is number => v !== null && v > 1e-6).sort((a, b) => a - b);
  // The first frames start from certainty: a few of them must not stretch the scale. Levels beyond it are cut.
  const low = (sorted[Math.min(Math.floor(sorted.length / 50) + 1, sorted.length - 1)] ?? 1) / 1.6;
  let high = Math.max((sorted.at(-1) ?? 10) * 1.3, low * 10);
  for (const line of lines.slice(1)) {
    const top = greatest(line.values);
    // Being lost may be far away: it is shown where UD came close.
    if (top > high && top < high * (line.name.endsWith(RULES.lost!) ? 2 : 8)) high = top * 1.3;
  }
  // A logarithm takes no zero, which UD is in the first frame.
  for (const line of lines) line.values = line.values.map((v) => (v !== null && v > 0 ? v : null));
  const about = "UD, the mean squared distance from the estimate under the belief. High: it could be in many places.";
  return { key: "ud", name: "Uncertainty", unit: `UD, ${run.udUnit(track)}, log scale`, about, height: 190, lines, log: true, range: [low, high] };
}

/** Those that hide the target are grey and at the bottom, so that their upper edge is P(hidden). */
function modes(run: RunData, track: Track): Panel {
  const hidden = run.hidingModes(track);
  const seen = track.modes.filter((mode) => !hidden.includes(mode));
  const lines = [...hidden, ...seen].map((name, index) => ({
    name,
    title: hidden.includes(name) ? "the target cannot be seen in this mode" : "probability of this mode",
    colour: index < hidden.length ? colour("hidden") : agentColour(AGENTS - 2 - (index - hidden.length)),
    width: 6,
    values: column(track, `modes/${name}`),
  }));
  const grey = hidden.length > 0 ? ` Grey: hidden (${hidden.join(", ")}).` : "";
  const about = `The probability of each mode, on each other.${grey}`;
  return { key: "modes", name: "Modes", unit: "probability", about, height: 80, lines, range: [0, 1], stacked: true };
}

function lanes(run: RunData, track: Track): Panel {
  const agents = agentsOf(run, track);
  const found = agents.map((agent, index) => ({
    agent,
    colour: agentColour(index),
    on: rows(track).map((row) => track.isActive(agent, row)),
    kl: rows(track).map((row) => track.value(`agents/${agent}/kl`, row)),
  }));
  const all = found.flatMap((lane) => lane.kl.filter((v) => Number.isFinite(v))).sort((a, b) => a - b);
  const top = Math.max(all[Math.floor(all.length * 0.98)] ?? 1, 0.1);
  const about = `A band while the agent is on; the hill in it is KL(belief ‖ agent), to ${short(top)} nats: how far the belief is from what this agent alone says.`;
  return { key: "agents", name: "Agents", unit: `on, and KL to ${short(top)} nats`, about, height: 12 + 34 * agents.length, lines: [], range: [0, top], lanes: found };
}

function belief(run: RunData, track: Track): Panel {
  const lines: Line[] = [{ name: "score", colour: colour("ud"), width: 1.8, values: column(track, "score") }];
  for (const rule of run.plates[track.plate]?.rules ?? []) {
    if (rule.unit !== "score") continue;
    const lost = rule.rule === "score_below";
    lines.push({ name: RULES[rule.rule]!, colour: colour(lost ? "lost" : "uncertain"), width: 1.3, dash: [7, 4], values: rows(track).map(() => rule.level) });
  }
  if (run.truth !== null && run.truthTarget === track.id) {
    const overlap = rows(track).map((row) => finite(run.overlap(track, row)));
    lines.push({ name: "overlap with truth", title: "IoU", colour: colour("truth"), width: 1.4, dash: [1.5, 2.5], values: overlap });
  }
  const about = track.calibrated
    ? "Probability of being on target, an overlap above 0.5."
    : "An index of certainty, not a calibrated probability: this graph has no coefficients for one.";
  return { key: "score", name: track.calibrated ? "Probability of being on target" : "Score", unit: "0 to 1", about, height: 110, lines, range: [0, 1.04] };
}

function evidence(track: Track): Panel {
  const values = column(track, "log_evidence");
  const sorted = known(values).sort((a, b) => a - b);
  const low = sorted[Math.floor(sorted.length * 0.005)] ?? -1;
  const high = sorted.at(-1) ?? 0;
  const room = Math.max((high - low) * 0.08, 0.1);
  const line = { name: "log evidence", colour: colour("ink-soft"), width: 1.4, values };
  const about = "Predictive log-likelihood: falls where nothing looks like the target.";
  return { key: "evidence", name: "Evidence", unit: "log, nats", about, height: 90, lines: [line], range: [low - room, high + room] };
}

function sample(track: Track): Panel {
  const lines = [
    { name: "drawn", colour: colour("ink-soft"), width: 1.4, steps: true, values: column(track, "particles") },
    { name: "effective", title: "effective sample size", colour: colour("ud"), width: 1.4, values: column(track, "ess") },
  ];
  const top = Math.max(1, ...lines.map((line) => greatest(line.values)));
  const about = "How many places were asked about, and as how many they count.";
  return { key: "sample", name: "Hypotheses", unit: "number", about, height: 90, lines, range: [0, top * 1.08] };
}

function times(run: RunData, track: Track): Panel | null {
  const frames = run.clock.get("frame")!;
  if (frames.length === 0) return null;
  const at = new Map<number, number>();
  for (let row = 0; row < frames.length; row += 1) at.set(frames.at(row), row);
  const of = (name: string) =>
    rows(track).map((row) => finite(run.clock.get(name)?.at(at.get(track.value("frame", row)) ?? -1) ?? NaN));
  const lines: Line[] = [{ name: "whole frame", colour: colour("ink-soft"), width: 1.4, values: of("ms") }];
  agentsOf(run, track).forEach((agent, index) => {
    if (!run.clock.has(`stages/${agent}`)) return;
    const values = of(`stages/${agent}`).map((v) => (v === 0 ? null : v));
    lines.push({ name: agent, colour: agentColour(index), width: 1.4, values });
  });
  const sorted = known(lines[0]!.values).sort((a, b) => a - b);
  // Kernels are compiled or loaded in the first frames: they would flatten all the others.
  const top = Math.max(sorted[Math.floor(sorted.length * 0.97)] ?? 1, 0.1) * 1.3;
  const several = run.tracks.size > 1 ? " All targets together." : "";
  return { key: "ms", name: "Time", unit: "ms per frame", about: `Wall-clock time of the whole step and of each agent.${several}`, height: 110, lines, range: [0, top] };
}
