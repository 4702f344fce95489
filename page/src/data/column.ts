/** Numbers in rows of equal width that may grow, as they do while a run goes on. */

export type Numbers = Float32Array | Float64Array | Int32Array | Int16Array | Uint8Array;

export const KINDS = {
  f4: Float32Array,
  f8: Float64Array,
  i4: Int32Array,
  i2: Int16Array,
  u1: Uint8Array,
} as const;

export type Kind = keyof typeof KINDS;

export class Column {
  constructor(
    private data: Numbers,
    readonly width = 1,
    private used = data.length,
  ) {}

  static empty(kind: Kind, width = 1): Column {
    return new Column(new KINDS[kind](16 * width), width, 0);
  }

  /** Number of rows. */
  get length(): number {
    return this.used / this.width;
  }

  at(row: number, place = 0): number {
    return row < 0 || row >= this.length ? NaN : this.data[row * this.width + place]!;
  }

  row(row: number): number[] {
    return Array.from({ length: this.width }, (_, place) => this.at(row, place));
  }

  push(...values: number[]): void {
    if (values.length !== this.width) throw new RangeError(`${values.length} values in a row of ${this.width}`);
    if (this.used + this.width > this.data.length) {
      const grown = new (this.data.constructor as new (n: number) => Numbers)(Math.max(16, 2 * this.data.length));
      grown.set(this.data);
      this.data = grown;
    }
    this.data.set(values, this.used);
    this.used += this.width;
  }

  /** Rows of `value` until there are `rows`: for what begins to be measured late. */
  fill(rows: number, value: number): void {
    while (this.length < rows) this.push(...Array<number>(this.width).fill(value));
  }
}
