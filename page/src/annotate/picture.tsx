/** A frame with every target's box, and the box that a person draws. Lengths are px of the source. */

import { Handles, useDrag } from "../view/box_drag";
import type { Desk } from "./desk";

export function Picture({ desk }: { desk: Desk }) {
  const { width, height, threshold } = desk.about.value!;
  const frame = desk.frame.value;
  const drawn = desk.drawn.value;
  const { px, handlers } = useDrag({
    width,
    height,
    take: (index) => {
      desk.playing.value = false;
      return index < 0 ? null : desk.drawn.value;
    },
    add: () => 0,
    set: (_, box) => {
      desk.problem.value = "";
      desk.drawn.value = box;
    },
  });

  return (
    <section class="sheet" aria-label="Frame">
      <div class="frame" style={{ aspectRatio: `${width} / ${height}`, maxWidth: `min(100%, calc(66vh * ${width / height}))` }}>
        <img src={`picture?frame=${frame}`} data-frame={frame} alt={`Frame ${frame}`} draggable={false} />
        <svg
          {...handlers}
          viewBox={`0 0 ${width} ${height}`}
          role="group"
          aria-label="Drag a box around the target"
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
              <Handles box={drawn} index={0} px={px} />
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
