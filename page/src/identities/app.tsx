/** The page that asks who is who in a run: the doubtful place as a loop, and one key for each answer. */

import { signal } from "@preact/signals";
import { useEffect } from "preact/hooks";

type Box = [number, number, number, number];

interface Question {
  target: string;
  frame: number;
  first: number;
  last: number;
  shown: string;
  swap: string;
  keep: boolean;
  doubt: number;
  candidates: { target: string; probability: number; frame: number | null }[];
  boxes: Record<string, (Box | null)[]>;
}

interface Standing {
  version: number;
  left: boolean;
  answers: number;
  changed: number;
  left_over: number;
  about: { name: string; width: number; height: number; frames: number; out: string };
  questions: Question[];
}

const AGAIN_MS = 1000;
const STEP_MS = 80;

export class Queue {
  readonly standing = signal<Standing | null>(null);
  readonly isCut = signal(false);
  readonly problem = signal("");
  readonly frame = signal(0);
  readonly playing = signal(true);
  readonly chosen = signal(0);
  private seen = 0;

  get question(): Question | undefined {
    const all = this.standing.value?.questions ?? [];
    return all[Math.min(this.chosen.value, all.length - 1)];
  }

  async listen(): Promise<void> {
    for (;;) {
      try {
        const answer = await fetch(`feed?from=0&seen=${this.seen}`, { cache: "no-store" });
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
    if (standing.version === this.seen) return;
    this.seen = standing.version;
    this.standing.value = standing;
    this.choose(0);
  }

  choose(index: number): void {
    this.chosen.value = index;
    this.frame.value = this.question?.first ?? 0;
    this.playing.value = true;
  }

  go(frame: number): void {
    const question = this.question;
    if (question !== undefined) this.frame.value = Math.min(Math.max(frame, question.first), question.last);
  }

  async answer(answer: string, other = ""): Promise<void> {
    const question = this.question;
    if (answer !== "undo" && question === undefined) return;
    const about = answer === "undo" ? {} : { frame: question!.frame, target: question!.target };
    await this.ask({ do: "answer", answer, ...about, ...(other === "" ? {} : { other }) });
  }

  async ask(what: object): Promise<void> {
    this.problem.value = "";
    try {
      const headers = { "Content-Type": "application/json" };
      const answer = await fetch("do", { method: "POST", headers, body: JSON.stringify(what) });
      const said = (await answer.json().catch(() => ({}))) as { error?: string };
      if (!answer.ok) this.problem.value = said.error ?? "the command refused";
    } catch {
      this.problem.value = "the command gives no answer";
    }
  }
}

/** Other targets that it may be, in the order of their numbers on the keyboard. */
const others = (question: Question) =>
  [...new Set(question.candidates.filter((one) => one.frame !== null && one.target !== question.target).map((one) => one.target))].slice(0, 9);

export function listenIdentities(queue: Queue): void {
  document.addEventListener("keydown", (event) => {
    const inside = event.target instanceof Element ? event.target : null;
    if (event.ctrlKey || event.metaKey || event.altKey || inside?.matches("input:not([type=range])")) return;
    if ((event.key === " " || event.key === "Enter") && inside?.matches("button")) return;
    const question = queue.question;
    const doing: Record<string, () => void> = {
      k: () => void queue.answer("keep"),
      s: () => void queue.answer("swap", question?.swap ?? ""),
      n: () => void queue.answer("new"),
      x: () => void queue.answer("skip"),
      u: () => void queue.answer("undo"),
      ArrowLeft: () => ((queue.playing.value = false), queue.go(queue.frame.value - 1)),
      ArrowRight: () => ((queue.playing.value = false), queue.go(queue.frame.value + 1)),
      " ": () => (queue.playing.value = !queue.playing.value),
    };
    const name = question === undefined ? undefined : others(question)[Number(event.key) - 1];
    if (/^[1-9]$/.test(event.key) && name !== undefined) void queue.answer("same", name);
    else if (doing[event.key] !== undefined) doing[event.key]!();
    else return;
    event.preventDefault();
  });
}

export function IdentitiesApp({ queue }: { queue: Queue }) {
  const standing = queue.standing.value;
  useEffect(() => {
    const due = setInterval(() => {
      const question = queue.question;
      if (!queue.playing.peek() || question === undefined) return;
      queue.frame.value = queue.frame.peek() >= question.last ? question.first : queue.frame.peek() + 1;
    }, STEP_MS);
    return () => clearInterval(due);
  }, [queue]);
  if (standing === null) {
    return (
      <section class="wait" role="status">
        <i class="lamp" aria-hidden="true" />
        <p>{queue.isCut.value ? "The command gives no answer. Is it still there? Trying again …" : "Opening the run …"}</p>
      </section>
    );
  }
  const { about } = standing;
  const figures: [string, number][] = [
    ["answers", standing.answers],
    ["tracks renamed", standing.changed],
    ["still doubtful", standing.left_over],
  ];
  return (
    <>
      <header class="top">
        <div>
          <h1>Who is who</h1>
          <p>
            <span class="source">{about.name}</span> · {about.frames} frames · {about.width} × {about.height} px
          </p>
        </div>
        <dl class="headline">
          {figures.map(([name, number]) => (
            <div key={name}>
              <dt>{name}</dt>
              <dd>{number}</dd>
            </div>
          ))}
        </dl>
      </header>
      <main class="annotate">
        <div class="left">
          <Sight queue={queue} />
        </div>
        <Panel queue={queue} />
      </main>
    </>
  );
}

/** The part of the frame with the shape of the whole frame, around a part of it. */
function widened([x, y, w, h]: Box, width: number, height: number): Box {
  const scale = Math.max(w / width, h / height);
  const left = Math.min(Math.max(x + (w - scale * width) / 2, 0), (1 - scale) * width);
  const top = Math.min(Math.max(y + (h - scale * height) / 2, 0), (1 - scale) * height);
  return [left, top, scale * width, scale * height];
}

function Sight({ queue }: { queue: Queue }) {
  const { width, height } = queue.standing.value!.about;
  const question = queue.question;
  const frame = queue.frame.value;
  if (question === undefined) return null;
  const names = Object.keys(question.boxes);
  // As much of the frame as holds all that is asked about, and a margin.
  const all = names.flatMap((name) => question.boxes[name]!.filter((box): box is Box => box !== null));
  const low = [0, 1].map((k) => Math.max(Math.min(...all.map((box) => box[k]!)) - 40, 0));
  const high = [0, 1].map((k) => Math.min(Math.max(...all.map((box) => box[k]! + box[k + 2]!)) + 40, [width, height][k]!));
  const [x, y, w, h] = widened([low[0]!, low[1]!, high[0]! - low[0]!, high[1]! - low[1]!], width, height);
  const unit = Math.max(w, h) / 700;
  return (
    <section class="shown" aria-label="Frame" style={{ maxWidth: `calc(74vh * ${w / h})` }}>
      <div class="sheet frame" style={{ aspectRatio: `${w} / ${h}` }}>
        <svg viewBox={`${x} ${y} ${w} ${h}`} role="img" aria-label={`Frame ${frame}`}>
          <image href={`picture?frame=${frame}`} x="0" y="0" width={width} height={height} />
          {names.map((name, index) => {
            const box = question.boxes[name]![frame - question.first];
            if (box == null) return null;
            const isIt = name === question.target && frame >= question.frame;
            return (
              <g key={name} class={`who who-${index % 8}${isIt ? " asked" : ""}`}>
                <rect x={box[0]} y={box[1]} width={box[2]} height={box[3]} stroke-width={(isIt ? 4 : 2) * unit} />
                <text x={box[0]} y={box[1] - 6 * unit} font-size={15 * unit} stroke-width={4 * unit}>
                  {isIt ? `${name} ?` : name}
                </text>
              </g>
            );
          })}
        </svg>
      </div>
      <div class="transport">
        <label class="now">
          <span>
            frame <b>{frame}</b> <small>clear again from frame {question.frame}</small>
          </span>
          <input
            type="range"
            aria-label="Frame"
            min={question.first}
            max={question.last}
            value={frame}
            onInput={(event) => ((queue.playing.value = false), queue.go(Number(event.currentTarget.value)))}
          />
        </label>
      </div>
    </section>
  );
}

function Panel({ queue }: { queue: Queue }) {
  const standing = queue.standing.value!;
  const question = queue.question;
  return (
    <section class="boxes ask-panel" aria-label="Question and answer">
      <p class={`standing ${question === undefined ? "" : "asks"}`} role="status">
        <i class="lamp" aria-hidden="true" />
        <b>
          {question === undefined
            ? "No doubtful decision remains. Press Finish."
            : `Who is target ${question.target} from frame ${question.frame} on?`}
        </b>
      </p>
      {question !== undefined && (
        <>
          <dl class="numbers">
            {question.candidates.slice(0, 4).map((one) => (
              <div key={`${one.target}/${one.frame}`}>
                <dt>{one.frame === null ? "a new target" : `target ${one.target} of frame ${one.frame}`}</dt>
                <dd>{Math.round(100 * one.probability)} %</dd>
              </div>
            ))}
          </dl>
          <div class="controls">
            <button type="button" disabled={!question.keep} onClick={() => void queue.answer("keep")}>
              Keep {question.target} <kbd>k</kbd>
            </button>
            <button type="button" disabled={question.swap === ""} onClick={() => void queue.answer("swap", question.swap)}>
              Swap with {question.swap || "–"} <kbd>s</kbd>
            </button>
            {others(question).map((name, index) => (
              <button key={name} type="button" onClick={() => void queue.answer("same", name)}>
                Same as {name} <kbd>{index + 1}</kbd>
              </button>
            ))}
            <button type="button" onClick={() => void queue.answer("new")}>
              New <kbd>n</kbd>
            </button>
            <button type="button" onClick={() => void queue.answer("skip")}>
              Skip <kbd>x</kbd>
            </button>
            <button type="button" disabled={standing.answers === 0} onClick={() => void queue.answer("undo")}>
              Undo <kbd>u</kbd>
            </button>
          </div>
          <div class="targets">
            {standing.questions.map((one, index) => (
              <button key={`${one.target}/${one.frame}`} type="button" aria-pressed={one === question} onClick={() => queue.choose(index)}>
                {one.target}, frame {one.frame}
              </button>
            ))}
          </div>
        </>
      )}
      {question === undefined && standing.answers > 0 && (
        <div class="controls">
          <button type="button" onClick={() => void queue.answer("undo")}>
            Undo <kbd>u</kbd>
          </button>
        </div>
      )}
      {queue.isCut.value && (
        <p class="problem" role="alert">
          {standing.left ? "The tracks are written. This page can be closed." : "The command gives no answer. Is it still there? Trying again …"}
        </p>
      )}
      {queue.problem.value !== "" && (
        <p class="problem" role="alert">
          {queue.problem.value}
        </p>
      )}
      <div class="controls finish">
        <button type="button" disabled={standing.left} onClick={() => void queue.ask({ do: "leave" })}>
          {standing.left ? "Writing …" : "Finish"}
        </button>
        <span class="hint">Answers are saved at once; the tracks are written to {standing.about.out} when you finish.</span>
      </div>
    </section>
  );
}
