// Runs side by side: curves laid over each other, and a table of all figures.

import { Chart, together } from "ropeteam/charts";
import { embedded } from "ropeteam/data";
import { readTheme } from "ropeteam/looks";
import { dot, make } from "ropeteam/tables";

const root = document.getElementById("page");
let theme = null;
const charts = [];

const number = (value) => typeof value === "number";

function valueText(value) {
  if (value === null) return "–";
  if (typeof value === "boolean") return value ? "yes" : "no";
  if (!number(value)) return value;
  if (Number.isInteger(value)) return value.toLocaleString("en");
  return Math.abs(value) < 10000 ? String(Number(value.toPrecision(4))) : Math.round(value).toLocaleString("en");
}

function difference(first, value) {
  if (!number(first) || !number(value) || first === value) return null;
  const change = value - first;
  if (first !== 0 && Math.abs(change / first) < 0.0005) return null;
  if (first === 0 || Math.abs(change / first) > 10) return `${change > 0 ? "+" : ""}${Number(change.toPrecision(3))}`;
  return `${change > 0 ? "+" : "−"}${Math.abs((100 * change) / first).toFixed(1)} %`;
}

function cell(first, value, isFirst) {
  const change = isFirst ? null : make("span", { class: "change" }, difference(first, value) ?? "");
  return make("td", { class: "number" }, valueText(value), change);
}

// One row for each key, with the first run's figure and how the others differ from it.
function rowsOf({ keys, runs }, wanted) {
  return keys.flatMap(([key, isMain], i) => {
    if (!wanted(key)) return [];
    const values = runs.map((run) => run.values[i]);
    const same = values.every((value) => JSON.stringify(value) === JSON.stringify(values[0]));
    const row = make("tr", { class: same ? "same" : "differs" }, make("th", { scope: "row" }, key), ...values.map((v, n) => cell(values[0], v, n === 0)));
    row.dataset.main = isMain;
    return [row];
  });
}

// A table of all runs; with `changes` there is room for how each differs from the first.
function tableOf(title, runs, rows, changes = true) {
  const head = make("tr", {}, make("th", { scope: "col" }, ""), ...runs.map((run, n) => make("th", { scope: "col", class: "number" }, dot(run.colour), run.label, changes && n > 0 ? make("span", { class: "change" }) : null)));
  const table = make("table", {}, make("thead", {}, head), make("tbody", {}, ...rows));
  return make("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": title }, table);
}

// What was set differently; nothing but the seed, as often as not.
function settings({ settings, runs }) {
  const card = (...parts) => make("section", { class: "card" }, make("h2", {}, "Set differently"), ...parts);
  if (settings.length === 0) return card(make("p", { class: "small" }, "Nothing but, perhaps, the seed: the scenarios are the same."));
  const text = (value) => (value === null ? "–" : typeof value === "number" ? String(value) : valueText(value));
  const rows = settings.map(([key, values]) =>
    make("tr", {}, make("th", { scope: "row" }, key), ...values.map((value) => make("td", { class: "number" }, text(value)))),
  );
  return card(tableOf("Set differently", runs, rows, false));
}

// The team's figures in sight, those of each robot folded away.
function figures(data) {
  const isRobots = (key) => key.startsWith("robots.");
  const team = rowsOf(data, (key) => !isRobots(key) && key !== "outcome_reason"); // it stands above
  const robots = rowsOf(data, isRobots);
  const all = make("input", { type: "checkbox", on: { change: () => show() } });
  const show = () => {
    for (const row of [...team, ...robots]) row.hidden = !all.checked && row.dataset.main === "false" && row.className === "same";
  };
  show();
  const note = make("p", { class: "small" }, "Differences are against the first run. ", make("label", {}, all, " also what is equal in all runs"));
  return [
    make("section", { class: "card" }, make("h2", {}, "Figures"), note, tableOf("Figures", data.runs, team)),
    make("details", { class: "card" }, make("summary", {}, "Figures of each robot"), tableOf("Figures of each robot", data.runs, robots)),
  ];
}

function chart(place, runs, title, curvesOf, texts) {
  const curves = runs.map((run) => ({ label: run.label, colour: run.colour }));
  const drawn = new Chart(place, { title, curves, look: () => theme, ...texts });
  drawn.now = null;
  const points = runs.map(curvesOf);
  const end = Math.max(1e-9, ...points.flat().map((point) => point[0]), ...(texts.xText ? [] : runs.map((run) => run.end_s)));
  drawn.show(together(points, texts.xText ? null : end));
  charts.push(drawn);
}

// The coverage that was there by the time so many kilobytes had been sent.
function coverageBySent(run) {
  let at = 0;
  const points = [];
  for (const [t, sent] of run.sent) {
    while (at < run.coverage.length && run.coverage[at][0] <= t) at += 1;
    if (at > 0) points.push([sent, run.coverage[at - 1][1]]);
  }
  return points;
}

try {
  const data = await embedded(document.getElementById("data"));
  theme = readTheme();
  const places = make("section", { class: "charts", "aria-label": "Curves" });
  root.append(
    make("header", { class: "top" }, make("div", {}, make("h1", {}, "Runs side by side"), make("ul", { class: "runs" }, ...data.runs.map((run) =>
      make("li", {}, dot(run.colour), make("strong", {}, run.label), ` ${run.reason}`))))),
    settings(data),
    places,
    make("div", { class: "tables" }, ...figures(data)),
  );
  const percent = { tick: (v) => String(v), text: (v) => `${v.toFixed(1)} %` };
  const kilobytes = { tick: (v) => String(v), text: (v) => `${v.toFixed(1)} kB` };
  chart(places, data.runs, "The best map, % of the cells that can be seen", (run) => run.coverage, { unit: percent });
  chart(places, data.runs, "Sent by the team, kB", (run) => run.sent, { unit: kilobytes });
  chart(places, data.runs, "The best map (%) by kB sent", coverageBySent, {
    unit: percent,
    xLabel: "sent",
    xText: (kB) => `${kB.toLocaleString("en")} kB`,
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
    theme = readTheme();
    for (const drawn of charts) drawn.restyle();
  });
  document.documentElement.dataset.ready = "yes";
} catch (error) {
  root.textContent = `This page can't be shown: ${error.message}. A browser of 2024 or later is needed.`;
  throw error;
}
