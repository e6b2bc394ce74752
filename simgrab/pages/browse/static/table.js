// Columns, loaded when they are first needed, and filters on them that are applied here, over all rows.

import { ask } from "./dom.js";

const MOST_BARS = 40; // of a histogram; fewer of few rows
const NONE = 255; // bin of a row without a value

export class Table {
  constructor(summary) {
    this.rows = summary.rows;
    this.columns = new Map(summary.columns.map((column, index) => [column.name, { ...column, index }]));
    this.filters = new Map(); // name: { kind, from, to } or { levels } or { text }, each with `out`, 1 where it fails
    this.fails = new Uint8Array(this.rows); // how many filters a row fails
    this.passing = this.rows;
    this.orders = new Map();
    this.waiting = new Map(); // columns on their way
  }

  /** Load a column's values: floats with NaN, or codes. */
  load(name) {
    const column = this.columns.get(name);
    if (!this.waiting.has(name))
      this.waiting.set(name, ask(`/api/columns/${column.index}`).then((answer) => answer.arrayBuffer()).then((data) => {
        column.values = column.kind === "number" ? new Float64Array(data) : new Uint32Array(data);
        if (column.kind !== "text") this.bin(column);
        return column;
      }));
    return this.waiting.get(name);
  }

  /** Put each row into a bar of the column's histogram; bars that are wider than needed have one number each. */
  bin(column) {
    const { values } = column;
    column.bins = new Uint8Array(this.rows);
    if (column.kind === "category") {
      column.bars = column.levels.length;
      column.bins.set(values);
      return;
    }
    const [low, high] = column.span ?? [0, 0];
    const most = Math.min(MOST_BARS, Math.max(8, Math.ceil(2 * Math.sqrt(this.rows))));
    const whole = high - low < MOST_BARS && values.every((value) => Number.isNaN(value) || Number.isInteger(value));
    column.whole = whole;
    column.bars = high > low ? (whole ? high - low + 1 : most) : 1;
    const factor = whole ? 1 : column.bars / (high - low || 1);
    for (let i = 0; i < this.rows; i++) {
      const value = values[i];
      column.bins[i] = Number.isNaN(value) ? NONE : Math.min(Math.floor((value - low) * factor), column.bars - 1);
    }
  }

  /** Numbers that a bar of a histogram stands for. */
  bar(column, index) {
    const [low, high] = column.span;
    if (column.whole) return [low + index, low + index];
    const width = (high - low) / column.bars;
    return [low + index * width, index === column.bars - 1 ? high : low + (index + 1) * width];
  }

  /** Set a column's filter, or with null remove it. */
  async filter(name, wanted) {
    const column = await this.load(name);
    const bits = wanted?.text ? new Uint8Array(await (await ask(
      `/api/columns/${column.index}/matches?text=${encodeURIComponent(wanted.text)}`)).arrayBuffer()) : null;
    const old = this.filters.get(name);
    const out = wanted ? new Uint8Array(this.rows) : null;
    if (out) fill(out, column, wanted, bits);
    let passing = 0;
    for (let i = 0; i < this.rows; i++) {
      const fails = this.fails[i] - (old ? old.out[i] : 0) + (out ? out[i] : 0);
      this.fails[i] = fails;
      passing += fails === 0;
    }
    this.passing = passing;
    if (wanted) this.filters.set(name, { ...wanted, out });
    else this.filters.delete(name);
  }

  /** Count rows in each bar of a column: all, and those that pass every filter but the column's own. */
  counts(name) {
    const { bins, bars } = this.columns.get(name);
    const own = this.filters.get(name)?.out;
    const all = new Uint32Array(256);
    const left = new Uint32Array(256);
    for (let i = 0; i < this.rows; i++) {
      all[bins[i]]++;
      if (this.fails[i] === (own ? own[i] : 0)) left[bins[i]]++;
    }
    return { all: all.subarray(0, bars), left: left.subarray(0, bars) };
  }

  /** Rows that pass, in the order of a column; those without a value come last. */
  async sorted(name, descending) {
    const order = await this.order(name, descending);
    const found = new Uint32Array(this.passing);
    let count = 0;
    for (let i = 0; i < order.length; i++) if (this.fails[order[i]] === 0) found[count++] = order[i];
    return found;
  }

  async order(name, descending) {
    const key = `${descending ? "-" : "+"}${name}`;
    if (!this.orders.has(key)) {
      const { values } = await this.load(name);
      const known = [];
      const unknown = [];
      for (let i = 0; i < this.rows; i++) (Number.isNaN(values[i]) ? unknown : known).push(i);
      const sign = descending ? -1 : 1;
      const order = Uint32Array.from(known).sort((a, b) => sign * (values[a] - values[b]) || a - b);
      const whole = new Uint32Array(this.rows);
      whole.set(order);
      whole.set(unknown, order.length);
      if (this.orders.size > 8) this.orders.delete(this.orders.keys().next().value);
      this.orders.set(key, whole);
    }
    return this.orders.get(key);
  }
}

const fill = (out, column, wanted, bits) => {
  const { values } = column;
  if (column.kind === "number") {
    const { from, to } = wanted;
    for (let i = 0; i < out.length; i++) out[i] = values[i] >= from && values[i] <= to ? 0 : 1;
  } else if (column.kind === "category") {
    const kept = column.levels.map((level) => (wanted.levels.has(level) ? 0 : 1));
    for (let i = 0; i < out.length; i++) out[i] = kept[values[i]];
  } else {
    for (let i = 0; i < out.length; i++) out[i] = bits ? 1 - ((bits[i >> 3] >> (i & 7)) & 1) : 0;
  }
};
