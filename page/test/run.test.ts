// A run filled line by line is the same as one that was there from the start.
import assert from "node:assert/strict";
import { test } from "node:test";
import { Column } from "../src/data/column";
import { RunData } from "../src/data/run";
import { costs, frameCounts, sum, totals } from "../src/data/totals";
import type { EventRow, FrameLine, Header } from "../src/data/types";
import { State } from "../src/state";
import { answers } from "../src/view/answers";
import { drawnOf } from "../src/view/panels";

const header = {
  run: { graph: "g", source: "s", frame_interval_s: 0.04, width: 64, height: 48 },
  plates: {
    box: { root: "box", agents: [{ name: "a", cue: "x", cost_ms: 3 }, { name: "b", cue: "y", cost_ms: 5 }], rules: [], hidden_modes: ["behind"] },
  },
} as unknown as Pick<Header, "run" | "plates">;

function line(frame: number, more: Partial<FrameLine> = {}): FrameLine {
  return {
    frame, time_s: frame / 25, target: "1", box: [10, 10, 5, 5], map: [10, 10, 5, 5], sd: [1, 1, 0, 0],
    ud_px2: 4, ud_nodes: { box: 4 }, quiet_px2: null, status: "tracking", score: 0.9, log_evidence: -1,
    surprise: 0.5, ess: 100, particles: 200, active: ["a"], kl: { a: 0.1 }, contribution: {}, agent_ud_px2: {},
    strength: { a: 1 }, learn_rate: 0, region50: [9, 11, 9, 11], region90: [8, 12, 8, 12], cloud: [[10, 11, 5, 5]],
    ...more,
  };
}

const event = (frame: number, more: Partial<EventRow> = {}): EventRow => ({
  frame, kind: "activated", sort: "switch", what: "b on", why: "", unless: "", target: "1", node: "b", on: true, ...more,
});

test("a column grows and is filled up", () => {
  const column = Column.empty("f4", 2);
  for (let k = 0; k < 50; k += 1) column.push(k, -k);
  assert.equal(column.length, 50);
  assert.deepEqual(column.row(49), [49, -49]);
  assert.ok(Number.isNaN(column.at(50)));
  assert.throws(() => column.push(1), RangeError);
});

test("lines are appended; what is measured late has gaps before", () => {
  const run = new RunData(header);
  run.append(line(3));
  run.append(line(4, { active: ["a", "b"], kl: { a: 0.1, b: 2 }, silent: ["b"], ud_px2: "Infinity", cloud: [] }));
  run.append(line(6, { status: "lost" }));
  const track = run.tracks.get("1")!;
  assert.equal(track.plate, "box");
  assert.deepEqual([run.first, run.last, track.length], [3, 6, 3]);
  assert.deepEqual([3, 4, 5, 6].map((frame) => track.rowOf(frame)), [0, 1, -1, 2]);
  assert.deepEqual([0, 1, 2].map((row) => track.isActive("b", row)), [false, true, false]);
  assert.ok(track.isSilent("b", 1) && !track.isSilent("a", 1));
  assert.ok(Number.isNaN(track.value("agents/b/kl", 0)) && track.value("agents/b/kl", 1) === 2);
  assert.equal(track.value("ud_px2", 1), Infinity);
  assert.deepEqual([0, 1, 2].map((row) => track.cloud(row).length), [1, 0, 1]);
  assert.equal(track.status(2), "lost");
});

test("frames with a target are counted once, and those without one, too", () => {
  const run = new RunData(header);
  for (let frame = 0; frame < 6; frame += 1) run.addTiming({ frame, seconds: 0.01, parts: {} });
  for (const [frame, target] of [[1, "1"], [2, "1"], [2, "2"], [3, "2"]] as const) run.append(line(frame, { target }));
  assert.deepEqual(frameCounts(run), { withTarget: 3, all: 6 });
  assert.deepEqual(frameCounts(new RunData(header)), { withTarget: 0, all: 0 });
});

// Colours come from the style sheet, which there is none of here.
Object.assign(globalThis, { document: {}, getComputedStyle: () => ({ getPropertyValue: () => "#000" }) });

test("answers to queries are panels: probabilities together, each number with its band", () => {
  const asked = { of: ["box"], asks: "x > 3", unit: "", interval: 0.9, level: null, corners: [] as [number, number][] };
  const queries = {
    inside: { ...asked, kind: "count" as const },
    right: { ...asked, kind: "probability" as const, level: 0.8 },
    speed: { ...asked, kind: "value" as const, unit: "m/s" },
    gap: { ...asked, kind: "value" as const, of: ["box", "box"] },
  };
  const run = new RunData({ ...header, queries });
  run.append(line(0));
  const numbers = { speed: 2, speed_low: 1, speed_high: 4, "gap/2": 9, "gap_low/2": 8, "gap_high/2": 11 };
  run.append(line(1, { queries: { right: 0.7, inside: 1, inside_count: 3, inside_count_low: 2, inside_count_high: 5, ...numbers } }));
  const panels = answers(run, run.tracks.get("1")!);
  assert.deepEqual(panels.map((panel) => panel.name), ["Asked", "inside_count", "speed", "gap/2"]);
  assert.deepEqual(panels[0]!.lines.map((one) => [one.name, one.values]), [["inside", [null, 1]], ["right", [null, Math.fround(0.7)]], ["right ≥ 0.8", [0.8, 0.8]]]);
  const edges = panels.slice(1).map((panel) => panel.band!.map((place) => panel.lines[place]!.values[1]));
  assert.deepEqual(edges, [[5, 2], [4, 1], [11, 8]]);
  assert.deepEqual(answers(new RunData(header), run.tracks.get("1")!), []);
});

