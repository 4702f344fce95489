/** A run in progress: what its server tells, line by line, and what a person asks of it. */

import { batch, computed, signal } from "@preact/signals";
import type { Control, Phase, Status } from "./control";
import { RunData } from "./data/run";
import type { EventRow, FrameLine, Header, TimingLine } from "./data/types";
import { fromServer } from "./pictures";
import { State } from "./state";

export interface Start {
  box: [number, number, number, number];
  plate: string | null;
}

type Line =
  | { header: Header }
  | { event: EventRow }
  | { frames: FrameLine[]; timing: TimingLine }
  | { ended: { complete: boolean; reason: string } };

const AGAIN_MS = 1000;

export class Live implements Control {
  readonly status = signal<Status | null>(null);
  readonly phase = computed<Phase>(() => this.status.value?.phase ?? "opening");
  /** Whether the run goes on: it can be paused, and its agents switched. */
  readonly isOn = computed(() => this.phase.value === "running" || this.phase.value === "paused");
  /** The server gives no answer. */
  readonly isCut = signal(false);
  /** What was refused, in words. */
  readonly problem = signal("");
  readonly state = signal<State | null>(null);
  /** "target/agent" -> what was asked for and is not done yet: on, off, or what the rules say. */
  readonly asked = signal<ReadonlyMap<string, boolean | null>>(new Map());
  /** Whether a finger or a button is down: then nothing is taken from under it. */
  isHeld = false;

  private next = 0;
  private version = 0;

  constructor() {
    for (const [kind, down] of [["pointerdown", true], ["pointerup", false], ["pointercancel", false]] as const) {
      window.addEventListener(kind, () => (this.isHeld = down), true);
    }
  }

  /** Listen until the view is closed. */
  async listen(): Promise<void> {
    for (;;) {
      try {
        const answer = await fetch(`feed?from=${this.next}&seen=${this.version}`, { cache: "no-store" });
        if (!answer.ok) throw new Error(await answer.text());
        const { status, lines } = (await answer.json()) as { status: Status; lines: Line[] };
        this.take(status, lines);
        this.isCut.value = false;
      } catch (error) {
        if (!(error instanceof TypeError)) console.error(error);
        this.isCut.value = true;
        // Where the run has ended, the view was closed: nobody will answer any more.
        if (this.phase.value === "ended") return;
        await new Promise((done) => setTimeout(done, AGAIN_MS));
      }
    }
  }

  /** Ask for something; whether it was granted. */
  async ask(what: { do: string; [key: string]: unknown }): Promise<boolean> {
    this.problem.value = "";
    try {
      const answer = await fetch("do", {
        method: "POST",
        headers: { "Content-Type": "application/json" },
        body: JSON.stringify(what),
      });
      const said = (await answer.json().catch(() => ({}))) as { error?: string };
      if (!answer.ok) this.problem.value = said.error ?? "the run refused";
      return answer.ok;
    } catch {
      this.problem.value = "the run gives no answer";
      return false;
    }
  }

  pauseOrGo(): void {
    void this.ask({ do: this.phase.value === "paused" ? "go" : "pause" });
  }

  step(): void {
    this.state.value?.goLive();
    void this.ask({ do: "step" });
  }

  /** Switch an agent by hand, or (null) give it back to the rules. */
  async switch(target: string, agent: string, on: boolean | null): Promise<void> {
    const key = `${target}/${agent}`;
    this.asked.value = new Map(this.asked.value).set(key, on);
    const what = on === null ? { do: "release" } : { do: "switch", on };
    if (!(await this.ask({ ...what, target, agent }))) this.done(key);
  }

  private done(key: string): void {
    if (!this.asked.value.has(key)) return;
    const left = new Map(this.asked.value);
    left.delete(key);
    this.asked.value = left;
  }

  private take(status: Status, lines: Line[]): void {
    batch(() => {
      const pictured = this.status.value?.pictured;
      [this.next, this.version] = [status.next, status.version];
      this.status.value = status;
      if (status.trouble !== "") this.problem.value = status.trouble;
      let isNew = false;
      for (const line of lines) {
        this.add(line);
        isNew ||= !("header" in line);
      }
      const state = this.state.value;
      if (state === null) return;
      if (isNew) state.run.changed();
      else state.follow();
      // A frame that rests gets its own picture a little later.
      if (status.pictured !== pictured && status.phase !== "running") state.look.value += 1;
    });
  }

  private add(line: Line): void {
    const run = this.state.value?.run;
    if ("header" in line) this.begin(line.header);
    else if (run === undefined) return;
    else if ("event" in line) {
      run.addEvent(line.event);
      const { kind, target, node, what } = line.event;
      if (["toggled", "released", "input_refused"].includes(kind)) this.done(`${target}/${node}`);
      if (kind === "input_refused") this.problem.value = what;
    } else if ("frames" in line) {
      for (const one of line.frames) run.append(one);
      run.addTiming(line.timing);
    } else run.about.ended = line.ended;
  }

  private begin(header: Header): void {
    const state = new State(new RunData(header));
    state.live = this;
    state.pictures.value = fromServer();
    this.state.value = state;
  }
}
