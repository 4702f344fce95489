/**
 * A run as the page knows it. It is filled at once from a packed page (packed.ts), or line by line while the run
 * goes on: `append` takes the measurements of a frame, `addTiming` one of timings.jsonl, `addEvent` a row of an event.
 * Whoever feeds it calls `changed` after each batch; the page listens with `onChange`. It knows no DOM.
 */

import { Column, type Kind } from "./column";
import type { About, CameraAbout, Counted, Doubt, EventRow, FrameLine, Header, Plate, Query, Thinned, TimingLine, Written } from "./types";

export const STATUSES = ["tracking", "uncertain", "lost", "seen", "hidden", "unwatched"] as const;
const NUMBERS = ["ud_px2", "score", "log_evidence", "surprise", "ess", "particles", "learn_rate"] as const;
const BOXES = ["box", "map", "sd", "region50", "region90"] as const;
const PER_AGENT = ["kl", "contribution", "agent_ud_px2"] as const;

export function number(value: Written | undefined): number {
  return value === null || value === undefined ? NaN : Number(value);
}

/** One target: a row per frame in which it lives. */
export class Track {
  readonly columns = new Map<string, Column>();
  agents: string[] = [];
  nodes: string[] = [];
  parts: string[] = [];
  modes: string[] = [];
  /** Columns of answers: a query, with `_sd`, `_low`, `_high` for a number, `_count` for all targets, `/ID` for a pair. */
  queries: string[] = [];
  /** Those of which the target may have the identity, in any frame; columns of probabilities. */
  identities: string[] = [];
  calibrated = false;
  /** Frames for which a row stands: 1, but in the page of a long run, which holds some rows only. */
  gap = 1;
  /** Its place among the targets, which is its colour. */
  place = 0;
  /** Counts over all rows, where the page holds some only. */
  counted: Counted | null = null;

  constructor(
    readonly id: string,
    readonly plate: string,
  ) {}

  get length(): number {
    return this.columns.get("frame")?.length ?? 0;
  }

  get first(): number {
    return this.value("frame", 0);
  }

  get last(): number {
    return this.value("frame", this.length - 1);
  }

  value(name: string, row: number, place = 0): number {
    return this.columns.get(name)?.at(row, place) ?? NaN;
  }

  values(name: string, row: number): number[] {
    return this.columns.get(name)?.row(row) ?? [];
  }

  status(row: number): string {
    return STATUSES[this.value("status", row)] ?? "tracking";
  }

  isActive(agent: string, row: number): boolean {
    return this.value(`agents/${agent}/state`, row) > 0;
  }

  isSilent(agent: string, row: number): boolean {
    return this.value(`agents/${agent}/state`, row) > 1;
  }

  /** The row of a frame, or in a thinned page the last one before it; -1 where the target does not live. */
  rowOf(frame: number): number {
    const row = this.rowAfter(frame + 1) - 1;
    return frame - this.value("frame", row) < this.gap ? row : -1;
  }

