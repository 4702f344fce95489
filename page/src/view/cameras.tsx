/** The images of several cameras side by side, and the ground that they see, in metres. */

import { useSignalEffect } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import type { Track } from "../data/run";
import type { CameraAbout } from "../data/types";
import type { Picture } from "../pictures";
import type { Layer, State } from "../state";
import { bounds, paintGround, type Ground } from "./ground";
import { Painter } from "./paint";
import { CopyLink, Layers } from "./stage";

const LAYERS: [Layer, string, string][] = [
  ["ellipses", "90 % ellipses", "where a target is with 90 %"],
  ["trails", "trails", "its last three seconds"],
  ["fields", "fields of view", "what each camera sees of the ground"],
  ["others", "other targets", "the targets that are not chosen"],
];
const GROUND = "ground";

export function Cameras({ state }: { state: State }) {
  const { cameras } = state.run;
  const pictures = state.pictures.value;
  return (
    <section class="stage cameras" aria-label="Cameras">
      <div class="tiles" style={{ gridTemplateColumns: `repeat(${layout(state).columns}, minmax(0, 1fr))` }}>
        {cameras.map((camera) => (
          <CameraTile key={camera.name} state={state} camera={camera} />
        ))}
        <GroundTile state={state} />
      </div>
      <fieldset class="layers">
        <legend>Show</legend>
        <Layers state={state} of={LAYERS} />
        <span class="take">
          <CopyLink />
        </span>
        {pictures !== null && pictures.without !== "" && <small>No pictures: {pictures.without}.</small>}
      </fieldset>
    </section>
  );
}

/** Columns of tiles, and over how many of them the ground, the last one, reaches. */
function layout(state: State): { columns: number; span: number } {
  void state.look.value;
  const many = state.run.cameras.length;
  const usual = state.camera.value !== "" ? Math.min(many, 4) : many > 3 ? 3 : 2;
  const columns = window.innerWidth < 560 ? 2 : usual;
  const before = many - (state.camera.value === "" || state.camera.value === GROUND ? 0 : 1);
  return { columns, span: columns - (before % columns) };
}

/** The name of a tile, which makes it large. */
function Name({ state, name }: { state: State; name: string }) {
  const isLarge = state.camera.value === name;
  return (
    <figcaption>
      <button type="button" aria-pressed={isLarge} title={isLarge ? "all of one size" : "enlarge"} onClick={() => (state.camera.value = isLarge ? "" : name)}>
        {name}
      </button>
    </figcaption>
  );
}

/** Draws a canvas as wide as its tile, anew when what is looked at changes. */
function useCanvas(state: State, draw: (canvas: HTMLCanvasElement, wide: number) => void) {
  const canvas = useRef<HTMLCanvasElement>(null);
  useEffect(() => {
    const watch = new ResizeObserver(() => (state.look.value += 1));
    watch.observe(canvas.current!.parentElement!);
    return () => watch.disconnect();
  }, [state]);
  useSignalEffect(() => {
    // What is read here is drawn again when it changes.
    void [state.frame.value, state.target.value, state.layers.value, state.look.value, state.camera.value, state.pictures.value];
    if (canvas.current !== null) draw(canvas.current, canvas.current.parentElement!.clientWidth);
  });
  return canvas;
}

/** A context in px of the page, for a canvas of this size. */
function prepare(canvas: HTMLCanvasElement, wide: number, high: number): CanvasRenderingContext2D {
  const ratio = window.devicePixelRatio || 1;
  [canvas.width, canvas.height] = [Math.round(wide * ratio), Math.round(high * ratio)];
  [canvas.style.width, canvas.style.height] = [`${wide}px`, `${high}px`];
  const g = canvas.getContext("2d")!;
  g.setTransform(ratio, 0, 0, ratio, 0, 0);
  g.fillStyle = "#20262e";
  g.fillRect(0, 0, wide, high);
  return g;
}

