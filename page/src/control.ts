/** A run in progress, as the page sees it: how things stand, and what a person may ask. `Live` is one. */

import type { ReadonlySignal, Signal } from "@preact/signals";

export type Phase = "opening" | "choosing" | "starting" | "running" | "paused" | "ended";

/** How things stand, as every answer says. */
export interface Status {
  next: number;
  version: number;
  phase: Phase;
  stopping: boolean;
  canSwitch: boolean;
  /** Frames a second. */
  rate: number;
  frames: number;
  /** The last frame that has a picture. */
  pictured: number;
  trouble: string;
  about: Asked;
}

/** What is known before the run begins. */
export interface Asked {
  graph?: string;
  source?: string;
  width?: number;
  height?: number;
  expected?: number | null;
  plates?: string[];
  out?: string;
  first?: number;
}

export interface Control {
  readonly status: ReadonlySignal<Status | null>;
  readonly phase: ReadonlySignal<Phase>;
  /** Whether the run goes on: it can be paused, and its agents switched. */
  readonly isOn: ReadonlySignal<boolean>;
  /** The server gives no answer. */
  readonly isCut: ReadonlySignal<boolean>;
  /** What was refused, in words. */
  readonly problem: Signal<string>;
  /** "target/agent" -> what was asked for and is not done yet: on, off, or what the rules say. */
  readonly asked: ReadonlySignal<ReadonlyMap<string, boolean | null>>;
  /** Whether a finger or a button is down: then nothing is taken from under it. */
  readonly isHeld: boolean;
  /** Ask for something; whether it was granted. */
  ask(what: { do: string; [key: string]: unknown }): Promise<boolean>;
  pauseOrGo(): void;
  step(): void;
  /** Switch an agent by hand, or (null) give it back to the rules. */
  switch(target: string, agent: string, on: boolean | null): Promise<void>;
}
