// The links of a run, one by one: what crossed each, what was lost, and how long it took.

import { dot, make, table } from "ropeteam/tables";

const MOST_WINDOWS = 120; // of the curve of air time
const WINDOWS_S = [10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600];

// Length of the windows in which air time is reckoned, for a run of so many seconds.
export const windowOf = (end_s) => WINDOWS_S.find((length) => end_s / length <= MOST_WINDOWS) ?? WINDOWS_S.at(-1);

// The share of each window (%) in which a robot's transmitter was busy.
export function airCurve(robot, end_s, window_s) {
  const busy = new Float64Array(Math.max(1, Math.ceil(end_s / window_s)));
  for (const { start, end } of robot.frames) {
    const [first, last] = [start, end].map((t) => Math.min(busy.length - 1, Math.floor(t / window_s)));
    for (let i = first; i <= last; i += 1) busy[i] += Math.max(0, Math.min(end, (i + 1) * window_s) - Math.max(start, i * window_s));
  }
  const length = (i) => Math.max(1e-9, Math.min(end_s, (i + 1) * window_s) - i * window_s);
  return [...busy].map((s, i) => [i * window_s, Math.min(100, (100 * s) / length(i))]);
}

// What is told of one link, by what one asks for; `none` where nothing was sent.
const MEASURES = {
  "frames heard": ({ heard, told }) => (heard === told ? count(heard) : `${count(heard)} of ${count(told)}`),
  "lost, %": ({ heard, told }) => (heard === told ? "0" : ((100 * (told - heard)) / told).toFixed(1)),
  "heard, kB": ({ bytes }) => (bytes / 1000).toFixed(1),
  "delay in the middle, s": ({ delays }) => quantile(delays, 0.5),
  "delay of the slowest 5 %, s": ({ delays }) => quantile(delays, 0.95),
};

const count = (n) => n.toLocaleString("en");

function quantile(sorted, share) {
  if (sorted.length === 0) return "–";
  return sorted[Math.min(sorted.length - 1, Math.floor(share * sorted.length))].toFixed(3);
}

// What became of the frames of one robot at another.
function fate(from, to) {
  const found = { told: 0, heard: 0, bytes: 0, delays: [], lost: new Map() };
  for (const frame of from.frames) {
    const [arrive, verdict] = frame.heard.get(to.index) ?? [];
    if (verdict === undefined) continue;
    found.told += 1;
    if (verdict === "delivered") {
      found.heard += 1;
      found.bytes += frame.bytes;
      found.delays.push(arrive - frame.chosen);
    } else found.lost.set(verdict, (found.lost.get(verdict) ?? 0) + 1);
  }
  found.delays.sort((a, b) => a - b);
  return found;
}

// From the robot of the row to that of the column, by a measure that the reader chooses.
export function linkCard(run) {
  const fates = run.robots.map((from) => run.robots.map((to) => (from === to ? null : fate(from, to))));
  const place = make("div", {});
  const show = (measure) => {
    const cell = (found) => (found === null ? "" : found.told === 0 ? "–" : MEASURES[measure](found));
    const rows = run.robots.map((from, i) => [make("span", {}, dot(from.colour), from.name), ...fates[i].map(cell)]);
    place.replaceChildren(table(["from \\ to", ...run.robots.map((robot) => robot.name)], rows, { caption: `Links: ${measure}` }));
  };
  const choice = make(
    "select",
    { "aria-label": "What is told of each link", on: { change: () => show(choice.value) } },
    ...Object.keys(MEASURES).map((measure) => make("option", {}, measure)),
  );
  show(choice.value);
  return make(
    "section",
    { class: "card" },
    make("h2", {}, "Links"),
    make("p", { class: "small" }, make("label", {}, "From the robot of the row to that of the column: ", choice), " Delay is from the choice of a frame to its arrival."),
    place,
    losses(fates),
  );
}

// Why frames were not heard, the most frequent reason first.
function losses(fates) {
  const reasons = new Map();
  for (const found of fates.flat()) for (const [why, n] of found?.lost ?? []) reasons.set(why, (reasons.get(why) ?? 0) + n);
  const words = [...reasons].sort((a, b) => b[1] - a[1]).map(([why, n]) => `${why} ${count(n)}`);
  return make("p", { class: "small" }, words.length > 0 ? `Not heard: ${words.join(", ")}.` : "Every frame was heard.");
}
