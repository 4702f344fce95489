/** The page on which a video is annotated: picture, question, timelines. */

import { useSignal } from "@preact/signals";
import { useEffect } from "preact/hooks";
import { Icon } from "../view/transport";
import { counted, tidy, type Desk, type Target } from "./desk";
import { edit, KEYS } from "./keys";
import { Picture } from "./picture";
import { Timelines } from "./timelines";

const WORDS: Record<string, string> = { g: "given", t: "tracked", i: "interpolated", x: "gone", ".": "not known yet" };

export function AnnotateApp({ desk }: { desk: Desk }) {
  const standing = desk.standing.value;
  if (standing === null) {
    return (
      <section class="wait" role="status">
        <i class="lamp" aria-hidden="true" />
        <p>{desk.isCut.value ? "The command gives no answer. Is it still there? Trying again …" : "Opening the session …"}</p>
      </section>
    );
  }
  const { about } = standing;
  return (
    <>
      <header class="top">
        <div>
          <h1>Annotate</h1>
          <p>
            <span class="source">{about.name}</span> · {about.frames} frames · {about.width} × {about.height} px
          </p>
        </div>
        <Headline desk={desk} />
      </header>
      <main class="annotate">
        <div class="left">
          <Picture desk={desk} />
          <Bar desk={desk} />
          <Timelines desk={desk} />
        </div>
        <Panel desk={desk} />
      </main>
      {desk.help.value && <Help desk={desk} />}
    </>
  );
}

function Headline({ desk }: { desk: Desk }) {
  const count = counted(desk.targets.value, desk.about.value!.frames);
  const figures: [string, number][] = [
    ["answers", desk.standing.value!.answers],
    ["tracked", count("t")],
    ["interpolated", count("i")],
    ["gone", count("x")],
    ["not known yet", count(".")],
  ];
  return (
    <dl class="headline">
      {figures.map(([name, number]) => (
        <div key={name}>
          <dt>{name}</dt>
          <dd>{number}</dd>
        </div>
      ))}
    </dl>
  );
}

function Bar({ desk }: { desk: Desk }) {
  useEffect(() => play(desk), [desk]);
  const last = desk.about.value!.frames - 1;
  const playing = desk.playing.value;
  return (
    <section class="transport" aria-label="Time">
      <div class="buttons">
        <button type="button" onClick={() => desk.toGiven(-1)} aria-label="Previous answered frame" title="previous answered frame ([)">
          <Icon d="M5 4v12M16 4 8 10l8 6z" />
        </button>
        <button type="button" class="play" onClick={() => (desk.playing.value = !playing)} aria-label={playing ? "Pause" : "Play"} title="play or pause (space)">
          <Icon d={playing ? "M6 4h3v12H6zM11 4h3v12h-3z" : "M6 3.5 16 10 6 16.5z"} />
        </button>
        <button type="button" onClick={() => desk.toGiven(1)} aria-label="Next answered frame" title="next answered frame (])">
          <Icon d="M15 4v12M4 4l8 6-8 6z" />
        </button>
        <output class="now">
          frame <b>{desk.frame.value}</b> <small>of {last}</small>
        </output>
        <button type="button" class="ask" onClick={() => (desk.help.value = true)} aria-label="Help: keyboard" title="help (?)">
          ?
        </button>
      </div>
    </section>
  );
}

