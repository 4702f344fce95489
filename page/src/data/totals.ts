/** What a run took in all, and what switching agents off has saved. */

import type { RunData, Track } from "./run";

export interface Totals {
  target: string;
  frames: number;
  lost: number;
  uncertain: number;
  agentsPerFrame: number;
  agents: number;
  switches: number;
  spentMs: number;
  savedMs: number;
  overlap: number;
}

/** Milliseconds that an agent takes for one target: the median over the frames, else its declared cost. */
export function costs(run: RunData): Map<string, { ms: number; measured: boolean }> {
  const tracks = [...run.tracks.values()];
  const frames = run.clock.get("frame")!;
  const found = new Map<string, { ms: number; measured: boolean }>();
  for (const agent of new Set(tracks.flatMap((track) => agentsOf(run, track)))) {
    const each: number[] = [];
    const column = run.clock.get(`stages/${agent}`);
    const step = Math.max(1, Math.floor(frames.length / 2000));
    for (let row = 0; column !== undefined && row < frames.length; row += step) {
      const asked = tracks.filter((track) => track.isActive(agent, track.rowOf(frames.at(row)))).length;
      const ms = column.at(row);
      if (asked > 0 && ms > 0) each.push(ms / asked);
    }
    const declared = Object.values(run.plates).flatMap((plate) => plate.agents).find((a) => a.name === agent)?.cost_ms;
    if (each.length > 0) found.set(agent, { ms: median(each), measured: true });
    else if (declared !== null && declared !== undefined) found.set(agent, { ms: declared, measured: false });
  }
  return found;
}

export function totals(run: RunData): Totals[] {
  const each = costs(run);
  return [...run.tracks.values()].map((track) => of(run, track, each));
}

export function sum(rows: Totals[]): Totals {
  const add = (key: keyof Totals) => rows.reduce((total, row) => total + (row[key] as number), 0);
  const frames = add("frames");
  const weighted = (key: "agentsPerFrame" | "agents") =>
    rows.reduce((total, row) => total + row[key] * row.frames, 0) / Math.max(1, frames);
  return {
    target: "all",
    frames,
    lost: add("lost"),
    uncertain: add("uncertain"),
    agentsPerFrame: weighted("agentsPerFrame"),
    agents: weighted("agents"),
    switches: add("switches"),
    spentMs: add("spentMs"),
    savedMs: add("savedMs"),
    overlap: NaN,
  };
}

/** Frames with at least one target, and all that were read. */
export function frameCounts(run: RunData): { withTarget: number; all: number } {
  const seen = new Set<number>();
  for (const track of run.tracks.values()) for (let row = 0; row < track.length; row += 1) seen.add(track.value("frame", row));
  const withTarget = run.thinned?.frames ?? seen.size;
  return { withTarget, all: Math.max(run.clock.get("frame")!.length, withTarget) };
}

/** The agents of a target's plate, or those that were ever active. */
export function agentsOf(run: RunData, track: Track): string[] {
  return run.plates[track.plate]?.agents.map((agent) => agent.name) ?? track.agents;
}

function of(run: RunData, track: Track, each: Map<string, { ms: number; measured: boolean }>): Totals {
  const agents = agentsOf(run, track);
  let [lost, uncertain, active, spentMs, savedMs, shared, compared] = [0, 0, 0, 0, 0, 0, 0];
  for (let row = 0; row < track.length; row += 1) {
    const status = track.status(row);
    lost += Number(status === "lost");
    uncertain += Number(status === "uncertain");
    for (const agent of agents) {
      const ms = each.get(agent)?.ms ?? 0;
      if (track.isActive(agent, row)) [active, spentMs] = [active + 1, spentMs + ms];
      else savedMs += ms;
    }
    const overlap = run.overlap(track, row);
    if (!Number.isNaN(overlap)) [shared, compared] = [shared + overlap, compared + 1];
  }
  let frames = track.length;
  if (track.counted !== null) {
    ({ frames, lost, uncertain } = track.counted);
    [active, spentMs, savedMs] = [0, 0, 0];
    for (const agent of agents) {
      const [ms, on] = [each.get(agent)?.ms ?? 0, track.counted.active[agent] ?? 0];
      [active, spentMs, savedMs] = [active + on, spentMs + ms * on, savedMs + ms * (frames - on)];
    }
  }
  return {
    target: track.id,
    frames,
    lost,
    uncertain,
    agentsPerFrame: active / Math.max(1, frames),
    agents: agents.length,
    switches: run.events.filter((event) => event.sort === "switch" && event.target === track.id).length,
    spentMs,
    savedMs,
    overlap: compared > 0 ? shared / compared : NaN,
  };
}

function median(values: number[]): number {
  const sorted = [...values].sort((a, b) => a - b);
  return sorted[sorted.length >> 1]!;
}
