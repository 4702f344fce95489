/** Colours for canvases, from the style sheet, so that light, dark and print stand in one place. */

/** Okabe and Ito's palette, which people with any colour vision can tell apart; lines also differ in dash. */
export const AGENTS = 8;

export function colour(name: string): string {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

export function agentColour(index: number): string {
  return colour(`agent-${index % AGENTS}`);
}

/** Gray for what is followed without a fitted score: nothing says that it is on the target. */
export function statusName(track: { calibrated: boolean }, status: string): string {
  if (status === "lost" || status === "uncertain" || status === "hidden") return status;
  return status === "tracking" && !track.calibrated ? "soft" : "tracking";
}

export function statusColour(track: { calibrated: boolean }, status: string): string {
  return colour(statusName(track, status));
}

export function agentVariable(index: number): string {
  return `var(--agent-${index % AGENTS})`;
}
