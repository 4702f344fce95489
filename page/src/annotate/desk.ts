/** A session of annotating: what its server knows, and what the person looks at and draws. */

import { batch, computed, signal } from "@preact/signals";

/** Top-left corner and size, px of the source. */
export type Box = [number, number, number, number];

export interface Target {
  name: string;
  /** A character for each frame: g given, t tracked, i interpolated, x gone, . not known yet. */
  how: string;
  percent: number[];
  boxes: (Box | null)[];
}

export interface Question {
  target: string;
  frame: number;
  reason: string;
}

/** How many frames there are of a kind of `how`, over all targets; before the first one, every frame is not known yet. */
export function counted(targets: Target[], frames: number): (how: string) => number {
  const all = targets.length === 0 ? ".".repeat(frames) : targets.map((one) => one.how).join("");
  return (how) => all.split(how).length - 1;
}

const LONGEST_NAME = 80;

/** A name as the command keeps it: on one line, printable, not too long. */
export function tidy(name: string): string {
  const printable = name.replace(/[\p{Z}\p{Cc}]+/gu, " ").replace(/\p{C}/gu, "");
  return [...printable.trim()].slice(0, LONGEST_NAME).join("").trimEnd();
}

interface Standing {
  version: number;
  marks: number;
  busy: { target: string; frame: number } | null;
  /** Whether answers were given that are not tracked from yet. */
  behind: boolean;
  trouble: string;
  left: boolean;
  answers: number;
  about: { name: string; frames: number; width: number; height: number; interval: number; threshold: number; graph: string; out: string };
  questions: Question[];
  targets?: Target[];
}

export type Kind = "box" | "gone" | "correct" | "undo";

const AGAIN_MS = 1000;

export class Desk {
  readonly standing = signal<Standing | null>(null);
  readonly targets = signal<Target[]>([]);
  readonly isCut = signal(false);
  readonly problem = signal("");
  readonly frame = signal(0);
  /** Name of the target that answers are about. */
  readonly target = signal("target 1");
  /** The box that is being drawn, not given yet. */
  readonly drawn = signal<Box | null>(null);
  readonly playing = signal(false);
  readonly help = signal(false);
  readonly about = computed(() => this.standing.value?.about);
  readonly questions = computed(() => this.standing.value?.questions ?? []);
  /** What is asked of the target; of another one where this one has no question. */
  readonly question = computed(
    () => this.questions.value.find((one) => one.target === this.target.value) ?? this.questions.value[0],
  );
  readonly current = computed(() => this.targets.value.find((one) => one.name === this.target.value));
  /** The question that the person was led to. */
  private led = "";
  private seen = 0;
  private marks = 0;
  /** Names that have no box yet. */
  readonly fresh = signal<string[]>(["target 1"]);

  get names(): string[] {
    const known = this.targets.value.map((one) => one.name);
    return [...known, ...this.fresh.value.filter((name) => !known.includes(name))];
  }

  async listen(): Promise<void> {
    for (;;) {
      try {
        const answer = await fetch(`feed?from=${this.marks}&seen=${this.seen}`, { cache: "no-store" });
        if (!answer.ok) throw new Error(await answer.text());
        this.take((await answer.json()) as Standing);
        this.isCut.value = false;
      } catch (error) {
        if (!(error instanceof TypeError)) console.error(error);
        this.isCut.value = true;
        if (this.standing.value?.left) return;
        await new Promise((done) => setTimeout(done, AGAIN_MS));
      }
    }
  }

  private take(standing: Standing): void {
    batch(() => {
      [this.seen, this.marks] = [standing.version, standing.marks];
      this.standing.value = standing;
      if (standing.trouble !== "") this.problem.value = standing.trouble;
      if (standing.targets !== undefined) {
        const isFirst = this.targets.value.length === 0 && standing.targets.length > 0;
        this.targets.value = standing.targets;
        if (isFirst && this.drawn.value === null && !this.current.value) {
          this.fresh.value = [];
          this.target.value = standing.targets[0]!.name;
        }
      }
      if (!standing.behind) this.lead();
    });
  }

  /** Go to the question that is open, once, and never while a box is being drawn. */
  private lead(): void {
    const question = this.question.value;
    const key = question === undefined ? "" : `${question.target}/${question.frame}`;
    if (question === undefined || key === this.led || this.drawn.value !== null) return;
    this.led = key;
    this.toQuestion();
  }

  toQuestion(): void {
    const question = this.question.value;
    if (question === undefined) return;
    this.playing.value = false;
    this.target.value = question.target;
    this.go(question.frame);
  }

  go(frame: number): void {
    const last = (this.about.value?.frames ?? 1) - 1;
    const to = Math.min(Math.max(Math.round(frame), 0), last);
    if (to !== this.frame.value) this.drawn.value = null;
    this.frame.value = to;
  }

  /** The next or previous frame that a person answered. */
  toGiven(step: 1 | -1): void {
    const how = this.current.value?.how ?? "";
    for (let at = this.frame.value + step; at >= 0 && at < how.length; at += step) if (how[at] === "g") return this.go(at);
  }

  add(name: string): void {
    if (!this.names.includes(name)) this.fresh.value = [...this.fresh.value, name];
    this.target.value = name;
    this.drawn.value = null;
  }

  /** A name with the next free number of the label. */
  nextName(): string {
    const label = this.target.value.replace(/[ _#-]*\d+$/, "") || "target";
    for (let number = 1; ; number += 1) if (!this.names.includes(`${label} ${number}`)) return `${label} ${number}`;
  }

  /** Give an answer about the target in this frame; whether it was taken. */
  async answer(kind: Kind): Promise<void> {
    const [frame, target, box] = [this.frame.value, this.target.value, this.drawn.value];
    if (kind === "box" && box === null) {
      this.problem.value = "Draw a box first: drag over the picture.";
      return;
    }
    const what = kind === "undo" ? { kind } : kind === "box" ? { kind, frame, target, box } : { kind, frame, target };
    if (await this.ask({ do: "answer", ...what })) {
      this.drawn.value = null;
      this.led = "";
    }
  }

  leave(): Promise<boolean> {
    return this.ask({ do: "leave" });
  }

  private async ask(what: object): Promise<boolean> {
    this.problem.value = "";
    try {
      const headers = { "Content-Type": "application/json" };
      const answer = await fetch("do", { method: "POST", headers, body: JSON.stringify(what) });
      const said = (await answer.json().catch(() => ({}))) as { error?: string };
      if (!answer.ok) this.problem.value = said.error ?? "the command refused";
      return answer.ok;
    } catch {
      this.problem.value = "the command gives no answer";
      return false;
    }
  }
}
