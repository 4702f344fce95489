/** Where to start: boxes drawn on the first frame by mouse, finger or keyboard. Lengths are px of the source. */

import { useSignal } from "@preact/signals";
import { useEffect } from "preact/hooks";
import type { Asked, Control } from "../control";
import { Handles, useDrag } from "./box_drag";
import { type Box, fitted, LEAST } from "./box_edit";
import { Icon } from "./transport";

interface Drawn {
  box: Box;
  plate: string;
}

export function StartBoxes({ live, about }: { live: Control; about: Asked }) {
  const [width, height] = [about.width!, about.height!];
  const plates = about.plates ?? [];
  const picture = useSignal("");
  const drawn = useSignal<Drawn[]>([]);
  const chosen = useSignal(0);
  const isSent = useSignal(false);

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
  const drag = useDrag({
    width,
    height,
    take: (index) => {
      if (index < 0) return null;
      chosen.value = index;
      return drawn.value[index]!.box;
    },
    add,
    set,
  });
  const { px } = drag;
  const addInMiddle = () => {
    const [w, h] = [Math.round(width / 5), Math.round(height / 4)];
    const shift = 12 * drawn.value.length;
    const index = add(fitted([Math.round((width - w) / 2) + shift, Math.round((height - h) / 2) + shift, w, h], width, height));
    requestAnimationFrame(() => drag.plane.current?.querySelector<SVGElement>(`[data-box="${index}"]`)?.focus());
  };
  const reset = () => {
    drawn.value = [];
    live.problem.value = "";
    drag.letGo();
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

  return (
    <main class="choose">
      <section class="sheet" aria-label="First frame">
        <div class="frame" style={{ aspectRatio: `${width} / ${height}`, maxWidth: `min(100%, calc(72vh * ${width / height}))` }}>
          {picture.value !== "" && <img src={picture.value} alt="The first frame of the video" draggable={false} />}
          <svg
            {...drag.handlers}
            viewBox={`0 0 ${width} ${height}`}
            role="group"
            aria-label="Draw a box around each target"
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
                  {isChosen && <Handles box={[x, y, w, h]} index={index} px={px} />}
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
