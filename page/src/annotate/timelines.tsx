/** A lane for each target: where it is given, tracked surely or doubtfully, interpolated, gone, or not known yet. */

import type { Desk, Target } from "./desk";

const LANE = 22;

export function Timelines({ desk }: { desk: Desk }) {
  const { frames, threshold } = desk.about.value!;
  const targets = desk.targets.value;
  const tall = Math.max(1, targets.length) * LANE;
  const last = Math.max(1, frames - 1);
  return (
    <section class="charts lanes" aria-label="Timelines">
      <div class="scrubber" style={{ height: `${tall}px` }}>
        <svg class="ribbon" viewBox={`0 0 ${frames} ${tall}`} preserveAspectRatio="none" aria-hidden="true">
          {targets.map((target, lane) => (
            <g key={target.name} class={target.name === desk.target.value ? "chosen" : ""}>
              {stretches(target, threshold).map(([kind, from, to]) => (
                <rect key={from} class={`lane-${kind}`} x={from} width={to - from} {...shape(kind, lane)} />
              ))}
            </g>
          ))}
          {desk.questions.value.map((one) => (
            <rect
              key={one.target}
              class="lane-question"
              x={one.frame - frames / 400}
              width={Math.max(1, frames / 200)}
              y={targets.findIndex((target) => target.name === one.target) * LANE + 1}
              height={LANE - 2}
            />
          ))}
          <rect class="lane-now" x={desk.frame.value + 0.5 - frames / 1200} width={frames / 600} y={0} height={tall} />
        </svg>
        <input
          type="range"
          min={0}
          max={last}
          step={1}
          value={desk.frame.value}
          aria-label="Frame"
          aria-valuetext={`frame ${desk.frame.value} of ${last}`}
          onInput={(event) => {
            desk.playing.value = false;
            desk.go(Number(event.currentTarget.value));
          }}
        />
      </div>
      <p class="legend hint">
        {LEGEND.map(([kind, word]) => (
          <span key={kind}>
            <i class={`lane-${kind}`} /> {word}
          </span>
        ))}
      </p>
    </section>
  );
}

const LEGEND = [
  ["given", "given"],
  ["sure", "tracked, sure"],
  ["doubtful", "doubtful"],
  ["line", "interpolated"],
  ["gone", "gone"],
  ["question", "question"],
];

const KINDS: Record<string, string> = { g: "given", i: "line", x: "gone", ".": "unknown" };

/** Frames of one kind in a row: kind, first, behind the last. */
export function stretches(target: Target, threshold: number): [string, number, number][] {
  const found: [string, number, number][] = [];
  for (let frame = 0; frame < target.how.length; frame += 1) {
    const how = target.how[frame]!;
    const kind = how === "t" ? (target.percent[frame]! < 100 * threshold ? "doubtful" : "sure") : KINDS[how]!;
    const before = found[found.length - 1];
    if (before !== undefined && before[0] === kind) before[2] = frame + 1;
    else found.push([kind, frame, frame + 1]);
  }
  return found.filter(([kind]) => kind !== "unknown");
}

function shape(kind: string, lane: number): { y: number; height: number } {
  const height = { given: LANE - 4, doubtful: 12, line: 12, gone: 3 }[kind] ?? 8;
  return { y: lane * LANE + (LANE - height) / 2, height };
}
