// The live view: fed by the runner through a socket, with buttons that change the run.

import { Page } from "ropeteam/controls";
import { unpack } from "ropeteam/data";
import { Run, clock } from "ropeteam/model";
import { make } from "ropeteam/tables";

const CURVES_MS = 1000;

class Live {
  constructor(root) {
    this.root = root;
    this.wait = make("p", { class: "status" }, "Waiting for the run ...");
    root.append(this.wait);
    this.over = false;
    const address = new URL("socket", location.href);
    address.protocol = "ws:";
    this.socket = new WebSocket(address);
    this.socket.binaryType = "arraybuffer";
    this.socket.onmessage = (message) => this.hear(unpack(message.data));
    this.socket.onclose = () => this.lost();
  }

  ask(wish) {
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(wish));
  }

  hear(told) {
    const acts = {
      head: () => this.begin(told.head),
      rows: () => this.rows(told),
      state: () => this.state(told),
      end: () => this.end(told.end),
      done: () => this.done(told),
      no: () => this.say(told.why, true),
    };
    acts[told.type]?.();
  }

  begin(head) {
    this.wait.remove();
    this.run = new Run(head);
    this.page = new Page(this.root, this.run, this);
    this.page.status.textContent = "Running";
    this.page.refresh();
    this.page.showCurves();
    this.curves = performance.now();
    document.documentElement.dataset.ready = "yes";
  }

  rows({ now_s, rows }) {
    this.run.take(rows);
    this.run.advance(now_s);
    this.pending ??= requestAnimationFrame(() => {
      this.pending = null;
      this.page.refresh();
      this.showButtons();
      if (performance.now() > this.curves + CURVES_MS) this.showCurves();
      else this.later ??= setTimeout(() => this.showCurves(), CURVES_MS);
    });
  }

  showCurves() {
    clearTimeout(this.later);
    this.later = null;
    this.curves = performance.now();
    this.page.showCurves();
  }

  // --- what can be done ----------------------------------------------------------------------

  // The bar by which the run itself is held and let go.
  bar() {
    this.goButton = make("button", { class: "play", on: { click: () => this.toggle() } }, "Pause the run");
    this.stepButton = make("button", { title: "Let 5 simulated seconds pass", on: { click: () => this.ask({ do: "step" }) } }, "Step 5 s");
    this.speeds = make("select", { "aria-label": "Speed of the run", on: { change: () => this.ask({ do: "speed", value: Number(this.speeds.value) }) } });
    this.said = make("p", { class: "small said", role: "status" });
    return make("div", { class: "runbar" }, this.goButton, this.stepButton, make("label", { class: "speed" }, "runs at ", this.speeds), this.said);
  }

  toggle() {
    if (this.over || !this.hasPace) return;
    this.ask({ do: this.paused ? "go" : "pause" });
  }

  state({ paused, steps, speed, speeds, has_pace }) {
    this.paused = paused;
    this.hasPace = has_pace;
    if (this.speeds.childElementCount === 0) {
      const words = (s) => (s === 0 ? "full speed" : `${s} × real time`);
      this.speeds.append(...speeds.map((s) => make("option", { value: s }, words(s))));
    }
    this.speeds.value = String(speed);
    this.goButton.textContent = paused ? "Let it run" : "Pause the run";
    this.goButton.setAttribute("aria-keyshortcuts", "Space");
    for (const part of [this.goButton, this.stepButton, this.speeds]) part.disabled = !has_pace || this.over;
    if (paused) this.page.rate = 1;
    this.page.draw();
    if (!this.over) this.page.status.textContent = paused && !steps ? "Paused" : "Running";
  }

  // What can be done to a robot, by what state it is in.
  buttonsOf(robot) {
    const deed = (words, what, title, more = {}) =>
      make("button", { title, on: { click: () => this.ask({ do: what, robot: robot.name }) }, ...more }, words);
    const buttons = {
      kill: deed("Kill", "kill", `End ${robot.name} at once`, { class: "bad" }),
      cut: deed("Cut off", "cut", `${robot.name} hears nobody, and nobody hears it`),
      heal: deed("Heal link", "heal", `${robot.name}'s radio works again`),
      revive: deed("Bring back", "revive", `Start ${robot.name} again, ten simulated seconds later`),
    };
    for (const [name, button] of Object.entries(buttons)) button.dataset.deed = name;
    return buttons;
  }

  showButtons() {
    const t = this.run.last_s;
    for (const { robot, buttons } of this.page.maps) {
      robot.acts ??= this.buttonsOf(robot);
      if (buttons.childElementCount === 0) buttons.append(...Object.values(robot.acts));
      const state = robot.stateAt(t);
      const isCut = this.isCut(robot);
      const runs = state === "alive";
      robot.acts.kill.disabled = this.over || !(runs || state === "stopped");
      robot.acts.cut.hidden = isCut;
      robot.acts.heal.hidden = !isCut;
      robot.acts.cut.disabled = robot.acts.heal.disabled = this.over;
      robot.acts.revive.hidden = state !== "killed";
      robot.acts.revive.disabled = this.over;
    }
  }

  // Whether the last thing that happened to a robot's own radio was that it was switched off.
  isCut(robot) {
    const told = this.run.events.filter(([name, , what, detail]) => what === "link" && name === robot.index && detail.includes("up ="));
    return told.length > 0 && told.at(-1)[3].includes("up = False");
  }

  done({ deed, robot, at_s }) {
    const words = { kill: "killed", cut: "cut off", heal: "heard again", revive: "started again, ten seconds later" };
    this.say(`${robot} is ${words[deed]} at ${clock(at_s)}; written into scenario.toml`);
  }

  say(words, bad = false) {
    this.said.textContent = words;
    this.said.classList.toggle("bad", bad);
  }

  // --- the end -------------------------------------------------------------------------------

  end(end) {
    this.over = true;
    this.run.advance(end.summary.simulated_s);
    this.page.showEnd(end);
    this.page.release();
    this.page.refresh();
    this.showCurves();
    this.showButtons();
    for (const part of [this.goButton, this.stepButton, this.speeds]) part.disabled = true;
    this.say("The run is over. This page can play it back; so can report.html in the run's folder.");
  }

  lost() {
    if (this.over) return;
    this.over = true;
    if (this.page) {
      this.page.status.textContent = "The runner is gone";
      this.page.release();
      this.showButtons();
      this.say("The runner does not answer any more; what it had told can be played back.", true);
    } else this.wait.textContent = "The run is over: its report.html shows it.";
  }
}

new Live(document.getElementById("page"));
