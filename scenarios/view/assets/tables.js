// Tables and lists, made of elements: nothing that was read is ever taken for markup.

import { clock } from "ropeteam/model";

export function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [key, value] of Object.entries(attributes)) {
    if (key === "on") for (const [event, act] of Object.entries(value)) element.addEventListener(event, act);
    else if (key === "style") element.style.cssText = value;
    else if (value === true) element.setAttribute(key, "");
    else if (value !== false && value !== null && value !== undefined) element.setAttribute(key, value);
  }
  element.append(...children.filter((child) => child !== null && child !== undefined));
  return element;
}

// A table with a head row; cells are text or elements, numbers stand to the right.
export function table(head, rows, { caption, left = 1 } = {}) {
  const side = (i) => (i < left ? "" : "number");
  return make(
    "div",
    { class: "scroll", tabindex: "0", role: "region", "aria-label": caption ?? "table" },
    make(
      "table",
      {},
      make("thead", {}, make("tr", {}, ...head.map((cell, i) => make("th", { scope: "col", class: side(i) }, cell)))),
      make(
        "tbody",
        {},
        ...rows.map((row) =>
          make(
            "tr",
            {},
            ...row.map((cell, i) => make(i === 0 ? "th" : "td", { class: side(i), scope: i === 0 ? "row" : null }, cell)),
          ),
        ),
      ),
    ),
  );
}

const kilobytes = (bytes) => (bytes / 1000).toFixed(1);
const percent = (share, digits = 0) => `${(100 * share).toFixed(digits)}`;
export const some = (value, text) => (value === null || value === undefined ? "–" : text(value));

export function dot(colour) {
  return make("span", { class: "dot", style: `background:${colour}` });
}

export function robotTable(run, summary) {
  const head = ["robot", "role", "state", "looks", "driven, m", "sent, kB", "heard, kB", "link busy, %", "own cells", "known cells", "pose error, m rms"];
  const rows = run.robots.map((robot) => {
    const told = summary.robots[robot.name];
    const name = make("span", {}, dot(robot.colour), robot.name);
    return [
      name,
      told.role,
      told.state,
      String(told.looks || "–"),
      told.distance_m.toFixed(1),
      kilobytes(told.sent_bytes),
      kilobytes(told.received_bytes),
      percent(told.link_busy_fraction, 1),
      told.own_cells.toLocaleString("en"),
      told.team_cells.toLocaleString("en"),
      some(told.pose_error_rms_m, (m) => m.toFixed(3)),
    ];
  });
  return table(head, rows, { caption: "Robots", left: 3 });
}

export function bytesTable(run) {
  const kinds = run.kinds();
  if (kinds.length === 0) return make("p", { class: "empty" }, "Nothing was sent.");
  const sums = run.robots.map((robot) =>
    kinds.map((kind) => robot.frames.reduce((sum, frame) => sum + (frame.kind === kind ? frame.bytes : 0), 0)),
  );
  const totals = kinds.map((_, i) => sums.reduce((sum, row) => sum + row[i], 0));
  const all = totals.reduce((a, b) => a + b, 0);
  const number = (n) => (n === 0 ? "–" : n.toLocaleString("en"));
  const rows = run.robots.map((robot, i) => [
    make("span", {}, dot(robot.colour), robot.name),
    ...sums[i].map(number),
    number(sums[i].reduce((a, b) => a + b, 0)),
  ]);
  rows.push(["share", ...totals.map((n) => `${percent(n / all, 1)} %`), ""]);
  return table(["bytes spent on", ...kinds, "in all"], rows, { caption: "What the bytes were spent on" });
}

// A few figures beside each other.
function factRow(facts) {
  return make("dl", { class: "wide" }, ...facts.map(([key, value]) => make("div", {}, make("dt", {}, key), make("dd", {}, value))));
}

export function factTable(facts) {
  return make("dl", { class: "facts" }, ...facts.flatMap(([key, value]) => [make("dt", {}, key), make("dd", {}, value)]));
}

export function eventText(run, [robot, t, what, detail]) {
  const known = typeof robot === "number" ? run.robots[robot] : null;
  return { t, what, detail, name: known ? known.name : robot, colour: known ? known.colour : null, time: clock(t) };
}

// All that is told of a run that has ended, as cards, with one of its links among them.
export function endCards(run, links, { summary, scenario, versions }) {
  const team = summary.team;
  const facts = [
    ["simulated", clock(summary.simulated_s)],
    ["seed", String(summary.seed)],
    ["mapped", `${(100 * team.coverage).toFixed(1)} % of ${team.observable_cells.toLocaleString("en")} cells that can be seen`],
    ...(team.elevation_rmse_m === null ? [] : [["elevation error", `${team.elevation_rmse_m.toFixed(3)} m rms`]]),
    ["maps", team.maps_equal ? "all equal" : "they differ"],
    ...Object.entries(summary.mission).map(missionFact),
  ];
  const card = (title, ...more) => make("section", { class: "card" }, make("h2", {}, title), ...more);
  const note = (words) => make("p", { class: "small" }, words);
  return [
    card("What came out", factRow(facts)),
    card("Robots", robotTable(run, summary)),
    card("Bytes", note("Charged bytes, the modem's overhead included."), bytesTable(run)),
    links,
    make("details", { class: "card" }, make("summary", {}, "The scenario, complete"), note("The run's folder has it as scenario.toml; run that, and the same files come out."), make("pre", { tabindex: "0" }, scenario)),
    make("details", { class: "card" }, make("summary", {}, "Versions"), factTable(Object.entries(versions))),
  ];
}

// What a mission's figure says, e.g. ["cliffbot reached", "yes"].
function missionFact([key, value]) {
  if (typeof value === "boolean") return [key.replaceAll("_", " "), value ? "yes" : "no"];
  if (key.endsWith("_at_s")) return [key.slice(0, -5).replaceAll("_", " "), some(value, (t) => `at ${clock(t)}`)];
  return [key.replaceAll("_", " "), some(value, String)];
}
