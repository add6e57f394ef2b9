// Curves over simulated time, drawn by uPlot, with a line where the page stands.

import { clock } from "ropeteam/model";

const HEIGHT = 210;
const WIDTHS = [4.6, 3.5, 2.4, 1.3];
const CLOCK_STEPS = [1, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 14400, 21600, 43200, 86400];

// A chart of one curve per robot; `series(robot)` gives [[t, value] ...], values hold till the next.
export class Chart {
  constructor(place, { title, unit, curves, look, onPick, xText = clock, xLabel = "time" }) {
    this.place = place;
    this.curves = curves;
    this.now = 0;
    this.figure = document.createElement("figure");
    this.figure.className = "chart";
    const caption = document.createElement("figcaption");
    caption.textContent = title;
    this.body = document.createElement("div");
    this.figure.append(caption, this.body);
    place.append(this.figure);
    this.unit = unit;
    this.xText = xText;
    this.xLabel = xLabel;
    this.look = look;
    this.onPick = onPick;
    this.size = new ResizeObserver(() => requestAnimationFrame(() => this.fit()));
    this.size.observe(this.body);
  }

  fit() {
    const width = this.body.clientWidth;
    if (!this.plot || width === 0 || width === this.plot.width) return;
    this.plot.setSize({ width, height: HEIGHT });
  }

  show(columns) {
    this.columns = columns;
    if (this.plot) this.plot.setData(columns);
    else if (this.body.clientWidth > 0) this.make();
    this.tell();
  }

  make() {
    const axis = (more) => ({
      stroke: () => this.look().muted,
      grid: { stroke: () => this.look().line, width: 1 },
      ticks: { stroke: () => this.look().line, width: 1, size: 4 },
      font: this.look().font,
      ...more,
    });
    const options = {
      width: this.body.clientWidth,
      height: HEIGHT,
      cursor: { drag: { x: false, y: false }, points: { size: 5 } },
      legend: { live: true },
      scales: { x: { time: false } },
      axes: [
        axis({ values: (_, ticks) => ticks.map(this.xText), space: 80, ...(this.xText === clock ? { incrs: CLOCK_STEPS } : {}) }),
        axis({ values: (_, ticks) => ticks.map((value) => this.unit.tick(value)), size: 54 }),
      ],
      series: [
        { label: this.xLabel, value: (_, x) => (x === null || x === undefined ? "" : this.xText(x)) },
        ...this.curves.map(({ label, colour }, i) => ({
          label,
          stroke: colour,
          width: WIDTHS[i] ?? WIDTHS.at(-1), // curves that lie on each other stay visible
          paths: uPlot.paths.stepped({ align: 1 }),
          points: { show: false },
          spanGaps: true,
          value: (plot, _, curve, at) => this.valueText(plot.data[curve], at),
        })),
      ],
      hooks: { draw: [(plot) => this.line(plot)], ready: [() => this.tell()] },
    };
    this.plot = new uPlot(options, this.columns, this.body);
    this.plot.over.addEventListener("click", () => {
      const t = this.plot.posToVal(this.plot.cursor.left, "x");
      this.onPick?.(t);
    });
    this.plot.over.addEventListener("mouseleave", () => this.tell());
  }

  // The value of a curve at a point, which another curve may have brought in.
  valueText(values, at) {
    if (at === null || at === undefined) return "";
    const last = values.slice(0, at + 1).findLast((value) => value !== null && value !== undefined);
    return last === undefined ? "–" : this.unit.text(last);
  }

  // Shows what holds where the page stands, as long as nobody points elsewhere.
  tell() {
    if (!this.plot || this.plot.cursor.left >= 0) return;
    const times = this.plot.data[0];
    const next = this.now === null ? times.length : times.findIndex((t) => t > this.now);
    this.plot.setLegend({ idx: (next < 0 ? times.length : Math.max(next, 1)) - 1 });
  }

  line(plot) {
    if (this.now === null) return;
    const x = plot.valToPos(this.now, "x", true);
    const { left, top, width, height } = plot.bbox;
    if (x < left || x > left + width) return;
    plot.ctx.save();
    plot.ctx.strokeStyle = this.look().ink;
    plot.ctx.lineWidth = window.devicePixelRatio || 1;
    plot.ctx.globalAlpha = 0.6;
    plot.ctx.beginPath();
    plot.ctx.moveTo(x, top);
    plot.ctx.lineTo(x, top + height);
    plot.ctx.stroke();
    plot.ctx.restore();
  }

  at(t) {
    this.now = t;
    this.plot?.redraw(false, false);
    this.tell();
  }

  restyle() {
    this.plot?.redraw(false, true);
  }
}

// Columns for uPlot of several curves with times of their own, each held to `end` (null: not held).
export function together(curves, end) {
  const tables = curves.map((points) => {
    const last = end === null || points.length === 0 ? [] : [[end, points.at(-1)[1]]];
    const closed = points.length > 0 ? [...points, ...last] : [[0, null]];
    return [closed.map((p) => p[0]), closed.map((p) => p[1])];
  });
  return tables.length > 0 ? uPlot.join(tables) : [[0]];
}

// Points thinned to about as many as there are pixels: the last of each span is kept.
export function thinned(points, end_s, most = 600) {
  if (points.length <= most || end_s <= 0) return points;
  const kept = [];
  let span = -1;
  for (let i = points.length - 1; i >= 0; i -= 1) {
    const at = Math.floor((points[i][0] / end_s) * most);
    if (at !== span || i === 0) kept.push(points[i]);
    span = at;
  }
  return kept.reverse();
}

export function bytesCurve(robot) {
  let sum = 0;
  const points = [[0, 0]];
  for (const frame of robot.frames) {
    sum += frame.bytes;
    points.push([frame.start, sum]);
  }
  return points;
}

export function coverageCurve(robot, observable) {
  if (observable === 0) return [];
  let last = -1;
  const points = [];
  for (const [t, mapped] of robot.growth) {
    if (mapped !== last) points.push([t, (100 * mapped) / observable]);
    last = mapped;
  }
  return points;
}
