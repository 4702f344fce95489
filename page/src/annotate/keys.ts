/** The keyboard of annotating. */

import type { Box, Desk } from "./desk";
import { fitted } from "../view/box_edit";

export const KEYS: [string, string][] = [
  ["Enter", "give the drawn box; without one, the box shown is correct"],
  ["g", "gone: it cannot be seen from this frame on"],
  ["u", "undo the last answer (also Ctrl+Z)"],
  ["q", "go to the question that is open"],
  ["e", "edit: take the box shown as the drawn one"],
  ["← →", "one frame back or on, with Shift ten; of a drawn box: move it, with Shift change its size"],
  [", .", "one frame back or on, also with a drawn box"],
  ["[ ]", "previous or next answered frame"],
  ["t", "another target"],
  ["1 … 9", "answer about target 1 … 9"],
  ["Space", "play or pause"],
  ["Esc", "drop the drawn box"],
  ["?", "this help"],
];

const MOVES: Record<string, [number, number]> = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

export function listen(desk: Desk): void {
  document.addEventListener("keydown", (event) => {
    const inside = event.target instanceof Element ? event.target : null;
    if (inside?.matches("input:not([type=range]), select, textarea")) return;
    if ((event.ctrlKey || event.metaKey) && event.key === "z") {
      event.preventDefault();
      return void desk.answer("undo");
    }
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    // A focused button is pressed by Enter and Space.
    if ((event.key === " " || event.key === "Enter") && inside?.matches("button, a, summary")) return;
    if (act(desk, event)) event.preventDefault();
  });
}

function act(desk: Desk, event: KeyboardEvent): boolean {
  const { key, shiftKey } = event;
  if (desk.help.value && key !== "?") {
    desk.help.value = false;
    return true;
  }
  const [drawn, about] = [desk.drawn.value, desk.about.value];
  const move = MOVES[key];
  if (move !== undefined && drawn !== null && about !== undefined) {
    const [x, y, w, h] = drawn;
    const next: Box = shiftKey ? [x, y, Math.max(3, w + move[0]), Math.max(3, h + move[1])] : [x + move[0], y + move[1], w, h];
    desk.drawn.value = fitted(next, about.width, about.height);
    return true;
  }
  const by = shiftKey ? 10 : 1;
  const doing: Record<string, () => void> = {
    Enter: () => void desk.answer(drawn === null ? "correct" : "box"),
    g: () => void desk.answer("gone"),
    u: () => void desk.answer("undo"),
    q: () => desk.toQuestion(),
    e: () => edit(desk),
    ArrowLeft: () => desk.go(desk.frame.value - by),
    ArrowRight: () => desk.go(desk.frame.value + by),
    ",": () => desk.go(desk.frame.value - 1),
    ".": () => desk.go(desk.frame.value + 1),
    Home: () => desk.go(0),
    End: () => desk.go(Number.MAX_SAFE_INTEGER),
    "[": () => desk.toGiven(-1),
    "]": () => desk.toGiven(1),
    t: () => desk.add(desk.nextName()),
    " ": () => (desk.playing.value = !desk.playing.value),
    Escape: () => (desk.drawn.value = null),
    "?": () => (desk.help.value = !desk.help.value),
  };
  const found = doing[key];
  if (found !== undefined) found();
  else if (/^[1-9]$/.test(key) && desk.names[Number(key) - 1] !== undefined) {
    desk.target.value = desk.names[Number(key) - 1]!;
    desk.drawn.value = null;
  } else return false;
  return true;
}

/** The box shown becomes one that can be changed. */
export function edit(desk: Desk): void {
  const box = desk.current.value?.boxes[desk.frame.value];
  const about = desk.about.value;
  if (box != null && about !== undefined) desk.drawn.value = fitted(box, about.width, about.height);
}
