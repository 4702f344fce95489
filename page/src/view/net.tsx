/** The net: agents are lit while they are on, edges are as wide as the last message was strong. */

import type { State } from "../state";
import type { NetNode } from "../data/types";
import { agentsOf } from "../data/totals";
import { agentVariable } from "./theme";
import { short } from "./words";

export function Net({ state }: { state: State }) {
  const track = state.track.value;
  const row = state.row.value;
  void state.version.value;
  const plate = state.run.plates[track?.plate ?? ""];
  if (track === undefined || plate === undefined) return null;
  const { net } = plate;
  const agents = agentsOf(state.run, track);
  const lit = (name: string): boolean => {
    const node = net.nodes.find((one) => one.name === name)!;
    if (node.agent) return track.isActive(name, row);
    return net.nodes.some((one) => one.parent === name && lit(one.name));
  };
  const strength = (name: string) => track.value(`nodes/${name}/strength`, row);
  const held = state.run.heldIn(track.id, state.frame.value);
  const hand = handOf(state);
  const chosen = state.node;
  const settings = plate?.settings ?? {};
  const told = agents.map((name) => `${name} ${track.isActive(name, row) ? "on" : "off"}`).join(", ");
  return (
    <section class="net" aria-label="Net">
      <h2>Net{Object.keys(state.run.plates).length > 1 ? ` of ${track.plate}` : ""}</h2>
      <svg
        viewBox={`0 0 ${net.width} ${net.height}`}
        role={hand === null ? "img" : "group"}
        aria-label={`Bayes net: ${plate.root} above ${told}`}
        style={{ maxWidth: `${Math.round(net.width)}px` }}
      >
        {net.edges.map((edge) => {
          const on = lit(edge.child);
          const nats = strength(edge.child);
          const [ax, ay] = edge.from;
          const [bx, by] = edge.to;
          const middle = (ay + by) / 2;
          const index = agents.indexOf(edge.child);
          return (
            <g key={edge.child} class={on ? "edge on" : "edge"}>
              <path
                d={`M${ax} ${ay}C${ax} ${middle} ${bx} ${middle} ${bx} ${by}`}
                style={on && index >= 0 ? { stroke: agentVariable(index) } : {}}
                stroke-width={on ? thickness(nats) : 1.4}
              />
              {on && Number.isFinite(nats) && (
                <text x={ax + (bx - ax) * 0.72} y={ay + (by - ay) * 0.6 + 4} class="nats">
                  {nats < 0.005 ? "0" : short(nats)}
                </text>
              )}
            </g>
          );
        })}
        {net.forks.map((fork) => (
          <g key={`${fork.x},${fork.y}`} class="fork">
            <rect x={fork.x - fork.w / 2} y={fork.y - fork.h / 2} width={fork.w} height={fork.h} rx={fork.h / 2} />
            <text x={fork.x} y={fork.y + 4}>
              {fork.text}
            </text>
          </g>
        ))}
        {net.nodes.map((node) => (
          <Node
            key={node.name}
            node={node}
            on={lit(node.name)}
            silent={node.agent && track.isSilent(node.name, row)}
            index={agents.indexOf(node.name)}
            held={held.get(node.name)}
            hand={hand}
            chosen={chosen.value === node.name}
            choose={node.name in settings ? () => (chosen.value = chosen.value === node.name ? null : node.name) : null}
          />
        ))}
      </svg>
      <p class="hint">
        Filled: on. Line width: strength of the message, in nats.
        {hand === null && Object.keys(settings).length > 0 && " Press a node for its parameters and its band."}
        {hand !== null && <b> Press an agent to switch it by hand.</b>}
        {hand === null && state.live?.isOn.value && !state.following.value && " To switch agents, go to the newest frame."}
      </p>
      {chosen.value !== null && settings[chosen.value] !== undefined && (
        <div class="settings">
          <h3>{chosen.value} in the graph</h3>
          <pre>{settings[chosen.value]}</pre>
        </div>
      )}
      {hand !== null && <ByHand state={state} hand={hand} agents={agents} />}
    </section>
  );
}

/** Nats to px: a message of 0.1 nats is a line, one of 5 a ribbon. */
function thickness(nats: number): number {
  return Number.isFinite(nats) ? 1.6 + 3.4 * Math.min(2.6, Math.log1p(Math.max(nats, 0) * 2)) : 1.6;
}

/** What a person may do to the agents of the target in the newest frame. */
interface Hand {
  /** What was asked for and works from the next frame on: on, off, or (null) as the rules say. */
  asked: (agent: string) => boolean | null | undefined;
  /** On or off by hand; null gives it back to the rules. */
  switch: (agent: string, on: boolean | null) => void;
}

/** Null where nothing can be switched: the run is over, or an earlier frame is looked at. */
function handOf(state: State): Hand | null {
  const { live } = state;
  const target = state.target.value;
  if (live === null || !live.isOn.value || !live.status.value?.canSwitch || !state.following.value) return null;
  if (state.row.value < 0) return null;
  return {
    asked: (agent) => live.asked.value.get(`${target}/${agent}`),
    switch: (agent, on) => void live.switch(target, agent, on),
  };
}

