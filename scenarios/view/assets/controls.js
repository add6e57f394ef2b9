// The page of one run: panels, time, curves, lists. A report plays it back; live feeds it on.

import { Curves } from "ropeteam/curves";
import { Keys } from "ropeteam/keys";
import { linkCard } from "ropeteam/links";
import { legend, readTheme } from "ropeteam/looks";
import { bytesText, clock, upTo } from "ropeteam/model";
import { RobotMap } from "ropeteam/panel";
import { World } from "ropeteam/scene";
import { dot, endCards, eventText, make } from "ropeteam/tables";

const SPEEDS = [1, 5, 10, 30, 60, 120, 300, 600];
const WHOLE_IN_S = 60; // a run is played back in about so many seconds, unless asked otherwise
const LIT_S = 0.25; // a frame stays lit for so long on the screen
const QUIET = new Set(["activity"]);
const MOST_EVENTS = 400;

export class Page {
  constructor(root, run, live = null) {
    this.run = run;
    this.live = live;
    this.t = 0;
    this.playing = false;
    this.follows = live !== null;
    this.speed = 60;
    this.rate = 1;
    this.root = root;
    this.listed = -1;
    this.keys = new Keys(this);
    this.build();
    this.theme = readTheme();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.restyle());
    new ResizeObserver(() => requestAnimationFrame(() => this.draw())).observe(root);
  }

  // --- what is on the page ---------------------------------------------------------------

  build() {
    const { head } = this.run;
    this.status = make("p", { class: "status", "aria-live": "polite" });
    this.numbers = make("div", { class: "numbers" });
    this.worldCanvas = make("canvas", { class: "world", role: "img", "aria-label": "The world from above" });
    this.worldCanvas.style.aspectRatio = `${head.frame.cols} / ${head.frame.rows}`;
    this.world = new World(this.worldCanvas, this.run);
    this.maps = this.run.robots.map((robot) => this.mapPanel(robot));
    this.charts = make("section", { class: "charts", "aria-label": "Curves" });
    this.eventList = make("ol", { class: "events", tabindex: "0", "aria-label": "Events" });
    this.tables = make("section", { class: "tables" });
    this.root.append(
      make(
        "header",
        { class: "top" },
        make("div", {}, make("h1", {}, head.title), this.status),
        make(
          "div",
          { class: "corner" },
          this.keys.button,
          make("button", { class: "quiet", title: "Light or dark (d)", on: { click: () => this.flip() } }, "Light / dark"),
        ),
      ),
      this.live ? this.live.bar() : "",
      this.numbers,
      make(
        "main",
        { class: "panels" },
        make("section", { class: "card stage", "aria-label": "World" }, this.choices(), this.worldCanvas, legend(this.run, this.world.range)),
        make(
          "div",
          { class: "right" },
          make("section", { class: "maps", "aria-label": "Each robot's team map" }, ...this.maps.map((m) => m.card)),
          make("section", { class: "card side" }, make("h2", {}, "Events"), this.eventList),
        ),
      ),
      this.timeBar(),
      this.charts,
      this.tables,
      this.keys.dialog,
    );
    this.curves = new Curves(this.charts, this.run, { look: () => this.theme, onPick: (t) => this.seek(t) });
  }

  mapPanel(robot) {
    const choose = () => this.choose(robot.index);
    const canvas = make("canvas", { role: "img", "aria-label": `Map of ${robot.name}`, title: "Show it large", on: { click: choose } });
    canvas.style.aspectRatio = `${this.run.head.frame.cols} / ${this.run.head.frame.rows}`;
    const facts = make("p", { class: "small" });
    const buttons = make("div", { class: "acts" });
    const card = make(
      "article",
      { class: "card map" },
      make("h3", {}, dot(robot.colour), robot.name, make("span", { class: "role" }, robot.role === robot.name ? "" : robot.role)),
      canvas,
      facts,
      buttons,
    );
    return { card, facts, buttons, robot, panel: new RobotMap(canvas, this.run, robot, this.world.range) };
  }

  choices() {
    const choices = [["truth", "truth only"], ["team", "all maps"], ...this.run.robots.map((r) => [r.index, r.name])];
    this.choiceInputs = new Map(
      choices.map(([value]) => [
        value,
        make("input", { type: "radio", name: "shown", checked: value === "team", on: { change: () => this.choose(value) } }),
      ]),
    );
    return make(
      "fieldset",
      { class: "choices" },
      make("legend", {}, "Over the dimmed truth"),
      ...choices.map(([value, words]) => make("label", {}, this.choiceInputs.get(value), make("span", {}, words))),
    );
  }

  // Lays another map over the truth: "truth" (none), "team", or a robot's by its index.
  choose(value) {
    const input = this.choiceInputs.get(value);
    if (!input) return;
    input.checked = true;
    this.world.choice = value;
    this.draw();
  }

  timeBar() {
    const button = (words, title, act, more = {}) => make("button", { title, "aria-label": title, on: { click: act }, ...more }, words);
    this.playButton = button("Play", "Play (space)", () => this.toggle(), { class: "play" });
    this.isLive = this.live !== null;
    if (this.live) this.playButton.hidden = true;
    this.slider = make("input", {
      type: "range",
      min: 0,
      max: 1,
      step: 0.1,
      value: 0,
      "aria-label": "Simulated time",
      on: { input: () => this.seek(Number(this.slider.value)) },
    });
    this.clockText = make("output", { class: "clock" }, "0:00:00");
    this.speedSelect = make(
      "select",
      { "aria-label": "Speed of play-back", on: { change: () => this.setSpeed(Number(this.speedSelect.value)) } },
      ...SPEEDS.map((speed) => make("option", { value: speed }, `${speed} ×`)),
    );
    this.speedLabel = make("label", { class: "speed", hidden: this.live !== null }, "plays at ", this.speedSelect);
    this.liveButton = this.live
      ? button("to now", "Follow the run as it goes on", () => this.follow(), { class: "quiet" })
      : null;
    this.marks = make("div", { class: "marks", "aria-hidden": "true" });
    return make(
      "nav",
      { class: "time", "aria-label": "Time" },
      button("start", "To the start (Home)", () => this.seek(0)),
      button("−5 s", "Back by 5 simulated seconds (←; with shift a minute)", () => this.seek(this.t - 5)),
      this.playButton,
      button("+5 s", "On by 5 simulated seconds (→; with shift a minute)", () => this.seek(this.t + 5)),
      make("div", { class: "track" }, this.slider, this.marks),
      this.clockText,
      this.speedLabel,
      this.liveButton,
    );
  }

  // --- time --------------------------------------------------------------------------------

  get end_s() {
    return this.run.last_s;
  }

  setSpeed(speed) {
    this.speed = speed;
    this.speedSelect.value = String(speed);
  }

  pickSpeed() {
    this.setSpeed(SPEEDS.findLast((speed) => this.end_s / speed >= WHOLE_IN_S) ?? SPEEDS[0]);
  }

  // From now on the page plays back what it was told: the run has ended.
  release() {
    this.isLive = false;
    this.playButton.hidden = this.speedLabel.hidden = false;
    this.liveButton.hidden = true;
    this.listed = -1;
    this.pickSpeed();
  }

  toggle() {
    this.playing = !this.playing;
    if (this.playing && this.t >= this.end_s) this.t = 0;
    this.follows = false;
    this.last = null;
    this.showPlaying();
    if (this.playing) requestAnimationFrame((now) => this.tick(now));
  }

  showPlaying() {
    this.playButton.textContent = this.playing ? "Pause" : "Play";
    this.playButton.title = this.playing ? "Pause (space)" : "Play (space)";
    this.playButton.setAttribute("aria-label", this.playButton.title);
    if (this.liveButton) this.liveButton.setAttribute("aria-pressed", String(this.follows));
  }

  tick(now) {
    if (!this.playing) return;
    if (this.last !== null) this.t = Math.min(this.t + ((now - this.last) / 1000) * this.speed, this.end_s);
    this.last = now;
    if (this.t >= this.end_s) {
      this.playing = false;
      this.showPlaying();
    }
    this.draw();
    if (this.playing) requestAnimationFrame((later) => this.tick(later));
  }

  seek(t) {
    this.t = Math.min(Math.max(t, 0), this.end_s);
    this.follows = false;
    this.showPlaying();
    this.draw();
  }

  follow() {
    this.follows = true;
    this.playing = false;
    this.t = this.end_s;
    this.showPlaying();
    this.draw();
  }

  // What the space bar does: a run that goes on is held itself, another one's play-back.
  hold() {
    if (this.isLive) this.live.toggle();
    else this.toggle();
  }

  toEnd() {
    if (this.isLive) this.follow();
    else this.seek(this.end_s);
  }

  // --- showing -----------------------------------------------------------------------------

  // Shows rows that were taken in: to be called after `run.take` and `run.advance`.
  refresh() {
    this.reckon();
    if (this.follows) this.t = this.end_s;
    this.slider.max = String(Math.max(this.end_s, 1));
    this.draw();
  }

  // Reckons how many simulated seconds go by in a second, while the run goes on.
  reckon() {
    const now = performance.now();
    if (this.reckoned) this.rate = (1000 * (this.end_s - this.reckoned[1])) / Math.max(now - this.reckoned[0], 1);
    this.reckoned = [now, this.end_s];
  }

  // How long, in simulated seconds, a frame stays lit after it has crossed.
  lit_s() {
    if (this.playing) return LIT_S * this.speed;
    return LIT_S * (this.isLive && this.follows ? Math.max(this.rate, 1) : 1);
  }

  draw() {
    if (!this.theme) return;
    for (const robot of this.run.robots) robot.map.to(this.t);
    this.slider.value = String(this.t);
    this.slider.setAttribute("aria-valuetext", clock(this.t));
    this.clockText.textContent = `${clock(this.t)} / ${clock(this.end_s)}`;
    this.world.draw(this.t, this.lit_s(), this.theme, this.playing);
    for (const { panel, facts, robot } of this.maps) {
      panel.draw(this.t, this.theme, this.playing);
      facts.textContent = this.mapFacts(robot);
    }
    this.curves.at(this.t);
    this.showNumbers();
    this.showEvents();
  }

  mapFacts(robot) {
    const state = robot.stateAt(this.t);
    if (state === "waiting") return `joins at ${clock(robot.joins_s)}`;
    const sample = robot.samples[upTo(robot.samples, this.t, (s) => s[0]) - 1];
    const observable = this.run.head.observable_cells;
    const share = observable > 0 ? (100 * robot.map.mapped) / observable : 0;
    const facts = [robot.map.mapped === 0 ? "knows nothing yet" : `${share.toFixed(0)} % mapped`];
    if (sample?.[4] !== null && sample?.[4] !== undefined) facts.push(`${(100 * sample[4]).toFixed(1)} cm rms`);
    if (state !== "alive") facts.push(state);
    return facts.join(", ");
  }

  showNumbers() {
    const sent = this.run.robots.reduce((sum, robot) => sum + robot.bytesTo(this.t), 0);
    const looks = this.run.robots.reduce((sum, robot) => sum + robot.looksTo(this.t), 0);
    const most = Math.max(0, ...this.run.robots.map((robot) => robot.map.mapped));
    const observable = this.run.head.observable_cells;
    const alive = this.run.robots.filter((robot) => robot.stateAt(this.t) === "alive").length;
    const facts = [
      ["best map", observable > 0 ? `${((100 * most) / observable).toFixed(1)} %` : "–"],
      ["sent", bytesText(sent)],
      ["looks", String(looks)],
      ["robots running", `${alive} of ${this.run.robots.length}`],
    ];
    if (this.numbers.childElementCount === 0) {
      this.numberCells = facts.map(([key]) => {
        const value = make("strong", {});
        this.numbers.append(make("div", {}, value, make("span", {}, key)));
        return value;
      });
    }
    facts.forEach(([, value], i) => {
      this.numberCells[i].textContent = value;
    });
  }

  showCurves() {
    this.curves.show(this.end_s);
  }

  showEvents() {
    const told = this.run.events.filter((row) => !QUIET.has(row[2]));
    if (told.length !== this.listed) {
      this.listed = told.length;
      this.eventItems = told.slice(-MOST_EVENTS).map((row) => this.eventItem(row));
      const empty = make("li", { class: "empty" }, "Nothing has happened yet.");
      this.eventList.replaceChildren(...(this.eventItems.length > 0 ? this.eventItems.map((e) => e.item) : [empty]));
      if (this.follows) this.eventList.scrollTop = this.eventList.scrollHeight;
      this.marks.replaceChildren(...(this.isLive ? [] : told.map((row) => this.mark(row))));
    }
    for (const { item, t } of this.eventItems ?? []) item.classList.toggle("later", t > this.t + 1e-6);
  }

  eventItem(row) {
    const { t, what, detail, name, colour, time } = eventText(this.run, row);
    const item = make(
      "li",
      {},
      make("button", { class: "jump", title: `Go to ${time}`, on: { click: () => this.seek(t) } }, time),
      make("span", {}, colour ? dot(colour) : null, `${name}: ${what}`, detail ? make("em", {}, ` ${detail}`) : null),
    );
    return { item, t };
  }

  mark(row) {
    const { t, colour } = eventText(this.run, row);
    return make("i", { style: `left:${(100 * t) / Math.max(this.end_s, 1)}%;background:${colour ?? "gray"}` });
  }

  showEnd(end) {
    this.run.end = end;
    const { outcome, outcome_reason } = end.summary;
    const words = `${outcome}: ${outcome_reason}`;
    this.status.textContent = words[0].toUpperCase() + words.slice(1);
    this.tables.replaceChildren(...endCards(this.run, linkCard(this.run), end));
  }

  // --- light and dark ------------------------------------------------------------------------

  flip() {
    const isDark = this.forced ? this.forced === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
    this.forced = isDark ? "light" : "dark";
    document.documentElement.style.colorScheme = this.forced;
    this.restyle();
  }

  restyle() {
    this.theme = readTheme();
    this.curves.restyle();
    this.draw();
  }
}
