/** Boxes that are drawn and pulled. Lengths are px of the source. */

/** Top-left corner and size. */
export type Box = [number, number, number, number];

/** What is pulled of a box: the sides, -1 the left or upper one, 1 the other; null is the box as a whole. */
export interface Pull {
  was: Box;
  sides: [number, number] | null;
}

export const LEAST = 3;
export const HANDLES: [number, number][] = [[-1, -1], [0, -1], [1, -1], [-1, 0], [1, 0], [-1, 1], [0, 1], [1, 1]];
export const CURSORS: Record<string, string> = { "-1,-1": "nwse", "1,1": "nwse", "1,-1": "nesw", "-1,1": "nesw", "0,-1": "ns", "0,1": "ns", "-1,0": "ew", "1,0": "ew" };

/** A side that is pulled stops at the frame's border, and may cross the one opposite. */
export function moved({ was: [x, y, w, h], sides }: Pull, dx: number, dy: number, width: number, height: number): Box {
  if (sides === null) return [x + dx, y + dy, w, h];
  const along = (start: number, size: number, side: number, d: number, room: number): [number, number] => {
    const ends = [side < 0 ? start + d : start, side > 0 ? start + size + d : start + size];
    const [a, b] = ends.map((end) => Math.min(Math.max(end, 0), room)) as [number, number];
    return [Math.min(a, b), Math.abs(b - a)];
  };
  const [[left, wide], [top, tall]] = [along(x, w, sides[0], dx, width), along(y, h, sides[1], dy, height)];
  return [left, top, wide, tall];
}

/** Whole pixels, inside the frame; a box that is moved keeps its size. */
export function fitted([x, y, w, h]: Box, width: number, height: number): Box {
  const along = (start: number, size: number, room: number): [number, number] => {
    const whole = Math.min(Math.max(LEAST, Math.round(size)), room);
    return [Math.min(Math.max(Math.round(start), 0), room - whole), whole];
  };
  const [[left, wide], [top, tall]] = [along(x, w, width), along(y, h, height)];
  return [left, top, wide, tall];
}
