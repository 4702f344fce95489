/** Numbers and names as they stand on the page. */

export function short(value: number): string {
  if (!Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  if (size >= 1e6) return value.toExponential(1).replace("e+", "e");
  if (size >= 1000) return String(Math.round(value));
  if (size !== 0 && size < 0.001) return value.toExponential(0);
  return String(Number(value.toPrecision(3)));
}

export function percent(share: number, digits = 0): string {
  return Number.isFinite(share) ? `${(100 * share).toFixed(digits)} %` : "–";
}

export function duration(ms: number): string {
  if (!Number.isFinite(ms)) return "–";
  return ms >= 1000 ? `${short(ms / 1000)} s` : `${short(ms)} ms`;
}

export function plural(count: number, noun: string): string {
  return `${count.toLocaleString("en")} ${noun}${count === 1 ? "" : "s"}`;
}

/** "ball 1": what a target is, and which one. */
export function nameOf(track: { id: string; plate: string }): string {
  return track.plate === "" ? `target ${track.id}` : `${track.plate} ${track.id}`;
}

/** What follows a number of a rule, and the word for the rule. */
export const RULES: Record<string, string> = {
  activate: "switch on above",
  deactivate: "switch off below",
  on_call: "runs at once above",
  learn: "learn below",
  lost: "lost above",
  self_check: "stops itself above",
  score_below: "lost below",
  uncertain_below: "uncertain below",
};

export const UNITS: Record<string, string> = { ud_box: " × box area", ud_baseline: " × baseline" };
