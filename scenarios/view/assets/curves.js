// The curves of a run: what was sent, what was mapped, how busy the air was.

import { Chart, bytesCurve, coverageCurve, thinned, together } from "ropeteam/charts";
import { airCurve, windowOf } from "ropeteam/links";

const tick = (v) => String(v);
const percent = { tick, text: (v) => `${v.toFixed(1)} %` };
const kilobytes = { tick, text: (v) => `${v.toFixed(1)} kB` };

export class Curves {
  constructor(place, run, { look, onPick }) {
    this.run = run;
    const curves = run.robots.map((robot) => ({ label: robot.name, colour: robot.colour }));
    const chart = (title, unit) => new Chart(place, { title, unit, curves, look, onPick });
    this.bytes = chart("Sent so far, kB", kilobytes);
    this.coverage = chart("Mapped, % of the cells that can be seen", percent);
    this.air = chart("On the air, % of the time", percent);
    this.all = [this.bytes, this.coverage, this.air];
  }

  show(end_s) {
    const { robots, head } = this.run;
    const end = Math.max(end_s, 1);
    const window_s = windowOf(end);
    const bytes = robots.map((robot) => thinned(bytesCurve(robot), end).map(([t, sum]) => [t, sum / 1000]));
    this.bytes.show(together(bytes, end));
    this.coverage.show(together(robots.map((robot) => thinned(coverageCurve(robot, head.observable_cells), end)), end));
    this.air.show(together(robots.map((robot) => airCurve(robot, end, window_s)), end));
  }

  at(t) {
    for (const chart of this.all) chart.at(t);
  }

  restyle() {
    for (const chart of this.all) chart.restyle();
  }
}
