/** Lines over frames: what a panel of the timelines is made of, and the columns of a target as lines. */

import type { Track } from "../data/run";

export interface Line {
  name: string;
  title?: string;
  colour: string;
  width: number;
  dash?: number[];
  steps?: boolean;
  values: (number | null)[];
}

export interface Panel {
  key: string;
  name: string;
  unit: string;
  about: string;
  height: number;
  lines: Line[];
  log?: boolean;
  /** Lowest and highest value that is shown. */
  range: [number, number];
  lanes?: Lane[];
  /** Lines are shares of one whole: areas on each other, the first at the bottom. */
  stacked?: boolean;
  /** Upper and lower edge of an area, as places in `lines`. */
  band?: [number, number];
  /** A row per target: its status over time. */
  targets?: { track: Track; chosen: boolean }[];
}

export interface Lane {
  agent: string;
  colour: string;
  on: boolean[];
  kl: number[];
}

export function rows(track: Track): number[] {
  return Array.from({ length: track.length }, (_, row) => row);
}

export function column(track: Track, name: string): (number | null)[] {
  return rows(track).map((row) => finite(track.value(name, row)));
}

export function finite(value: number): number | null {
  return Number.isFinite(value) ? value : null;
}

export function known(values: (number | null)[]): number[] {
  return values.filter((v): v is number => v !== null);
}

/** Not by Math.max(...): a long run has more values than a call may have arguments. */
export function greatest(values: (number | null)[]): number {
  return values.reduce<number>((top, value) => (value !== null && value > top ? value : top), -Infinity);
}
