// A report: all that a run left, in this file.

import { Page } from "ropeteam/controls";
import { embedded } from "ropeteam/data";
import { Run } from "ropeteam/model";

const root = document.getElementById("page");
try {
  const { head, rows, end } = await embedded(document.getElementById("data"));
  const run = new Run(head);
  run.take(rows);
  run.advance(end.summary.simulated_s);
  const page = new Page(root, run);
  page.pickSpeed();
  page.showEnd(end);
  page.refresh();
  page.showCurves();
  const asked = /[#&]t=([\d.]+)/.exec(location.hash);
  page.seek(asked ? Number(asked[1]) : run.last_s);
  document.documentElement.dataset.ready = "yes";
} catch (error) {
  root.textContent = `This report can't be shown: ${error.message}. A browser of 2024 or later is needed.`;
  throw error;
}
