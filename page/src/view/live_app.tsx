/** The page of a run in progress: first the boxes to start with, then the run. */

import type { Asked, Phase } from "../control";
import type { Live } from "../live";
import { App } from "./app";
import { StartBoxes } from "./start_boxes";

export function LiveApp({ live }: { live: Live }) {
  const state = live.state.value;
  if (state !== null && state.count.value > 0) return <App state={state} />;
  const about = live.status.value?.about ?? {};
  const phase = live.phase.value;
  return (
    <>
      <header class="top">
        <div>
          <h1>{about.graph ?? "bayesnet-track"}</h1>
          <p>
            {about.source !== undefined && (
              <>
                on <span class="source">{about.source}</span> · {about.width} × {about.height} px
              </>
            )}
          </p>
        </div>
      </header>
      {phase === "choosing" && about.width ? <StartBoxes live={live} about={about} /> : <Wait live={live} phase={phase} about={about} />}
    </>
  );
}

const WORDS: Record<Phase, string> = {
  opening: "Opening the video …",
  choosing: "Opening the video …",
  starting: "Starting. The first time this takes some seconds: the numeric kernels are compiled.",
  running: "Waiting for the first target …",
  paused: "Paused before the first target.",
  ended: "The run has ended. No target was tracked.",
};

function Wait({ live, phase, about }: { live: Live; phase: Phase; about: Asked }) {
  return (
    <section class="wait" role="status">
      {phase !== "ended" && !live.isCut.value && <i class="lamp" aria-hidden="true" />}
      <p>{live.isCut.value ? "The run gives no answer. Is it still there? Trying again …" : WORDS[phase]}</p>
      {live.problem.value !== "" && <p class="problem" role="alert">{live.problem.value}</p>}
      {about.out && phase === "ended" && <p>Its files are in {about.out}.</p>}
    </section>
  );
}