/** Agents that a person holds, to be given back. */
function ByHand({ state, hand, agents }: { state: State; hand: Hand; agents: string[] }) {
  // What was switched with the newest frame works from the next one on.
  const held = state.run.heldIn(state.target.value, Infinity);
  const shown = agents.filter((agent) => held.has(agent) || hand.asked(agent) !== undefined);
  if (shown.length === 0) return null;
  return (
    <ul class="hands" aria-label="Switched by hand">
      {shown.map((agent) => {
        const asked = hand.asked(agent);
        const on = asked ?? held.get(agent);
        return (
          <li key={agent}>
            <span>
              <b>{agent}</b> {asked === null ? "back to the rules" : `${on ? "on" : "off"} by hand`}
              {asked !== undefined && <small> with the next frame</small>}
            </span>
            {asked === undefined && (
              <button type="button" onClick={() => hand.switch(agent, null)}>
                Give back to the rules
              </button>
            )}
          </li>
        );
      })}
    </ul>
  );
}

interface NodeProps {
  node: NetNode;
  on: boolean;
  silent: boolean;
  index: number;
  held: boolean | undefined;
  hand: Hand | null;
  chosen: boolean;
  /** Show or hide its parameters; null where none are known. */
  choose: (() => void) | null;
}

function Node({ node, on, silent, index, held, hand, chosen, choose }: NodeProps) {
  const { x, y, w, h } = node;
  const asked = node.agent ? hand?.asked(node.name) : undefined;
  const look = `node ${node.agent ? "agent" : "belief"}${on ? " on" : ""}${asked === undefined ? "" : " asked"}${chosen ? " chosen" : ""}`;
  const tint = node.agent ? { "--tint": agentVariable(index) } : {};
  const wanted = !(asked ?? held ?? on);
  const switches = hand !== null && node.agent;
  const press = () => (switches ? hand.switch(node.name, wanted) : choose?.());
  const onKeyDown = (event: KeyboardEvent) => {
    if (event.key !== "Enter" && event.key !== " ") return;
    event.preventDefault();
    press();
  };
  const shows = {
    role: "button" as const,
    tabindex: 0,
    "aria-expanded": chosen,
    "aria-label": `${node.name}: its parameters`,
    onClick: press,
    onKeyDown,
  };
  const button =
    !switches
      ? choose === null || hand !== null
        ? {}
        : shows
      : {
          role: "button" as const,
          tabindex: 0,
          "aria-pressed": on,
          "aria-label": `${node.name}: ${on ? "on" : "off"}${held === undefined ? "" : " by hand"}. Press to switch it ${wanted ? "on" : "off"} by hand`,
          onClick: press,
          onKeyDown,
        };
  return (
    <g class={look} style={tint} {...button}>
      {"role" in button && <title>{switches ? `press: ${node.name} ${wanted ? "on" : "off"} by hand` : `press: parameters of ${node.name}`}</title>}
      {node.agent ? (
        <rect x={x - w / 2} y={y - h / 2} width={w} height={h} rx={9} />
      ) : (
        <ellipse cx={x} cy={y} rx={w / 2} ry={h / 2} />
      )}
      <text x={x} y={node.note || silent ? y - 4 : y + 5} class="name">
        {node.name}
      </text>
      {(node.note || silent) && (
        <text x={x} y={y + 14} class="note">
          {silent ? "sees nothing" : node.note}
        </text>
      )}
      {held !== undefined && (
        <g class="badge">
          <rect x={x + w / 2 - 62} y={y - h / 2 - 9} width={58} height={18} rx={9} />
          <text x={x + w / 2 - 33} y={y - h / 2 + 4}>
            by hand
          </text>
        </g>
      )}
    </g>
  );
}

/** What each agent said in the frame. */
export function Agents({ state }: { state: State }) {
  const track = state.track.value;
  const row = state.row.value;
  if (track === undefined) return null;
  const agents = agentsOf(state.run, track);
  const value = (agent: string, name: string) => short(track.value(`agents/${agent}/${name}`, row));
  return (
    <table class="agents">
      <caption class="hidden">Agents in this frame</caption>
      <thead>
        <tr>
          <th scope="col">agent</th>
          <th scope="col" />
          <th scope="col" title="KL(belief ‖ agent), nats: how far the belief is from what the agent alone says">
            KL
          </th>
          <th scope="col" title="KL(belief ‖ belief without it), nats: what the agent adds">
            adds
          </th>
          <th scope="col" title="its own UD">
            own UD
          </th>
          <th scope="col" title="milliseconds in this frame">
            ms
          </th>
        </tr>
      </thead>
      <tbody>
        {agents.map((agent, index) => {
          const on = track.isActive(agent, row);
          return (
            <tr key={agent} class={on ? "on" : "off"}>
              <th scope="row">
                <i class="dot" style={{ background: on ? agentVariable(index) : "transparent", borderColor: agentVariable(index) }} />
                {agent}
              </th>
              <td>{on ? (track.isSilent(agent, row) ? "blind" : "on") : "off"}</td>
              <td>{on ? value(agent, "kl") : ""}</td>
              <td>{on ? value(agent, "contribution") : ""}</td>
              <td>{on ? value(agent, "agent_ud_px2") : ""}</td>
              <td>{on ? short(state.run.ms(`stages/${agent}`, state.frame.value)) : ""}</td>
            </tr>
          );
        })}
      </tbody>
    </table>
  );
}
