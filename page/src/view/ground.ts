/** Paints the ground in metres: cameras and what they see, targets with ellipses and trails. x to the right, y up. */

import type { RunData, Track } from "../data/run";
import type { State } from "../state";
import { DASH, inkOfTarget } from "./paint";

/** The part of the ground that is shown, m. */
export interface Ground {
  left: number;
  right: number;
  low: number;
  high: number;
}

const TRAIL_S = 3;
/** Chi-square of two degrees of freedom below which 90 % are. */
const LEVEL = 4.605;
/** Cameras that are farther from the targets are drawn at the border. */
const NEAR_M = 15;
const INK = "#b9c7d8";

/** What holds all targets and areas, and cameras near them. */
export function bounds(run: RunData): Ground {
  const xs: number[] = [];
  const ys: number[] = [];
  const take = (x: number, y: number) => Number.isFinite(x + y) && (xs.push(x), ys.push(y));
  for (const track of run.tracks.values()) {
    const step = Math.max(1, Math.floor(track.length / 500));
    for (let row = 0; row < track.length; row += step) take(track.value("ground", row, 0), track.value("ground", row, 1));
  }
  for (const plate of Object.values(run.plates)) for (const [x, y] of plate.area ?? []) take(x, y);
  if (xs.length === 0) return { left: -1, right: 1, low: -1, high: 1 };
  const [left, right, low, high] = [least(xs), -least(xs.map((x) => -x)), least(ys), -least(ys.map((y) => -y))];
  for (const { at } of run.cameras) {
    if (at === null) continue;
    const isNear = at[0] > left - NEAR_M && at[0] < right + NEAR_M && at[1] > low - NEAR_M && at[1] < high + NEAR_M;
    if (isNear) take(...at);
  }
  const room = 0.05 * Math.max(right - left, high - low) + 0.3;
  return { left: least(xs) - room, right: -least(xs.map((x) => -x)) + room, low: least(ys) - room, high: -least(ys.map((y) => -y)) + room };
}

function least(values: number[]): number {
  return values.reduce((a, b) => Math.min(a, b), Infinity);
}

/** From metres to px of the canvas. */
interface Plan {
  scale: number;
  x(metres: number): number;
  y(metres: number): number;
}

export function paintGround(
  g: CanvasRenderingContext2D,
  state: State,
  ground: Ground,
  { wide, tall }: { wide: number; tall: number },
  drawn: [Track, number][],
): void {
  const { left, right, low, high } = ground;
  const scale = Math.min(wide / (right - left), tall / (high - low));
  const [middleX, middleY] = [(left + right) / 2, (low + high) / 2];
  const plan: Plan = { scale, x: (m) => wide / 2 + (m - middleX) * scale, y: (m) => tall / 2 - (m - middleY) * scale };
  grid(g, plan, { left: middleX - wide / 2 / scale, right: middleX + wide / 2 / scale, low: middleY - tall / 2 / scale, high: middleY + tall / 2 / scale }, tall);
  for (const plate of Object.values(state.run.plates)) outline(g, plan, plate.area ?? [], "#d9a75f", 0, [5, 4]);
  if (state.layers.value.has("fields")) {
    for (const { name, field } of state.run.cameras) outline(g, plan, field, INK, state.camera.value === name ? 0.16 : 0.05, []);
  }
  cameras(g, plan, state, { wide, tall });
  for (const [track, row] of drawn) {
    if (state.layers.value.has("trails")) trail(g, plan, track, row);
    if (state.layers.value.has("ellipses")) ellipse(g, plan, track, row, track.id === state.target.value);
  }
  for (const [track, row] of drawn) spot(g, plan, track, row, track.id === state.target.value);
}

function grid(g: CanvasRenderingContext2D, plan: Plan, shown: Ground, tall: number): void {
  const step = [0.5, 1, 2, 5, 10, 20, 50, 100].find((metres) => metres * plan.scale >= 34) ?? 200;
  g.font = "10px system-ui, sans-serif";
  g.textBaseline = "alphabetic";
  for (let m = Math.ceil(shown.left / step) * step; m <= shown.right; m += step) {
    g.fillStyle = "rgba(185,199,216,.13)";
    g.fillRect(Math.round(plan.x(m)), 0, 1, tall);
    g.fillStyle = "#94a3b5";
    g.fillText(`${Number(m.toFixed(1))}${m + step > shown.right ? " m" : ""}`, plan.x(m) + 3, tall - 4);
  }
  for (let m = Math.ceil(shown.low / step) * step; m <= shown.high; m += step) {
    g.fillStyle = "rgba(185,199,216,.13)";
    g.fillRect(0, Math.round(plan.y(m)), plan.x(shown.right), 1);
    g.fillStyle = "#94a3b5";
    if (plan.y(m) < tall - 16 && plan.y(m) > 34) g.fillText(String(Number(m.toFixed(1))), 3, plan.y(m) - 3);
  }
}