  /** The first row of this frame or a later one. */
  rowAfter(frame: number): number {
    const frames = this.columns.get("frame");
    let low = 0;
    let high = this.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (frames!.at(middle) < frame) low = middle + 1;
      else high = middle;
    }
    return low;
  }

  /** Whose identity it may have in a row, with probabilities, the most probable one first. */
  shares(row: number): [string, number][] {
    const shares = this.identities.map((name): [string, number] => [name, this.value(`identities/${name}`, row)]);
    return shares.filter(([, share]) => share > 0).sort((a, b) => b[1] - a[1]);
  }

  cloud(row: number): number[][] {
    const start = row > 0 ? this.value("cloud_end", row - 1) : 0;
    const end = this.value("cloud_end", row);
    return Array.from({ length: Math.max(0, end - start) }, (_, k) => this.values("cloud", start + k));
  }

  append(line: FrameLine): void {
    const row = this.length;
    for (const name of NUMBERS) this.put(name, row, "f4", number(line[name]));
    this.put("angle", row, "f4", number(line.angle ?? 0));
    for (const name of BOXES) this.put(name, row, "f4", ...line[name].map(number));
    this.put("quiet_px2", row, "f4", number(line.quiet_px2));
    this.put("time_s", row, "f8", number(line.time_s));
    this.put("status", row, "u1", code(line.status));
    this.agents = union(this.agents, line.active);
    for (const agent of this.agents) {
      const state = Number(line.active.includes(agent)) + Number(line.silent?.includes(agent) ?? false);
      this.put(`agents/${agent}/state`, row, "u1", state);
      for (const key of PER_AGENT) this.put(`agents/${agent}/${key}`, row, "f4", number(line[key][agent]));
    }
    this.nodes = union(this.nodes, Object.keys(line.ud_nodes));
    for (const node of this.nodes) this.put(`nodes/${node}/ud_px2`, row, "f4", number(line.ud_nodes[node]));
    for (const node of union([...this.agents, ...this.nodes], Object.keys(line.strength))) {
      this.put(`nodes/${node}/strength`, row, "f4", number(line.strength[node]));
    }
    this.parts = union(this.parts, Object.keys(line.parts ?? {}));
    for (const part of this.parts) {
      const found = line.parts?.[part];
      this.put(`parts/${part}/box`, row, "f4", ...(found?.box.map(number) ?? [NaN, NaN, NaN, NaN]));
      this.put(`parts/${part}/status`, row, "u1", code(found?.status ?? "unwatched"));
    }
    this.modes = union(this.modes, Object.keys(line.modes ?? {}));
    for (const mode of this.modes) this.put(`modes/${mode}`, row, "f4", number(line.modes?.[mode]));
    this.queries = union(this.queries, Object.keys(line.queries ?? {}));
    for (const name of this.queries) this.put(`queries/${name}`, row, "f4", number(line.queries?.[name]));
    this.identities = union(this.identities, Object.keys(line.identities ?? {}));
    for (const name of this.identities) this.put(`identities/${name}`, row, "f4", number(line.identities?.[name]));
    for (const box of line.cloud) this.put("cloud", -1, "i2", ...box.slice(0, 4));
    this.put("cloud_end", row, "i4", this.columns.get("cloud")?.length ?? 0);
    this.calibrated ||= Object.keys(line.features ?? {}).length > 0;
    this.put("frame", row, "i4", line.frame); // last: it is what makes the row count
  }

  private put(name: string, row: number, kind: Kind, ...values: number[]): void {
    let column = this.columns.get(name);
    if (column === undefined) this.columns.set(name, (column = Column.empty(kind, values.length)));
    if (row >= 0) column.fill(row, kind === "f4" ? NaN : 0);
    column.push(...values);
  }
}

export class RunData {
  readonly about: About;
  readonly plates: Record<string, Plate>;
  readonly tracks = new Map<string, Track>();
  readonly events: EventRow[] = [];
  /** Those of them by which a person switched an agent, or gave it back to the rules. */
  readonly hands: EventRow[] = [];
  /** Milliseconds of the whole step and of each stage or agent, a row per frame. */
  readonly clock = new Map<string, Column>([
    ["frame", Column.empty("i4")],
    ["ms", Column.empty("f4")],
  ]);
  readonly queries: Record<string, Query>;
  /** Those of a run of several cameras. */
  readonly cameras: CameraAbout[];
  truth: Column | null = null;
  truthTarget: string | null = null;
  thinned: Thinned | null = null;
  first = 0;
  last = 0;
  private readonly listeners = new Set<() => void>();

  constructor(header: Pick<Header, "run" | "plates" | "queries" | "cameras">) {
    this.about = header.run;
    this.plates = header.plates;
    this.queries = header.queries ?? {};
    this.cameras = header.cameras ?? [];
  }

  /** Call with the measurements of a frame; frames come in order. */
  append(line: FrameLine): void {
    let track = this.tracks.get(line.target);
    if (track === undefined) {
      track = new Track(line.target, this.plateOf(line.target));
      this.add(track);
    }
    track.append(line);
    this.measure();
  }

  addEvent(row: EventRow): void {
    this.events.push(row);
    if (row.kind === "toggled" || row.kind === "released") this.hands.push(row);
  }

  addTiming(line: TimingLine): void {
    const row = this.clock.get("frame")!.length;
    this.clock.get("ms")!.push(1e3 * line.seconds);
    const known = [...this.clock.keys()].filter((name) => name.startsWith("stages/")).map((name) => name.slice(7));
    for (const stage of union(known, Object.keys(line.parts))) {
      const name = `stages/${stage}`;
      if (!this.clock.has(name)) this.clock.set(name, Column.empty("f4"));
      this.clock.get(name)!.fill(row, 0);
      this.clock.get(name)!.push(1e3 * (line.parts[stage] ?? 0));
    }
    this.clock.get("frame")!.push(line.frame);
  }