/** Those that live in the frame, the chosen one last. */
function drawn(state: State): [Track, number][] {
  const [frame, chosen] = [state.frame.value, state.target.value];
  const tracks = [...state.run.tracks.values()].filter((track) => track.id === chosen || state.layers.value.has("others"));
  const rows = tracks.map((track): [Track, number] => [track, track.rowOf(frame)]);
  return rows.filter(([, row]) => row >= 0).sort(([a], [b]) => Number(a.id === chosen) - Number(b.id === chosen));
}

function CameraTile({ state, camera }: { state: State; camera: CameraAbout }) {
  const { name, width, height } = camera;
  const shown = useRef<Picture | null>(null);
  const canvas = useCanvas(state, (element, wide) => {
    const frame = state.frame.value;
    const pictures = state.pictures.value;
    const show = () => {
      const scale = wide / width;
      const g = prepare(element, wide, Math.round(height * scale));
      if (shown.current !== null && shown.current.frame <= frame) {
        g.imageSmoothingQuality = "high";
        g.drawImage(shown.current.image, 0, 0, wide, height * scale);
      }
      const painter = new Painter(g, { x: 0, y: 0, scale });
      for (const [track, row] of drawn(state)) {
        const [x, y, w, h] = track.values(`cameras/${name}`, row) as [number, number, number, number];
        const isInside = Math.abs(2 * x - width) < w + width && Math.abs(2 * y - height) < h + height;
        if (isInside) painter.seen(track, row, name, track.id === state.target.value);
      }
      element.dataset.frame = String(frame);
    };
    if (pictures === null || pictures.without !== "") show();
    else {
      void pictures.of(frame, name).then((picture) => {
        if (state.frame.peek() !== frame) return;
        shown.current = picture;
        show();
      });
    }
  });
  const pick = (event: MouseEvent) => {
    const scale = canvas.current!.clientWidth / width;
    const [x, y] = [event.offsetX / scale - 0.5, event.offsetY / scale - 0.5];
    const hits = drawn(state).flatMap(([track, row]) => {
      const [cx, cy, w, h] = track.values(`cameras/${name}`, row) as [number, number, number, number];
      return Math.abs(x - cx) <= w / 2 + 4 && Math.abs(y - cy) <= h / 2 + 4 ? [{ id: track.id, area: w * h }] : [];
    });
    state.target.value = hits.sort((a, b) => a.area - b.area)[0]?.id ?? state.target.value;
  };
  const isThere = [...state.run.tracks.values()].some((track) => track.columns.has(`cameras/${name}`));
  return (
    <figure class={`tile ${state.camera.value === name ? "large" : ""}`}>
      <Name state={state} name={name} />
      <div class="picture">
        <canvas ref={canvas} role="img" aria-label={`Camera ${name}, frame ${state.frame.value}`} onClick={pick} />
        {!isThere && <p class="without">No boxes: the calibration of this camera is not there any more.</p>}
      </div>
    </figure>
  );
}

function GroundTile({ state }: { state: State }) {
  const ground = useRef<Ground | null>(null);
  const canvas = useCanvas(state, (element, wide) => {
    ground.current ??= bounds(state.run);
    const first = state.run.cameras[0]!;
    const { left, right, low, high } = ground.current;
    const whole = element.closest(".tiles")!.clientWidth;
    const { columns, span } = layout(state);
    const isWide = state.camera.value === GROUND || span === columns;
    const large = Math.min((wide * (high - low)) / (right - left), window.innerHeight * 0.66);
    const row = ((whole / columns) * first.height) / first.width;
    const tall = Math.round(isWide ? large : row);
    paintGround(prepare(element, wide, tall), state, ground.current, { wide, tall }, drawn(state));
  });
  const names = drawn(state).map(([track, row]) => `${track.id} at ${track.values("ground", row).slice(0, 2).map((v) => v.toFixed(1)).join(", ")}`);
  const isLarge = state.camera.value === GROUND;
  return (
    <figure class={`tile ground ${isLarge ? "large" : ""}`} style={{ gridColumn: isLarge ? "1 / -1" : `span ${layout(state).span}` }}>
      <Name state={state} name={GROUND} />
      <div class="plan">
        <canvas ref={canvas} role="img" aria-label={`The ground in metres, frame ${state.frame.value}: ${names.join("; ")}`} />
      </div>
    </figure>
  );
}
