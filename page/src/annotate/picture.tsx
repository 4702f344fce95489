/** A frame with every target's box, and the box that a person draws. Lengths are px of the source. */

import { useSignal } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import { CURSORS, fitted, HANDLES, LEAST, moved, type Pull } from "../view/box_edit";
import type { Desk } from "./desk";

export function Picture({ desk }: { desk: Desk }) {
  const { width, height, threshold } = desk.about.value!;
  const shown = useSignal(1);
  const plane = useRef<SVGSVGElement>(null);
  const grip = useRef<(Pull & { from: [number, number]; isNew: boolean }) | null>(null);
  const frame = desk.frame.value;
  const drawn = desk.drawn.value;

  useEffect(() => {
    const watch = new ResizeObserver(() => (shown.value = (plane.current?.clientWidth ?? 0) / width || 1));
    watch.observe(plane.current!);
    return () => watch.disconnect();
  }, [width]);

  const place = (event: PointerEvent): [number, number] => {
    const bounds = plane.current!.getBoundingClientRect();
    return [((event.clientX - bounds.left) / bounds.width) * width, ((event.clientY - bounds.top) / bounds.height) * height];
  };
  const take = (event: PointerEvent) => {
    if (!event.isPrimary || event.button !== 0) return;
    plane.current!.setPointerCapture(event.pointerId);
    desk.playing.value = false;
    const from = place(event);
    const part = event.target instanceof Element ? event.target.closest<SVGElement>("[data-box]") : null;
    if (part !== null && desk.drawn.value !== null) {
      const sides = part.dataset.sides?.split(",").map(Number) as [number, number] | undefined;
      grip.current = { from, was: desk.drawn.value, sides: sides ?? null, isNew: false };
    } else grip.current = { from, was: [from[0], from[1], 0, 0], sides: [1, 1], isNew: true };
  };
  const move = (event: PointerEvent) => {
    const held = grip.current;
    if (held === null) return;
    const [dx, dy] = [place(event)[0] - held.from[0], place(event)[1] - held.from[1]];
    // A press alone draws nothing.
    if (held.isNew && (Math.abs(dx) < LEAST || Math.abs(dy) < LEAST)) return;
    held.isNew = false;
    desk.problem.value = "";
    desk.drawn.value = fitted(moved(held, dx, dy, width, height), width, height);
  };
  const letGo = () => (grip.current = null);

  const px = (length: number) => length / shown.value;
  return (
    <section class="sheet" aria-label="Frame">
      <div class="frame" style={{ aspectRatio: `${width} / ${height}`, maxWidth: `min(100%, calc(66vh * ${width / height}))` }}>
        <img src={`picture?frame=${frame}`} data-frame={frame} alt={`Frame ${frame}`} draggable={false} />
        <svg
          ref={plane}
          viewBox={`0 0 ${width} ${height}`}
          role="group"
          aria-label="Drag a box around the target"
          onPointerDown={take}
          onPointerMove={move}
          onPointerUp={letGo}
          onPointerCancel={letGo}
        >
          {desk.targets.value.map((target) => {
            const box = target.boxes[frame];
            const isChosen = target.name === desk.target.value;
            if (box == null || (isChosen && drawn !== null)) return null;
            const [x, y, w, h] = box;
            const how = target.how[frame]!;
            const doubtful = how !== "g" && target.percent[frame]! < 100 * threshold;
            return (
              <g key={target.name} class={`mark-box ${how === "g" ? "given" : doubtful ? "doubtful" : "sure"}${isChosen ? " chosen" : ""}`}>
                <rect class="halo" x={x} y={y} width={w} height={h} stroke-width={px(isChosen ? 5 : 3.5)} />
                <rect
                  class="line"
                  x={x}
                  y={y}
                  width={w}
                  height={h}
                  stroke-width={px(isChosen ? 2.5 : 1.5)}
                  stroke-dasharray={doubtful ? `${px(8)} ${px(4)}` : undefined}
                />
                <text
                  x={x < 0.7 * width ? x + px(3) : Math.min(x + w, width) - px(3)}
                  y={y > px(22) ? y - px(6) : y + px(15)}
                  text-anchor={x < 0.7 * width ? "start" : "end"}
                  font-size={px(12.5)}
                  stroke-width={px(3.5)}
                >
                  {target.name}
                  {how === "g" ? "" : ` · ${target.percent[frame]} %`}
                </text>
              </g>
            );
          })}
          {drawn !== null && (
            <g class="drawn chosen">
              <rect class="halo" x={drawn[0]} y={drawn[1]} width={drawn[2]} height={drawn[3]} stroke-width={px(5)} />
              <rect class="line" data-box="0" x={drawn[0]} y={drawn[1]} width={drawn[2]} height={drawn[3]} stroke-width={px(2.5)} />
              {HANDLES.map(([sx, sy]) => {
                const [cx, cy] = [drawn[0] + (drawn[2] * (sx + 1)) / 2, drawn[1] + (drawn[3] * (sy + 1)) / 2];
                return (
                  <g key={`${sx},${sy}`} data-box="0" data-sides={`${sx},${sy}`} style={{ cursor: `${CURSORS[`${sx},${sy}`]}-resize` }}>
                    <circle class="reach" cx={cx} cy={cy} r={px(13)} />
                    <circle class="handle" cx={cx} cy={cy} r={px(4.5)} stroke-width={px(1.5)} />
                  </g>
                );
              })}
              <text x={drawn[0] + px(4)} y={drawn[1] > px(24) ? drawn[1] - px(7) : drawn[1] + px(16)} font-size={px(13)} stroke-width={px(3.5)}>
                {drawn[0]}, {drawn[1]} · {drawn[2]} × {drawn[3]}
              </text>
            </g>
          )}
        </svg>
      </div>
    </section>
  );
}
