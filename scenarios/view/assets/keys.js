// What the keys do, and the list of it that "?" opens.

import { make } from "ropeteam/tables";

const STEP_S = 5;
const FAR_S = 60;
const HELP = [
  ["space", "play, pause; of a run that goes on: hold it, let it go"],
  ["← →", `${STEP_S} simulated seconds back, on; with shift a minute`],
  ["Home, End", "to the start, to the end"],
  ["0", "over the truth, what any robot knows"],
  ["1 to 9", "over the truth, what the first, second ... robot knows"],
  ["t", "the truth alone"],
  ["d", "light or dark"],
  ["?", "this list"],
  ["Tab", "to everything else"],
];

export class Keys {
  constructor(page) {
    this.page = page;
    this.dialog = make(
      "dialog",
      { class: "card help", "aria-label": "Keys" },
      make("h2", {}, "Keys"),
      make("dl", { class: "facts" }, ...HELP.flatMap(([key, does]) => [make("dt", {}, make("kbd", {}, key)), make("dd", {}, does)])),
      make("form", { method: "dialog" }, make("button", {}, "Close")),
    );
    this.button = make("button", { class: "quiet", title: "What the keys do (?)", on: { click: () => this.dialog.showModal() } }, "Keys");
    document.addEventListener("keydown", (event) => this.press(event));
  }

  deed(key, far) {
    const { page } = this;
    if (/^[0-9]$/.test(key)) return () => page.choose(key === "0" ? "team" : Number(key) - 1);
    return {
      " ": () => page.hold(),
      ArrowLeft: () => page.seek(page.t - far),
      ArrowRight: () => page.seek(page.t + far),
      Home: () => page.seek(0),
      End: () => page.toEnd(),
      t: () => page.choose("truth"),
      d: () => page.flip(),
      "?": () => this.dialog.showModal(),
    }[key];
  }

  // Keys that a part of the page has a use for itself are left to it.
  press(event) {
    const at = event.target;
    if (this.dialog.open || event.ctrlKey || event.metaKey || event.altKey) return;
    if (at.matches?.("select")) return;
    const moves = event.key.startsWith("Arrow") || event.key === "Home" || event.key === "End";
    if (moves && at.matches?.("input[type=radio], .events, .scroll, pre")) return;
    if (event.key === " " && at.matches?.("button, summary, input[type=radio]")) return;
    const deed = this.deed(event.key, event.shiftKey ? FAR_S : STEP_S);
    if (!deed) return;
    event.preventDefault();
    deed();
  }
}
