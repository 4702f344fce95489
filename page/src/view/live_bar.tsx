/** How the run in progress stands, and what one can do with it. */

import { useSignal } from "@preact/signals";
import { useEffect } from "preact/hooks";
import type { Control } from "../control";
import type { State } from "../state";
import { Icon } from "./transport";
import { plural, short } from "./words";

const SURE_MS = 3000;

export function LiveBar({ state, live }: { state: State; live: Control }) {
  const phase = live.phase.value;
  const isOn = live.isOn.value;
  const isPaused = phase === "paused";
  const status = live.status.value;
  const behind = state.run.last - state.frame.value;
  void state.version.value;
  return (
    <section class={`live ${live.isCut.value && isOn ? "cut" : phase}`} aria-label="The run in progress">
      <p class="standing" role="status">
        <i class="lamp" aria-hidden="true" />
        <Standing state={state} live={live} />
      </p>
      <div class="controls">
        {isOn && (
          <>
            <button type="button" class="main" onClick={() => live.pauseOrGo()} disabled={status?.stopping} title="space">
              <Icon d={isPaused ? "M6 3.5 16 10 6 16.5z" : "M6 4h3v12H6zM11 4h3v12h-3z"} />
              {isPaused ? "Go on" : "Pause"}
            </button>
            <button type="button" onClick={() => live.step()} disabled={status?.stopping} title="one frame, then wait (.)">
              <Icon d="M4 4l8 6-8 6zM15 4v12" />
              One frame
            </button>
            <Stop live={live} stopping={status?.stopping ?? false} />
          </>
        )}
        {phase === "ended" && !live.isCut.value && (
          <button type="button" onClick={() => void live.ask({ do: "leave" })} title="the command ends; this page stays">
            Close the view
          </button>
        )}
        {isOn && !state.following.value && (
          <button type="button" class="catch-up" onClick={() => state.goLive()} title="to the newest frame (l)">
            Live: {plural(behind, "frame")} ahead
            <Icon d="M4 4l8 6-8 6zM15 4v12" />
          </button>
        )}
      </div>
      {live.problem.value !== "" && (
        <p class="problem" role="alert">
          {live.problem.value}
          <button type="button" onClick={() => (live.problem.value = "")} aria-label="Close this message">
            ×
          </button>
        </p>
      )}
    </section>
  );
}

function Standing({ state, live }: { state: State; live: Control }) {
  const status = live.status.value;
  const { run } = state;
  const expected = status?.about.expected;
  const at = (
    <>
      frame {run.last}
      {expected ? ` of ${run.first + expected - 1}` : ""}
    </>
  );
  if (live.phase.value === "ended" || run.about.ended !== null) {
    const ended = run.about.ended;
    const how = status?.stopping ? "You stopped the run" : ended?.complete ? "The run has ended" : `The run ended early (${ended?.reason.replaceAll("_", " ") ?? "error"})`;
    return (
      <span>
        <b>{how}</b> after {plural(run.last - run.first + 1, "frame")}.{" "}
        {live.isCut.value ? "The view is closed; this page stays as it is." : status?.about.out ? `Its files are in ${status.about.out}.` : ""}
      </span>
    );
  }
  if (live.isCut.value) return <span><b>No answer</b> since {at}: trying again</span>;
  if (live.phase.value === "paused") return <span><b>Paused</b> at {at}</span>;
  return (
    <span>
      <b>{status?.stopping ? "Stopping" : "Live"}</b> at {at}
      {(status?.rate ?? 0) > 0 && <> · {short(Math.round(10 * status!.rate) / 10)} frames/s</>}
    </span>
  );
}

/** Stopping is for good: it has to be pressed twice. */
function Stop({ live, stopping }: { live: Control; stopping: boolean }) {
  const isSure = useSignal(false);
  useEffect(() => {
    if (!isSure.value) return;
    const due = setTimeout(() => (isSure.value = false), SURE_MS);
    return () => clearTimeout(due);
  }, [isSure.value]);
  const press = () => {
    if (isSure.value) void live.ask({ do: "stop" });
    isSure.value = !isSure.value;
  };
  return (
    <button type="button" class={isSure.value ? "sure" : ""} onClick={press} disabled={stopping} title="end the run here; what was tracked so far is kept">
      <Icon d="M5 5h10v10H5z" />
      {isSure.value ? "Stop for good?" : "Stop"}
    </button>
  );
}
