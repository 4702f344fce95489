/** The picture of the frame with what is believed over it. */

import { useSignal, useSignalEffect } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import type { Picture } from "../pictures";
import type { Layer, State } from "../state";
import { Painter, type View } from "./paint";

const LAYERS: [Layer, string, string][] = [
  ["cloud", "hypotheses", "boxes drawn from the posterior, and their centres"],
  ["regions", "regions", "where the centre is with 50 % (solid) and 90 % (dashed)"],
  ["map", "most probable", "centre of the most probable box"],
  ["parts", "parts", "parts of the target; dashed where they are not seen"],
  ["truth", "truth", "the true box, dotted white"],
  ["shapes", "lines, areas", "lines and polygons that queries ask about"],
  ["others", "other targets", "the other targets' estimates"],
];

/** A box to tick for each layer that can be drawn: its name, and what it shows. */
export function Layers({ state, of }: { state: State; of: [Layer, string, string][] }) {
  return (
    <>
      {of.map(([layer, name, title]) => (
        <label key={layer} title={title}>
          <input type="checkbox" checked={state.layers.value.has(layer)} onChange={() => state.toggle(layer)} />
          <i class={`key key-${layer}`} aria-hidden="true" />
          {name}
        </label>
      ))}
    </>
  );
}

export function Stage({ state }: { state: State }) {
  const canvas = useRef<HTMLCanvasElement>(null);
  const shown = useRef<{ picture: Picture | null; view: View } | null>(null);
  const { run } = state;

  useEffect(() => {
    const watch = new ResizeObserver(() => (state.look.value += 1));
    watch.observe(canvas.current!.parentElement!);
    return () => watch.disconnect();
  }, [state]);

  useSignalEffect(() => {
    const frame = state.frame.value;
    const pictures = state.pictures.value;
    // What is read here is drawn again when it changes.
    void [state.target.value, state.layers.value, state.close.value, state.look.value, state.version.value];
    let stale = false;
    const draw = (picture: Picture | null) => {
      if (stale || canvas.current === null) return;
      shown.current = { picture, view: paint(canvas.current, state, picture) };
      if (pictures !== null) canvas.current.dataset.frame = String(frame);
    };
    if (pictures === null) draw(null);
    else {
      // Until the new picture is there, the old one stays, with the new boxes on it only if it is quick.
      const late = setTimeout(() => draw(shown.current?.picture ?? null), 60);
      void pictures.of(frame).then((picture) => {
        clearTimeout(late);
        draw(picture);
      });
    }
    return () => {
      stale = true;
    };
  });

  const pick = (event: MouseEvent) => {
    const view = shown.current?.view;
    if (view === undefined) return;
    const x = event.offsetX / view.scale + view.x - 0.5;
    const y = event.offsetY / view.scale + view.y - 0.5;
    const id = nearest(state, x, y);
    if (id !== null) state.target.value = id;
  };

  const has: Partial<Record<Layer, boolean>> = {
    cloud: true,
    regions: true,
    map: true,
    parts: [...run.tracks.values()].some((track) => track.parts.length > 0),
    truth: run.truth !== null && run.truthTarget !== null,
    others: run.tracks.size > 1,
    shapes: Object.values(run.queries).some((query) => query.corners.length > 0),
  };
  const pictures = state.pictures.value;
  return (
    <section class={pictures?.without ? "stage bare" : "stage"} aria-label="Frame">
      <div class="picture">
        <canvas ref={canvas} role="img" aria-label={describe(state)} onClick={pick} />
        {pictures !== null && pictures.without !== "" && <p class="without">No pictures: {pictures.without}</p>}
      </div>
      <fieldset class="layers">
        <legend>Show</legend>
        <Layers state={state} of={LAYERS.filter(([layer]) => has[layer])} />
        <label title="key z">
          <input type="checkbox" checked={state.close.value} onChange={() => (state.close.value = !state.close.value)} />
          close up
        </label>
        <span class="take">
          <button type="button" title="this frame with what is drawn on it, as PNG" onClick={() => save(canvas.current!, state)}>
            save picture
          </button>
          {state.live === null && <CopyLink />}
        </span>
        {pictures?.annotated && <small>Pictures from the run's annotated video.</small>}
      </fieldset>
    </section>
  );
}

/** Offers the canvas as a file that names the run, the frame and the target. */
function save(canvas: HTMLCanvasElement, state: State): void {
  const { about } = state.run;
  const name = [about.name || about.graph, `frame_${state.frame.value}`, ...(state.run.tracks.size > 1 ? [`target_${state.target.value}`] : [])];
  canvas.toBlob((picture) => {
    if (picture === null) return;
    const link = document.createElement("a");
    link.href = URL.createObjectURL(picture);
    link.download = `${name.join("_").replaceAll(/[^\w.-]+/g, "_")}.png`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
  });
}

/** The address names frame and target (`main.tsx`); a page inside a notebook has none. */
export function CopyLink() {
  const told = useSignal("copy link");
  const copy = () => {
    const copied = navigator.clipboard?.writeText(location.href) ?? Promise.reject(new Error("no clipboard"));
    copied
      .then(() => (told.value = "copied"))
      .catch(() => (told.value = "copy the address bar"))
      .finally(() => setTimeout(() => (told.value = "copy link"), 2000));
  };
  if (location.protocol === "about:") return null;
  return (
    <button type="button" title="a link to this frame" onClick={copy}>
      {told.value}
    </button>
  );
}

function describe(state: State): string {
  const { track, row, frame } = state;
  if (track.value === undefined || row.value < 0) return `Frame ${frame.value}: no target ${state.target.value}`;
  const [x, y, w, h] = track.value.values("box", row.value).map(Math.round);
  return `Frame ${frame.value}: target ${track.value.id} ${track.value.status(row.value)}, centre ${x}, ${y}, ${w} by ${h} pixels`;
}

function paint(canvas: HTMLCanvasElement, state: State, picture: Picture | null): View {
  const { run } = state;
  const [w, h] = [run.about.width, run.about.height];
  const wide = canvas.parentElement!.clientWidth;
  const most = Math.max(240, Math.min(window.innerHeight * 0.66, 720));
  const whole = Math.min(wide / w, most / h);
  const ratio = window.devicePixelRatio || 1;
  const [cw, ch] = [Math.round(w * whole), Math.round(h * whole)];
  if (canvas.width !== Math.round(cw * ratio) || canvas.height !== Math.round(ch * ratio)) {
    [canvas.width, canvas.height] = [Math.round(cw * ratio), Math.round(ch * ratio)];
    canvas.style.width = `${cw}px`;
    canvas.style.height = `${ch}px`;
  }
  const view = viewOf(state, whole, cw, ch);
  const g = canvas.getContext("2d")!;
  g.setTransform(ratio, 0, 0, ratio, 0, 0);
  g.fillStyle = "#20262e";
  g.fillRect(0, 0, cw, ch);
  // One of a later frame would show what was not there yet.
  const isLate = picture !== null && picture.frame > state.frame.value;
  if (picture !== null && !isLate) {
    g.imageSmoothingQuality = "high";
    g.drawImage(picture.image, -view.x * view.scale, -view.y * view.scale, w * view.scale, h * view.scale);
  }
  const painter = new Painter(g, view);
  const frame = state.frame.value;
  if (state.layers.value.has("shapes")) {
    for (const [name, query] of Object.entries(run.queries)) painter.shape(name, query.corners);
  }
  if (state.layers.value.has("others")) {
    for (const track of run.tracks.values()) {
      const row = track.rowOf(frame);
      if (row >= 0 && track.id !== state.target.value) painter.other(track, row);
    }
  }
  const [track, row] = [state.track.value, state.row.value];
  if (track !== undefined && row >= 0) {
    for (const doubt of run.doubtsOf(track.id, frame)) {
      const other = run.tracks.get(doubt.other);
      const place = other?.rowOf(frame) ?? -1;
      if (frame <= doubt.until && place >= 0) painter.doubt(track.values("box", row), other!.values("box", place), doubt.probability);
    }
    painter.target(run, track, row, state.layers.value);
  }
  if (picture !== null && picture.frame !== frame) {
    g.font = "11px system-ui, sans-serif";
    g.textBaseline = "alphabetic";
    const text = isLate ? "no picture of this frame" : `picture of frame ${picture.frame}`;
    g.fillStyle = "rgba(12,17,24,.7)";
    g.fillRect(cw - g.measureText(text).width - 12, ch - 19, g.measureText(text).width + 12, 19);
    g.fillStyle = "#e8edf3";
    g.fillText(text, cw - g.measureText(text).width - 6, ch - 6);
  }
  return view;
}

/** The whole picture, or what lies around the target. */
function viewOf(state: State, whole: number, cw: number, ch: number): View {
  const [track, row] = [state.track.value, state.row.value];
  if (!state.close.value || track === undefined || row < 0) return { x: 0, y: 0, scale: whole };
  const [x, y, w, h] = track.values("box", row) as [number, number, number, number];
  const scale = Math.min(Math.max(Math.min(cw / (w * 4), ch / (h * 3)), whole), whole * 8);
  const place = (centre: number, shown: number, size: number) => Math.min(Math.max(centre + 0.5 - shown / 2, 0), size - shown);
  return {
    x: place(x, cw / scale, state.run.about.width),
    y: place(y, ch / scale, state.run.about.height),
    scale,
  };
}

/** The target whose box holds a point, the smallest one first. */
function nearest(state: State, x: number, y: number): string | null {
  let best: string | null = null;
  let area = Infinity;
  for (const track of state.run.tracks.values()) {
    const row = track.rowOf(state.frame.value);
    if (row < 0) continue;
    const [cx, cy, w, h] = track.values("box", row) as [number, number, number, number];
    if (Math.abs(x - cx) <= w / 2 + 4 && Math.abs(y - cy) <= h / 2 + 4 && w * h < area) [best, area] = [track.id, w * h];
  }
  return best;
}
