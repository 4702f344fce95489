/** Boxes that a person drags on a picture: what a pointer pulls, and how a drawn box looks. Lengths are px of the source. */

import { useSignal } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import { type Box, CURSORS, fitted, HANDLES, LEAST, moved, type Pull } from "./box_edit";

/** What a finger moves: a new box, a box as a whole, or the sides of one. */
interface Grip extends Pull {
  index: number;
  from: [number, number];
  isNew: boolean;
}

export interface Boxes {
  width: number;
  height: number;
  /** A pointer went down: on box number `index`, or beside all of them (-1); the box there. */
  take: (index: number) => Box | null;
  /** A new box begins; its number. */
  add: (box: Box) => number;
  set: (index: number, box: Box) => void;
}

/** What an svg over the picture needs so that boxes can be drawn and pulled on it; how long a px of the screen is. */
export function useDrag(boxes: Boxes) {
  const { width, height } = boxes;
  const shown = useSignal(1);
  const plane = useRef<SVGSVGElement>(null);
  const grip = useRef<Grip | null>(null);

  useEffect(() => {
    const watch = new ResizeObserver(() => (shown.value = (plane.current?.clientWidth ?? 0) / width || 1));
    watch.observe(plane.current!);
    return () => watch.disconnect();
  }, [width]);

  const place = (event: PointerEvent): [number, number] => {
    const bounds = plane.current!.getBoundingClientRect();
    return [((event.clientX - bounds.left) / bounds.width) * width, ((event.clientY - bounds.top) / bounds.height) * height];
  };
  const onPointerDown = (event: PointerEvent) => {
    if (!event.isPrimary || event.button !== 0) return;
    plane.current!.setPointerCapture(event.pointerId);
    const from = place(event);
    const part = event.target instanceof Element ? event.target.closest<SVGElement>("[data-box]") : null;
    const index = part === null ? -1 : Number(part.dataset.box);
    const was = boxes.take(index);
    if (part !== null && was !== null) {
      const sides = part.dataset.sides?.split(",").map(Number) as [number, number] | undefined;
      grip.current = { index, from, was, sides: sides ?? null, isNew: false };
    } else grip.current = { index: -1, from, was: [from[0], from[1], 0, 0], sides: [1, 1], isNew: true };
  };
  const onPointerMove = (event: PointerEvent) => {
    const held = grip.current;
    if (held === null) return;
    const [dx, dy] = [place(event)[0] - held.from[0], place(event)[1] - held.from[1]];
    if (held.isNew) {
      // A press alone draws nothing.
      if (Math.abs(dx) < LEAST || Math.abs(dy) < LEAST) return;
      held.index = boxes.add([0, 0, LEAST, LEAST]);
      held.isNew = false;
    }
    boxes.set(held.index, fitted(moved(held, dx, dy, width, height), width, height));
  };
  const letGo = () => (grip.current = null);
  const px = (length: number) => length / shown.value;
  return { plane, px, letGo, handlers: { ref: plane, onPointerDown, onPointerMove, onPointerUp: letGo, onPointerCancel: letGo } };
}

interface HandlesProps {
  box: Box;
  index: number;
  px: (length: number) => number;
}

/** The eight places where a box can be pulled. */
export function Handles({ box: [x, y, w, h], index, px }: HandlesProps) {
  return (
    <>
      {HANDLES.map(([sx, sy]) => {
        const [cx, cy] = [x + (w * (sx + 1)) / 2, y + (h * (sy + 1)) / 2];
        return (
          <g key={`${sx},${sy}`} data-box={index} data-sides={`${sx},${sy}`} style={{ cursor: `${CURSORS[`${sx},${sy}`]}-resize` }}>
            <circle class="reach" cx={cx} cy={cy} r={px(13)} />
            <circle class="handle" cx={cx} cy={cy} r={px(4.5)} stroke-width={px(1.5)} />
          </g>
        );
      })}
    </>
  );
}
