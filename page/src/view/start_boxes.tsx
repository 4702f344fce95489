/** Where to start: boxes drawn on the first frame by mouse, finger or keyboard. Lengths are px of the source. */

import { useSignal } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import type { Asked, Control } from "../control";
import { type Box, CURSORS, fitted, HANDLES, LEAST, moved, type Pull } from "./box_edit";
import { Icon } from "./transport";

interface Drawn {
  box: Box;
  plate: string;
}

/** What a finger moves: a new box, a box as a whole, or the sides of one. */
interface Grip extends Pull {
  index: number;
  from: [number, number];
  isNew: boolean;
}

export function StartBoxes({ live, about }: { live: Control; about: Asked }) {
  const [width, height] = [about.width!, about.height!];
  const plates = about.plates ?? [];
  const picture = useSignal("");
  const drawn = useSignal<Drawn[]>([]);
  const chosen = useSignal(0);
  const isSent = useSignal(false);
  const shown = useSignal(1);
  const plane = useRef<SVGSVGElement>(null);
  const grip = useRef<Grip | null>(null);

  useEffect(() => {
    let [address, gone] = ["", false];
    const get = async () => {
      const answer = await fetch(`picture?frame=${about.first ?? 0}`, { cache: "no-store" }).catch(() => null);
      if (gone) return;
      if (answer?.status !== 200) return void setTimeout(get, 100);
      address = URL.createObjectURL(await answer.blob());
      picture.value = address;
    };
    void get();
    return () => {
      gone = true;
      URL.revokeObjectURL(address);
    };
  }, [about.first]);

  useEffect(() => {
    const watch = new ResizeObserver(() => (shown.value = (plane.current?.clientWidth ?? 0) / width || 1));
    watch.observe(plane.current!);
    return () => watch.disconnect();
  }, [width]);

  const set = (index: number, box: Box) => {
    live.problem.value = "";
    drawn.value = drawn.value.map((one, at) => (at === index ? { ...one, box: fitted(box, width, height) } : one));
  };
  const add = (box: Box): number => {
    drawn.value = [...drawn.value, { box, plate: plates[Math.min(drawn.value.length, plates.length - 1)] ?? "" }];
    chosen.value = drawn.value.length - 1;
    return chosen.value;
  };
  const remove = (index: number) => {
    drawn.value = drawn.value.filter((_, at) => at !== index);
    chosen.value = Math.max(0, Math.min(chosen.value, drawn.value.length - 1));
  };
  const addInMiddle = () => {
    const [w, h] = [Math.round(width / 5), Math.round(height / 4)];
    const shift = 12 * drawn.value.length;
    const index = add(fitted([Math.round((width - w) / 2) + shift, Math.round((height - h) / 2) + shift, w, h], width, height));
    requestAnimationFrame(() => plane.current?.querySelector<SVGElement>(`[data-box="${index}"]`)?.focus());
  };
  const reset = () => {
    drawn.value = [];
    live.problem.value = "";
    grip.current = null;
  };
  const begin = async () => {
    if (drawn.value.length === 0) {
      live.problem.value = "Draw a box around what is to be tracked.";
      return;
    }
    isSent.value = true;
    const boxes = drawn.value.map(({ box, plate }) => ({ box, plate: plate || null }));
    isSent.value = await live.ask({ do: "start", boxes });
  };

  useEffect(() => {
    const press = (event: KeyboardEvent) => {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      const inside = event.target instanceof Element ? event.target : null;
      if (event.key === "Escape") reset();
      else if (event.key === "Enter" && !inside?.matches("button, select")) void begin();
      else if (!inside?.matches("input, select") && nudge(event)) event.preventDefault();
    };
    document.addEventListener("keydown", press);
    return () => document.removeEventListener("keydown", press);
  });

  /** Arrows move the chosen box; with Shift they move its lower right corner. */
  const nudge = (event: KeyboardEvent): boolean => {
    const one = drawn.value[chosen.value];
    if (one === undefined) return false;
    if (event.key === "Delete" || event.key === "Backspace") {
      remove(chosen.value);
      return true;
    }
    const [dx, dy] = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key] ?? [0, 0];
    if (!dx && !dy) return false;
    const [x, y, w, h] = one.box;
    set(chosen.value, event.shiftKey ? [x, y, Math.max(LEAST, w + dx!), Math.max(LEAST, h + dy!)] : [x + dx!, y + dy!, w, h]);
    return true;
  };

  const place = (event: PointerEvent): [number, number] => {
    const bounds = plane.current!.getBoundingClientRect();
    return [((event.clientX - bounds.left) / bounds.width) * width, ((event.clientY - bounds.top) / bounds.height) * height];
  };
  const take = (event: PointerEvent) => {
    if (!event.isPrimary || event.button !== 0) return;
    plane.current!.setPointerCapture(event.pointerId);
    const from = place(event);
    const part = event.target instanceof Element ? event.target.closest<SVGElement>("[data-box]") : null;
    const index = part === null ? -1 : Number(part.dataset.box);
    if (index >= 0) {
      chosen.value = index;
      const sides = part!.dataset.sides?.split(",").map(Number) as [number, number] | undefined;
      grip.current = { index, from, was: drawn.value[index]!.box, sides: sides ?? null, isNew: false };
    } else grip.current = { index: -1, from, was: [from[0], from[1], 0, 0], sides: [1, 1], isNew: true };
  };
  const move = (event: PointerEvent) => {
    const held = grip.current;
    if (held === null) return;
    const [dx, dy] = [place(event)[0] - held.from[0], place(event)[1] - held.from[1]];
    if (held.isNew && held.index < 0) {
      // A press alone draws nothing.
      if (Math.abs(dx) < LEAST || Math.abs(dy) < LEAST) return;
      held.index = add([0, 0, LEAST, LEAST]);
    }
    set(held.index, moved(held, dx, dy, width, height));
  };
  const letGo = () => (grip.current = null);

  const px = (length: number) => length / shown.value;
  return (
    <main class="choose">
      <section class="sheet" aria-label="First frame">
        <div class="frame" style={{ aspectRatio: `${width} / ${height}`, maxWidth: `min(100%, calc(72vh * ${width / height}))` }}>
          {picture.value !== "" && <img src={picture.value} alt="The first frame of the video" draggable={false} />}
          <svg
            ref={plane}
            viewBox={`0 0 ${width} ${height}`}
            role="group"
            aria-label="Draw a box around each target"
            onPointerDown={take}
            onPointerMove={move}
            onPointerUp={letGo}
            onPointerCancel={letGo}
          >
            {drawn.value.map(({ box: [x, y, w, h] }, index) => {
              const isChosen = index === chosen.value;
              return (
                <g key={index} class={isChosen ? "drawn chosen" : "drawn"}>
                  <rect class="halo" x={x} y={y} width={w} height={h} stroke-width={px(5)} />
                  <rect
                    class="line"
                    data-box={index}
                    x={x}
                    y={y}
                    width={w}
                    height={h}
                    stroke-width={px(2.5)}
                    tabindex={0}
                    role="button"
                    aria-label={`Box ${index + 1}: x ${x}, y ${y}, width ${w}, height ${h}. Arrows move it, Shift and arrows change its size`}
                    onFocus={() => (chosen.value = index)}
                  />
                  {isChosen &&
                    HANDLES.map(([sx, sy]) => {
                      const [cx, cy] = [x + (w * (sx + 1)) / 2, y + (h * (sy + 1)) / 2];
                      return (
                        <g key={`${sx},${sy}`} data-box={index} data-sides={`${sx},${sy}`} style={{ cursor: `${CURSORS[`${sx},${sy}`]}-resize` }}>
                          <circle class="reach" cx={cx} cy={cy} r={px(13)} />
                          <circle class="handle" cx={cx} cy={cy} r={px(4.5)} stroke-width={px(1.5)} />
                        </g>
                      );
                    })}
                  <text x={x + px(4)} y={y > px(24) ? y - px(7) : y + px(16)} font-size={px(13)} stroke-width={px(3.5)}>
                    {index + 1} · {x}, {y} · {w} × {h}
                  </text>
                </g>
              );
            })}
            {drawn.value.length === 0 && (
              <text class="invite" x={width / 2} y={height - px(18)} font-size={px(15)} stroke-width={px(4)}>
                Drag a box around what is to be tracked
              </text>
            )}
          </svg>
        </div>
      </section>
      <form
        class="boxes"
        onSubmit={(event) => {
          event.preventDefault();
          void begin();
        }}
      >
        <h2>Where does it start?</h2>
        <p>
          Drag a box around each target on this first frame: close around it, little background. Drag inside a box to move
          it, at a handle to change it.
        </p>
        {drawn.value.map(({ box, plate }, index) => (
          <fieldset key={index} class={index === chosen.value ? "chosen" : ""} onFocusIn={() => (chosen.value = index)}>
            <legend>Box {index + 1}</legend>
            {(["x", "y", "w", "h"] as const).map((name, at) => (
              <label key={name}>
                <span>{name}</span>
                <input
                  type="number"
                  step={1}
                  value={box[at]}
                  aria-label={`${name} of box ${index + 1}, pixels`}
                  onChange={(event) => {
                    const next: Box = [...box];
                    next[at] = Number(event.currentTarget.value) || 0;
                    set(index, next);
                  }}
                />
              </label>
            ))}
            {plates.length > 1 && (
              <label class="plate">
                <span>what</span>
                <select
                  value={plate}
                  onChange={(event) => {
                    const name = event.currentTarget.value;
                    drawn.value = drawn.value.map((one, at) => (at === index ? { ...one, plate: name } : one));
                  }}
                >
                  {plates.map((name) => (
                    <option key={name}>{name}</option>
                  ))}
                </select>
              </label>
            )}
            <button type="button" class="remove" onClick={() => remove(index)} aria-label={`Remove box ${index + 1}`} title="remove (Delete)">
              ×
            </button>
          </fieldset>
        ))}
        {live.isCut.value && (
          <p class="problem" role="alert">
            The command gives no answer. Is it still there? Trying again …
          </p>
        )}
        {live.problem.value !== "" && (
          <p class="problem" role="alert">
            {live.problem.value}
          </p>
        )}
        <div class="controls">
          <button type="submit" class="main" disabled={isSent.value || drawn.value.length === 0}>
            <Icon d="M6 3.5 16 10 6 16.5z" />
            {isSent.value ? "Starting …" : "Start tracking"}
          </button>
          <button type="button" onClick={addInMiddle}>
            Add a box
          </button>
          {drawn.value.length > 0 && (
            <button type="button" onClick={reset}>
              Reset
            </button>
          )}
        </div>
        <p class="hint">
          <kbd>←</kbd> <kbd>→</kbd> <kbd>↑</kbd> <kbd>↓</kbd> move by a pixel, with <kbd>Shift</kbd> they change the size,{" "}
          <kbd>Del</kbd> removes, <kbd>Esc</kbd> resets, <kbd>Enter</kbd> starts. x, y is the top-left corner.
        </p>
      </form>
    </main>
  );
}
