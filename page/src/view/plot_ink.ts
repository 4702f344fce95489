/** What is painted into the timelines besides their lines: bands, triangles, rows of targets. */

import uPlot from "uplot";
import type { EventRow } from "../data/types";
import type { State } from "../state";
import type { Panel } from "./series";
import { colour, statusColour } from "./theme";

/** Frames in which the target was lost or uncertain, behind everything. */
export function shade(u: uPlot, state: State): void {
  const track = state.track.peek();
  if (track === undefined) return;
  const { left, top, width, height } = u.bbox;
  const g = u.ctx;
  g.save();
  g.beginPath();
  g.rect(left, top, width, height);
  g.clip();
  for (let row = 0, from = 0; row < track.length; row += 1) {
    const status = track.status(row);
    if (row + 1 < track.length && track.status(row + 1) === status) continue;
    if (status !== "tracking") {
      const x = u.valToPos(track.value("frame", from) - 0.5, "x", true);
      const end = u.valToPos(track.value("frame", row) + 0.5, "x", true);
      g.fillStyle = colour(`${status === "lost" || status === "hidden" ? status : "uncertain"}-veil`);
      g.fillRect(x, top, end - x, height);
    }
    from = row + 1;
  }
  g.restore();
}

/** A band per agent; where one of them is `chosen`, the others step back. */
export function lanes(u: uPlot, panel: Panel, frames: number[], gap: number, chosen: string | null): void {
  const g = u.ctx;
  const ratio = uPlot.pxRatio;
  const { left, top, width, height } = u.bbox;
  const tall = height / Math.max(1, panel.lanes!.length);
  const narrow = width / ratio < 480;
  const [ink, ground] = [colour("ink"), colour("lane")];
  const isOneChosen = panel.lanes!.some((lane) => lane.agent === chosen);
  g.save();
  panel.lanes!.forEach((lane, index) => {
    const y = top + index * tall + 3 * ratio;
    const h = tall - 6 * ratio;
    const isChosen = lane.agent === chosen;
    const strength = isOneChosen && !isChosen ? 0.3 : 1;
    g.globalAlpha = strength;
    g.fillStyle = ground;
    g.fillRect(left, y, width, h);
    g.save();
    g.beginPath();
    g.rect(left, y, width, h);
    g.clip();
    const x = (frame: number) => u.valToPos(frame, "x", true);
    for (let k = 0, from = 0; k < frames.length; k += 1) {
      if (k + 1 < frames.length && lane.on[k + 1] === lane.on[k] && frames[k + 1]! <= frames[k]! + gap) continue;
      if (lane.on[k]) {
        const [a, b] = [x(frames[from]! - 0.5), x(frames[k]! + 0.5)];
        g.fillStyle = lane.colour;
        g.globalAlpha = 0.3 * strength;
        g.fillRect(a, y, b - a, h);
        g.globalAlpha = 0.95 * strength;
        g.beginPath();
        g.moveTo(a, y + h);
        for (let j = from; j <= k; j += 1) {
          const share = Math.min(1, Math.max(0, (lane.kl[j] || 0) / panel.range[1]));
          g.lineTo(x(frames[j]! - 0.5), y + h - share * h);
          g.lineTo(x(frames[j]! + 0.5), y + h - share * h);
        }
        g.lineTo(b, y + h);
        g.fill();
        g.fillRect(a, y + h - 1.5 * ratio, b - a, 1.5 * ratio);
        g.globalAlpha = strength;
      }
      from = k + 1;
    }
    g.restore();
    g.globalAlpha = isOneChosen && !isChosen ? 0.6 : 1;
    if (isChosen) {
      g.strokeStyle = ink;
      g.lineWidth = 1.5 * ratio;
      g.strokeRect(left, y - ratio, width, h + 2 * ratio);
    }
    g.font = `${isChosen ? 800 : 600} ${11.5 * ratio}px system-ui, sans-serif`;
    g.fillStyle = ink;
    g.textBaseline = "middle";
    g.textAlign = narrow ? "left" : "right";
    if (narrow) {
      g.lineWidth = 3 * ratio;
      g.strokeStyle = colour("paper");
      g.strokeText(lane.agent, left + 4 * ratio, y + h / 2);
    }
    const room = narrow ? width : left - 12 * ratio;
    g.fillText(cut(g, lane.agent, room), narrow ? left + 4 * ratio : left - 8 * ratio, y + h / 2);
  });
  g.restore();
}

/** Lines as areas on each other, a step per frame. */
export function stack(u: uPlot, panel: Panel, frames: number[]): void {
  const g = u.ctx;
  const { left, top, width, height } = u.bbox;
  g.save();
  g.beginPath();
  g.rect(left, top, width, height);
  g.clip();
  g.fillStyle = colour("lane");
  g.fillRect(left, top, width, height);
  const hidden = colour("hidden");
  frames.forEach((frame, row) => {
    const x = Math.round(u.valToPos(frame - 0.5, "x", true));
    const across = Math.round(u.valToPos(frame + 0.5, "x", true)) - x;
    let below = 0;
    for (const line of panel.lines) {
      const above = below + (line.values[row] ?? 0);
      const [y, end] = [u.valToPos(above, "y", true), u.valToPos(below, "y", true)];
      g.globalAlpha = line.colour === hidden ? 1 : 0.6; // a full area would outshine the other plots
      g.fillStyle = line.colour;
      g.fillRect(x, y, across, end - y);
      below = above;
    }
  });
  g.restore();
}

