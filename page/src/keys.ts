/** The keyboard. */

import type { State } from "./state";

export const KEYS: [string, string][] = [
  ["Space", "play or pause"],
  ["← →", "one frame back or on; with Shift, ten"],
  ["Home End", "first or last frame"],
  ["p n", "previous or next event"],
  ["[ ]", "previous or next target"],
  ["+ −", "shorter or longer stretch of the timelines; 0: the whole run"],
  ["z", "close to the target, or the whole picture"],
  ["?", "this help"],
];

/** Those of a run in progress besides, or instead. */
export const LIVE_KEYS: [string, string][] = [
  ["Space", "pause the run, or let it go on; while you look back, play what was"],
  [".", "take one frame"],
  ["l", "go to the newest frame, and follow"],
  ["Enter", "on an agent of the net: switch it by hand"],
];

export function listen(state: State): void {
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const inside = event.target instanceof Element ? event.target : null;
    if (inside?.matches("input:not([type=range]):not([type=checkbox]), select, textarea")) return;
    // A focused button or box is pressed by Space, and a list is walked through by arrows.
    if (event.key === " " && inside?.matches("button, [role=button], a, summary, input[type=checkbox]")) return;
    if (act(state, event)) event.preventDefault();
  });
}

function act(state: State, event: KeyboardEvent): boolean {
  const by = event.shiftKey ? 10 : 1;
  switch (event.key) {
    case " ":
      if (state.live?.isOn.value && state.following.value) state.live.pauseOrGo();
      else state.playing.value = !state.playing.value;
      return true;
    case "ArrowLeft":
      state.step(-by);
      return true;
    case "ArrowRight":
      state.step(by);
      return true;
    case "Home":
      state.go(state.run.first);
      return true;
    case "End":
      state.go(state.run.last);
      return true;
    case "n":
      state.stop(1);
      return true;
    case "p":
      state.stop(-1);
      return true;
    case "[":
      state.other(-1);
      return true;
    case "]":
      state.other(1);
      return true;
    case "+":
    case "=":
      state.zoom(0.5);
      return true;
    case "-":
      state.zoom(2);
      return true;
    case "0":
      state.zoom(Infinity);
      return true;
    case "z":
      state.close.value = !state.close.value;
      return true;
    case "l":
      state.goLive();
      return true;
    case ".":
      if (!state.live?.isOn.value) return false;
      state.live.step();
      return true;
    case "?":
      state.help.value = !state.help.value;
      return true;
    case "Escape":
      state.help.value = false;
      return true;
    default:
      return false;
  }
}
