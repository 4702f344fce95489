/** What the page is told of a run: its header, its events, and the lines that a run in progress adds. */

export type Sort = "switch" | "status" | "life" | "camera" | "note";

export interface EventRow {
  frame: number;
  kind: string;
  sort: Sort;
  what: string;
  why: string;
  unless: string;
  target?: string;
  other?: string;
  node?: string;
  /** Of which camera it tells. */
  camera?: string;
  on?: boolean;
  status?: string;
  /** Of an identity: the frame in which the two met, the probability, and whether they would be swapped. */
  doubt?: { since: number; probability: number; mutual: boolean };
}

/** A doubtful identity as a target sees it: the probability that it is `other`. */
export interface Doubt {
  other: string;
  since: number;
  /** The frame in which the two were apart for long enough. */
  until: number;
  probability: number;
  mutual: boolean;
  /** What decided it. */
  reason: string;
}

export interface Rule {
  node: string;
  rule: "activate" | "deactivate" | "on_call" | "learn" | "lost" | "self_check" | "score_below" | "uncertain_below";
  unit: "ud_px2" | "ud_box" | "ud_baseline" | "score";
  level: number;
  frames: number;
}

export interface NetNode {
  name: string;
  note: string;
  agent: boolean;
  x: number;
  y: number;
  w: number;
  h: number;
  parent: string | null;
}

export interface Net {
  width: number;
  height: number;
  nodes: NetNode[];
  edges: { child: string; from: [number, number]; to: [number, number] }[];
  forks: { text: string; x: number; y: number; w: number; h: number }[];
}

export interface Plate {
  root: string;
  /** Node -> what the graph says of it, as YAML; not in pages of earlier versions. */
  settings?: Record<string, string>;
  /** Modes in which the target cannot be seen. */
  hidden_modes: string[];
  /** Unit of UD, of baselines and of levels in `ud_px2`: px², or m² where the state is in metres. */
  ud_unit?: string;
  /** Nodes that are what a camera sees: their UD is in px². */
  views?: string[];
  /** Corners of the ground on which targets start, m; empty where they do anywhere. */
  area?: [number, number][];
  agents: { name: string; cue: string; cost_ms: number | null }[];
  rules: Rule[];
  net: Net;
}

export interface About {
  /** Of the run; empty where it has none, as a run in progress. */
  name?: string;
  graph: string;
  graph_sha256: string;
  source: string;
  seed: number;
  width: number;
  height: number;
  declared_frames: number | null;
  frame_interval_s: number | null;
  versions: Record<string, string>;
  /** Whether boxes and UD are those of beliefs given the whole sequence. */
  smoothed?: boolean;
  ended: { complete: boolean; reason: string } | null;
}

/** Frames of a target, lost and uncertain ones, and those in which each agent was active. */
export interface Counted {
  frames: number;
  lost: number;
  uncertain: number;
  active: Record<string, number>;
}

/**
 * A page that holds some rows only: each stands for `step` frames; there are `rows` of `of`, in `frames` frames, and
 * one in `decisions` of those with a decision.
 */
export interface Thinned {
  step: number;
  rows: number;
  of: number;
  frames: number;
  decisions: number;
}

/** One of several cameras: size of its image in px; where it stands and what it sees of the ground, in m. */
export interface CameraAbout {
  name: string;
  width: number;
  height: number;
  /** Null where its calibration is not known. */
  at: [number, number] | null;
  /** Corners of what it sees; none where that is not known. */
  field: [number, number][];
}

/** A query of the graph. */
export interface Query {
  kind: "probability" | "value" | "count" | "crosses";
  of: string[];
  asks: string;
  unit: string;
  /** Share of the belief in the interval of a number. */
  interval: number;
  level: number | null;
  /** Two ends of a line, or the corners of a polygon, px. */
  corners: [number, number][];
}

export interface Header {
  version: number;
  run: About;
  plates: Record<string, Plate>;
  queries?: Record<string, Query>;
  /** Of a run of several cameras. */
  cameras?: CameraAbout[];
  targets: { id: string; plate: string; agents: string[]; nodes: string[]; parts: string[]; modes: string[]; queries: string[]; identities?: string[]; calibrated: boolean; counted?: Counted }[];
  events: EventRow[];
  stages: string[];
  truth_target?: string | null;
  thinned?: Thinned | null;
  pictures?: { where: "file" | "folder"; step: number; annotated: boolean; without: string; starts?: Record<string, number> };
}

/** A number as the journal writes it: JSON has neither NaN nor infinity. */
export type Written = number | "NaN" | "Infinity" | "-Infinity" | null;

/** Measurements of a frame, as `export --format frames` writes them. */
export interface FrameLine {
  frame: number;
  time_s: Written;
  target: string;
  box: Written[];
  map: Written[];
  sd: Written[];
  ud_px2: Written;
  ud_nodes: Record<string, Written>;
  quiet_px2: Written;
  status: string;
  score: Written;
  log_evidence: Written;
  surprise: Written;
  ess: Written;
  particles: Written;
  active: string[];
  kl: Record<string, Written>;
  contribution: Record<string, Written>;
  agent_ud_px2: Record<string, Written>;
  strength: Record<string, Written>;
  learn_rate: Written;
  region50: Written[];
  region90: Written[];
  cloud: number[][];
  silent?: string[];
  features?: Record<string, Written>;
  parts?: Record<string, { box: Written[]; status: string }>;
  angle?: Written;
  modes?: Record<string, Written>;
  queries?: Record<string, Written>;
  identities?: Record<string, Written>;
}

/** A line of timings.jsonl. */
export interface TimingLine {
  frame: number;
  seconds: number;
  parts: Record<string, number>;
}
