/** The table of totals, and the few of them that stand at the head of the page. */

import { useComputed } from "@preact/signals";
import { costs, frameCounts, sum, totals, type Totals } from "../data/totals";
import type { State } from "../state";
import { duration, nameOf, percent, plural, short } from "./words";

export function Headline({ state }: { state: State }) {
  const all = useComputed(() => {
    void state.settled.value;
    return { ...sum(totals(state.run)), read: frameCounts(state.run) };
  }).value;
  const { withTarget, all: read } = all.read;
  return (
    <dl class="headline">
      <Figure
        name={withTarget < read ? "frames with a target" : "frames"}
        value={withTarget.toLocaleString("en")}
        of={withTarget < read ? `of ${read.toLocaleString("en")}` : undefined}
        title={`${plural(withTarget, "frame")} with at least one target, of ${read} that were read`}
      />
      <Figure
        name="lost"
        value={`${short((100 * all.lost) / Math.max(1, all.frames))} %`}
        title={`${plural(all.lost, "frame")} of ${all.frames} in which a target was lost`}
      />
      <Figure
        name="uncertain"
        value={`${short((100 * all.uncertain) / Math.max(1, all.frames))} %`}
        title={`${plural(all.uncertain, "frame")} of ${all.frames} in which the net was unsure of a target`}
      />
      <Figure
        name="agents a frame"
        value={`${short(all.agentsPerFrame)}`}
        of={`of ${short(all.agents)}`}
        title="agents that were on, in the mean"
      />
      <Figure name="reconfigurations" value={String(all.switches)} title="agents switched on or off" />
      <Figure
        name="of agents' time saved"
        value={percent(all.savedMs / Math.max(1e-9, all.savedMs + all.spentMs))}
        title={`${duration(all.savedMs)} of ${duration(all.savedMs + all.spentMs)} that all agents would have taken if always on`}
      />
    </dl>
  );
}

function Figure({ name, value, of, title }: { name: string; value: string; of?: string; title?: string }) {
  return (
    <div title={title}>
      <dt>{name}</dt>
      <dd>
        {value}
        {of !== undefined && <small> {of}</small>}
      </dd>
    </div>
  );
}

export function TotalsTable({ state }: { state: State }) {
  const found = useComputed(() => {
    void state.settled.value;
    return { rows: totals(state.run), costs: costs(state.run) };
  }).value;
  const { rows } = found;
  const several = rows.length > 1;
  const hasUncertain = rows.some((row) => row.uncertain > 0);
  const hasTruth = rows.some((row) => Number.isFinite(row.overlap));
  const measured = [...found.costs].map(([agent, cost]) => `${agent} ${short(cost.ms)} ms${cost.measured ? "" : " (declared)"}`);
  return (
    <section class="totals" aria-label="Totals">
      <h2>Summary</h2>
      <div class="wide">
        <table>
          <thead>
            <tr>
              <th scope="col">target</th>
              <th scope="col">frames</th>
              <th scope="col">lost</th>
              {hasUncertain && <th scope="col">uncertain</th>}
              <th scope="col" title="agents that were on in a frame, in the mean">
                agents
              </th>
              <th scope="col">switches</th>
              <th scope="col">agents' time</th>
              <th scope="col">saved</th>
              {hasTruth && (
                <th scope="col" title="mean IoU with the ground-truth box">
                  overlap
                </th>
              )}
            </tr>
          </thead>
          <tbody>
            {rows.map((row) => (
              <Row key={row.target} state={state} row={row} has={{ hasUncertain, hasTruth }} />
            ))}
          </tbody>
          {several && (
            <tfoot>
              <Row row={sum(rows)} has={{ hasUncertain, hasTruth }} />
            </tfoot>
          )}
        </table>
      </div>
      <p class="hint">
        Saved is what the agents that were off would have taken, at the median cost of a frame: {measured.join(", ") || "no cost is known"}. What they
        would have added to the planes that cues share is not counted.
      </p>
    </section>
  );
}

interface RowProps {
  state?: State;
  row: Totals;
  has: { hasUncertain: boolean; hasTruth: boolean };
}

function Row({ state, row, has }: RowProps) {
  const chosen = state?.target.value === row.target;
  return (
    <tr class={chosen ? "chosen" : undefined}>
      <th scope="row">
        {state === undefined || state.run.tracks.size === 1 ? (
          row.target
        ) : (
          <button type="button" aria-pressed={chosen} onClick={() => (state.target.value = row.target)}>
            {nameOf(state.run.tracks.get(row.target)!)}
          </button>
        )}
      </th>
      <td data-name="frames">{row.frames}</td>
      <td data-name="lost">{row.lost}</td>
      {has.hasUncertain && <td data-name="uncertain">{row.uncertain}</td>}
      <td data-name="agents">
        {short(row.agentsPerFrame)} <small>of {short(row.agents)}</small>
      </td>
      <td data-name="switches">{row.switches}</td>
      <td data-name="agents' time">{duration(row.spentMs)}</td>
      <td data-name="saved">
        {duration(row.savedMs)} <small>{percent(row.savedMs / Math.max(1e-9, row.savedMs + row.spentMs))}</small>
      </td>
      {has.hasTruth && <td data-name="overlap">{Number.isFinite(row.overlap) ? row.overlap.toFixed(2) : ""}</td>}
    </tr>
  );
}