  add(track: Track): void {
    track.place = this.tracks.size;
    this.tracks.set(track.id, track);
  }

  /** Which frames there are. */
  measure(): void {
    const lived = [...this.tracks.values()].filter((track) => track.length > 0);
    this.first = Math.min(...lived.map((track) => track.first));
    this.last = Math.max(...lived.map((track) => track.last));
    if (lived.length === 0) this.first = this.last = 0;
  }

  onChange(listener: () => void): void {
    this.listeners.add(listener);
  }

  changed(): void {
    for (const listener of this.listeners) listener();
  }

  /** Milliseconds of a stage or agent in a frame. */
  ms(name: string, frame: number): number {
    const frames = this.clock.get("frame")!;
    let row = frame - frames.at(0);
    if (frames.at(row) !== frame) {
      row = 0;
      while (row < frames.length && frames.at(row) !== frame) row += 1;
    }
    return this.clock.get(name)?.at(row) ?? NaN;
  }

  /** Agents of a target that a person holds in a frame: whether on or off. */
  heldIn(target: string, frame: number): Map<string, boolean> {
    const held = new Map<string, boolean>();
    for (const event of this.hands) {
      if (event.frame >= frame || event.target !== target || event.node === undefined) continue;
      if (event.kind === "toggled") held.set(event.node, event.on === true);
      else held.delete(event.node);
    }
    return held;
  }

  /** Events of a target, and those that concern no target. */
  eventsOf(target: string): EventRow[] {
    return this.events.filter((e) => e.target === undefined || e.target === target || e.other === target);
  }

  /** Whom a target may be in a frame, from the frame on in which the two met; the latest meeting first. */
  doubtsOf(target: string, frame: number): Doubt[] {
    return this.events.flatMap((event) => {
      const { doubt } = event;
      const isOf = event.target === target || (event.other === target && doubt?.mutual === true);
      if (doubt === undefined || !isOf || doubt.since > frame) return [];
      const other = event.target === target ? event.other! : event.target!;
      return [{ ...doubt, other, until: event.frame, reason: event.what.split("; ").slice(1).join("; ") }];
    }).reverse();
  }

  /** IoU of the estimate with the true box; NaN where there is none. */
  overlap(track: Track, row: number): number {
    if (this.truth === null || track.id !== this.truthTarget) return NaN;
    const [x, y, w, h] = track.values("box", row) as [number, number, number, number];
    const [tx, ty, tw, th] = this.truth.row(track.value("frame", row)) as [number, number, number, number];
    const [left, top] = [x - (w - 1) / 2, y - (h - 1) / 2];
    const across = Math.min(left + w, tx + tw) - Math.max(left, tx);
    const down = Math.min(top + h, ty + th) - Math.max(top, ty);
    if (!Number.isFinite(across + down)) return NaN;
    const shared = Math.max(0, across) * Math.max(0, down);
    return shared / (w * h + tw * th - shared);
  }

  /** Unit of a target's UD. */
  udUnit(track: Track): string {
    return this.plates[track.plate]?.ud_unit ?? "px²";
  }

  /** Modes of a target in which it cannot be seen. */
  hidingModes(track: Track): string[] {
    return track.modes.filter((mode) => this.plates[track.plate]?.hidden_modes.includes(mode));
  }

  /** Probability that the target is hidden; NaN where no mode hides it. */
  hidden(track: Track, row: number): number {
    const shares = this.hidingModes(track).map((mode) => track.value(`modes/${mode}`, row));
    return shares.length === 0 ? NaN : shares.reduce((sum, share) => sum + share, 0);
  }

  private plateOf(target: string): string {
    const names = Object.keys(this.plates);
    const started = this.events.find((e) => e.target === target && e.sort === "life");
    return names.find((name) => started?.what.includes(` as ${name},`)) ?? names[0] ?? "";
  }
}

function code(status: string): number {
  return Math.max(0, (STATUSES as readonly string[]).indexOf(status));
}

function union(known: string[], more: string[]): string[] {
  return more.every((name) => known.includes(name)) ? known : [...new Set([...known, ...more])];
}
