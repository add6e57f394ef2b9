// What the page looks like: its legend, and its colours in light and dark.

import { KIND_COLOURS } from "ropeteam/panel";
import { scaleGradient } from "ropeteam/shade";
import { make } from "ropeteam/tables";

// What the colours and lines on the panels mean.
export function legend(run, range) {
  const { head } = run;
  const items = [];
  if (run.isPlanar) {
    items.push(make("span", {}, make("i", { class: "swatch", style: "background:#f6ecd8" }), "free"));
    items.push(make("span", {}, make("i", { class: "swatch", style: "background:#7a3d34" }), "solid"));
  } else {
    const [low, high] = range.map((level) => head.scale.low + (level - 1) * head.scale.step);
    const bar = make("i", { class: "bar", style: `background:${scaleGradient()}` });
    items.push(make("span", {}, `${low.toFixed(1)} m`, bar, `${high.toFixed(1)} m elevation`));
  }
  items.push(make("span", {}, make("i", { class: "swatch pale" }), "paler: told by team-mates, not seen itself"));
  const kinds = make("span", { class: "kinds" }, "on the air:");
  for (const [kind, colour] of Object.entries(KIND_COLOURS)) {
    kinds.append(make("span", {}, make("i", { class: "line", style: `background:${colour}` }), kind));
  }
  items.push(kinds);
  items.push(make("span", {}, "dashed: planned way and look"));
  return make("div", { class: "legend" }, ...items);
}

// The page's colours as a canvas wants them.
export function readTheme() {
  const probe = make("span", { hidden: true });
  document.body.append(probe);
  const colour = (name) => {
    probe.style.color = `var(--${name})`;
    return getComputedStyle(probe).color;
  };
  const rgb = (name) => colour(name).match(/\d+/g).slice(0, 3).map(Number);
  const theme = {
    ink: colour("ink"),
    muted: colour("muted"),
    line: colour("line"),
    panel: colour("panel"),
    bad: colour("bad"),
    rock: rgb("rock"),
    floor: [rgb("floor-free"), rgb("floor-solid")],
    font: `500 12px ${getComputedStyle(document.body).fontFamily}`,
  };
  probe.remove();
  return theme;
}
