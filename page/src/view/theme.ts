/** Colours for canvases, from the style sheet, so that light, dark and print stand in one place. */

/** Okabe and Ito's palette, which people with any colour vision can tell apart; lines also differ in dash. */
export const AGENTS = 8;

export function colour(name: string): string {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

export function agentColour(index: number): string {
  return colour(`agent-${index % AGENTS}`);
}

export function statusColour(status: string): string {
  return colour(status === "lost" ? "lost" : status === "uncertain" ? "uncertain" : "tracking");
}

export function agentVariable(index: number): string {
  return `var(--agent-${index % AGENTS})`;
}
