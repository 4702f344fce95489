/** Opens the page's own data and shows it. */

import { options, render } from "preact";
import { AnnotateApp } from "./annotate/app";
import { Desk } from "./annotate/desk";
import { listen as listenAnnotate } from "./annotate/keys";
import { IdentitiesApp, listenIdentities, Queue } from "./identities/app";
import { bytesOf, open } from "./data/packed";
import { listen } from "./keys";
import { Live } from "./live";
import { none, picturesOf } from "./pictures";
import { State } from "./state";
import { App } from "./view/app";
import { LiveApp } from "./view/live_app";
import "uplot/dist/uPlot.min.css";
import "./style.css";

async function start(root: HTMLElement): Promise<void> {
  const opened = await open(bytesOf(document.getElementById("run-data")?.textContent ?? ""));
  const state = new State(opened.run);
  fromAddress(state);
  root.replaceChildren();
  render(<App state={state} />, root);
  root.dataset.ready = String(Math.round(performance.now()));
  listen(state);
  toAddress(state);
  redraw(state);
  state.pictures.value = await picturesOf(opened).catch((error: unknown) => none(String(error)));
}

/** The page of a run in progress: its server has the data. */
function watch(root: HTMLElement): void {
  const live = new Live();
  let shown: State | null = null;
  live.state.subscribe((state) => {
    if (state === null || state === shown) return;
    shown = state;
    document.title = `${state.run.about.graph} on ${state.run.about.source}`;
    listen(state);
    redraw(state);
  });
  root.replaceChildren();
  render(<LiveApp live={live} />, root);
  root.dataset.ready = String(Math.round(performance.now()));
  void live.listen();
}

/** The page of a session of annotating. */
function annotate(root: HTMLElement): void {
  const desk = new Desk();
  root.replaceChildren();
  render(<AnnotateApp desk={desk} />, root);
  listenAnnotate(desk);
  root.dataset.ready = String(Math.round(performance.now()));
  void desk.listen();
}

/** The page that asks who is who in a run. */
function identities(root: HTMLElement): void {
  const queue = new Queue();
  root.replaceChildren();
  render(<IdentitiesApp queue={queue} />, root);
  listenIdentities(queue);
  root.dataset.ready = String(Math.round(performance.now()));
  void queue.listen();
}

/** `#frame=120&target=2` leads to a frame of a target; without a target, to the first one that is there. */
function fromAddress(state: State): void {
  const asked = new URLSearchParams(location.hash.slice(1));
  const [frame, target] = [asked.get("frame"), asked.get("target")];
  if (target !== null && state.run.tracks.has(target)) state.target.value = target;
  if (frame === null || !Number.isFinite(Number(frame))) return;
  state.go(Number(frame));
  if (target === null && (state.track.value?.rowOf(state.frame.value) ?? -1) < 0) {
    const there = [...state.run.tracks].find(([, track]) => track.rowOf(state.frame.value) >= 0);
    if (there !== undefined) state.target.value = there[0];
  }
}

function toAddress(state: State): void {
  let due = 0;
  const write = () => {
    const asked = new URLSearchParams({ frame: String(state.frame.value) });
    if (state.run.tracks.size > 1) asked.set("target", state.target.value);
    try {
      history.replaceState(null, "", `#${asked}`);
    } catch {
      // Some browsers refuse this for files, or when it comes too often.
    }
  };
  const later = () => {
    window.clearTimeout(due);
    due = window.setTimeout(write, 300);
  };
  state.frame.subscribe(later);
  state.target.subscribe(later);
  window.addEventListener("hashchange", () => fromAddress(state));
}

/** Canvases know nothing of style sheets: they are drawn again when the colours change. */
function redraw(state: State): void {
  const again = () => (state.look.value += 1);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", again);
  matchMedia("print").addEventListener("change", again);
  // They are drawn before the page is laid out for paper: there is no frame of animation in between.
  window.addEventListener("beforeprint", () => {
    document.documentElement.dataset.print = "";
    const usual = options.requestAnimationFrame;
    options.requestAnimationFrame = (flush) => flush();
    again();
    options.requestAnimationFrame = usual;
  });
  window.addEventListener("afterprint", () => {
    delete document.documentElement.dataset.print;
    again();
  });
}

const root = document.getElementById("page");
if (root?.dataset.live !== undefined) watch(root);
else if (root?.dataset.identities !== undefined) identities(root);
else if (root?.dataset.annotate !== undefined) annotate(root);
else if (root !== null) {
  start(root).catch((error: unknown) => {
    const words = document.createElement("p");
    words.className = "nothing";
    words.textContent = `This page cannot be shown: ${error instanceof Error ? error.message : String(error)}. It needs a browser of 2023 or later.`;
    root.replaceChildren(words);
  });
}