function cut(g: CanvasRenderingContext2D, text: string, room: number): string {
  let kept = text;
  while (kept.length > 1 && g.measureText(kept === text ? text : `${kept}…`).width > room) kept = kept.slice(0, -1);
  return kept === text ? text : `${kept}…`;
}

/** Every target's status over time. */
export function people(u: uPlot, targets: NonNullable<Panel["targets"]>, state: State): void {
  const g = u.ctx;
  const ratio = uPlot.pxRatio;
  const { left, top, width, height } = u.bbox;
  const tall = height / targets.length;
  g.save();
  g.textBaseline = "middle";
  g.textAlign = "right";
  targets.forEach(({ track, chosen }, index) => {
    const middle = top + (index + 0.5) * tall;
    g.font = `${chosen ? 700 : 450} ${Math.min(11.5, (tall / ratio) * 0.95) * ratio}px system-ui, sans-serif`;
    g.fillStyle = colour(chosen ? "ink" : "soft");
    g.fillText(cut(g, track.id, left - 12 * ratio), left - 8 * ratio, middle);
    g.save();
    g.beginPath();
    g.rect(left, top, width, height);
    g.clip();
    const x = (frame: number) => u.valToPos(frame, "x", true);
    for (let row = 0, from = 0; row < track.length; row += 1) {
      const status = track.status(row);
      const lasts = row + 1 < track.length && track.value("frame", row + 1) <= track.value("frame", row) + track.gap;
      if (lasts && track.status(row + 1) === status) continue;
      const [a, b] = [x(track.value("frame", from) - 0.5), x(track.value("frame", row) + 0.5)];
      const high = tall * (status === "lost" || status === "hidden" ? 0.9 : status === "uncertain" ? 0.7 : chosen ? 0.45 : 0.25);
      g.fillStyle = statusColour(track, status);
      g.fillRect(a, middle - high / 2, Math.max(b - a, ratio), high);
      from = row + 1;
    }
    for (const event of state.run.events) {
      if (event.sort !== "switch" || event.target !== track.id) continue;
      g.fillStyle = colour(event.on ? "on" : "off");
      g.fillRect(x(event.frame) - ratio, middle - tall * 0.38, 2 * ratio, tall * 0.76);
    }
    g.restore();
  });
  g.restore();
}

/** A triangle on the curve per switch (up: on, down: off), a square per camera, a diamond per change of status. */
export function marks(u: uPlot, panel: Panel, frames: number[], events: EventRow[]): void {
  const g = u.ctx;
  const ratio = uPlot.pxRatio;
  const { left, top, width, height } = u.bbox;
  const rows = new Map(frames.map((frame, row) => [frame, row]));
  for (const event of events) {
    if (event.sort === "note") continue;
    const x = u.valToPos(event.frame, "x", true);
    if (x < left - 1 || x > left + width + 1) continue;
    const value = panel.lines[0]!.values[rows.get(event.frame) ?? -1] ?? panel.range[0];
    const y = Math.min(u.valToPos(value, "y", true), top + height - 6 * ratio);
    const quiet = event.sort === "camera" ? "camera" : "ink";
    const ink = event.sort === "switch" ? (event.on ? "on" : "off") : event.status === "lost" ? "lost" : quiet;
    g.fillStyle = g.strokeStyle = colour(ink);
    g.lineWidth = ratio;
    g.globalAlpha = 0.35;
    g.beginPath();
    g.moveTo(x, y);
    g.lineTo(x, top + height);
    g.stroke();
    g.globalAlpha = 1;
    const s = 5 * ratio;
    g.beginPath();
    if (event.sort === "camera") g.rect(x - 0.8 * s, y - 0.8 * s, 1.6 * s, 1.6 * s);
    else if (event.sort !== "switch") {
      g.moveTo(x, y - s);
      g.lineTo(x + s, y);
      g.lineTo(x, y + s);
      g.lineTo(x - s, y);
    } else {
      const up = event.on ? -1 : 1;
      g.moveTo(x - s, y);
      g.lineTo(x + s, y);
      g.lineTo(x, y + up * 1.7 * s);
    }
    g.closePath();
    g.fill();
    g.strokeStyle = colour("paper");
    g.lineWidth = 0.8 * ratio;
    g.stroke();
  }
}

export function stems(u: uPlot, events: EventRow[]): void {
  const { left, top, width, height } = u.bbox;
  u.ctx.lineWidth = uPlot.pxRatio;
  for (const event of events) {
    const x = u.valToPos(event.frame, "x", true);
    if (event.sort !== "switch" || x < left || x > left + width) continue;
    u.ctx.strokeStyle = colour(event.on ? "on" : "off");
    u.ctx.globalAlpha = 0.4;
    u.ctx.beginPath();
    u.ctx.moveTo(x, top);
    u.ctx.lineTo(x, top + height);
    u.ctx.stroke();
    u.ctx.globalAlpha = 1;
  }
}