function Panel({ desk }: { desk: Desk }) {
  const standing = desk.standing.value!;
  const [target, frame, drawn] = [desk.current.value, desk.frame.value, desk.drawn.value];
  const how = target?.how[frame] ?? ".";
  const question = desk.question.value;
  const isHere = question !== undefined && question.frame === frame && question.target === desk.target.value;
  const isLeaving = useSignal(false);
  return (
    <section class="boxes ask-panel" aria-label="Question and answer">
      <p class={`standing ${standing.behind ? "busy" : question === undefined ? "" : "asks"}`} role="status">
        <i class="lamp" aria-hidden="true" />
        <span>
          <Standing desk={desk} />
        </span>
      </p>
      {isHere && <p class="told uncertain reason">{question.reason}</p>}
      {question !== undefined && !isHere && !standing.behind && (
        <button type="button" class="to-question" onClick={() => desk.toQuestion()}>
          Question: {question.target}, frame {question.frame} <kbd>q</kbd>
        </button>
      )}
      <Names desk={desk} />
      <dl class="numbers">
        <div>
          <dt>{desk.target.value}, frame {frame}</dt>
          <dd>{drawn !== null ? "drawn, not given yet" : WORDS[how]}</dd>
        </div>
        <div>
          <dt>probability of being on target</dt>
          <dd>{drawn !== null || !"ti".includes(how) ? "–" : `${target!.percent[frame]} %`}</dd>
        </div>
      </dl>
      <div class="controls">
        {drawn !== null ? (
          <button type="button" class="main" onClick={() => void desk.answer("box")}>
            Give this box <kbd>Enter</kbd>
          </button>
        ) : (
          <button type="button" class="main" disabled={!"ti".includes(how)} onClick={() => void desk.answer("correct")}>
            Correct <kbd>Enter</kbd>
          </button>
        )}
        <button type="button" disabled={target === undefined} onClick={() => void desk.answer("gone")}>
          Gone <kbd>g</kbd>
        </button>
        <button type="button" disabled={drawn !== null || target?.boxes[frame] == null} onClick={() => edit(desk)}>
          Edit <kbd>e</kbd>
        </button>
        <button type="button" disabled={standing.answers === 0} onClick={() => void desk.answer("undo")}>
          Undo <kbd>u</kbd>
        </button>
      </div>
      {desk.isCut.value && (
        <p class="problem" role="alert">
          {standing.left ? "The annotations are written. This page can be closed." : "The command gives no answer. Is it still there? Trying again …"}
        </p>
      )}
      {desk.problem.value !== "" && (
        <p class="problem" role="alert">
          {desk.problem.value}
          <button type="button" onClick={() => (desk.problem.value = "")} aria-label="Close this message">
            ×
          </button>
        </p>
      )}
      <div class="controls finish">
        <button
          type="button"
          disabled={standing.left}
          onClick={() => {
            isLeaving.value = true;
            void desk.leave();
          }}
        >
          {isLeaving.value ? "Writing …" : "Finish"}
        </button>
        <span class="hint">Every answer is kept at once. The annotations are written to {about(desk).out} at the end.</span>
      </div>
    </section>
  );
}

const about = (desk: Desk) => desk.about.value!;

function Standing({ desk }: { desk: Desk }) {
  const { busy, behind, answers } = desk.standing.value!;
  const question = desk.question.value;
  if (behind) {
    return busy === null ? <>Tracking …</> : <>Tracking {busy.target}: frame {busy.frame} of {about(desk).frames - 1}</>;
  }
  if (answers === 0) return <b>Drag a box around the first target, in any frame where it can be seen well.</b>;
  if (question === undefined) return <b>No question is open. Look at the last frames of each target, then press Finish.</b>;
  return (
    <b>
      Where is {question.target} in frame {question.frame}?
    </b>
  );
}

function Names({ desk }: { desk: Desk }) {
  const written = useSignal("");
  return (
    <div class="targets">
      {desk.names.map((name, index) => (
        <button key={name} type="button" aria-pressed={name === desk.target.value} onClick={() => ((desk.target.value = name), (desk.drawn.value = null))}>
          <i class={`dot target-${index % 8}`} />
          {name}
        </button>
      ))}
      <form
        onSubmit={(event) => {
          event.preventDefault();
          desk.add(tidy(written.value) || desk.nextName());
          written.value = "";
          if (document.activeElement instanceof HTMLElement) document.activeElement.blur();
        }}
      >
        <input
          value={written.value}
          maxLength={80}
          placeholder={desk.nextName()}
          aria-label="Name of another target, such as car 1"
          onInput={(event) => (written.value = event.currentTarget.value)}
        />
        <button type="submit" title="another target (t)">
          Add target
        </button>
      </form>
    </div>
  );
}

function Help({ desk }: { desk: Desk }) {
  return (
    <div class="veil" onClick={() => (desk.help.value = false)}>
      <div class="help" role="dialog" aria-label="Help">
        <h3>Keyboard</h3>
        <dl>
          {KEYS.map(([keys, words]) => (
            <div key={keys}>
              <dt>
                {keys.split(" ").map((key) => (
                  <kbd key={key}>{key}</kbd>
                ))}
              </dt>
              <dd>{words}</dd>
            </div>
          ))}
        </dl>
        <button type="button" onClick={() => (desk.help.value = false)}>
          Close
        </button>
      </div>
    </div>
  );
}

/** Moves the frame on while playing; gives what stops it. */
function play(desk: Desk): () => void {
  const tick = () => {
    if (!desk.playing.peek()) return;
    if (desk.frame.peek() >= desk.about.peek()!.frames - 1) desk.playing.value = false;
    else desk.go(desk.frame.peek() + 1);
  };
  const due = setInterval(tick, Math.max(33, 1000 * (desk.about.peek()?.interval || 0.04)));
  return () => clearInterval(due);
}

export type { Target };