test("probabilities of modes are kept by name, also of frames before a mode was known", () => {
  const run = new RunData(header);
  run.append(line(0));
  run.append(line(1, { modes: { seen: 0.25, behind: 0.75 } }));
  const track = run.tracks.get("1")!;
  assert.deepEqual(track.modes, ["seen", "behind"]);
  assert.ok(Number.isNaN(track.value("modes/behind", 0)) && Number.isNaN(run.hidden(track, 0)));
  assert.equal(run.hidden(track, 1), 0.75);
  assert.equal(track.value("modes/behind", 1), 0.75);
});

test("what was saved is the cost of agents that were off", () => {
  const run = new RunData(header);
  for (let k = 0; k < 10; k += 1) {
    run.append(line(k, k < 4 ? { active: ["a", "b"] } : {}));
    run.addTiming({ frame: k, seconds: 0.01, parts: { a: 0.002 } });
  }
  run.addEvent(event(3, { on: false }));
  assert.deepEqual(costs(run).get("a")!.measured, true);
  assert.deepEqual(costs(run).get("b"), { ms: 5, measured: false });
  const [row] = totals(run);
  assert.equal(row!.switches, 1);
  assert.equal(row!.agentsPerFrame, 1.4);
  assert.ok(Math.abs(row!.savedMs - 30) < 1e-3 && Math.abs(row!.spentMs - 40) < 1e-3);
  assert.ok(Math.abs(sum([row!, row!]).savedMs - 60) < 1e-3);
});

test("overlap with the truth counts pixels as the project does", () => {
  const run = new RunData(header);
  run.append(line(0));
  run.truth = new Column(new Float32Array([8, 8, 5, 5]), 4);
  run.truthTarget = "1";
  assert.equal(run.overlap(run.tracks.get("1")!, 0), 1);
});

test("stepping through events, and following a run that goes on", () => {
  const run = new RunData(header);
  for (let k = 0; k <= 20; k += 1) run.append(line(k));
  for (const frame of [5, 12]) run.addEvent(event(frame));
  run.addEvent(event(8, { sort: "note" }));
  const state = new State(run);
  state.stop(1);
  state.stop(1);
  assert.equal(state.frame.value, 12);
  state.stop(-1);
  assert.equal(state.frame.value, 5);
  run.append(line(21));
  run.changed();
  assert.equal(state.frame.value, 5);
  state.go(Infinity);
  run.append(line(22));
  run.changed();
  assert.equal(state.frame.value, 22);
  assert.deepEqual(state.stretch.value, [0, 22]);
});

test("of many targets the longest are drawn, and the chosen one, in their order", () => {
  const run = new RunData(header);
  [2, 5, 1, 4].forEach((length, index) => {
    for (let frame = 0; frame < length; frame += 1) run.append(line(frame, { target: String(index + 1) }));
  });
  const all = [...run.tracks.values()];
  assert.deepEqual(drawnOf(all, all[2]!, 3), [all[1], all[2], all[3]]);
  assert.deepEqual(drawnOf(all, all[0]!, 4), all);
});

test("a thinned page shows a frame by the row before it, and counts all frames", () => {
  const run = new RunData(header);
  const lines = [0, 10, 17, 20, 60].map((frame) => line(frame));
  for (const one of lines) run.append(one);
  const track = run.tracks.get("1")!;
  assert.deepEqual([5, 17, 19, 29, 30].map((frame) => track.rowOf(frame)), [-1, 2, -1, -1, -1]);
  track.gap = 10;
  assert.deepEqual([-1, 0, 5, 17, 19, 29, 30, 60, 70].map((frame) => track.rowOf(frame)), [-1, 0, 0, 2, 2, 3, -1, 4, -1]);
  track.counted = { frames: 40, lost: 8, uncertain: 3, active: { color: 40 } };
  run.thinned = { step: 10, rows: 5, of: 40, frames: 40, decisions: 1 };
  const [total] = totals(run);
  assert.deepEqual([total!.frames, total!.lost, total!.uncertain], [40, 8, 3]);
  assert.equal(frameCounts(run).withTarget, 40);
});

test("a doubtful identity is one of both that may be swapped, from where they met", () => {
  const run = new RunData(header);
  const what = "identities 4 and 9 could be swapped since frame 3, probability 0.22; decided by appearance +1.8, motion -0.5 nats";
  const row = { kind: "identity_doubtful", sort: "note" as const, what, target: "4", other: "9" };
  run.addEvent(event(8, { ...row, doubt: { since: 3, probability: 0.22, mutual: true } }));
  run.addEvent(event(9, { ...row, other: "2", doubt: { since: 5, probability: 0.6, mutual: false } }));
  assert.deepEqual(run.doubtsOf("4", 2), []);
  const reason = "decided by appearance +1.8, motion -0.5 nats";
  assert.deepEqual(run.doubtsOf("9", 3), [{ other: "4", since: 3, until: 8, probability: 0.22, mutual: true, reason }]);
  assert.deepEqual(run.doubtsOf("4", 20).map((doubt) => [doubt.other, doubt.until]), [["2", 9], ["9", 8]]);
  assert.deepEqual(run.doubtsOf("2", 20), []); // it is not there any more
});

test("identities that a target may have: the most probable one first, none where it is not doubtful", () => {
  const run = new RunData(header);
  run.append(line(1));
  run.append(line(2, { identities: { "9": 0.29, "1": 0.71 } }));
  run.append(line(3));
  const track = run.tracks.get("1")!;
  assert.deepEqual(track.shares(1).map(([name]) => name), ["1", "9"]);
  assert.deepEqual([track.shares(0), track.shares(2)], [[], []]);
});