function outline(g: CanvasRenderingContext2D, plan: Plan, corners: [number, number][], ink: string, fill: number, dash: number[]): void {
  if (corners.length < 3) return;
  g.save();
  g.beginPath();
  for (const [x, y] of corners) g.lineTo(plan.x(x), plan.y(y));
  g.closePath();
  g.fillStyle = g.strokeStyle = ink;
  g.globalAlpha = fill;
  g.fill();
  g.globalAlpha = 0.5;
  g.setLineDash(dash);
  g.stroke();
  g.restore();
}

/** A camera stands where it is, or at the border in its direction; one that was knocked is red. */
function cameras(g: CanvasRenderingContext2D, plan: Plan, state: State, { wide, tall }: { wide: number; tall: number }): void {
  const frame = state.frame.value;
  g.font = "600 11px system-ui, sans-serif";
  g.textBaseline = "middle";
  for (const { name, at, field } of state.run.cameras) {
    if (at === null) continue;
    const isKnocked = state.run.events.some((event) => event.kind === "camera_knocked" && event.camera === name && event.frame <= frame);
    const [x, y] = [Math.min(Math.max(plan.x(at[0]), 8), wide - 8), Math.min(Math.max(plan.y(at[1]), 8), tall - 8)];
    const towards = field.length > 0 ? field.reduce(([a, b], [p, q]) => [a + p / field.length, b + q / field.length], [0, 0]) : at;
    const way = Math.atan2(plan.y(towards[1]!) - plan.y(at[1]), plan.x(towards[0]!) - plan.x(at[0]));
    g.save();
    g.translate(x, y);
    g.rotate(way);
    g.fillStyle = isKnocked ? "#ff7a59" : "#e8edf3";
    g.beginPath();
    g.moveTo(9, -6);
    g.lineTo(-5, 0);
    g.lineTo(9, 6);
    g.closePath();
    g.fill();
    g.restore();
    const text = isKnocked ? `${name}, knocked` : name;
    const long = g.measureText(text).width;
    const place = x + 12 + long > wide ? x - 12 - long : x + 12;
    g.fillStyle = isKnocked ? "#ff7a59" : "#e8edf3";
    g.fillText(text, place, Math.min(Math.max(y, 8), tall - 22));
  }
}

function trail(g: CanvasRenderingContext2D, plan: Plan, track: Track, row: number): void {
  const end = track.value("time_s", row);
  g.save();
  g.strokeStyle = inkOfTarget(track);
  g.lineWidth = 2;
  for (let k = row; k > 0; k -= 1) {
    const age = end - track.value("time_s", k - 1);
    if (!(age <= TRAIL_S)) break;
    g.globalAlpha = 0.75 * (1 - age / TRAIL_S) + 0.05;
    g.beginPath();
    g.moveTo(plan.x(track.value("ground", k - 1, 0)), plan.y(track.value("ground", k - 1, 1)));
    g.lineTo(plan.x(track.value("ground", k, 0)), plan.y(track.value("ground", k, 1)));
    g.stroke();
  }
  g.restore();
}

function ellipse(g: CanvasRenderingContext2D, plan: Plan, track: Track, row: number, chosen: boolean): void {
  const [x, y, sdX, sdY, corr] = track.values("ground", row) as [number, number, number, number, number];
  if (!Number.isFinite(x + y + sdX + sdY + corr)) return;
  const [a, b, c] = [sdX * sdX, corr * sdX * sdY, sdY * sdY];
  const [mean, spread] = [(a + c) / 2, Math.hypot((a - c) / 2, b)];
  const radius = (variance: number) => Math.sqrt(LEVEL * Math.max(variance, 0)) * plan.scale;
  g.save();
  g.beginPath();
  g.ellipse(plan.x(x), plan.y(y), radius(mean + spread), radius(mean - spread), -0.5 * Math.atan2(2 * b, a - c), 0, 2 * Math.PI);
  g.fillStyle = g.strokeStyle = inkOfTarget(track);
  g.globalAlpha = 0.22;
  g.fill();
  g.globalAlpha = 1;
  g.lineWidth = chosen ? 2 : 1.25;
  g.setLineDash(DASH[track.status(row)] ?? []);
  g.stroke();
  g.restore();
}

function spot(g: CanvasRenderingContext2D, plan: Plan, track: Track, row: number, chosen: boolean): void {
  const [x, y] = [plan.x(track.value("ground", row, 0)), plan.y(track.value("ground", row, 1))];
  if (!Number.isFinite(x + y)) return;
  g.fillStyle = inkOfTarget(track);
  g.beginPath();
  g.arc(x, y, chosen ? 3 : 2, 0, 2 * Math.PI);
  g.fill();
  g.font = `${chosen ? 700 : 600} 12px system-ui, sans-serif`;
  g.textBaseline = "middle";
  g.lineWidth = 3;
  g.strokeStyle = "rgba(12,17,24,.85)";
  g.strokeText(track.id, x + 8, y - 9);
  g.fillText(track.id, x + 8, y - 9);
}
